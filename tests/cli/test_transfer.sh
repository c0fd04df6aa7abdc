#!/bin/sh
# test_transfer.sh - maps of further textures of a scan: values by formula, colour or data, tasks,
# the same bytes for any threads, budget and tiles, and what is refused.
. "$(dirname "$0")/lib.sh"
need_oracle
. "$top/tests/cli/texture_lib.sh"
# same_texels A B: two PNG files show the same, whatever their texts say.
same_texels()
{
    PYTHONPATH=$top/tests/cli python3 -B -c 'import png, sys
sys.exit(png.read(sys.argv[1]) != png.read(sys.argv[2]))' "$1" "$2"
}

vox="run bisque-voxelize --resolution 40" bake="run bisque-bake --size 48"

ok $vox plane.obj --texture light.png -o plane.nvdb
ok $vox bare.obj -o bare.nvdb

# ---- values from triangles ----

four=transfer:roughness,transfer:metallic,transfer:emission,transfer:coat
textures="--texture roughness=ramp.png --texture metallic=slope.png --texture emission=light.png
    --texture coat=three.png"
ok $bake plane.tris low.obj --maps color,$four $textures -o 't_<MAP>.png' --json
json '.maps | keys == ["coat", "color", "emission", "metallic", "roughness"]'
json '.maps.coat == "t_coat.png"'
values t_roughness.png ramp 0.00003
values t_metallic.png slope 0.002
values t_emission.png light 0.00003
values t_coat.png three 0.00003
holds "a transferred colour is that of the map color" same_texels t_color.png t_emission.png

ok $bake plane.tris low.obj --maps transfer:roughness --texture roughness=ramp.png -o one.png --type 8
values one.png ramp 0.004
ok $bake plane.tris low.obj --maps transfer:emission --texture emission=light.png -o e.exr
grep -aq 'bisque:transfer.*emission' e.exr && grep -aq lin_rec709_scene e.exr
check "the file says what it shows" $?

# "all" leaves out what only one of two scans has, and says so once, whichever comes first.
ok $vox plane.obj --channels dirt=ramp.png -o dirty.nvdb --tris dirty.tris
for scans in 'dirty.nvdb plane.nvdb' 'plane.nvdb dirty.nvdb' 'plane.tris dirty.tris'; do
    # shellcheck disable=SC2086 # names
    ok $bake $scans low.obj --maps all --rays ao=1 --rays thickness=1 -o 'a_<MAP>.exr'
    [ "$(grep -c "warning: the scans do not all have the channel dirt: no map transfer:dirt is baked" "$err")" -eq 1 ]
    check "a warning of a lost channel: $scans" $?
    # shellcheck disable=SC2086 # names
    $bake $scans low.obj --maps all --rays ao=1 --rays thickness=1 -o 'a_<MAP>.exr' --strict
    code 65
done
rm a_* dirty.*

# ---- channels of materials ----

# Two materials, which change at x = 0.6.
moved='-s 0.5 -0.5 -o 0.25 0.75 light.png'
cat >two.mtl <<END
newmtl left
Pr 0.3
map_Pm -imfchan g three.png
Pm 0.9
map_Ke $moved
map_Kd $moved
newmtl right
map_Pr ramp.png
Pm 0.75
Ke 0.2 0.4 0.6
map_Kd $moved
map_Ps none.png
END
ok $vox two.obj --channels id,roughness,metallic,emission,coat=three.png -o two.nvdb
holds "no message about channels that nobody asked for" [ ! -s "$err" ]
ok run bisque-voxelize --verify two.tris
ok oracle read_file two.tris
ok $bake two.tris low.obj --maps id,color,$four -o 'two_<MAP>.png'
values two_roughness.png two_rough 0.00003
for scan in two.tris two.nvdb; do
    ok $bake $scan low.obj --maps all --json -o 'all_<MAP>.png' --rays ao=1 --rays thickness=1
    json '.maps | (keys - ["ao", "bent", "confidence", "curvature", "height", "mask", "normal", "position", "thickness"])
        == ["coat", "color", "emission", "id", "metallic", "roughness"]'
done
values two_metallic.png two_metal 0.00003
values two_emission.png two_light 0.00003
values two_coat.png three 0.00003
values two_color.png moved_light 0.00003
ok $bake two.nvdb low.obj --maps color -o two_grid.png
values two_grid.png moved_light 0.02

# ---- channels of glTF materials ----

# The same scan as OBJ and as glTF, whose materials have all in one texture, and coordinates that are
# those of a base colour which is moved.
sed 's/two.mtl/pbr.mtl/' two.obj >pbr.obj
cat >pbr.mtl <<END
newmtl left
map_Pr -imfchan g orm.png
map_Pm -imfchan b orm.png
map_ao orm.png
map_Ke $moved
newmtl right
Pr 0.5
Pm 0.75
Ke 0.2 0.4 0.6
map_ao orm.png
END
$maps gltf two.obj || exit 1
pbr=transfer:roughness,transfer:metallic,transfer:emission,transfer:occlusion
for scan in pbr.obj two.gltf; do
    ok $vox $scan --channels roughness,metallic,emission,occlusion -o pbr.nvdb
    holds "no warning about channels of $scan" [ ! -s "$err" ]
    ok $bake pbr.tris low.obj --maps $pbr -o "pbr_$scan.<MAP>.png"
    values pbr_$scan.roughness.png pbr_rough 0.00003
    values pbr_$scan.metallic.png two_metal 0.00003
    values pbr_$scan.emission.png two_light 0.00003
    values pbr_$scan.occlusion.png slope 0.00003
done
ok $vox two.gltf --channels clearcoat -o x.nvdb
grep -q 'warning: two.gltf: no material has a value or a texture of clearcoat, so it is 0 everywhere' "$err"
check "a channel that nothing has is told" $?

# What cannot be used is told, if the channel is kept.
jq '(.materials[0].occlusionTexture.texCoord) = 1 | .materials[1].occlusionTexture.strength = 0.5 |
    .materials[0].pbrMetallicRoughness.roughnessFactor = 0.5 |
    .materials[0].emissiveTexture.extensions.KHR_texture_transform.rotation = 0.5 |
    .materials[0].emissiveFactor = [0, 0, 0]' two.gltf >odd.gltf
ok $vox odd.gltf --channels metallic,emission -o odd.nvdb
holds "no warning about channels that nobody asked for, or are black" [ ! -s "$err" ]
ok $vox odd.gltf --channels roughness,occlusion -o odd.nvdb
grep -q 'material "left": occlusion: its texture has other texture coordinates than the base colour' "$err"
check "textures of channels that cannot be used are told" $?
$vox odd.gltf --channels occlusion -o x.nvdb --strict
code 65
jq '.materials[0] |= (del(.pbrMetallicRoughness) | .extensions.KHR_materials_pbrSpecularGlossiness = {})' \
    two.gltf >glossy.gltf
ok $vox glossy.gltf --channels roughness -o x.nvdb
grep -q 'material "left": roughness: it has specular and glossiness instead, which are not read' "$err"
check "roughness that a material has as glossiness is told" $?

# ---- channels of grids ----

# Borders of materials are as exact as two voxels.
ok $vox --resolution 160 two.tris --channels metallic,coat,emission,roughness -o fine.nvdb
ok run bisque-voxelize --verify fine.nvdb
out_like 'surface grid of version 4'
ok oracle read_file fine.nvdb
ok $bake fine.nvdb low.obj --maps $four --device cpu -o 'fine_<MAP>.png'
values fine_roughness.png two_rough 0.0001
values fine_metallic.png two_metal 0.0001
values fine_emission.png two_light 0.0001
values fine_coat.png three 0.0001
ok $bake fine.nvdb low.obj --maps $four --scan sampling=nearest -o 'near_<MAP>.png'
values near_coat.png three 0.005

# A sphere of radius 1 whose image shows its position: a function of it, by triangles and by voxels.
$maps sphere || exit 1
ok $vox --resolution 100 ball.obj --channels place=ball.png,roughness=ball.png -o ball.nvdb
for scan in nvdb tris; do
    ok run bisque-bake ball.$scan ball_low.obj --size 64 --samples 2 \
        --maps normal,transfer:place,transfer:roughness --normal space=object -o "ball_${scan}_<MAP>.png"
    $maps on_sphere ball_${scan}_place.png ball_${scan}_roughness.png ball_${scan}_normal.png 0.01 >"$out"
    check "channels of the sphere are functions of its position, from $scan" $?
done

# The kernel for devices gives the same bytes.
if [ -s "$(ls "$BIN"/../gen/kernel-*.ptx 2>/dev/null | head -n 1)" ]; then
    LD_LIBRARY_PATH=$TESTS/fake ok $bake fine.nvdb low.obj --maps $four --device cuda -o 'cuda_<MAP>.png'
    for map in roughness metallic emission coat; do
        same fine_$map.png cuda_$map.png
    done
fi

# From the chunk file, with other threads and budgets, a grid has the same bytes.
ok $vox --resolution 160 two.tris --channels metallic,coat,emission,roughness -o again.nvdb --threads 1 \
    --memory 150M
holds "a grid with channels has the same bytes for any threads and budget" cmp -s fine.nvdb again.nvdb
$bake two.nvdb low.obj --maps transfer:sheen -o x.png
refused_like 65 'two.nvdb has no channel sheen: make it with bisque-voxelize --channels sheen'
run bisque-voxelize --resolution 40 two.tris --channels sheen -o x.nvdb
refused_like 65 'two.tris has no channel sheen: make it with bisque-voxelize --channels sheen'

# Beside each other as two scans.
for side in left right; do
    awk -v side=$side '/^usemtl/ { keep = $2 == side } !/^f/ || keep { print }' two.obj >$side.obj
    ok $vox $side.obj --channels roughness,emission,metallic -o $side.nvdb
done
ok $bake left.tris right.tris low.obj --maps transfer:roughness,transfer:emission -o 'sides_<MAP>.png'
values sides_roughness.png two_rough 0.00003
values sides_emission.png two_light 0.00003

ok $vox two.obj --channels sheen -o sheen.nvdb
grep -q 'two.mtl:12: .*none.png: no such texture: material "right" goes without it' "$err" &&
    grep -q 'two.obj: no material has a value or a texture of sheen' "$err"
check "a channel that nothing gives is told" $?
$vox bare.obj --channels coat=three.png -o coat.nvdb
refused_like 65 'bare.obj: no texture coordinates for the channel coat of three.png'
[ ! -e coat.nvdb ]
check "and no grid is made" $?

# ---- textures of tiles ----

# Texture coordinates u = 2 x, v = y lie in two tiles; u = 3 x also in one without a file.
for times in 2 3; do
    awk -v times=$times '/^vt/ { $2 *= times } { print }' plane.obj |
        sed "1imtllib udim.mtl\nusemtl tiles" >udim$times.obj
done
printf 'newmtl tiles\nmap_Kd udim.<UDIM>.png\n' >udim.mtl
cp udim.1001.png uv_u1_v1.png
cp udim.1002.png uv_u2_v1.png
ok $vox udim2.obj --channels 'emission=uv_<UVTILE>.png' -o udim2.nvdb
holds "no message about tiles that nobody needs" [ ! -s "$err" ]
for scan in tris nvdb; do
    ok $bake udim2.$scan low.obj --maps color -o udim_$scan.png
done
values udim_tris.png two_tiles_light 0.001 # footprints are wider than a texel
values udim_nvdb.png two_tiles_light 0.02
ok $bake udim2.tris low.obj --maps transfer:emission -o udim_e.png
holds "<UVTILE> is another name of the tiles" same_texels udim_e.png udim_tris.png
# Tokens stand anywhere in the path.
mkdir -p tiles/1001 tiles/1002
cp udim.1001.png tiles/1001/u1_v1.png
cp udim.1002.png tiles/1002/u2_v1.png
printf 'newmtl tiles\nmap_Kd tiles/<UDIM>/<UVTILE>.png\n' >folders.mtl
sed 's/udim.mtl/folders.mtl/' udim2.obj >folders.obj
ok $vox folders.obj -o folders.nvdb --strict
ok $bake folders.tris low.obj --maps color -o folders.png
holds "tokens in folders and names" cmp -s folders.png udim_tris.png
ok $vox udim3.obj -o udim3.nvdb
told='udim.<UDIM>.png: 1 tile has no file that can be read: 1003; the scan is black there'
[ "$(grep -c "$told" "$err")" = 1 ] && [ "$(wc -l <"$err")" = 1 ]
check "the tile that is missing is told once" $?
$bake udim3.tris low.obj --maps color -o udim3.png --strict
code 65
holds "and refused by a strict job" grep -q "$told" "$err"
ok $vox udim3.obj --channels 'emission=udim.<UDIM>.png,a=udim.<UDIM>.png' -o udim3.nvdb
holds "also if it is missing for colours and for channels" [ "$(cat "$err")" = "bisque-voxelize: warning: $(pwd -P)/$told" ]
# Many missing tiles are one line. A damaged one is lost alone, whatever is wrong with it.
awk '/^vt/ { $2 *= 20 } { print }' udim3.obj >udim60.obj
ok $vox udim60.obj -o udim60.nvdb
grep -q 'udim.<UDIM>.png: [0-9]* tiles have no file that can be read: 1003, 1004, 1005, 1006, 1007, ...; the scan' "$err"
check "the first of many missing tiles" $?
[ "$(wc -l <"$err")" = 2 ] && grep -q 'where it lies outside of all tiles' "$err"
check "and no further lines but that of all else" $?
printf 'newmtl tiles\nmap_Kd bad.<UDIM>.png\n' >bad.mtl
sed 's/udim.mtl/bad.mtl/' udim2.obj >bad.obj
cp udim.1001.png bad.1001.png
$vox bad.obj -o alone.nvdb
for damage in fifo folder cut; do
    rm -rf bad.1002.png
    case $damage in
    fifo) mkfifo bad.1002.png ;;
    folder) mkdir bad.1002.png ;;
    cut) head -c 60 udim.1002.png >bad.1002.png ;;
    esac
    ok $vox bad.obj -o bad.nvdb
    same alone.nvdb bad.nvdb
    black='bad.<UDIM>.png: 1 tile has no file that can be read: 1002; the scan is black there'
    holds "one tile: $damage" grep -q "$black" "$err"
done
grep -q 'bad.<UDIM>.png: 1 tile is not used; the first: .*bad.1002.png: ' "$err" &&
    [ "$(wc -l <"$err")" = 2 ]
check "what is wrong with it" $?
ok $bake bad.tris low.obj --maps color -o bad.png
holds "a bake tells of the tile too" grep -q "$black" "$err"
head -c 60 udim.1002.png >bad.1001.png
rm -r bad.1002.png
ok $vox bad.obj -o bad.nvdb
holds "all tiles are damaged" grep -q 'bad.1001.png: .*: material "tiles" goes without it' "$err"
# A texture whose first texel is not finite, for colours and for two channels.
{
    printf 'PF\n16 16\n-1.0\n\0\0\300\177'
    head -c 3068 /dev/zero
} >broken.pfm
broken='broken.pfm: texels that are not finite: 1; they count as 0'
ok $vox plane.obj --texture broken.pfm --channels emission=broken.pfm,a=broken.pfm -o broken.nvdb
holds "a damaged texture is told once" [ "$(cat "$err")" = "bisque-voxelize: warning: $(pwd -P)/$broken" ]
ok $bake broken.tris low.obj --maps color,transfer:emission,transfer:a -o 'broken_<MAP>.exr'
holds "also by a bake" [ "$(cat "$err")" = "bisque-bake: warning: $(pwd -P)/$broken" ]
ok run bisque-voxelize plane.obj --texture broken.pfm -o sorted.tris --strict
for job in "$vox sorted.tris -o x.nvdb" "$bake sorted.tris low.obj --maps color -o x.exr"; do
    $job --strict
    code 65
    holds "a job that uses the texels tells: $job" grep -q "$broken" "$err"
done
$vox udim2.obj --texture 'none.<UDIM>.png' -o x.nvdb
refused_like 66 'none.<UDIM>.png: no tile of this texture exists'

# ---- the same bytes ----

for how in '--threads 1' '--memory 100M'; do
    ok $bake plane.tris low.obj --maps color,$four $textures -o 's_<MAP>.png' $how
    for map in color roughness metallic emission coat; do
        cmp -s t_$map.png s_$map.png || echo "$map differs" >>differ
    done
done
holds "maps have the same bytes with other options of the work" [ ! -e differ ]
in_parts 2 $bake plane.tris low.obj --maps color,$four $textures -o 'p_<MAP>.png'
for map in color roughness metallic emission coat; do
    holds "parts give the bytes of $map" cmp -s t_$map.png p_$map.png
done

# ---- what is refused ----

$bake plane.tris low.obj --maps transfer:gloss -o x.png
refused_like 65 'plane.tris has no channel gloss: make it with bisque-voxelize --channels gloss'
$bake plane.tris two.tris low.obj --maps transfer:a --texture a=ramp.png -o x.png
refused_like 64 'ramp.png is a texture of one scan, but there are 2 scans'
$vox two.tris --channels coat=three.png -o x.nvdb
refused_like 64 'two.tris is already a chunk file: leave out the images of --channels'
$vox two.obj --channels Rough -o x.nvdb
refused_like 64 '"Rough" is not a channel'
for name in normal id all transfer; do
    run bisque-voxelize two.obj -o bad.nvdb --channels roughness,$name=three.png
    refused 64 "bisque-voxelize: --channels: \"$name=three.png\": there is a map of this name"
done
$vox two.obj --channels a,a -o x.nvdb
refused_like 64 'channel a is named twice'
$bake plane.tris low.obj --maps normal --texture gloss=ramp.png -o x.png
refused_like 64 -- '--maps does not have transfer:gloss'
$bake plane.tris low.obj --maps transfer:Gloss --texture Gloss=ramp.png -o x.png
refused_like 64 'cannot be a transfer map'
$bake plane.tris low.obj --maps transfer:normal --texture normal=ramp.png -o x.png
refused_like 64 'another map of this name'
$bake plane.tris low.obj --maps transfer:a,transfer:a --texture a=ramp.png -o 'x_<MAP>.png'
refused_like 64 'transfer:a is named twice'
$bake plane.tris low.obj --maps transfer:a --texture a=ramp.png --texture a=ramp.png -o x.png
refused_like 64 '"a" is given twice'
$bake plane.tris low.obj --maps transfer:a --texture ramp.png -o x.png
refused_like 64 '"ramp.png" is not NAME=FILE'
$bake plane.tris low.obj --maps transfer:a,mask --texture a=ramp.png -o x.png
refused_like 64 'several maps need'
$bake plane.tris low.obj --maps transfer:ramp --texture ramp=ramp.png -o '<MAP>.png'
refused_like 64 'ramp.png'
$bake plane.nvdb low.obj --maps transfer:a --texture a=ramp.png -o x.png
refused_like 65 'plane.nvdb is a grid, which cannot use ramp.png: make it with bisque-voxelize --channels a=ramp.png'
$bake bare.tris low.obj --maps transfer:a --texture a=ramp.png -o x.png
refused_like 65 'has no texture coordinates'
$bake plane.tris low.obj --maps transfer:a --texture a=none.png -o x.png
refused_like 66 'none.png'
$bake plane.tris low.obj --maps transfer:a --texture a=plane.obj -o x.png
refused_like 65 'plane.obj: not a readable image'
[ ! -e x.png ] && [ ! -e x_a.png ]
check "nothing was written" $?
finish

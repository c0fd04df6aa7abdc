#!/bin/sh
# test_opacity.sh - opacity of scans: alpha of textures, values and textures of MTL and glTF files,
# and masks that are multiplied by it.
. "$(dirname "$0")/lib.sh"
need_oracle
. "$top/tests/cli/texture_lib.sh"
vox="run bisque-voxelize --resolution 40 --channels opacity"
bake="run bisque-bake --size 48"

$maps glass || exit 1

# ---- alpha of the colour texture ----

ok $vox plane.obj --texture glass.png -o plane.nvdb
for scan in tris nvdb; do
    tolerance=$([ $scan = tris ] && echo 0.002 || echo 0.01)
    ok $bake plane.$scan low.obj --maps color,mask:opacity -o "${scan}_<MAP>.png" --json
    json '.maps | keys == ["color", "mask"]'
    values ${scan}_mask.png slope $tolerance
    values ${scan}_color.png light 0.02
    ok $bake plane.$scan low.obj --maps mask:opacity,transfer:opacity -o "${scan}_both_<MAP>.png"
    values ${scan}_both_opacity.png slope $tolerance
    holds "a file of opacity changes no mask from $scan" cmp -s ${scan}_mask.png ${scan}_both_mask.png
    ok run bisque-bake --size 48 plane.$scan low.obj --maps mask -o ${scan}_plain.png
    values ${scan}_plain.png whole 0
done
ok run bisque-voxelize --verify plane.tris
oracle measure plane.tris
holds "another reader finds alpha in plane.tris" grep -q 'component 3' "$out"

# A mask from parts has the same bytes.
in_parts 2 $bake plane.tris low.obj --maps color,mask:opacity -o 'task_<MAP>.png'
cmp -s tris_mask.png task_mask.png && [ ! -e task_opacity.png ]
check "parts give the same mask" $?

# ---- materials ----

# material NAME FUNCTION STATEMENT...: a scan of this material has this opacity.
material()
{
    name=$1 function=$2
    shift 2
    printf '%s\n' 'newmtl m' "$@" >$name.mtl
    sed "1imtllib $name.mtl\nusemtl m" plane.obj >$name.obj
    ok run bisque-voxelize --channels opacity $name.obj -o $name.tris
    ok $bake $name.tris low.obj --maps mask:opacity -o $name.png
    values $name.png $function 0.002
}
material own slope 'map_Kd glass.png'
material over ramp 'map_Kd glass.png' 'map_d ramp.png'
material alpha slope 'map_d glass.png'
material green v 'map_d -imfchan g three.png'
material matte slope 'map_d -imfchan m glass.png'
material value half 'd 0.5'
material inverse half 'Tr 0.5'
material texture slope 'd 0.5' 'map_Kd glass.png'

# A texture of opacity that cannot be used is a loss: the alpha of the colour texture counts, or else
# the value, or else the material is opaque.
echo text >text.png
lost()
{
    name=$1 options=$2 function=$3
    shift 3
    printf '%s\n' 'newmtl m' "$@" >lost.mtl
    sed "1imtllib lost.mtl\nusemtl m" plane.obj >lost.obj
    ok run bisque-voxelize --progress none --channels opacity $options lost.obj -o lost.tris
    grep -Eq "^bisque-voxelize: warning: lost.mtl:2: (gone.png: no such texture|text.png: not a readable image: .*): material \"m\" goes without it$" "$err"
    check "a warning tells of the texture ($name)" $?
    ok $bake lost.tris low.obj --maps mask:opacity -o lost.png
    values lost.png $function 0.002
    run bisque-voxelize --channels opacity $options lost.obj -o strict.tris --strict
    code 65
    holds "no file with --strict" [ ! -e strict.tris ]
}
lost alpha '' slope 'map_d gone.png' 'map_Kd glass.png'
lost 'alpha of all' '--texture glass.png' slope 'map_d text.png'
lost value '' half 'map_d gone.png' 'map_Kd light.png' 'd 0.5'
lost unreadable '' half 'map_d text.png' 'Tr 0.5'
lost opaque '' whole 'map_d gone.png'
material both ramp 'map_d ramp.png'
ok run bisque-voxelize --channels opacity --texture glass.png both.obj -o both.tris
ok $bake both.tris low.obj --maps mask:opacity -o both.png
values both.png ramp 0.002

# Two materials, which change at x = 0.6, and one without opacity, which is opaque.
printf 'newmtl left\nd 0.5\nnewmtl right\nTr 0.25\n' >two.mtl
ok $vox --resolution 80 two.obj -o two.nvdb
for scan in tris nvdb; do
    ok $bake two.$scan low.obj --maps mask:opacity -o two.png
    values two.png two_opacity 0.002
done
sed 's/usemtl right/usemtl none/; s/usemtl left/usemtl right/' two.obj >rest.obj
awk '$1 == "usemtl" { name = $2; print; next } $1 != "f" || name == "none" { print }' rest.obj >none.obj
printf 'f 1 2 3\nusemtl right\nf 1 2 3\n' >>none.obj
ok $vox none.obj -o none.nvdb
for scan in tris nvdb; do
    ok $bake none.$scan low.obj --maps mask:opacity --samples 1 --back 0.01 --front 0.01 -o none_$scan.png
    python3 -B -c 'import sys; sys.path.insert(0, sys.argv[2]); import png
rows = png.read(sys.argv[1])[3]; sys.exit(rows[8][24][0] != 65535)' none_$scan.png "$top/tests/cli"
    check "faces without a material are opaque, from $scan" $?
done

# ---- glTF ----

ok $vox blend.gltf -o blend.nvdb
ok $bake blend.tris low.obj --maps mask:opacity -o blend.png
values blend.png slope 0.002
ok $vox thin.gltf -o thin.nvdb --strict
ok $bake thin.tris low.obj --maps mask:opacity -o thin.png
values thin.png half_slope 0.002
# A cutoff shows or hides.
while read -r name function; do
    ok $vox $name.gltf -o $name.nvdb
    holds "no warning about $name.gltf" [ ! -s "$err" ]
    ok $bake $name.tris low.obj --maps mask:opacity -o $name.png
    values $name.png "$function" 0
done <<'CASES'
mask upper
faint upper
gone none
CASES
ok $bake mask.nvdb low.obj --maps mask:opacity -o mask.png
values mask.png upper 0
oracle measure faint.tris
holds "another reader finds the cutoff in faint.tris" grep -q 'source 0.5 0.5 0.5 component 4' "$out"
ok run bisque-voxelize --verify mask.tris
ok $vox opaque.gltf -o opaque.nvdb
grep -q 'warning: opaque.gltf: no material has a value or a texture of opacity, so it is 1 everywhere' "$err"
check "opacity that nothing has is told" $?

# ---- an image of the options ----

ok run bisque-voxelize --resolution 40 plane.obj --channels opacity=glass.png -o given.nvdb
ok $bake given.tris low.obj --maps mask:opacity -o given.png
values given.png slope 0.002
ok run bisque-voxelize --resolution 40 plane.obj --texture light.png -o light.nvdb
ok $bake light.tris low.obj --maps mask:opacity,transfer:opacity --texture opacity=glass.png -o 'light_<MAP>.png'
values light_mask.png slope 0.002

# ---- what is refused ----

$bake light.tris low.obj --maps mask:opacity -o x.png
refused_like 65 'light.tris has no channel opacity: make it with bisque-voxelize --channels opacity'
$bake light.nvdb low.obj --maps mask:opacity -o x.png
refused_like 65 'light.nvdb has no channel opacity: make it with bisque-voxelize --channels opacity'
$vox light.nvdb -o x.nvdb
code 65
[ ! -e x.png ] && [ ! -e x.nvdb ]
check "nothing was written" $?
finish

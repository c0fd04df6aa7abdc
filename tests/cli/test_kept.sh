#!/bin/sh
# test_kept.sh - what bisque-voxelize keeps of a scan and says of the rest, and what --info says of files.
. "$(dirname "$0")/lib.sh"
need_oracle
p=bisque-voxelize: vox="run bisque-voxelize --resolution 16"

printf 'P3 2 2 255 9 9 9 200 9 9 9 200 9 9 9 200\n' >dot.ppm
cat >left.mtl <<'END'
newmtl left
Kd 1 1 1
map_Kd dot.ppm
map_Pr dot.ppm
Pm 0.25
END
cat >right.mtl <<'END'
newmtl right
Kd 1 1 1
map_Kd gone.ppm
norm dot.ppm
END
# face MATERIAL: a mesh of one quad with texture coordinates.
face()
{
    printf 'mtllib %s.mtl\no part of %s\nusemtl %s\n' "$1" "$1" "$1"
    printf 'v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n'
}
face left >left.obj
face right >right.obj
sed 's/^mtllib.*//; s/^usemtl.*//' left.obj >bare.obj
sed 's/gone/dot/' right.mtl >good.mtl
sed 's/right.mtl/good.mtl/' right.obj >good.obj

# ---- losses ----

# Red is 3, green 0.5 and blue 0, as float32.
printf 'PF\n1 1\n-1.0\n\000\000\100\100\000\000\000\077\000\000\000\000' >bright.pfm
bright='128 voxels have colours below 0 or above 1, which the grid'"'"'s 8 bits clamp; bake such colours from the chunk file (.tris)'
ok $vox bare.obj --texture bright.pfm -o bright.nvdb
grep -qxF "$p warning: bright.tris: $bright" "$err"
check "a grid tells how many colours it clamps" $?
$vox bare.obj --texture bright.pfm -o strict.nvdb --strict
code 65
grep -qxF "$p strict.tris: $bright" "$err"
check "clamped colours end a strict job" $?

# kept SCAN OPTION... with the lines that say it on standard input.
kept()
{
    ok $vox "$@" -o kept.nvdb
    grep -E '^(not )?kept: ' "$out" >lines
    cmp -s - lines
    check "kept of $*" $?
}
# warns LINES: of standard error.
warns()
{
    [ "$(cat "$err")" = "$1" ]
    check "warnings: $1" $?
}
lost='textures of materials are not kept'
kept left.obj <<'END'
kept: positions, texture coordinates, textures
not kept: roughness,metallic of the materials; --channels all keeps them
END
warns "$p warning: left.obj: $lost: roughness; --channels all keeps them, --channels none says that they are not needed"
kept good.obj --channels all <<'END'
kept: positions, texture coordinates, textures, normal_map
END
kept left.obj --channels all <<'END'
kept: positions, texture coordinates, textures, roughness,metallic
END
holds "nothing is lost" [ ! -s "$err" ]
kept left.obj --channels none --strict <<'END'
kept: positions, texture coordinates, textures
not kept: roughness,metallic of the materials; --channels all keeps them
END
kept left.obj --channels metallic --strict <<'END'
kept: positions, texture coordinates, textures, metallic
not kept: roughness of the materials; --channels all keeps them
END
kept bare.obj <<'END'
kept: positions
not kept: texture coordinates, because there is no texture; --texture FILE gives one
END
$vox left.obj -o x.nvdb --strict
refused_like 65 "^$p left.obj: $lost: roughness;"
ok run bisque-voxelize left.obj -o left.tris --json
json '.scan | .unkept_channels == ["roughness", "metallic"] and .kept_channels == [] and .uses_textures and
    (.unused_texcoords or .has_colors or .has_material_colors | not)'

# A grid has all channels of its chunk file, but for the normal map, which is in its normals.
ok $vox left.obj good.obj --channels all -o whole.nvdb --tris whole.tris
ok $vox whole.tris --channels all -o again.nvdb
same whole.nvdb again.nvdb
ok run bisque-voxelize --info whole.tris again.nvdb --json
json '.files | .[0].channels == ["roughness", "metallic", "normal_map"] and .[1].channels == ["roughness", "metallic"]'

# Without any texture of its materials, a scan has no colours: white would be a guess.
ok $vox right.obj -o right.nvdb --channels none --json
json '.grid.has_color | not'
ok $vox left.obj right.obj -o both.nvdb --channels none --json
json .grid.has_color

# ---- parts that are sorted alike ----

for part in left good; do
    ok run bisque-voxelize $part.obj --channels metallic,roughness,emission -o $part.tris
done
warns "$p warning: good.obj: no material has a value or a texture of metallic, so it is 0 everywhere
$p warning: good.obj: no material has a value or a texture of roughness, so it is 0 everywhere
$p warning: good.obj: no material has a value or a texture of emission, so it is 0 everywhere"
ok $vox left.tris good.tris --channels metallic -o joined.nvdb
$vox left.obj --channels coat -o x.nvdb
refused 65 "$p left.obj: materials have no channel coat: give its image, as coat=FILE"

# ---- textures inside of the chunk file ----

mkdir away
ok $vox left.obj --channels all -o outer.nvdb
needs='outer.tris needs its textures where they are now, such as '
grep -qF "$needs$(pwd -P)/dot.ppm; --embed-textures copies them into it" "$out"
check "a chunk file says what it needs" $?
ok $vox left.obj --channels all --embed-textures -o inner.nvdb
holds "nothing is needed" sh -c "! grep -q 'needs its textures' '$out'"
same outer.nvdb inner.nvdb
ok run bisque-voxelize left.obj --channels all --embed-textures -o alone.tris
same inner.tris alone.tris
cp -p dot.ppm away/dot.ppm
echo '# another image' >>dot.ppm
ok run bisque-voxelize left.obj --channels all --embed-textures -o alone.tris --json
json '.scan.outer_texture == null'
mv inner.tris away/moved.tris
rm dot.ppm
$vox outer.tris -o x.nvdb
refused 66 "$p outer.tris: its texture $(pwd -P)/dot.ppm is missing: put it there, or sort the scan with --embed-textures"
ok $vox away/moved.tris --channels all -o moved.nvdb
same outer.nvdb moved.nvdb
size=$(wc -c <away/dot.ppm)
mv away/dot.ppm .
ok run bisque-voxelize --verify away/moved.tris
ok run bisque-voxelize --info away/moved.tris --json
json ".files[0].textures == [\"away/moved.tris#bytes=176+$size\"]"
cp away/moved.tris broken.tris
printf X | dd of=broken.tris bs=1 seek=184 conv=notrunc status=none
run bisque-voxelize --verify broken.tris
refused 65 "$p broken.tris: damaged chunk file: the images' checksum does not match"
for file in away/moved.tris broken.tris; do
    oracle read_file $file
    grep -q "$(basename $file .tris | sed 's/moved/tris: ok/; s/broken/checksum of the images/')" "$out"
    check "another reader judges $file alike" $?
done
# Textures of tiles stay outside.
cp dot.ppm dot.1001.ppm
sed 's/dot.ppm/dot.<UDIM>.ppm/' left.mtl >tiles.mtl
sed 's/left.mtl/tiles.mtl/' left.obj >tiles.obj
ok run bisque-voxelize tiles.obj --embed-textures --channels none -o tiles.tris
grep -q '^tiles.tris needs its textures where they are now, such as .*/dot.<UDIM>.ppm$' "$out"
check "tiles stay outside" $?
$vox left.obj --embed-textures --no-tris -o x.nvdb
refused 64 "$p --embed-textures and --no-tris exclude each other"
rm -r away

# ---- descriptions ----

ok run bisque-voxelize --info left.obj right.obj
cat >expected <<'END'
left.obj
  format: OBJ
  bytes: 140
  box: min 0, 0, 0, max 2, 1, 0, size 2, 1, 0
  vertices: 4
  faces: 1
  triangles: 2
  normals: no
  texture coordinates: yes
  vertex colors: no
  faces without material: 0
  objects: part of left
  materials:
    name left, faces 1, color (texture dot.ppm, found yes), roughness (texture dot.ppm, found yes), metallic 0.25
  channels: roughness, metallic
  kept: positions, colour textures
right.obj
END
sed -n '1,/^right/p' "$out" | sed 's/bytes: .*/bytes: 140/' | cmp -s - expected
check "the description of a mesh" $?
grep -q 'color (texture gone.ppm, found no), normal_map (texture dot.ppm, found yes)' "$out" && tail -1 "$out" | grep -qx '  kept: positions'
check "a texture that is missing" $?
printf 'ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red
property uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header
0 0 0 1 2 3\n1 0 0 1 2 3\n0 4 0 1 2 3\n3 0 1 2\n' >color.ply
ok run bisque-voxelize --info color.ply left.tris kept.nvdb --json
json '.files[0] | .format == "PLY" and .vertex_colors and .box.size == [1, 4, 0] and .units == null and .materials == []'
json '.files[1] | .version == 7 and .made_normals == "area" and .triangles == 2 and .color and (.textures | length == 1) and (.textures[0] | endswith("/dot.ppm"))'
json '.files[2] | .voxels > 0 and .box.max == [2, 1, 0] and (.color | not)'
run bisque-voxelize --info left.obj gone.obj
code 66
warns "$p gone.obj: No such file or directory"
run bisque-voxelize --info left.obj -o x.nvdb
refused 64 "$p --info only describes files: leave out --output"
printf ' BDV' >grid.vdb
printf '\0\0\0\0' >>grid.vdb
run bisque-voxelize --info grid.vdb
refused 65 "$p grid.vdb: an OpenVDB file, which Bisque does not read"
finish

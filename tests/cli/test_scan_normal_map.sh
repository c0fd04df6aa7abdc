#!/bin/sh
# test_scan_normal_map.sh - tangent-space normal maps of scans: values by formula in maps from grids
# and triangles, from an image and from materials, tasks, and what is refused.
. "$(dirname "$0")/lib.sh"
. "$top/tests/cli/texture_lib.sh"
vox="run bisque-voxelize --resolution 160" bake="run bisque-bake --size 48 --maps normal --normal space=object"

awk '$1 == "vt" { $2 = 1 - $2 } { print }' plane.obj >left_plane.obj
printf 'newmtl left\nnorm tilt.png\nnewmtl right\nPr 1\n' >two.mtl

# ---- images ----

for scan in plane left_plane; do
    ok $vox $scan.obj --scan-normal-map tilt.png -o $scan.nvdb
    holds "no message about the normal map of $scan" [ ! -s "$err" ]
    for surface in nvdb tris; do
        ok $bake $scan.$surface low.obj -o n_${scan}_$surface.png
    done
done
values n_plane_tris.png tilted 0.00003
values n_plane_nvdb.png tilted 0.0002
values n_left_plane_tris.png tilted_left 0.00003
values n_left_plane_nvdb.png tilted_left 0.0002
# Heights stay: planes lean, but not by much of a voxel.
ok $bake plane.nvdb low.obj --maps height -o h.png --json
json '.encodings.height.range < 0.1 / 160'

# An image that is given later does the same.
ok $vox plane.obj --channels coat=three.png --tris later.tris -o plain.nvdb
ok $bake later.tris low.obj --scan-normal-map tilt.png -o n_later.png
holds "bisque-bake adds the image alike" cmp -s n_later.png n_plane_tris.png
ok $vox later.tris --scan-normal-map tilt.png -o later.nvdb
holds "bisque-voxelize adds the image to a chunk file alike" cmp -s later.nvdb plane.nvdb
ok $vox later.tris --channels coat -o without.nvdb
holds "without the image there is none" cmp -s without.nvdb plain.nvdb

# ---- parts ----

in_parts 2 $bake later.tris low.obj --scan-normal-map tilt.png -o n_tasks.png
holds "parts give the bytes of normals with the scan's map" cmp -s n_plane_tris.png n_tasks.png

# ---- materials ----

ok $vox two.obj --channels normal_map -o two.nvdb --threads 1
ok $vox two.tris -o two_again.nvdb --threads 2
holds "a chunk file keeps its normal map" cmp -s two.nvdb two_again.nvdb
for surface in nvdb tris; do
    ok $bake two.$surface low.obj -o two_$surface.png
    values two_$surface.png half_tilted 0.0002
done
# Chunk files that are one scan: those of the left side have the map.
for side in left right; do
    awk -v side=$side '/^usemtl/ { keep = $2 == side } !/^f/ || keep { print }' two.obj >$side.obj
    channel=normal_map
    [ $side = left ] || channel=roughness
    ok run bisque-voxelize $side.obj --channels $channel -o $side.tris
done
ok $vox left.tris right.tris -o parts.nvdb
ok $bake parts.nvdb low.obj -o parts.png
values parts.png half_tilted 0.0002

# The same in a glTF file, whose base colour moves texture coordinates.
$maps gltf two.obj || exit 1
jq '.images += [{"uri": "tilt.png"}] | .textures += [{"source": 3}] |
    .materials[0].normalTexture = (.materials[0].occlusionTexture | .index = 3)' two.gltf >map.gltf
ok $vox map.gltf --channels normal_map -o map.nvdb
holds "no warning about the normal map of a glTF file" [ ! -s "$err" ]
ok $bake map.tris low.obj -o map.png
values map.png half_tilted 0.00003
ok $vox two.obj -o none.nvdb
ok $bake none.tris low.obj -o none.png
values none.png flat 0.00003

# ---- what is refused ----

$bake plain.nvdb low.obj --scan-normal-map tilt.png -o x.png
refused_like 64 'plain.nvdb: a grid has no texture coordinates for the normal map tilt.png; bake from the chunk file'
ok $vox bare.obj -o bare.nvdb
$bake bare.tris low.obj --scan-normal-map tilt.png -o x.png
refused_like 65 'bare.tris has no texture coordinates for the normal map tilt.png'
$vox bare.tris --scan-normal-map tilt.png -o x.nvdb
refused_like 65 'bare.tris has no texture coordinates for the normal map tilt.png'
$bake later.tris low.obj --scan-normal-map missing.png -o x.png
refused_like 66 'missing.png'
$vox later.tris --scan-normal-map missing.png -o x.nvdb
refused_like 66 'missing.png'
$bake later.tris low.obj --scan-normal-map tilt.png -o tilt.png
refused_like 64 'tilt.png'
$bake later.tris plain.nvdb low.obj --scan-normal-map tilt.png -o x.png
refused_like 64 'tilt.png is the normal map of one scan, but there are 2 scans'
$bake two.tris low.obj --maps transfer:normal_map -o x.png
refused_like 64 'normal_map: directions in tangent space cannot be transferred'
$vox two.tris --channels normal_map -o x.nvdb
refused_like 64 'two.tris is already a chunk file: leave out the channel normal_map'
$vox two.obj --channels normal_map --scan-normal-map tilt.png -o x.nvdb
refused_like 64 '--scan-normal-map and --channels normal_map exclude each other'

[ ! -e x.png ] && [ ! -e x.nvdb ]
check "nothing was written" $?
finish

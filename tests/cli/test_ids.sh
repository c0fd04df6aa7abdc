#!/bin/sh
# test_ids.sh - maps of ids: from triangles, grids, several scans, tasks and all devices; never
# blended, with a table of names.
. "$(dirname "$0")/lib.sh"
need_oracle
vox="run bisque-voxelize" bake="run bisque-bake --size 32 --samples 3"
ids="python3 -B $top/tests/cli/ids.py"

# sheet FROM TO Z: columns FROM to TO of a wavy sheet of 40 x 40 quads at height Z, with three
# materials, two objects, and vertices in three colours.
sheet()
{
    awk -v from="$1" -v to="$2" -v z="$3" 'BEGIN {
        n = 40
        print "mtllib sheet.mtl"
        for (j = 0; j <= n; j++)
            for (i = from; i <= to; i++)
                printf "v %.6f %.6f %.6f %s\n", i / n, j / n, z + 0.02 * sin(i / 6) * sin(j / 8),
                    i < 14 ? "1 0 0" : j < 20 ? "0 1 0" : "0 0 1"
        w = to - from + 1
        for (j = 0; j < n; j++)
            for (i = from; i < to; i++) {
                print "usemtl " (i < 13 ? "stone" : (i + j) % 7 && j < 20 ? "brick wall" : "gl\303\244s")
                print (j % 2 ? "o " : "g ") (i < 20 ? "left" : "right")
                a = j * w + i - from + 1
                print "f", a, a + 1, a + w + 1, a + w
            }
    }'
}
sheet 0 40 0 >sheet.obj
sheet 0 13 0 >left.obj
sheet 13 40 0 >right.obj
sheet 0 40 -0.25 | sed 's/^usemtl.*/usemtl floor/' >below.obj
printf 'newmtl stone\nKd .5 .5 .5\nnewmtl brick wall\nKd .8 .2 .1\n' >sheet.mtl
write_square 0 0 1 0 >low.obj

# few_differ A B PERCENT: at most this percentage of texels differ.
few_differ()
{
    $ids differ "$1" "$2" | awk -v most="$3" '{ exit !($1 <= most) }'
    check "at most $3 % of $1 and $2 differ" $?
}

# ---- names and colours ----

for kind in material object color; do
    ok $vox sheet.obj -o $kind.nvdb --resolution 80 --channels id --id $kind --json
    json '.grid.has_ids'
    ok $vox --verify $kind.tris $kind.nvdb
    ok oracle read_file $kind.tris $kind.nvdb
    for scan in tris nvdb; do
        ok $bake $kind.$scan low.obj -o ${kind}_$scan.png --maps id --json
        json ".ids.source == \"$kind\""
        cp "$out" ${kind}_$scan.json
    done
done
json '.ids.names == []'
few_differ material_tris.png material_nvdb.png 3
$ids name stone 'brick wall' 'gläs' left right floor >all
{
    sed -n 1,3p all | sort | paste -sd ' '
    sed -n 4,5p all | sort | paste -sd ' '
    echo '#0000ff #00ff00 #ff0000'
} >expected
for scan in tris nvdb; do
    $ids colors material_$scan.png object_$scan.png color_$scan.png >"$out"
    holds "maps of $scan have the expected ids and no other colour" cmp -s expected "$out"
    for kind in material object; do
        jq -r '.ids.names[] | select(.name != "").color' ${kind}_$scan.json | sort | paste -sd ' '
    done >"$out"
    head -n 2 expected | cmp -s - "$out"
    check "the reports of $scan name them" $?
done

# ---- several scans ----

# Beside each other, grids and triangles mixed; below, a third one that no ray should reach.
for scan in left right below; do
    ok $vox $scan.obj -o $scan.nvdb --voxel-size 0.0125 --channels id
done
rays="--front 0.5 --back 0.5"
ok $bake left.tris right.tris below.tris low.obj $rays -o several.png --maps id --json
json '[.ids.names[].name] == ["", "brick wall", "floor", "gläs", "stone"]'
few_differ several.png material_tris.png 0
ok $bake left.nvdb right.tris below.nvdb low.obj $rays -o several.png --maps id
few_differ several.png material_tris.png 3
ok $bake below.nvdb left.nvdb right.tris low.obj $rays -o order.png --maps id
same several.png order.png
$bake left.nvdb object.nvdb low.obj -o x.png --maps id
refused 65 "bisque-bake: left.nvdb has ids by material, object.nvdb by object: make both with one --id"
ok $vox left.tris right.tris -o parts.nvdb --resolution 80 --channels id
ok $bake parts.nvdb low.obj -o parts.png --maps id
few_differ parts.png material_nvdb.png 0.5
$vox right.tris object.tris -o x.nvdb --channels id
refused 65 "bisque-voxelize: object.tris has ids by object, right.tris by material: make both with one --id"

# ---- parts ----

for scan in tris nvdb; do
    in_parts 2 $bake material.$scan low.obj -o 'tasks_<MAP>.png' --maps id,normal --json
    json '[.ids.names[].name] == ["", "brick wall", "gläs", "stone"]'
    same tasks_id.png material_$scan.png
    rm tasks*
done

# ---- devices, threads, budgets ----

for device in $("$BIN/bisque-bake" --list devices --json | jq -r '.devices[].id' | grep opencl: | head -n 1); do
    ok $bake material.nvdb low.obj -o other.png --maps id --device "$device"
    same material_nvdb.png other.png
done
# On a device with memory of its own, ids follow the colours.
if [ -s "$(ls "$BIN"/../gen/kernel-*.ptx 2>/dev/null | head -n 1)" ]; then
    bake="run bisque-bake --size 16 --samples 2 --maps id,color material.nvdb low.obj"
    ok $bake -o 'cpu_<MAP>.png'
    LD_LIBRARY_PATH=$TESTS/fake ok $bake -o 'cuda_<MAP>.png' --device cuda
    same cpu_id.png cuda_id.png
    same cpu_color.png cuda_color.png
fi
ok $vox sheet.obj -o again.nvdb --resolution 80 --channels id --threads 3 --memory 80M
same material.tris again.tris
same material.nvdb again.nvdb
ok $vox material.tris -o other.nvdb --resolution 80
ok $vox sheet.obj -o plain.nvdb --resolution 80
same other.nvdb plain.nvdb

# ---- what has no ids ----

bake="run bisque-bake"
for scan in nvdb tris; do
    $bake plain.$scan low.obj -o x.png --maps id
    refused 65 "bisque-bake: plain.$scan has no ids for the map id: make it with bisque-voxelize --channels id"
done
$bake left.nvdb plain.tris low.obj -o x.png --maps id
refused 65 "bisque-bake: plain.tris has no ids for the map id: make it with bisque-voxelize --channels id"
$vox plain.tris -o x.nvdb --channels id
refused 65 "bisque-voxelize: plain.tris has no ids: make it with bisque-voxelize --channels id"
$vox left.tris plain.tris -o x.nvdb --channels id
refused 65 "bisque-voxelize: plain.tris has no ids: make it with bisque-voxelize --channels id"
sed '/^v /s/ [^ ]* [^ ]* [^ ]*$//' sheet.obj >grey.obj
$vox grey.obj -o x.nvdb --channels id --id color
refused 65 "bisque-voxelize: grey.obj: no vertex colours: ids need materials or objects"
$vox sheet.obj -o x.nvdb --id object
refused 64 "bisque-voxelize: --id needs --channels id"
$vox material.tris -o x.nvdb --channels id --id object
refused 64 "bisque-voxelize: material.tris is already a chunk file: leave out --id"
$vox sheet.obj -o x.nvdb --channels id,Gloss
refused 64 'bisque-voxelize: --channels: "Gloss" is not a channel'
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n' >bare.obj
ok $vox bare.obj -o bare.nvdb --resolution 8 --channels id --id object
grep -q '^bisque-voxelize: warning: bare.obj: no faces with objects or groups: all have the same id$' "$err"
check "a warning says that there are no objects" $?
finish

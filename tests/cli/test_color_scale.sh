#!/bin/sh
# test_color_scale.sh - colours of vertices from 0 to 1 or to 255, which the first ones do not tell.
. "$(dirname "$0")/lib.sh"
vox="run bisque-voxelize --voxel-size 4 --no-tris"

# expect NAME ARGUMENT...: the scan has the voxels of bytes.ply.
expect()
{
    name=$1
    shift
    ok $vox "$@" -o "$name.nvdb"
    same bytes.nvdb "$name.nvdb"
    rm -f "$name.nvdb"
}

for kind in late_bytes late_units; do
    python3 "$top/tests/cli/color_scale.py" $kind .
    ok $vox bytes.ply -o bytes.nvdb
    expect obj scan.obj
    expect text text.ply
    expect binary binary.ply
    gzip -1 -c scan.obj >scan.obj.gz
    expect packed scan.obj.gz --threads 3
    gzip -1 -c binary.ply >packed.ply
    expect packed packed.ply --threads 1 --memory 52MiB
    command="bisque-voxelize - <scan.obj" code=0
    "$BIN/bisque-voxelize" - --voxel-size 4 --no-tris -o piped.nvdb <scan.obj >"$out" 2>"$err" || code=$?
    code 0
    same bytes.nvdb piped.nvdb
done
# Nothing but the values that are too large is warned of, once.
$vox text.ply -o text.nvdb
holds "one warning" [ "$(cat "$err")" = "bisque-voxelize: warning: text.ply: colours out of range were clamped at 1 vertex" ]

# Black has any scale, and white is 1 if nothing is above.
for white in 1 255; do
    awk -v w=$white 'BEGIN { for (i = 0; i < 9; i++) { c = i < 6 ? 0 : w
        print "v", i % 3, int(i / 3), 0, c, c, c }
        print "f 1 2 5 4\nf 2 3 6 5\nf 4 5 8 7\nf 5 6 9 8" }' >white.$white.obj
    ok run bisque-voxelize --voxel-size 0.5 --no-tris white.$white.obj -o white.$white.nvdb
done
same white.1.nvdb white.255.nvdb
# 16 is still a bright spot of colours to 1 if one has a fraction; anything above, or whole numbers alone, show that they
# range to 255.
for most in 16 16.5; do
    printf 'v 0 0 0 0 0 0\nv 1 0 0 %s 1 0\nv 0 1 0 1 1 1\nv 9 9 9 0.5 0 0\nf 1 2 3\n' $most >most.$most.obj
    ok $vox most.$most.obj -o most.nvdb
    mv most.nvdb most.$most.nvdb
done
printf 'v 0 0 0 0 0 0\nv 1 0 0 1 1 0\nv 0 1 0 1 1 1\nf 1 2 3\n' >unit.obj
printf 'v 0 0 0 0 0 0\nv 1 0 0 17 1 0\nv 0 1 0 1 1 1\nf 1 2 3\n' >byte.obj
ok $vox unit.obj -o unit.nvdb
ok $vox byte.obj -o byte.nvdb
same unit.nvdb most.16.nvdb
printf 'v 0 0 0 0 3 16\nv 1 0 0 1 2 15\nv 0 1 0 2 1 14\nf 1 2 3\n' >dark.obj
printf 'ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red
property uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header
0 0 0 0 3 16\n1 0 0 1 2 15\n0 1 0 2 1 14\n3 0 1 2\n' >dark.ply
ok $vox dark.obj -o dark.nvdb
holds "no warning of dark bytes" [ ! -s "$err" ]
ok $vox dark.ply -o dark_bytes.nvdb
same dark_bytes.nvdb dark.nvdb
same byte.nvdb most.16.5.nvdb

# Each file has the scale of its own colours, in any order. Faces lie apart, so that the grids of all
# orders have the same voxels.
face()
{
    printf 'v %s 0 0 %s\nv %s 1 0 %s\nv %s 0 1 %s\nf -3 -2 -1\n' "$1" "$2" "$1" "$2" "$1" "$2"
}
face 0 '0.5 0.25 1' >unit.obj
face 2 '127.5 255 64' >byte.obj
face 4 '1 0 1' >pure.obj
face 2 '0.5 1 0.250980392' >byte_as_unit.obj
face 4 '255 0 255' >pure_as_byte.obj
# apart NAME FILE...: a grid of these files with no warning.
apart()
{
    name=$1
    shift
    ok run bisque-voxelize --voxel-size 0.5 --no-tris "$@" -o "$name.nvdb"
    holds "no warning: $command" [ ! -s "$err" ]
}
apart right unit.obj byte_as_unit.obj pure.obj
apart a unit.obj byte.obj pure.obj
same right.nvdb a.nvdb
apart a pure.obj unit.obj byte.obj
apart b pure.obj unit.obj byte_as_unit.obj
same b.nvdb a.nvdb
apart a pure.obj byte.obj unit.obj
apart b pure.obj byte_as_unit.obj unit.obj
same b.nvdb a.nvdb
apart a byte.obj unit.obj
apart b byte_as_unit.obj unit.obj
same b.nvdb a.nvdb
apart b pure.obj
apart a pure_as_byte.obj
same b.nvdb a.nvdb
finish

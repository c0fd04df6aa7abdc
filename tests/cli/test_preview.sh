#!/bin/sh
# test_preview.sh - all columns show both sides of a scan, and below each row stands the difference.
. "$(dirname "$0")/lib.sh"
unsanitized "what a preview shows" "test_bake.sh makes previews under sanitizers"
PYTHONPATH=$top/tests/cli
export PYTHONPATH

# An open square that faces z, and in another scan a triangle before it, which the map lacks.
{
    printf 'v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n'
    printf 'f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n'
} >low.obj
ok run bisque-voxelize low.obj --resolution 64 -o scan.nvdb
cat low.obj - >more.obj <<EOF
v -0.3 -0.3 0.4
v 0.3 -0.3 0.4
v 0 0.3 0.1
f 5 6 7
EOF
ok run bisque-voxelize more.obj -o more.tris
bake="run bisque-bake --size 32 --maps normal -o normal.png --preview look.png"

# Prints the middles of the panels of a view, and whether something stands below it.
looks='
import png
width, height, most, rows = png.read("look.png")
side = (width - 8) // 3
line = rows[side:side + 24]
print(*(rows[side // 2][side // 2 + k * (side + 4)][0] for k in range(3)), sum(max(p) > 99 for row in line for p in row) > 99)'
shows()
{
    python3 -c "$looks" | awk '{ exit !($1 > 120 && $2 - $1 < 4 && $1 - $2 < 4 && $3 - $1 < 4 && $1 - $3 < 4 && $4 == "True") }'
}
for scan in scan.tris scan.nvdb; do
    for from in 0 180; do
        ok $bake $scan low.obj --view count=2,above=0,from=$from
        holds "$scan is seen from $from degrees in all columns" shows
    done
done

# The number of pixels that are lit in the line tells one number from another.
number='
import png
width, height, most, rows = png.read("look.png")
side = (width - 8) // 3
print(sum(row[x][0] > 99 for row in rows[side:side + 24] for x in range(width)))'
ok $bake scan.tris low.obj --view count=2,above=0,from=0
python3 -c "$number" >same
ok $bake more.tris low.obj --front 0.1 --back 0.1 --view count=2,above=30,from=30
python3 -c "$number" >other
holds "another difference is another line" [ "$(cat same)" != "$(cat other)" ]
finish

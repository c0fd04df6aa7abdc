#!/bin/sh
# test_interrupt.sh - SIGTERM ends the programs on inputs that are made to be slow: a scan with very
# many materials, one polygon with very many corners, and low-poly triangles that all cover the
# whole map. Each is interrupted at several moments, which fall into all stages.
. "$(dirname "$0")/lib.sh"

# A star-shaped polygon with texture coordinates, and random radii.
write_polygon()
{
    awk -v n="$1" 'BEGIN {
        srand(1)
        for (i = 0; i < n; i++) {
            angle = i * 2 * 3.14159265358979 / n
            radius = 0.1 + 0.4 * rand()
            x = radius * cos(angle); y = radius * sin(angle)
            printf "v %.9g %.9g 0\nvt %.9g %.9g\n", x, y, x + 0.5, y + 0.5
        }
        printf "f"
        for (i = 1; i <= n; i++)
            printf " %d/%d", i, i
        print ""
    }'
}

# write_materials COUNT: materials.obj uses each material of materials.mtl once.
write_materials()
{
    awk -v n="$1" 'BEGIN {
        for (i = n; i > 0; i--)
            printf "newmtl m%d\nKd 0.5 0.5 0.5\n", i
    }' >materials.mtl
    awk -v n="$1" 'BEGIN {
        print "mtllib materials.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0"
        for (i = 1; i <= n; i++)
            printf "usemtl m%d\nf 1 2 %d\n", i, 3 + i % 2
    }' >materials.obj
}

# write_covering COUNT: triangles, of which each two cover the whole map.
write_covering()
{
    awk -v n="$1" 'BEGIN {
        print "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1"
        for (i = 0; i < n; i++)
            print i % 2 ? "f 1/1 2/2 3/3" : "f 1/1 3/3 4/4"
    }'
}

# stops NAME PROGRAM ARGUMENT...: interrupts the program at several moments, $most (4) at most. It
# must end with 75 and leave nothing, unless it was done before (0), or had not yet started (143).
# 20 seconds are far more than it may take to answer; then it is killed (137).
stops()
{
    name=$1 answered=0 command=$* code=0 before=$(ls -A)
    shift
    program=$1
    shift
    for moment in 0.1 0.2 0.4 0.7 1 1.5 2 4 8; do
        code=0
        env --default-signal=TERM timeout --preserve-status --kill-after=20 "$moment" \
            "$BIN/$program" "$@" >"$out" 2>"$err" || code=$?
        [ "$code" -ne 143 ] || continue
        [ "$code" -eq 75 ] || break
        [ "$(tail -n 1 "$err")" = "$program: interrupted" ] && [ "$(ls -A)" = "$before" ] || break
        answered=$((answered + 1))
        [ "$answered" -lt "${most:-4}" ] || break
    done
    [ "$answered" -gt 0 ] && { [ "$code" -eq 0 ] || { [ "$code" -eq 75 ] && [ "$answered" -eq "${most:-4}" ]; }; }
    check "$name: $answered interruptions are answered" $?
    rm -f slow*
}

if sanitized; then size=20000; else size=200000; fi
write_polygon $size >polygon.obj
write_materials $size
write_covering $size >covering.obj
write_box >box.obj
ok run bisque-voxelize box.obj -o box.nvdb --resolution 64

stops "one polygon as a scan" bisque-voxelize polygon.obj -o slow.nvdb --resolution 1024 --no-tris
stops "one polygon in little memory" bisque-voxelize polygon.obj -o slow.nvdb --resolution 1024 --no-tris \
    --threads 1 --memory 80M
# The coarse grid takes no time, so the moments fall into reading and writing the materials.
most=9
stops "many materials" bisque-voxelize materials.obj -o slow.nvdb --resolution 4 --no-tris
unset most
stops "one polygon as the low-poly mesh" bisque-bake box.nvdb polygon.obj -o 'slow_<MAP>.exr' \
    --device cpu --size 2048
for surface in nvdb tris; do
    stops "triangles over the whole map, .$surface" bisque-bake box.$surface covering.obj --as-is \
        -o 'slow_<MAP>.exr' --device cpu --size 1024 --samples 8 --memory 1G
done
finish

#!/bin/sh
# test_interrupt.sh - signals end the programs in all stages, also on inputs that are made to be slow: a
# scan with very many materials, one polygon with very many corners, very many triangles around one
# vertex, and low-poly triangles that all cover the whole map. The programs of $TESTS/bin get a
# signal when they look for an interruption for the N-th time, so the moments are the same on any
# machine. With LONG=1, they get signals at moments by the clock, in larger inputs, and must end
# within two seconds.
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
            print i % 2 ? "f 3/3 2/2 1/1" : "f 4/4 3/3 1/1"
    }'
}

# write_fan COUNT: triangles around one vertex on the border of the mesh.
write_fan()
{
    awk -v n="$1" 'BEGIN {
        print "v 0 0 1"
        for (i = 0; i <= n; i++)
            print "v", cos(6 * i / n), sin(6 * i / n), 0
        for (i = 0; i < n; i++)
            print "f 1", i + 2, i + 3
    }'
}

# write_list COUNT: list.ply has a face with a list of that many numbers that are not read.
write_list()
{
    xyz='property float x\nproperty float y\nproperty float z'
    list='property list int int vertex_indices\nproperty list int float quality'
    printf "ply\nformat ascii 1.0\nelement vertex 3\n$xyz\nelement face 1\n$list\nend_header\n" >list.ply
    printf '0 0 0\n1 0 0\n0 1 0\n' >>list.ply
    awk -v n="$1" 'BEGIN { printf "3 0 1 2 %d", n; for (i = 0; i < n; i++) printf " 1"; print "" }' >>list.ply
}

# write_comments COUNT: comments.obj has vertices in lines whose comments end in a backslash.
write_comments()
{
    awk -v n="$1" 'BEGIN {
        for (i = 0; i < n; i++)
            print "v " i % 7 " " i % 11 " 0 # \\"
        print "\nf 1 2 3"
    }' >comments.obj
}

signals="TERM INT HUP TERM INT HUP TERM" last=7
sanitized && signals="TERM INT HUP" last=3

# stops NAME LEAST PROGRAM ARGUMENT...: counts how often the program looks for an interruption, at
# least LEAST times; then signals end it at some of these looks, evenly spread. It leaves nothing.
stops()
{
    name=$1 least=$2 moment=0
    shift 2
    at_look 0 '' '' "$@"
    code 0
    rm -f slow*
    all=$looks before=$(ls -A)
    holds "$name: it looks for an interruption $all times, at least $least" [ "$all" -ge "$least" ]
    for signal in $signals; do
        at_look $((1 + moment * (all - 1) / last)) $signal '' "$@"
        stopped
        holds "$name: nothing is left" [ "$(ls -A)" = "$before" ]
        moment=$((moment + 1))
    done
}

# ends NAME SECONDS PROGRAM ARGUMENT...: each signal ends the program within two seconds, at moments
# of the first SECONDS, or it was done before. A signal that comes before it has begun ends it, too.
ends()
{
    name=$1 last=$2 before=$(ls -A)
    shift 2
    for signal in TERM INT HUP; do
        for tenth in 0 2 8; do
            command="$*, SIG$signal" code=0
            env --default-signal=TERM,INT,HUP "$BIN/$@" >"$out" 2>"$err" &
            sleep "$(awk "BEGIN { print 0.05 + $tenth * $last / 10 }")"
            sent=$(date +%s%N)
            kill -$signal $! 2>/dev/null
            wait $! || code=$?
            late=$((($(date +%s%N) - sent) / 1000000))
            [ "$late" -lt 2000 ] && { [ "$code" -eq 0 ] || [ "$code" -gt 128 ] || [ "$code" -eq 75 ]; }
            check "$name: it ends $late ms after SIG$signal, with $code" $?
            rm -f slow*
            holds "$name: nothing is left" [ "$(ls -A)" = "$before" ]
        done
    done
}

write_box >box.obj
ok run bisque-voxelize box.obj -o box.nvdb --resolution 64
if [ -z "${LONG-}" ]; then size=20000 side=128 try=stops; else size=200000 side=1024 try=ends; fi
"$TESTS/generate-scan" --triangles $((2 * size)) vase -o vase.obj
"$TESTS/generate-scan" vase-low -o low.obj
ok run bisque-voxelize vase.obj -o vase.nvdb --resolution 128
for map in a b; do
    ok run bisque-bake vase.nvdb low.obj --device cpu --size 512 --samples 1 --maps normal -o $map.exr
done

# of LOOKS: the argument after the name: LOOKS, or the seconds in which signals come.
of() { if [ $try = stops ]; then echo "$1"; else echo 8; fi; }
write_polygon $size >polygon.obj
write_materials $size
write_covering $((size / 5)) >covering.obj
write_fan $((size / 10)) >fan.obj
write_list $((50 * size))
write_comments $((50 * size))

# Every loop looks at least once for 64 corners or materials, or for a triangle that covers the map.
$try "one polygon as a scan" $(of $((size / 64))) bisque-voxelize polygon.obj -o slow.nvdb --resolution 1024 --no-tris
$try "one polygon in little memory" $(of $((size / 64))) bisque-voxelize polygon.obj -o slow.nvdb --resolution 1024 \
    --no-tris --threads 1 --memory 80M
$try "many materials" $(of $((size / 64))) bisque-voxelize materials.obj -o slow.nvdb --resolution 4 --no-tris
$try "several chunk files" $(of 8) bisque-voxelize vase.tris vase.tris vase.tris -o slow.nvdb --resolution 16
$try "one polygon as the low-poly mesh" $(of $((size / 64))) bisque-bake box.nvdb polygon.obj -o 'slow_<MAP>.exr' \
    --device cpu --size $((2 * side)) --front 4 --back 4 --two-sided --samples 1
for surface in nvdb tris; do
    $try "triangles over the whole map, .$surface" $(of $((size / 5))) bisque-bake box.$surface covering.obj --as-is \
        -o 'slow_<MAP>.exr' --device cpu --size $side --samples 8 --memory 1G
done
# Readers look for it within a list of a text, and within a part that cannot be cut.
$try "a long list" $(of 20) bisque-voxelize --parse-only list.ply
$try "a long part" $(of 20) bisque-voxelize --parse-only comments.obj
# A plain job of each program.
$try "a scan" $(of 64) bisque-voxelize vase.obj -o slow.nvdb --no-tris --resolution 256
$try "a bake" $(of 100) bisque-bake vase.nvdb low.obj -o 'slow_<MAP>.exr' --maps normal,ao --rays ao=8 --size $side --device cpu
$try "an exact bake" $(of 100) bisque-bake vase.tris low.obj -o 'slow_<MAP>.png' --maps normal,ao --rays ao=8 --size $side
$try "simplifying" $(of 100) bisque-simplify vase.tris -o slow.obj --triangles $((size / 5))
$try "simplifying a fan" $(of $((size / 10))) bisque-simplify fan.obj -o slow.obj --triangles $((size / 40))
# Blocks of a fan are near all of its triangles: it looks for each of them.
write_fan 500 >fan.obj
at_look 0 '' measuring bisque-simplify fan.obj -o slow.obj --triangles 500
holds "measuring a fan of 500, it looks for an interruption $looks times" [ "$looks" -ge 3000 ]
rm slow.obj
$try "comparing" $(of 4) bisque-compare a.exr b.exr --heatmap slow.png
finish

#!/bin/sh
# test_no_sockets.sh - the programs open no socket: they run under a filter that kills them if they,
# or a process that they start, make a system call about sockets (tests/faults/no-sockets.c).
. "$(dirname "$0")/lib.sh"
filter=$TESTS/no-sockets

unsanitized "no program opens a socket" "sanitizers make system calls of their own"

# ---- the filter ----

command="opening a socket without the filter" code=0
"$filter" --open >"$out" 2>"$err" || code=$?
code 0
command="opening a socket under the filter" code=0
("$filter" "$filter" --open >"$out" 2>"$err") 2>/dev/null || code=$?
if [ "$code" -eq 77 ]; then
    skip "no program opens a socket" "the system has no seccomp filters"
    finish
    exit
fi
code 159
command="a child that opens a socket" code=0
("$filter" /bin/sh -c '"$0" --open' "$filter" >"$out" 2>"$err") 2>/dev/null || code=$?
code 159

# ---- all programs and modes ----

# offline PROGRAM ARGUMENT...: it succeeds under the filter. A process that it started was not
# killed either, which would be a warning.
offline()
{
    command="$* (no sockets)" code=0
    program=$1
    shift
    "$filter" "$BIN/$program" "$@" >"$out" 2>"$err" || code=$?
    code 0
    ! grep -q 'cannot be used\|is not used\|Bad system call' "$err"
    check "no part of it is left out: $command" $?
}

awk 'BEGIN { print "P3 64 64 255"
     for (y = 0; y < 64; y++) for (x = 0; x < 64; x++) print 4 * x, 4 * y, 128 }' >ramp.ppm
printf 'newmtl glaze\nmap_Kd ramp.ppm\n' >scan.mtl
"$TESTS/generate-scan" -n 3000 --uvs vase -o plain.obj
{
    printf 'mtllib scan.mtl\nusemtl glaze\n'
    cat plain.obj
} >scan.obj
"$TESTS/generate-scan" vase-low -o low.obj

offline bisque-voxelize scan.obj -o scan.nvdb --resolution 32 --vdb scan.vdb
offline bisque-voxelize scan.tris -o scan.nvdb --resolution 32 --json
offline bisque-voxelize --parse-only scan.obj
offline bisque-voxelize --verify scan.tris scan.nvdb
# A name that looks like an address is a file.
mkdir -p http:/127.0.0.1:9
cp ramp.ppm http:/127.0.0.1:9/ramp.ppm
offline bisque-voxelize plain.obj --texture http://127.0.0.1:9/ramp.ppm --no-tris -o a.nvdb --resolution 32
printf 'newmtl glaze\nmap_Kd http://127.0.0.1:9/ramp.ppm\n' >scan.mtl
offline bisque-voxelize scan.obj -o a.nvdb --resolution 32
offline bisque-bake a.tris low.obj --size 32 --samples 1 -o 'a_<MAP>.png'
rm -r http:
printf 'newmtl glaze\nmap_Kd http://127.0.0.1:9/ramp.ppm\n' >scan.mtl
offline bisque-voxelize scan.obj -o a.nvdb --no-tris --resolution 32

maps="low.obj --size 32 --samples 1"
offline bisque-bake scan.nvdb $maps --device cpu --preview a.png -o 'a_<MAP>.exr'
offline bisque-bake scan.tris $maps -o 'b_<MAP>.exr'
offline bisque-bake scan.nvdb $maps --device cpu --maps normal,color,mask --type 8 -o 'a_<MAP>.png'
offline bisque-voxelize --verify scan.tris scan.nvdb
offline bisque-compare a_normal.exr b_normal.exr --heatmap heat.png
offline bisque-compare --version

# ---- drivers ----

run bisque-bake --list devices
if grep -q '^opencl:0 ' "$out"; then
    offline bisque-bake --list devices
    offline bisque-bake scan.nvdb $maps --device opencl -o 'a_<MAP>.exr'
else
    lacks "OpenCL opens no socket" "no OpenCL device"
fi
if [ -s "$(ls "$BIN"/../gen/kernel-*.ptx 2>/dev/null | head -n 1)" ]; then
    export LD_LIBRARY_PATH="$TESTS/fake"
    offline bisque-bake scan.nvdb $maps --device cuda -o 'a_<MAP>.exr'
else
    lacks "CUDA opens no socket" "no PTX"
fi

finish

#!/bin/sh
# test_go_on.sh - what an interrupted job leaves, and what its message says about going on from there.
. "$(dirname "$0")/lib.sh"

p=bisque-voxelize:
unsanitized "interruptions at system calls" "sanitizers have to be loaded before faults.so"

# stop_at CALLS NUMBER ARGUMENT...: SIGTERM comes before this call of these kinds (tests/faults/faults.c).
stop_at()
{
    calls=$1 number=$2
    shift 2
    command="bisque-voxelize $* interrupted" code=0
    FAULT_UNDER=$(pwd -P) FAULT_CALLS=$calls FAULT_AT=$number FAULT_DO=TERM LD_PRELOAD=$TESTS/faults.so \
        env --default-signal=TERM "$BIN/bisque-voxelize" "$@" >"$out" 2>"$err" || code=$?
}

# The file of a grid gets its size when the chunk file is complete.
interrupted_grid()
{
    stop_at size 1 "$@"
}

"$TESTS/generate-scan" --triangles 2000 --colors vase -o scan.obj
mkdir whole
ok run bisque-voxelize scan.obj -o whole/scan.nvdb --resolution 32 --channels id --id color

# ---- before the chunk file is complete ----

stop_at sync 1 scan.obj -o scan.nvdb --resolution 32
refused 75 "$p interrupted"
files scan.obj whole
stop_at sync 1 scan.obj -o scan.tris
refused 75 "$p interrupted"
files scan.obj whole

# ---- after that: the command in the message makes the grid ----

interrupted_grid scan.obj -o scan.nvdb --resolution 32 --channels id --id color
refused 75 "$p interrupted; \"bisque-voxelize scan.tris -o scan.nvdb\" with the options of the grid goes on from there"
files scan.obj scan.tris whole
same scan.tris whole/scan.tris
ok run bisque-voxelize scan.tris -o scan.nvdb --resolution 32 --channels id
same scan.nvdb whole/scan.nvdb
rm scan.tris scan.nvdb

interrupted_grid scan.obj -o scan.nvdb --resolution 32 --tris 'kept here.tris'
refused 75 "$p interrupted; \"bisque-voxelize kept here.tris -o scan.nvdb\" with the options of the grid goes on from there"
rm 'kept here.tris'

# Chunk files beside meshes are inputs again.
cp whole/scan.tris first.tris
interrupted_grid first.tris scan.obj -o scan.nvdb --resolution 32 --tris kept.tris
refused 75 "$p interrupted; \"bisque-voxelize kept.tris first.tris -o scan.nvdb\" with the options of the grid goes on from there"
rm kept.tris

# Without a new chunk file there is nothing to say.
interrupted_grid scan.obj -o scan.nvdb --resolution 32 --no-tris
refused 75 "$p interrupted"
interrupted_grid first.tris -o scan.nvdb --resolution 32
refused 75 "$p interrupted"
files first.tris scan.obj whole

finish

#!/bin/sh
# test_faults.sh - killed jobs and failing system calls: no partial file is left, each failure is
# reported. tests/faults/ has the library that makes calls fail, and the program that repeats runs.
# LONG=1 repeats more runs.
. "$(dirname "$0")/lib.sh"
export FAULTS="$TESTS/faults.so"
unsanitized "calls that fail" "sanitizers want to be loaded first"
SEED=$(seed)
# Runs that are killed, calls at which a run is killed or interrupted, and calls that fail in each
# way, evenly spread over the run. With LONG=1 all calls of most jobs fail once.
if [ -n "${LONG-}" ]; then kills=200 calls=60 most=100000; else kills=24 calls=12 most=20; fi
echo "# SEED=$SEED"

# torture OPTION...: runs tests/faults/torture.c on the job in $job_outputs and $job_command.
torture()
{
    command="torture $* $job_outputs -- $job_command" code=0
    # Both are split into words on purpose: no name in them has a space.
    "$TESTS/torture" -s "$SEED" $job_alone "$@" $job_outputs -- $job_command >"$out" 2>"$err" || code=$?
    check "$(sed -n '$s/^\(not \)*ok - //p' "$out")" "$code"
    SEED=$((SEED + 1))
}

# job NAME OUTPUT... -- PROGRAM ARGUMENT...
job()
{
    job_outputs='' job_command='' job_alone=''
    while [ "$1" != -- ]; do
        job_outputs="$job_outputs $1"
        shift
    done
    shift
    job_command="$BIN/$*"
}

# Makes each call that writes fail in each way.
writes_fail()
{
    torture -m "$most" ENOSPC
    torture -m "$most" full
    torture -m "$most" EIO
    torture -m "$most" -p ENOSPC
    torture -m "$most" short
    torture -m "$most" EINTR
    torture -c close EIO
    torture -c name -x 73 EPERM
    torture -c name full
}

reads_fail()
{
    torture -m "$most" -c read EIO
    torture -m "$most" -c read short
    torture -m "$most" -c read EINTR
    torture -m "$most" -c open -x 66 -x 73 -x 74 EMFILE
}

# Kills the job at random moments, and before each call that changes a file or a name.
killed()
{
    torture -n "$kills" kill
    torture -n $((kills / 4)) -p kill
    torture -m "$calls" kill-at
    torture -c name -p kill-at
    torture -c remove -p EIO
    torture -m "$calls" -x 75 -c "open read write sync size name" interrupt
}

# Reserving disk space for a grid is one call among many: it fails alone, the other runs skip it.
room_fails()
{
    torture -c size ENOSPC
    torture -c size EINTR
    torture -c size EOPNOTSUPP
    torture -c size kill-at
    torture -p -c size kill-at
    torture -c size -x 75 interrupt
}

# In memory, because the disk would take most of the time; the library simulates its failures.
if [ -d /dev/shm ] && [ -w /dev/shm ] && memory=$(mktemp -d /dev/shm/bisque-cli.XXXXXX); then
    trap 'cd / && rm -rf "$memory" "$work"' EXIT
    cd "$memory" || exit 1
fi
"$TESTS/generate-scan" --triangles 2000 --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
ok run bisque-voxelize scan.obj -o scan.nvdb --resolution 32
ok run bisque-bake scan.nvdb low.obj --device cpu --size 32 --samples 1 --maps normal -o grid.exr
ok run bisque-bake scan.tris low.obj --size 32 --samples 1 --maps normal -o exact.exr
small="--size 32 --samples 1 --threads 2"

# ---- each tool, every call ----

job a.tris a.nvdb -- bisque-voxelize scan.obj -o a.nvdb --resolution 32 --threads 2
job_alone=-e
writes_fail
room_fails
reads_fail
killed

# A temporary file that cannot be removed is named, and the next job removes it.
LD_PRELOAD=$FAULTS FAULT_UNDER=$(pwd -P) FAULT_CALLS=remove FAULT_AT=1 FAULT_STICKY=1 FAULT_DO=EIO FAULT_PLAIN=1 \
    ok run bisque-voxelize scan.obj -o a.nvdb --resolution 32 --no-tris
holds "warnings name each file that stays" [ "$(grep -c 'warning: .*/[.]bisque[.].*[.]tmp: this temporary file cannot be removed: Input/output error$' "$err")" -eq \
    "$(ls -A | grep -c '^[.]bisque[.].*[.]tmp$')" ]
holds "a file stays" [ "$(ls -A | grep -c '[.]tmp$')" -gt 0 ]
FAULT_UNDER=$(pwd -P) FAULT_PLAIN=1 LD_PRELOAD=$FAULTS ok run bisque-voxelize scan.obj -o a.nvdb --resolution 32 --no-tris
holds "the next job removes them" [ "$(ls -A | grep -c '[.]tmp$')" -eq 0 ]
rm -f a.nvdb

# Without chunk file, so that chunks go to a temporary file.
job a.nvdb -- bisque-voxelize scan.obj -o a.nvdb --resolution 32 --no-tris --threads 2
torture ENOSPC
torture -c read EIO
torture -n 50 kill

job a_normal.png a_color.png -- bisque-bake scan.nvdb low.obj --device cpu $small -o 'a_<MAP>.png'
writes_fail
reads_fail
torture -c map -x 71 ENOMEM
killed

# OpenEXR writes through a stream of Bisque's.
job a.exr -- bisque-bake scan.tris low.obj $small --maps normal -o a.exr
writes_fail
reads_fail
killed

job a.exr a.png -- bisque-bake scan.nvdb low.obj --device cpu $small --maps normal --preview a.png -o a.exr
torture -m 12 ENOSPC

job heat.png -- bisque-compare grid.exr exact.exr --json --heatmap heat.png
writes_fail
reads_fail
killed

# ---- large scans: data in temporary files ----

"$TESTS/generate-scan" --triangles 1600000 --colors --shuffle 7 vase -o large.obj
job a.tris a.nvdb -- bisque-voxelize large.obj -o a.nvdb --resolution 64 --threads 1 --memory 52M
job_alone=-e
torture -m 5 ENOSPC
torture -m 4 -c read EIO
torture -m 3 kill-at
rm large.obj
job a.exr -- bisque-bake scan.nvdb low.obj --device cpu --size 512 --samples 1 --maps normal --memory 8M --threads 1 -o a.exr
torture -m 8 ENOSPC
torture -m 8 -c read EIO

# ---- helpers: OpenVDB and textures ----

job a.nvdb a.vdb -- bisque-voxelize scan.tris -o a.nvdb --resolution 16 --vdb a.vdb --threads 2
torture -m 30 ENOSPC
torture -m 10 short
torture -m 10 EINTR
torture -m 5 -n 20 kill

# The image is too large for its cache, so it is copied to a temporary tiled file.
ok run bisque-bake scan.nvdb low.obj --device cpu --size 2048 --samples 1 --maps color --type 8 --padding 0 -o wood.png
write_square 0 0 1 0 >square.obj
job a.nvdb -- bisque-voxelize square.obj -o a.nvdb --no-tris --texture wood.png --resolution 100 --memory 64M --threads 1
torture -m 5 -c write ENOSPC
torture -m 5 -c read EIO
torture -c open -x 66 -x 73 -x 74 -m 8 EMFILE

# ---- two jobs at a time ----

# together OPTION...: one job pauses before it renames its output; another one with the same output
# runs meanwhile.
together()
{
    rm -f flag a.nvdb
    LD_PRELOAD=$FAULTS FAULT_UNDER=$(pwd -P) FAULT_CALLS=name FAULT_PATH=a.nvdb FAULT_AT=$1 FAULT_DO=pause FAULT_FLAG=flag \
        FAULT_PLAIN=$2 "$BIN/bisque-voxelize" scan.tris -o a.nvdb --resolution 32 >"$out" 2>"$err" &
    wait_for flag
    before=$(ls -A | grep -c '^\.a\.nvdb\.............\.tmp$')
    LD_PRELOAD=$FAULTS FAULT_PLAIN=$2 "$BIN/bisque-voxelize" scan.tris -o a.nvdb --resolution 32 >/dev/null 2>&1
    same a.nvdb scan.nvdb
    [ "$(ls -A | grep -c '^\.a\.nvdb\.............\.tmp$')" -eq "$before" ]
    check "a job leaves the $before temporary file(s) of another one alone" $?
    rm a.nvdb flag
    command="the job that stood still" code=0
    wait $! || code=$?
    code 0
    same a.nvdb scan.nvdb
    holds "two jobs with one output leave nothing" [ -z "$(ls -A | grep '^\.a\.nvdb')" ]
}
together 1 ''  # before its file gets a name
together 2 ''  # between that and its final name
together 1 yes # all the time with a name

# A chunk file that is replaced between sorting and voxelizing: the grid is made of the job's own.
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >other.obj
ok run bisque-voxelize other.obj -o other.nvdb --resolution 4
rm -f flag
LD_PRELOAD=$FAULTS FAULT_UNDER=$(pwd -P) FAULT_CALLS=sync FAULT_AT=3 FAULT_DO=pause FAULT_FLAG=flag \
    "$BIN/bisque-voxelize" scan.obj -o a.nvdb --resolution 32 >"$out" 2>"$err" &
wait_for flag
[ -s a.tris ] && mv other.tris a.tris
check "a chunk file is replaced after it was written" $?
rm flag
command="the job whose chunk file was replaced" code=0
wait $! || code=$?
code 0
same a.nvdb scan.nvdb
rm a.tris a.nvdb

# ---- a grid that shrinks while it is read ----

# shrink BYTES PATH: truncates the grid when the bake opens the file PATH, which it does after it
# has opened and checked the grid.
shrink()
{
    rm -f flag
    cp scan.nvdb cut.nvdb
    LD_PRELOAD=$FAULTS FAULT_UNDER=$(pwd -P) FAULT_CALLS=open FAULT_PATH=$2 FAULT_AT=1 FAULT_DO=pause FAULT_FLAG=flag \
        "$BIN/bisque-bake" cut.nvdb low.obj --device $3 $small --maps normal,color -o 'a_<MAP>.exr' >"$out" 2>"$err" &
    wait_for flag
    truncate -s "$1" cut.nvdb
    rm flag
    command="bisque-bake of a grid cut to $1 bytes" code=0
    wait $! || code=$?
    refused 74 "bisque-bake: cut.nvdb: shrank from $size to $1 bytes while it was read"
    holds "no map of a grid that shrank" [ -z "$(ls -A | grep '^\.*a_')" ]
}
size=$(wc -c <scan.nvdb)
for bytes in 0 4096 $((size / 4)) $((size / 2)) $((size - 8192)); do
    shrink $bytes /low.obj cpu
done
shrink 4096 /low.obj opencl

finish

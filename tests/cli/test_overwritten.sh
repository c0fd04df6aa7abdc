#!/bin/sh
# test_overwritten.sh - grids and chunk files that another process overwrites in place while a bake
# reads them: the bake ends with exit code 74 and one line, unless its maps were complete before. No
# signal ends it. LONG=1 makes many more rounds. tests/faults/ has what makes a bake wait.
. "$(dirname "$0")/lib.sh"
SEED=$(seed)
echo "# SEED=$SEED"
if [ -n "${LONG:-}" ]; then
    waiting=40 moments=200
else
    waiting=2 moments=8
fi

"$TESTS/generate-scan" -n 30000 --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
"$BIN/bisque-voxelize" scan.obj -o scan.nvdb --resolution 250 >"$out" 2>"$err"
"$BIN/bisque-voxelize" scan.obj -o other.nvdb --no-tris --resolution 260 >"$out" 2>"$err"
# The same surface in another colour: its chunk file has the same layout.
awk '$1 == "v" { $5 = 1 - $5 } { print }' scan.obj >other.obj
"$BIN/bisque-voxelize" other.obj -o other.tris >"$out" 2>"$err"
command="two grids and two chunk files" code=0
[ -s scan.nvdb ] && [ -s other.nvdb ] && [ -s scan.tris ] && [ -s other.tris ]
check "$command" $?
live=live.nvdb size=$(wc -c <scan.nvdb)

# random N: sets $random to a number from 0 to N - 1.
random()
{
    SEED=$(((SEED * 1103515245 + 12345) & 2147483647))
    random=$(((SEED >> 8) % $1))
}

# damage KIND: overwrites $live in place, without changing its size except for cut.
damage()
{
    random $((size / 4096))
    place=$random
    case $1 in
    all) head -c "$size" /dev/urandom | dd of=$live conv=notrunc bs=1M status=none iflag=fullblock ;;
    ones) head -c "$size" /dev/zero | tr '\0' '\377' | dd of=$live conv=notrunc bs=1M status=none iflag=fullblock ;;
    cut) truncate -s $((size / 2)) $live ;;
    page) dd if=/dev/urandom of=$live conv=notrunc bs=4096 seek="$place" count=1 status=none ;;
    other) head -c "$size" "other.${live#live.}" | dd of=$live conv=notrunc bs=1M status=none iflag=fullblock ;;
    moved) tail -c +$((place * 4096 + 9)) "scan.${live#live.}" | head -c $((size - place * 4096 - 8)) |
        dd of=$live conv=notrunc bs=1M seek=$((place * 4096)) oflag=seek_bytes iflag=fullblock status=none ;;
    esac
}

# fresh: $live is the scan again, with a time that differs from that of any change.
fresh()
{
    cp "scan.${live#live.}" $live
    touch -d 2020-01-01 $live
}

# overwritten KIND: the bake was paused; overwrites $live, and waits for the end.
overwritten()
{
    wait_for flag
    holds "it waits: $command" [ -e flag ]
    damage "$1"
    rm -f flag
    wait $! || code=$?
}

# changed: the bake has noticed the change, and leaves no map.
changed()
{
    [ "$code" -eq 74 ] && [ "$(cat "$err")" = "bisque-bake: $live: was changed while it was read" ]
    check "exit code 74: $command" $?
    holds "no map: $command" [ -z "$(ls -A | grep '^\.*a_')" ]
}

# held KIND OPTION...: overwrites the scan when the bake opens the low-poly mesh, which it does
# after it has opened and checked the scan.
held()
{
    kind=$1
    shift
    fresh
    command="bisque-bake $* of $live overwritten with $kind, SEED=$SEED" code=0
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$(pwd -P) FAULT_CALLS=open FAULT_PATH=/low.obj FAULT_AT=1 FAULT_DO=pause \
        FAULT_FLAG=flag "$BIN/bisque-bake" $live low.obj --size 48 --maps normal,color -o 'a_<MAP>.exr' "$@" >"$out" 2>"$err" &
    overwritten "$kind"
    changed
}

# while_it_bakes LOOK KIND: overwrites the grid when the bake looks for an interruption for that time.
while_it_bakes()
{
    fresh
    command="bisque-bake of a grid overwritten with $2 at look $1, SEED=$SEED" code=0
    FAULT_CALLS=check FAULT_AT=$1 FAULT_DO=pause FAULT_FLAG=flag FAULT_COUNT=looks "$TESTS/bin/bisque-bake" live.nvdb low.obj \
        --size 128 --device cpu --maps normal,color -o 'a_<MAP>.exr' >"$out" 2>"$err" &
    overwritten "$2"
}

if sanitized; then
    skip "bakes that wait" "sanitizers want to be loaded first"
else
    round=0
    while [ $round -lt $waiting ]; do
        round=$((round + 1))
        for kind in all ones page other moved; do
            held $kind --device cpu
        done
        held all --device opencl
        LD_LIBRARY_PATH=$TESTS/fake held moved --device cuda --gpu-memory 2M
        LD_LIBRARY_PATH=$TESTS/fake held all --device cuda --gpu-memory 2M
        live=live.tris size=$(wc -c <scan.tris)
        for kind in all page other cut; do
            held $kind
        done
        live=live.nvdb size=$(wc -c <scan.nvdb)
    done
fi

# ---- at any moment ----

rm -f looks
fresh
FAULT_CALLS=check FAULT_COUNT=looks "$TESTS/bin/bisque-bake" live.nvdb low.obj --size 128 --device cpu \
    --maps normal,color -o 'whole_<MAP>.exr' >"$out" 2>"$err"
read -r all later <looks
holds "the bake looks for an interruption, $all times" [ "$all" -gt 1000 ]
moment=0
while [ $moment -lt $moments ]; do
    for kind in all page other moved; do
        while_it_bakes $((1 + moment * (all - 10) / moments)) $kind
        changed
    done
    moment=$((moment + 1))
done
# Its last look comes when the maps have their names.
while_it_bakes "$all" all
code 0
for map in normal color; do
    same a_$map.exr whole_$map.exr
done

# A grid that is overwritten before it is opened is like one that always had these bytes.
if ! sanitized; then
    rm a_*
    fresh
    command="bisque-bake of a grid overwritten before it is opened" code=0
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$(pwd -P) FAULT_CALLS=open FAULT_PATH=/live.nvdb FAULT_AT=1 FAULT_DO=pause \
        FAULT_FLAG=flag "$BIN/bisque-bake" live.nvdb low.obj --size 48 -o 'a_<MAP>.exr' >"$out" 2>"$err" &
    overwritten all
    refused_like 65 '^bisque-bake: live.nvdb: '
fi
finish

#!/bin/sh
# test_overwritten.sh - grids and chunk files that another process overwrites in place while a bake
# reads them: the bake ends with exit code 74 and one line, or it was done before. No signal ends
# it. LONG=1 makes many more rounds. tests/faults/ has the library that makes a bake wait.
. "$(dirname "$0")/lib.sh"
SEED=${SEED:-$(date +%s)}
echo "# SEED=$SEED"
if [ -n "${LONG:-}" ]; then
    waiting=40 racing=200
else
    waiting=2 racing=8
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

# ended: the last run ended with 0, or with one line about the grid: 74 if it was overwritten while
# it was open, 65 if that was before. Warnings may come first.
ended()
{
    case $code in
    0) ;;
    65 | 74) [ "$(grep -vc ': warning: ' "$err")" -eq 1 ] && grep -q '^bisque-bake: live.nvdb: ' "$err" ;;
    *) false ;;
    esac
    check "ended with 0, 65 or 74: $command" $?
}

# held KIND OPTION...: overwrites the scan when the bake opens the low-poly mesh, which it does
# after it has opened and checked the scan.
held()
{
    kind=$1
    shift
    rm -f flag
    cp "scan.${live#live.}" $live
    command="bisque-bake $* of $live overwritten with $kind, SEED=$SEED" code=0
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$(pwd -P) FAULT_CALLS=open FAULT_PATH=/low.obj FAULT_AT=1 FAULT_DO=pause \
        FAULT_FLAG=flag "$BIN/bisque-bake" $live low.obj --size 48 --maps normal,color -o 'a_<MAP>.exr' "$@" >"$out" 2>"$err" &
    wait_for flag
    damage "$kind"
    rm flag
    wait $! || code=$?
    [ "$code" -eq 74 ] && [ "$(cat "$err")" = "bisque-bake: $live: was changed while it was read" ]
    check "exit code 74: $command" $?
    holds "no map: $command" [ -z "$(ls -A | grep '^\.*a_')" ]
}

# raced KIND: overwrites the grid at any moment of a bake, opening included.
raced()
{
    cp scan.nvdb live.nvdb
    sleep 0.02
    command="bisque-bake of a grid overwritten with $1 at any moment, SEED=$SEED" code=0
    "$BIN/bisque-bake" live.nvdb low.obj --size 128 --device cpu --maps normal,color -o 'r_<MAP>.exr' >"$out" 2>"$err" &
    random 60
    sleep "0.0$((100 + random))"
    damage "$1"
    wait $! || code=$?
    ended
    rm -f r_*.exr
}

if ldd "$BIN/bisque-bake" | grep -q 'lib[at]san'; then
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
round=0
while [ $round -lt $racing ]; do
    round=$((round + 1))
    for kind in all page other moved; do
        raced $kind
    done
done
finish

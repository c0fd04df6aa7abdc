# farm_lib.sh - a part of a bake is killed, and baked twice at once. Needs tests/cli/lib.sh, and $whole,
# the options of a bake of one tile into farm/.
#
#   begin_faults           keeps a whole part for comparison; sets $part, its name
#   killed_at CALL...      checks bakes that end at their first call of each kind
#   twice NAME COMMAND     checks a bake that stops before it names its file while COMMAND runs
#   no_temporary_files     checks that none is left in farm/
#   plainly COMMAND...     runs a command as on NFS that has neither files without a name nor flock

begin_faults()
{
    part=farm/o_part-2-of-3.exr under=$(cd farm && pwd -P)
    rm -f farm/*
    bake_part
    mv $part whole
}

# bake_part: bakes part 2, without faults.
bake_part()
{
    # shellcheck disable=SC2086 # several words
    ok run bisque-bake $whole --part 2/3
}

# faulty_part CALL ACTION PLAIN: bakes the part; ACTION happens at its first call of this kind on the file.
# PLAIN is 1 for a file system that has no files without a name.
faulty_part()
{
    # shellcheck disable=SC2086
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$under FAULT_PATH=part-2 FAULT_CALLS=$1 FAULT_AT=1 FAULT_DO=$2 FAULT_PLAIN=$3 \
        FAULT_FLAG=flag "$BIN/bisque-bake" $whole --part 2/3 >"$out" 2>"$err"
}

killed_at()
{
    for plain in 0 1; do
        for call; do
            rm -f $part
            code=0
            faulty_part "$call" KILL $plain || code=$?
            command="part 2 killed at $call, FAULT_PLAIN=$plain"
            [ "$code" -ne 0 ] && { [ ! -e $part ] || cmp -s $part whole; }
            check "$command: no file, or all of it" $?
            bake_part
            same $part whole
        done
    done
}

twice()
{
    rm -f $part flag
    command=$1 code=0
    faulty_part name pause 1 &
    wait_for flag
    holds "$1: the bake stops" [ -e flag ]
    eval "$2"
    rm -f flag
    wait $! || code=$?
    [ "$code" -eq 0 ] && cmp -s $part whole
    check "$1" $?
}

plainly()
{
    rm -f locks
    command="$* without O_TMPFILE and flock" code=0
    LD_PRELOAD=$TESTS/faults.so FAULT_PLAIN=1 FAULT_LOCKS=$(pwd -P)/locks "$@" >"$out" 2>"$err" || code=$?
    code 0
    holds "$command: it asked for a lock" [ -s locks ]
}

no_temporary_files()
{
    holds "no temporary file is left" [ -z "$(ls -A farm | grep tmp)" ]
}

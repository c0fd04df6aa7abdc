# farm_lib.sh - task 2 of farm/plan.json is killed, and runs twice at once. Needs tests/cli/lib.sh.
#
#   begin_faults PROGRAM   sets the program, and keeps a whole part of the task for comparison;
#                          sets $part, the name of the part, and $faulted, the program
#   killed_at CALL...      checks tasks that end at their first call of each kind
#   twice NAME COMMAND     checks a task that stops before it names its part while COMMAND runs
#   no_temporary_files     checks that none is left in farm/
#   plainly COMMAND...     runs a command as on NFS that has neither files without a name nor flock

begin_faults()
{
    faulted=$BIN/$1 part=farm/plan.0002.part under=$(cd farm && pwd -P)
    rm -f farm/*.part
    task
    mv $part whole
}

# task: runs the task, without faults.
task()
{
    command="$faulted --task 2" code=0
    "$faulted" --plan farm/plan.json --task 2 >"$out" 2>"$err" || code=$?
    code 0
}

# faulty_task CALL ACTION PLAIN: runs the task; ACTION happens at its first call of this kind on the part.
# PLAIN is 1 for a file system that has no files without a name.
faulty_task()
{
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$under FAULT_PATH=plan.0002 FAULT_CALLS=$1 FAULT_AT=1 FAULT_DO=$2 FAULT_PLAIN=$3 \
        FAULT_FLAG=flag "$faulted" --plan farm/plan.json --task 2 >"$out" 2>"$err"
}

killed_at()
{
    for plain in 0 1; do
        for call; do
            rm -f $part
            code=0
            faulty_task "$call" KILL $plain || code=$?
            command="${faulted##*/} --task 2 killed at $call, FAULT_PLAIN=$plain"
            [ "$code" -ne 0 ] && { [ ! -e $part ] || cmp -s $part whole; }
            check "$command: no part, or all of it" $?
            task
            same $part whole
        done
    done
}

twice()
{
    rm -f $part flag
    command=$1 code=0
    faulty_task name pause 1 &
    wait_for flag
    holds "$1: the task stops" [ -e flag ]
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

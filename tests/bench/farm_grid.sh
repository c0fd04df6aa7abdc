#!/bin/sh
# farm_grid.sh - what dividing a grid costs: processor time (user and system) of the plan, all tasks
# and the merge beside that of a single run, one thread each, in seconds and as a ratio; the bytes of
# the parts; the longest task; the bytes that tasks read. Checks that the grids are the same. The last
# column says whether the ratio is at most 1.10, and how long a task takes if not: tasks of a tenth of
# a second measure how processes start.
# Writing into memory that the kernel has not used yet can take thrice as long as into memory that it
# has, so all is done TURNS times in turns: medians are printed, and the least and greatest ratio.
# TRIANGLES: of the scan; RESOLUTION: of the grid; COUNTS: numbers of tasks; GRIDS: several sizes,
# each TRIANGLES:RESOLUTION; TURNS: 3 unless given.
set -eu
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd)
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/bisque-bench.XXXXXX")
trap 'cd / && rm -rf "$work"' EXIT
cd "$work"
counts=${COUNTS:-1 4 16 64} turns=${TURNS:-3}
grids=${GRIDS:-${TRIANGLES:-2000000}:${RESOLUTION:-1024}}

# cost COMMAND...: runs it and sets $seconds of a processor, and $read bytes.
cost()
{
    "$@" --threads 1 --json >report
    set -- $(jq -r '.cost | "\(.seconds_user + .seconds_system) \(.bytes_read)"' report)
    seconds=$1 read=$2
}

# divide_in_turns TASKS RESOLUTION: times a single run, the plan, its tasks and the merge. Appends a row to
# the file runs: plan, tasks, merge, single run, and the longest task in seconds, then bytes that tasks
# read and the most that one did.
divide_in_turns()
{
    rm -f plan.* grid.nvdb one.nvdb
    cost "$BIN/bisque-voxelize" scan.tris -o one.nvdb --resolution "$2"
    single=$seconds
    cost "$BIN/bisque-voxelize" scan.tris -o grid.nvdb --resolution "$2" --tasks "$1" --write-plan plan.json
    plan=$seconds all=0 longest=0 bytes=0 most=0 task=0
    while [ $task -lt "$1" ]; do
        cost "$BIN/bisque-voxelize" --plan plan.json --task $task
        all=$(jq -n "$all + $seconds")
        longest=$(jq -n "[$longest, $seconds] | max")
        bytes=$((bytes + read)) most=$((read > most ? read : most))
        task=$((task + 1))
    done
    cost "$BIN/bisque-voxelize" --plan plan.json --merge
    cmp one.nvdb grid.nvdb
    echo "[$plan, $all, $seconds, $single, $longest, $bytes, $most]" >>runs
}

# divide_grid TRIANGLES RESOLUTION: prints the table of a size.
divide_grid()
{
    triangles=$1 resolution=$2
    "$TESTS/generate-scan" --triangles "$triangles" --colors vase -o scan.ply
    "$BIN/bisque-voxelize" scan.ply -o scan.tris >report
    rm scan.ply
    echo "a grid of $resolution; scan of $triangles triangles"
    echo "| tasks | plan s | tasks s | merge s | single run s | ratio | ratios | parts MiB | longest task s | a task reads MiB | at most MiB | at most 1.10 |"
    echo "|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|"
    for tasks in $counts; do
        rm -f runs
        turn=0
        while [ $turn -lt "$turns" ]; do
            divide_in_turns "$tasks" "$resolution"
            turn=$((turn + 1))
        done
        parts=$(cat plan.*.part | wc -c)
        jq -nr --slurpfile runs runs --argjson tasks "$tasks" --argjson parts "$parts" '
            def median: sort | .[length / 2 | floor];
            def places(n): . * n | round / n;
            [$runs[] | (.[0] + .[1] + .[2]) / .[3]] as $ratios | ($ratios | median) as $ratio |
            ($runs | transpose | map(median)) as $all |
            [$tasks] + [$all[:4][] | places(100)] + [$ratio | places(1000)] +
            ["\($ratios | min | places(100)) to \($ratios | max | places(100))", ($parts / 1048576 | round),
             ($all[4] | places(100)), ($all[5] / $tasks / 1048576 | round), ($all[6] / 1048576 | round),
             if $ratio <= 1.1 then "yes" else "no: tasks of \($all[1] / $tasks | places(100)) s" end] |
            "| \(map(tostring) | join(" | ")) |"'
    done
    rm -f scan.tris* one.nvdb grid.nvdb plan.*
}

for size in $grids; do
    divide_grid "${size%:*}" "${size#*:}"
done

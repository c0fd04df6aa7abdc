#!/bin/sh
# farm_grid.sh - what dividing a grid costs: processor time (user and system) of the plan, all tasks
# and the merge beside that of a single run, one thread each, in seconds and as a ratio; the bytes of
# the parts; the longest task; the bytes that tasks read. Checks that the grids are the same. The last
# column says whether the ratio is at most 1.10, and how long a task takes if not: tasks of a tenth of
# a second measure how processes start.
# TRIANGLES: of the scan; RESOLUTION: of the grid; COUNTS: numbers of tasks; GRIDS: several sizes,
# each TRIANGLES:RESOLUTION.
set -eu
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd)
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/bisque-bench.XXXXXX")
trap 'cd / && rm -rf "$work"' EXIT
cd "$work"
counts=${COUNTS:-1 4 16 64}
grids=${GRIDS:-${TRIANGLES:-2000000}:${RESOLUTION:-1024}:64}

# cost COMMAND...: runs it and sets $seconds of a processor, and $read bytes.
cost()
{
    "$@" --threads 1 --json >report
    set -- $(jq -r '.cost | "\(.seconds_user + .seconds_system) \(.bytes_read)"' report)
    seconds=$1 read=$2
}

# divide_grid TRIANGLES RESOLUTION: prints the table of a size.
divide_grid()
{
    triangles=$1 resolution=$2
    "$TESTS/generate-scan" --triangles "$triangles" --colors vase -o scan.ply
    "$BIN/bisque-voxelize" scan.ply -o scan.tris >report
    rm scan.ply
    echo "a grid of $resolution; scan of $triangles triangles"
    echo "| tasks | plan s | tasks s | merge s | single run s | ratio | parts MiB | longest task s | a task reads MiB | at most MiB | at most 1.10 |"
    echo "|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|"
    cost "$BIN/bisque-voxelize" scan.tris -o one.nvdb --resolution "$resolution"
    single=$seconds
    for tasks in $counts; do
        rm -f plan.*
        cost "$BIN/bisque-voxelize" scan.tris -o grid.nvdb --resolution "$resolution" --tasks "$tasks" --write-plan plan.json
        plan=$seconds all=0 longest=0 bytes=0 most=0 task=0
        while [ $task -lt "$tasks" ]; do
            cost "$BIN/bisque-voxelize" --plan plan.json --task $task
            all=$(jq -n "$all + $seconds")
            longest=$(jq -n "[$longest, $seconds] | max")
            bytes=$((bytes + read)) most=$((read > most ? read : most))
            task=$((task + 1))
        done
        cost "$BIN/bisque-voxelize" --plan plan.json --merge
        cmp one.nvdb grid.nvdb
        parts=$(cat plan.*.part | wc -c)
        jq -nr "[$tasks, $plan, $all, $seconds, $single, ($plan + $all + $seconds) / $single, $parts / 1048576, $longest,
            $bytes / $tasks / 1048576, $most / 1048576] | (.[5] <= 1.1) as \$holds | map(. * 1000 | round / 1000 | tostring) +
            [if \$holds then \"yes\" else \"no: tasks of \($all / $tasks * 100 | round / 100) s\" end] |
            \"| \" + join(\" | \") + \" |\""
    done
    rm -f scan.tris* one.nvdb grid.nvdb plan.*
}

for size in $grids; do
    divide_grid "${size%:*}" "${size#*:}"
done

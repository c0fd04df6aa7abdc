#!/bin/sh
# farm_grid.sh - what dividing a grid costs: processor time (user and system) of the plan, all tasks
# and the merge beside that of a single run, one thread each, in seconds and as a ratio; the bytes of
# the parts; the longest task. Checks that the grids are the same. TRIANGLES: of the scan; RESOLUTION:
# of the grid; COUNTS: numbers of tasks.
set -eu
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd)
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/bisque-bench.XXXXXX")
trap 'cd / && rm -rf "$work"' EXIT
cd "$work"
triangles=${TRIANGLES:-2000000} resolution=${RESOLUTION:-1024} counts=${COUNTS:-1 4 16 64}

"$TESTS/generate-scan" --triangles "$triangles" --colors vase -o scan.obj
"$BIN/bisque-voxelize" scan.obj -o scan.tris >report
rm scan.obj

# cost COMMAND...: adds its processor seconds to $total.
cost()
{
    "$@" --threads 1 --json >report
    total=$(jq --argjson t "$total" '$t + .cost.seconds_user + .cost.seconds_system' report)
}

echo "a grid of $resolution; scan of $triangles triangles"
echo "| tasks | plan s | tasks s | merge s | single run s | ratio | parts MiB | longest task s |"
echo "|---:|---:|---:|---:|---:|---:|---:|---:|"
total=0
cost "$BIN/bisque-voxelize" scan.tris -o one.nvdb --resolution "$resolution"
single=$total
for tasks in $counts; do
    rm -f plan.*
    total=0
    cost "$BIN/bisque-voxelize" scan.tris -o grid.nvdb --resolution "$resolution" --tasks "$tasks" --write-plan plan.json
    plan=$total all=0 longest=0 task=0
    while [ $task -lt "$tasks" ]; do
        total=0
        cost "$BIN/bisque-voxelize" --plan plan.json --task $task
        all=$(jq -n "$all + $total")
        longest=$(jq -n "[$longest, $total] | max")
        task=$((task + 1))
    done
    total=0
    cost "$BIN/bisque-voxelize" --plan plan.json --merge
    cmp one.nvdb grid.nvdb
    parts=$(cat plan.*.part | wc -c)
    jq -nr "[$tasks, $plan, $all, $total, $single, ($plan + $all + $total) / $single, $parts / 1048576, $longest] |
        \"| \" + (map(. * 1000 | round / 1000 | tostring) | join(\" | \")) + \" |\""
done

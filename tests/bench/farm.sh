#!/bin/sh
# farm.sh - what dividing a bake costs: processor time (user and system) of the plan, all tasks
# and the merge beside that of a single run, one thread each, in seconds and as a ratio; the bytes of
# the parts; the longest task. Checks that the maps are the same. SIDE: of the maps; TRIANGLES: of the
# scan; COUNTS: numbers of tasks.
set -eu
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd)
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/bisque-bench.XXXXXX")
trap 'cd / && rm -rf "$work"' EXIT
cd "$work"
side=${SIDE:-2048} triangles=${TRIANGLES:-2000000} counts=${COUNTS:-1 4 16 64}

"$TESTS/generate-scan" --triangles "$triangles" --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
"$BIN/bisque-voxelize" scan.obj -o scan.nvdb --resolution 1024 >report

# cost COMMAND...: adds its processor seconds to $total.
cost()
{
    "$@" --threads 1 --json >report
    total=$(jq --argjson t "$total" '$t + .cost.seconds_user + .cost.seconds_system' report)
}

echo "maps of $side x $side, 2 x 2 samples, normal, color, height; scan of $triangles triangles"
echo "| bake | tasks | plan s | tasks s | merge s | single run s | ratio | parts MiB | longest task s |"
echo "|---|---:|---:|---:|---:|---:|---:|---:|---:|"
for scan in scan.nvdb scan.tris; do
    options="--size $side --maps normal,color,height --device cpu"
    total=0
    cost "$BIN/bisque-bake" $scan low.obj -o 'one_<MAP>.exr' $options
    single=$total
    for tasks in $counts; do
        rm -f plan.* part_*
        total=0
        cost "$BIN/bisque-bake" $scan low.obj -o 'part_<MAP>.exr' $options --tasks "$tasks" --write-plan plan.json
        plan=$total all=0 longest=0 task=0
        while [ $task -lt "$tasks" ]; do
            total=0
            cost "$BIN/bisque-bake" --plan plan.json --task $task
            all=$(jq -n "$all + $total")
            longest=$(jq -n "[$longest, $total] | max")
            task=$((task + 1))
        done
        total=0
        cost "$BIN/bisque-bake" --plan plan.json --merge
        for map in normal color height; do
            cmp one_$map.exr part_$map.exr
        done
        parts=$(cat plan.*.part | wc -c)
        jq -nr --arg scan "${scan#scan.}" "[\$scan, $tasks, $plan, $all, $total, $single,
            ($plan + $all + $total) / $single, $parts / 1048576, $longest] |
            \"| \" + (map(if type == \"number\" then . * 1000 | round / 1000 else . end | tostring) | join(\" | \")) + \" |\""
    done
done

#!/bin/sh
# farm.sh - what dividing work costs. Processor time, user and system, one thread each: of all parts
# and the merge of a bake beside that of a single run; of many small assets. Bytes that
# parts read. Checks that the maps are the same, and predicts large scans from what it measured.
# SIDE: of the maps; TRIANGLES: of the scan; COUNTS: numbers of parts, 16 among them for the
# prediction; ASSETS: how many small ones.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd)
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/bisque-bench.XXXXXX")
trap 'cd / && rm -rf "$work"' EXIT
cd "$work"
side=${SIDE:-2048} triangles=${TRIANGLES:-2000000} counts=${COUNTS:-1 4 16 64} assets=${ASSETS:-200}

# cost COMMAND...: runs it and sets $seconds of a processor, $wall and $read bytes.
cost()
{
    "$@" --threads 1 --json >report
    set -- $(jq -r '.cost | "\(.seconds_user + .seconds_system) \(.seconds) \(.bytes_read)"' report)
    seconds=$1 wall=$2 read=$3
}

# note NAME VALUE: keeps a figure for the prediction.
note()
{
    echo "$1 $2" >>figures
}

# calculate EXPRESSION: prints its value.
calculate()
{
    jq -n "$1"
}

# ---- the scan and its grid ----

"$TESTS/generate-scan" --triangles "$triangles" --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
cost "$BIN/bisque-voxelize" scan.obj -o coarse.nvdb --tris scan.tris --resolution 1
note sort_seconds "$seconds"
cost "$BIN/bisque-voxelize" scan.tris -o small.nvdb --resolution 256
note small_grid_seconds "$seconds"
cost "$BIN/bisque-voxelize" scan.tris -o scan.nvdb --resolution 1024
note grid_seconds "$seconds"
note triangles "$triangles"
note side "$side"
for kind in obj tris nvdb; do
    note ${kind}_bytes "$(stat -c %s scan.$kind)"
done
note small_grid_bytes "$(stat -c %s small.nvdb)"

# ---- bakes ----

# divide PARTS: bakes in parts, and prints a row of the table. $scan, $options and $single are set.
divide()
{
    rm -f part_*
    all=0 longest=0 most=0 bytes=0 task=0
    while [ $task -lt "$1" ]; do
        cost "$BIN/bisque-bake" $scan low.obj -o 'part_<MAP>.exr' $options --part $((task + 1))/"$1"
        all=$(calculate "$all + $seconds") longest=$(calculate "[$longest, $seconds] | max")
        bytes=$((bytes + read)) most=$((read > most ? read : most))
        task=$((task + 1))
    done
    cost "$BIN/bisque-bake" $scan low.obj -o 'part_<MAP>.exr' $options --merge "$1"
    for map in normal color height; do
        cmp one_$map.exr part_$map.exr
    done
    parts=$(cat part_part-* | wc -c)
    jq -nr --arg scan "${scan#scan.}" "[\$scan, $1, $all, $seconds, $single,
        ($all + $seconds) / $single, $parts / 1048576, $longest, $bytes / $1 / 1048576, $most / 1048576] |
        \"| \" + (map(if type == \"number\" then . * 1000 | round / 1000 else . end | tostring) | join(\" | \")) + \" |\""
    [ "$1" -ne 16 ] || {
        for figure in tasks:$all merge:$seconds parts:$parts read:$bytes merge_read:$read; do
            note "${scan#scan.}_${figure%%:*}" "${figure#*:}"
        done
        ratio=$(calculate "($all + $seconds) / $single")
    }
}

echo "maps of $side x $side, 2 x 2 samples, normal, color, height; scan of $triangles triangles"
echo "| bake | parts | parts s | merge s | single run s | ratio | files MiB | longest part s | a part reads MiB | at most MiB |"
echo "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
limits=
for scan in scan.nvdb scan.tris; do
    options="--size $((side / 4)) --maps normal,color,height --device cpu" ratio=0
    cost "$BIN/bisque-bake" $scan low.obj -o 'one_<MAP>.exr' $options
    note ${scan#scan.}_small "$seconds"
    options="--size $side --maps normal,color,height --device cpu"
    cost "$BIN/bisque-bake" $scan low.obj -o 'one_<MAP>.exr' $options
    single=$seconds
    note ${scan#scan.}_single "$seconds"
    for tasks in $counts; do
        divide "$tasks"
    done
    limits="$limits $ratio"
done
echo
echo "$limits" | awk '$1 { printf "16 tasks: %.2f of a single run from the grid (limit 1.10), %.2f from triangles (limit 1.25)\n", $1, $2 }'

# ---- many small assets ----

"$TESTS/generate-scan" --triangles 2000 --colors vase -o small.obj
all=0 whole=0 asset=0
while [ $asset -lt "$assets" ]; do
    cost "$BIN/bisque-voxelize" small.obj -o small.nvdb --no-tris --resolution 32
    all=$(calculate "$all + $seconds") whole=$(calculate "$whole + $wall")
    cost "$BIN/bisque-bake" small.nvdb low.obj -o 'small_<MAP>.exr' --size 32 --maps normal --device cpu
    all=$(calculate "$all + $seconds") whole=$(calculate "$whole + $wall")
    asset=$((asset + 1))
done
echo "$assets small assets: $(calculate "$all / $assets * 1000 | round / 1000") s of a processor each, $(
    calculate "$whole / $assets * 1000 | round / 1000") s in all, for voxelizing and baking (limit 0.2)"

# ---- large scans ----

grep -q '^tris_tasks ' figures || exit 0
echo
awk -f "$here/farm_predict.awk" figures

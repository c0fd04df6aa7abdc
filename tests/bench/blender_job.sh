#!/bin/sh
# Compares whole jobs: from a scan as OBJ to a map of ambient occlusion, with Bisque and with Blender, at equal noise. Prints
# tables in Markdown; tests/bench/BAKE.md says how to read them.
#
#   BIN=DIR TESTS=DIR tests/bench/blender_job.sh small|medium
#
#   BIN, TESTS   directories with the programs, and with generate-scan and measure
#   BLENDER      Blender, or a Python with the module bpy (default: blender)
#   SIZES        texels along a side of the maps (default: 256 1024)
set -eu
LC_ALL=C
export LC_ALL
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd)
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd)
here=$(cd "$(dirname "$0")" && pwd)
case ${1:-} in
small) triangles=1000000 ;;
medium) triangles=10000000 ;;
*)
    echo "usage: BIN=DIR TESTS=DIR tests/bench/blender_job.sh small|medium" >&2
    exit 64
    ;;
esac
BLENDER=${BLENDER:-blender}
if ! { "$BLENDER" -b --version || "$BLENDER" -c 'import bpy'; } >/dev/null 2>&1; then
    echo "bench-blender: there is neither Blender nor a Python with bpy: set BLENDER" >&2
    exit 69
fi
work=$(mktemp -d "${TMPDIR:-/tmp}/bench-blender.XXXXXX")
trap 'rm -rf "$work"' EXIT
trap 'exit 75' INT TERM HUP
cd "$work"
reach="--front 0.05 --back 0.05"

say()
{
    echo "bench-blender: $*" >&2
}

# cost NAME COMMAND...: runs a command and adds its cost to the file NAME.
cost()
{
    name=$1
    shift
    "$TESTS/measure" report "$@" >log 2>&1 || {
        tail -n 5 log >&2
        exit 70
    }
    cat report >>"$name"
}

# in_blender NAME ARGUMENT...: runs blender_bake.py.
in_blender()
{
    name=$1
    shift
    case $BLENDER in
    *python*) cost "$name" "$BLENDER" "$here/blender_bake.py" "$@" ;;
    *) cost "$name" "$BLENDER" -b --factory-startup --python-exit-code 70 --python "$here/blender_bake.py" -- "$@" ;;
    esac
}

# bisque NAME SCAN SIZE RAYS[,filter=MODE]: bakes NAME_ao.exr and NAME_mask.exr.
bisque()
{
    # shellcheck disable=SC2086 # options
    cost "$1" "$BIN/bisque-bake" "$2.nvdb" low.obj -o "$1_<MAP>.exr" --maps ao,mask --rays "ao=$4" --size "$3" --samples 1 \
        --padding 0 --type float --device cpu $reach
}

# noise A B MASK: prints the root mean square of the difference of two maps.
noise()
{
    in_blender compared compare value "$1" "$2" "$3"
    sed -n 's/.*RMS: //p' log
}

"$TESTS/generate-scan" vase-low -o low.obj
"$TESTS/generate-scan" --triangles 200000 vase -o coarse.obj
"$BIN/bisque-voxelize" coarse.obj -o coarse.nvdb >log 2>&1

say "noise"
bisque reference coarse 128 4096
bisque many coarse 128 64
ours=$(noise many_ao.exr reference_ao.exr reference_mask.exr)
in_blender reference bake ao coarse.obj low.obj blender.exr 128 4096 0.05 0.05
echo "| rays or samples | Bisque, RMS from 4096 | Blender, RMS from 4096 |"
echo "|--:|--:|--:|"
for samples in 32 64 96 128 192; do
    in_blender count bake ao coarse.obj low.obj "blender$samples.exr" 128 $samples 0.05 0.05
    theirs=$(noise "blender$samples.exr" blender.exr reference_mask.exr)
    echo "| $samples | $([ $samples = 64 ] && echo "$ours" || echo) | $theirs |"
    echo "$samples $theirs" >>noises
done
# The number of samples with the noise of our 64 rays: on a line through the logarithms of both around it.
samples=$(awk -v ours="$ours" '{
    if (!n && $2 <= ours)
        n = NR == 1 ? $1 : last_n * exp(log($1 / last_n) * log(ours / last) / log($2 / last))
    last_n = $1
    last = $2
} END { printf "%.0f\n", n ? n : last_n }' noises)

say "the filter"
bisque reference coarse 512 1024
echo
echo "At 512 x 512 texels, RMS from 1024 rays a texel:"
echo
echo "| rays | RMS |"
echo "|:--|--:|"
for rays in 16 64 16,filter=surface; do
    bisque filtered coarse 512 $rays
    echo "| $rays | $(noise filtered_ao.exr reference_ao.exr reference_mask.exr) |"
done

say "a scan of $triangles triangles"
"$TESTS/generate-scan" --triangles $triangles vase -o scan.obj
echo
echo "Whole jobs, $triangles triangles, Bisque with 64 rays, Blender with $samples samples:"
echo
echo "| texels | | wall s | processor s | memory, MiB | Blender's wall / this |"
echo "|--:|:--|--:|--:|--:|--:|"

# wall NAME: prints the sum of the wall times in the file NAME.
wall()
{
    tr ' ' '\n' <"$1" | awk -F = '$1 == "wall" { s += $2 } END { print s }'
}

# row SIZE NAME: prints the sum of the costs in the file NAME.
row()
{
    awk -v size="$1" -v name="$2" -v theirs="$(wall Blender)" '{
        for (i = 1; i <= NF; i++) { split($i, p, "="); v[p[1]] = p[2] }
        wall += v["wall"]; cpu += v["user"] + v["system"]; if (v["rss_kib"] > rss) rss = v["rss_kib"]
    } END { printf "| %s | %s | %.1f | %.1f | %.0f | %.1f |\n", size, name, wall, cpu, rss / 1024, theirs / wall }' "$2"
}
for size in ${SIZES:-256 1024}; do
    rm -f Bisque Filtered Blender
    say "$size x $size"
    # A voxel of half a texel, as README.md says.
    in_blender Blender bake ao scan.obj low.obj map.exr "$size" "$samples" 0.05 0.05
    for name in Bisque Filtered; do
        cost $name "$BIN/bisque-voxelize" scan.obj -o scan.nvdb --resolution "$size"
    done
    bisque Bisque scan "$size" 64
    bisque Filtered scan "$size" 16,filter=surface
    for name in Bisque Filtered Blender; do
        row "$size" $name
    done
done

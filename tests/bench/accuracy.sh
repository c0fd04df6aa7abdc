#!/bin/sh
# Measures how far maps baked from voxels are from exact ones, and prints tables in Markdown.
# tests/bench/ACCURACY.md says how to read them.
#
#   BIN=DIR TESTS=DIR tests/bench/accuracy.sh small|medium
#
#   BIN, TESTS     directories with the programs and with generate-scan
#   BENCH_DIR      where maps and heat maps stay; without it they go to a temporary directory beside
#                  BIN, which is removed in the end
#   SCANS          directory with bunny.obj and bunny_low.obj (default: ../shared/scans); without them
#                  the bunny is left out
set -u
LC_ALL=C
export LC_ALL

case ${1:-medium} in
small) scan_triangles=2000000 bunny_triangles=2000000 size=1024 ;;
medium) scan_triangles=10000000 bunny_triangles=10000000 size=2048 ;;
*)
    echo "usage: BIN=DIR TESTS=DIR tests/bench/accuracy.sh small|medium" >&2
    exit 64
    ;;
esac
samples=4
ratios="2 1 0.5 0.25"
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd) || exit 66
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd) || exit 66
here=$(cd "$(dirname "$0")" && pwd) || exit 66
SCANS=$(cd "${SCANS:-../shared/scans}" 2>/dev/null && pwd) || SCANS=
if [ -n "${BENCH_DIR:-}" ]; then
    mkdir -p "$BENCH_DIR" && work=$(cd "$BENCH_DIR" && pwd) || exit 73
else
    work=$(mktemp -d "$(dirname "$BIN")/accuracy.XXXXXX") || exit 73
    trap 'rm -rf "$work"' EXIT
fi
trap 'exit 75' INT TERM HUP
cd "$work" || exit 73
records=$work/records
: >"$records"

say()
{
    echo "accuracy: $*" >&2
}

run()
{
    "$BIN/$@" >log 2>&1 && return
    say "failed: $*"
    cat log >&2
    exit 70
}

# number KEY FILE: of a line "KEY": NUMBER in JSON.
number()
{
    sed -n "s/^ *\"$1\": *\\([-0-9.e]*\\).*/\\1/p" "$2"
}

calc()
{
    awk "BEGIN { printf \"%.9g\", $* }"
}

# bake SCAN LOW NAME OPTION...: object-space normals and the mask as floats; the report is NAME.json.
bake()
{
    scan=$1 low=$2 name=$3
    shift 3
    run bisque-bake "$scan" "$low" -o "${name}_<MAP>.exr" --maps normal,mask --normal-space object \
        --float --size "$map_size" --samples $samples --padding 0 --json "$@"
    mv log "$name.json"
}

# prepare NAME SCAN.obj LOW.obj SIZE: chunks, their exact maps, texel (world units).
prepare()
{
    name=$1 scan_low=$3 map_size=$4
    texel=$(calc "$(awk -f "$here/accuracy_texel.awk" "$scan_low") / $map_size") || exit 65
    say "$name: $map_size x $map_size texels of $texel"
    run bisque-voxelize "$2" -o "$name.nvdb" --voxel-size "$(calc "4 * $texel")"
    rm "$name.nvdb"
    bake "$name.tris" "$scan_low" "$name-exact"
    reach="--front $(number front "$name-exact.json") --back $(number back "$name-exact.json")"
}

# against_exact NAME RATIO DETAIL METHOD: DETAIL is the wavelength in voxels, or "-".
against_exact()
{
    map=$1-$2-$4
    # shellcheck disable=SC2086 # two options with a value each
    bake "$1.nvdb" "$scan_low" "$map" --sampling "$4" $reach
    run bisque-compare "${map}_normal.exr" "$1-exact_normal.exr" --mask-a "${map}_mask.exr" \
        --mask-b "$1-exact_mask.exr" --heatmap "$map-heat.png" --histogram "$map-histogram.png" \
        --scale 5 --json
    line="$5	$2	$3	$4"
    for key in mean p95 p99 max share_above_1 share_above_5 agreement; do
        line="$line	$(number $key log)"
    done
    printf '%s\n' "$line" >>"$records"
    mv log "$map.json"
    [ -n "${BENCH_DIR:-}" ] || rm -f "$map"*
}

# both_samplings NAME RATIO DETAIL TITLE: at one ratio of voxel to texel.
both_samplings()
{
    run bisque-voxelize "$1.tris" -o "$1.nvdb" --voxel-size "$(calc "$2 * $texel")"
    for sampling in trilinear nearest; do
        against_exact "$1" "$2" "$3" $sampling "$4"
    done
    rm "$1.nvdb"
}

# whole_scan NAME TITLE: at all ratios.
whole_scan()
{
    for ratio in $ratios; do
        both_samplings "$1" "$ratio" - "$2"
    done
    [ -n "${BENCH_DIR:-}" ] || rm -f "$1"*
}

# The wavelength is chosen in texels; what it is in voxels follows from the ratio. 24 triangles a wave.
sine()
{
    waves=$1 map_size=128
    cells=$(calc "int(24 * 108 / (100 / $map_size * $waves))")
    [ "$cells" -lt 1600 ] || cells=1600
    "$TESTS/generate-scan" --triangles $((2 * cells * cells)) --normals \
        --wavelength "$(calc "100 / $map_size * $waves")" sine -o sine.obj || exit 73
    prepare "sine$waves" sine.obj sine_low.obj $map_size
    rm sine.obj
    for ratio in $ratios; do
        detail=$(calc "$waves / $ratio")
        case $detail in
        4 | 8 | 16 | 32) both_samplings "sine$waves" "$ratio" "$detail" sine ;;
        esac
    done
    [ -n "${BENCH_DIR:-}" ] || rm -f "sine$waves"*
}

"$TESTS/generate-scan" sine-low -o sine_low.obj || exit 73
for waves in 1 2 4 8 16 32 64; do
    sine $waves
done

"$TESTS/generate-scan" --triangles $scan_triangles vase -o vase.obj &&
    "$TESTS/generate-scan" vase-low -o vase_low.obj || exit 73
prepare vase vase.obj vase_low.obj $size
rm vase.obj
whole_scan vase "vase, $((scan_triangles / 1000000))M triangles, $size²"

if [ -n "$SCANS" ] && [ -f "$SCANS/bunny.obj" ]; then
    "$TESTS/generate-scan" --triangles $bunny_triangles "$SCANS/bunny.obj" -o bunny.obj || exit 73
    prepare bunny bunny.obj "$SCANS/bunny_low.obj" $size
    rm bunny.obj
    whole_scan bunny "bunny, $((bunny_triangles / 1000000))M triangles, $size²"
else
    say "no bunny.obj in SCANS: left out"
fi

echo "Date: $(date -u +%Y-%m-%d), $("$BIN/bisque-bake" --version), $samples x $samples samples a texel"
awk -F '\t' -f "$here/accuracy_table.awk" "$records"

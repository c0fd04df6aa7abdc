#!/bin/sh
# Measures how far maps baked from voxels are from exact ones, and prints tables in Markdown.
# tests/bench/ACCURACY.md says how to read them.
#
#   BIN=DIR TESTS=DIR tests/bench/accuracy.sh small|medium [sine|vase|bunny|waves]...
#
#   sine, vase, bunny, waves: measures these scans only
#   BIN, TESTS     directories with the programs and with generate-scan
#   BENCH_DIR      directory where maps and heat maps are kept; default: a temporary directory beside
#                  BIN, which is removed at the end
#   SCANS          directory with bunny.obj and bunny_low.obj (default: ../shared/scans); without them
#                  the bunny is left out
set -u
LC_ALL=C
export LC_ALL

case ${1:-medium} in
small) scan_triangles=2000000 bunny_triangles=2000000 size=1024 ;;
medium) scan_triangles=10000000 bunny_triangles=10000000 size=2048 ;;
*)
    echo "usage: BIN=DIR TESTS=DIR tests/bench/accuracy.sh small|medium [sine|vase|bunny|waves]..." >&2
    exit 64
    ;;
esac
shift $(($# > 0))
[ $# -gt 0 ] || set -- sine vase bunny waves
samples=4
ratios="2 1 0.5 0.25"
finer=", against four times the triangles"
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
    program=$1
    shift
    "$BIN/$program" "$@" >log 2>&1 && return
    say "failed: $program $*"
    cat log >&2
    exit 70
}

# number KEY FILE: prints NUMBER of a line "KEY": NUMBER in JSON.
number()
{
    sed -n "s/^ *\"$1\": *\\([-0-9.e]*\\).*/\\1/p" "$2"
}

calc()
{
    awk "BEGIN { printf \"%.9g\", $* }"
}

# bake SCAN LOW NAME OPTION...: bakes object-space normals and the mask as floats, with the report NAME.json.
bake()
{
    from=$1 onto=$2 map=$3
    shift 3
    run bisque-bake "$from" "$onto" -o "${map}_<MAP>.exr" --maps normal,mask --normal space=object \
        --type float --size "$map_size" --samples $samples --padding 0 --json "$@"
    mv log "$map.json"
}

# prepare NAME SCAN.obj LOW.obj SIZE: makes the chunk file and its exact maps, and sets the size of a texel (world units).
prepare()
{
    scan_low=$3 map_size=$4
    texel=$(calc "$(awk -f "$here/accuracy_texel.awk" "$scan_low") / $map_size") || exit 65
    say "$1: $map_size x $map_size texels of $texel"
    run bisque-voxelize "$2" -o "$1.nvdb" --voxel-size "$(calc "4 * $texel")"
    rm "$1.nvdb"
    bake "$1.tris" "$scan_low" "$1-exact"
    reach="--front $(number front "$1-exact.json") --back $(number back "$1-exact.json")"
}

# compare A B TITLE RATIO DETAIL KIND: records how far map A is from the reference B, and draws heat maps.
compare()
{
    pictures=$1-against-${2##*-}
    run bisque-compare "$1_normal.exr" "$2_normal.exr" --mask-a "$1_mask.exr" --mask-b "$2_mask.exr" \
        --heatmap "$pictures-heat.png" --scale 5 --json
    mv log comparison
    line="voxel	$3	$4	$5	$6"
    for key in mean p95 p99 max share_above_1 share_above_5 agreement; do
        line="$line	$(number $key comparison)"
    done
    printf '%s\n' "$line" >>"$records"
}

# discard NAME: removes files that are no longer needed, unless BENCH_DIR keeps them.
discard()
{
    [ -n "${BENCH_DIR:-}" ] || rm -f "$1"*
}

# against_exact NAME RATIO DETAIL SAMPLING TITLE: compares voxels with exact maps. DETAIL: wavelength in voxels, or "-".
against_exact()
{
    # shellcheck disable=SC2086 # two options with a value each
    bake "$1.nvdb" "$scan_low" "$1-$2-$4" --scan sampling="$4" $reach
    compare "$1-$2-$4" "$1-exact" "$5" "$2" "$3" "$4"
    [ ! -f "$1-flat_normal.exr" ] || compare "$1-$2-$4" "$1-flat" "$5, against facets" "$2" "$3" "$4"
    [ ! -f "$1-fine_normal.exr" ] || compare "$1-$2-$4" "$1-fine" "$5$finer" "$2" "$3" "$4"
}

# both_samplings NAME RATIO DETAIL TITLE: compares both samplings at one ratio of voxel to texel.
both_samplings()
{
    run bisque-voxelize "$1.tris" -o "$1.nvdb" --voxel-size "$(calc "$2 * $texel")"
    for sampling in trilinear nearest; do
        against_exact "$1" "$2" "$3" $sampling "$4"
    done
    rm "$1.nvdb"
}

# whole_scan NAME TITLE: compares at all ratios with all references: triangles with smooth normals, facets, and, if it was
# prepared, a finer scan of the same surface.
whole_scan()
{
    # shellcheck disable=SC2086 # two options with a value each
    bake "$1.tris" "$scan_low" "$1-flat" --scan normals=flat $reach
    compare "$1-flat" "$1-exact" "$2" 0 - flat
    if [ -f "$1-fine_normal.exr" ]; then
        compare "$1-exact" "$1-fine" "$2$finer" 0 - smooth
        compare "$1-flat" "$1-fine" "$2$finer" 0 - flat
    fi
    for ratio in $ratios; do
        both_samplings "$1" "$ratio" - "$2"
    done
}

# truth NAME TITLE LABEL: compares a map of the vase with its formula, every 149th texel.
truth()
{
    "$TESTS/check-vase" -s $samples -e 149 "$1_normal.exr" "$1_mask.exr" >log || exit 70
    sed -n 's/.*mean angle: \([0-9.e-]*\).*/\1/p; s/.*95th percentile: \([0-9.e-]*\).*/\1/p
        s/.*99th \([0-9.e-]*\), largest \([0-9.e-]*\) .*/\1\t\2/p' log | paste -s - >numbers
    printf 'truth\t%s\t%s\t%s\n' "$2" "$3" "$(cat numbers)" >>"$records"
}

# truths NAME TITLE
truths()
{
    truth "$1-exact" "$2" "exact, smooth normals"
    truth "$1-flat" "$2" "exact, facets"
    for ratio in $ratios; do
        for sampling in trilinear nearest; do
            truth "$1-$ratio-$sampling" "$2" "voxel / texel $ratio, $sampling"
        done
    done
}

# The wavelength is chosen in texels; the ratio determines it in voxels. A wave has 64 cells, and a few less if waves are
# shortest, so that the error of the triangles is far below that of the voxels.
sine()
{
    waves=$1 map_size=128
    [ "$waves" -gt 2 ] || map_size=64
    cells=$(calc "int(64 * 1.08 * $map_size / $waves)")
    [ "$cells" -le 2300 ] || cells=2300
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
    discard "sine$waves"
}

sines()
{
    "$TESTS/generate-scan" sine-low -o sine_low.obj || exit 73
    for waves in 1 2 4 8 16 32 64; do
        sine $waves
    done
}

vase()
{
    "$TESTS/generate-scan" --triangles $scan_triangles vase -o vase.obj &&
        "$TESTS/generate-scan" vase-low -o vase_low.obj || exit 73
    prepare vase vase.obj vase_low.obj $size
    rm vase.obj
    title="vase, $((scan_triangles / 1000000))M triangles, $size²"
    whole_scan vase "$title"
    truths vase "$title"
    discard vase
}

has_bunny()
{
    [ -n "$SCANS" ] && [ -f "$SCANS/bunny.obj" ] && return
    say "no bunny.obj in SCANS: left out"
    return 1
}

bunny()
{
    has_bunny || return
    "$TESTS/generate-scan" --triangles $bunny_triangles "$SCANS/bunny.obj" -o bunny.obj || exit 73
    prepare bunny bunny.obj "$SCANS/bunny_low.obj" $size
    rm bunny.obj
    # The displacement is a formula, so more triangles approximate the same surface better.
    "$TESTS/generate-scan" --triangles $((4 * bunny_triangles)) "$SCANS/bunny.obj" -o fine.obj || exit 73
    run bisque-voxelize fine.obj -o fine.nvdb --voxel-size "$(calc "4 * $texel")"
    rm fine.obj fine.nvdb
    # shellcheck disable=SC2086 # two options with a value each
    bake fine.tris "$scan_low" bunny-fine $reach
    rm fine.tris
    whole_scan bunny "bunny, $((bunny_triangles / 1000000))M triangles, $size²"
    discard bunny
}

# waves_of NAME TITLE TRIANGLES STRETCH RATIO...: compares the bunny with waves that are STRETCH times as long and of the same
# slope; 0: without waves. Edges of the small scan are rounded, but not completely. The shortest waves are 6 to 11 texels long in
# medium and half of that in small, depending on direction; tables say 8 and 4.
waves_of()
{
    surface=$1 title="$2, $(($3 / 1000000))M triangles" triangles=$3 stretch=$4
    shift 4
    "$TESTS/generate-scan" --triangles "$triangles" --rounded --amplitude "$(calc "0.002 * $stretch")" \
        --wavelength "$(calc "0.03 * $diagonal * $stretch")" "$SCANS/bunny.obj" -o waves.obj || exit 73
    prepare "$surface" waves.obj "$SCANS/bunny_low.obj" $size
    rm waves.obj
    for ratio; do
        detail=-
        [ "$stretch" = 0 ] || detail=$(calc "8 * $stretch * $size / 2048 / $ratio")
        both_samplings "$surface" "$ratio" "$detail" "$title"
    done
    discard "$surface"
}

# How much the length of the waves, the triangles and the small scan contribute to the bunny's errors.
waves()
{
    has_bunny || return
    diagonal=$(calc "$(awk -f "$here/accuracy_diagonal.awk" "$SCANS/bunny.obj")") || exit 65
    waves_of waves "bunny's waves" $bunny_triangles 1 1 0.5 0.25
    waves_of long "bunny's waves" $bunny_triangles 2 2 1 0.5
    waves_of fine "bunny's waves" $((4 * bunny_triangles)) 1 1 0.5 0.25
    # shellcheck disable=SC2086 # a list
    waves_of still "bunny without waves" $bunny_triangles 0 $ratios
}

for scan; do
    case $scan in
    sine) sines ;;
    vase) vase ;;
    bunny) bunny ;;
    waves) waves ;;
    *)
        say "$scan is not sine, vase, bunny or waves"
        exit 64
        ;;
    esac
done

echo "Date: $(date -u +%Y-%m-%d), $("$BIN/bisque-bake" --version), $samples x $samples samples a texel"
awk -F '\t' -f "$here/accuracy_table.awk" "$records"

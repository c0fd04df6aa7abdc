#!/bin/sh
# Measures what maps cost beside the normal map, how many secondary rays a grid traces beside Embree, where the time of
# --maps all goes, and what older instruction sets cost. All is processor time. Prints tables in Markdown; tests/bench/BAKE.md says how to read them.
#
#   BIN=DIR TESTS=DIR tests/bench/maps.sh small|medium
#
#   BIN, TESTS     directories with the programs, and with generate-scan and bench-maps
#   BENCH_DIR      directory for scans and maps, where scans are kept for the next run; default: a temporary directory
#   BENCH_ROUNDS   rounds; tables show the median (default: 1 for medium, 3 for small)
set -eu
LC_ALL=C
export LC_ALL
case ${1:-} in
small) triangles=1000000 resolution=768 size=192 all=256 rounds=${BENCH_ROUNDS:-3} ;;
medium) triangles=10000000 resolution=2048 size=768 all=2048 rounds=${BENCH_ROUNDS:-1} ;;
*)
    echo "usage: BIN=DIR TESTS=DIR tests/bench/maps.sh small|medium" >&2
    exit 64
    ;;
esac

if [ -n "${BENCH_DIR:-}" ]; then
    mkdir -p "$BENCH_DIR"
    work=$BENCH_DIR
else
    work=$(mktemp -d "${TMPDIR:-/tmp}/bench-maps.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    trap 'exit 1' INT TERM HUP
fi
scan=$work/bake-$1
low=$work/bake-low.obj

say()
{
    echo "bench-maps: $*" >&2
}

if [ ! -f "$scan.nvdb" ] || [ ! -f "$scan.tris" ]; then
    say "making a scan of $triangles triangles"
    # Sixteen materials, for the map id.
    "$TESTS/generate-scan" --triangles $triangles vase -o "$work/plain.obj" >&2
    awk -v step=$((triangles / 16)) '/^f/ && faces++ % step == 0 { print "usemtl m" faces } 1' "$work/plain.obj" >"$scan.obj"
    rm "$work/plain.obj"
    "$BIN/bisque-voxelize" --progress none "$scan.obj" -o "$scan.nvdb" --resolution $resolution --channels id >&2
    rm "$scan.obj"
fi
"$TESTS/generate-scan" vase-low -o "$low" >&2

say "maps and rays"
"$TESTS/bench-maps" "$scan.nvdb" "$scan.tris" "$low" $size 1 64 "$rounds"

say "visits"
echo
"$TESTS/tree-visits" "$scan.nvdb" "$low" 256 16

say "rays on triangles"
echo
"$TESTS/bench-exact-rays" "$scan.tris" $((size * size)) 64 "$rounds"

# seconds COMMAND...: prints its processor time.
seconds()
{
    say "$*"
    (
        "$@" >/dev/null
        times
    ) | tail -n 1 |
        awk '{ for (i = 1; i <= 2; i++) { split($i, t, /[ms]/); s += 60 * t[1] + t[2] } printf "%.2f", s }'
}

# bake SCAN SIZE MAPS: without the preview.
bake()
{
    "$BIN/bisque-bake" --progress none --device cpu --size "$2" --samples 1 --maps "$3" \
        --rays ao=64,thickness=64 -o "$work/map_<MAP>.exr" "$1" "$low"
    rm -f "$work"/map_*.exr
}

echo
echo "Processor time of whole bakes, $all x $all texels, one sample each:"
echo
echo "| maps | seconds |"
echo "|:-----|--------:|"
for maps in normal normal,height,position normal,curvature normal,ao normal,ao,bent normal,thickness all; do
    echo "| $maps | $(seconds bake "$scan.nvdb" $all $maps) |"
done

voxelize()
{
    "$BIN/bisque-voxelize" --progress none --resolution $resolution "$scan.tris" -o "$work/again.nvdb"
    rm "$work/again.nvdb"
}

# levels JOB COMMAND...: prints a row with the medians of rounds that take turns.
levels()
{
    job=$1
    shift
    for round in $(seq "$rounds"); do
        for level in avx512 avx2 sse4.2; do
            export BSQ_SIMD=$level
            echo "$level $(seconds "$@")"
        done
    done | sort -k 1,1 -k 2,2n | awk -v job="$job" -v rounds="$rounds" '
        ++seen[$1] == int((rounds + 1) / 2) { s[$1] = $2 }
        END {
            printf "| %s | %.2f | %.2f | %.2f | %.2f | %.2f |\n", job, s["avx512"], s["avx2"], s["sse4.2"],
                s["avx2"] / s["avx512"], s["sse4.2"] / s["avx512"]
        }'
}

# Jobs say if the processor lacks an instruction set; the next one below it is measured then.
echo
echo "Processor time in seconds with each instruction set:"
echo
echo "| job | AVX-512 | AVX2 | SSE4.2 | AVX2 / AVX-512 | SSE4.2 / AVX-512 |"
echo "|:----|--------:|-----:|-------:|---------------:|-----------------:|"
levels "voxelizing chunks" voxelize
levels "grid: normal, $all" bake "$scan.nvdb" $all normal
levels "grid: normal, ao, $size" bake "$scan.nvdb" $size normal,ao
levels "exact: normal, $all" bake "$scan.tris" $all normal
levels "exact: normal, ao, $((size / 2))" bake "$scan.tris" $((size / 2)) normal,ao

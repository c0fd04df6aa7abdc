#!/bin/sh
# Measures what maps cost beside the normal map, how many secondary rays a grid traces beside Embree, and where the time of
# --maps all goes. All is processor time. Prints tables in Markdown; tests/bench/BAKE.md says how to read them.
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

# seconds MAPS: prints the processor time of a bake, without the preview.
seconds()
{
    say "--maps $1"
    (
        "$BIN/bisque-bake" --progress none --device cpu --size $all --samples 1 --maps "$1" \
            -o "$work/map_<MAP>.exr" "$scan.nvdb" "$low" >/dev/null
        times
    ) | tail -n 1 |
        awk '{ for (i = 1; i <= 2; i++) { split($i, t, /[ms]/); s += 60 * t[1] + t[2] } printf "%.2f", s }'
    rm -f "$work"/map_*.exr
}

echo
echo "Processor time of whole bakes, $all x $all texels, one sample each:"
echo
echo "| maps | seconds |"
echo "|:-----|--------:|"
for maps in normal normal,height,position normal,curvature normal,ao normal,ao,bent normal,thickness all; do
    echo "| $maps | $(seconds $maps) |"
done

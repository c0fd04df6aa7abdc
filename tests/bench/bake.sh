#!/bin/sh
# Measures how fast every device traces rays, compared with Embree on the same rays, and where a whole bake
# spends its time. Prints tables in Markdown; tests/bench/BAKE.md says how to read them.
#
#   BIN=DIR TESTS=DIR tests/bench/bake.sh small|medium
#
#   BIN, TESTS     directories with the programs, and with generate-scan and bench-rays
#   BENCH_DIR      directory for scans and maps, where scans are kept for the next run; default: a temporary directory
#   BENCH_SCAN     an OBJ file to amplify instead of the vase, and BENCH_LOW, its low-poly mesh
#   BENCH_ROUNDS   rounds; tables show the median (default: 1 for medium, 3 for small)
set -eu
LC_ALL=C
export LC_ALL
case ${1:-} in
small) triangles=1000000 resolution=768 size=1024 rounds=${BENCH_ROUNDS:-3} ;;
medium) triangles=10000000 resolution=2048 size=4096 rounds=${BENCH_ROUNDS:-1} ;;
*)
    echo "usage: BIN=DIR TESTS=DIR tests/bench/bake.sh small|medium" >&2
    exit 64
    ;;
esac

if [ -n "${BENCH_DIR:-}" ]; then
    mkdir -p "$BENCH_DIR"
    work=$BENCH_DIR
else
    work=$(mktemp -d "${TMPDIR:-/tmp}/bench-bake.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    trap 'exit 1' INT TERM HUP
fi
scan=$work/bake-$1${BENCH_SCAN:+-$(basename "$BENCH_SCAN" .obj)}
low=${BENCH_LOW:-$work/bake-low.obj}

say()
{
    echo "bench-bake: $*" >&2
}

if [ ! -f "$scan.nvdb" ] || [ ! -f "$scan.tris" ]; then
    say "making a scan of $triangles triangles"
    "$TESTS/generate-scan" --triangles $triangles "${BENCH_SCAN:-vase}" -o "$scan.obj"
    "$BIN/bisque-voxelize" --progress none "$scan.obj" -o "$scan.nvdb" --resolution $resolution >&2
    rm "$scan.obj"
fi
[ -n "${BENCH_LOW:-}" ] || "$TESTS/generate-scan" vase-low -o "$low"

begin=$(date +%s)
say "rays"
"$TESTS/bench-rays" "$scan.nvdb" "$scan.tris" "$low" $size 2 "$rounds"

# number NAME: prints a number of the last report.
number()
{
    sed -n "s/.*\"$1\": *\\([-0-9.e+]*\\).*/\\1/p" "$work/report" | head -n 1
}

echo
echo "Seconds of a whole bake with mask and padding of 16; of several queues' kernels and copies those at the same time"
echo "count once:"
echo
echo "| device | open | of it upload | trace | of it kernels | copies | padding | resolve | file | all |"
echo "|:-------|-----:|-------------:|------:|--------------:|-------:|--------:|--------:|-----:|----:|"
for device in $("$BIN/bisque-bake" --list devices --progress none 2>/dev/null | awk '{ print $1 }'); do
    say "whole bake on $device"
    "$BIN/bisque-bake" --json --progress none --device "$device" --size $size --maps normal,mask \
        -o "$work/map_<MAP>.exr" "$scan.nvdb" "$low" >"$work/report" || continue
    printf '| %s | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f |\n' "$device" "$(number seconds_open)" \
        "$(number seconds_upload)" "$(number seconds_trace)" "$(number seconds_kernels)" "$(number seconds_copies)" \
        "$(number seconds_padding)" "$(number seconds_resolve)" "$(number seconds_write)" "$(number seconds)"
    rm -f "$work"/map_*.exr
done
echo
echo "The run took $(($(date +%s) - begin)) s."

#!/bin/sh
# Measures bisque-bake on the GPUs of this machine and prints tables in Markdown: whole bakes on cpu, cuda and opencl, and how
# their maps agree with the processor's.
#
#   tests/bench/gpu.sh [small|full]
#
#   small          1024 x 1024 with 2 x 2 samples from a grid of 512 voxels; to try the script
#   full           4096 x 4096 with 4 x 4 samples from a grid of 2048 voxels (default)
#   BENCH_BUNDLE   a directory made by `make gpu-bundle`, with programs and libraries; default: build/gpu if it exists,
#                  else the programs are built
#   BENCH_DIR      directory for scans and maps, where scans are kept for the next run; default: a temporary directory
#   BENCH_ROUNDS   runs of each bake, of which the fastest counts (default: 3)
#
# It needs the driver of a GPU, and nothing else with a bundle. If a step fails, it prints a line and continues.
set -u
LC_ALL=C
export LC_ALL
top=$(cd "$(dirname "$0")/../.." && pwd) || exit 66
case ${1:-full} in
small) triangles=100000 resolution=512 size=1024 samples=2 ;;
full) triangles=4000000 resolution=2048 size=4096 samples=4 ;;
*)
    echo "usage: tests/bench/gpu.sh [small|full]" >&2
    exit 64
    ;;
esac
rounds=${BENCH_ROUNDS:-3}

bundle=${BENCH_BUNDLE:-$top/build/gpu}
if [ -d "$bundle" ]; then
    bundle=$(cd "$bundle" && pwd)
else
    bundle=$top/build/gpu
    make -C "$top" gpu-bundle >&2 || exit 70
fi
LD_LIBRARY_PATH=$bundle/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
export LD_LIBRARY_PATH
PATH=$bundle/bin:$PATH

if [ -n "${BENCH_DIR:-}" ]; then
    mkdir -p "$BENCH_DIR" && cd "$BENCH_DIR" || exit 73
else
    directory=$(mktemp -d) || exit 73
    trap 'rm -rf "$directory"' EXIT
    trap 'exit 75' INT TERM HUP
    cd "$directory" || exit 73
fi

say() { echo "gpu: $*" >&2; }

# field NAME FILE: prints a value of a JSON object with one value a line.
field() { sed -n "s/^ *\"$1\": *\(.*\)/\1/p" "$2" | sed 's/,$//; s/^"\(.*\)"$/\1/' | head -n 1; }

# seconds NAME FILE: prints a value to three digits.
seconds() { awk -v s="$(field "$1" "$2")" 'BEGIN { printf "%.3f", s }'; }

# ---- the scan ----

scan=scan-$resolution.nvdb
if [ ! -s "$scan" ]; then
    say "generating $triangles triangles, $resolution voxels"
    generate-scan --triangles $triangles --colors vase -o scan.obj >&2 &&
        generate-scan vase-low -o low.obj >&2 &&
        bisque-voxelize --progress none --no-tris --resolution $resolution scan.obj -o "$scan" >&2 || exit 70
    rm -f scan.obj
fi

# ---- devices ----

echo "## Devices"
echo
echo '```'
command -v nvidia-smi >/dev/null &&
    nvidia-smi --query-gpu=name,driver_version,memory.total,pcie.link.gen.max --format=csv,noheader
echo "$(uname -m), $(nproc) processors, $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1)"
bisque-bake --list devices 2>warnings
cat warnings
setting=$(sed -n 's/.*this does it: export //p' warnings | head -n 1)
if [ -n "$setting" ]; then
    echo "\$ export $setting"
    export "${setting?}"
    bisque-bake --list devices 2>&1
fi
echo '```'
echo

# ---- bakes ----

# bake DEVICE TYPE DESTINATION: bakes maps of an OpenEXR type; writes the report to a file.
bake()
{
    bisque-bake --progress none --json --device "$1" --size $size --samples $samples --type "$2" --maps normal,color,mask \
        "$scan" low.obj -o "$1_<MAP>.exr" >"$3" 2>bake.err || {
        say "$1: $(cat bake.err)"
        return 1
    }
}

# bake_often DEVICE: bakes in all rounds; keeps the fastest report as DEVICE.json, and maps of full precision.
bake_often()
{
    best="" left=$rounds
    while [ "$left" -gt 0 ]; do
        bake "$1" half round.json || return 1
        wall=$(field seconds round.json)
        if [ -z "$best" ] || awk "BEGIN { exit !($wall < $best) }"; then
            best=$wall
            cp round.json "$1.json"
        fi
        left=$((left - 1))
        [ "$1" != cpu ] || left=0
    done
    bake "$1" float round.json
}

# agreement DEVICE: prints how its maps agree with the processor's.
agreement()
{
    same=yes
    for map in normal color mask; do
        cmp -s cpu_$map.exr "$1_$map.exr" || same=no
    done
    if [ $same = yes ]; then
        echo "the same bytes"
    else
        bisque-compare "$1_normal.exr" cpu_normal.exr >compared 2>&1
        grep '^degrees' compared >/dev/null && grep -E '^(degrees|share)' compared | paste -sd ';' || echo "cannot be compared"
    fi
}

bakes()
{
    echo "## Whole bakes: $size x $size texels, $samples x $samples samples, grid of $resolution voxels ($(wc -c <"$scan") bytes)"
    echo
    echo "Seconds; the fastest of $rounds runs (cpu: one) of normal, colour and mask as half floats. Open includes the upload;"
    echo "kernels and copies run within trace; GB/s are the grid's bytes by the upload. Maps are compared as floats."
    echo
    echo "| device | all | open | upload | GB/s | trace | kernels | calls | copies | padding | resolve | write |" \
        "10^9 pairs/s in kernels | maps |"
    echo "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
    for device in cpu cuda opencl; do
        bake_often $device || continue
        f=$device.json
        printf '| %s: %s ' $device "$(field device $f)"
        for name in seconds seconds_open seconds_upload; do
            printf '| %s ' "$(seconds $name $f)"
        done
        awk -v n="$(wc -c <"$scan")" -v s="$(field seconds_upload $f)" \
            'BEGIN { if (s > 0) printf "| %.2f ", n / s / 1e9; else printf "| – " }'
        for name in seconds_trace seconds_kernels; do
            printf '| %s ' "$(seconds $name $f)"
        done
        printf '| %s ' "$(field kernel_calls $f)"
        for name in seconds_copies seconds_padding seconds_resolve seconds_write; do
            printf '| %s ' "$(seconds $name $f)"
        done
        awk -v n="$(field samples $f)" -v s="$(field seconds_kernels $f)" \
            'BEGIN { if (s > 0) printf "| %.3f ", n / s / 1e9; else printf "| – " }'
        if [ $device = cpu ]; then
            echo "| reference |"
        else
            echo "| $(agreement $device) |"
        fi
    done
    echo
}

bakes

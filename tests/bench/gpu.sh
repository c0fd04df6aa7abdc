#!/bin/sh
# Measures bisque on a machine with a GPU and prints tables in Markdown: bakes on the GPU beside the processor's, with the
# times that were recorded on an H100 with 16 cores, and whether the maps have the same bytes; then a large scan with more
# and more threads. One run takes at most BENCH_SECONDS: what would take longer is left out, and its row says so.
#
#   tests/bench/gpu.sh [small|full]
#
#   small          maps of a sixteenth of the side, a scan of 50,000 triangles; to try the script
#   full           10 million triangles, a grid of 2048 voxels; 100 million with more and more threads (default)
#   BENCH_BUNDLE   a directory made by `make gpu-bundle`, with programs and libraries (default: build/gpu)
#   BENCH_DEVICE   the device to measure (default: cuda if there is one, else opencl)
#   BENCH_DIR      directory for scans and maps, where scans are kept for the next run (default: a temporary directory)
#   BENCH_SECONDS  default: 285
#
# It needs the driver of a GPU, a POSIX shell with awk and cmp, and 16 GB of disk. If a step fails, it prints a line and
# continues.
set -u
LC_ALL=C
export LC_ALL
started=$(date +%s)
top=$(cd "$(dirname "$0")/../.." && pwd) || exit 66
case ${1:-full} in
small) triangles=50000 many=200000 resolution=128 divisor=16 ;;
full) triangles=10000000 many=100000000 resolution=2048 divisor=1 ;;
*)
    echo "usage: tests/bench/gpu.sh [small|full]" >&2
    exit 64
    ;;
esac
end=$((started + ${BENCH_SECONDS:-285}))
bundle=$(cd "${BENCH_BUNDLE:-$top/build/gpu}" && pwd) || exit 66
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

say() { echo "gpu: $(($(date +%s) - started)) s: $*" >&2; }

# in_time SECONDS: whether a step that takes so long on the recorded machine ends in time.
in_time() { [ $(($(date +%s) + $1 / divisor)) -lt "$end" ]; }

# field NAME FILE: prints a value of a JSON object with one value a line.
field() { sed -n "s/^ *\"$1\": *\(.*\)/\1/p" "$2" | sed 's/,$//; s/^"\(.*\)"$/\1/' | head -n 1; }

# seconds NAME... FILE: prints a sum of values, to two digits.
seconds()
{
    sum="" file=""
    for file; do :; done
    for name; do
        [ "$name" = "$file" ] || sum="$sum $(field "$name" "$file")"
    done
    echo "$sum" | awk '{ for (i = 1; i <= NF; i++) s += $i; printf "%.2f", s }'
}

# make_scan NAME TRIANGLES: generates an OBJ file.
make_scan()
{
    [ -s "$1.obj" ] || generate-scan --triangles "$2" --colors vase -o "$1.obj" >&2
}

# ---- the machine ----

machine()
{
    echo "## The machine"
    echo
    echo '```'
    command -v nvidia-smi >/dev/null &&
        nvidia-smi --query-gpu=name,driver_version,memory.total,pcie.link.gen.max --format=csv,noheader
    echo "$(uname -m), $(nproc) processors, $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1)"
    bisque-bake --list devices 2>&1 | tee devices
    setting=$(sed -n 's/.*this does it: export //p' devices | head -n 1)
    if [ -n "$setting" ]; then
        echo "\$ export $setting"
        export "${setting?}"
        bisque-bake --list devices 2>&1 | tee devices
    fi
    echo '```'
    echo
}

# ---- bakes ----

# bake DEVICE OPTION...: bakes half-float maps DEVICE_<MAP>.exr; writes the report to DEVICE.json.
bake()
{
    on=$1
    shift
    bisque-bake --progress none --json --device "$on" "$@" low.obj -o "${on}_<MAP>.exr" >"$on.json" 2>bake.err && return 0
    say "$on $*: $(cat bake.err)"
    return 1
}

# device_cell DEVICE RAYS OPTION...: bakes three times on a device and describes the fastest; RAYS are those of a texel.
device_cell()
{
    on=$1 rays=$2 cell=""
    shift 2
    for _ in 1 2 3; do
        in_time "$estimate" || break
        bake "$on" "$@" || { cell=none && break; }
        cell=$(awk -v cell="$cell" -v wall="$(seconds seconds "$on.json")" -v kernels="$(field seconds_kernels "$on.json")" \
            -v core="$(seconds seconds_user seconds_system "$on.json")" -v texels="$(field covered_texels "$on.json")" \
            -v traced="$(field seconds_trace "$on.json")" -v rays="$rays" 'BEGIN {
                split(cell, before)
                if (cell != "" && before[1] + 0 <= wall + 0) { printf "%s", cell; exit }
                on_card = (kernels > 0 ? sprintf("kernels %.2f, ", kernels) : "")
                busy = (kernels > 0 ? kernels : traced)
                rate = (rays > 0 && busy > 0 ? sprintf("; %.0f million rays/s", texels * rays / busy / 1e6) : "")
                printf "%s s (%s%s s of processors%s)", wall, on_card, core, rate
            }')
        [ "$on" != cpu ] || break
    done
    printf '%s' "${cell:-no time left}"
}

# row NAME RECORDED RAYS GPU_SECONDS CPU_SECONDS SCAN SIZE OPTION...: bakes on the device and on the processor, unless its
# seconds are 0, and compares the maps. RECORDED: what was measured.
row()
{
    name=$1 recorded=$2 rays=$3 gpu_seconds=$4 cpu_seconds=$5 scan=$6 size=$(($7 / divisor))
    shift 7
    say "$name"
    rm -f ./*_*.exr
    estimate=$gpu_seconds
    printf '| %s | %s ' "$name" "$(device_cell "$device" "$rays" --size $size "$@" "$scan")"
    estimate=$cpu_seconds
    if [ "$cpu_seconds" -gt 0 ]; then
        printf '| %s ' "$(device_cell cpu "$rays" --size $size "$@" "$scan")"
    else
        printf '| – '
    fi
    same="–"
    for map in cpu_*.exr; do
        other=$device${map#cpu}
        if [ ! -e "$map" ] || [ ! -e "$other" ]; then
            continue
        fi
        [ "$same" != "–" ] || same=same
        cmp -s "$map" "$other" || same="${map#cpu_} differs"
    done
    echo "| $recorded | $same |"
}

bakes()
{
    echo "## Bakes: $triangles triangles, grid of $resolution voxels ($(wc -c <scan.nvdb) bytes), $device"
    echo
    echo "Maps of an OBJ's grid with 2 x 2 samples, unless their name says otherwise; the fastest of three runs (processor: one)."
    echo "Recorded: an H100 with 16 cores, before secondary rays went through a tree; / separates the card from the cores."
    echo "Through the triangles of such a scan, OptiX 9.0 traced 737 million rays/s on that card (100 million: 877)."
    [ $divisor -eq 1 ] || echo "Sides are those of the names divided by $divisor."
    echo
    echo "| job | $device | processor | recorded | bytes |"
    echo "|:--|:--|:--|:--|:--|"
    row "normal 512²" "0.55 s / –" 0 1 1 scan.nvdb 512 --maps normal
    row "ao 4096², 256 rays a texel" "7.6 s, 310 million rays/s / 41 s, 52" 256 8 0 scan.nvdb 4096 --maps ao --rays ao=256
    row "ao 2048², 256 rays a texel" "– / a quarter of 41 s" 256 2 11 scan.nvdb 2048 --maps ao --rays ao=256
    row "normal 4096²" "1.06 / 0.95 s" 0 1 1 scan.nvdb 4096 --maps normal
    row "normal 8192²" "1.5 / 3.2 s" 0 2 4 scan.nvdb 8192 --maps normal
    row "all maps 2048²" "3.1 / 18.3 s" 0 4 19 scan.nvdb 2048 --maps all
    row "all maps 2048², 4 threads" "5.3 s / –" 0 5 0 scan.nvdb 2048 --maps all --threads 4
    row "exact ao 1024², 64 rays" "– / 3.5 s, 10 million rays/s" 64 2 4 scan.tris 1024 --maps ao --rays ao=64
    if [ -s "$device.json" ]; then
        row "exact ao 4096², 64 rays" "– / –" 64 4 0 scan.tris 4096 --maps ao --rays ao=64
        row "exact normal 8192²" "– / –" 0 4 6 scan.tris 8192 --maps normal
    fi
    for alone in normal:0.6:0.9 color:0.6:1 mask:0.6:0.9 height:0.6:0.9 position:0.6:0.9 confidence:0.6:1.5 curvature:1.8:1.5 \
        ao:1.0:7.1 bent:1.0:7.1 thickness:1.2:10.7; do
        map=${alone%%:*} times=${alone#*:}
        cores=${times#*:}
        row "$map 2048²" "${times%:*} / $cores s" 0 1 $((${cores%.*} + 1)) scan.nvdb 2048 --maps "$map"
    done
    if [ "$device" = cuda ] && grep -q '^opencl:' devices; then
        device=opencl
        row "ao 4096², 256 rays, OpenCL" "kernels 1.15 times CUDA's, 125 s of processors / –" 256 9 0 scan.nvdb 4096 --maps ao \
            --rays ao=256
        row "all maps 2048², OpenCL" "– / 18.3 s" 0 4 19 scan.nvdb 2048 --maps all
        device=cuda
    fi
    rm -f ./*_*.exr
    echo
}

# ---- threads ----

# threads COUNT SECONDS RECORDED: makes the large scan's grid, and simplifies it on as many threads as there are.
threads()
{
    if ! in_time "$2"; then
        echo "| grid, $1 threads | no time left | | | | $3 |"
        return
    fi
    say "$1 threads"
    bisque-voxelize --progress none --json --threads "$1" --resolution $resolution many.obj -o many.nvdb >many.json || return
    printf '| grid, %s threads | %s | %s | %s | %s | %s |\n' "$1" "$(seconds seconds many.json)" \
        "$(seconds seconds_user seconds_system many.json)" "$(seconds seconds_read many.json)" \
        "$(seconds seconds_sort many.json)" "$3"
}

scales()
{
    echo "## Threads: $many triangles"
    echo
    echo "| job | s | s of processors | read | sort | recorded |"
    echo "|:--|--:|--:|--:|--:|--:|"
    if ! in_time 40 || ! make_scan many $many; then
        echo "| – | no time left | | | | |"
        return
    fi
    for of in 16:5:4.05 8:7:5.5 4:11:9.5 2:19:17.6; do
        rest=${of#*:}
        [ "${of%%:*}" -gt "$(nproc)" ] || threads "${of%%:*}" "${rest%:*}" "${rest#*:}"
    done
    if in_time 7 && [ -s many.tris ]; then
        bisque-simplify --progress none --json many.tris -o many_low.obj --triangles 20000 >many.json &&
            echo "| simplify to 20,000 | $(seconds seconds many.json) | $(seconds seconds_user seconds_system many.json) | | | 5.35 |"
    fi
    echo
    if [ -s many.tris ]; then
        echo "| job | $device | processor | recorded | bytes |"
        echo "|:--|:--|:--|:--|:--|"
        row "exact normal 8192², $many triangles" "– / 33 s" 0 12 34 many.tris 8192 --maps normal
    fi
}

machine
device=${BENCH_DEVICE:-$(sed -n 's/^\(cuda\|opencl\):0 .*/\1/p' devices | head -n 1)}
if [ -z "$device" ]; then
    say "there is no device beside the processor"
    exit 69
fi
say "making a scan of $triangles triangles"
generate-scan vase-low -o low.obj >&2 && make_scan scan $triangles &&
    bisque-voxelize --progress none --resolution $resolution scan.obj -o scan.nvdb >&2 || exit 70
say "the first bake, for which a driver may compile the kernel"
bake "$device" --size 16 --maps all scan.nvdb && echo "The first bake took $(seconds seconds "$device.json") s." && echo
bakes
for scan in scan.nvdb scan.tris; do
    if ! command -v compute-sanitizer >/dev/null || ! in_time 30; then
        continue
    fi
    echo "compute-sanitizer, all maps 64² of $scan: $(compute-sanitizer bisque-bake --progress none --device "$device" \
        --size 64 --maps all $scan low.obj -o 'checked_<MAP>.exr' 2>&1 | grep 'ERROR SUMMARY')"
    echo
done
scales
say "finished"

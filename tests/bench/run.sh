#!/bin/sh
# Measures bisque-voxelize and other programs on the same scans, and prints tables in Markdown.
# tests/bench/RESULTS.md says how to read them.
#
#   BIN=DIR TESTS=DIR tests/bench/run.sh small|medium|large
#
#   BIN, TESTS     directories with the programs, and with generate-scan, measure and the baselines
#   BENCH_DIR      directory for scans and outputs, where scans are kept for the next run; default: a
#                  temporary directory beside BIN, which is removed at the end
#   BENCH_SCAN     a small OBJ file to amplify instead of the vase
#   BENCH_PYTHON   a Python that may have open3d and trimesh, whose readers are baselines; default:
#                  python3
#   BENCH_ROUNDS   how often each job runs (default: 3; with 109 million triangles: 2)
#
# Each job runs once a round, so that slow drifts of the machine affect all jobs alike. No job may
# influence the next one. Before each job, its scan is read into the page cache, what earlier jobs wrote
# is flushed to disk, and as much memory as the job needs is prefaulted and freed. The host of a virtual
# machine may reclaim freed memory after some seconds; getting it back takes two or three seconds a
# gigabyte. Jobs whose ratio to "whole" is measured run directly after it; those that free most memory
# run last.
set -u
LC_ALL=C
export LC_ALL
unset TMPDIR

size=${1:-medium}
case $size in
small | medium | large) ;;
*)
    echo "usage: BIN=DIR TESTS=DIR tests/bench/run.sh small|medium|large" >&2
    exit 64
    ;;
esac
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd) || exit 66
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd) || exit 66
here=$(cd "$(dirname "$0")" && pwd) || exit 66
rounds=${BENCH_ROUNDS:-3}
processors=$(nproc)
failed=0

if [ -n "${BENCH_DIR:-}" ]; then
    mkdir -p "$BENCH_DIR" && scans=$(cd "$BENCH_DIR" && pwd) || exit 73
    work=$(mktemp -d "$scans/work.XXXXXX") || exit 73
    remove=$work
else
    scans=$(mktemp -d "$(dirname "$BIN")/bench.XXXXXX") || exit 73
    work=$scans
    remove=$scans
fi
trap 'rm -rf "$remove"' EXIT
trap 'exit 75' INT TERM HUP
records=$work/records
: >"$records"

say()
{
    echo "bench: $*" >&2
}

# record FIELD...: writes a line of table.awk's input.
record()
{
    line=$1
    shift
    for field; do
        line="$line	$field"
    done
    printf '%s\n' "$line" >>"$records"
}

# value NAME FILE: prints VALUE of a line NAME=VALUE.
value()
{
    sed -n "s/^$1=//p" "$2"
}

# json_number NAME FILE
json_number()
{
    sed -n "s/.*\"$1\": *\\([0-9][0-9]*\\).*/\\1/p" "$2"
}

bytes_of()
{
    wc -c <"$1" | tr -d ' '
}

# ---- the machine ----

describe_machine()
{
    cpu=$(sed -n 's/^model name[^:]*: *//p' /proc/cpuinfo | head -n 1)
    memory=$(awk '/^MemTotal/ { printf "%.1f GiB", $2 / 1048576 }' /proc/meminfo)
    os=$(sed -n 's/^PRETTY_NAME="\(.*\)"/\1/p' /etc/os-release 2>/dev/null)
    "$TESTS/measure" "$work/report" dd if=/dev/zero of="$work/probe" bs=1M count=128 conv=fsync \
        2>/dev/null
    disk=$(sed 's/wall=\([0-9.]*\).*/\1/' "$work/report" |
        awk '{ printf "%.0f MB/s written and synced", 134.217728 / $1 }')
    rm -f "$work/probe"
    echo "- Date: $(date -u +%Y-%m-%d), $("$BIN/bisque-voxelize" --version | head -n 1)"
    echo "- Processor: ${cpu:-unknown} ($(uname -m)), $processors processors"
    echo "- Memory: $memory"
    echo "- System: $(uname -sr), ${os:-unknown}"
    echo "- Disk: $(df --output=fstype "$work" | tail -n 1), $disk"
    echo "- Load before the run: $(cut -d ' ' -f 1-3 /proc/loadavg)"
    echo "- Scan: ${scan_name}, amplified"
}

kib_free()
{
    df -Pk "$work" | awk 'NR == 2 { print $4 }'
}

# require_disk TRIANGLES LABEL: checks that both scans, a chunk file and temporary files fit the disk.
require_disk()
{
    need=$(($1 * 195 / 1024 + 1024 * 1024))
    for scan in "$2" "$2-shuffled" "$2 ply" "$2 ply.gz" "$2 ply.zst"; do
        # shellcheck disable=SC2086 # a name, and a suffix or none
        scan=$(scan_path $scan)
        [ ! -f "$scan" ] || need=$((need - $(bytes_of "$scan") / 1024))
    done
    free=$(kib_free)
    [ "$free" -ge "$need" ] && return
    say "$scans: needs $((need / 1048576 + 1)) GiB of disk, $((free / 1048576)) GiB are free;" \
        "name another directory with BENCH_DIR"
    exit 74
}

# has_memory BYTES: checks that this much memory is available without swapping.
has_memory()
{
    awk -v need="$1" '/^MemAvailable/ { exit !($2 * 1024 >= need) }' /proc/meminfo
}

# ---- scans ----

# The small scan: the vase's low-poly mesh, or the file that BENCH_SCAN names.
choose_source()
{
    source=${BENCH_SCAN:-$work/low.obj}
    scan_name=${BENCH_SCAN:+$(basename "$source")}
    scan_name=${scan_name:-vase}
    [ -n "${BENCH_SCAN:-}" ] || "$TESTS/generate-scan" vase-low -o "$source" || exit 73
    [ -r "$source" ] || {
        say "$source: cannot be read"
        exit 66
    }
}

# scan_path NAME [SUFFIX]
scan_path()
{
    echo "$scans/${scan_name%.obj}-$1.${2:-obj}"
}

# make_scan NAME SUFFIX TRIANGLES OPTION...: generates a scan unless it exists; sets $made to its path.
make_scan()
{
    made=$(scan_path "$1" "$2")
    count=$3
    shift 3
    [ -f "$made" ] && return
    say "generating $(basename "$made")"
    "$TESTS/generate-scan" --triangles "$count" "$@" "$source" -o "$work/part.${made##*.}" &&
        mv "$work/part.${made##*.}" "$made" || exit 73
}

# pack_scan SUFFIX COMMAND...: packs the PLY file unless that is done; sets $made to its path, or to
# nothing if the program is missing.
pack_scan()
{
    made=$ply.$1
    shift
    [ -f "$made" ] && return
    command -v "$1" >/dev/null || {
        made=
        return
    }
    say "packing $(basename "$made")"
    "$@" "$ply" >"$work/part" && mv "$work/part" "$made" || exit 73
}

# use_scans LABEL TRIANGLES: generates the scan in both orders, as PLY and as packed PLY; sets $label,
# $ordered, $shuffled, $ply and so on.
use_scans()
{
    label=$1
    require_disk "$2" "$1"
    make_scan "$1" obj "$2"
    ordered=$made
    make_scan "$1-shuffled" obj "$2" --shuffle 1
    shuffled=$made
    make_scan "$1" ply "$2"
    ply=$made
    pack_scan gz gzip -1 -c
    gz=$made
    pack_scan zst zstd -q -1 -c
    zst=$made
    bytes=$(bytes_of "$ordered")
    "$BIN/bisque-voxelize" --parse-only --json "$ordered" >"$work/out" || exit 70
    triangles=$(json_number triangles "$work/out")
}

# ---- jobs ----

# measure INPUT BYTES COMMAND...: runs a command after prefaulting BYTES of memory; sets wall, user,
# system, rss, written, status; its output goes to $work/out and $work/err.
measure()
{
    cat "$1" >/dev/null
    at_hand=$2
    shift 2
    sync
    "$TESTS/measure" --at-hand "$at_hand" "$work/report" "$@" >"$output" 2>"$work/err"
    sed 's/[a-z_]*=//g' "$work/report" >"$work/fields"
    read -r wall user system rss _ written status <"$work/fields"
}

# why: prints the error of the last command, or how it ended.
why()
{
    case $status in
    137) echo "stopped by the system, probably for lack of memory" ;;
    *) tail -n 1 "$work/err" | grep . || echo "exit status $status" ;;
    esac
}

# keep KEY TITLE AGAINST INPUT_BYTES: records the last measurement.
keep()
{
    record run "$label" "$round" "$1" "$2" "$3" "$triangles" "$4" \
        "$wall" "$user" "$system" "$rss" "$written"
}

job_cat()
{
    say "$label, round $round: cat"
    output=/dev/null
    measure "$ordered" 0 cat "$ordered"
    keep cat "cat" - "$bytes"
    measure "$ply" 0 cat "$ply"
    keep cat-ply "cat the PLY" - "$(bytes_of "$ply")"
    output=$work/out
}

# baseline PROGRAM TITLE BYTES_A_TRIANGLE INPUT: runs a baseline; if it cannot run, records why and
# fails. Its memory is known from smaller scans; a quarter more must be available.
baseline()
{
    if [ ! -x "$TESTS/$1" ]; then
        record skip "$label" "$2" "not built, its package is not installed"
        return 1
    fi
    program=$TESTS/$1
    shift
    measure_baseline "$@" "$program"
}

# measure_baseline TITLE BYTES_A_TRIANGLE INPUT COMMAND...: the same for a command.
measure_baseline()
{
    name=$1 each=$2 input=$3
    shift 3
    most=$((triangles * each * 5 / 4))
    if ! has_memory "$most"; then
        record skip "$label" "$name" "needs $((most / 1048576)) MiB of memory, less is available"
        return 1
    fi
    say "$label, round $round: $name"
    measure "$input" $((triangles * each)) "$@" "$input"
    [ "$status" -eq 0 ] && return
    record skip "$label" "$name" "$(why)"
    return 1
}

# add_phase NAME: adds the cost of a phase of a baseline to wall, user and system.
add_phase()
{
    wall=$(echo "$wall $(value "$1.wall" "$output")" | awk '{ print $1 + $2 }')
    user=$(echo "$user $(value "$1.user" "$output")" | awk '{ print $1 + $2 }')
    system=$(echo "$system $(value "$1.system" "$output")" | awk '{ print $1 + $2 }')
    rss=$(value "$1.rss_kib" "$output")
}

# The baselines measure their own phases, without start and freeing, which favours them.
job_embree()
{
    baseline baseline-embree "Embree: parse and build" 120 "$ordered" || return 0
    wall=0 user=0 system=0
    add_phase parse
    keep embree-parse "Embree: parse, 1 thread" - "$bytes"
    add_phase build
    keep embree "Embree: parse and build" - "$bytes"
}

job_tinyobj()
{
    baseline baseline-tinyobj "tinyobjloader: parse" 184 "$ordered" || return 0
    wall=0 user=0 system=0
    add_phase parse
    keep tinyobj "tinyobjloader: parse" embree-parse "$bytes"
}

# keep_reader KEY TITLE: records the phase "parse" of a reader of the PLY.
keep_reader()
{
    wall=0 user=0 system=0
    add_phase parse
    keep "$1" "$2" parse-ply "$(bytes_of "$ply")"
}

# Other readers of the PLY, one thread each. They run after Bisque's, which they are divided by.
job_ply_readers()
{
    baseline baseline-assimp "Assimp: read the PLY" 450 "$ply" &&
        keep_reader assimp-ply "Assimp: read the PLY"
    for library in open3d trimesh; do
        measure_baseline "$library: read the PLY" 150 "$ply" "${BENCH_PYTHON:-python3}" \
            "$here/baseline_reader.py" "$library" &&
            keep_reader "$library-ply" "$library: read the PLY"
    done
}

# job_unpack KEY INPUT PROGRAM: unpacks the packed PLY and keeps nothing.
job_unpack()
{
    say "$label, round $round: $3 -dc"
    output=/dev/null
    measure "$2" 0 "$3" -dc "$2"
    output=$work/out
    keep "$1" "$3 -dc" - "$(bytes_of "$2")"
}

# Packed PLY files.
job_packed()
{
    if [ -n "$gz" ]; then
        job_unpack gzip "$gz" gzip
        bisque parse-gz "parse only, .ply.gz" gzip "$gz" 0 --parse-only
    fi
    if [ -n "$zst" ]; then
        job_unpack zstd "$zst" zstd
        bisque parse-zst "parse only, .ply.zst" zstd "$zst" 0 --parse-only
    fi
}

# bisque KEY TITLE AGAINST INPUT BYTES ARGUMENT...: measures bisque-voxelize after prefaulting BYTES of
# memory; fails if it fails.
bisque()
{
    key=$1 name=$2 other=$3 input=$4 bytes_at_hand=$5
    shift 5
    say "$label, round $round: $name"
    measure "$input" "$bytes_at_hand" "$BIN/bisque-voxelize" --json --progress none "$@" "$input"
    if [ "$status" -ne 0 ]; then
        record skip "$label" "$name" "$(why)"
        # A budget that is too small for this many processors is a refusal, not a failure.
        grep -q 'is too small' "$work/err" || failed=1
        return 1
    fi
    keep "$key" "$name" "$other" "$(bytes_of "$input")"
}

# grid_facts KEY FACT...: records facts of the last report about its files.
grid_facts()
{
    key=$1
    shift
    for name; do
        record fact "$label" "$key" "$name" "$(json_number "$name" "$work/out")"
    done
}

job_parse()
{
    bisque "parse-1" "parse only, 1 thread" embree-parse "$ordered" 0 --parse-only --threads 1
    bisque "parse" "parse only, all threads" embree-parse "$ordered" 0 --parse-only
    bisque "parse-ply" "parse only, PLY, all threads" cat-ply "$ply" 0 --parse-only
}

# takes MEMORY: prints the bytes that a job with this budget takes, including the page cache of its
# files: 12 bytes a triangle for the chunk file, some more for temporary files, and a grid of 300 MiB.
takes()
{
    echo $(($(numfmt --from=iec "$1") + triangles * 32 + 512 * 1024 * 1024))
}

job_whole()
{
    rm -f "$work/whole.nvdb" "$work/whole.tris"
    bisque whole "whole: OBJ to .tris, .nvdb" embree "$ordered" "$(takes 1G)" \
        --resolution "$resolution" --memory 1G -o "$work/whole.nvdb" || return 0
    grid_facts whole tris_bytes temp_bytes grid_bytes voxels
}

# The same scan as binary PLY, plain and packed; its outputs are the same.
job_ply()
{
    bisque whole-ply "whole, from PLY" whole "$ply" "$(takes 1G)" --resolution "$resolution" \
        --memory 1G -o "$work/other.nvdb" && same_bytes "PLY"
    rm -f "$work/other.nvdb" "$work/other.tris"
    for packed in "$zst" "$gz"; do
        [ -n "$packed" ] || continue
        bisque "whole-${packed##*.}" "whole, from .ply.${packed##*.}" whole-ply "$packed" \
            "$(takes 1G)" --resolution "$resolution" --memory 1G -o "$work/other.nvdb" &&
            same_bytes ".ply.${packed##*.}"
        rm -f "$work/other.nvdb" "$work/other.tris"
    done
}

# job_grid KEY RESOLUTION AGAINST: makes a grid from the chunk file of job_whole.
job_grid()
{
    [ -f "$work/whole.tris" ] || return 0
    bisque "$1" ".tris to .nvdb at $2" "$3" "$work/whole.tris" "$(takes 1G)" --resolution "$2" \
        --memory 1G -o "$work/other.nvdb" && grid_facts "$1" grid_bytes voxels
    rm -f "$work/other.nvdb"
}

# same_bytes TITLE: in the first round, compares the outputs of the last run with those of job_whole.
same_bytes()
{
    [ "$round" -eq 1 ] && [ -f "$work/whole.tris" ] || return 0
    for ending in tris nvdb; do
        cmp -s "$work/whole.$ending" "$work/other.$ending" && continue
        say "FAILED: $label, $1: .$ending differs from that of the OBJ with a budget of 1G"
        failed=1
    done
}

job_ordered()
{
    bisque "whole-$1" "whole, --memory $1" whole "$ordered" "$(takes "$1")" \
        --resolution "$resolution" --memory "$1" -o "$work/other.nvdb" && same_bytes "--memory $1"
    rm -f "$work/other.nvdb" "$work/other.tris"
}

# job_shuffled KEY TITLE MEMORY
job_shuffled()
{
    bisque "$1" "$2" whole "$shuffled" "$(takes "$3")" --resolution "$resolution" \
        --memory "$3" -o "$work/other.nvdb" &&
        grid_facts "$1" tris_bytes temp_bytes grid_bytes voxels
    rm -f "$work/other.nvdb" "$work/other.tris"
}

# one_round BUDGET...: runs all jobs once, with these budgets besides 1 GiB.
one_round()
{
    job_cat
    job_parse
    job_packed
    job_whole
    job_ply
    job_grid revoxelize "$((resolution / 2))" whole
    job_shuffled shuffled "shuffled faces" 1G
    for memory; do
        job_ordered "$memory"
        job_shuffled "shuffled-$memory" "shuffled, --memory $memory" "$memory"
    done
    job_ply_readers
    job_tinyobj
    job_embree
}

# job_fine RESOLUTION: makes a fine grid, if it and as many bytes of temporary files fit the disk. The
# voxels of a surface grow with the square of the resolution.
job_fine()
{
    [ -f "$work/whole.nvdb" ] || return 0
    times=$(($1 / resolution))
    need=$(($(bytes_of "$work/whole.nvdb") * times * times * 22 / 10 / 1024))
    free=$(kib_free)
    if [ "$free" -lt "$need" ]; then
        record skip "$label" ".tris to .nvdb at $1" \
            "needs about $((need / 1048576)) GiB of disk, $((free / 1048576)) GiB are free"
        return 0
    fi
    job_grid "grid-$1" "$1" whole
}

# ---- the run ----

bench_small()
{
    resolution=1024
    use_scans 2M 2000000
    for round in $(seq "$rounds"); do
        one_round 256M
    done
}

bench_medium()
{
    resolution=2048
    use_scans 10M 10000000
    for round in $(seq "$rounds"); do
        one_round 256M 64M
    done
}

bench_large()
{
    bench_medium
    use_scans 109M 109000000
    for round in $(seq "${BENCH_ROUNDS:-2}"); do
        one_round 256M
    done
    [ -n "${BENCH_DIR:-}" ] || rm -f "$shuffled"
    job_fine 8192
    job_fine 16384
}

choose_source
describe_machine >"$work/machine"
begin=$(date +%s)
case $size in
small) bench_small ;;
medium) bench_medium ;;
large) bench_large ;;
esac
echo
cat "$work/machine"
awk -v threads="$processors" -f "$here/table.awk" "$records"
echo
echo "The run took $(($(date +%s) - begin)) s."
exit $failed

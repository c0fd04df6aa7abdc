#!/bin/sh
# test_limits.sh - bisque-voxelize under limits of the system: a hard limit on memory, and a disk
# that is too small.
. "$(dirname "$0")/lib.sh"
unsanitized "limits of the system" "sanitizers need memory of their own"

"$TESTS/generate-scan" --triangles 2000000 --colors vase -o vase.obj
ok run bisque-voxelize vase.obj -o vase.nvdb --resolution 512 --threads 2

# ---- memory ----

# Memory that a process may use beside its budget, with its program and stacks of threads.
limited()
{
    kind=$1 kib=$2
    shift 2
    command="ulimit $kind $kib; $*" program=$1 code=0
    shift
    (ulimit "$kind" "$kib" && exec "$BIN/$program" "$@") >"$out" 2>"$err" || code=$?
}

# RLIMIT_DATA counts anonymous memory, the heap and stacks of threads (8 MiB each). What the heap keeps
# of freed memory depends on which thread comes first, so there is space for that.
limited -d 122880 bisque-voxelize vase.obj -o small.nvdb --resolution 512 --memory 72M --threads 2 --json
code 0
json '.cost.memory_high_bytes <= .cost.memory_budget_bytes and .cost.memory_budget_bytes == 75497472'
# Its pages of mapped files count here too. How many there are depends on what else the system does.
[ -z "${LONG-}" ] || json '.cost.max_rss_bytes <= 100663296'
same vase.nvdb small.nvdb
same vase.tris small.tris
rm -f small.nvdb small.tris

# A budget above the limit fails with one line and leaves no file.
limited -d 40960 bisque-voxelize vase.obj -o small.nvdb --resolution 512 --memory 1G --threads 2
refused_like 71 '^bisque-voxelize: the system has no memory left: '
files vase.nvdb vase.obj vase.tris

run bisque-voxelize vase.obj -o small.nvdb --memory 16M --threads 2
refused_like 71 '^bisque-voxelize: --memory: 16.0 MiB is too small, 2 threads need at least [0-9]*MiB$'
least=$(sed -n 's/.*at least \([0-9]*\)MiB$/\1/p' "$err")
ok run bisque-voxelize vase.obj -o small.nvdb --resolution 512 --memory "${least}M" --threads 2
same vase.nvdb small.nvdb
rm -f small.nvdb small.tris

# RLIMIT_AS counts addresses too, of which the libraries for textures of some formats take many.
printf 'P6\n1 1\n255\nabc' >abc.ppm
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n' >face.obj
textured="bisque-voxelize face.obj --texture abc.ppm -o small.nvdb --no-tris --resolution 32 --memory 100M --threads 2"
limited -v 552960 $textured
code 0
rm small.nvdb
limited -v 460800 $textured
refused_like 71 '^bisque-voxelize: textures of this format need 512 MiB of addresses for their libraries$'
rm abc.ppm face.obj

# Too little memory has one exit code in all programs.
"$TESTS/generate-scan" vase-low -o low.obj
ok run bisque-bake vase.nvdb low.obj -o normal.exr --maps normal --device cpu --size 64
for scan in vase.nvdb vase.tris; do
    run bisque-bake $scan low.obj -o small.exr --maps normal --device cpu --size 64 --memory 1k
    refused_like 71 '^bisque-bake: the memory budget is too small: '
done
run bisque-compare normal.exr normal.exr --memory 1k
refused_like 71 '^bisque-compare: the memory budget is too small: '
run bisque-voxelize vase.tris -o small.nvdb --memory 1k
refused_like 71 '^bisque-voxelize: --memory: 1.0 KiB is too small, '
files low.obj normal.exr vase.nvdb vase.obj vase.tris
rm -f low.obj normal.exr

# Triangles, of which each two cover the whole map.
awk 'BEGIN {
    print "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1"
    for (i = 0; i < 4000; i++)
        print i % 2 ? "f 3/3 2/2 1/1" : "f 4/4 3/3 1/1"
}' >covering.obj
run bisque-bake vase.nvdb covering.obj -o small.exr --maps mask --device cpu --size 2048 --memory 16M --as-is
refused_like 71 'the memory budget is too small: low-poly triangles cover each other on the map, on average [0-9]+ in each patch of .* need [0-9]+ MiB, [0-9]+ MiB are left: a smaller --size needs less$'
rm covering.obj

# ---- disk ----

# small_disk MIB ARGUMENT...: runs bisque-voxelize with a disk of that size at "disk".
small_disk()
{
    size=$1
    shift
    command="bisque-voxelize $* on a disk of $size MiB" code=0
    unshare --map-root-user --mount sh -c '
        mount -t tmpfs -o size="$1"m tmpfs disk || exit 99
        program=$2
        shift 2
        "$program" "$@"
        code=$?
        ls -A disk >here.txt
        exit $code' sh "$size" "$BIN/bisque-voxelize" "$@" >"$out" 2>"$err" || code=$?
}

mkdir disk
if unshare --map-root-user --mount mount -t tmpfs -o size=1m tmpfs disk 2>/dev/null; then
    small_disk 8 vase.obj -o disk/a.nvdb --resolution 512
    refused_like 74 '^bisque-voxelize: disk/a\.tris: writing: No space left on device$'
    holds "nothing was written" [ ! -s here.txt ]

    # The grid's size is estimated when the chunk file is complete; that file stays, for another attempt.
    small_disk 50 vase.obj -o disk/a.nvdb --resolution 512
    refused_like 74 '^bisque-voxelize: disk: [0-9]* bytes are needed for outputs and temporary files, [0-9]* are free$'
    holds "the chunk file is left" [ "$(cat here.txt)" = a.tris ]

    # Temporary files need space in their own directory.
    small_disk 8 vase.obj -o a.nvdb --tmpdir disk --resolution 512 --memory "${least}M" --threads 2
    refused_like 74 '^bisque-voxelize: .*disk.*: No space left on device$'
    [ ! -s here.txt ] && [ ! -e a.tris ]
    check "nothing was written" $?

    small_disk 200 vase.obj -o disk/a.nvdb --resolution 512
    code 0

    # So does the chunk file that several become.
    ok run bisque-voxelize vase.obj -o whole.tris
    small_disk 40 whole.tris whole.tris -o a.nvdb --tmpdir disk --resolution 512
    refused_like 74 '^bisque-voxelize: disk: [0-9]* bytes are needed for temporary files, [0-9]* are free$'
    [ ! -s here.txt ] && [ ! -e a.nvdb ]
    check "nothing was written" $?
else
    skip "a disk that is too small is told" "no file systems can be mounted here"
fi

finish

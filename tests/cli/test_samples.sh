#!/bin/sh
# test_samples.sh - what an exact bake of a large scan reads: for distances the samples of its
# chunks, for a map each chunk once, whether all rays fit into memory or not.
. "$(dirname "$0")/lib.sh"
unsanitized "bytes that are read" "they would need a large scan"

read_bytes()
{
    awk '$1 == "rchar:" { print $2 }' "/proc/$$/io"
}

if ! [ -r "/proc/$$/io" ]; then
    skip "bytes that are read" "no /proc/self/io"
    finish
    exit
fi
"$TESTS/generate-scan" --triangles 17000000 vase -o scan.ply >"$out" &&
    "$TESTS/generate-scan" vase-low -o low.obj >"$out" || exit 1
ok run bisque-voxelize scan.ply -o scan.tris
size=$(stat -c %s scan.tris)
chunks=$(od -An -tu8 -j24 -N8 scan.tris | tr -d ' ')

before=$(read_bytes)
ok run bisque-bake scan.tris low.obj --maps normal --size 512 -o 'map_<MAP>.exr' --part 65536/65536
bytes=$(($(read_bytes) - before - 2 * $(stat -c %s low.obj)))
check "distances read $bytes bytes of $size: at most a twentieth" $((bytes * 20 > size))

ok run bisque-bake scan.tris low.obj --maps normal --size 512 -o 'map_<MAP>.exr' --json
json ".chunk_loads <= 1.1 * $chunks"
json '.maps.normal != null'

# Also if the rays of a map do not fit into memory: its batches go through the chunks in one sweep.
ok run bisque-bake scan.tris low.obj --maps normal --size 1024 -o 'whole_<MAP>.exr' --memory 4G
ok run bisque-bake scan.tris low.obj --maps normal --size 1024 -o 'swept_<MAP>.exr' --memory 384M \
    --json
json ".chunk_loads <= 1.1 * $chunks"
same whole_normal.exr swept_normal.exr
ok run bisque-bake scan.tris low.obj --maps normal --size 1024 -o 'small_<MAP>.exr' --memory 64M \
    --json
json ".chunk_loads > 1.1 * $chunks and .chunk_loads < 8 * $chunks"
same whole_normal.exr small_normal.exr
finish

#!/bin/sh
# test_pipeline.sh - both stages on whole scans, compared with the truth: the generated vase with
# its analytic normals and colours; the bunny and Spot, if SCANS is a folder with them, with exact
# maps.
SCANS=$(cd "${SCANS:-../shared/scans}" 2>/dev/null && pwd) || SCANS=
. "$(dirname "$0")/lib.sh"
unsanitized "whole scans beside the truth" "they would need large scans; other tests run this code under sanitizers"

# truth NAME CHECKER ARGUMENT...: the results are within the checker's limits.
truth()
{
    name=$1 command="$*"
    shift
    "$TESTS/$@" >"$out" 2>"$err"
    code=$?
    check "$name" $code
    sed 's/^/# /' "$out"
}

# ---- the vase: two million triangles, about two voxels wide each ----

triangles=2000000 resolution=768
"$TESTS/generate-scan" --triangles $triangles --colors vase -o vase.obj
"$TESTS/generate-scan" vase-low -o low.obj
ok run bisque-voxelize vase.obj -o vase.nvdb --resolution $resolution
ok run bisque-bake vase.nvdb low.obj --maps normal,color,mask --normal space=object --type float --size 512 \
    --samples 1 -o 'object_<MAP>.exr'
# The finest relief is 14 voxels and 11 triangles long. The normal at a vertex is a mean over its
# triangles, which flattens a wave of n triangles by about (2 pi / n)^2 / 6 of its slope: 5 % here.
# Facets would be off by 1.8 degrees.
truth "vase: normals and colours are the analytic ones" check-vase -m 0.9 -p 1.8 -h 0.9999 -c 0.01 \
    object_normal.exr object_mask.exr object_color.exr

# Voxels add little to the error of the triangles' own normals.
mean() { "$TESTS/check-vase" "$1" object_mask.exr | sed -n 's/.*mean angle: \([0-9.e-]*\).*/\1/p'; }
ok run bisque-bake vase.tris low.obj --maps normal --normal space=object --type float --size 512 --samples 1 -o exact.exr
awk "BEGIN { exit !($(mean object_normal.exr) < 1.1 * $(mean exact.exr)) }"
check "vase: normals from voxels are as good as those from triangles" $?

# Lookup of the nearest voxel is blockier: the option must make the result worse.
ok run bisque-bake vase.nvdb low.obj --maps normal,mask --normal space=object --type float --size 512 \
    --samples 1 --scan sampling=nearest -o 'nearest_<MAP>.exr'
awk "BEGIN { exit !($(mean nearest_normal.exr) > 1.5 * $(mean object_normal.exr)) }"
check "vase: blending over neighbours beats the nearest voxel" $?

# The same scan in other forms gives the same voxels: shuffled, geo-referenced, from the chunk file.
"$TESTS/generate-scan" --triangles $triangles --colors --offset 500000,5000000,100 vase -o far.obj
ok run bisque-voxelize far.obj -o far.nvdb --resolution $resolution --no-tris
"$TESTS/generate-scan" --offset 500000,5000000,100 vase-low -o far_low.obj
ok run bisque-bake far.nvdb far_low.obj --maps normal,color,mask --normal space=object --type float --size 512 \
    --samples 1 -o 'far_<MAP>.exr'
truth "vase 5000 km away: normals and colours keep their detail" check-vase -m 0.9 -p 1.8 -h 0.9999 -c 0.01 \
    far_normal.exr far_mask.exr far_color.exr
ok run bisque-voxelize vase.tris -o again.nvdb --resolution $resolution
same vase.nvdb again.nvdb

# The files do not depend on the budget or the number of threads.
ok run bisque-voxelize vase.obj -o small.nvdb --resolution $resolution --memory 96M --threads 3 --json
json '.cost.memory_high_bytes <= .cost.memory_budget_bytes'
same vase.nvdb small.nvdb
same vase.tris small.tris

# Independent readers accept the grid.
if command -v nanovdb_validate >/dev/null; then
    nanovdb_validate vase.nvdb >"$out" 2>"$err"
    check "nanovdb_validate accepts the grid" $?
    nanovdb_print vase.nvdb >"$out" 2>"$err" && grep -q 'Mask' "$out"
    check "nanovdb_print reads the grid" $?
else
    lacks "nanovdb_validate accepts the grid" "not installed"
fi

# ---- real scans ----

# against_exact NAME LIMITS TYPE: maps of a grid beside exact ones, whose hits unit tests compare with brute force.
against_exact()
{
    # shellcheck disable=SC2086 # several options
    ok run bisque-compare $1_nvdb_$3.exr $1_tris_$3.exr --mask-a $1_nvdb_mask.exr --mask-b $1_tris_mask.exr $2
}

if [ -n "$SCANS" ]; then
    ok run bisque-voxelize "$SCANS/bunny.obj" -o bunny.nvdb --resolution 1024 --scan-normals flat
    ok run bisque-voxelize "$SCANS/spot.obj" --texture "$SCANS/spot.png" -o spot.nvdb --resolution 1024 \
        --scan-normals flat
    for name in bunny spot; do
        for scan in "nvdb" "tris --scan normals=flat"; do
            # shellcheck disable=SC2086 # several words
            ok run bisque-bake $name.$scan "$SCANS/${name}_low.obj" --normal space=object --type float --size 1024 \
                --samples 1 -o "${name}_${scan%% *}_<MAP>.exr" --maps normal,mask$([ $name = bunny ] || echo ,color)
        done
    done
    against_exact bunny "--max-mean 1 --max-p95 5 --min-agreement 0.999" normal
    against_exact spot "--max-mean 1 --max-p95 3 --min-agreement 0.999" normal
    against_exact spot "--max-mean 0.1 --max-p99 0.5" color
else
    skip "bunny and Spot against exact rays" "no folder SCANS"
fi
finish

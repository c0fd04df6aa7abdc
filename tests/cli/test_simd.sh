#!/bin/sh
# test_simd.sh - the programs write the same bytes with each instruction set that BSQ_SIMD names.
. "$(dirname "$0")/lib.sh"

# The vase lies at negative coordinates, so that rounding down differs from rounding to zero.
"$TESTS/generate-scan" --offset -9,-9,-9 --triangles 20000 --colors vase -o vase.obj
# A sheet so rough that many voxels have two records, with normals that lean from its planes.
awk 'BEGIN {
    n = 90
    seed = 1
    for (i = 0; i <= n * (n + 2); i++) {
        seed = seed * 16807 % 2147483647
        printf "v %.6f %.6f %.6f\nvn %d %d 5\n", i % (n + 1) / n, int(i / (n + 1)) / n, seed / 2147483647 / 25,
            seed % 7 - 3, seed % 11 - 5
    }
    for (y = 0; y < n; y++) for (x = 1; x <= n; x++) {
        a = y * (n + 1) + x; b = a + 1; c = b + n + 1; d = a + n + 1
        printf "f %d//%d %d//%d %d//%d\nf %d//%d %d//%d %d//%d\n", a, a, b, b, c, c, a, a, c, c, d, d
    } }' >rough.obj
"$TESTS/generate-scan" --offset -9,-9,-9 vase-low -o low.obj
levels=sse4.2
for level in avx2 avx512; do
    BSQ_SIMD=$level "$BIN/bisque-voxelize" vase.obj --parse-only 2>&1 | grep -q 'no effect' || levels="$levels $level"
done

for level in $levels; do
    export BSQ_SIMD=$level
    mkdir "$level"
    ok run bisque-voxelize vase.obj -o $level/vase.nvdb --resolution 100
    for weights in area angle max; do
        ok run bisque-voxelize $level/vase.tris -o $level/$weights.nvdb --voxel-size 0.017 --scan-normals $weights
    done
    for resolution in 30 400; do
        ok run bisque-voxelize rough.obj -o $level/rough.$resolution.nvdb --resolution $resolution --tris $level/rough.tris
    done
    for scan in vase.nvdb vase.tris; do
        ok run bisque-bake $level/$scan low.obj -o "$level/${scan#*.}_<MAP>.exr" --size 48x36 --samples 2 --device cpu \
            --maps normal,color,position,curvature,ao,thickness --rays ao=16
    done
    [ $level = sse4.2 ] || for file in sse4.2/*; do
        same "$file" "$level/${file#*/}"
    done
done
holds "both stages wrote their files" [ "$(ls sse4.2 | wc -l)" -eq 20 ]

export BSQ_SIMD=avx
run bisque-voxelize vase.obj --parse-only
holds "a name that is no level is told" grep -qx \
    'bisque-voxelize: warning: BSQ_SIMD=avx has no effect: this processor has no such level' "$err"
finish

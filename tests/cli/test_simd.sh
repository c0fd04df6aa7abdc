#!/bin/sh
# test_simd.sh - the programs write the same bytes with each instruction set that BSQ_SIMD names.
. "$(dirname "$0")/lib.sh"

"$TESTS/generate-scan" --triangles 20000 --colors vase -o vase.obj
"$TESTS/generate-scan" vase-low -o low.obj
levels=sse4.2
for level in avx2 avx512; do
    BSQ_SIMD=$level "$BIN/bisque-voxelize" vase.obj --parse-only 2>&1 | grep -q 'no effect' || levels="$levels $level"
done

for level in $levels; do
    export BSQ_SIMD=$level
    mkdir "$level"
    ok run bisque-voxelize vase.obj -o $level/vase.nvdb --resolution 100
    for scan in vase.nvdb vase.tris; do
        ok run bisque-bake $level/$scan low.obj -o "$level/${scan#*.}_<MAP>.exr" --size 48x36 --samples 2 --device cpu \
            --maps normal,color,position,curvature,ao,thickness --rays ao=16
    done
    [ $level = sse4.2 ] || for file in sse4.2/*; do
        same "$file" "$level/${file#*/}"
    done
done
holds "both stages wrote their files" [ "$(ls sse4.2 | wc -l)" -eq 14 ]

export BSQ_SIMD=avx
run bisque-voxelize vase.obj --parse-only
holds "a name that is no level is told" grep -qx \
    'bisque-voxelize: warning: BSQ_SIMD=avx has no effect: this processor has no such level' "$err"
finish

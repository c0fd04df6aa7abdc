#!/bin/sh
# check_openjd.sh - the templates for Open Job Description are valid, and openjd runs them: the maps
# have the bytes of a single run. OPENJD is the command of openjd-cli.
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd) || exit 1
openjd=$(cd "$(dirname "${OPENJD:?is the command of openjd-cli}")" && pwd)/openjd || exit 1
. "$(dirname "$0")/../cli/lib.sh"
. "$top/tests/farm/parts.sh"
farm=$top/tools/farm

# openjd WORD...: runs it.
openjd()
{
    command="openjd $*" code=0
    "$openjd" "$@" >"$out" 2>"$err" || code=$?
    code 0
}

for template in asset parts assets; do
    openjd check "$farm/$template.openjd.yaml"
    grep -q 'passes validation checks' "$out"
    check "$template.openjd.yaml is valid" $?
done

"$TESTS/generate-scan" --triangles 20000 --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
options="--maps normal,height,color --size 160x96 --device cpu"
run bisque-voxelize scan.obj -o scan.nvdb --no-tris --resolution 128
code 0
run bisque-bake scan.nvdb low.obj -o 'map_<MAP>.<UDIM>.exr' $options
code 0
openjd run "$farm/asset.openjd.yaml" --step Merge --run-dependencies -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps \
    -p LastTask=4 -p Resolution=128 -p BakeOptions="$options" -p BinDir="$BIN"
grep -q 'openjd_progress: 100' "$out" && grep -q 'openjd_status: tracing' "$out"
check "openjd shows the progress" $?
for map in normal height color; do
    same map_$map.1001.exr maps/map_$map.1001.exr
done
same scan.nvdb maps/scan.nvdb
[ "$(ls maps/*.part | wc -l)" -eq 5 ]
check "there are five parts" $?

# One task again, and a scan that lies elsewhere on this machine.
rm maps/plan.0003.part maps/map_*
openjd run "$farm/asset.openjd.yaml" --step Bake -tp Task=3 -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps -p LastTask=4 \
    -p BinDir="$BIN"
openjd run "$farm/asset.openjd.yaml" --step Merge -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps -p LastTask=4 \
    -p BinDir="$BIN"
same map_height.1001.exr maps/map_height.1001.exr
openjd run "$farm/asset.openjd.yaml" --step Merge --run-dependencies -p Scan=/mnt/studio/scan.obj -p Low=/mnt/studio/low.obj \
    -p OutputDir=other -p LastTask=1 -p Resolution=128 -p BakeOptions="$options" -p BinDir="$BIN" --path-mapping-rules \
    "{\"version\": \"pathmapping-1.0\", \"path_mapping_rules\": [{\"source_path_format\": \"POSIX\",
    \"source_path\": \"/mnt/studio\", \"destination_path\": \"$PWD\"}]}"
same map_normal.1001.exr other/map_normal.1001.exr

# A task that fails says why.
command="openjd run of a missing scan" code=0
"$openjd" run "$farm/asset.openjd.yaml" --step Voxelize -p Scan=none.obj -p Low=low.obj -p OutputDir=bad -p BinDir="$BIN" \
    >"$out" 2>"$err" || code=$?
[ "$code" -ne 0 ] && grep -q 'openjd_fail: .*none\.obj: No such file' "$out"
check "a failure is told to Open Job Description" $?

# ---- a comparison with maps of before ----

mkdir reference && cp map_height.1001.exr map_normal.1001.exr reference
compare="run $farm/asset.openjd.yaml --step Compare -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps -p BinDir=$BIN"
openjd $compare -p Reference=reference -p CompareOptions='--max-error 0'
openjd $compare
grep -q 'no reference given' "$out"
check "no reference, no comparison" $?
run bisque-bake scan.nvdb low.obj -o 'reference/map_<MAP>.<UDIM>.exr' --maps normal --size 160x96 --green down --device cpu
code 0
command="openjd $compare" code=0
"$openjd" $compare -p Reference=reference -p CompareOptions='--force --max-error 1' >"$out" 2>"$err" || code=$?
[ "$code" -ne 0 ] && grep -q 'exited with code: 1 ' "$out"
check "maps outside of a limit fail the step" $?

# ---- a scan in eight parts ----

write_parts scan.obj
voxelize_parts 128
run bisque-bake parts.nvdb low.obj -o 'part_<MAP>.<UDIM>.exr' $options
code 0
openjd run "$farm/parts.openjd.yaml" --step Compare --run-dependencies -p Root=. -p List=parts.txt -p LastPart=7 -p Low=low.obj \
    -p OutputDir=parts -p LastTask=4 -p Resolution=128 -p BakeOptions="$options" -p BinDir="$BIN"
[ "$(ls parts/*.tris | wc -l)" -eq 8 ]
check "there are eight chunk files" $?
same parts.nvdb parts/scan.nvdb
for map in normal height color; do
    same part_$map.1001.exr parts/map_$map.1001.exr
done
command="openjd run with a part too few" code=0
"$openjd" run "$farm/parts.openjd.yaml" --step Sort -p Root=. -p List=parts.txt -p LastPart=6 -p Low=low.obj -p OutputDir=few \
    -p BinDir="$BIN" >"$out" 2>"$err" || code=$?
[ "$code" -ne 0 ] && grep -q 'openjd_fail: LastPart' "$out" && [ ! -e few ]
check "a list with more parts than tasks is refused" $?

# ---- many assets ----

for i in 0 1 2; do
    cp scan.obj asset$i.obj
    printf 'asset%d.obj\tlow.obj\tasset%d_<MAP>.exr\n' $i $i
done >list.tsv
openjd run "$farm/assets.openjd.yaml" --step Bake -p Root=. -p List=list.tsv -p LastAsset=2 -p Resolution=128 \
    -p BakeOptions="$options" -p BinDir="$BIN"
for i in 0 1 2; do
    same map_color.1001.exr asset${i}_color.exr
done
finish

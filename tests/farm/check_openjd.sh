#!/bin/sh
# check_openjd.sh - the templates for Open Job Description are valid, and openjd runs them: the maps
# have the bytes of a single run. OPENJD is the command of openjd-cli, ASSET the folder of bisque-asset.
openjd=$(cd "$(dirname "${OPENJD:?is the command of openjd-cli}")" && pwd)/openjd || exit 1
asset=$(cd "${ASSET:?is the folder of bisque-asset}" && pwd) || exit 1
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

# rises: whether the progress in the output never falls, and ends with 100.
rises()
{
    sed -n 's/.*openjd_progress: //p' "$out" | awk '$1 < last { bad = 1 } { last = $1 } END { exit bad || last != 100 }'
}

for template in asset parts assets bake tiles; do
    command="bisque-openjd $template" code=0
    case $template in parts | assets) chunk="--chunk 3" ;; *) chunk= ;; esac
    "$farm/bisque-openjd" $template $chunk --cpus 2 --memory 700 --scratch 3 --gpu >$template.chunks.yaml 2>"$err" || code=$?
    code 0
    grep -q 'amount.worker.vcpu, min: 2}' $template.chunks.yaml && grep -q 'amount.worker.memory, min: 700}' $template.chunks.yaml
    check "host requirements of $template" $?
    for file in "$farm/$template.openjd.yaml" $template.chunks.yaml; do
        openjd check "$file"
        holds "${file##*/} is valid" grep -q 'passes validation checks' "$out"
    done
done

"$TESTS/generate-scan" --triangles 20000 --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
options="--maps normal,height,color --size 160x96 --device cpu"
run bisque-voxelize scan.obj -o scan.nvdb --no-tris --resolution 128
code 0
run bisque-bake scan.nvdb low.obj -o 'map_<MAP>.<UDIM>.exr' $options
code 0
openjd run "$farm/asset.openjd.yaml" --step Merge --run-dependencies -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps \
    -p Parts=5 -p Resolution=128 -p BakeOptions="$options" -p BinDir="$BIN"
grep -q 'openjd_progress: 100' "$out" && grep -q 'openjd_status: tracing' "$out"
check "openjd shows the progress" $?
for map in normal height color; do
    same map_$map.1001.exr maps/map_$map.1001.exr
done
same scan.nvdb maps/scan.nvdb
holds "there are five parts" [ "$(ls maps/*part-*-of-5* | wc -l)" -eq 5 ]

# One part again, and a scan that lies elsewhere on this machine.
rm maps/map_*part-4* maps/map_[!p]*
for step in "Bake -tp Part=4" Merge; do
    # shellcheck disable=SC2086 # several words
    openjd run "$farm/asset.openjd.yaml" --step $step -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps -p Parts=5 \
        -p BakeOptions="$options" -p BinDir="$BIN"
done
same map_height.1001.exr maps/map_height.1001.exr
openjd run "$farm/asset.openjd.yaml" --step Merge --run-dependencies -p Scan=/mnt/studio/scan.obj -p Low=/mnt/studio/low.obj \
    -p OutputDir=other -p Parts=2 -p Resolution=128 -p BakeOptions="$options" -p BinDir="$BIN" --path-mapping-rules \
    "{\"version\": \"pathmapping-1.0\", \"path_mapping_rules\": [{\"source_path_format\": \"POSIX\",
    \"source_path\": \"/mnt/studio\", \"destination_path\": \"$PWD\"}]}"
same map_normal.1001.exr other/map_normal.1001.exr

# A bake alone. Names with quotes, blanks and commands are names.
odd="a \$(touch harm)'\"; touch harm; '"
mkdir "$odd"
cp scan.nvdb "$odd/scan.nvdb"
openjd run "$farm/bake.openjd.yaml" --step Merge --run-dependencies -p Scan="$odd/scan.nvdb" -p Low=low.obj -p OutputDir="$odd" \
    -p OutputName="it's_<MAP>.exr" -p Parts=7 -p BakeOptions="$options" -p BinDir="$BIN"
grep -q 'Part(INT) = 7$' "$out"
check "all parts run" $?
for map in normal height color; do
    same map_$map.1001.exr "$odd/it's_$map.exr"
done
"$openjd" run "$farm/asset.openjd.yaml" --step Voxelize -p Scan=scan.obj -p Low=low.obj -p OutputDir="$odd" -p Resolution=16 \
    -p Scale='2$(touch harm)' -p VoxelizeOptions='--up z;touch${IFS}harm' -p BinDir="$BIN" >"$out" 2>"$err"
holds "they are refused as options" grep -q 'bisque-voxelize: .*touch' "$out"
holds "no command of a parameter ran" [ -z "$(find . -name harm)" ]

# A task that fails says why.
command="openjd run of a missing scan" code=0
"$openjd" run "$farm/asset.openjd.yaml" --step Voxelize -p Scan=none.obj -p Low=low.obj -p OutputDir=bad -p BinDir="$BIN" \
    >"$out" 2>"$err" || code=$?
[ "$code" -ne 0 ] && grep -q 'openjd_fail: .*none\.obj: No such file' "$out"
check "a failure is told to Open Job Description" $?

# ---- a scan that is moved, and a cancelation ----

run bisque-voxelize scan.obj -o moved.nvdb --no-tris --resolution 64 --scale 2 --up y --translate 1,2,3
code 0
openjd run "$farm/asset.openjd.yaml" --step Voxelize -p Scan=scan.obj -p Low=low.obj -p OutputDir=moved -p Resolution=64 \
    -p Scale=2 -p Up=y -p Translate=1,2,3 -p VoxelizeOptions='--channels none' -p BinDir="$BIN"
same moved.nvdb moved/scan.nvdb

# ---- a comparison with maps of before ----

mkdir reference && cp map_height.1001.exr map_normal.1001.exr reference
compare="run $farm/asset.openjd.yaml --step Compare -p Scan=scan.obj -p Low=low.obj -p OutputDir=maps -p BinDir=$BIN"
openjd $compare -p Reference=reference -p CompareOptions='--max-error 0'
rises && grep -q 'openjd_progress: 50' "$out"
check "the progress of two comparisons rises to 100" $?
openjd $compare
holds "no reference, no comparison" grep -q 'no reference given' "$out"
run bisque-bake scan.nvdb low.obj -o 'reference/map_<MAP>.<UDIM>.exr' --maps normal --size 160x96 --normal green=down --device cpu
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
openjd run parts.chunks.yaml --step Compare --run-dependencies -p Root=. -p List=parts.txt -p LastPart=7 -p Low=low.obj \
    -p OutputDir=parts -p Parts=5 -p Resolution=128 -p BakeOptions="$options" -p BinDir="$BIN"
holds "there are eight chunk files" [ "$(ls parts/*.tris | wc -l)" -eq 8 ]
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
for template in "$farm/assets.openjd.yaml" assets.chunks.yaml; do
    rm -f asset?_*
    openjd run $template --step Bake -p Root=. -p List=list.tsv -p LastAsset=2 -p Resolution=128 -p BakeOptions="$options" \
        -p BinDir="$BIN"
    for i in 0 1 2; do
        same map_color.1001.exr asset${i}_color.exr
    done
done
rises
check "the progress of a chunk of assets rises to 100" $?

# Tiles in three parts.
options="--size 64 --triangles 3000 --tile-triangles 300"
command="bisque-asset --tiles" code=0
# shellcheck disable=SC2086 # several words
"$asset/bisque-asset" --tiles scan.obj -o whole $options >"$out" 2>"$err" || code=$?
code 0
openjd run "$farm/tiles.openjd.yaml" --step Finish --run-dependencies -p Scan=scan.obj -p OutputDir=tiles -p Parts=3 \
    -p TilesOptions="$options" -p BinDir="$asset"
grep -q 'tiles: part 3/3: [1-9]' "$out"
check "the third part makes tiles" $?
diff -r --exclude=tiles.json whole tiles
check "tiles of parts have the bytes of one job" $?

# A session that is cancelled interrupts the program, which leaves no half of a file. A bake has so many
# rays that the first bake is not done before the cancelation, however fast the machine is and
# however late this script sees that it began.
rm -f asset?_* asset?.obj.nvdb
command="openjd run, cancelled" code=0
PYTHONUNBUFFERED=1 "$openjd" run assets.chunks.yaml --step Bake -p Root=. -p List=list.tsv -p LastAsset=2 -p Resolution=128 \
    -p BakeOptions="--size 4096 --samples 4 --maps ao --rays ao=4096 --device cpu" -p BinDir="$BIN" >"$out" 2>"$err" &
pid=$!
until grep -q 'openjd_status: tracing' "$out" || ! kill -0 $pid; do
    sleep 0.1
done
# A signal that comes just before Python's main thread begins to wait is not handled until it wakes up.
until grep -q 'Interruption signal' "$out" || ! kill -0 $pid; do
    kill -INT $pid
    sleep 1
done
wait $pid || code=$?
[ "$code" -ne 0 ] && grep -q 'openjd_fail: interrupted' "$out" && grep -q 'exited with code: 75 ' "$out"
check "a cancelation interrupts the program" $?
holds "and nothing of its maps is left" [ -z "$(ls -A | grep '^asset._ao\|tmp$')" ]
finish

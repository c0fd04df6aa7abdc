#!/bin/sh
# test_farm.sh - a bake in parts: parts and merges have the bytes of a single run; what is missing,
# damaged or foreign is refused by name; parts may be killed, repeated and baked twice at once.
. "$(dirname "$0")/lib.sh"
. "$top/tests/cli/farm_lib.sh"

bake="run bisque-bake"
p="bisque-bake:"
write_box >box.obj
awk '/^v / { print $0, $2, $3 / 2, $4 / 3; next } { print }' box.obj >scan.obj
# The charts in two tiles: 1002, and 1012 from half the height of the map on.
awk '/^vt / { $2 += 1; $3 *= 2 } { print }' box.obj >low.obj
ok run bisque-voxelize scan.obj -o scan.nvdb --resolution 40
rm scan.obj box.obj
size="--size 1002=90x70,*=64 --padding 5"
mkdir one farm

# parts N INPUT... OPTION...: bakes all parts into farm/, in any order, with other threads and budgets.
parts()
{
    part=$1
    shift
    while [ $part -gt 0 ]; do
        (cd farm && "$BIN/bisque-bake" "$@" --part $part/$all --threads $((1 + part % 3)) --memory 60M) >"$out" 2>"$err" || return
        part=$((part - 1))
    done
}

# alike N INPUTS OPTION...: the outputs of a bake in one run and in N parts are the same.
alike()
{
    all=$1 inputs=$2
    shift 2
    rm -rf one farm
    mkdir one farm
    # shellcheck disable=SC2086 # several words
    (cd one && "$BIN/bisque-bake" $inputs $size "$@") >"$out" 2>"$err"
    check "one bake of $inputs: $*" $?
    # shellcheck disable=SC2086
    parts $all $inputs $size "$@"
    check "$all parts: $*" $?
    # shellcheck disable=SC2086
    (cd farm && "$BIN/bisque-bake" $inputs $size "$@" --merge $all) >"$out" 2>"$err"
    check "merge of $all parts: $*" $?
    (cd one && ls) >maps
    (cd farm && ls | grep -v part-) | cmp -s - maps
    check "all maps are there: $*" $?
    while read -r map; do
        same "one/$map" "farm/$map"
    done <maps
    rm maps
}

grid="../scan.nvdb ../low.obj" exact="../scan.tris ../low.obj"
alike 5 "$grid" --maps all --rays ao=2,thickness=2 -o 'm_<MAP>.<UDIM>.exr' --preview look.png --glb low.glb
# The ranges of heights and curvature follow from all parts.
alike 3 "$exact" --maps all -o 'x_<MAP>.<UDIM>.exr'
alike 4 "$grid" --maps height,curvature,normal -o 'r_<MAP>.<UDIM>.png' --normal green=down --cage ../low.obj --back 0.2
alike 1 "$grid" --maps mask -o 'k_<UDIM>.exr' --samples 3
alike 3 "$exact" --maps ao,thickness -o 'f_<MAP>.<UDIM>.png' --rays ao=4,thickness=4,filter=surface
printf 'P2 2 1 255\n30 220\n' >skew.pgm
alike 2 "$exact" --maps height -o 's_<UDIM>.exr' --skew ../skew.pgm
# More parts than blocks: some have no texels.
alike 200 "$grid" --maps normal -o 'n_<UVTILE>.exr' --samples 1 --device cpu
holds "some parts are empty" [ "$(ls farm | grep -c part-)" -lt 200 ]
alike 2 "$exact" --maps color,position -o 'p_<MAP>.<UDIM>.exr' --normal space=object --type float

# What no part could measure is counted again by the merge.
rm -rf farm
mkdir farm
unknown="scan.nvdb low.obj --low normals=angle -o farm/c_<UDIM>.png --size 32 --maps curvature --distance curvature=100"
for part in 1 2 3; do
    ok $bake $unknown --part $part/3
    grep 'around the hits of' "$err" >>counts
done
texels=$(sed -n 's/.* around the hits of \([0-9]*\) of .*/\1/p' counts | awk '{ sum += $1 } END { print sum }')
$bake $unknown --merge 3 --strict
code 65
holds "a strict merge writes no map of unknown curvature" [ ! -e farm/c_1002.png ]
ok $bake $unknown --merge 3
grep -q "warning: map curvature: no surface around the hits of $texels of $texels texels, at a radius of 100" "$err"
check "a merge warns of unknown curvature" $?
rm farm/*
$bake $unknown --part 1/3 --strict
code 65
grep -q 'map curvature: no surface around the hits of ' "$err"
check "a strict part ends with what is lost" $?
holds "and leaves no file" [ -z "$(ls farm)" ]

# A merge obeys --max-missed, parts do not.
awk '/^v / { $2 += 0.5 } { print }' low.obj >aside.obj
aside="scan.nvdb aside.obj -o farm/m_<UDIM>.png --size 32 --maps mask --front 0.1 --back 0.1 --max-missed 5"
ok $bake $aside --part 1/2
ok $bake $aside --part 2/2
$bake $aside --merge 2
code 1
grep -q ' % of the samples found no surface, more than --max-missed 5$' "$err"
check "the merge says what is wrong" $?
holds "the maps are there" [ -s farm/m_1002.png ]
rm aside.obj

# ---- several scans and low-poly meshes ----

awk '/^v / { $4 += 0.05 } { print }' low.obj | sed '1i o lid' >lid_low.obj
sed '1i o box' low.obj >box_low.obj
run bisque-voxelize low.obj -o box_high.nvdb --resolution 24
run bisque-voxelize lid_low.obj -o lid_high.nvdb --resolution 33
alike 3 "../box_high.nvdb ../lid_high.tris ../low.obj" --maps normal,height,curvature,mask -o 'm_<MAP>.<UDIM>.exr' --samples 3
# Objects see scans of their names, and have maps of their own.
sed -i 's/^o .*/o lid_low/' lid_low.obj
sed -i 's/^o .*/o box_low/' box_low.obj
alike 4 "../box_high.nvdb ../lid_high.nvdb ../box_low.obj ../lid_low.obj" --maps normal,ao,position --rays ao=2 --match name \
    -o '<OBJECT>_<MAP>.<UDIM>.exr'
holds "maps of two objects in two tiles" [ "$(ls farm | grep -vc part-)" -eq 12 ]
alike 2 "../scan.nvdb ../box_low.obj ../lid_low.obj" --maps mask -o '<MATERIAL>.<UDIM>.exr' --samples 1

# ---- the same again ----

rm -rf farm maps
mkdir maps
whole="scan.nvdb low.obj $size --low normals=angle -o maps/<MAP>.<UDIM>.exr --maps normal,height"
$bake $whole --merge 3
refused 66 "$p maps/part-1-of-3.1002.exr: missing; of 3 parts, 3 are missing: 1, 2, 3"
ok $bake $whole --part 1/3
ok $bake $whole --part 3/3 --json
json '.part == 3 and .parts == 3 and (.kept | not) and .samples > 0'
$bake $whole --merge 3
code 66
grep -q "^$p maps/part-2-of-3\.10.2\.exr: missing; of 3 parts, 1 is missing: 2$" "$err"
check "the missing part is named" $?
ok $bake $whole --part 2/3
before=$(stat -c %i.%y maps/part-2*)
ok $bake $whole --part 2/3 --threads 1 --device cpu --padding 9
out_like '^maps/<MAP>\.<UDIM>\.exr: part 2/3 is complete already, kept$'
holds "a part that is done is not touched" [ "$(stat -c %i.%y maps/part-2*)" = "$before" ]
ok $bake $whole --part 2/3 --json
json .kept
ok $bake $whole --merge 3 --json
json '.samples > 0 and .samples == .hits + .misses and .device == "3 parts" and (.tiles | length) == 2'

# Tiles are merged by themselves, on several machines, with the ranges of all.
rm -rf one
mkdir one
tiles="-o <MAP>.<UDIM>.png --maps normal,height,curvature --preview look.png"
(cd one && "$BIN/bisque-bake" $grid $size $tiles) >"$out" 2>"$err"
check "one bake with a preview" $?
(
    cd maps
    for part in 1 2 3 4; do
        "$BIN/bisque-bake" $grid $size $tiles --part $part/4 || exit
    done
    "$BIN/bisque-bake" $grid $size $tiles --merge 4 --tiles 1012 --memory 60M --json
) >"$out" 2>"$err"
check "four parts, and the merge of a tile" $?
[ "$(cd maps && echo *.png)" = 'curvature.1012.png height.1012.png normal.1012.png' ]
check "the maps of one tile, and no preview" $?
sed -n '/^{/,$p' "$out" | jq -e '[.tiles[].tile] == [1012] and (.encodings | keys) == ["curvature", "height"] and
    ([del(.files_read) | .. | strings | select(test("1002"))] == [])' >/dev/null
check "the report is of this tile" $?
for map in curvature height normal; do
    same one/$map.1012.png maps/$map.1012.png
done
(cd maps && "$BIN/bisque-bake" $grid $size $tiles --merge 4) >"$out" 2>"$err"
for map in one/*; do
    same "$map" "maps/${map#one/}"
done
$bake $whole --merge 3 --tiles 1001
refused 64 "$p no triangle lies in the tiles of --tiles"
$bake $whole --part 1/3 --tiles 1002
refused 64 "$p a part has all tiles: give --tiles to --merge only"

# A folder can move, with all that is in it; names of inputs may be others.
mkdir moved
cp low.obj moved/low_poly.obj
cp scan.nvdb moved
cp maps/part-?-of-3.* moved
(cd moved && "$BIN/bisque-bake" scan.nvdb low_poly.obj $size --low normals=angle -o '<MAP>.<UDIM>.exr' --maps normal,height --merge 3) >"$out" 2>"$err"
check "parts that were moved" $?
for map in maps/normal.*.exr maps/height.*.exr; do
    same $map moved/${map#maps/}
done
rm -r moved

# ---- damaged, foreign, changed ----

rm -rf farm
mkdir farm
whole="scan.nvdb one.obj --low normals=angle --size 64 -o farm/o_<MAP>.exr --maps normal,height"
awk '/^vt / { $2 -= 1; $3 /= 2 } { print }' low.obj >one.obj
for part in 1 2 3; do
    ok $bake $whole --part $part/3
done
again=': bake this part again$'
# refused_again FILE PATTERN: a merge refuses a file and says why; then it is as before.
refused_again()
{
    $bake $whole --merge 3
    refused_like 65 "^$p farm/$1: $2"
    mv keep farm/$1
}
second=o_part-2-of-3.exr
bytes=$(wc -c <farm/$second)
for place in 0 5 9 400 $((bytes / 2)) $((bytes - 9)); do
    cp farm/$second keep
    byte=$(od -An -tu1 -j $place -N 1 keep)
    printf "\\$(printf %03o $((byte ^ 16)))" | dd of=farm/$second bs=1 seek=$place conv=notrunc 2>"$work/dd"
    refused_again $second ''
done
# The part itself notices damage, too.
cp farm/$second keep
printf x | dd of=farm/$second bs=1 seek=$((bytes / 2)) conv=notrunc 2>"$work/dd"
ok $bake $whole --part 2/3
out_like '^farm/o_<MAP>\.exr: part 2/3, '
same keep farm/$second
for length in 0 3 300 $((bytes / 2)) $((bytes - 1)); do
    cp farm/$second keep
    head -c $length keep >farm/$second
    refused_again $second ''
done
# changed FROM TO: replaces a text of the same length in the file.
changed()
{
    cp farm/$second keep
    LC_ALL=C sed "s|$1|$2|" keep >farm/$second
    holds "the file says $2" grep -qa "$2" farm/$second
}
version=$("$BIN/bisque-bake" --version | sed -n '1s/.* //p')
changed "$version" "$(echo "$version" | tr 0-8 1-9)"
refused_again $second "a part by another version of Bisque$again"
cp farm/$second keep
cp farm/o_part-1-of-3.exr farm/$second
refused_again $second "another part$again"
changed '2/3' '2/4'
refused_again $second "another part$again"
changed '1001 (1/1)' '1002 (1/1)'
refused_again $second "a part of another tile$again"
changed 'bisque:inputs' 'bisque:outfit'
refused_again $second "not a part of a bake$again"
cp farm/$second keep
ok $bake scan.nvdb one.obj --size 64 -o farm/x_height.exr --maps height
mv farm/x_height.exr farm/$second
refused_again $second ''
cp farm/$second keep
ok $bake $whole --samples 1 --part 2/3
out_like '^farm/o_<MAP>\.exr: part 2/3, ' # with another option it is another part
refused_again $second "a part of a bake with other options$again"
cp one.obj one.good
sed 's/^v 1 2 3/v 1 2 3.1/' one.good >one.obj
$bake $whole --merge 3
refused_like 65 "^$p farm/o_part-1-of-3\.exr: a part of a bake with other inputs$again"
cp farm/$second keep
ok $bake $whole --part 2/3
out_like '^farm/o_<MAP>\.exr: part 2/3, '
mv one.good one.obj
refused_again $second "a part of a bake with other inputs$again"
holds "no map was written" [ ! -e farm/o_normal.exr ]
ok $bake $whole --merge 3

# The reader in Python accepts what Bisque wrote and refuses what is damaged.
if find_python; then
    "$python" -B "$top/tests/oracle/read_part.py" farm/o_part-*.exr maps/*part-*.exr >"$out" 2>"$err"
    check "the reader in Python accepts the parts" $?
    for place in 30 400 $((bytes / 2)) $((bytes - 3)); do
        cp farm/$second keep
        printf '\376' | dd of=keep bs=1 seek=$place conv=notrunc 2>"$work/dd"
        ! "$python" -B "$top/tests/oracle/read_part.py" keep >"$out" 2>"$err" && grep -q 'refused' "$out"
        check "the reader in Python refuses a part with a changed byte at $place" $?
    done
else
    lacks "a reader in Python" "python3-numpy or python3-xxhash is not installed"
fi

# ---- paths ----

# The scan names a texture by a path of another machine; another picture is another input.
mkdir here
printf 'P3 2 1 255 250 10 20 30 40 250' >here/skin.ppm
sed 's/^v \([^ ]* [^ ]* [^ ]*\).*/v \1/' low.obj >here/skin.obj
sed -i '1i mtllib skin.mtl' here/skin.obj
sed -i 's/^f 4/usemtl skin\nf 4/' here/skin.obj
printf 'newmtl skin\nmap_Kd Z:\\Studio\\textures\\skin.ppm\n' >here/skin.mtl
ok run bisque-voxelize here/skin.obj -o here/skin.tris
holds "the texture is found beside" grep -aq "$PWD/here/skin.ppm" here/skin.tris
skin="$size --low normals=angle --maps color -o farm/<MAP>.<UDIM>.exr"
ok $bake here/skin.tris low.obj $size --low normals=angle --maps color -o 'skin.<UDIM>.exr'
ok $bake here/skin.tris low.obj $skin --part 1/2
cp here/skin.tris moved.tris
ok $bake moved.tris low.obj $skin --part 2/2
cp here/skin.ppm skin.ppm
printf 'P3 2 1 255 250 10 20 30 40 251' >here/skin.ppm
$bake moved.tris low.obj $skin --merge 2
refused_like 65 "^$p farm/part-1-of-2\.10.2\.exr: a part of a bake with other inputs$again"
mv skin.ppm here
ok $bake moved.tris low.obj $skin --merge 2
for tile in 1002 1012; do
    same skin.$tile.exr farm/color.$tile.exr
done

# ---- progress ----

ok $bake scan.nvdb low.obj $size -o 'maps/<MAP>.<UDIM>.exr' --maps normal,curvature --progress openjd
percentages 's/^openjd_progress: \([0-9.]*\)$/\1/p' && grep -q '^openjd_status: tracing$' "$out" && [ ! -s "$err" ]
check "progress for Open Job Description rises from 0 to 100, also with two UDIM tiles" $?
ok $bake $whole --samples 3 --part 1/3 --progress alf
percentages 's/^ALF_PROGRESS \([0-9]*\)%$/\1/p'
check "progress of a part rises from 0 to 100" $?
run bisque-bake box_high.nvdb lid_high.nvdb box_low.obj $size -o 'm_<MAP>.<UDIM>.exr' --maps ao --rays ao=1 --progress openjd
for percent in 33.0 66.0; do # after each tile
    holds "progress of $percent" grep -qx "openjd_progress: $percent" "$out"
done
$bake $whole --merge 4 --progress openjd
code 66
grep -qx 'openjd_fail: farm/o_part-1-of-4.exr: missing; of 4 parts, 4 are missing: 1, 2, 3, 4' "$out" && ! grep -q 'openjd_progress: 100' "$out"
check "a failure for Open Job Description" $?
if [ -n "${LONG-}" ]; then # it takes half a minute
    rm -f flag
    command="bisque-bake that waits" code=0
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$(pwd -P) FAULT_CALLS=open FAULT_PATH=/one.obj FAULT_AT=1 FAULT_DO=pause \
        FAULT_FLAG=flag "$BIN/bisque-bake" $whole --part 1/3 --progress percent >"$out" 2>"$err" &
    wait_for flag
    until [ "$(grep -c '^Progress: 0%$' "$out")" -ge 2 ]; do # another line comes within 30 s
        sleep 0.1
    done
    rm flag
    wait $! || code=$?
    code 0
fi

# ---- options ----

for part in 0/2 3/2 1 1/ /2 1/2/3 -1/2 1/65537 '1 /2' ''; do
    $bake scan.nvdb one.obj --low normals=angle -o x.exr --part "$part"
    refused_like 64 "^$p --part: \"$part\" is not I/N"
done
for parts in 0 65537 x; do
    $bake scan.nvdb one.obj --low normals=angle -o x.exr --merge $parts
    code 64
done
$bake $whole --part 1/3 --merge 3
refused 64 "$p --part and --merge exclude each other"
for bad in "--part 1/3" "--merge 3 --tiles 1001"; do
    $bake $whole $bad --report x.html
    refused 64 "$p --report shows whole bakes: give it to --merge without --tiles"
done
mkfifo pipe.obj
cat one.obj >pipe.obj &
$bake scan.nvdb pipe.obj -o x.exr --part 1/3
[ "$code" -ne 0 ] && [ ! -e x.part-1-of-3.exr ]
check "no part of a mesh from a pipe" $?
kill $! 2>"$work/kill"
$bake scan.nvdb one.obj --maps mask -o nowhere/x.exr --part 1/3
code 73

# ---- Slurm: what would be submitted; tests/farm/ submits it ----

slurm=$top/tools/farm/bisque-slurm
command="bisque-slurm bake --dry-run" code=0
"$slurm" bake --dry-run --parts 9 --at-most 4 --gpu --partition fast -- "a scan.nvdb" low.obj -o "o'<MAP>.exr" \
    >"$out" 2>"$err" || code=$?
code 0
holds "two jobs" [ "$(grep -c '^sbatch ' "$out")" -eq 2 ]
for line in "'--array=0-8%4' '--gres=gpu:1'" "'--dependency=afterok:<bisque-part>' '--kill-on-invalid-dep=yes'" "'--output=logs/%A_%a.log'" "'--partition=fast'" \
    "'a scan.nvdb' 'low.obj' '-o' 'o'\\\\''<MAP>.exr' '--merge' '9'"; do
    holds "submitted: $line" grep -qF -- "$(printf '%b' "$line")" "$out"
done
# The printed commands give sbatch the same script as a submission does.
mkdir fake
printf '#!/bin/sh\ncat >>"scripts.$RUN"\necho 7\n' >fake/sbatch
chmod +x fake/sbatch
command="bisque-slurm bake --dry-run | sh" code=0
"$slurm" bake --dry-run -- s.nvdb low.obj -o o.exr | RUN=printed PATH=$PWD/fake:$PATH sh >"$out" 2>"$err" || code=$?
code 0
RUN=submitted PATH=$PWD/fake:$PATH "$slurm" bake -- s.nvdb low.obj -o o.exr >"$out" 2>"$err" || code=$?
code 0
same scripts.printed scripts.submitted
rm scripts.printed
# Several parts in an element of the array, also if there were too many elements otherwise.
printf '#!/bin/sh\nwhile [ $# -gt 1 ]; do shift; done\necho "$1"\n' >fake/bisque-bake
chmod +x fake/bisque-bake
for parts in "--parts 10 --chunk 4" "--parts 2500"; do
    command="bisque-slurm bake $parts --dry-run | sh" code=0
    # shellcheck disable=SC2086 # several words
    "$slurm" bake --dry-run --at-most 5 $parts -- s.nvdb low.obj -o o.exr | RUN=printed PATH=$PWD/fake:$PATH sh >"$out" 2>"$err"
    sed -n '/^bake_parts() {/,/^exit/p' scripts.printed >first
    baked=$(for element in 0 2 833; do code=0 SLURM_ARRAY_TASK_ID=$element PATH=$PWD/fake:$PATH sh first; done | tr '\n' ' ')
    case $parts in
    *chunk*) [ "$baked" = "1/10 2/10 3/10 4/10 9/10 10/10 " ] ;;
    *) [ "$baked" = "1/2500 2/2500 3/2500 7/2500 8/2500 9/2500 2500/2500 " ] ;;
    esac
    check "elements bake several parts: $parts" $?
    rm scripts.printed first
done
rm -r fake scripts.*
command="bisque-slurm tiles --dry-run" code=0
"$slurm" tiles --dry-run --parts 3 -- "a scan.obj" -o "the tiles" --size 512 >"$out" 2>"$err" || code=$?
code 0
words="'bisque-asset' '--tiles' 'a scan.obj' '-o' 'the tiles' '--size' '512'" plan="'--part' 'plan' "
[ "$(grep -c '^sbatch ' "$out")" -eq 3 ] && grep -qF "$words $plan" "$out" && grep -qF -- "--part \$part/3 || return" "$out" &&
    grep -qF "'--array=0-2'" "$out" && grep -qF "'--dependency=afterok:<bisque-plan>'" "$out" && [ "$(grep -cF "$words" "$out")" -eq 3 ] &&
    ! grep -q -- --merge "$out"
check "a plan, an array of parts and the tileset" $?
printf 'a.obj\tl.obj\to_<MAP>.exr\n' >list
command="bisque-slurm assets --dry-run" code=0
"$slurm" assets --dry-run list -- --maps normal >"$out" 2>"$err" || code=$?
code 0
[ "$(grep -c "'--array=0-0'" "$out")" -eq 2 ] && grep -qF "'--dependency=aftercorr:<bisque-grid>'" "$out"
check "two arrays, task by task" $?
grep -qF "grid=\$scan.nvdb" "$out" # so body.obj and body.ply have two grids
check "grids have the whole names of their scans" $?
printf 'p/a 1.ply\np/b.ply.zst\nc' >list # without an end of its last line
command="bisque-slurm parts --dry-run" code=0
"$slurm" parts --dry-run --parts 2 list -- low.obj -o 'o_<MAP>.exr' >"$out" 2>"$err" || code=$?
code 0
[ "$(grep -c '^sbatch ' "$out")" -eq 4 ] && grep -qF "'--array=0-2'" "$out" &&
    grep -qF " 'p/a 1.tris' 'p/b.ply.tris' 'c.tris' ||" "$out" &&
    grep -qF "'--dependency=afterok:<bisque-sort>' '--kill-on-invalid-dep=yes'" "$out" &&
    grep -qF "'--dependency=afterok:<bisque-grid>' '--kill-on-invalid-dep=yes'" "$out" &&
    grep -qF "'bisque-bake' 'scan.nvdb' 'low.obj'" "$out"
check "parts are sorted, voxelized together and baked" $?
printf 'a.ply\na.obj\n' >twice
printf 'a.ply\n\nb.ply\n' >gap
: >empty
for bad in "" "bake --parts 0 -- a b -o c" "bake --parts 5" "bake --chunk 0 -- a b -o c" "bake --what" assets "render" "tiles list -- s -o t" "tiles -- s" \
    "parts twice -- l -o o" "parts gap -- l -o o" "parts empty -- l -o o" "parts none -- l -o o" "parts list" "assets none"; do
    command="bisque-slurm $bad" code=0
    # shellcheck disable=SC2086 # $bad is several words
    "$slurm" $bad >"$out" 2>"$err" || code=$?
    refused_like 64 '^bisque-slurm: '
done
rm list twice gap empty

# ---- Open Job Description: templates; tests/farm/ runs them ----

openjd=$top/tools/farm/bisque-openjd
command="bisque-openjd" code=0
"$openjd" parts --parts 3 --chunk 2 --cpus 8 --gpu >"$out" 2>"$err" || code=$?
code 0
for line in 'extensions: [TASK_CHUNKING]' '    default: 3' '          type: CHUNK[INT]' \
    '          chunks: {defaultTaskCount: 2, rangeConstraint: CONTIGUOUS}' '        - {name: amount.worker.vcpu, min: 8}' \
    '        - {name: amount.worker.gpu, min: 1}'; do
    holds "the template has \"$line\"" grep -qxF -- "$line" "$out"
done
[ "$(grep -c 'CHUNK\[INT\]' "$out")" -eq 1 ]
check "parts of scans have chunks, those of bakes have not" $?
for template in asset parts assets bake tiles; do # without options, it is the template itself
    "$openjd" $template | cmp -s - "$top/tools/farm/$template.openjd.yaml"
    check "bisque-openjd $template" $?
    "$openjd" $template --gpu --scratch 7 >text
    grep -qxF '        - {name: amount.worker.gpu, min: 1}' text && grep -qxF '        - {name: amount.worker.disk.scratch, min: 7}' text
    check "bisque-openjd $template --gpu --scratch 7" $?
done
for bad in "" "asset parts" what "asset --chunk 0" "asset --cpus" "asset --memory 1G" "assets --parts 2" "bake --chunk 2" "tiles --chunk 2" "asset --parts x" "--what asset"; do
    command="bisque-openjd $bad" code=0
    # shellcheck disable=SC2086 # $bad is several words
    "$openjd" $bad >"$out" 2>"$err" || code=$?
    refused_like 64 '^bisque-openjd: '
done

# ---- other devices ----

# One part has a GPU, which tests/fake/fake_cuda.c simulates, and the others have not.
rm -rf farm one
mkdir farm one
ok $bake scan.nvdb low.obj $size -o 'one/<MAP>.<UDIM>.exr' --maps color --device cpu
color="scan.nvdb low.obj $size -o farm/<MAP>.<UDIM>.exr --maps color"
LD_LIBRARY_PATH=$TESTS/fake $bake $color --part 1/3 --device cuda --json
json '.device == "Fake GPU 0 (CUDA)"'
$bake $color --part 2/3 --device opencl:99
code 69
ok $bake $color --part 2/3 --device cpu --json
json '.device | startswith("cpu")'
ok $bake $color --part 3/3 --device auto
ok $bake $color --merge 3
for map in color.1002.exr color.1012.exr; do
    same one/$map farm/$map
done

# ---- killed, interrupted, twice at once ----

unsanitized "parts that are killed" "sanitizers want to be loaded first"

begin_faults
killed_at open write sync name
rm -f $part
command="bisque-bake --part 2/3 interrupted" code=0
faulty_part write TERM 0 || code=$?
refused 75 "$p interrupted"
holds "an interrupted part leaves no file" [ ! -e $part ]
twice "the same part completes meanwhile" '"$BIN/bisque-bake" $whole --part 2/3 >"$work/second"'
no_temporary_files

# ---- NFS that has neither files without a name nor flock ----

rm -rf farm
mkdir farm
for step in "--part 1/2" "--part 2/2" "--merge 2"; do
    # shellcheck disable=SC2086 # several words
    plainly "$BIN/bisque-bake" $color $step
done
for map in color.1002.exr color.1012.exr; do
    same one/$map farm/$map
done
no_temporary_files

# ---- another scan of the same size ----

# grid_scan PLACE: prints a square of 1700 x 1700 vertices, whose red is inverted in 100 x 100 of them,
# if PLACE is not empty.
grid_scan()
{
    awk -v place="$1" 'BEGIN { n = 1700
        printf "ply\nformat ascii 1.0\nelement vertex %d\n", n * n
        print "property float x\nproperty float y\nproperty float z"
        print "property uchar red\nproperty uchar green\nproperty uchar blue"
        printf "element face %d\nproperty list uchar int vertex_indices\nend_header\n", (n - 1) ^ 2
        for (y = 0; y < n; y++) for (x = 0; x < n; x++) {
            red = place && x < 100 && y >= n - 100 ? 255 - x % 256 : x % 256
            print x, y, x * y % 7 / 7, red, y % 256, 9 }
        for (y = 1; y < n; y++) for (x = 1; x < n; x++)
            print 4, n * y + x - n - 1, n * y + x - n, n * y + x, n * y + x - 1 }'
}

# Neither the first nor the last 4 KiB of their files hold colours that differ.
if [ -n "${LONG-}" ]; then
    rm -rf one farm
    mkdir one other farm
    grid_scan '' >one/scan.ply
    grid_scan upper >other/scan.ply
    printf 'v 0 0 0\nv 1699 0 0\nv 1699 1699 0\nv 0 1699 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n' >flat.obj
    for folder in one other; do
        ok run bisque-voxelize $folder/scan.ply -o $folder/scan.nvdb --resolution 2700
    done
    for scan in scan.tris scan.nvdb; do
        holds "$scan is large" [ "$(wc -c <one/$scan)" -gt 67108864 ]
        holds "both have one size" [ "$(wc -c <one/$scan)" -eq "$(wc -c <other/$scan)" ]
        cp one/$scan $scan
        flat="$scan flat.obj --low normals=angle --maps color --size 300 --front 2 --back 2 -o farm/c.exr"
        ok $bake $flat --part 1/2
        cp other/$scan $scan
        ok $bake $flat --part 2/2
        $bake $flat --merge 2
        refused_like 65 "^$p farm/c\.part-1-of-2\.exr: a part of a bake with other inputs$again"
        rm -f farm/* $scan
    done
fi

finish

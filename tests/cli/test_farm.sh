#!/bin/sh
# test_farm.sh - a bake as tasks: plans, parts and merges have the bytes of a single run; what is
# missing, damaged or foreign is refused by name; tasks may be killed, repeated and run twice.
. "$(dirname "$0")/lib.sh"
. "$top/tests/cli/farm_lib.sh"

bake="run bisque-bake"
write_box >box.obj
awk '/^v / { print $0, $2, $3 / 2, $4 / 3; next } { print }' box.obj >scan.obj
# The charts in two tiles: 1002, and 1012 from half the height of the map on.
awk '/^vt / { $2 += 1; $3 *= 2 } { print }' box.obj >low.obj
ok run bisque-voxelize scan.obj -o scan.nvdb --resolution 40
rm scan.obj box.obj
size="--size 1002=90x70,*=64 --padding 5"
mkdir one farm

# alike SCAN TASKS OPTION...: the maps of a bake in one run and in tasks are the same.
alike()
{
    rm -rf one farm
    mkdir one farm
    scan=$1 tasks=$2
    shift 2
    ok $bake "$scan" low.obj $size "$@"
    (
        cd farm
        "$BIN/bisque-bake" "../$scan" ../low.obj $size "$@" --tasks "$tasks" --plan plan.json >"$out" 2>"$err"
    )
    check "a plan of $tasks tasks: $*" $?
    task=$tasks
    while [ $task -gt 0 ]; do # in any order, with other threads and budgets
        task=$((task - 1))
        run bisque-bake --plan farm/plan.json --task $task --threads $((1 + task % 3)) --memory 60M
        [ "$code" -eq 0 ] || break
    done
    check "tasks: $*" "$code"
    ok $bake --plan farm/plan.json --merge
    for map in *.exr *.png; do
        [ ! -e "$map" ] || same "$map" "farm/$map"
        rm -f "$map"
    done
}

alike scan.nvdb 5 --maps all --rays ao=2 --rays thickness=2 -o 'm_<MAP>.<UDIM>.exr' --preview look.png
# The ranges of heights and curvature follow from all tasks.
alike scan.tris 3 --maps all -o 'x_<MAP>.<UDIM>.exr'
alike scan.nvdb 4 --maps height,curvature,normal -o 'r_<MAP>.<UDIM>.png' --normal green=down --cage "$work/here/low.obj" --back 0.2
alike scan.nvdb 1 --maps mask -o 'k_<UDIM>.exr' --samples 3
printf 'P2 2 1 255\n30 220\n' >"$work/here/skew.pgm"
alike scan.tris 2 --maps height -o 's_<UDIM>.exr' --skew "$work/here/skew.pgm"
jq -e '[.inputs[].role] | index("the skew map")' farm/plan.json >/dev/null
check "the skew map is an input of the plan" $?
# More tasks than blocks: some have nothing to bake.
alike scan.nvdb 40 --maps normal -o 'n_<UVTILE>.exr' --samples 1 --device cpu
alike scan.tris 2 --maps color,position -o 'p_<MAP>.<UDIM>.exr' --tiles 1012 --normal space=object

# What the tasks could not measure is counted again by the merge.
rm -rf farm
mkdir farm
(cd farm && "$BIN/bisque-bake" ../scan.nvdb ../low.obj -o 'c_<UDIM>.png' --size 32 --maps curvature --distance curvature=100 \
    --tasks 3 --plan plan.json) >"$out" 2>"$err"
check "a plan of unknown curvature" $?
ok $bake --plan farm/plan.json --task 0-2
texels=$(sed -n 's/.* around the hits of \([0-9]*\) of .*/\1/p' "$err" | awk '{ sum += $1 } END { print sum }')
$bake --plan farm/plan.json --merge --strict
code 65
holds "a strict merge writes no map of unknown curvature" [ ! -e farm/c_1002.png ]
ok $bake --plan farm/plan.json --merge
grep -q "warning: map curvature: no surface around the hits of $texels of $texels texels, at a radius of 100" "$err"
check "a merge warns of unknown curvature" $?
ok $bake --plan farm/plan.json --merge
holds "a merge that is kept warns of it too" grep -q "of $texels texels, at a radius of 100" "$err"
$bake --plan farm/plan.json --merge --strict
code 65

# A plan keeps --strict.
rm -rf farm
mkdir farm
(cd farm && "$BIN/bisque-bake" ../scan.nvdb ../low.obj -o 'c_<UDIM>.png' --size 32 --maps curvature --distance curvature=100 \
    --strict --tasks 3 --plan plan.json) >"$out" 2>"$err"
check "a strict plan" $?
$bake --plan farm/plan.json --task 0-2
code 65
grep -q 'map curvature: no surface around the hits of ' "$err"
check "a task of a strict plan ends with what is lost" $?

# A plan keeps --max-missed for its merge, which may have another. A merge that is kept obeys too.
rm -rf farm
mkdir farm
awk '/^v / { $2 += 0.5 } { print }' low.obj >aside.obj
(cd farm && "$BIN/bisque-bake" ../scan.nvdb ../aside.obj -o 'm_<UDIM>.png' --size 32 --maps mask --front 0.1 --back 0.1 \
    --max-missed 5 --tasks 2 --plan plan.json) >"$out" 2>"$err"
check "a plan with --max-missed" $?
ok $bake --plan farm/plan.json --task 0-1
for again in 1 2; do
    $bake --plan farm/plan.json --merge
    code 1
    grep -q ' % of the samples found no surface, more than --max-missed 5$' "$err"
    check "merge $again says what is wrong" $?
done
holds "the maps are there" [ -s farm/m_1002.png ]
ok $bake --plan farm/plan.json --merge --max-missed 99
$bake --plan farm/plan.json --merge --max-missed 0
code 1
rm aside.obj

# ---- several scans and low-poly meshes ----

# alike_several TASKS OPTION...: as alike(), with all inputs in `inputs`.
alike_several()
{
    rm -rf one farm
    mkdir one farm
    tasks=$1
    shift
    (cd one && "$BIN/bisque-bake" $inputs $size "$@") >"$out" 2>"$err"
    check "one bake of $inputs: $*" $?
    (cd farm && "$BIN/bisque-bake" $inputs $size "$@" --tasks "$tasks" --plan "a <UDIM> plan.json") >"$out" 2>"$err"
    check "a plan of $tasks tasks: $*" $?
    $bake --plan "farm/a <UDIM> plan.json" --task 1-$((tasks - 1)) --memory 60M
    code 0
    ok $bake --plan "farm/a <UDIM> plan.json" --task 0 --threads 1
    ok $bake --plan "farm/a <UDIM> plan.json" --merge
    (cd one && ls) >maps
    (cd farm && ls | grep '\.exr$') | cmp -s - maps
    check "all maps are there: $*" $?
    while read -r map; do
        same "one/$map" "farm/$map"
    done <maps
    rm maps
}

awk '/^v / { $4 += 0.05 } { print }' low.obj | sed '1i o lid' >lid_low.obj
sed '1i o box' low.obj >box_low.obj
run bisque-voxelize low.obj -o box_high.nvdb --resolution 24
run bisque-voxelize lid_low.obj -o lid_high.nvdb --resolution 33
inputs="../box_high.nvdb ../lid_high.tris ../low.obj"
alike_several 3 --maps normal,height,curvature,mask -o 'm_<MAP>.<UDIM>.exr' --samples 3
[ "$(jq -c '[.inputs[].path] | sort' farm/*.json)" = '["../box_high.nvdb","../lid_high.tris","../low.obj"]' ]
check "all scans are inputs of the plan" $?
cp lid_high.tris keep
run bisque-voxelize box_low.obj -o lid_high.nvdb --resolution 33
$bake --plan "farm/a <UDIM> plan.json" --task 0
refused_like 65 '^bisque-bake: farm/\.\./lid_high\.tris: a scan is not the file that the plan|^bisque-bake: lid_high\.tris: a scan is not'
mv keep lid_high.tris
run bisque-voxelize lid_high.tris -o lid_high.nvdb --resolution 33
# Objects see scans of their names, and have maps of their own.
inputs="../box_high.nvdb ../lid_high.nvdb ../box_low.obj ../lid_low.obj"
sed -i 's/^o .*/o lid_low/' lid_low.obj
sed -i 's/^o .*/o box_low/' box_low.obj
alike_several 4 --maps normal,ao,position --rays ao=2 --match name -o '<OBJECT>_<MAP>.<UDIM>.exr'
holds "maps of two objects in two tiles" [ "$(ls farm/*.exr | wc -l)" -eq 12 ]
inputs="../scan.nvdb ../box_low.obj ../lid_low.obj"
alike_several 2 --maps mask -o '<MATERIAL>.<UDIM>.exr' --samples 1

# The percentage counts the tiles that a task traces.
run bisque-bake box_high.nvdb lid_high.nvdb box_low.obj $size -o 'm_<MAP>.<UDIM>.exr' --maps ao --rays ao=1 --progress openjd
for percent in 33.5 66.0; do # after each tile
    holds "progress of $percent" grep -qx "openjd_progress: $percent" "$out"
done
run bisque-bake scan.nvdb low.obj $size -o 'm_<MAP>.<UDIM>.exr' --maps mask --tasks 40 --plan forty.json
task=$(jq '[.tiles[].blocks | [scan("[*]([0-9]+)")[0]]] | .[1] - .[0] | .[0] | tonumber' forty.json) # of one of two tiles
$bake --plan forty.json --task "$task" --progress openjd
holds "it counts this tile alone" grep -qx 'openjd_progress: 66.0' "$out"
rm forty.* m_*

# ---- the same again ----

plan="bisque-bake scan.nvdb low.obj $size --low normals=angle -o maps/<MAP>.<UDIM>.exr --maps normal,height --tasks 3 --plan farm/plan.json"
mkdir maps
rm -rf one farm/*
ok run $plan
out_like '^farm/plan\.json: 3 tasks for [0-9,]+ texels in 2 tiles$'
run $plan
out_like '^farm/plan\.json: 3 tasks for [0-9,]+ texels in 2 tiles, was there already$'
run $plan --json
json '.tasks == 3 and .kept and .task_memory_bytes > 0 and .parts_bytes > 0'
# Nothing but the plan is written, and no map.
[ "$(ls farm maps)" = "farm:
plan.json

maps:" ]
check "a plan writes no maps" $?

# What tasks need follows from inputs and options alone, and so does the plan's id.
for scan in scan.nvdb scan.tris; do
    need="bisque-bake $scan low.obj --tiles 1002 --size 512 --samples 1 -o m.exr --maps normal --tasks 1 --plan need.json"
    rm -f need.*
    ok run $need --threads 1 --memory 60M
    run $need --threads 3 --memory 1G
    out_like '^need\.json: 1 task for [0-9,]+ texels in 1 tile, was there already$'
    out_like '^a task: about [0-9.]+ MiB of memory with eight threads, [0-9.]+ MiB of temporary files with less, 0\.[0-9]+ s of one core$'
    $bake --plan need.json --task 0 --threads 8 --memory 1G --device cpu --json
    jq -e --slurpfile plan need.json '.cost.memory_high_bytes as $high | $plan[0].expected[0].memory_bytes |
        . >= $high and . <= 2 * $high + 25 * 1048576' "$out" >"$work/jq"
    check "$scan: a task takes about the memory that its plan expects" $?
done
rm need.*

p="bisque-bake:"
$bake --plan farm/plan.json --merge
refused 66 "$p farm/plan.0000.part: missing; 3 of 3 parts are missing: those of tasks 0, 1, 2"
for task in 0 2; do
    ok $bake --plan farm/plan.json --task $task
done
$bake --plan farm/plan.json --merge
refused 66 "$p farm/plan.0001.part: missing; 1 of 3 parts are missing: those of task 1"
$bake --plan farm/plan.json --task 3
refused 64 "$p farm/plan.json: there is no task 3: tasks are 0 to 2"
ok $bake --plan farm/plan.json
out_like '^farm/plan\.json: 3 tasks for [0-9,]+ texels in 2 tiles$'
ok $bake --plan farm/plan.json --json
json '.tasks == 3 and .task_memory_bytes > 0 and .parts_bytes > 0'
ok $bake --plan farm/plan.json --task 1 --json
json '.task == 1 and (.kept | not) and .samples > 0'
before=$(stat -c %i.%y farm/plan.0001.part)
ok $bake --plan farm/plan.json --task 1
out_like '^farm/plan\.0001\.part: this part is complete already, kept$'
holds "a complete part is not touched" [ "$(stat -c %i.%y farm/plan.0001.part)" = "$before" ]
ok $bake --plan farm/plan.json --task 1 --force
holds "--force bakes it again" [ "$(stat -c %i.%y farm/plan.0001.part)" != "$before" ]
ok $bake --plan farm/plan.json --merge
out_like '^maps/normal\.1002\.exr: normal map$'
ok $bake --plan farm/plan.json --merge
out_like '^farm/plan\.json: the merge of this plan is complete already, kept$'
echo x >>maps/height.1012.exr
$bake --plan farm/plan.json --merge --json
json '.samples > 0 and .samples == .hits + .misses'
ok $bake --plan farm/plan.json --merge --force
out_like '^maps/normal\.1002\.exr: normal map$'
rm farm/plan.*.merged maps/*
mkdir farm/plan.0001.merged
$bake --plan farm/plan.json --merge
code 73
holds "no maps if the note of the merge cannot be written" [ -z "$(ls maps)" ]
rmdir farm/plan.0001.merged
ok $bake --plan farm/plan.json --merge

# ---- tiles are merged by themselves, on several machines ----

mkdir one
(cd one && "$BIN/bisque-bake" ../scan.nvdb ../low.obj $size -o '<MAP>.<UDIM>.png' --maps normal,height,curvature \
    --preview look.png) >"$out" 2>"$err"
check "one bake with a preview" $?
(cd one && "$BIN/bisque-bake" ../scan.nvdb ../low.obj $size -o '../maps/<MAP>.<UDIM>.png' --maps normal,height,curvature \
    --preview ../maps/look.png --tasks 4 --plan ../farm/tiles.json) >"$out" 2>"$err"
check "a plan with a preview" $?
ok $bake --plan farm/tiles.json --json
json '.tiles == 2'
$bake --plan farm/tiles.json --merge --task 1
code 66
ok $bake --plan farm/tiles.json --task 0-3
ok $bake --plan farm/tiles.json --merge --task 1 --memory 60M
out_like '^maps/height\.1012\.png: height map, range '
[ "$(ls maps/*.png | tr '\n' ' ')" = 'maps/curvature.1012.png maps/height.1012.png maps/normal.1012.png ' ]
check "the maps of one tile, and no preview" $?
ok $bake --plan farm/tiles.json --merge --task 1
out_like '^farm/tiles\.json: the merge of this tile is complete already, kept$'
ok $bake --plan farm/tiles.json --merge --task 0-7 # a scheduler need not know how many there are
$bake --plan farm/tiles.json --merge --task 7 --json
json '.merge_tile == 7 and .kept == false'
before=$(stat -c %i.%y maps/*.png)
ok $bake --plan farm/tiles.json --merge
holds "the last step writes the preview only" [ "$(stat -c %i.%y maps/[!l]*.png)" = "$before" ]
for map in one/*; do
    same "$map" "maps/${map#one/}"
done
ok $bake --plan farm/tiles.json --merge
out_like '^farm/tiles\.json: the merge of this plan is complete already, kept$'
rm maps/height.1002.png
: >farm/tiles.0001.merged # a damaged note: the tile is merged again
ok $bake --plan farm/tiles.json --merge
for map in one/*; do
    same "$map" "maps/${map#one/}"
done
rm -r one maps/*.png farm/tiles.*

# A plan without ".json" at the end of its name has parts of its own.
cp farm/plan.0000.part keep
ok $bake scan.nvdb low.obj $size -o 'other_<MAP>.<UDIM>.exr' --maps mask --tasks 1 --plan farm/plan
ok $bake --plan farm/plan --task 0
out_like '^farm/plan\.part\.0000: task 0, '
same keep farm/plan.0000.part
ok $bake --plan farm/plan --merge
rm farm/plan farm/plan.part.0000 farm/plan.merged.000? other_* keep

# A folder can move, with all that a plan names below it or beside it.
mkdir moved
cp -r low.obj scan.nvdb farm maps moved
rm moved/maps/*
(cd moved/farm && "$BIN/bisque-bake" --plan plan.json --merge) >"$out" 2>"$err"
check "a plan that was moved" $?
for map in maps/*; do
    same $map moved/$map
done
rm -r moved

# ---- damaged, foreign, changed ----

# damaged FILE OFFSET: changes one byte of it.
damaged()
{
    cp farm/plan.$1.part keep
    at=$(($2 < 0 ? $(stat -c %s keep) + $2 : $2))
    byte=$(od -An -tu1 -j $at -N 1 keep)
    printf "\\$(printf %03o $((byte ^ 16)))" | dd of=farm/plan.$1.part bs=1 seek=$at conv=notrunc 2>"$work/dd"
}
for place in 0 8 12 17 33 45 50 90 99 5000 -1; do
    damaged 0001 $place
    $bake --plan farm/plan.json --merge --force
    refused_like 65 "^$p farm/plan\.0001\.part: .*: run this task again$"
    if [ $place = 5000 ]; then # the task itself notices, too
        ok $bake --plan farm/plan.json --task 1
        out_like '^farm/plan\.0001\.part: task 1, '
        same keep farm/plan.0001.part
    fi
    mv keep farm/plan.0001.part
done
cp farm/plan.0002.part keep
head -c 5000 keep >farm/plan.0002.part
$bake --plan farm/plan.json --merge --force
refused 65 "$p farm/plan.0002.part: damaged: its size is wrong: run this task again"
cp farm/plan.0001.part farm/plan.0002.part
$bake --plan farm/plan.json --merge --force
refused 65 "$p farm/plan.0002.part: the part of another task: run this task again"
: >farm/plan.0002.part
$bake --plan farm/plan.json --merge --force
err "$p farm/plan.0002.part: not a part of a bake: run this task again"
mv keep farm/plan.0002.part

# The reader in Python accepts what Bisque wrote and refuses what is damaged.
find_python
if [ -n "$python" ]; then
    "$python" -B "$top/tests/oracle/read_part.py" farm/plan.json farm/*.part >"$out" 2>"$err"
    check "the reader in Python accepts the parts" $?
    for place in 30 104 7000 -3; do
        damaged 0001 $place
        ! "$python" -B "$top/tests/oracle/read_part.py" farm/plan.json farm/plan.0001.part >"$out" 2>"$err" &&
            grep -q 'refused' "$out"
        check "the reader in Python refuses a part with a changed byte at $place" $?
        mv keep farm/plan.0001.part
    done
else
    lacks "a reader in Python" "python3-numpy or python3-xxhash is not installed"
fi

cp farm/plan.json plan.good
sed 's/"samples": 2/"samples": 3/' plan.good >farm/plan.json
$bake --plan farm/plan.json --task 0
refused 65 "$p farm/plan.json: damaged plan: its id does not fit the rest"
sed 's/"program_version": "[^"]*"/"program_version": "0.1.9"/' plan.good >farm/plan.json
$bake --plan farm/plan.json --task 0
refused_like 65 "^$p farm/plan\.json: this plan is of Bisque 0\.1\.9, this program is .*: all tasks need one version$"
for size_kept in 0 1 100 700 1500; do
    head -c $size_kept plan.good >farm/plan.json
    $bake --plan farm/plan.json --task 0
    code 65
done
echo '{"format": "a recipe"}' >farm/plan.json
$bake --plan farm/plan.json --task 0
err "$p farm/plan.json: not a plan of bisque-bake"
mv plan.good farm/plan.json
cp low.obj low.good
sed 's/^v 1 2 3/v 1 2 3.1/' low.good >low.obj
for step in "--task 0 --force" "--task 0" --merge; do # the last two are complete already
    $bake --plan farm/plan.json $step
    refused 65 "$p low.obj: the low-poly mesh is not the file that the plan farm/plan.json was made with: make a new plan"
done
mv low.good low.obj
# A plan with another option has another id.
ok run $plan --samples 1
$bake --plan farm/plan.json --merge
refused 65 "$p farm/plan.0000.part: a part of another plan: run this task again"
ok $bake --plan farm/plan.json --task 0
out_like '^farm/plan\.0000\.part: task 0, '

# ---- paths ----

# The scan names a texture, and the plan its files, by paths of another machine.
mkdir -p here/textures
printf 'P3 2 1 255 250 10 20 30 40 250' >here/textures/skin.ppm
sed 's/^v \([^ ]* [^ ]* [^ ]*\).*/v \1/' low.obj >here/skin.obj
sed -i '1i mtllib skin.mtl' here/skin.obj
sed -i 's/^f 4/usemtl skin\nf 4/' here/skin.obj
printf 'newmtl skin\nmap_Kd Z:\\Studio\\textures\\skin.ppm\n' >here/skin.mtl
cat >rules.json <<JSON
{"version": "pathmapping-1.0", "path_mapping_rules": [
{"source_path_format": "WINDOWS", "source_path": "z:\\\\", "destination_path": "/nowhere"},
{"source_path_format": "WINDOWS", "source_path": "z:\\\\studio", "destination_path": "$PWD/here"},
{"source_path_format": "POSIX", "source_path": "/mnt/farm", "destination_path": "$PWD/here"},
{"source_path_format": "POSIX", "source_path": "/mnt", "destination_path": "/nowhere"}]}
JSON
ok run bisque-voxelize /mnt/farm/skin.obj -o here/skin.nvdb --resolution 24 --path-map rules.json
holds "the texture is found by the rules" grep -aq "$PWD/here/textures/skin.ppm" here/skin.tris
ok $bake /mnt/farm/skin.tris low.obj $size -o "$PWD/here/<MAP>.<UDIM>.exr" --maps color --tasks 2 --plan here/plan.json \
    --path-map rules.json
jq -e '[.inputs[].path] | sort == ["../low.obj", "skin.tris", "textures/skin.ppm"]' here/plan.json >"$work/jq"
check "inputs below the plan and beside it have relative paths" $?
ok $bake ./here/skin.tris here/../low.obj $size -o './here/../<MAP>.<UDIM>.exr' --maps color --tasks 2 --plan here/dots.json \
    --path-map rules.json
jq -e '[.inputs[].path, .options.output_path] | sort ==
    ["../<MAP>.<UDIM>.exr", "../low.obj", "skin.tris", "textures/skin.ppm"]' here/dots.json >"$work/jq"
check "paths with . and .. are relative to the plan, too" $?
rm here/dots.json
mkdir other
cp here/*.tris here/*.json other
cp -r here/textures other
jq -c --arg here "$PWD/here" '{version: "pathmapping-1.0", path_mapping_rules: [{source_path_format: "POSIX",
    source_path: $here, destination_path: ($here | sub("here$"; "other"))}]}' -n >moved.json
mv here gone
for task in 0 1; do
    ok $bake --plan other/plan.json --task $task --path-map moved.json
done
ok $bake --plan other/plan.json --merge --path-map moved.json
ok $bake gone/skin.tris low.obj $size -o 'skin.<UDIM>.exr' --maps color --path-map moved.json
for tile in 1002 1012; do
    same skin.$tile.exr other/color.$tile.exr
done
# All tasks in one process: threads do not keep what they know of the textures of a task before.
ok $bake gone/skin.tris low.obj $size -o 'many.<UDIM>.exr' --maps color --tasks 12 --plan many.json \
    --path-map moved.json
ok $bake --plan many.json --task 0-11 --threads 2 --path-map moved.json
ok $bake --plan many.json --merge --path-map moved.json
for tile in 1002 1012; do
    same skin.$tile.exr many.$tile.exr
done
for bad in '{' '[]' '{"version": "pathmapping-2.0"}' '{"version": "pathmapping-1.0", "path_mapping_rules": 3}' \
    '{"version": "pathmapping-1.0", "path_mapping_rules": [{"source_path_format": "POSIX", "source_path": "/a"}]}' \
    '{"version": "pathmapping-1.0", "path_mapping_rules": [{"source_path_format": "DOS", "source_path": "/a", "destination_path": "/b"}]}'; do
    echo "$bad" >bad.json
    $bake --plan farm/plan.json --task 0 --path-map bad.json
    refused_like 65 "^$p bad\.json: no rules of pathmapping-1\.0: "
done
# What the parser would allocate is reserved from the budget: here about 100 bytes for each byte.
awk 'BEGIN { printf "["; for (i = 0; i < 300000; i++) printf "{},"; print "{}]" }' >wide.json
$bake --plan farm/plan.json --task 0 --path-map wide.json --memory 60M
code 71
$bake --plan wide.json --task 0 --memory 60M
code 71
rm wide.json
for none in '{"version": "pathmapping-1.0"}' '{}'; do
    echo "$none" >none.json
    ok $bake --plan farm/plan.json --task 0 --path-map none.json
done

# ---- progress ----

ok $bake scan.nvdb low.obj $size -o 'maps/<MAP>.<UDIM>.exr' --maps normal,curvature --progress openjd
percentages 's/^openjd_progress: \([0-9.]*\)$/\1/p' && grep -q '^openjd_status: tracing$' "$out" && [ ! -s "$err" ]
check "progress for Open Job Description rises from 0 to 100, also with two UDIM tiles" $?
ok $bake --plan farm/plan.json --task 0 --force --progress alf
percentages 's/^ALF_PROGRESS \([0-9]*\)%$/\1/p'
check "progress of a task rises from 0 to 100" $?
ok $bake --plan farm/plan.json --task 0-2 --force --progress openjd
percentages 's/^openjd_progress: \([0-9.]*\)$/\1/p' && grep -qx 'openjd_progress: 33.3' "$out" && grep -q '^farm/plan\.0002\.part: task 2' "$out"
check "progress of three tasks rises from 0 to 100 once" $?
$bake --plan farm/plan.json --task 9 --progress openjd
code 64
grep -qx 'openjd_fail: farm/plan.json: there is no task 9: tasks are 0 to 2' "$out" && ! grep -q 'openjd_progress: 100' "$out"
check "a failure for Open Job Description" $?
if [ -n "${LONG-}" ]; then # it takes half a minute
    rm -f flag
    command="bisque-bake that waits" code=0
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$(pwd -P) FAULT_CALLS=open FAULT_PATH=/low.obj FAULT_AT=1 FAULT_DO=pause \
        FAULT_FLAG=flag "$BIN/bisque-bake" --plan farm/plan.json --task 0 --force --progress percent >"$out" 2>"$err" &
    wait_for flag
    until [ "$(grep -c '^Progress: 0%$' "$out")" -ge 2 ]; do # another line comes within 30 s
        sleep 0.1
    done
    rm flag
    wait $! || code=$?
    code 0
fi

# ---- options ----

$bake scan.nvdb low.obj -o x.exr --tasks 4 --plan x.json --task 0
err "$p --task and --merge need --plan, without --tasks"
for tiles in 2-1 x; do
    $bake --plan farm/plan.json --merge --task $tiles
    code 64
done
$bake --plan farm/plan.json --task 0 --samples 4
err "$p --plan has the options of the work: leave out --samples"
$bake --plan farm/plan.json --task 0 low.obj
err "$p --plan names the inputs: leave out the files, or add --tasks"
$bake --task 0
err "$p --task and --merge need --plan, without --tasks"
$bake scan.nvdb low.obj -o x.exr --tasks 4
err "$p --tasks needs --plan, the file to write"
$bake scan.nvdb low.obj -o x.exr --force
err "$p --force needs --task or --merge"
$bake --plan farm/plan.json --force
err "$p --force needs --task or --merge"
for tasks in 2-1 1- -1 1-2-3 0x1 1-65536 '1 ' ''; do
    $bake --plan farm/plan.json --task "$tasks"
    refused_like 64 "^$p --task: \"$tasks\""
done
$bake --plan farm/plan.json --task 1-3
refused 64 "$p farm/plan.json: there is no task 3: tasks are 0 to 2"
$bake --plan farm/plan.json --max-missed 3
err "$p --max-missed is for the bake of all texels: give it to --merge"
$bake --plan farm/plan.json --merge --task 0 --max-missed 3
err "$p --max-missed is for the bake of all texels: give it to --merge"
mkfifo pipe.obj
cat low.obj >pipe.obj &
$bake scan.nvdb pipe.obj $size -o 'x_<MAP>.<UDIM>.exr' --tasks 4 --plan p.json
[ "$code" -ne 0 ] && [ ! -e p.json ]
check "no plan for a mesh from a pipe" $?
kill $! 2>"$work/kill"
$bake scan.nvdb low.obj $size -o "$(printf 'x\377_<MAP>.<UDIM>.exr')" --tasks 4 --plan p.json
code 64
holds "no plan with a name that is not UTF-8" [ ! -e p.json ]
$bake scan.nvdb low.obj $size -o 'x_<MAP>.<UDIM>.exr' --tasks 4 --plan nowhere/p.json
code 73
for tasks in 0 65537 x; do
    $bake scan.nvdb low.obj -o x.exr --tasks $tasks --plan p.json
    code 64
done
$bake --plan missing.json --task 0
code 66
$bake scan.nvdb low.obj -o o.exr --maps mask --tiles 1002 --tasks 2 --plan o.exr
refused 64 "$p o.exr: two outputs have this name"
$bake scan.nvdb low.obj $size -o './o.<UDIM>.exr' --maps height --tasks 2 --plan o.1012.exr
refused 64 "$p ./o.1012.exr: two outputs have this name"
$bake scan.nvdb low.obj -o o.exr --maps mask --tiles 1002 --tasks 2 --preview o.png --plan ./o.png
refused 64 "$p ./o.png: two outputs have this name"
ok $bake scan.nvdb low.obj -o o.exr --maps mask --tiles 1002 --tasks 1 --plan o.json
cp o.json o.exr
$bake --plan o.exr --merge
code 64
same o.json o.exr
rm o.json o.exr

# ---- Slurm: what would be submitted; tests/farm/ submits it ----

slurm=$top/tools/farm/bisque-slurm
command="bisque-slurm bake --dry-run" code=0
"$slurm" bake --dry-run --tasks 9 --at-most 4 --gpu --partition fast -- "a scan.nvdb" low.obj -o "o'<MAP>.exr" \
    >"$out" 2>"$err" || code=$?
code 0
holds "three jobs" [ "$(grep -c '^sbatch ' "$out")" -eq 3 ]
for line in "'--array=0-8%4' '--gres=gpu:1'" "'--dependency=afterok:<bisque-plan>' '--kill-on-invalid-dep=yes'" \
    "'--dependency=afterok:<bisque-task>' '--kill-on-invalid-dep=yes'" "'--output=logs/%A_%a.log'" "'--partition=fast'" \
    "'a scan.nvdb' 'low.obj' '-o' 'o'\\\\''<MAP>.exr' '--tasks' '9'"; do
    holds "submitted: $line" grep -qF -- "$(printf '%b' "$line")" "$out"
done
command="bisque-slurm bake --tiles --dry-run" code=0
"$slurm" bake --dry-run --tiles 3 -- s.nvdb low.obj -o 'o_<UDIM>.exr' >"$out" 2>"$err" || code=$?
code 0
[ "$(grep -c '^sbatch ' "$out")" -eq 4 ] && grep -qF "'--array=0-2'" "$out" &&
    grep -qF " --merge --task \$SLURM_ARRAY_TASK_ID" "$out" && grep -qF "'--dependency=afterok:<bisque-tile>'" "$out"
check "tiles are merged in an array, before the last job" $?
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
# Several tasks in an element of the array, also if there were too many elements otherwise.
for tasks in "--tasks 10 --chunk 4" "--tasks 2500"; do
    command="bisque-slurm bake $tasks --dry-run | sh" code=0
    "$slurm" bake --dry-run --at-most 5 $tasks -- s.nvdb low.obj -o o.exr | RUN=printed PATH=$PWD/fake:$PATH sh >"$out" 2>"$err"
    sed -n '/^first=/,/--task/p' scripts.printed | sed "s/^ 'bisque-bake'.*--task \(.*\) ||.*/echo \1/" >numbers
    ends=$(for element in 0 1 2 833; do SLURM_ARRAY_TASK_ID=$element sh numbers; done | tr '\n' ' ')
    case $tasks in
    *chunk*) [ "${ends%% 3332*}" = "0-3 4-7 8-9" ] ;;
    *) [ "$ends" = "0-2 3-5 6-8 2499-2499 " ] ;;
    esac
    check "elements bake several tasks: $tasks" $?
    rm scripts.printed numbers
done
rm -r fake scripts.*
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
"$slurm" parts --dry-run --tasks 2 list -- low.obj -o 'o_<MAP>.exr' >"$out" 2>"$err" || code=$?
code 0
[ "$(grep -c '^sbatch ' "$out")" -eq 5 ] && grep -qF "'--array=0-2'" "$out" &&
    grep -qF " 'p/a 1.tris' 'p/b.ply.tris' 'c.tris' ||" "$out" &&
    grep -qF "'--dependency=afterok:<bisque-sort>' '--kill-on-invalid-dep=yes'" "$out" &&
    grep -qF "'--dependency=afterok:<bisque-grid>' '--kill-on-invalid-dep=yes'" "$out" &&
    grep -qF "'bisque-bake' 'plan.nvdb' 'low.obj'" "$out"
check "parts are sorted, voxelized together and baked" $?
printf 'a.ply\na.obj\n' >twice
printf 'a.ply\n\nb.ply\n' >gap
: >empty
for bad in "" "bake --tasks 0 -- a b -o c" "bake --tasks 5" "bake --chunk 0 -- a b -o c" "bake --what" assets "render" \
    "parts twice -- l -o o" "parts gap -- l -o o" "parts empty -- l -o o" "parts none -- l -o o" "parts list" "assets none"; do
    command="bisque-slurm $bad" code=0
    # shellcheck disable=SC2086 # $bad is several words
    "$slurm" $bad >"$out" 2>"$err" || code=$?
    refused_like 64 '^bisque-slurm: '
done
rm list twice gap empty

# ---- Open Job Description: templates for a plan; tests/farm/ runs them ----

openjd=$top/tools/farm/bisque-openjd
command="bisque-openjd" code=0
"$openjd" bake --plan farm/plan.json --bin "$BIN" --chunk 2 --cpus 8 --gpu >"$out" 2>"$err" || code=$?
code 0
for line in 'extensions: [TASK_CHUNKING]' '    default: 2' '          type: CHUNK[INT]' \
    '          chunks: {defaultTaskCount: 2, rangeConstraint: CONTIGUOUS}' '        - {name: amount.worker.vcpu, min: 8}' \
    '        - {name: amount.worker.gpu, min: 1}'; do
    holds "the template has \"$line\"" grep -qxF -- "$line" "$out"
done
memory=$("$BIN/bisque-bake" --plan farm/plan.json --json | jq '.task_memory_bytes / 1048576 | ceil')
[ "$(grep -c "amount.worker.memory, min: $memory}" "$out")" -eq 3 ]
check "tasks and merges ask for the plan's memory" $?
for template in asset parts assets bake; do # without options, it is the template itself
    "$openjd" $template | cmp -s - "$top/tools/farm/$template.openjd.yaml"
    check "bisque-openjd $template" $?
    "$openjd" $template --gpu --scratch 7 >text
    grep -qxF '        - {name: amount.worker.gpu, min: 1}' text && grep -qxF '        - {name: amount.worker.disk.scratch, min: 7}' text
    check "bisque-openjd $template --gpu --scratch 7" $?
done
for bad in "" "asset parts" what "asset --chunk 0" "asset --cpus" "asset --memory 1G" "assets --plan farm/plan.json" "--what asset"; do
    command="bisque-openjd $bad" code=0
    # shellcheck disable=SC2086 # $bad is several words
    "$openjd" $bad >"$out" 2>"$err" || code=$?
    refused_like 64 '^bisque-openjd: '
done

# ---- other devices than the plan's ----

# The plan is made without a GPU. One task has one, which tests/fake/fake_cuda.c simulates, and the others have not.
rm -rf farm color.*.exr
mkdir farm
ok $bake scan.nvdb low.obj $size -o '<MAP>.<UDIM>.exr' --maps color --device cpu
ok $bake scan.nvdb low.obj $size -o 'farm/<MAP>.<UDIM>.exr' --maps color --device cuda --tasks 3 --plan farm/plan.json
LD_LIBRARY_PATH=$TESTS/fake $bake --plan farm/plan.json --task 0 --json
json '.device == "Fake GPU 0 (CUDA)"'
$bake --plan farm/plan.json --task 1 --device cpu --json
json '.device | startswith("cpu")'
$bake --plan farm/plan.json --task 2 --device opencl:99
code 69
ok $bake --plan farm/plan.json --task 2 --device auto
ok $bake --plan farm/plan.json --merge
for map in color.*.exr; do
    same "$map" "farm/$map"
done
for step in --merge ""; do
    $bake --plan farm/plan.json $step --device cpu
    refused 64 "$p --plan has the device of the tasks: give --device to --task only"
done

# ---- killed, interrupted, twice at once ----

if ldd "$BIN/bisque-bake" | grep -q 'lib[at]san'; then
    skip "tasks that are killed" "sanitizers want to be loaded first"
    finish
    exit
fi

run $plan --force # not with --tasks
code 64
ok run $plan
begin_faults bisque-bake
killed_at open write sync name
rm -f $part
command="bisque-bake --task 2 interrupted" code=0
faulty_task write TERM 0 || code=$?
refused 75 "$p interrupted"
holds "an interrupted task leaves no part" [ ! -e $part ]

second='"$faulted" --plan farm/plan.json --task 2 >"$work/second"'
twice "the same task completes meanwhile" "$second"
# On a machine where locks of other machines do not hold, the second removes the first one's file.
twice "its temporary file is removed meanwhile" 'rm farm/.plan.0002.part.*.tmp'
twice "both" "rm farm/.plan.0002.part.*.tmp; $second"
no_temporary_files

# ---- NFS that has neither files without a name nor flock ----

rm -rf farm color.*.exr
mkdir farm
ok $bake scan.nvdb low.obj $size -o '<MAP>.<UDIM>.exr' --maps color
plainly "$BIN/bisque-bake" scan.nvdb low.obj $size -o 'farm/<MAP>.<UDIM>.exr' --maps color --tasks 2 --plan farm/plan.json
plainly "$BIN/bisque-bake" --plan farm/plan.json --task 0-1
plainly "$BIN/bisque-bake" --plan farm/plan.json --merge
for map in color.*.exr; do
    same "$map" "farm/$map"
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
        ok $bake $scan flat.obj --maps color --size 300 --front 2 --back 2 -o farm/c.exr --tasks 2 --plan farm/plan.json
        ok $bake --plan farm/plan.json --task 0
        cp other/$scan $scan
        $bake --plan farm/plan.json --task 1
        refused_like 65 "^$p $scan: the scan is not the file that the plan farm/plan.json was made with: make a new plan$"
        rm -f farm/* $scan
    done
fi

finish

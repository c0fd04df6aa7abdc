#!/bin/sh
# test_grid_farm.sh - a grid as tasks: plans, parts and merges have the bytes of a single run; what
# is missing, damaged or foreign is refused by name; tasks may be killed, repeated and run twice.
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd) || exit 1
. "$(dirname "$0")/lib.sh"
. "$top/tests/cli/farm_lib.sh"

vox="run bisque-voxelize" p="bisque-voxelize:"
# A scan in three chunk files, two of which have colours, below and above the origin; its triangles
# are so large that normals are smooth across regions.
for part in a b c; do
    case $part in a) from=-20 to=-6 rgb=" 0.8 0.4 0.2" ;; b) from=-6 to=9 rgb= ;; c) from=9 to=20 rgb=" 0.1 0.4 0.9" ;; esac
    awk -v from=$from -v to=$to -v rgb="$rgb" 'BEGIN {
        for (y = 0; y <= 30; y++) for (x = from; x <= to; x++)
            printf "v %.6f %.6f %.6f%s\n", x, y - 15, 8 * sin(x / 5) * cos(y / 6), rgb
        w = to - from + 1
        for (y = 0; y < 30; y++) for (x = 0; x < w - 1; x++) {
            i = y * w + x + 1
            printf "o %d\nf %d %d %d\nf %d %d %d\n", x % 3, i, i + 1, i + w + 1, i, i + w + 1, i + w }
        print "f 1 2 3"   # a second sheet in a voxel: the first triangle from the other side
    }' >$part.obj
    sed -i '$s/.*/f 2 1 '"$((to - from + 3))"'/' $part.obj
    # A part is sorted alone.
    $vox $part.obj -o $part.tris --channels id --id object
    code 0
done
[ ! -e a.nvdb ]
check "sorting alone makes no grid" $?
out_like '^c\.tris: 1 chunk, '

# Sorting is a task too: what is complete is kept.
sort_c="c.obj -o c.tris --channels id --id object"
cp c.tris whole
before=$(stat -c %i.%y c.tris)
$vox $sort_c
out_like '^c\.tris: this chunk file is complete already, kept$'
$vox $sort_c --json --threads 1
json '.kept and .path == "c.tris"'
[ "$(stat -c %i.%y c.tris)" = "$before" ]
check "a complete chunk file is not touched" $?
echo '{"version": "pathmapping-1.0", "path_mapping_rules": [{"source_path_format": "POSIX", "source_path": "/a",
    "destination_path": "/b"}]}' >rules.json
for other in "--force" "--strict" "--path-map rules.json" ""; do # the last one has no rules
    $vox $sort_c $other
    out_like '^c\.tris: 1 chunk, '
    same whole c.tris
done
head -c 3000 whole >c.tris
$vox $sort_c
out_like '^c\.tris: 1 chunk, '
same whole c.tris
sed 's/^f 2 1 .*//' c.obj >d.obj
cp c.obj keep.obj
cp d.obj c.obj
$vox $sort_c
out_like '^c\.tris: 1 chunk, '
! cmp -s whole c.tris
check "a changed scan is sorted again" $?
mv keep.obj c.obj
$vox $sort_c
same whole c.tris
$vox - -o d.tris --channels id --id object <d.obj
$vox - -o d.tris --channels id --id object <d.obj
out_like '^d\.tris: 1 chunk, '
$vox a.tris -o x.nvdb --force
refused 64 "$p --force needs --task or --merge"
rm d.* whole rules.json
scans="a.tris b.tris c.tris"
mkdir farm

# alike TASKS OPTION...: the grid of a single run and of tasks is the same.
alike()
{
    rm -rf farm one.nvdb one.vdb
    mkdir farm
    tasks=$1
    shift
    $vox $scans -o one.nvdb "$@"
    code 0
    (cd farm && "$BIN/bisque-voxelize" ../a.tris ../b.tris ../c.tris -o grid.nvdb --tasks "$tasks" "$@" \
        --write-plan plan.json >"$out" 2>"$err")
    check "a plan of $tasks tasks: $*" $?
    task=$tasks
    while [ $task -gt 0 ]; do # in any order, with other threads and budgets
        task=$((task - 1))
        run bisque-voxelize --plan farm/plan.json --task $task --threads $((1 + task % 2)) --memory 60M
        [ "$code" -eq 0 ] || break
    done
    check "tasks: $*" "$code"
    $vox --plan farm/plan.json --merge --memory 60M
    code 0
    same one.nvdb farm/grid.nvdb
}

alike 1 --resolution 300
alike 2 --resolution 300 --grid-type onindex --channels id
alike 5 --voxel-size 0.08 --scan-normals flat
grep -q '"regions": 0' farm/plan.json
[ $? -ne 0 ]
check "each of five tasks has regions" $?
alike 40 --resolution 200 # more tasks than regions
grep -q '"regions": 0' farm/plan.json
check "some tasks have no regions" $?

# ---- the same again ----

rm -rf farm/*
plan="bisque-voxelize $scans -o farm/grid.nvdb --resolution 300 --tasks 3 --write-plan farm/plan.json"
run $plan
grep -Eqx 'farm/plan\.json: 3 tasks for [0-9]+ regions' "$out"
check "a plan is written" $?
[ "$(cat "$err")" = "$p warning: b.tris: no vertex colours, so what has no texture is white; other parts of the scan have vertex colours; parts like this: 1" ]
check "the plan warns, tasks and merges do not" $?
run $plan
grep -Eqx 'farm/plan\.json: 3 tasks for [0-9]+ regions, was there already' "$out"
check "a plan is kept" $?
$vox --plan farm/plan.json --json
json '.tasks == 3 and .regions > 3 and .task_memory_bytes > 0 and .parts_bytes > 0 and .cpu_seconds > 0'
$vox --plan farm/plan.json --merge
code 66
err "$p farm/plan.0000.part: missing; 3 of 3 parts are missing: those of tasks 0, 1, 2"
$vox --plan farm/plan.json --task 2 --json
json '.task == 2 and (.kept | not) and .voxels > 0 and .regions > 0 and .part_bytes > 0'
$vox --plan farm/plan.json --task 0-2 # the last one is there
grep -q '^farm/plan\.0002\.part: this part is complete already, kept$' "$out"
check "a complete part is kept" $?
cp farm/plan.0001.part whole
$vox --plan farm/plan.json --task 1 --force --memory 60M --threads 3
same whole farm/plan.0001.part
$vox --plan farm/plan.json --merge --json
json '(.kept | not) and .grid.voxels > 0 and .grid.index_min == [0, 0, 0]'
$vox $scans -o one.nvdb --resolution 300 --json
jq -c .grid "$out" | sed 's/,"seconds":.*//' >one.json
$vox --plan farm/plan.json --merge --force --json
jq -c .grid "$out" | sed 's/,"seconds":.*//' >merged.json
same one.json merged.json
$vox --plan farm/plan.json --merge
out_like '^farm/plan\.json: the merge of this plan is complete already, kept$'

# A folder can move, with all that a plan names below it or beside it.
mkdir moved
cp -r ?.tris farm moved
rm moved/farm/grid.nvdb
(cd moved/farm && "$BIN/bisque-voxelize" --plan plan.json --merge) >"$out" 2>"$err"
same farm/grid.nvdb moved/farm/grid.nvdb
rm -r moved

# ---- damaged, foreign, changed ----

# damaged OFFSET: changes one byte of the part of task 1.
damaged()
{
    size=$(stat -c %s whole)
    at=$(($1 < 0 ? size + $1 : $1))
    byte=$(od -An -tu1 -j $at -N 1 whole)
    cp whole farm/plan.0001.part
    printf "\\$(printf %03o $((byte ^ 16)))" | dd of=farm/plan.0001.part bs=1 seek=$at conv=notrunc 2>"$work/dd"
}
for place in 0 8 12 17 33 45 70 100 108 112 118 130 5000 -1; do
    damaged $place
    $vox --plan farm/plan.json --merge --force
    code 65
    err_like "^$p farm/plan\.0001\.part: .*: run this task again$"
done
$vox --plan farm/plan.json --task 1 # notices the damage, too
out_like '^farm/plan\.0001\.part: task 1, '
same whole farm/plan.0001.part
for bytes in 0 50 112 5000; do
    head -c $bytes whole >farm/plan.0001.part
    $vox --plan farm/plan.json --merge --force
    code 65
done
cp farm/plan.0002.part farm/plan.0001.part
$vox --plan farm/plan.json --merge --force
err "$p farm/plan.0001.part: the part of another task: run this task again"
cp whole farm/plan.0001.part

# The reader in Python accepts what Bisque wrote and refuses what is damaged.
python=
for candidate in python3 /usr/bin/python3; do
    [ -n "$python" ] || ! "$candidate" -c 'import numpy, xxhash' 2>/dev/null || python=$candidate
done
if [ -n "$python" ]; then
    "$python" -B "$top/tests/oracle/read_grid_part.py" farm/plan.json farm/*.part >"$out" 2>"$err"
    check "the reader in Python accepts the parts" $?
    for place in 40 104 7000 -3; do
        damaged $place
        ! "$python" -B "$top/tests/oracle/read_grid_part.py" farm/plan.json farm/plan.0001.part >"$out" 2>"$err" &&
            grep -q 'refused' "$out"
        check "the reader in Python refuses a part with a changed byte at $place" $?
    done
    cp whole farm/plan.0001.part
else
    skip "a reader in Python" "python3-numpy or python3-xxhash is not installed"
fi

cp farm/plan.json plan.good
sed 's/"resolution": 300/"resolution": 301/' plan.good >farm/plan.json
$vox --plan farm/plan.json --task 0
code 65
err "$p farm/plan.json: damaged plan: its id does not fit the rest"
sed 's/"program_version": "[^"]*"/"program_version": "0.1.9"/' plan.good >farm/plan.json
$vox --plan farm/plan.json --task 0
code 65
err_like "^$p farm/plan\.json: this plan is of Bisque 0\.1\.9, this program is .*: all tasks need one version$"
echo '{"format": "Bisque bake plan"}' >farm/plan.json
$vox --plan farm/plan.json --task 0
err "$p farm/plan.json: not a plan of bisque-voxelize"
mv plan.good farm/plan.json
mv b.tris b.good
cp c.tris b.tris
for step in "--task 0 --force" "--task 0" --merge; do # the last two are complete already
    $vox --plan farm/plan.json $step
    code 65
    err "$p b.tris: the scan is not the file that the plan farm/plan.json was made with: make a new plan"
done
mv b.good b.tris
$vox $scans -o farm/grid.nvdb --resolution 299 --tasks 3 --write-plan farm/plan.json
$vox --plan farm/plan.json --merge
code 65
err "$p farm/plan.0000.part: a part of another plan: run this task again"

# ---- paths ----

cat >rules.json <<JSON
{"version": "pathmapping-1.0", "path_mapping_rules": [
{"source_path_format": "POSIX", "source_path": "/mnt/studio", "destination_path": "$PWD"}]}
JSON
$vox /mnt/studio/a.tris -o farm/m.nvdb --resolution 50 --tasks 1 --write-plan farm/m.json --path-map rules.json
code 0
$vox --plan /mnt/studio/farm/m.json --task 0 --path-map rules.json --progress percent
code 0
grep -qx 'Progress: 100%' "$out"
check "progress of a task" $?

# ---- options ----

$vox --plan farm/plan.json --task 0 --resolution 4
err "$p --plan has the options of the work: leave out --resolution"
$vox --plan farm/plan.json --task 3
code 64
err "$p farm/plan.json: there is no task 3: tasks are 0 to 2"
$vox a.obj -o x.nvdb --tasks 2 --write-plan x.json
refused 64 "$p a.obj: tasks share chunk files: sort it first, with -o FILE.tris"
$vox a.tris -o x.tris --tasks 2 --write-plan x.json
refused 64 "$p a plan is for a grid: leave out the chunk file as output"
$vox a.tris -o ./x.nvdb --tasks 2 --write-plan x.nvdb
refused 64 "$p x.nvdb: two outputs have this name"
$vox a.tris -o x.tris
refused 64 "$p x.tris: only meshes can be sorted, and an input is a chunk file"
$vox a.obj -o x.tris --vdb x.vdb
refused 64 "$p x.tris: a chunk file is not a grid: leave out --vdb"
$vox a.tris -o x.nvdb --tasks 2 --write-plan nowhere/x.json
code 73

# ---- killed, twice at once ----

if ldd "$BIN/bisque-voxelize" | grep -q 'lib[at]san'; then
    skip "tasks that are killed" "sanitizers want to be loaded first"
    finish
    exit
fi
begin_faults bisque-voxelize
killed_at open write name
twice "the same task completes meanwhile" '"$faulted" --plan farm/plan.json --task 2 >"$work/second"'
# On a machine where locks of other machines do not hold, the second removes the first one's file.
twice "its temporary file is removed meanwhile" 'rm farm/.plan.0002.part.*.tmp'
no_temporary_files

# ---- NFS that has neither files without a name nor flock ----

rm -rf farm one.nvdb
mkdir farm
$vox a.obj -o alone.tris
code 0
$vox $scans -o one.nvdb --resolution 120
code 0
plainly "$BIN/bisque-voxelize" a.obj -o farm/alone.tris
same alone.tris farm/alone.tris
plainly "$BIN/bisque-voxelize" $scans -o farm/whole.nvdb --resolution 120
same one.nvdb farm/whole.nvdb
plainly "$BIN/bisque-voxelize" $scans -o farm/grid.nvdb --resolution 120 --tasks 2 --write-plan farm/plan.json
plainly "$BIN/bisque-voxelize" --plan farm/plan.json --task 0-1
plainly "$BIN/bisque-voxelize" --plan farm/plan.json --merge
same one.nvdb farm/grid.nvdb
no_temporary_files
finish

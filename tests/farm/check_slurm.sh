#!/bin/sh
# check_slurm.sh - bisque-slurm on a real Slurm cluster. A scan in eight parts goes through all
# steps. Among the tasks that sort, those of the grid and those of the bake, a node dies in the middle
# of one task, another task is requeued, a third runs twice at once. The grid and the maps have the
# bytes of a single run.
# SECONDS_LIMIT: the longest wait for a job.
. "$(dirname "$0")/../cli/lib.sh"
. "$top/tests/farm/slurm_cluster.sh"
. "$top/tests/farm/parts.sh"
limit=${SECONDS_LIMIT:-3600}
slurm=$top/tools/farm/bisque-slurm
trap 'stop_cluster; cd / && rm -rf "$work"' EXIT

"$TESTS/generate-scan" --triangles 60000 --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
write_parts scan.obj
voxelize_parts 300
options="--maps normal,color,height,curvature,ao --size 640 --samples 2 --rays ao=16 --device cpu"
run bisque-bake parts.nvdb low.obj -o 'one_<MAP>.exr' $options --preview one.png
code 0

command=start_cluster code=0
start_cluster || code=$?
check "a cluster of four nodes" $code
[ "$code" -eq 0 ] || { cat "$cluster"/*.log; finish; exit 1; }

# submit OPTION...: runs bisque-slurm.
submit()
{
    command="bisque-slurm $*" code=0
    LD_PRELOAD=$preload "$slurm" "$@" >"$out" 2>"$err" || code=$?
    code 0
}
preload=

# state ID: the states of a job's tasks, without those of the past.
jobs_left()
{
    squeue -h -o %i 2>/dev/null | wc -l
}
completed()
{
    scontrol show job "$1" 2>/dev/null | sed -n 's/.*JobState=\([A-Z_]*\).*/\1/p' | sort | uniq -c | tr -s ' '
}

# Each task stops before it gives its output a name, until somebody removes the file "held".
export BIN FAULT_UNDER="$(pwd -P)" FAULT_PATH=part FAULT_CALLS=name FAULT_AT=1 FAULT_DO=pause FAULT_FLAG="$work/held" \
    FAULT_LOG="$work/stops"
preload=$TESTS/faults.so

# disturb WHAT JOB PATTERN COMMAND: waits until three tasks of the job stand before the names of their
# outputs, which the pattern matches. The node of one dies and starts again, a second task is requeued,
# a third runs twice at once: by the command, whose $1 is its number. Then all tasks go on.
disturb()
{
    pattern=$3
    wait_until "$limit" '[ "$(cat "$work/stops" 2>/dev/null | grep -c "$pattern")" -ge 3 ]'
    check "three tasks that $1 are held" $?
    squeue -h -t R -j "$2" -o '%N %A %K' | sort >running
    read -r died _ lost <running
    twice=$(sed -n '3s/.* //p' running)
    lose_node "$died"
    scontrol requeue "$(sed -n '2{s/^[^ ]* //;s/ .*//;p;}' running)"
    sh -c "$4" sh "$twice" >"$work/double" 2>&1
    check "task $twice of those that $1 runs a second time, $died is lost with task $lost" $?
    start_node "$died"
    job=$2
    wait_until "$limit" 'rm -f "$work/held"; [ -z "$(squeue -h -j "$job" -o %i 2>/dev/null)" ]'
    check "all tasks that $1 end" $?
}

submit parts --parts 8 --at-most 4 --cpus 1 --memory 400 --bin "$BIN" --grid farm.nvdb --resolution 300 parts.txt -- \
    low.obj -o 'farm_<MAP>.exr' $options --preview farm.png
holds "the numbers of four jobs are printed" [ "$(grep -c ': job [0-9]*$' "$out")" -eq 4 ]
sort=$(sed -n 's/^bisque-sort: job //p' "$out")
task=$(sed -n 's/^bisque-part: job //p' "$out")
merge=$(sed -n 's/^bisque-merge: job //p' "$out")
disturb "sort" "$sort" 'part_.\.tris' '"$BIN/bisque-voxelize" -o "part_$1.tris" "part_$1.obj"'
wait_until "$limit" '[ "$(squeue -h -t R -j "$task" -o %i 2>/dev/null | wc -l)" -ge 3 ]'
check "tasks run" $?

# The node of one task dies; another task is put back; a third has a double.
set -- $(squeue -h -t R -j "$task" -o '%N %A %K' | sort | head -n 1)
lost_node=$1 lost=$3
lose_node "$lost_node"
set -- $(squeue -h -t R -j "$task" -o '%N %A %K' | grep -v "^$lost_node " | head -n 1)
again=${3-none} queued=${2-}
twice=$(squeue -h -t R -j "$task" -o '%N %K' | grep -v "^$lost_node \| $again$" | sed -n 's/.* //p' | head -n 1)
holds "a third task runs" [ -n "$twice" ]
"$BIN/bisque-bake" farm.nvdb low.obj -o 'farm_<MAP>.exr' $options --part $((${twice:-7} + 1))/8 --threads 1 >"$work/double" 2>&1 &
double=$!
[ -z "$queued" ] || scontrol requeue "$queued"
echo "# node $lost_node lost with task $lost, task $again requeued, task ${twice:-7} twice"
wait $double
check "the double of a task that runs" $?
wait_until "$limit" 'rm -f "$work/held"; [ "$(jobs_left)" -eq 0 ]'
preload=
check "all jobs end" $?
holds "job $merge is completed" [ "$(completed "$merge")" = " 1 COMPLETED" ]
sed 's/^/# /' logs/*.log | grep -i 'error\|bisque-bake:' | head
for map in normal color height curvature ao; do
    same one_$map.exr farm_$map.exr
done
same one.png farm.png
same parts.nvdb farm.nvdb
holds "eight chunk files" [ "$(ls part_?.tris | wc -l)" -eq 8 ]
[ "$(grep -c '^Progress: 0%$' logs/"${task}_$lost.log")" -ge 2 ] && grep -q '^Progress: 100%$' logs/"${task}_$lost.log"
check "the task whose node was lost was started again, in the same log" $?
[ "$(scontrol show node "$lost_node" | sed -n 's/.*State=\(DOWN\).*/\1/p')" = DOWN ]
check "the node is known to be down" $?
start_node "$lost_node"

# ---- many assets ----

for i in 1 2 3; do
    cp scan.obj asset$i.obj
    printf 'asset%d.obj\tlow.obj\tasset%d_<MAP>.exr\n' $i $i
done >list
submit assets --resolution 64 --cpus 1 --memory 400 --bin "$BIN" list -- --maps normal --size 64 --device cpu
wait_until "$limit" '[ "$(jobs_left)" -eq 0 ]'
run bisque-voxelize asset1.obj --no-tris -o one.nvdb --resolution 64
run bisque-bake one.nvdb low.obj --maps normal --size 64 --device cpu -o one.exr
for i in 1 2 3; do
    same one.exr asset${i}_normal.exr
done

# ---- a bake alone ----

submit bake --parts 3 --cpus 1 --memory 400 --bin "$BIN" -- parts.nvdb low.obj -o 'three_<MAP>.exr' --maps normal --size 64 \
    --device cpu
holds "the numbers of two jobs are printed" [ "$(grep -c ': job [0-9]*$' "$out")" -eq 2 ]
wait_until "$limit" '[ "$(jobs_left)" -eq 0 ]'
run bisque-bake parts.nvdb low.obj -o 'whole_<MAP>.exr' --maps normal --size 64 --device cpu
code 0
same whole_normal.exr three_normal.exr

# A task that cannot succeed ends the jobs that wait for it.
submit bake --parts 2 --cpus 1 --memory 400 --bin "$BIN" -- none.nvdb low.obj -o 'x_<MAP>.exr'
wait_until "$limit" '[ "$(jobs_left)" -eq 0 ]'
check "jobs that depend on a failed one are cancelled" $?
[ -z "$(ls | grep '^x_')" ]
check "and write nothing" $?
finish

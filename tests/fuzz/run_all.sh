#!/bin/bash
# run_all.sh OPTIONS JOBS NAME... - fuzzes each target of build/fuzz/tests with libFuzzer's OPTIONS,
# JOBS at a time, from tests/fuzz/corpus and from what earlier runs found (build/fuzz/corpus). Prints
# a line for each. If a target fails, prints the end of its log, and the input is in
# build/fuzz/failures.
set -u
cd "$(dirname "$0")/../.." || exit 1
read -r -a options <<<"$1"
jobs=$2
shift 2
failures=build/fuzz/failures

fuzz()
{
    local name=$1 log=build/fuzz/$1.log dict=tests/fuzz/dict/$1.dict block=256 all=1500
    # Draco reserves as much as a damaged count says, mostly without touching it.
    [ "$name" != compressed ] || block=30000 all=6000
    mkdir -p "build/fuzz/corpus/$name"
    if ! "build/fuzz/tests/fuzz-$name" "${options[@]}" -print_final_stats=1 \
        -timeout=120 -malloc_limit_mb=$block -rss_limit_mb=$all $([ ! -e "$dict" ] || echo "-dict=$dict") \
        -artifact_prefix="$failures/$name-" "build/fuzz/corpus/$name" "tests/fuzz/corpus/$name" \
        >"$log" 2>&1; then
        echo "fuzz-$name: FAILED, see $log and $failures/$name-*:"
        tail -n 40 "$log"
        return 1
    fi
    awk -v name="$name" '/stat::number_of_executed_units/ { runs = $2 }
        /stat::new_units_added/ { new = $2 }
        END { printf "fuzz-%s: %d executions, %d new inputs\n", name, runs, new }' "$log"
}

mkdir -p "$failures"
status=0 running=0
for name; do
    [ "$running" -lt "$jobs" ] || { wait -n || status=1; running=$((running - 1)); }
    fuzz "$name" &
    running=$((running + 1))
done
while [ "$running" -gt 0 ]; do
    wait -n || status=1
    running=$((running - 1))
done
exit $status

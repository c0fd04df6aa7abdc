#!/bin/bash
# interrupt.sh RUNS SECONDS PROGRAM ARGUMENT... - sends SIGTERM to a program at RUNS moments, evenly spread over its first
# SECONDS, and prints how long it takes to end, the slowest last. For large inputs, by hand. Run it in a directory of its
# own; each interruption must leave the directory unchanged.
set -u
[ $# -ge 3 ] || { sed -n '2,4s/^# //p' "$0" >&2; exit 64; }
runs=$1 seconds=$2
shift 2
before=$(ls -A)
for ((i = 1; i <= runs; i++)); do
    moment=$(awk "BEGIN { print $seconds * ($i - 0.5) / $runs }")
    "$@" --progress json >/dev/null 2>interrupt.log &
    program=$!
    sleep "$moment"
    sent=$(date +%s%N)
    kill -TERM $program 2>/dev/null || true
    wait $program
    code=$?
    late=$((($(date +%s%N) - sent) / 1000000))
    stage=$(grep -o '"stage": *"[a-z]*"' interrupt.log | tail -n 1)
    left=''
    if [ $code -ne 0 ]; then
        rm interrupt.log
        [ "$(ls -A)" = "$before" ] || left=", and left something"
    fi
    printf '%6d ms after SIGTERM at %7.2f s: exit code %d, last stage %s%s\n' $late "$moment" $code "$stage" "$left"
    [ $code -ne 0 ] || { rm -f interrupt.log; echo "it ends by itself before $moment s"; break; }
done | sort -n

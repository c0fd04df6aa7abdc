#!/bin/sh
# test_replay.sh - runs each fuzz target on its seeds and on inputs that failed before.
corpus=$(cd "$(dirname "$0")/../fuzz/corpus" && pwd) || exit 1
. "$(dirname "$0")/lib.sh"
for directory in "$corpus"/*/; do
    name=$(basename "$directory")
    command="replay-$name" code=0
    "$TESTS/replay-$name" "$directory"* >"$out" 2>"$err" || code=$?
    check "$name: $(ls "$directory" | wc -l) files" "$code"
done
finish

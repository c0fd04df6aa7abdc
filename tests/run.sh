#!/bin/sh
# Runs test programs that print TAP lines, prints a line for each, and the counts at the end. A
# program that fails without naming a failed test counts as one failure.
set -u
export CMOCKA_MESSAGE_OUTPUT=TAP
# Sanitizer options, for programs built with config=tsan or config=asan. die_after_fork=0 because
# some tests fork.
lint=$(cd "$(dirname "$0")/lint" && pwd) || exit 1
export TSAN_OPTIONS="suppressions=$lint/tsan.supp die_after_fork=0 ${TSAN_OPTIONS-}"
export LSAN_OPTIONS="suppressions=$lint/lsan.supp:print_suppressions=0:${LSAN_OPTIONS-}"
# Compiled OpenCL kernels go to the tests' cache, not to the user's.
XDG_CACHE_HOME=$(cd "${TESTS:?}" && pwd)/cache || exit 1
export XDG_CACHE_HOME
log=$(mktemp) || exit 1
trap 'rm -f "$log"' EXIT
passed=0 failed=0 skipped=0
for program; do
    "$program" >"$log" 2>&1
    status=$?
    # cmocka also prints "not ok" for skipped tests.
    ok=$(grep '^ok ' "$log" | grep -vci '# skip')
    skip=$(grep -Eci '^(not )?ok .*# skip' "$log")
    bad=$(grep '^not ok ' "$log" | grep -vci '# skip')
    [ "$status" -eq 0 ] || [ "$bad" -gt 0 ] || bad=1
    [ $((ok + skip)) -gt 0 ] || [ "$bad" -gt 0 ] || bad=1
    echo "$program: $ok passed, $bad failed, $skip skipped"
    if [ "$bad" -gt 0 ]; then
        grep -v '^ok ' "$log"
        echo "exit status $status"
    elif [ "$skip" -gt 0 ]; then
        grep -i '# skip' "$log"
    fi
    passed=$((passed + ok)) failed=$((failed + bad)) skipped=$((skipped + skip))
done
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ]

#!/bin/sh
# Runs test programs that print TAP lines, as many at once as there are processors (JOBS). Prints a
# line for each with its seconds, and the counts at the end. A program that fails without naming a
# failed test counts as one failure. TEST_SECONDS: a program that runs longer is stopped, and fails.
# CI, if it is set: checks that need a missing package fail; else they are skipped. The file SKIPS,
# if it is set, gets a line for each skipped check.
set -u
export CMOCKA_MESSAGE_OUTPUT=TAP
here=$(cd "$(dirname "$0")" && pwd) || exit 1
# Sanitizer options, for programs built with config=tsan or config=asan. die_after_fork=0 because
# some tests fork.
export TSAN_OPTIONS="suppressions=$here/lint/tsan.supp die_after_fork=0 ${TSAN_OPTIONS-}"
# The leak sanitizer may crash at exit when it looks at dynamic thread-local memory of modules that
# were closed ("Tracer caught signal 11"), so it does not follow such memory.
export ASAN_OPTIONS="intercept_tls_get_addr=0 ${ASAN_OPTIONS-}"
export LSAN_OPTIONS="suppressions=$here/lint/lsan.supp:print_suppressions=0:${LSAN_OPTIONS-}"
# Compiled OpenCL kernels go to the tests' cache, not to the user's.
XDG_CACHE_HOME=$(cd "${TESTS:?}" && pwd)/cache || exit 1
export XDG_CACHE_HOME
results=$(mktemp -d) || exit 1
export results
trap 'rm -rf "$results"' EXIT
trap 'exit 130' INT TERM

# Runs program $0. Its lines and counts go to files of their own in $results.
# shellcheck disable=SC2016
run_one='
    log=$(mktemp "$results/XXXXXX") || exit 1
    started=$(date +%s)
    ${TEST_SECONDS:+timeout --kill-after=10 "$TEST_SECONDS"} "$0" >"$log" 2>&1
    status=$?
    seconds=$(($(date +%s) - started))
    # cmocka also prints "not ok" for skipped tests.
    ok=$(grep -a "^ok " "$log" | grep -avci "# skip")
    skip=$(grep -aEci "^(not )?ok .*# skip" "$log")
    bad=$(grep -a "^not ok " "$log" | grep -avci "# skip")
    [ "$status" -eq 0 ] || [ "$bad" -gt 0 ] || bad=1
    [ $((ok + skip)) -gt 0 ] || [ "$bad" -gt 0 ] || bad=1
    echo "$ok $bad $skip" >"$log.counts"
    {
        echo "$0: $ok passed, $bad failed, $skip skipped, $seconds s"
        if [ "$bad" -gt 0 ]; then
            grep -av "^ok " "$log"
            echo "exit status $status${TEST_SECONDS:+, 124 if it ran for $TEST_SECONDS s}"
        elif [ "$skip" -gt 0 ]; then
            grep -ai "# skip" "$log"
        fi
    } >"$log.lines"
    [ -z "${SKIPS-}" ] || grep -aEi "^(not )?ok .*# skip" "$log" >>"$SKIPS"
    flock "$results" cat "$log.lines"
'
printf '%s\0' "$@" | xargs -0 -n 1 -P "${JOBS:-$(nproc)}" sh -c "$run_one" || exit 1
cat "$results"/*.counts | awk -v programs=$# '
    { passed += $1; failed += $2; skipped += $3 }
    END {
        print passed " passed, " failed " failed, " skipped " skipped"
        exit failed > 0 || NR != programs
    }'

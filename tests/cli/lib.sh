# lib.sh - shared by the tests of the programs. Each test_*.sh sources it, runs in an empty
# directory of its own, and prints a line "ok" or "not ok" for each check. BIN and TESTS are the
# directories of the programs and of the test programs.
#
#   run PROGRAM ARGUMENT...   runs it; sets $code, $command, and the files $out and $err
#   ok run PROGRAM ...        runs it; its exit code must be 0
#   code N, err LINE, ...     check the last run, see below
#   finish                    prints the counts; the exit status is 1 after a failed check

set -u
LC_ALL=C
export LC_ALL
unset TMPDIR POSIXLY_CORRECT
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd) || exit 1
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd) || exit 1
top=$(cd "$(dirname "$0")/../.." && pwd) || exit 1
work=$(mktemp -d /tmp/bisque-cli.XXXXXX) || exit 1
out=$work/out err=$work/err
mkdir "$work/here" && cd "$work/here" || exit 1
trap 'cd / && chmod -R u+w "$work" && rm -rf "$work"' EXIT
trap 'exit 1' INT TERM HUP

passed=0 failed=0

# check NAME STATUS: the check passes if STATUS is 0.
check()
{
    if [ "$2" -eq 0 ]; then
        passed=$((passed + 1))
        echo "ok $((passed + failed)) - $1"
    else
        failed=$((failed + 1))
        echo "not ok $((passed + failed)) - $1"
        echo "# command: $command"
        echo "# exit code: $code"
        sed 's/^/# stdout: /' "$out" | head -n 20
        sed 's/^/# stderr: /' "$err" | head -n 20
    fi
}

# holds NAME COMMAND...: the check passes if the command succeeds.
holds()
{
    held=$1
    shift
    "$@"
    check "$held" $?
}

run()
{
    command=$*
    program=$1
    shift
    code=0
    "$BIN/$program" "$@" >"$out" 2>"$err" || code=$?
    # Most meshes of the tests have no normals.
    [ "$program" != bisque-bake ] || sed -i '/^bisque-bake: warning: .* has no normals.*: it gets /d' "$err"
}

# code N: the exit code.
code()
{
    [ "$code" -eq "$1" ]
    check "exit code $1: $command" $?
}

# err LINE: standard error is exactly this line, standard output is empty.
err()
{
    [ "$(cat "$err")" = "$1" ] && [ ! -s "$out" ]
    check "message: $1" $?
}

# err_like PATTERN: standard error is one line that matches, standard output is empty.
err_like()
{
    [ "$(wc -l <"$err")" -eq 1 ] && grep -Eq -- "$1" "$err" && [ ! -s "$out" ]
    check "message like: $1" $?
}

# out_like PATTERN: a line of standard output matches, standard error is empty.
out_like()
{
    grep -Eq -- "$1" "$out" && [ ! -s "$err" ]
    check "output like: $1" $?
}

# ok COMMAND...: a command such as run, after which the exit code is 0.
ok()
{
    "$@"
    code 0
}

# refused CODE LINE, refused_like CODE PATTERN: the exit code, and err or err_like.
refused()
{
    code "$1"
    err "$2"
}
refused_like()
{
    code "$1"
    err_like "$2"
}

# json EXPRESSION: standard output is JSON, and jq finds the expression true.
json()
{
    jq -e "$1" "$out" >/dev/null 2>&1
    check "JSON: $1" $?
}

# files NAME...: the directory has exactly these files, hidden ones included.
files()
{
    [ "$(ls -A)" = "$(printf '%s\n' "$@" | sort)" ]
    check "files after $command: $*" $?
}

# same A B: the files have equal bytes.
same()
{
    cmp -s "$1" "$2"
    check "$1 and $2 are the same" $?
}

# help_and_man_page PROGRAM: its man page is well-formed, and lists the options of --help and no
# others, with the keys of options such as --rays ao=N.
help_and_man_page()
{
    page=$top/man/$1.1
    run "$1" --help
    code 0
    out_like "^Usage: $1 "
    awk '/^  (-o,|   ) --/ { name = $1 == "-o," ? $2 : $1; key = $1 == "-o," ? $3 : $2 }
        /^       +[a-z]+=[A-Z]/ { key = $1 }
        key ~ /^[a-z]+=/ { sub(/=.*/, "", key); print name " " key; key = ""; next }
        /^  (-o,|   ) --/ { print name }' "$out" | sort -u >help_options
    sed -e :a -e '/\\$/N; s/ \\\n/ /; ta' "$page" | sed -n 's/^\.It Fl //p' | sed 's/ Fl /\n/g' |
        sed -n 's/^\\-\([a-z][a-z0-9-]*\)\( Cm \([a-z]*\) Ns =\)\{0,1\}.*/--\1 \3/p' |
        sed 's/ $//' | sort -u >page_options
    if command -v mandoc >/dev/null; then
        command="mandoc -T lint $page" code=0
        mandoc -T lint -W warning "$page" >"$out" 2>"$err" || code=$?
        check "$page is well-formed" "$code"
    else
        lacks "$page is well-formed" "mandoc is not installed"
    fi
    command="diff help_options page_options" code=0
    diff help_options page_options >"$out" 2>"$err" || code=$?
    [ "$code" -eq 0 ] && [ -s help_options ]
    check "$page has the options of --help" $?
    rm help_options page_options
}

# at_look N WHAT STAGE PROGRAM ARGUMENT...: runs the program; WHAT, a FAULT_DO of tests/faults/fault.h,
# happens when it looks for an interruption the N-th time, in stages whose names contain STAGE. Sets
# what run() sets, and: $looks, how often it looked; $later, how often after a signal.
at_look()
{
    look=$1 what=$2 stage=$3 program=$4
    shift 4
    command="$program $*, $what at look $look ${stage:+while $stage}" code=0 looks=0 later=0
    rm -f "$work/looks"
    # The parent of the test may ignore signals, and programs inherit that.
    FAULT_CALLS=check FAULT_PATH=$stage FAULT_AT=$look FAULT_DO=$what FAULT_COUNT=$work/looks \
        env --default-signal=TERM,INT,HUP "$TESTS/bin/$program" "$@" >"$out" 2>"$err" || code=$?
    [ ! -s "$work/looks" ] || read -r looks later <"$work/looks"
}

# stopped: at_look() sent a signal, which ended the program: it says so, and stops working. Each of
# its threads may look once or twice more on its way out.
stopped()
{
    code 75
    [ "$(tail -n 1 "$err")" = "$program: interrupted" ] && [ ! -s "$out" ]
    check "its last line says that $program was interrupted" $?
    holds "it looks $later times more" [ "$later" -le $((8 + 4 * $(nproc))) ]
}

# interrupted SIGNAL STAGE PROGRAM ARGUMENT...: a signal in the stage ends the program.
interrupted()
{
    signal=$1 stage=$2
    shift 2
    at_look 3 "$signal" "$stage" "$@"
    stopped
}

# wait_for FILE: until it is there, or the process that was started last has ended.
wait_for()
{
    while [ ! -e "$1" ] && kill -0 $! 2>/dev/null; do
        sleep 0.02
    done
}

# skip NAME WHY: a check that cannot be made on this machine or with this build.
skip()
{
    passed=$((passed + 1))
    echo "ok $((passed + failed)) - $1 # skip $2"
}

# lacks NAME WHY: skips a check that needs a package. It fails if CI is set: there, all are
# installed. Sanitizers keep some drivers and programs from working.
lacks()
{
    if [ -n "${CI-}" ] && ! sanitized; then
        command="a package is missing: $2" code=0
        : >"$out" >"$err"
        check "$1" 1
    else
        skip "$1" "$2"
    fi
}

# seed: prints SEED, which repeats a run. By default it is always the same; with LONG it is a new one.
seed()
{
    if [ -n "${LONG-}" ]; then echo "${SEED:-$(date +%s)}"; else echo "${SEED:-1}"; fi
}

# percentages SCRIPT: the numbers that sed finds in standard output rise from 0 to 100.
percentages()
{
    sed -n "$1" "$out" >"$work/percentages"
    [ "$(head -n 1 "$work/percentages" | cut -d. -f1)" = 0 ] &&
        [ "$(tail -n 1 "$work/percentages" | cut -d. -f1)" = 100 ] &&
        sort -n -u -c "$work/percentages"
}

# sanitized: true if the programs are built with a sanitizer, which makes them ten times slower.
# Tests then use smaller scans and leave out checks that need their detail.
sanitized()
{
    ldd "$BIN/bisque-voxelize" | grep -q 'lib[at]san'
}

# unsanitized NAME WHY: skips the rest of the test if the programs are built with a sanitizer.
unsanitized()
{
    sanitized || return 0
    skip "$1" "$2"
    finish
    exit
}

# has_opencl: true if there is a device opencl:0.
has_opencl()
{
    "$BIN/bisque-bake" --list devices 2>/dev/null | grep -q '^opencl:0 '
}

# find_python: sets $python to one with numpy and xxhash, or to nothing and is false. Another Python
# than Debian's may come first in PATH, without Debian's packages.
find_python()
{
    for python in python3 /usr/bin/python3 ''; do
        [ -z "$python" ] || ! "$python" -c 'import numpy, xxhash' 2>/dev/null || return 0
    done
    return 1
}

# need_oracle: skips the test if Python or its packages are missing, which oracle() needs.
need_oracle()
{
    ! find_python || return 0
    lacks "readers in Python" "python3-numpy or python3-xxhash is not installed"
    finish
    exit
}

# oracle PROGRAM ARGUMENT...: runs a program of tests/oracle, whose readers were written from
# FORMATS.md alone; sets what run() sets.
oracle()
{
    command=$* code=0 oracle=$1
    shift
    "$python" -B "$top/tests/oracle/$oracle.py" "$@" >"$out" 2>"$err" || code=$?
}

# in_parts N COMMAND...: runs a bake as N parts, and their merge.
in_parts()
{
    parts=$1 part=0
    shift
    while [ $part -lt $parts ]; do
        part=$((part + 1))
        ok "$@" --part $part/$parts
    done
    ok "$@" --merge $parts
}

# A box [0, 1] x [0, 2] x [0, 3] of quads with texture coordinates, one UV chart for each face.
write_box()
{
    cat <<'OBJ'
v 0 0 0
v 1 0 0
v 1 2 0
v 0 2 0
v 0 0 3
v 1 0 3
v 1 2 3
v 0 2 3
OBJ
    for chart in 0 1 2 3 4 5; do
        u=$((chart % 3)) v=$((chart / 3))
        for corner in '05 05' '28 05' '28 28' '05 28'; do
            set -- $corner
            awk "BEGIN { printf \"vt %.4f %.4f\\n\", $u / 3 + $1 / 100, $v / 3 + $2 / 100 }"
        done
    done
    cat <<'OBJ'
f 4/1 3/2 2/3 1/4
f 5/5 6/6 7/7 8/8
f 1/9 2/10 6/11 5/12
f 3/13 4/14 8/15 7/16
f 1/17 5/18 8/19 4/20
f 2/21 3/22 7/23 6/24
OBJ
}

# write_square X Y SIDE Z: a level square whose chart fills the map.
write_square()
{
    set -- "$1" "$2" $(($1 + $3)) $(($2 + $3)) "$4"
    printf 'v %s %s %s\n' "$1" "$2" "$5" "$3" "$2" "$5" "$3" "$4" "$5" "$1" "$4" "$5"
    printf 'vt %s\n' '0 0' '1 0' '1 1' '0 1'
    echo 'f 1/1 2/2 3/3 4/4'
}

finish()
{
    echo "$passed passed, $failed failed"
    [ "$failed" -eq 0 ]
}

#!/bin/sh
# test_reproducible.sh - builds of the same sources in two folders have the same bytes. With LONG=1
# all programs, modules and archives of config=release, else one archive of config=debug.
. "$(dirname "$0")/lib.sh"
config=debug built=lib/libbisque-base.a target=build/debug/lib/libbisque-base.a
if [ -n "${LONG-}" ]; then
    config=release built='bin lib' target=all
fi

# build FOLDER: copies the sources and builds them.
build()
{
    command="make $target in $1" code=0
    mkdir -p "$1"
    tar -C "$top" --exclude=./build --exclude=./.git -c . | tar -x -C "$1"
    # Not the values that the make above this test has for its own build.
    env -u MAKEFLAGS -u MAKEOVERRIDES make -C "$1" --no-print-directory -s -j"$(nproc)" \
        config=$config $target >"$out" 2>"$err" || code=$?
    check "builds in a folder" "$code"
}

build first
build "$work/another-folder-with-a-longer-name"
command=cmp code=0
for file in $(cd "first/build/$config" && find $built -type f | sort); do
    cmp "first/build/$config/$file" "$work/another-folder-with-a-longer-name/build/$config/$file" \
        >"$out" 2>&1
    check "$file has the same bytes" $?
done
finish

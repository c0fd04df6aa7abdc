#!/bin/sh
# skip.sh WHAT WHY - says that a step of the tests is skipped because packages are missing, and adds a
# line to the file SKIPS. Fails if CI is set: there, all packages are installed.
if [ -n "${CI-}" ]; then
    echo "$1: fails, $2" >&2
    exit 1
fi
echo "$1: skipped, $2"
[ -z "${SKIPS-}" ] || echo "$1: $2" >>"$SKIPS"

#!/bin/sh
# Checks that a static function's name stands for one function: grep finds it once. In `later` are
# the folders whose files may still have names in common with each other.
cd "$(dirname "$0")/../.." || exit 1
later='^(formats/mesh/|libvoxel/read/|libvoxel/simplify/|tools/python/)'
find base formats libvoxel libbake tools -name '*.[ch]' -o -name '*.cc' -o -name '*.cl' | sort |
    xargs awk -v later="$later" -f tests/lint/statics.awk && echo "statics: ok"

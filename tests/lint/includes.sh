#!/bin/sh
# Checks who includes whom: the flow of data is base <- formats <- libvoxel, libbake <- tools, the two libraries
# never meet, and tools see public headers only.
set -u
check() { # directory, regular expression of forbidden includes
    grep -rnE "^#[[:space:]]*include[[:space:]]+\"($2)" "$1" --include='*.[ch]' --include='*.cc' --include='*.cl' && bad=1
}
bad=0
check base 'formats/|libvoxel/|libbake/|tools/|tests/'
check formats 'libvoxel/|libbake/|tools/|tests/'
check libvoxel 'libbake/|tools/|tests/'
check libbake 'libvoxel/|tools/|tests/'
check tools 'tests/|.*_internal\.h'
for directory in base formats libvoxel libbake; do
    for other in base formats libvoxel libbake; do
        [ $directory = $other ] || check $directory "$other/[^\"]*_internal\.h"
    done
done
# File names are unique in the tree, so that a name alone says which file is meant.
twice=$(find base formats libvoxel libbake tools \( -name '*.[ch]' -o -name '*.cc' \) -printf '%f\n' | sort | uniq -d)
[ -z "$twice" ] || { echo "file names that occur twice: $twice"; bad=1; }
[ $bad -eq 0 ] && echo "includes: ok"
exit $bad

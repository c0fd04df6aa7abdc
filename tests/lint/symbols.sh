#!/bin/sh
# symbols.sh LIBDIR - checks that each symbol of the archives in LIBDIR that other programs can see
# has its library's prefix. Names that begin with two underscores belong to compilers. Checks also
# that libraries sort with bsq_sort(): qsort() allocates memory that no budget counts.
set -u
bad=0
[ $# -eq 1 ] || { echo "usage: symbols.sh LIBDIR"; exit 64; }
while read -r library prefixes; do
    archive=$1/libbisque-$library.a
    symbols=$(nm -g --defined-only "$archive" | awk 'NF == 3 { print $3 }')
    [ -n "$symbols" ] || { echo "symbols: $archive exports nothing"; bad=1; }
    strangers=$(echo "$symbols" | grep -vE "^($prefixes|__)" | sort -u)
    [ -z "$strangers" ] || { echo "symbols: $archive exports" $strangers; bad=1; }
    ! nm -u "$archive" | grep -qw qsort || { echo "symbols: $archive calls qsort()"; bad=1; }
done <<LIBRARIES
base bsq_
formats fmt_
voxel vox_
bake bake_|bk_
LIBRARIES
[ $bad -eq 0 ] && echo "symbols: ok"
exit $bad

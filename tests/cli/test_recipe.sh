#!/bin/sh
# test_recipe.sh - a mesh reader that was added as formats/mesh/README.md says: tests/recipes/off.c,
# in a program with the registry that is shown there.
. "$(dirname "$0")/lib.sh"
BIN=$TESTS/recipe

# to_off FILE.obj: the same mesh as OFF.
to_off()
{
    awk '$1 == "v" { v[nv++] = $2 " " $3 " " $4 }
        $1 == "f" { f[nf++] = NF - 1; for (i = 2; i <= NF; i++) f[nf - 1] = f[nf - 1] " " $i - 1 }
        END { print "OFF\n# a comment\n" nv, nf, 0
            for (i = 0; i < nv; i++) print v[i]
            print ""
            for (i = 0; i < nf; i++) print f[i] " 255 0 0" }' "$1"
}

"$TESTS/generate-scan" -n 20000 --corners 4 vase -o scan.obj >"$out" || exit 1
to_off scan.obj >scan.off
# Neither the name nor the suffix tells that this is OFF.
cp scan.off scan
for file in scan.off scan; do
    for threads in 1 3; do
        ok run bisque-voxelize --resolution 64 --threads $threads scan.obj -o obj.nvdb
        ok run bisque-voxelize --resolution 64 --threads $threads "$file" -o off.nvdb
        holds "$file, $threads threads: the grid of the OBJ file" cmp obj.nvdb off.nvdb
    done
done
ok run bisque-voxelize --info scan.off
sed 's/^4 [0-9]*/4 99999/' scan.off >index.off
run bisque-voxelize --resolution 64 index.off -o off.nvdb
code 65
line=$(($(grep -n '^$' index.off | cut -d: -f1) + 1))
err_like "index.off:$line: face refers to vertex 99999 .counted from 0., file has 10000"
sed '9s/^[^ ]*/x/' scan.off >number.off
run bisque-voxelize --resolution 64 number.off -o off.nvdb
code 65
err_like 'number.off:9: "x" is not a number'
head -n 1000 scan.off >short.off
run bisque-voxelize --resolution 64 short.off -o off.nvdb
code 65
err_like 'short.off:1001: truncated: the file ends after 997 of [0-9]* elements'

# The other formats are still there.
for suffix in stl ply; do
    "$TESTS/generate-scan" -n 2000 vase -o scan.$suffix >"$out" || exit 1
    ok run bisque-voxelize --resolution 64 scan.$suffix -o other.nvdb
done
grep -o '^ .*ROW(.*' "$top/formats/mesh/mesh_format.h" | grep -o 'fmt_[a-z]*_format' >rows
holds "rows of the registry" test -s rows
while read -r row; do
    holds "the README shows $row" grep -q "ROW($row)" "$top/formats/mesh/README.md"
done <rows
finish

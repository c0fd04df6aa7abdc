#!/bin/sh
# check_reports.sh - reports in a headless Chromium, see reports.py. Screenshots are left in
# DOORS, build/doors if it is not set.
. "$(dirname "$0")/../cli/lib.sh"
pictures=${DOORS:-$top/build/doors}
mkdir -p "$pictures"
for tiles in 1 2; do
    "$TESTS/generate-scan" --tiles $tiles vase-low -o low$tiles.obj
done
"$TESTS/generate-scan" --triangles 150000 --colors vase -o scan.obj
ok run bisque-voxelize scan.obj --resolution 512 -o scan.nvdb
bake="run bisque-bake scan.nvdb --size 512 --threads 2 --view count=2"
ok $bake low1.obj --maps normal,color,mask,height -o 'v_<MAP>.exr' --report asset.html
out_like '^asset.html: report$'
ok $bake low2.obj --maps normal,color -o 'w_<MAP>.<UDIM>.png' --report tiles.html
ok $bake low1.obj --front 0.004 --back 0.004 --maps normal,color -o 'x_<MAP>.exr' --report misses.html
ok run bisque-compare x_normal.exr v_normal.exr --report comparison.html
# Wrong names are refused, and a bake that fails leaves no page.
run bisque-bake scan.nvdb low1.obj -o y.exr --report page.txt
code 64
run bisque-bake scan.nvdb low1.obj --maps normal --report y.html -o y.html
code 64
holds "no page of a bake that failed" [ ! -e y.html ]
command="reports.py"
python3 "$top/tests/doors/reports.py" "$pictures" asset.html tiles.html misses.html comparison.html >"$out" 2>"$err"
code=$?
cat "$out"
passed=$((passed + $(grep -c '^ok' "$out"))) failed=$((failed + $(grep -c '^not ok' "$out")))
check "reports.py ends" $code
finish

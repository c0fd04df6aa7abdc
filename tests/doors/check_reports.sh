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
mkdir exact
ok run bisque-bake scan.tris low1.obj --size 512 --maps normal,mask -o 'exact/v_<MAP>.exr'
ok $bake low1.obj --maps normal,color,mask,height -o 'v_<MAP>.exr' --report asset.html --reference exact
out_like '^asset.html: report$'
out_like '^v_normal.exr against exact/v_normal.exr: mean 0\.[0-9]*, p99 [0-9.]*, max [0-9.]* \(degrees\)$'
ok $bake low1.obj --maps normal -o 'v_<MAP>.exr' --reference exact --json
json '.comparisons | length == 1'
mkdir merged
in_parts 2 $bake low1.obj --maps normal -o 'merged/v_<MAP>.exr' --reference exact --preview merged.png
out_like '^merged/v_normal.exr against .*exact/v_normal.exr: mean 0\.[0-9]*, p99 '
ok $bake low2.obj --maps normal,color -o 'w_<MAP>.<UDIM>.png' --report tiles.html
ok $bake low1.obj --front 0.004 --back 0.004 --maps normal,color -o 'x_<MAP>.exr' --report misses.html
ok run bisque-compare x_normal.exr v_normal.exr --report comparison.html
# Wrong names are refused, and a bake that fails leaves no page.
run bisque-bake scan.nvdb low1.obj -o y.exr --report page.txt
code 64
run bisque-bake scan.nvdb low1.obj --maps normal --report y.html -o y.html
code 64
run bisque-bake scan.nvdb low1.obj --maps normal -o 'exact/v_<MAP>.exr' --report page.html --reference exact
code 64
err_like 'exact/v_normal.exr: this output would overwrite a reference'
cp exact/v_normal.exr exact/s_normal.exr
run bisque-bake scan.nvdb low1.obj --size 64 --maps normal -o 's_<MAP>.exr' --report page.html --reference exact
code 65
err_like 's_normal.exr has 64 x 64 texels, exact/s_normal.exr has 512 x 512'
run bisque-bake scan.nvdb low1.obj --maps normal -o 'v_<MAP>.exr' --report page.html --reference none
code 66
holds "no page without its references" [ ! -e page.html ]
run bisque-compare v_normal.exr exact/v_normal.exr --mask-a v_mask.exr --mask-b exact/v_mask.exr --json
code 0
cp "$out" normal.json
holds "no page of a bake that failed" [ ! -e y.html ]
command="reports.py"
python3 "$top/tests/doors/reports.py" "$pictures" asset.html tiles.html misses.html comparison.html normal.json >"$out" 2>"$err"
code=$?
cat "$out"
passed=$((passed + $(grep -c '^ok' "$out"))) failed=$((failed + $(grep -c '^not ok' "$out")))
check "reports.py ends" $code
finish

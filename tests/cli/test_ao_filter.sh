#!/bin/sh
# test_ao_filter.sh - --rays filter=surface, on a vase and on two squares that lie side by side in the
# map and far apart in space: one in the open, one under a roof.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake"

"$TESTS/generate-scan" -n 20000 vase -o vase.obj >"$out"
"$TESTS/generate-scan" vase-low -o vase_low.obj >"$out"
ok run bisque-voxelize vase.obj -o vase.nvdb --resolution 128

# ---- the same bytes ----

maps="--maps normal,ao,curvature --size 384 --samples 1 --rays ao=1,filter=surface --type float"
ok $bake vase.nvdb vase_low.obj $maps -o 'one_<MAP>.exr' --threads 1
ok $bake vase.nvdb vase_low.obj $maps -o 'few_<MAP>.exr' --threads 3 --memory 22M
holds "a small budget gives the same ao" cmp one_ao.exr few_ao.exr
holds "a small budget gives the same curvature" cmp one_curvature.exr few_curvature.exr
in_parts 3 $bake vase.nvdb vase_low.obj $maps -o 'task_<MAP>.exr'
for map in normal ao curvature; do
    holds "parts give the same $map" cmp one_$map.exr task_$map.exr
done
ok $bake vase.nvdb vase_low.obj --maps normal,curvature --size 384 --samples 1 --type float \
    -o 'plain_<MAP>.exr'
holds "other maps stay" cmp one_normal.exr plain_normal.exr
holds "curvature stays" cmp one_curvature.exr plain_curvature.exr
holds "there is no map of the filter's own" test ! -e one_guide.exr
$bake vase.nvdb vase_low.obj --maps ao,guide --size 16 -o 'x_<MAP>.exr'
code 64

unsanitized "how the filter looks" "it takes very many rays"

# difference A B [LEFT]: prints the root mean square and the mean of A - B, both maps of 16 bits; or
# the largest sample's distance from white in the left part of A.
difference()
{
    python3 - "$top/tests/cli" "$@" <<'PY'
import sys
sys.path.insert(0, sys.argv[1])
import png
_, _, most, a = png.read(sys.argv[2])
_, _, _, b = png.read(sys.argv[3])
if len(sys.argv) > 4:
    print(max(most - t[0] for row in a for t in row[:int(sys.argv[4])]))
else:
    d = [(x[0] - y[0]) / most for r, s in zip(a, b) for x, y in zip(r, s)]
    print((sum(v * v for v in d) / len(d)) ** 0.5, sum(d) / len(d))
PY
}
# compare NAME CONDITION REFERENCE FEW FILTERED MANY: an awk condition of the root mean squares few,
# filtered and many against the reference, and of the means of their differences.
compare()
{
    holds "$1" awk -v r="$(difference "$4" "$3") $(difference "$5" "$3") $(difference "$6" "$3")" \
        'BEGIN { split(r, v); print "# " r; few = v[1]; filtered = v[3]; mean = v[4]; many = v[5]
            exit !('"$2"') }'
}

# ---- two squares ----

# grid X Z N: a square of N x N faces with the corner (X, 0, Z).
grid()
{
    awk -v x="$1" -v z="$2" -v n="$3" -v base="$4" 'BEGIN {
        for (j = 0; j <= n; j++) for (i = 0; i <= n; i++) print "v", x + i / n, j / n, z
        for (j = 0; j < n; j++) for (i = 0; i < n; i++) {
            a = base + (n + 1) * j + i; print "f", a, a + 1, a + n + 2, a + n + 1
        } }'
}
{ grid 0 0 4 1; grid 10 0 4 26; grid 10.25 0.5 4 51; } >scan.obj
cat >low.obj <<'OBJ'
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 10 0 0
v 11 0 0
v 11 1 0
v 10 1 0
vt 0 0
vt 0.5 0
vt 0.5 1
vt 0 1
vt 1 0
vt 1 1
f 1/1 2/2 3/3 4/4
f 5/2 6/5 7/6 8/3
OBJ
ok run bisque-voxelize scan.obj -o scan.nvdb --voxel-size 0.0625
maps="--maps ao --size 64x32 --samples 1 --type 16 --back 0.1 --front 0.1"
for rays in 16 64 1024; do
    ok $bake scan.tris low.obj $maps --rays ao=$rays -o n$rays.png
done
ok $bake scan.tris low.obj $maps --rays ao=16,filter=surface -o f16.png
compare "16 rays have less noise than 64" 'filtered < many && filtered < few / 3' \
    n1024.png n16.png f16.png n64.png
compare "16 rays get no lighter or darker" 'mean < 0.002 && mean > -0.002' \
    n1024.png n16.png f16.png n64.png
holds "nothing bleeds into a chart beside it" test "$(difference f16.png f16.png 32)" -eq 0

# ---- a vase ----

maps="--maps ao --size 128 --samples 1 --type 16 --padding 0"
for rays in 16 64 1024; do
    ok $bake vase.tris vase_low.obj $maps --rays ao=$rays -o n$rays.png
done
filtered="$maps --rays ao=16,filter=surface"
ok $bake vase.tris vase_low.obj $filtered -o f16.png
compare "relief stays" 'filtered < 0.75 * few && mean < 0.002 && mean > -0.002' \
    n1024.png n16.png f16.png n64.png

ok $bake vase.tris vase_low.obj $maps --rays ao=64,filter=surface -o f64.png
compare "the filter does not make relief of many rays worse" 'filtered <= 1.05 * many && mean < 0.002 && mean > -0.002' \
    n1024.png n16.png f64.png n64.png

# ---- a fin on a floor, two texels thick; two plates with a slot of a texel, one of them below a roof ----

# box X0,X1 Y0,Y1 Z0,Z1 VERTICES: a box after this many vertices.
box()
{
    awk -v x="$1" -v y="$2" -v z="$3" -v n="$4" 'BEGIN { split(x, X, ","); split(y, Y, ","); split(z, Z, ",")
        for (i = 0; i < 8; i++) print "v", X[i % 2 + 1], Y[int(i / 2) % 2 + 1], Z[int(i / 4) + 1]
        split("1 3 4 2 5 6 8 7 1 2 6 5 3 7 8 4 1 5 7 3 2 4 8 6", f, " ")
        for (i = 0; i < 6; i++) print "f", f[4 * i + 1] + n, f[4 * i + 2] + n, f[4 * i + 3] + n, f[4 * i + 4] + n }'
}
{ box -.5,1.5 -.5,1.5 -.1,0 0; box .485,.515 .1,.9 -.01,.4 8; } >fin.obj
{ box 0,.492 0,1 -.3,0 0; box .508,1 0,1 -.3,0 8; box -.2,.5 -.2,1.2 .1,.12 16; } >slot.obj
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n' >square.obj
maps="--maps ao --size 64 --samples 1 --type 16 --padding 0 --front 0.005 --back 0.005"
for scan in fin slot; do
    ok run bisque-voxelize $scan.obj -o $scan.tris
    ok $bake $scan.tris square.obj $maps --rays ao=4096 -o n4096.png
    for rays in 16 64 256; do
        ok $bake $scan.tris square.obj $maps --rays ao=$rays -o n$rays.png
        ok $bake $scan.tris square.obj $maps --rays ao=$rays,filter=surface -o f$rays.png
        compare "$scan: the filter is not worse than none, $rays rays" 'filtered <= 1.05 * many' \
            n4096.png n16.png f$rays.png n$rays.png
    done
done

finish

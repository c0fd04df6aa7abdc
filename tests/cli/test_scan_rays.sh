#!/bin/sh
# test_scan_rays.sh - secondary rays on several scans: ao, bent and thickness against formulas, in
# any order of scans, with any memory and threads, and for objects that see some scans.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake"

# patch NAME X0 Y0 Z0 UX UY UZ VX VY VZ: a parallelogram of 16 x 16 quads with a corner and two sides.
patch()
{
    awk -v corner="$2 $3 $4" -v first="$5 $6 $7" -v second="$8 $9 ${10}" 'BEGIN {
        split(corner, c); split(first, u); split(second, v)
        for (j = 0; j <= 16; j++) for (i = 0; i <= 16; i++) {
            printf "v"
            for (k = 1; k <= 3; k++) printf " %.9g", c[k] + u[k] * i / 16 + v[k] * j / 16
            print ""
        }
        for (j = 0; j < 16; j++) for (i = 0; i < 16; i++) {
            a = 1 + 17 * j + i; print "f", a, a + 1, a + 18, a + 17
        } }' >"$1.obj"
}
# square NAME X Y SIDE Z: a low-poly square whose normals point up.
square()
{
    awk -v x="$2" -v y="$3" -v s="$4" -v z="$5" 'BEGIN {
        for (i = 0; i < 4; i++) {
            a = i == 1 || i == 2; b = i > 1
            print "v", x + s * a, y + s * b, z; print "vt", a, b
        }
        print "f 1/1 2/2 3/3 4/4" }' >"$1.obj"
}
# scan NAME VOXEL [OBJ...]: makes NAME.nvdb and NAME.tris.
scan()
{
    name=$1 voxel=$2
    shift 2
    ok run bisque-voxelize "${@:-$name.obj}" -o "$name.nvdb" --voxel-size "$voxel"
}
# value MAP.exr EXPECTED TOLERANCE: all texels are near a value. The mask beside the map is 1.
value()
{
    run bisque-compare "$1" mask.exr --force --type data --json
    json "(.mean - (1 - $2 | fabs) | fabs) < $3 and .max < 0.05 + (1 - $2 | fabs)"
}

# ---- a wall of one scan hides half of the floor of another ----

patch floor 0 -4 0 4 0 0 0 8 0
patch wall 0 -4 0 0 8 0 0 0 4
patch far 40 0 0 1 0 0 0 1 0
square foot 0.0625 -0.0625 0.125 -0.0625
scan floor 0.0625
scan wall 0.05
scan far 0.05
scan both 0.0625 floor.obj wall.obj
usual="--size 8 --device cpu --front 0.5 --back 0.125 --padding 0"
ok $bake $usual --maps mask floor.tris foot.obj -o mask.exr
# Beside the middle of a wall of height 4 and width 8, at the distance d from 1/16 to 3/16: a
# rectangle at a right angle hides (atan(4 / d) - d / s atan(4 / s)) / pi, with s^2 = d^2 + 4^2
# (Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-4). Its mean over the
# square is 0.4822.
for scans in "floor.nvdb wall.nvdb" "wall.nvdb floor.tris" "floor.nvdb wall.tris"; do
    ok $bake $usual --maps ao,bent $scans foot.obj -o 'foot_<MAP>.exr'
    value foot_ao.exr 0.5178 0.01
    # The mean open direction leans away from the wall by atan(2 / pi) = 32.48 degrees.
    $bake $usual --maps bent both.tris foot.obj -o both.exr
    ok run bisque-compare both.exr foot_bent.exr --max-error 4 --max-mean 1
done
ok $bake $usual --maps ao floor.nvdb far.nvdb foot.obj -o far.exr
value far.exr 1 0.0001
# A scan that no ray reaches changes nothing.
$bake $usual --maps ao both.nvdb foot.obj -o one.exr
$bake $usual --maps ao far.nvdb both.nvdb foot.obj -o two.exr
ok run bisque-compare one.exr two.exr --max-error 0
# The wall hides less the farther away it is: 1 - t / 2.
$bake $usual --maps ao --distance ao=2 --ao falloff=linear wall.nvdb floor.tris foot.obj -o one.exr
$bake $usual --maps ao --distance ao=2 --ao falloff=linear both.tris foot.obj -o two.exr
ok run bisque-compare one.exr two.exr --type data --max-mean 0.01 --max-error 0.05
# Whole voxels of the wall hide more than its surface does, in one grid and in several: half a voxel
# of its height of 64 or more, and half of one towards the floor, are a share of 0.004 each. Farther
# away than anything in the scans, they hide nothing more.
for scans in "both.nvdb" "floor.nvdb wall.nvdb"; do
    for from in none 8 1000; do
        ok $bake $usual --maps ao --ao coarse=$from $scans foot.obj -o from_$from.exr
    done
    run bisque-compare from_none.exr from_8.exr --force --type data --json
    json '.mean > 0.004 and .mean < 0.02'
    ok run bisque-compare from_none.exr from_1000.exr --type data --max-error 0
done

# A roof half a voxel above the floor hides all of it, 0.88 of it with falloff, although rays that start a voxel above
# the floor would be past the roof.
patch roof 0 -1 0.03125 0 2 0 1 0 0
scan gap 0.0625 floor.obj roof.obj
gap="$usual --front 0.08 --as-is --maps ao --distance ao=0.5"
for falloff in none linear; do
    for scan in gap.tris gap.nvdb; do
        ok $bake $gap --ao falloff=$falloff $scan foot.obj -o $scan.exr
    done
    ok run bisque-compare gap.nvdb.exr gap.tris.exr --force --type data --max-mean 0.02
    run bisque-compare gap.tris.exr mask.exr --force --type data --json
    json '.mean > 0.85'
done

# ---- the other side of a slab is another scan ----

# A ray at the angle a to the normal goes h / cos a, but at most L: 2 h - h^2 / L in the mean.
patch below 0 -4 -0.5 0 8 0 4 0 0
square middle 1.9375 -0.0625 0.125 -0.0625
scan below 0.0625
for scans in "floor.nvdb below.nvdb" "below.nvdb floor.tris" "floor.nvdb below.tris"; do
    ok $bake $usual --maps thickness --distance thickness=1.5 $scans middle.obj -o slab.exr
    value slab.exr 0.8333 0.01
done
ok $bake $usual --maps thickness --distance thickness=1.5 floor.nvdb far.nvdb middle.obj -o slab.exr
value slab.exr 1.5 0.0001

# ---- a scan in two parts ----

patch left 0 -1 1 1 0 -1 0 2 0
patch right 1 -1 0 1 0 1 0 2 0
square groove 0.5 -0.5 1 0.25
scan left 0.03125
scan right 0.03125
scan groove_scan 0.03125 left.obj right.obj
maps="--maps ao,bent,thickness --distance thickness=1"
usual="--size 24 --device cpu --front 1 --back 1 --padding 0"
for parts in "left.nvdb right.nvdb" "left.nvdb right.tris"; do
    ok $bake $usual $maps groove_scan.nvdb groove.obj -o 'whole_<MAP>.exr'
    ok $bake $usual $maps $parts groove.obj -o 'parts_<MAP>.exr' --threads 1
    for map in ao thickness; do
        ok run bisque-compare whole_$map.exr parts_$map.exr --max-mean 0.005 --max-p95 0.02
    done
    ok run bisque-compare whole_bent.exr parts_bent.exr --max-mean 0.5 --max-p95 2
    # Any order, threads and memory.
    ok $bake $usual $maps ${parts#* } ${parts% *} groove.obj -o 'other_<MAP>.exr' --threads 3 \
        --memory 1900K --json
    [ "$parts" = "left.nvdb right.nvdb" ] || json '.chunk_loads > 1'
    for map in ao bent thickness; do
        same parts_$map.exr other_$map.exr
    done
done
$bake $usual $maps --device cuda left.nvdb right.nvdb groove.obj -o 'cuda_<MAP>.exr'
refused 64 "bisque-bake: several scans, of which some are grids, are traced on the cpu, not on cuda"

# ---- objects that see some scans ----

for kind in nvdb tris; do
    cp floor.$kind a_high.$kind
    cp wall.$kind a_high_wall.$kind
    cp floor.$kind b_high.$kind
done
awk '/^f/ { next } { print }' foot.obj >pair.obj
printf 'o a_low\nf 1/1 2/2 3/3 4/4\no b_low\nf 1/1 2/2 3/3 4/4\n' >>pair.obj
usual="--size 8 --device cpu --front 0.5 --back 0.125 --padding 0"
for kind in nvdb tris; do
    ok $bake $usual --maps ao --match name a_high.$kind b_high.$kind a_high_wall.$kind pair.obj \
        -o '<OBJECT>.exr'
    value a_low.exr 0.5178 0.01
    value b_low.exr 1 0.0001
done

# The wall stands within the radius of all texels. Curvature ignores it on objects that do not see it,
# also in a map that both objects share.
printf 'vt 0.5 0\nvt 0.5 1\nvt 1 0\nvt 1 1\n' >halves.txt
awk '/^f/ { next } { print } /^vt/ && ++n == 4 { while ((getline line < "halves.txt") > 0) print line }' \
    foot.obj >shared.obj
printf 'o a_low\nf 1/1 2/5 3/6 4/4\no b_low\nf 1/5 2/7 3/8 4/6\n' >>shared.obj
awk '/^o a_low/ { getline; next } { print }' shared.obj >b.obj
usual="--size 8 --device cpu --front 0.5 --back 0.125 --padding 0 --distance curvature=0.25"
for kind in nvdb tris; do
    ok $bake $usual --maps curvature --match name a_high.$kind b_high.$kind a_high_wall.$kind pair.obj \
        -o 'own_<OBJECT>.exr'
    ok $bake $usual --maps curvature --match name a_high.$kind b_high.$kind a_high_wall.$kind shared.obj \
        --samples 3 --threads 1 -o shared_one.exr
    ok $bake $usual --maps curvature --match name a_high_wall.$kind b_high.$kind a_high.$kind shared.obj \
        --samples 3 --threads 3 --memory 24M -o shared.exr
    same shared.exr shared_one.exr
    $bake $usual --maps curvature floor.$kind pair.obj -o alone.exr
    ok run bisque-compare --type data own_b_low.exr alone.exr --max-error 0.0001
    run bisque-compare --type data own_a_low.exr alone.exr --max-error 0.0001
    code 1
    $bake $usual --maps curvature,mask --samples 3 floor.$kind b.obj -o 'b_<MAP>.exr'
    ok run bisque-compare --type data shared.exr b_curvature.exr --mask b_mask.exr --max-error 0.0001
done

finish

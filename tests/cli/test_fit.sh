#!/bin/sh
# test_fit.sh - pairs of scan and low-poly mesh that fit each other and are baked without a word, and
# pairs that do not, of which the bake says what is wrong.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake --size 32 --samples 1 --device cpu" p=bisque-bake:

mesh()
{
    command="pairs.py $*"
    python3 "$top/tests/cli/pairs.py" "$@" || exit 1
}

# scan NAME SHAPE ROWS KEY=VALUE...: NAME.tris and NAME.nvdb.
scan()
{
    name=$1
    shift
    mesh "$name.obj" "$@"
    ok run bisque-voxelize "$name.obj" -o "$name.nvdb" --resolution 160
}

for shape in sphere ellipsoid head statue torus cube bust; do
    scan $shape $shape 100 detail=0.003
done
scan sheet sheet 100 detail=0.02
scan inside head 60 invert=1
scan left_high head 60 shift=-1.5,0,0
scan right_high statue 60 shift=1.5,0,0

# layers NAME SCALE: a scan of a sphere and of another one within it.
layers()
{
    mesh outer.obj sphere 60
    mesh inner.obj sphere 60 scale="$2"
    awk 'FNR == NR { n += /^v /; print; next }
        /^f/ { for (i = 2; i <= 4; i++) { split($i, c, "/"); k = c[1] + n; $i = k "/" k "/" k } }
        { print }' outer.obj inner.obj >"$1.obj"
    ok run bisque-voxelize "$1.obj" -o "$1.nvdb" --resolution 400
}
layers skins 0.975
layers coats 0.9

# ---- pairs that fit ----

# right SCAN SHAPE ROWS KEY=VALUE... [-- OPTION...]: a bake without a warning, exact and of a grid.
right()
{
    of=$1 keys=''
    shift
    while [ $# -gt 0 ] && [ "$1" != -- ]; do
        keys="$keys $1"
        shift
    done
    [ $# -eq 0 ] || shift
    # shellcheck disable=SC2086
    mesh low.obj $keys
    for kind in tris nvdb; do
        $bake $of.$kind low.obj -o right.png "$@"
        [ "$code" -eq 0 ] && [ ! -s "$err" ]
        check "$of.$kind fits$keys: no word" $?
    done
}

right sphere sphere 24
right sphere sphere 10
right sphere sphere 4
right ellipsoid ellipsoid 24
right ellipsoid ellipsoid 12
right head head 30
right head head 16
right head head 30 part=0.4
right statue statue 30
right statue statue 16
right statue statue 30 part=0.3
right statue statue 30 bare=1 -- --low normals=angle
right torus torus 24
right torus torus 12
right cube cube 32
right cube cube 16
right bust bust 24
right bust bust 12
right sheet sheet 20
right sheet sheet 8
right sheet sheet 20 part=0.5
right inside head 30 -- --two-sided
right skins sphere 8 # the outer one is baked
# Options that place the mesh again make a pair that fits.
right head head 30 turn=x,-z,y -- --low turn=y-up
right statue statue 30 turn=-y,x,z scale=1000 -- --low turn=y-xz,scale=0.001
right statue statue 30 scale=0.01 shift=0.5,0,-0.25 -- --low scale=100,x=-50,z=25
right statue statue 30 shift=10,20,30 -- --low x=-10,y=-20,z=-30
right torus torus 24 scale=25.4 -- --low scale=0.0393701
right head head 30 turn=x,-z,y shift=0,0,2 -- --low turn=y-up,y=-2
# Several scans, all or by name.
mesh left.obj head 30 shift=-1.5,0,0 name=left_low
mesh right.obj statue 30 shift=1.5,0,0 name=right_low
for match in '' '--match name'; do
    # shellcheck disable=SC2086
    $bake left_high.tris right_high.nvdb left.obj right.obj -o '<OBJECT>.png' $match
    [ "$code" -eq 0 ] && [ ! -s "$err" ]
    check "two scans fit two meshes: no word $match" $?
done

# ---- pairs that do not ----

# wrong STATUS TEXT SCAN SHAPE ROWS KEY=VALUE...: the exit status, and a line that matches.
wrong()
{
    status=$1 text=$2 of=$3
    shift 3
    mesh low.obj "$@"
    for kind in tris nvdb; do
        $bake $of.$kind low.obj -o wrong.png
        [ "$code" -eq "$status" ] && grep -Eq -- "$text" "$err"
        check "$of.$kind does not fit $*: $text" $?
        if [ "$status" -eq 65 ]; then
            $bake $of.$kind low.obj -o wrong.png --as-is
            ! grep -q 'does not fit\|opposite' "$err"
            check "and goes on as it is" $?
        fi
    done
}

fits='does not fit .* with --low' about='does not fit .* with about --low'
wrong 65 "$fits turn=y-up;" head head 30 turn=x,-z,y
wrong 65 "$fits turn=z-up;" head head 30 turn=x,z,-y
wrong 65 "$fits turn=zxy;" head head 30 turn=y,z,x
wrong 65 "$fits turn=y-up;" statue statue 30 turn=x,-z,y
wrong 65 "$fits turn=y-xz;" statue statue 30 turn=-y,x,z
wrong 65 "$fits turn=y-up;" bust bust 24 turn=x,-z,y
wrong 65 "$fits turn=[yz]-up;" ellipsoid ellipsoid 24 turn=x,-z,y
wrong 65 "$fits turn=" torus torus 24 turn=x,-z,y
wrong 65 "$fits turn=" sheet sheet 20 turn=x,-z,y
wrong 65 "$fits scale=0.001;" statue statue 30 scale=1000
wrong 65 "$fits scale=1000;" statue statue 30 scale=0.001
wrong 65 "$fits scale=25.4;" head head 30 scale=0.0393701
wrong 65 "$fits scale=0.3048;" torus torus 24 scale=3.28084
wrong 65 "$fits scale=10;" sphere sphere 24 scale=0.1
wrong 65 "$fits turn=y-up,scale=100;" statue statue 30 scale=0.01 turn=x,-z,y
wrong 65 "$fits turn=y-up,scale=0.01;" sheet sheet 20 scale=100 turn=x,-z,y
wrong 0 "$about scale=0.7[67]" statue statue 30 scale=1.3
wrong 0 "$about scale=1.2[45]" head head 30 scale=0.8
wrong 0 "$about x=-0.[45]" statue statue 30 shift=0.5,0,0
wrong 0 "$about y=-0.[23]" head head 30 shift=0,0.25,0
wrong 0 "$about z=0.[23]" torus torus 24 shift=0,0,-0.25
wrong 65 "$fits turn=y-up,[xyz,=.0-9-]*;" statue statue 30 turn=x,-z,y shift=3,0,0
wrong 65 'is mirrored' statue statue 30 mirror=1
wrong 65 'is mirrored' head head 30 mirror=1
wrong 65 'is mirrored' bust bust 24 mirror=1
wrong 65 'opposite directions: .* --two-sided' statue statue 30 invert=1
wrong 65 'opposite directions: .* --two-sided' sphere sphere 24 invert=1
wrong 65 'opposite directions: .* --two-sided' inside head 30
far='farther from .* is it the mesh of this scan'
wrong 0 "$far" statue head 30
wrong 65 "$far" torus statue 30
wrong 0 "$far" ellipsoid torus 24
wrong 0 "has another layer within" coats sphere 24 scale=0.945

# ---- parts that the mesh lacks ----

# The middle of the other half of a sphere is the root of 2 from the border.
mesh half.obj sphere 24 part=0.5
ok run bisque-compare half.obj sphere.tris --json
json '.from_scan | (.max - (2 | sqrt) | fabs) < 0.02 and .where[2] > 0.98'

# ---- thickness of open scans ----

# open SCAN LOW TEXT [OPTION...]: a bake of thickness warns of rays that leave the scan; TEXT empty:
# it does not.
open()
{
    of=$1 low=$2 text=$3
    shift 3
    for kind in tris nvdb; do
        ok $bake $of.$kind $low -o o.png --maps thickness --rays thickness=1 "$@"
        if [ -z "$text" ]; then
            [ ! -s "$err" ]
        else
            grep -q "thickness: $text % of the rays straight into $of.$kind leave" "$err"
        fi
        check "$of.$kind is open: '$text' $*" $?
    done
}

# Straight rays into a sphere meet the opposite longitude: of three quarters, two thirds are there.
mesh low.obj sphere 24
mesh wide.obj sphere 24 part=0.75
mesh half.obj sphere 24 part=0.5
scan wedge sphere 60 part=0.75
scan bowl sphere 60 part=0.5
scan wound sphere 60 part=0.75 invert=1
open sphere low.obj ''
open wedge wide.obj '3[234]'
open wedge wide.obj '3[234]' --front 0.01 --back 0.01
open wedge wide.obj '3[234]' --extrude 0.01 --as-is
open wedge wide.obj '' --distance thickness=0.2
open bowl half.obj 100
open wound wide.obj '3[234]' --two-sided
ok $bake wedge.nvdb wide.obj -o o.png --maps normal
[ ! -s "$err" ]
check "other maps of an open scan: no word" $?
for shape in head statue torus cube; do
    mesh low.obj $shape 16
    open $shape low.obj ''
done
mesh low.obj sheet 8
open sheet low.obj 100
in_parts 2 $bake sheet.tris low.obj -o o.png --maps thickness --rays thickness=1
grep -q 'thickness: 100 % of the rays' "$err"
check "a merge tells of an open scan" $?

# ---- voxels and texels ----

# The square of side 2 has texels of 2 / 128.
mesh low.obj flat 4
ok run bisque-voxelize low.obj -o flat.nvdb --voxel-size 0.03125
ok run bisque-bake flat.nvdb low.obj -o o.png --size 128 --device cpu
grep -qx 'a voxel is 2 texels; one of half a texel would match: --voxel-size 0.00781' "$out"
check "the report names the voxel size that matches" $?
ok run bisque-voxelize low.obj -o flat.nvdb --voxel-size 0.0078125
ok run bisque-bake flat.nvdb low.obj -o o.png --size 128 --device cpu
grep -qx 'a voxel is 0.5 texels' "$out"
check "and none if it matches" $?
ok run bisque-bake flat.tris low.obj -o o.png --size 128 --device cpu --json
json '.texel == 0.015625 and .voxel == 0'

# ---- confidence ----

# Flat scans above the low-poly mesh: the formula of docs/maps.md. All samples hit.
mesh low.obj flat 4
mesh above.obj flat 40 shift=0,-0.1,0 # its normals are -y
mesh near.obj flat 40 shift=0,-0.05,0
mesh mesh.obj flat 40 # a layer beneath, where the low-poly mesh is
awk 'FNR == NR { n += /^v /; print; next }
    /^f/ { for (i = 2; i <= 4; i++) { split($i, c, "/"); k = c[1] + n; $i = k "/" k "/" k } }
    { print }' above.obj mesh.obj >both.obj

# sure SCAN VALUE OPTION...: the mean of the map, exact and of a grid.
sure()
{
    scan=$1 value=$2
    shift 2
    ok run bisque-voxelize "$scan.obj" -o "$scan.nvdb" --voxel-size 0.01
    for kind in tris nvdb; do
        ok $bake "$scan.$kind" low.obj --maps confidence,mask -o '<MAP>.exr' --as-is --back 0.2 "$@"
        ok run bisque-compare mask.exr confidence.exr --force --type data --json
        json "(.mean - 1 + $value | fabs) < 0.01 and (.max - 1 + $value | fabs) < 0.01"
    done
}
sure above 0.5 --front 0.2
sure near 0.75 --front 0.2
sure both 0.25 --extrude 0.2

# ---- what the options do ----

mesh low.obj statue 30
$bake statue.tris low.obj -o wrong.png --low scale=0.01
code 65
holds 'the mesh fits with no --low' grep -q '% with no --low; to bake it all the same: --as-is$' "$err"

# A mesh that was turned, scaled and shifted and is placed again gives the same map.
mesh low.obj statue 30
ok $bake statue.tris low.obj -o plain.exr
mesh low.obj statue 30 turn=x,-z,y scale=1024
ok $bake statue.tris low.obj -o placed.exr --low turn=y-up,scale=0.0009765625
run bisque-compare plain.exr placed.exr --max-mean 0.01
code 0

finish

#!/bin/sh
# test_numbers.sh - coordinates of any size and extreme shapes give the right result or one clear
# line.
. "$(dirname "$0")/lib.sh"
need_oracle

p=bisque-voxelize:

# voxelize NAME ARGUMENT...: voxelizes NAME.obj and verifies both files.
voxelize()
{
    name=$1
    shift
    ok run bisque-voxelize "$name.obj" -o "$name.nvdb" --json "$@"
    cp "$err" "$work/warnings"
    ok run bisque-voxelize --verify "$name.tris" "$name.nvdb" --json
}

# moved SCALE X Y FILE: prints an OBJ file with vertices scaled, then moved.
moved()
{
    awk -v s="$1" -v x="$2" -v y="$3" '$1 == "v" { printf "v %.17g %.17g %.17g\n", s * $2 + x, s * $3 + y, s * $4; next }
        { print }' "$4"
}

# maps NAME: bakes normals of NAME.nvdb, and exact ones of NAME.tris, for NAME_low.obj; keeps the
# lengths of the rays.
maps()
{
    for kind in nvdb tris; do
        ok run bisque-bake "$1.$kind" "$1_low.obj" --size 64 --maps normal,mask --normal space=object --device cpu --type float \
            -o "$1_${kind}_<MAP>.exr" --json
        jq -r '"\(.front) \(.back)"' "$out" >"$1_$kind.rays"
    done
}

# alike A B LIMIT...: maps of both kinds are similar, and so are their hits.
alike()
{
    a=$1 b=$2
    shift 2
    for kind in nvdb tris; do
        ok run bisque-compare "${a}_${kind}_normal.exr" "${b}_${kind}_normal.exr" --mask-a "${a}_${kind}_mask.exr" \
            --mask-b "${b}_${kind}_mask.exr" "$@"
    done
}

# ---- the unit of the scan does not matter: scaling by 2^100 and 2^-100 does not round ----

"$TESTS/generate-scan" --triangles 5000 vase -o plain.obj
"$TESTS/generate-scan" vase-low -o plain_low.obj
voxelize plain --resolution 100
maps plain
for scale in 1267650600228229401496703205376 7.8886090522101180541172856528279e-31; do
    moved $scale 0 0 plain.obj >scaled.obj
    moved $scale 0 0 plain_low.obj >scaled_low.obj
    voxelize scaled --resolution 100
    maps scaled
    alike plain scaled --max-error 0 --min-agreement 1
done

# ---- a geo-referenced scan keeps its detail ----

moved 1 500000 5000000 plain.obj >geo.obj
moved 1 500000 5000000 plain_low.obj >geo_low.obj
voxelize geo --resolution 100
holds "a geo-referenced scan is no cause for a warning" [ ! -s "$work/warnings" ]
maps geo
alike plain geo --max-p95 0.05 --min-agreement 0.99
for kind in nvdb tris; do
    paste -d ' ' plain_$kind.rays geo_$kind.rays |
        awk '{ exit !($1 > 0 && $2 > 0 && ($1 / $3 - 1)^2 < 1e-4 && ($2 / $4 - 1)^2 < 1e-4) }'
    check "rays are as long as at the origin ($kind)" $?
done
# A detail of a thousandth, far away: two triangles that differ by it are both kept.
printf 'v 500000.123 5000000.456 0\nv 500000.124 5000000.456 0\nv 500000.123 5000000.457 0
v 500001.123 5000001.456 0\nf 1 2 3\nf 1 2 4\n' >fine.obj
voxelize fine --resolution 16
json '.files[0].triangles == 2 and .files[0].vertices == 4'

# ---- a warning names the detail that 32-bit positions lose: 2^-14 units near 1000 ----

awk 'BEGIN { print "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"; n = 4
    for (i = 0; i < 20; i++) for (j = 0; j < 20; j++) { x = 999 + i * 1e-6; y = 999 + j * 1e-6
        printf "v %.6f %.6f 0\nv %.6f %.6f 0\nv %.6f %.6f 0\nf %d %d %d\n", x, y, x + 1e-6, y, x, y + 1e-6, n, n + 1, n + 2
        n += 3 } }' >km.obj
ok run bisque-voxelize km.obj -o km.nvdb --resolution 64
grep -Eq "^$p warning: km\.obj: [0-9]+ vertices fell together with the one before: positions are kept to 6\.1e-05 of the scan's units" "$err"
check "merged vertices are named, with the precision" $?
printf 'v 1000 0 0\nv 1000.001 0 0\nv 1000 .001 0\nf 1 2 3\nv 0 0 0\nv .001 0 0\nv 0 .001 0\nf 4 5 6\n' >tiny.obj
ok run bisque-voxelize tiny.obj -o tiny.nvdb --voxel-size .0005
grep -qx "$p warning: tiny\.tris: positions are kept to 6\.1e-05 of the scan's units, which is coarse for voxels of 0\.0005" "$err"
check "voxels that are too fine for the scan's precision are named" $?

# ---- malformed numbers, and numbers that are too large ----

# refuses "COORDINATE" LINE: an OBJ file with this coordinate is refused with this line.
refuses()
{
    printf 'v 0 0 0\nv 1 0 0\nv 0 %s 0\nf 1 2 3\n' "$1" >bad.obj
    run bisque-voxelize bad.obj -o bad.nvdb
    sed -i '/ warning: .*: vertices without a finite position: 1; this is the first$/d' "$err"
    refused 65 "$p bad.obj$2"
    [ ! -e bad.nvdb ] && [ ! -e bad.tris ]
    check "nothing was written" $?
    { sed 's|^f .*|f 1/1 2/1 3/1|' bad.obj; echo 'vt 0 0'; } >bad_low.obj
    case $2 in
    :[0-9]*) run bisque-bake plain.nvdb bad_low.obj -o map.exr
        sed -i '/ warning: .*: vertices without a finite position: 1; this is the first$/d' "$err"
        refused 65 "bisque-bake: bad_low.obj$2" ;;
    esac
}
for number in nan -inf 1e999 '-nan(ind)' 1.#QNAN; do
    refuses "$number" ":4: 1 of 1 faces have a vertex without a finite position, more than 1 %; this is the first"
done
refuses 1,0 ':3: "1,0" is not a number'
refuses 1e39 ': vertex 3 of the scan: coordinate 1e+39 is too large'
refuses 1e-60 ": the scan's only triangle has no area"
run bisque-voxelize plain.tris -o bad.nvdb --voxel-size 1e38
refused 64 "$p plain.tris: voxels of 1e+38 are beyond the 32-bit numbers of a NanoVDB grid, 1.17549e-38 to 8.50706e+37"
run bisque-voxelize plain.tris -o bad.nvdb --voxel-size 1e-40
refused_like 64 'plain\.tris: with a voxel size of 1e-40 the scan reaches from index .* beyond the limit of '
printf 'v 0 0 0\nv 1e-42 0 0\nv 0 1e-42 0\nf 1 2 3\n' >denormal.obj
run bisque-voxelize denormal.obj -o denormal.nvdb --resolution 64
refused_like 65 'denormal\.tris: voxels of 1\.5.*e-44 are beyond the 32-bit numbers'

# ---- a stray triangle far away leaves the scan few voxels ----

{ cat plain.obj; printf 'v 5000 0 0\nv 5001 0 0\nv 5000 1 0\nf -3 -2 -1\n'; } >stray.obj
ok run bisque-voxelize stray.obj -o stray.nvdb --resolution 1000 --json
json '.grid.voxels < 1000'
grep -Eq "^$p warning: stray\.nvdb: only [0-9]+ voxels in a grid of 1000 along the longest side: " "$err"
check "a hint at what lies far away" $?

# ---- triangles without area ----

for points in '1 2 3|1 2 3|1 2 3' '0 0 0|1 1 1|2 2 2' '5 5 5|5 5 5|7 7 7'; do
    { echo "$points" | tr '|' '\n' | sed 's/^/v /'; echo 'f 1 2 3'; } >flat.obj
    run bisque-voxelize flat.obj -o flat.nvdb
    refused 65 "$p flat.obj: the scan's only triangle has no area"
done
# A right triangle over 8 x 8 voxels touches those with i + j < 8, and those at whose corner the
# longest side passes, except at its ends.
right=$((36 + 7))
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 2\nf 1 2 2\nf 3 3 3\n' >some.obj
voxelize some --resolution 8
json ".files[1].voxels == $right and .files[0].triangles == 1"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >one.obj
for resolution in 1 8; do
    voxelize one --resolution $resolution
    json ".files[1].voxels == $([ $resolution = 1 ] && echo 1 || echo $right)"
done

# ---- many triangles in few voxels, few triangles in many voxels ----

# A million triangles in one plane inside one voxel give the record of one flat triangle.
{
    printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv .5 .5 0\nv .51 .5 0\nv .5 .51 0\nf 1 2 3\n'
    yes 'f 4 5 6' | head -n 1000000
} >crowd.obj
voxelize crowd --resolution 8 --memory 100M
json ".files[0].triangles == 1000001 and .files[1].voxels == $right"
oracle measure crowd.nvdb
sed -n 's/^sum_normal //p' "$out" | awk -v n=$right '{ exit !($1^2 < 1e-6 && $2^2 < 1e-6 && ($3 - n)^2 < 1e-6) }'
check "all normals are +z" $?
# Two triangles over all 512 x 512 voxels.
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n' >sheet.obj
voxelize sheet --resolution 512
json '.files[1].voxels == 512 * 512'
# A sliver along the diagonal of 16384^3, 16 voxels wide in one axis: each step along it touches at
# least one voxel and at most about 10.
printf 'v 0 0 0\nv 1 1 1\nv 1 1 .999\nf 1 2 3\n' >diagonal.obj
voxelize diagonal --resolution 16384
json '.files[1].voxels >= 16384 and .files[1].voxels < 10 * 16384'
finish

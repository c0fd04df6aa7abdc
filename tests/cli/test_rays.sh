#!/bin/sh
# test_rays.sh - cages, directions of rays, skew maps and the limit of misses, on two parallel sheets.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake"
p=bisque-bake

# sheet Z R G: a square at height Z in one colour, larger than the low-poly mesh.
sheet()
{
    awk -v z="$1" -v r="$2" -v g="$3" 'BEGIN {
        for (j = 0; j <= 8; j++) for (i = 0; i <= 8; i++)
            print "v", -0.5 + i / 4, -0.5 + j / 4, z, r, g, 0
        for (j = 0; j < 8; j++) for (i = 0; i < 8; i++) {
            a = 1 + 9 * j + i; print "f", a, a + 1, a + 10, a + 9
        } }'
}
sheet 0.125 1 0 >red.obj
sheet 0.375 0 1 >green.obj
# square NAME Z: a square of the same faces as the low-poly mesh, at height Z.
square()
{
    printf 'v 0 0 %s\nv 1 0 %s\nv 1 1 %s\nv 0 1 %s\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n' \
        "$2" "$2" "$2" "$2" >"$1"
}
square low.obj 0
square high_cage.obj 0.5
square low_cage.obj 0.25
square above.obj 0.4375
square above_cage.obj 0.5
awk '/^f/ { print "f 2 3 4 1"; next } { print }' high_cage.obj >turned.obj
for scan in red green; do
    ok run bisque-voxelize $scan.obj -o $scan.nvdb --voxel-size 0.03125
done
ok run bisque-voxelize red.obj green.obj -o both.nvdb --voxel-size 0.03125

# same_color A B: the colour maps show one sheet.
same_color()
{
    ok run bisque-compare "$1" "$2" --max-error 0.01
}

# ---- cages ----

small="--device cpu --size 32 --samples 1 --maps color --back 0.0625"
for kind in nvdb tris; do
    for scan in red green; do
        ok $bake $small --front 0.625 $scan.$kind low.obj -o $scan.exr
    done
    # Without a cage the nearer sheet wins, from a cage the outer one.
    ok $bake $small --front 0.625 both.$kind low.obj -o near.exr
    same_color near.exr red.exr
    ok $bake $small both.$kind low.obj --cage high_cage.obj -o cage.exr --json
    json '.misses == 0 and .front == 0.5'
    same_color cage.exr green.exr
    # The cage ends the rays in front.
    ok $bake $small both.$kind low.obj --cage low_cage.obj -o cage.exr
    same_color cage.exr red.exr
    # Behind the low-poly mesh they end at --back.
    ok $bake $small both.$kind above.obj --cage above_cage.obj -o cage.exr --back 0.09375
    same_color cage.exr green.exr
    $bake $small both.$kind above.obj --cage above_cage.obj -o cage.exr --back 0.03125
    refused_like 65 "^$p: no ray hit "
done
$bake $small both.nvdb low.obj --cage turned.obj -o cage.exr
refused_like 65 "^$p: turned\.obj:9: face has other vertices than the same face of the low-poly mesh\$"
# A cage that touches the low-poly mesh: rays still have a direction, and go back from there.
ok $bake $small both.nvdb above.obj --cage above.obj -o cage.exr --back 0.09375
same_color cage.exr green.exr
cp high_cage.obj cage.exr
$bake $small both.nvdb low.obj --cage cage.exr -o cage.exr
code 64
rm cage.exr
$bake $small both.nvdb low.obj --cage missing.obj -o cage.exr
code 66
$bake $small both.nvdb low.obj --cage high_cage.obj --front 1 -o cage.exr
code 64
$bake $small both.nvdb low.obj --cage high_cage.obj --ray-directions mesh -o cage.exr
code 64
if has_opencl; then
    ok $bake $small both.nvdb low.obj --cage high_cage.obj --device opencl:0 -o cage.exr
    same_color cage.exr green.exr
else
    lacks "a cage on OpenCL" "there is no OpenCL device"
fi

# ---- layers ----

# wrong SCENE LEAST MOST SCAN... [OPTION...]: the share of texels that show another part than that
# which the low-poly mesh has there, in percent.
wrong()
{
    scene=$1 least=$2 most=$3
    shift 3
    ok $bake "$@" ${scene}_low.obj $ids -o shown.png
    share=$(python3 "$top/tests/cli/layers.py" wrong shown.png $scene.png)
    holds "$share % of $scene are wrong, not $least to $most" \
        awk -v s="$share" -v l="$least" -v m="$most" 'BEGIN { exit !(s >= l && s <= m) }'
}
ids="--device cpu --size 128 --samples 1 --padding 0 --maps id"
for scene in spheres figure fingers; do
    holds "the scene is written" python3 "$top/tests/cli/layers.py" write $scene
    ok run bisque-voxelize ${scene}_low.obj -o own.tris --channels id --id object
    ok $bake own.tris ${scene}_low.obj $ids -o $scene.png --front 1e-4 --back 1e-4
    ok run bisque-voxelize $scene.obj -o $scene.nvdb --channels id --id object --resolution 512
    wrong $scene 0 0 $scene.tris
    wrong $scene 0 0 $scene.nvdb
done
# Each sphere is a scan of its own; their order does not matter.
for part in inner outer; do
    awk -v part=$part '/^o / { keep = $2 == part } /^v/ || keep' spheres.obj >$part.obj
    ok run bisque-voxelize $part.obj -o $part.nvdb --channels id --id object --resolution 512
done
wrong spheres 0 0 inner.tris outer.nvdb
wrong spheres 0 0 outer.tris inner.nvdb
# From an extruded mesh the outer sphere is hit too, but fingers hide each other.
wrong spheres 0 0 spheres.nvdb --extrude 0.1
wrong fingers 5 100 fingers.tris --extrude 0.05
ok $bake $small both.nvdb low.obj --extrude 0.5 -o extruded.exr --json
json '.misses == 0 and .front == 0.5'
same_color extruded.exr green.exr
ok $bake $small both.nvdb low.obj --extrude 0.25 -o extruded.exr
same_color extruded.exr red.exr
$bake $small both.nvdb low.obj --extrude 0.5 --cage high_cage.obj -o extruded.exr
refused 64 "$p: high_cage.obj: rays start at a cage or at an extruded mesh, not both"
$bake $small both.nvdb low.obj --extrude 0.5 --front 1 -o extruded.exr
code 64
# A tower stands out by more than a tenth of the diagonal.
awk '/^v / { if ($2 == 0.25 && $3 == 0.25) $4 += 0.6 } { print }' red.obj >tower.obj
ok run bisque-voxelize tower.obj -o tower.tris
ok $bake --size 64 --maps mask tower.tris low.obj -o tower.exr --json
json '.misses == 0 and .front > 0.7 and .front < 1.2'
holds "a warning tells of long rays" grep -q '% of the low-poly mesh lies more than a tenth of' "$err"

# ---- directions ----

write_box >box.obj
# The same box with a normal for each face, so that its edges are hard.
{
    printf 'vn %s\n' '0 0 -1' '0 0 1' '0 -1 0' '0 1 0' '-1 0 0' '1 0 0'
    awk '/^f/ { n++; for (i = 2; i <= NF; i++) $i = $i "/" n } { print }' box.obj
} >hard.obj
ok run bisque-voxelize box.obj -o box.nvdb --resolution 64 --no-tris
for rays in smooth mesh face; do
    ok $bake --device cpu --size 64 --samples 1 --maps normal box.nvdb hard.obj -o $rays.exr --ray-directions $rays
done
# Along hard normals and along faces rays are the same; smooth ones differ.
ok run bisque-compare mesh.exr face.exr --max-error 0
! cmp -s smooth.exr mesh.exr
check "smooth directions differ from hard normals" $?
ok $bake --device cpu --size 64 --samples 1 --maps normal box.nvdb hard.obj -o default.exr
same default.exr smooth.exr
$bake box.nvdb hard.obj -o a.exr --ray-directions up
refused 64 "$p: --ray-directions: \"up\" is not smooth, mesh or face"

# ---- skew maps ----

# grey NAME VALUE: an image of one grey, 0 to 255.
grey()
{
    printf 'P2 2 2 255\n%s %s %s %s\n' "$2" "$2" "$2" "$2" >"$1"
}
grey black.pgm 0
grey grey.pgm 100
grey white.pgm 255
turned="$bake --size 64 --samples 1 --maps normal box.nvdb hard.obj"
for value in black grey white; do
    ok $turned --device cpu --skew $value.pgm -o skew_$value.exr
done
# Black leaves rays smooth; white leads them along the faces' normals.
same skew_black.exr smooth.exr
ok run bisque-compare skew_white.exr face.exr --max-error 0.01
! cmp -s skew_grey.exr smooth.exr && ! cmp -s skew_grey.exr skew_white.exr
check "grey is neither" $?
if has_opencl; then
    ok $turned --device opencl:0 --skew grey.pgm -o opencl.exr
    ok run bisque-compare opencl.exr skew_grey.exr --max-error 0.1
else
    lacks "a skew map on OpenCL" "there is no OpenCL device"
fi
# Secondary rays make a patch of the raster so dear that it is traced in bands of rows. Maps without
# them, of the same tile in one band, have the same bytes.
bands="$bake --size 256 --samples 2 --device cpu --front 0.5 --skew grey.pgm box.nvdb hard.obj"
ok $bands --maps height,normal -o 'whole_<MAP>.exr'
ok $bands --maps height,normal,ao,thickness -o 'bands_<MAP>.exr'
for map in height normal; do
    same whole_$map.exr bands_$map.exr
done
# Two tiles have images of their own: white in 1001, black in 1002, or one of them is missing.
{
    cat low.obj
    printf 'v %s\n' '2 0 0' '3 0 0' '3 1 0' '2 1 0'
    printf 'vt %s\n' '1 0' '2 0' '2 1' '1 1'
    echo 'f 5/5 6/6 7/7 8/8'
} >tiles.obj
cp white.pgm skew.1001.pgm
$bake --size 16 --maps mask red.nvdb tiles.obj --skew 'skew.<UDIM>.pgm' -o 'tile.<UDIM>.exr'
refused_like 66 '^bisque-bake: skew\.1002\.pgm: '
cp black.pgm skew.1002.pgm
ok $bake --size 16 --maps mask red.nvdb tiles.obj --skew 'skew.<UDIM>.pgm' -o 'tile.<UDIM>.exr'
# It is an input: outputs do not overwrite it.
cp white.pgm skew.exr
$turned --skew skew.exr -o skew.exr
code 64
$turned --skew white.pgm --ray-directions face -o none.exr
refused 64 "$p: white.pgm: a skew map changes nothing if rays run along the faces' normals"

# ---- misses ----

# Half of the low-poly mesh lies beside the scan.
awk '/^v / { $2 += 1 } { print }' low.obj >aside.obj
ok $bake --size 32 --maps mask red.nvdb aside.obj -o missed.exr
holds "the message tells how far lengths were measured" \
    grep -q 'behind, measured within a tenth of the scan.s diagonal: try' "$err"
rm missed.exr
for limit in 40 60; do
    $bake $small red.nvdb aside.obj --front 0.25 --max-missed $limit -o missed.exr
    code $((limit < 50))
    holds "the map is written whatever the limit says" [ -s missed.exr ]
    rm -f missed.exr
    [ $limit = 60 ] || grep -q "^$p: 4[0-9.]* % of the samples found no surface, more than --max-missed 40\$" "$err"
    check "the message names the limit" $?
done

finish

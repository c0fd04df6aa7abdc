#!/bin/sh
# test_scans.sh - maps of several scans: sheets beside each other and above each other.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake"
p=bisque-bake

# sheet NAME X Z R G: a square sheet of side 1 in one colour, whose left side is at X, at height Z.
sheet()
{
    awk -v x="$2" -v z="$3" -v r="$4" -v g="$5" 'BEGIN {
        for (j = 0; j <= 4; j++) for (i = 0; i <= 4; i++)
            print "v", x + i / 4, j / 4, z, r, g, 0
        for (j = 0; j < 4; j++) for (i = 0; i < 4; i++) {
            a = 1 + 5 * j + i; print "f", a, a + 1, a + 6, a + 5
        } }' >"$1.obj"
}
# square NAME X WIDTH Z: a low-poly rectangle whose normals point up.
square()
{
    awk -v x="$2" -v w="$3" -v z="$4" 'BEGIN {
        for (i = 0; i < 4; i++) {
            a = i == 1 || i == 2; b = i > 1
            print "v", x + w * a, 0.125 + 0.75 * b, z; print "vt", a, b
        }
        print "f 1/1 2/2 3/3 4/4" }' >"$1.obj"
}
sheet left 0 0 1 0
sheet right 1 0 0 1
sheet above 0 0.25 0 1
sheet far 7 3 0 1
sheet plain 0 0.25 0 1
awk '/^v/ { print $1, $2, $3, $4; next } { print }' plain.obj >x.obj && mv x.obj plain.obj
square wide 0.125 1.75 -0.0625
square low 0.125 0.75 -0.0625
square cage 0.125 0.75 0.5
for scan in left right above far plain; do
    size=0.03125
    [ $scan = right ] && size=0.025
    ok run bisque-voxelize $scan.obj -o $scan.nvdb --voxel-size $size
done
ok run bisque-voxelize left.obj right.obj -o merged.tris
size="--device cpu --size 32x16"
all="--maps normal,color,mask,height,position,curvature --distance curvature=0.0625"
rays="--front 0.5 --back 0.125"

# same_values A B: no sample of the maps differs.
same_values()
{
    ok run bisque-compare "$1" "$2" --max-error 0
}

# ---- the nearest hit ----

ok $bake $size --maps color merged.tris wide.obj -o merged.exr --front 0.5 --back 0.125 --padding 0
for kind in nvdb tris; do
    # Beside each other: each half of the map has a colour, and no sample is missed.
    ok $bake $size --maps color,height wide.obj left.$kind right.$kind -o 'both_<MAP>.exr' \
        $rays --padding 0 --json
    json '.misses == 0 and .samples == 2048 and .scan_path == "left.'$kind'" and
        .scan_paths == ["left.'$kind'", "right.'$kind'"] and
        (.encodings.height.range - 0.0625 | fabs) < 1e-6'
    # The voxels at an edge reach over it, by up to a texel here.
    run bisque-compare both_color.exr merged.exr --max-error 0.01
    [ $kind = nvdb ] || code 0
    holds "only a column at the edge differs" grep -Eq 'share above 1: (0|3.125) %' "$out"
    # Above each other: the nearer one wins without a cage, the outer one from a cage.
    $bake $size --maps color left.$kind low.obj -o near.exr $rays
    $bake $size --maps color above.$kind low.obj -o far.exr $rays
    ok $bake $size --maps color left.$kind above.$kind low.obj -o two.exr $rays
    same_values two.exr near.exr
    ok $bake $size --maps color left.$kind above.$kind low.obj -o cage.exr --cage cage.obj --back 0.125
    same_values cage.exr far.exr
    # A scan that no ray reaches changes nothing.
    $bake $size $all --samples 1 left.$kind low.obj -o 'alone_<MAP>.exr' $rays
    ok $bake $size $all --samples 1 far.$kind left.$kind low.obj -o 'more_<MAP>.exr' $rays
    for map in normal color mask height position; do
        same_values alone_$map.exr more_$map.exr
    done
done

# ---- any order, threads, memory and kinds of scans ----

for scans in "left.nvdb right.nvdb above.nvdb" "left.tris right.tris above.tris" \
    "left.nvdb right.tris above.nvdb"; do
    set -- $scans
    ok $bake $size $all $1 $2 $3 wide.obj -o 'one_<MAP>.exr' --threads 1
    ok $bake $size $all $3 $1 $2 wide.obj -o 'other_<MAP>.exr' --threads 3 --memory 96M
    for map in normal color mask height position curvature; do
        same one_$map.exr other_$map.exr
    done
    holds "the map names its scans" grep -aq 'bisque:scans.*above.* left.* right' one_color.exr
done

small="--device cpu --size 8 --maps normal --view count=1"
$bake $small left.nvdb above.tris low.obj -o x.exr --preview one.png
ok $bake $small above.tris left.nvdb low.obj -o x.exr --preview other.png
same one.png other.png
rm x.exr

# ---- names that match ----

# Two objects in one place, whose charts are the halves of the map. The green sheet is nearer.
mkdir scans
for kind in nvdb tris; do
    cp left.$kind scans/belt_high.$kind
    cp above.$kind scans/body_high_1.$kind
    cp far.$kind scans/body_high_2.$kind
done
awk 'BEGIN {
    for (o = 0; o < 2; o++) {
        print "o", o ? "belt_low" : "body_low"
        for (i = 0; i < 4; i++) {
            a = i == 1 || i == 2; b = i > 1
            print "v", 0.125 + 0.75 * a, 0.125 + 0.75 * b, -0.0625; print "vt", (o + a) / 2, b
        }
        f = 4 * o + 1
        print "f", f "/" f, f + 1 "/" f + 1, f + 2 "/" f + 2, f + 3 "/" f + 3
    } }' >pair.obj
sed 's/_low/_L/' pair.obj >letters.obj
for kind in nvdb tris; do
    high="scans/body_high_1.$kind scans/belt_high.$kind scans/body_high_2.$kind"
    ok $bake $size --maps color $high pair.obj -o '<OBJECT>.exr' $rays --padding 0 --match name
    # Each object alone, with its scan alone.
    for pair in "body body_high_1" "belt belt_high"; do
        set -- $pair
        awk -v o="$1_low" '$1 == "o" { on = $2 == o } $1 != "f" || on { print }' pair.obj >single.obj
        $bake $size --maps color scans/$2.$kind single.obj -o single.exr $rays --padding 0
        same_values $1_low.exr single.exr
    done
    run bisque-compare body_low.exr belt_low.exr --max-error 1
    code 1
    # In one map, with automatic lengths of rays: no sample takes the other scan.
    ok $bake $size --maps height,color $high pair.obj -o 'match_<MAP>.exr' --padding 0 --match name --json
    json '.misses == 0 and (.encodings.height.range - 0.3125 | fabs) < 0.001 and .front > 0.3125'
    $bake $size --maps height $high pair.obj -o any.exr --padding 0 --json
    json '(.encodings.height.range - 0.0625 | fabs) < 0.001'
done
# Secondary rays see the only scan of each object.
ok $bake $size --maps ao scans/body_high_1.nvdb scans/belt_high.nvdb pair.obj -o ao.exr \
    $rays --padding 0 --match name --rays ao=16 --json
# Suffixes.
ok $bake $size --maps mask scans/body_high_1.nvdb scans/belt_high.nvdb letters.obj -o x.exr \
    --match _L,_high --front 1 --back 0
rm x.exr
# A scan belongs to the object that shares most of its name.
cp scans/body_high_1.nvdb body.nvdb
cp scans/belt_high.nvdb body_belt.nvdb
sed 's/belt_low/body_belt_low/' pair.obj >nested.obj
ok $bake $size --maps height body.nvdb body_belt.nvdb nested.obj -o nested.exr $rays --padding 0 --match _low, --json
json '.misses == 0 and (.encodings.height.range - 0.3125 | fabs) < 0.001'
rm body.nvdb body_belt.nvdb nested.*
$bake $size --maps mask left.nvdb scans/belt_high.nvdb pair.obj -o x.exr --match name
refused 64 "$p: names do not match: low-poly objects without a scan: body_low; scans without an object: left"
$bake $size --maps mask scans/belt_high.nvdb pair.obj -o x.exr --match name
refused 64 "$p: names do not match: low-poly objects without a scan: body_low; scans without an object: none"
$bake $size --maps mask left.nvdb low.obj -o x.exr --match colour
refused 64 "$p: --match: \"colour\" is not name or LOW,HIGH"

# ---- what is refused ----

ok $bake $size --maps all left.nvdb right.nvdb wide.obj -o 'all_<MAP>.exr' --rays ao=4 \
    --rays thickness=4 --json
json '.maps | has("ao") and has("bent") and has("thickness") and has("curvature")'
$bake $size --maps color left.nvdb plain.nvdb wide.obj -o x.exr
refused_like 65 "^$p: plain\.nvdb has no colour; leave color out of --maps"
ok $bake $size left.nvdb plain.nvdb wide.obj -o default.exr --json
json '.maps | keys == ["normal"]'
lost="plain.nvdb has no colour, and other scans have: no map color is baked"
holds "one warning tells that colours get lost" [ "$(grep -c "^$p: warning: $lost\$" "$err")" -eq 1 ]
$bake $size left.nvdb plain.nvdb wide.obj -o x.exr --strict
refused 65 "$p: $lost"
mkdir ids
ok run bisque-voxelize left.obj -o ids/left.nvdb --voxel-size 0.03125 --channels id --id color
ok $bake $size ids/left.nvdb right.nvdb wide.obj -o 'x_<MAP>.exr' --maps all --rays ao=1 --rays thickness=1
grep -q "^$p: warning: the scans do not all have ids of one kind: no map id is baked$" "$err"
check "a warning tells that ids get lost" $?
rm x_*.exr
ok $bake $size left.nvdb right.nvdb wide.obj -o 'x_<MAP>.exr' --maps all --rays ao=1,thickness=1 --distance thickness=1
[ ! -s "$err" ] && rm x_*.exr
check "nothing is told if no scan has ids" $?
$bake $size left.nvdb missing.nvdb wide.obj -o x.exr
code 66
$bake $size --scan sampling=nearest left.nvdb left.tris wide.obj -o x.exr
code 64
$bake $size left.nvdb right.nvdb low.obj -o left.nvdb
code 64
holds "no map is left" [ ! -e x.exr ]

finish

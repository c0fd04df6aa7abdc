#!/bin/sh
# test_accuracy.sh - errors of maps: thin plates, exact maps compared with a formula and with
# voxels, tangent space compared with object space.
. "$(dirname "$0")/lib.sh"
unsanitized "errors of maps" "they would need large scans; other tests run this code under sanitizers"

# accurate NAME CHECKER ARGUMENT...: the results are within the checker's limits.
accurate()
{
    name=$1 checker=$2
    shift 2
    command="$checker $*" code=0
    "$TESTS/$checker" "$@" >"$out" 2>"$err" || code=$?
    check "$name" "$code"
    sed 's/^/# /' "$out"
}

# within NAME ARGUMENT...: the results are within bisque-compare's limits.
within()
{
    name=$1
    shift
    run bisque-compare "$@"
    check "$name" "$code"
    sed 's/^/# /' "$out"
}

# ---- a plate thinner than a voxel: red at the top, blue at the bottom ----

# place TILT HEIGHT: prints an AWK function that turns (x, y, z) by TILT degrees about the y axis
# and raises it by HEIGHT.
place()
{
    echo "function place(x, y, z,    a) {
        a = $1 * 3.14159265358979 / 180
        return sprintf(\"%.6f %.6f %.6f\", x * cos(a) - z * sin(a), y, x * sin(a) + z * cos(a) + $2) }"
}

# plate TILT HEIGHT THICKNESS: both faces of a plate, squares of side 40, without a rim.
plate()
{
    awk "$(place "$1" "$2")
        function face(z, color) {
            print \"v\", place(-20, -20, z), color; print \"v\", place(20, -20, z), color
            print \"v\", place(20, 20, z), color; print \"v\", place(-20, 20, z), color }
        BEGIN { face($3 / 2, \"1 0 0\"); face(-$3 / 2, \"0 0 1\"); print \"f 1 2 3 4\"; print \"f 5 8 7 6\" }"
}

# plate_low TILT HEIGHT: two squares of side 30 in the plate's middle plane, which face up and down;
# their UV charts are side by side.
plate_low()
{
    awk "$(place "$1" "$2")
        BEGIN { print \"v\", place(-15, -15, 0); print \"v\", place(15, -15, 0); print \"v\", place(15, 15, 0)
            print \"v\", place(-15, 15, 0)
            for (u = 0; u < 1; u += 0.5) {
                print \"vt\", u + 0.05, 0.1; print \"vt\", u + 0.45, 0.1; print \"vt\", u + 0.45, 0.9
                print \"vt\", u + 0.05, 0.9 }
            print \"f 1/1 2/2 3/3 4/4\"; print \"f 1/5 4/8 3/7 2/6\" }"
}

# bake_plate SCAN NAME
bake_plate()
{
    run bisque-bake "$1" plate_low.obj -o "$2_<MAP>.exr" --maps normal,color,mask --normal space=object \
        --type float --size 64x32 --samples 2 --front 6 --back 6 --device cpu
}

# Parallel to the grid, between two layers of voxels, inside one and elsewhere; and tilted.
for pose in "0 0" "0 0.25" "0 0.5" "33 0.25"; do
    tilt=${pose% *} height=${pose#* }
    plate_low "$tilt" "$height" >plate_low.obj
    # The reference: the same sides, four voxels from the low-poly mesh, so that they cannot be
    # mixed up.
    plate "$tilt" "$height" 8 >thick.obj
    run bisque-voxelize thick.obj -o thick.nvdb --voxel-size 1
    bake_plate thick.tris thick
    for thickness in 0.9 0.5 0.1; do
        plate "$tilt" "$height" $thickness >plate.obj
        run bisque-voxelize plate.obj -o plate.nvdb --voxel-size 1
        for scan in nvdb tris; do
            bake_plate plate.$scan plate
            what="plate of $thickness voxels at $height, tilted by $tilt degrees, from .$scan"
            within "$what: red above, blue below" plate_color.exr thick_color.exr --mask-a plate_mask.exr \
                --mask-b thick_mask.exr --max-error 0.5 --min-agreement 1
            within "$what: normals" plate_normal.exr thick_normal.exr --mask-a plate_mask.exr \
                --mask-b thick_mask.exr --max-error 0.1 --min-agreement 1
        done
    done
done
# The comparison above finds swapped sides.
sed 's/1 0 0$/x/; s/0 0 1$/1 0 0/; s/x$/0 0 1/' plate.obj >swapped.obj
run bisque-voxelize swapped.obj -o swapped.nvdb --voxel-size 1
bake_plate swapped.nvdb swapped
run bisque-compare swapped_color.exr thick_color.exr --mask thick_mask.exr --json
json '.mean > 30'

# ---- the vase: exact maps and the formula, voxels and exact maps ----
# The finest wave of its relief is 13 triangles long.

"$TESTS/generate-scan" --triangles 3000000 --normals vase -o vase.obj
"$TESTS/generate-scan" vase-low -o low.obj
ok run bisque-voxelize vase.obj -o vase.nvdb --resolution 1024
options="--maps normal,mask --size 256 --samples 2 --normal space=object --type float"
ok run bisque-bake vase.tris low.obj $options -o 'exact_<MAP>.exr'
accurate "exact maps have the formula's normals" check-vase -s 2 -e 7 -m 0.2 -p 0.5 -h 1 exact_normal.exr \
    exact_mask.exr
for setting in "--threads 1 --memory 96M" "--threads 3 --memory 1G"; do
    ok run bisque-bake vase.tris low.obj $options $setting -o 'other_<MAP>.exr'
    same exact_normal.exr other_normal.exr
    same exact_mask.exr other_mask.exr
done
ok run bisque-bake vase.nvdb low.obj $options -o 'voxel_<MAP>.exr'
# A texel is 6 voxels wide; the limit is the goal for voxels of at most half a texel.
within "voxels against exact maps" voxel_normal.exr exact_normal.exr --mask-a voxel_mask.exr \
    --mask-b exact_mask.exr --max-mean 0.4 --max-p95 1 --max-p99 1.5 --min-agreement 0.999

# ---- secondary rays: voxels and exact maps; errors are those of rays that start a voxel higher ----

around="--maps ao,thickness,mask --size 64 --samples 1 --rays ao=32 --rays thickness=32"
for scan in tris nvdb; do
    ok run bisque-bake vase.$scan low.obj $around -o "${scan}_<MAP>.exr"
done
within "ambient occlusion of voxels" nvdb_ao.exr tris_ao.exr --mask tris_mask.exr --max-mean 0.01
within "thickness of voxels" nvdb_thickness.exr tris_thickness.exr --mask tris_mask.exr --max-mean 0.0025

# ---- voxels of half a texel: 0.4 degrees, and a third of the nearest voxel's error ----

# mean_error MAP: prints the mean difference from the exact map, in degrees.
mean_error()
{
    run bisque-compare "$1_normal.exr" exact_normal.exr --mask-a "$1_mask.exr" --mask-b exact_mask.exr --json
    sed -n 's/^ *"mean": *\([-0-9.e]*\).*/\1/p' "$out"
}

# half_texels WHAT LIMIT TIMES WAVELENGTH OPTION...: bakes a sine surface with these options to 64 x
# 64 texels of size 1.5625.
half_texels()
{
    what=$1 limit=$2 times=$3 wavelength=$4
    shift 4
    "$TESTS/generate-scan" "$@" --wavelength "$wavelength" sine -o sine.obj
    ok run bisque-voxelize sine.obj -o sine.nvdb --voxel-size 0.78125
    options="--maps normal,mask --size 64 --samples 4 --normal space=object --type float --padding 0"
    run bisque-bake sine.tris sine_low.obj $options -o 'exact_<MAP>.exr'
    for sampling in trilinear nearest; do
        run bisque-bake sine.nvdb sine_low.obj $options --scan sampling=$sampling -o "${sampling}_<MAP>.exr"
    done
    trilinear=$(mean_error trilinear) nearest=$(mean_error nearest)
    echo "# $what: $trilinear degrees, nearest $nearest"
    awk "BEGIN { exit !($trilinear <= $limit && $times * $trilinear <= $nearest) }"
    check "$what" $?
}

"$TESTS/generate-scan" sine-low -o sine_low.obj
# Exact maps of small triangles that have the formula's normals give the formula's normals.
half_texels "waves of 8 voxels, the formula's normals" 0.2 3 6.25 --triangles 611618 --normals
# Voxels smaller than triangles without normals: planes must agree with interpolated normals.
half_texels "triangles of 0.8 voxels, 10 to a wave" 0.15 3 6.25 --triangles 59858
half_texels "triangles of 1.3 voxels, 10 to a wave" 0.4 2 10 --triangles 23328
half_texels "triangles of 1.6 voxels, 10 to a wave" 0.15 3 12.9 --triangles 14112
half_texels "triangles of 2.6 voxels, 10 to a wave" 0.2 1.2 20 --triangles 5832
half_texels "triangles of 2.6 voxels with the formula's normals" 0.4 1 20 --triangles 5832 --normals

# ---- tangent space, decoded as a shader does, compared with object space ----

write_box >box.obj
ok run bisque-voxelize box.obj -o box.nvdb --resolution 96
awk '$1 == "vt" { $2 = 1 - $2 } { print }' low.obj >low_mirrored.obj
# The box has no normals in its file, so smooth normals at its corners differ much over each face,
# and frames are far from orthogonal. In an orthogonal frame, rounding to half precision turns a
# normal by at most 0.0485 degrees.
for mesh in low low_mirrored box; do
    case $mesh in
    box) scan=box limit=0.15 ;;
    *) scan=vase limit=0.05 ;;
    esac
    for source in nvdb tris; do
        bake="run bisque-bake $scan.$source $mesh.obj --size 256 --samples 1 --device cpu"
        ok $bake --maps normal,mask --normal space=object --type float -o 'object_<MAP>.exr'
        $bake --maps normal --type float -o tangent.exr
        accurate "$mesh from $scan.$source: tangent space of floats is object space" check-tangent -x 0.01 -h 0.5 \
            $mesh.obj tangent.exr object_normal.exr object_mask.exr
        $bake --maps normal --type half -o tangent.exr
        accurate "$mesh from $scan.$source: tangent space of halves is object space" check-tangent -x $limit -m 0.03 \
            -h 0.5 $mesh.obj tangent.exr object_normal.exr object_mask.exr
    done
done
finish

#!/bin/sh
# Compares ambient occlusion and normals with those that Blender bakes.
#
#   BIN=DIR TESTS=DIR tests/bench/blender.sh
#
#   BIN, TESTS   directories with the programs and with generate-scan and measure
#   BLENDER      Blender, or a Python with the module bpy (default: blender, else python3)
#   SIZE, RAYS   texels along a side (default 256), rays of the reference (default 1024)
#   SCANS        directory with bunny.obj and bunny_low.obj (default: ../shared/scans); without them
#                normals are left out
set -u
LC_ALL=C
export LC_ALL
BIN=$(cd "${BIN:?is the directory with the programs}" && pwd) || exit 66
TESTS=$(cd "${TESTS:?is the directory with the test programs}" && pwd) || exit 66
here=$(cd "$(dirname "$0")" && pwd) || exit 66
SCANS=$(cd "${SCANS:-../shared/scans}" 2>/dev/null && pwd) || SCANS=
size=${SIZE:-256} rays=${RAYS:-1024}
work=$(mktemp -d) || exit 73
trap 'rm -rf "$work"' EXIT
trap 'exit 75' INT TERM HUP
cd "$work" || exit 73

if [ -z "${BLENDER:-}" ]; then
    BLENDER=python3
    ! command -v blender >/dev/null || BLENDER=blender
fi
# blend ARGUMENT...: runs blender_bake.py, and prints what it says.
blend()
{
    case $BLENDER in
    *python*) "$BLENDER" "$here/blender_bake.py" "$@" ;;
    *) "$BLENDER" -b --factory-startup --python "$here/blender_bake.py" -- "$@" ;;
    esac >blender.log 2>&1 || {
        tail -n 5 blender.log >&2
        exit 70
    }
    sed -n '/^\(texels\|means\|processor seconds\):/p' blender.log
}
if ! { "$BLENDER" -b --version || "$BLENDER" -c 'import bpy'; } >/dev/null 2>&1; then
    echo "bench-blender: there is neither Blender nor a Python with bpy: set BLENDER" >&2
    exit 69
fi

# bake MAP OPTION...: bakes a map and the mask as floats, and prints the processor time.
bake()
{
    map=$1
    shift
    "$TESTS/measure" report "$BIN/bisque-bake" "$@" -o "${map}_<MAP>.exr" --type float --size "$size" \
        --samples 1 --padding 0 >bake.log 2>&1 || {
        cat bake.log >&2
        exit 70
    }
    tr ' ' '\n' <report | awk -F = '/^(user|system)=/ { s += $2 } END { printf "processor seconds: %.1f\n", s }'
}

"$TESTS/generate-scan" --triangles 200000 vase -o vase.obj &&
    "$TESTS/generate-scan" vase-low -o vase_low.obj &&
    "$BIN/bisque-voxelize" vase.obj -o vase.nvdb >bake.log 2>&1 || exit 70
reach="--front 0.05 --back 0.05"
for count in 64 "$rays"; do
    echo "ao of the vase, exact, $count rays"
    # shellcheck disable=SC2086 # options
    bake "exact$count" vase.tris vase_low.obj --maps ao,mask --rays ao="$count" $reach
    echo "ao of the vase, Blender, $count rays"
    blend bake ao vase.obj vase_low.obj "blender$count.exr" "$size" "$count" 0.05 0.05
done
echo "ao of the vase, grid, 64 rays"
# shellcheck disable=SC2086 # options
bake grid64 vase.nvdb vase_low.obj --maps ao,mask --rays ao=64 $reach
mask=exact${rays}_mask.exr
for map in "exact${rays}_ao.exr" exact64_ao.exr grid64_ao.exr blender64.exr; do
    echo "$map beside Blender with $rays rays"
    blend compare value "$map" "blender$rays.exr" "$mask"
done
echo "exact64_ao.exr beside $rays rays"
blend compare value exact64_ao.exr "exact${rays}_ao.exr" "$mask"

if [ -z "$SCANS" ] || [ ! -f "$SCANS/bunny.obj" ]; then
    echo "bench-blender: no bunny.obj in SCANS: normals are left out" >&2
    exit 0
fi
cp "$SCANS/bunny.obj" "$SCANS/bunny_low.obj" .
"$BIN/bisque-voxelize" bunny.obj -o bunny.nvdb --resolution 64 >bake.log 2>&1 || exit 70
blend bake normal bunny.obj bunny_low.obj bunny.exr "$size" 1 0.005 0.005
for weights in area angle max; do
    echo "normals of the bunny, degrees, --scan normals=$weights"
    bake "$weights" bunny.tris bunny_low.obj --maps normal,mask --normal space=object \
        --front 0.005 --back 0.005 --scan normals=$weights
    blend compare angle "${weights}_normal.exr" bunny.exr "${weights}_mask.exr"
done

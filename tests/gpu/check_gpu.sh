#!/bin/sh
# Bakes all maps of a grid, and exact ones, on the processor and on each device of CUDA and OpenCL of this machine, and
# compares them. Maps from CUDA must have the processor's bytes. OpenCL devices may round differently:
# their maps may differ a little, and the line of each map says whether they do.
#
#   tests/gpu/check_gpu.sh
#
# It needs an NVIDIA GPU with its driver and a folder that `make gpu-bundle` made (GPU_BUNDLE, by
# default build/gpu), and no compiler, so that the folder may come from another machine. The exit code
# is 1 if a map differs or if there is no CUDA device.
here=$(cd "$(dirname "$0")/../.." && pwd) || exit 1
bundle=$(cd "${GPU_BUNDLE:-$here/build/gpu}" && pwd) || exit 1
BIN=$bundle/bin TESTS=$bundle/bin
LD_LIBRARY_PATH=$bundle/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
export LD_LIBRARY_PATH
. "$here/tests/cli/lib.sh"

# ---- a scan with everything that a grid can have ----

# A vase of four materials with roughness, metallic and emission.
"$BIN/generate-scan" --triangles 400000 --colors vase -o vase.obj >/dev/null &&
    "$BIN/generate-scan" vase-low -o low.obj >/dev/null || exit 1
awk 'BEGIN { print "mtllib vase.mtl" }
    /^f / && faces++ % 5000 == 0 { print "usemtl m" int(faces / 5000) % 4 }
    { print }' vase.obj >materials.obj
awk 'BEGIN {
    for (m = 0; m < 4; m++)
        printf "newmtl m%d\nPr %.2f\nPm %.2f\nKe %.2f 0.3 0.6\n", m, 0.1 + m / 5, m / 4, m / 8
}' >vase.mtl
ok run bisque-voxelize --resolution 700 materials.obj -o scan.nvdb --no-tris \
    --channels id,roughness,metallic,emission
ok run bisque-voxelize materials.obj -o scan.tris --channels id,roughness,metallic,emission

# ---- bakes ----

names="ao bent color confidence curvature emission height id mask metallic normal position roughness thickness"

# bake DEVICE WAY: all maps, in one of several ways that take other parts of the kernel.
bake()
{
    scan=scan.nvdb
    case $2 in
    usual) options="--size 512x384 --rays ao=16,thickness=16" ;;
    other) options="--size 384 --samples 1 --scan sampling=nearest --two-sided --normal space=object
        --ray-directions mesh --rays ao=8,thickness=8 --ao coarse=none,falloff=linear,spread=100 --distance ao=0.1,thickness=0.2" ;;
    dense) options="--size 96x64 --samples 20 --extrude 0.05 --rays ao=400,thickness=400" ;;
    exact) scan=scan.tris options="--size 512x384 --rays ao=64,thickness=64" ;;
    groups) scan=scan.tris options="--size 256x192 --rays ao=64,thickness=64 --ao falloff=linear --distance ao=0.3
        --threads 2 --gpu-memory 24M" ;;
    esac
    # shellcheck disable=SC2086 # several options
    ok run bisque-bake --device "$1" --maps all --type float $options $scan low.obj \
        -o "$1.$2.<MAP>.exr" --json
}

# compare DEVICE WAY: the maps of the processor and of the device.
compare()
{
    for map in $names; do
        command="cmp cpu.$2.$map.exr $1.$2.$map.exr" code=0
        if cmp -s "cpu.$2.$map.exr" "$1.$2.$map.exr"; then
            check "$1, $2: $map has the processor's bytes" 0
        elif [ "${1%%:*}" = cuda ]; then
            check "$1, $2: $map has the processor's bytes" 1
        else
            run bisque-compare --type data "cpu.$2.$map.exr" "$1.$2.$map.exr" --max-p99 1e-5 --max-error 0.02
            check "$1, $2: $map is nearly the processor's" "$code"
        fi
    done
}

run bisque-bake --list devices
sed 's/^/# /' "$out" "$err"
devices=$(sed -En 's/^((cuda|opencl):[0-9]+) .*/\1/p' "$out")
holds "there is a CUDA device" grep -q '^cuda:0 ' "$out"
for way in usual other dense exact groups; do
    bake cpu $way
    holds "no map is left out" [ "$(echo cpu.$way.*)" = "$(printf "cpu.$way.%s.exr " $names | sed 's/ $//')" ]
    for device in $devices; do
        bake "$device" $way
        grep -Eq '"kernel_calls": [1-9]' "$out"
        check "the device bakes them" $?
        compare "$device" $way
    done
    rm -f -- *".$way."*
done
finish

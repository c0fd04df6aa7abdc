#!/bin/sh
# Exact bakes with a device: all maps have the processor's bytes, whatever the device, its memory, the threads, the
# options and the number of scans; and what happens if the device fails, is too small or has no double precision.
. "$(dirname "$0")/lib.sh"
p=bisque-bake:
fake=$TESTS/fake

"$TESTS/generate-scan" --offset 9,9,9 --triangles 200000 --colors vase -o vase.obj >/dev/null &&
    "$TESTS/generate-scan" --offset 9,9,9 vase-low -o low.obj >/dev/null &&
    "$BIN/bisque-voxelize" vase.obj -o vase.tris >/dev/null &&
    "$TESTS/generate-scan" --offset 9.2,9,9 --triangles 60000 vase -o near.obj >/dev/null &&
    "$BIN/bisque-voxelize" near.obj -o near.tris >/dev/null || exit 1
first=normal,mask,height,position,curvature,confidence
names="ao bent thickness $(echo $first | tr , ' ')"
usual="--threads 2 --size 96x64 --type float --maps ao,bent,thickness,$first --rays ao=12,thickness=4 vase.tris low.obj"
other="--threads 3 --size 64x40 --samples 1 --type float --maps ao,bent,thickness,$first --rays ao=70,thickness=5
    --ao falloff=linear,spread=100 --distance ao=0.2,thickness=0.1 --two-sided --memory 100M vase.tris low.obj"
# Batches that meet chunks again, in which rays have hits.
small="--threads 2 --memory 20M --size 256 --maps normal vase.tris low.obj"
several="--threads 2 --size 64x40 --type float --maps ao,bent,thickness,$first --rays ao=12,thickness=4
    --extrude 0.1 vase.tris near.tris low.obj"

cuda() { LD_LIBRARY_PATH=$fake run bisque-bake "$@"; }
opencl() { LD_LIBRARY_PATH=$fake/opencl run bisque-bake "$@"; }

# made NAME WAY: the maps of the last job have the bytes of the processor's.
made()
{
    code 0
    for map in $names; do
        same "cpu.$2.$map.exr" "$1.$map.exr"
    done
    rm -f "$1".*.exr
}
# bytes TEXT: the bytes of the MiB that standard error has before TEXT.
bytes() { sed -n "s/.* \([0-9.]*\) MiB $1.*/\1/p" "$err" | awk '{ printf "%d", $1 * 1048576 + 110000 }'; }

ok run bisque-bake --device cpu $usual -o 'cpu.usual.<MAP>.exr' --json
json '.device == "cpu, 2 threads, exact"'
# shellcheck disable=SC2086 # several options
ok run bisque-bake --device cpu $other -o 'cpu.other.<MAP>.exr'
# shellcheck disable=SC2086
ok run bisque-bake --device cpu $several -o 'cpu.several.<MAP>.exr'
ok run bisque-bake --device cpu $small -o cpu.small.exr --json
json '.chunk_loads > 8' # of four chunks

# ---- CUDA ----

ptx=$(ls "$BIN"/../gen/kernel-*.ptx 2>/dev/null | head -n 1)
if [ -s "$ptx" ]; then
    cuda --device cuda $usual -o 'x.<MAP>.exr' --json
    json '.device == "Fake GPU 0 (CUDA), exact" and .kernel_calls > 0 and .seconds_upload > 0 and .seconds_kernels > 0'
    holds "nothing is left on the device: $(cat "$err")" [ ! -s "$err" ]
    calls=$(sed -n 's/.*"kernel_calls": \([0-9]*\).*/\1/p' "$out")
    made x usual
    # shellcheck disable=SC2086
    cuda --device cuda $other -o 'x.<MAP>.exr'
    made x other
    # shellcheck disable=SC2086
    cuda --device cuda $several -o 'x.<MAP>.exr' --gpu-memory 12M
    made x several
    cuda --device auto $usual --threads 1 -o 'x.<MAP>.exr' --json
    json '.device == "Fake GPU 0 (CUDA), exact"'
    made x usual
    ok cuda --device cuda --threads 2 --size 96x64 --type float --maps normal vase.tris low.obj -o x.exr --gpu-memory 6M --json
    json '.device == "Fake GPU 0 (CUDA), exact" and .kernel_calls > 0'
    holds "nothing is said of first rays alone: $(cat "$err")" [ ! -s "$err" ]
    same cpu.usual.normal.exr x.exr
    ok cuda --device cuda $small -o x.exr --json
    json '.device == "Fake GPU 0 (CUDA), exact"'
    same cpu.small.exr x.exr
    rm x.exr

    # The scan passes through a small device in groups of chunks.
    cuda --device cuda $usual -o 'x.<MAP>.exr' --gpu-memory 1M
    refused_like 69 'Fake GPU 0: rays take [0-9]+ bytes of the device.s memory, 1048576 are allowed'
    rays=$(sed -n 's/.*rays take \([0-9]*\) bytes.*/\1/p' "$err")
    cuda --device cuda $usual -o 'x.<MAP>.exr' --gpu-memory $((${rays:-1} + 1000000)) --json
    json '.device == "cpu, 2 threads, exact" and .kernel_calls == 0'
    needs='the largest chunk of the scan needs [0-9.]* MiB of memory, Fake GPU 0 (CUDA) has 1\.0 MiB for it'
    [ "$(wc -l <"$err")" -eq 1 ] && grep -qx "$p warning: $needs: the processor bakes it" "$err"
    check "a line says that a chunk does not fit" $?
    chunk=$(bytes 'of memory')
    made x usual
    for areas in 1 2; do
        cuda --device cuda $usual -o 'x.<MAP>.exr' --gpu-memory $((rays + areas * ${chunk:-1})) --json
        json ".kernel_calls > $calls and (.device | startswith(\"Fake GPU\"))"
        holds "nothing is said of $areas areas: $(cat "$err")" [ ! -s "$err" ]
        made x usual
    done

    # A device that fails: the processor goes on, or ends the job if the device was named.
    for failure in cuMemAlloc_v2:1:2 cuMemAlloc_v2:2:2 cuMemAlloc_v2:4:719 cuMemAllocHost_v2:1:2 cuMemcpyHtoDAsync_v2:3:719 \
        cuMemcpyHtoDAsync_v2:20:719 cuMemcpyHtoDAsync_v2:40:719 cuEventSynchronize:5:719 cuEventSynchronize:90:719 \
        cuLaunchKernel:1:719 cuLaunchKernel:2:719 cuLaunchKernel:8:719 cuMemcpyDtoHAsync_v2:2:719 \
        cuMemcpyDtoHAsync_v2:9:719 cuEventElapsedTime:9:719; do
        FAKE_CUDA_FAIL=$failure cuda --device auto $usual -o 'x.<MAP>.exr' --gpu-memory $((rays + 2 * chunk)) --json
        json '.device == "Fake GPU 0 (CUDA), then cpu, 2 threads, exact"'
        [ "$(wc -l <"$err")" -eq 1 ] && grep -q "going on with cpu, 2 threads, exact$" "$err"
        check "one line tells of $failure" $?
        made x usual
    done
    FAKE_CUDA_FAIL=cuLaunchKernel:1:719 cuda --device cuda $usual --threads 1 -o 'x.<MAP>.exr'
    refused 69 "$p Fake GPU 0 (CUDA): cuLaunchKernel: CUDA_ERROR_LAUNCH_FAILED (unspecified launch failure)"
    holds "no map of a failed job" [ -z "$(ls x.* 2>/dev/null)" ]
else
    lacks "CUDA" "built without clang and nvcc"
fi

# ---- OpenCL ----

FAKE_OPENCL_REAL=$(ldconfig -p | awk '/libOpenCL\.so\.1 / { print $NF; exit }')
export FAKE_OPENCL_REAL
if has_opencl; then
    # This device shares the host's memory; the next one has its own.
    run bisque-bake --device opencl:0 $usual -o 'x.<MAP>.exr' --json
    json '(.device | endswith(", exact")) and .kernel_calls > 0'
    calls=$(sed -n 's/.*"kernel_calls": \([0-9]*\).*/\1/p' "$out")
    made x usual
    run bisque-bake --device opencl:0 $usual -o 'x.<MAP>.exr' --gpu-memory 12M --json
    json ".kernel_calls > $calls"
    made x usual
    # shellcheck disable=SC2086
    run bisque-bake --device opencl:0 $other -o 'x.<MAP>.exr'
    made x other
    # shellcheck disable=SC2086
    run bisque-bake --device opencl:0 $several -o 'x.<MAP>.exr' --gpu-memory 12M --json
    json '(.device | endswith(", exact")) and .kernel_calls > 0'
    made x several
    ok run bisque-bake --device opencl:0 $small -o x.exr
    same cpu.small.exr x.exr
    rm x.exr
    opencl --device auto $usual -o 'x.<MAP>.exr' --gpu-memory 12M --json
    json '(.device | startswith("cpu,") | not) and .kernel_calls > 0'
    made x usual
    FAKE_OPENCL_FAIL=clEnqueueNDRangeKernel:1:-5 opencl --device auto $usual -o 'x.<MAP>.exr'
    holds "one line: $(cat "$err")" grep -q "going on with cpu, 2 threads, exact$" "$err"
    made x usual
    FAKE_OPENCL_SINGLE=1 opencl --device opencl:0 $usual -o 'x.<MAP>.exr' --json
    json '.device == "cpu, 2 threads, exact"'
    [ "$(wc -l <"$err")" -eq 1 ] &&
        grep -q "^$p warning: .* has no double precision, which triangles need: the processor bakes it$" "$err"
    check "a line says that the device has no double precision" $?
    made x usual
    FAKE_OPENCL_SINGLE=1 opencl --device auto $usual -o 'x.<MAP>.exr' --json
    json '.device == "cpu, 2 threads, exact"'
    holds "one line: $(cat "$err")" grep -q "opencl:0 is not used: .* has no double precision" "$err"
    made x usual
else
    lacks "OpenCL" "there is no OpenCL device"
fi
finish

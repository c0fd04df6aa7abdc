#!/bin/sh
# GPUs that fail under way: bisque-bake finishes the same maps with the processor and says so once,
# or ends with one line if the user named the device. The drivers are tests/fake/fake_cuda.c and
# tests/fake/opencl_gpu.c.
. "$(dirname "$0")/lib.sh"
p=bisque-bake:
fake=$TESTS/fake

"$TESTS/generate-scan" --offset 9,9,9 --triangles 20000 --colors vase -o vase.obj >/dev/null &&
    "$TESTS/generate-scan" --offset 9,9,9 vase-low -o low.obj >/dev/null &&
    "$BIN/bisque-voxelize" --resolution 500 vase.obj -o vase.nvdb >/dev/null || exit 1
maps="--threads 2 --size 224x128 --type float --maps normal,mask vase.nvdb low.obj"

ok run bisque-bake --device cpu $maps -o 'cpu_<MAP>.exr'

cuda() { LD_LIBRARY_PATH=$fake run bisque-bake "$@"; }
opencl() { LD_LIBRARY_PATH=$fake/opencl run bisque-bake "$@"; }

# survives SETTING: checks the last job: its maps, and that it warned at most once. OpenCL devices
# may round differently.
survives()
{
    ok=0
    [ "$code" -eq 0 ] && [ "$(wc -l <"$err")" -le 1 ] && cmp -s cpu_mask.exr x_mask.exr &&
        "$BIN/bisque-compare" --type normal --max-mean 0.1 cpu_normal.exr x_normal.exr \
            >/dev/null 2>&1 || ok=1
    [ ! -s "$err" ] || grep -Eq "is not used: |; going on with cpu, 2 threads$" "$err" || ok=1
    [ ! -s "$err" ] || warned=$((warned + 1))
    check "the job survives $1" $ok
    rm -f x_*.exr
}

# ---- CUDA ----

ptx=$(ls "$BIN"/../gen/kernel-*.ptx 2>/dev/null | head -n 1)
if [ -s "$ptx" ]; then
    cuda --device cuda $maps -o 'x_<MAP>.exr' --json
    json '.kernel_calls > 6'
    warned=0
    for call in cuCtxSetCurrent cuMemAlloc_v2 cuMemcpyHtoDAsync_v2 cuEventRecord cuEventSynchronize \
        cuLaunchKernel cuStreamQuery cuMemcpyDtoHAsync_v2 cuEventElapsedTime; do
        for number in 1 7; do
            FAKE_CUDA_FAIL=$call:$number:719 cuda --device auto $maps -o 'x_<MAP>.exr'
            survives "$call:$number"
        done
    done
    holds "most failures were reached: $warned" [ "$warned" -ge 15 ]
    # The rays of curvature come after all patches.
    alone="--threads 1 --size 224x128 --type float vase.nvdb low.obj"
    ok run bisque-bake --device cpu $alone --maps curvature -o cpu_curvature.exr
    cuda --device cuda $alone --maps normal -o x.exr --json
    patches=$(jq .kernel_calls "$out")
    FAKE_CUDA_FAIL=cuLaunchKernel:$((patches + 2)):719 cuda --device auto $alone --maps curvature -o x.exr --json
    json ".kernel_calls == $patches + 2 and (.device | endswith(\", then cpu, 1 thread\"))"
    same cpu_curvature.exr x.exr
    rm x.exr
    # With a second thread, its next call could fail first.
    FAKE_CUDA_FAIL=cuStreamQuery:3:719 cuda --device cuda ${maps#--threads 2} --threads 1 -o 'x_<MAP>.exr'
    code 69
    refused 69 "$p Fake GPU 0 (CUDA): cuLaunchKernel: CUDA_ERROR_LAUNCH_FAILED (unspecified launch failure)"
else
    lacks "CUDA" "built without clang and nvcc"
fi

# ---- OpenCL ----

FAKE_OPENCL_REAL=$(ldconfig -p | awk '/libOpenCL\.so\.1 / { print $NF; exit }')
export FAKE_OPENCL_REAL
if [ -n "$FAKE_OPENCL_REAL" ] && opencl --list devices && grep -q '^opencl:0' "$out"; then
    opencl --device auto $maps -o 'x_<MAP>.exr' --json
    json '(.device | startswith("cpu,") | not) and .kernel_calls > 6'
    holds "the device works to the end: $(cat "$err")" [ ! -s "$err" ]
    warned=0
    for failure in clCreateContext:1 clBuildProgram:1 clCreateBuffer:7 clEnqueueWriteBuffer:7 \
        clWaitForEvents:7 clSetKernelArg:7 clEnqueueNDRangeKernel:2 clEnqueueReadBuffer:2 \
        clGetEventProfilingInfo:7 clGetEventInfo:7; do
        FAKE_OPENCL_FAIL=$failure:-5 opencl --device auto $maps -o 'x_<MAP>.exr'
        survives "$failure"
    done
    holds "most failures were reached: $warned" [ "$warned" -ge 8 ]
    # A device that has less memory than it says: the codes that drivers give.
    for code_of_driver in -4 -5 -6 -61; do
        FAKE_OPENCL_FAIL=clCreateBuffer:5:$code_of_driver:once opencl --device auto $maps -o 'x_<MAP>.exr'
        survives "code $code_of_driver"
    done
else
    lacks "OpenCL" "no device is installed"
fi
finish

#!/bin/sh
# Devices of bisque-bake: lists, errors, the same maps from all devices, drivers that misbehave, the kernel's PTX.
# tests/fake/fake_cuda.c is the CUDA driver.
. "$(dirname "$0")/lib.sh"
p=bisque-bake:
fake=$TESTS/fake

bake() { run bisque-bake "$@"; }
cuda() { LD_LIBRARY_PATH=$fake bake "$@"; }

# warned LINE: checks that standard error has exactly this line.
warned()
{
    holds "warning: $1" grep -Fqx -- "$1" "$err"
}

# ---- inputs ----

"$TESTS/generate-scan" --offset 9,9,9 --triangles 20000 --colors vase -o vase.obj >/dev/null &&
    "$TESTS/generate-scan" --offset 9,9,9 vase-low -o low.obj >/dev/null &&
    "$BIN/bisque-voxelize" --resolution 500 vase.obj -o vase.nvdb >/dev/null || exit 1
hits="--rays ao=5 --distance ao=0.02 --rays thickness=3 --distance thickness=0.02"
maps="--size 160x96 --type float --maps all $hits vase.nvdb low.obj"
names="normal color mask height position curvature ao bent thickness confidence"

# ---- CUDA ----

ptx=$(ls "$BIN"/../gen/kernel-*.ptx 2>/dev/null | head -n 1)
if [ -s "$ptx" ]; then
    cuda --list devices
    code 0
    out_like '^cuda:0 +Fake GPU 0, 1\.0 GiB$'
    FAKE_CUDA_DEVICES=2 cuda --list devices --json
    json '.devices | map(select(.is_gpu)) | map(.id) | contains(["cuda:0", "cuda:1"])'

    bake --device cpu $maps -o 'cpu_<MAP>.exr'
    code 0
    cuda --device cuda $maps -o 'cuda_<MAP>.exr' --json
    code 0
    json '.device == "Fake GPU 0 (CUDA)" and .kernel_calls > 0 and .seconds_kernels > 0 and .seconds_upload > 0'
    check "nothing is left on the device" "$(wc -l <"$err")"
    cuda --device auto --threads 1 $maps -o 'auto_<MAP>.exr' --json
    json '.device == "Fake GPU 0 (CUDA)"'
    for map in $names; do
        same cpu_$map.exr cuda_$map.exr
        same cpu_$map.exr auto_$map.exr
    done

    # The next patch is copied and launched before the only worker waits for one.
    FAKE_CUDA_LOG=calls cuda --device cuda --threads 1 --size 384x256 --maps normal,ao --rays ao=4 vase.nvdb low.obj -o 'x_<MAP>.exr'
    code 0
    awk '
        $1 == "fetch" { fetching[$2] = 1; patches++ }
        $1 == "wait" && ($2 in fetching) {
            delete fetching[$2]
            for (other in fetching) beside++
        }
        END { exit !(patches > 4 && beside == patches - 1) }' calls
    check "while a worker waits for a patch, the GPU has the next one" $?
    rm calls x_*

    # A GPU fails during the job: "auto" falls back to the processor and makes the same map, "cuda" fails.
    FAKE_CUDA_FAIL=cuLaunchKernel:2:719 cuda --device auto --threads 1 $maps -o 'lost_<MAP>.exr' --json
    json '.device == "Fake GPU 0 (CUDA), then cpu, 1 thread"'
    holds "the GPU's loss is a warning" grep -q "going on with cpu" "$err"
    same cpu_normal.exr lost_normal.exr
    FAKE_CUDA_FAIL=cuLaunchKernel:2:719 cuda --device cuda $maps -o 'gone_<MAP>.exr'
    refused 69 "$p Fake GPU 0 (CUDA): cuLaunchKernel: CUDA_ERROR_LAUNCH_FAILED (unspecified launch failure)"
    holds "no map of a failed job" [ -z "$(ls gone_* 2>/dev/null)" ]

    # By default a bake asks no driver if the processor is expected to finish before a GPU. That is expected to take
    # half a second to open, and then needs the processor for the first rays as well, but hardly for those from hits.
    for short in '--size 16' '--size 640 --threads 1'; do
        FAKE_CUDA_FAIL=cuInit:1:803 cuda $short --maps mask vase.nvdb low.obj -o mask.exr --json
        json '.device | startswith("cpu")'
        holds "a short bake asks no driver: $short" [ ! -s "$err" ]
    done
    cuda --size 256 --threads 1 --maps ao vase.nvdb low.obj -o ao.exr --json
    json '.device == "Fake GPU 0 (CUDA)"'
    rm ao.exr

    # The processor bakes a grid that does not fit the device's memory, also if the user named the device. One line
    # says so.
    cuda --device cuda --threads 2 $maps -o 'x_<MAP>.exr' --gpu-memory 1M
    refused_like 69 'texels and the low-poly mesh take [0-9]+ bytes of the device.s memory, 1048576 are allowed'
    other=$(sed -n 's/.*take \([0-9]*\) bytes of the device.*/\1/p' "$err")
    few=$((${other:-1} + 1000000))
    needs='the grid needs \([0-9.]*\) MiB of memory, Fake GPU 0 (CUDA) has 1\.0 MiB for it'
    cuda --device cuda --threads 2 $maps -o 'few_<MAP>.exr' --gpu-memory $few --json
    code 0
    json '.device == "cpu, 2 threads" and .kernel_calls == 0'
    [ "$(wc -l <"$err")" -eq 1 ] && grep -qx "$p warning: $needs: the processor bakes it" "$err"
    check "a line says that the grid does not fit" $?
    for map in $names; do
        same cpu_$map.exr few_$map.exr
    done
    all=$(sed -n "s/.*$needs.*/\1/p" "$err" | awk -v other="$other" '{ printf "%d", other + ($1 + 0.1) * 1048576 }')
    cuda --device auto --threads 2 $maps -o 'auto_<MAP>.exr' --gpu-memory $few --json
    json '.device == "cpu, 2 threads"'
    grep -qx "$p warning: cuda:0 is not used: $needs" "$err"
    check "a line says why a GPU that was found is not used" $?
    same cpu_normal.exr auto_normal.exr
    cuda --device cuda --threads 2 $maps -o 'all_<MAP>.exr' --gpu-memory "${all:-1}" --json
    json '.device == "Fake GPU 0 (CUDA)"'
    holds "the memory that the line names is enough" [ ! -s "$err" ]
    same cpu_normal.exr all_normal.exr

    cuda --device cuda:1 $maps -o 'x_<MAP>.exr'
    refused 69 "$p there is no device cuda:1; there is cuda:0 Fake GPU 0"
    FAKE_CUDA_DEVICES=0 cuda --device cuda $maps -o 'x_<MAP>.exr'
    refused 69 "$p CUDA has no devices"
    FAKE_CUDA_FAIL=cuInit:1:803 cuda --list devices
    code 0
    warned "$p warning: CUDA does not start: CUDA_ERROR_SYSTEM_DRIVER_MISMATCH (system has unsupported display driver / cuda driver combination)"

    # ---- drivers that crash or hang, and other processes that ask them ----

    # NVIDIA's OpenCL driver starts CUDA, so it must not be asked by a child of a process that has started CUDA.
    nvidia() { LD_LIBRARY_PATH=$fake:$fake/nvidia bake "$@"; }
    FAKE_CUDA_FAIL=cuModuleLoadDataEx:1:218 nvidia --device auto --size 16 --maps mask vase.nvdb low.obj -o mask.exr
    code 0
    warned "$p warning: opencl:0 is not used: Fake GPU (Fake CUDA): clCreateContext: CL_DEVICE_NOT_AVAILABLE"
    FAKE_CUDA_FAIL=cuInit:1:-6 cuda --device cuda $maps -o 'x_<MAP>.exr'
    refused 69 "$p CUDA cannot be used: a driver crashed when it was asked for its devices (Aborted)"
    LD_LIBRARY_PATH=$fake:$fake/nvidia "$BIN/bisque-bake" --list devices 2>&- 0<&- | grep -q '^opencl:0'
    check "devices are listed without standard input and error" $?

    # gone PID: waits until a process has ended; hung: starts a job with a driver that hangs, sets $job and $asking.
    gone()
    {
        while [ -d "/proc/$1" ]; do
            case $(cat "/proc/$1/stat" 2>/dev/null) in *") Z "*) return 0 ;; esac
            sleep 0.05
        done
    }
    hung()
    {
        rm -f hang
        LD_LIBRARY_PATH=$fake FAKE_CUDA_HANG=hang "$BIN/bisque-bake" $maps --size 2048 -o 'x_<MAP>.exr' >"$out" 2>"$err" &
        job=$!
        while [ ! -s hang ] && kill -0 "$job"; do sleep 0.05; done
        asking=$(cat hang)
    }
    command="bisque-bake with a driver that hangs"
    hung
    kill -TERM "$job"
    code=0
    wait "$job" || code=$?
    code 75
    gone "$asking"
    check "the process that asks a driver ends with an interrupted job" $?
    hung
    kill -KILL "$job"
    wait "$job" 2>/dev/null
    gone "$asking"
    check "the process that asks a driver ends with a killed job" $?

    # ---- the kernel's PTX ----

    command="awk -f check_ptx.awk $ptx" code=0
    awk -f "$top/libbake/kernel/check_ptx.awk" "$ptx" >"$out" 2>"$err" || code=$?
    check "the PTX rounds as the processor does" "$code"
    # Drivers take PTX up to their own version. CUDA 11.0, the oldest with all functions, takes up to 7.0.
    version=$(sed -n 's/^\.version \([0-9]*\)\.\([0-9]*\)$/\1\2/p' "$ptx")
    holds "the PTX is for drivers since CUDA 11.0" [ "${version:-99}" -le 70 ]
    for bad in 'fma.rn.f32 %f1, %f2, %f3, %f4;' 'mul.f32 %f1, %f2, %f3;' 'div.full.f32 %f1, %f2, %f3;' \
        'sqrt.approx.f32 %f1, %f2;' 'add.rn.ftz.f32 %f1, %f2, %f3;' 'add.rn.f64 %fd1, %fd2, %fd3;'; do
        { cat "$ptx"; printf '\t%s\n' "$bad"; } >bad.ptx
        ! awk -f "$top/libbake/kernel/check_ptx.awk" bad.ptx 2>/dev/null
        check "PTX with $bad is refused" $?
    done
else
    lacks "CUDA" "built without clang and nvcc"
    bake --device cuda $maps -o 'x_<MAP>.exr'
    refused 69 "$p this program was built without CUDA (neither clang nor nvcc was there)"
fi

# ---- caches ----

# Programs keep no cache of kernels, so no file in a user's directories can mislead or block them.
if ! sanitized; then
    mkdir home
    devices=cpu
    [ ! -s "$ptx" ] || devices='cpu cuda'
    for device in $devices; do
        command="bisque-bake --device $device" code=0
        LD_LIBRARY_PATH=$fake HOME=$(pwd -P)/home XDG_CACHE_HOME=$(pwd -P)/home LD_PRELOAD=$TESTS/faults.so FAULT_UNDER=$(pwd -P)/home \
            FAULT_CALLS=open FAULT_LOG=$(pwd -P)/opened "$BIN/bisque-bake" --device "$device" --size 16 --maps mask \
            vase.nvdb low.obj -o mask.exr >"$out" 2>"$err" || code=$?
        code 0
        [ ! -s opened ] && [ -z "$(ls -A home)" ]
        check "--device $device opens no file of a cache" $?
    done
    rm -rf home opened
fi

# ---- OpenCL ----

# A device that is compiled at run time rounds nearly as the processor does.
if has_opencl; then
    bake --device cpu $maps -o 'cpu_<MAP>.exr'
    bake --device opencl:0 $maps -o 'opencl_<MAP>.exr'
    code 0
    for map in $names; do
        run bisque-compare --type data cpu_$map.exr opencl_$map.exr --max-p99 1e-5 --max-error 0.02
        check "$map is the same with OpenCL" "$code"
    done
else
    lacks "maps with OpenCL" "there is no OpenCL device"
fi

OCL_ICD_VENDORS=$fake/crashing_driver.so
export OCL_ICD_VENDORS
crash="OpenCL cannot be used: a driver crashed when it was asked for its devices (Aborted)"
bake --list devices
if [ "$(cat "$err")" = "$p warning: $crash" ]; then
    code 0
    bake --device auto --size 16 --maps mask vase.nvdb low.obj -o mask.exr
    code 0
    warned "$p warning: $crash"
    bake --device opencl --size 16 --maps mask vase.nvdb low.obj -o x.exr
    refused 69 "$p $crash"
else
    lacks "a driver that crashes" "no OpenCL loader that takes it"
fi
OCL_ICD_VENDORS=/nowhere
bake --device opencl --size 16 --maps mask vase.nvdb low.obj -o x.exr
if [ "$code" -eq 69 ]; then
    refused 69 "$p OpenCL has no devices (no driver that works is installed)"
    bake --list devices
    check "no warning if no OpenCL driver is registered" "$(wc -l <"$err")"
fi
unset OCL_ICD_VENDORS

# ---- the program that asks drivers is missing, or of another version ----

if sanitized; then
    skip "an answer that cannot be read" "sanitizers want to be loaded first"
else
    LD_PRELOAD=$TESTS/faults.so FAULT_UNDER='/memfd:devices (deleted)' FAULT_CALLS=read FAULT_AT=1 \
        FAULT_DO=EIO run bisque-bake --device cuda --size 16 --maps mask vase.nvdb low.obj -o x.exr
    refused_like 69 "^$p CUDA cannot be used: the answer of .*bisque-devices: Input/output error$"
fi
mkdir -p moved/bin moved/lib/bisque
cp "$BIN/bisque-bake" moved/bin
BIN=$PWD/moved/bin
places="$PWD/moved/bin, $PWD/moved/lib/bisque or "
bake --device cuda --size 16 --maps mask vase.nvdb low.obj -o x.exr
code 69
grep -Fq "$p CUDA devices need the program bisque-devices, which is not in $places" "$err"
check "a missing bisque-devices is named" $?
bake --device auto --size 16 --maps mask vase.nvdb low.obj -o mask.exr
code 0
grep -Fq "$p warning: OpenCL devices need the program bisque-devices, which is not in $places" "$err"
check "without bisque-devices, the processor bakes" $?
{ printf '#!/bin/sh\nprintf 99.0.0\n'; echo 'head -c 2000 /dev/zero'; } >moved/lib/bisque/bisque-devices
chmod +x moved/lib/bisque/bisque-devices
bake --device cuda --size 16 --maps mask vase.nvdb low.obj -o x.exr
code 69
grep -q "^$p CUDA cannot be used: $PWD/moved/lib/bisque/bisque-devices is of version 99\.0\.0, this program is of [0-9.]*$" "$err"
check "a bisque-devices of another version is refused" $?

finish

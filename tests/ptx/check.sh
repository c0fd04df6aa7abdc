#!/bin/sh
# Checks the kernel's PTX with NVIDIA's assemblers, and the declarations in cuda_api.h with NVIDIA's
# headers, of two versions of CUDA. No GPU is needed.
#
#   check.sh TOOLS PTX...    TOOLS: a directory of virtual environments, each with the packages of
#                            one version (see check-ptx in the Makefile); PTX: the kernel, and
#                            then the same one from other compilers
#
# For each of the architectures below that an assembler knows:
#  - the PTX becomes machine code within the limits below;
#  - with all divisions and roots replaced by other instructions, the machine code has no fused
#    operation, no flushed denormal and no approximation. So only the assembler's own code for
#    divisions and roots has them, which rounds correctly (NVIDIA, "PTX ISA", div.rn and sqrt.rn).
set -u
cd "$(dirname "$0")/../.." || exit 1
tools=$1
shift
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

# The others differ from these in a digit.
architectures="50 60 70 75 80 86 89 90 100 120"
# PTX from other compilers than the usual one, for some of them.
some=" 75 120 "
# Limits for each architecture, in bytes, with as many registers as cuda.c asks for. The
# kernel needs at most 596 bytes of spills, a stack of 560 bytes and 171 KB of code.
registers=128 spill=608 stack=576 code=196608

# assemble PTXAS NAME SM PTX: assembles, and prints "ok" or "not ok".
assemble()
{
    cubin=$work/$2.sm_$3.cubin
    if ! "$1" -arch="sm_$3" -maxrregcount=$registers -v "$4" -o "$cubin" >"$cubin.log" 2>&1; then
        echo "not ok - $2 for sm_$3 assembles: $(grep -v info "$cubin.log" | head -n 1)"
        return
    fi
    text=$(readelf -SW "$cubin" 2>/dev/null |
        awk '{ for (i = 1; i < NF; i++) if ($i == ".text.bake_patch") print $(i + 4) }')
    awk -v name="$2 for sm_$3" -v text="$((0x${text:-fffffff}))" -v registers=$registers \
        -v spill=$spill -v stack=$stack -v code=$code '
        { gsub(",", " ") }
        / bytes stack frame/ {
            for (i = 2; i < NF; i++) {
                if ($(i + 1) == "stack") frame = $(i - 1)
                if ($(i + 1) == "spill" && $(i - 1) > spilled) spilled = $(i - 1)
            }
        }
        / Used / { for (i = 1; i < NF; i++) if ($i == "Used") used = $(i + 1) }
        END {
            fine = used && used <= registers && spilled <= spill && frame <= stack && text <= code
            printf "%s - %s: %d registers, %d bytes spilled, %d of stack, %d of code\n",
                   fine ? "ok" : "not ok", name, used, spilled, frame, text
        }' "$cubin.log"
}

# disassemble NVDISASM NAME SM: checks machine code without divisions and roots.
disassemble()
{
    cubin=$work/$2.sm_$3.undivided
    if ! "$1" -c "$cubin" >"$cubin.sass" 2>"$cubin.log"; then
        echo "not ok - $2 for sm_$3 is disassembled: $(head -n 1 "$cubin.log")"
        return
    fi
    # HFMA2 of -RZ and RZ moves a constant.
    bad=$(grep -E '\b(FFMA|DFMA|HFMA)|\.FTZ|MUFU' "$cubin.sass" |
        grep -Ev 'HFMA2[.A-Z]* R[0-9]+, -RZ, RZ, ' | head -n 1)
    if grep -q FMUL "$cubin.sass" && [ -z "$bad" ]; then
        echo "ok - $2 for sm_$3 fuses, flushes and approximates nothing"
    else
        echo "not ok - $2 for sm_$3 fuses, flushes or approximates: $bad"
    fi
}

# declarations CUDA_H NAME: compares cuda_api.h with NVIDIA's header: values and types.
declarations()
{
    api=libbake/device/cuda/cuda_api.h
    {
        echo '#define __CUDA_API_VERSION_INTERNAL /* declares symbols of older versions too */'
        echo '#include <cuda.h>'
        sed -En 's/^ *(CU[A-Z_0-9]*) = ([0-9]+).*/_Static_assert(\1 == \2, "\1");/p' $api
        sed -n '/^#define BAKE_CUDA_FUNCTIONS/,/[^\\]$/p' $api
        echo '#define SAME(name, symbol, parameters) CUresult (*our_##symbol) parameters = symbol;'
        echo 'BAKE_CUDA_FUNCTIONS(SAME)'
    } >"$work/$2.c"
    if ! grep -q CU_JIT_MAX_REGISTERS "$work/$2.c" || ! grep -q cuLaunchKernel "$work/$2.c"; then
        echo "not ok - $2: the declarations were not found"
    elif cc -std=c11 -Werror -fsyntax-only -I "$(dirname "$1")" "$work/$2.c" 2>"$work/log"; then
        echo "ok - cuda_api.h agrees with cuda.h of $2"
    else
        echo "not ok - cuda_api.h differs from cuda.h of $2: $(grep -m 1 error "$work/log")"
    fi
}

# check_version CUDA PTX...: checks all that depends on one version of CUDA.
check_version()
{
    cuda=$1
    shift
    ptxas=$(find -L "$tools/$cuda" -name ptxas -type f | head -n 1)
    nvdisasm=$(find -L "$tools" -name nvdisasm -type f | head -n 1)
    declarations "$(find -L "$tools/$cuda" -name cuda.h | head -n 1)" "$cuda"
    for sm in $architectures; do
        "$ptxas" --help | grep -q "'sm_$sm'" || continue
        for ptx; do
            name=$(basename "$ptx" .ptx)
            [ "$ptx" = "$1" ] || [ "${some#* $sm }" != "$some" ] || continue
            [ "$sm" -ge "$(sed -n 's/^\.target sm_\([0-9]*\).*/\1/p' "$ptx")" ] || continue
            assemble "$ptxas" "$name.$cuda" "$sm" "$ptx"
            [ "$sm" -ge 75 ] || continue # nvdisasm knows no earlier ones
            "$ptxas" -arch="sm_$sm" -maxrregcount=$registers "$work/$name.ptx" \
                -o "$work/$name.$cuda.sm_$sm.undivided"
            disassemble "$nvdisasm" "$name.$cuda" "$sm"
        done
    done
}

for ptx; do
    name=$(basename "$ptx" .ptx)
    sed -E 's/div\.rn\.f(32|64)/add.rn.f\1/; s/(sqrt|rcp)\.rn\.f(32|64)/abs.f\2/' "$ptx" >"$work/$name.ptx"
    if awk -f libbake/kernel/check_ptx.awk "$ptx"; then
        echo "ok - $name rounds as the processor does"
    else
        echo "not ok - $name rounds as the processor does"
    fi
done >"$work/results"
for cuda in $(ls "$tools"); do
    check_version "$cuda" "$@" >"$work/results.$cuda" 2>&1 &
done
wait
cat "$work"/results*
passed=$(cat "$work"/results* | grep -c '^ok')
failed=$(cat "$work"/results* | grep -vc '^ok')
echo "$passed passed, $failed failed"
[ "$passed" -gt 20 ] && [ "$failed" -eq 0 ]

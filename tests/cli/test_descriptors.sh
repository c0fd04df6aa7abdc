#!/bin/sh
# test_descriptors.sh - programs that start with standard descriptors closed, as some daemons and
# schedulers start them. Outputs have the same bytes, and no message gets into a file.
. "$(dirname "$0")/lib.sh"

# A scan with warnings about its material library, a texture, its colours and its precision.
awk 'BEGIN { print "P3 256 256 255"
     for (y = 0; y < 256; y++) for (x = 0; x < 256; x++) print x, 255 - y, 128 }' >ramp.ppm
printf 'newmtl glaze\nKd red\nmap_Kd ramp.ppm\nnewmtl lost\nmap_Kd lost.png\n' >scan.mtl
"$TESTS/generate-scan" -n 3000 --uvs --offset 4e6,0,0 vase -o vase.obj
{
    printf 'mtllib scan.mtl\nusemtl glaze\n'
    cat vase.obj
    printf 'usemtl lost\nf 1/1 2/2 3/3\n'
} >scan.obj
"$TESTS/generate-scan" --offset 4e6,0,0 vase-low -o low.obj

# Warnings, without reports of progress, the time, and that the report cannot be printed.
warnings()
{
    grep -v '^{\|^time:\|: standard output: Bad file descriptor$' "$err"
}

# all_combinations OUTPUT... -- PROGRAM ARGUMENT...: runs a job with every combination of closed
# descriptors, and with many lines for standard error; all_closed: with all of them closed. A report
# that cannot be printed is exit code 74, else the code is 0.
all_combinations()
{
    combinations='<&- >&- 2>&-'
    sanitized || combinations="<&-,>&-,2>&-,<&- >&-,<&- 2>&-,>&- 2>&-,$combinations"
    closed "$@"
}
all_closed()
{
    combinations='<&- >&- 2>&-'
    closed "$@"
}
closed()
{
    outputs=
    while [ "$1" != -- ]; do
        outputs="$outputs $1"
        shift
    done
    shift
    ok run "$@"
    [ -z "$outputs" ] || sha256sum $outputs >whole.txt
    [ -s "$err" ] || [ -z "$outputs" ] || [ "$1" = bisque-compare ]
    check "writes to standard error: $*" $?
    warnings >warnings.txt
    while [ -n "$combinations" ]; do
        closing=${combinations%%,*}
        combinations=${combinations#"$closing"}
        combinations=${combinations#,}
        rm -f $outputs
        command="$* $closing" code=0 expected=0
        program=$1
        : >"$out" >"$err"
        eval 'shift; "$BIN/$program" "$@"' '>"$out" 2>"$err"' "$closing" || code=$?
        set -- "$program" "$@"
        case $closing in
        '<&-' | '2>&-' | '<&- 2>&-') ;;
        *) expected=74 ;;
        esac
        holds "exit code $expected: $command" [ "$code" -eq $expected ]
        [ -z "$outputs" ] || sha256sum --quiet -c whole.txt >/dev/null 2>&1
        check "the same outputs: $command" $?
        case $closing in
        *'2>&-') [ ! -s "$err" ] ;;
        *) warnings | cmp -s - warnings.txt ;;
        esac
        check "the same warnings: $command" $?
        for output in $outputs; do
            case $output in
            *.tris | *.nvdb)
                ok run bisque-voxelize --verify "$output"
                ;;
            esac
        done
    done
    rm -f whole.txt warnings.txt
}

grid="scan.obj -o a.nvdb --resolution 32 --threads 2 --progress json"
all_combinations a.nvdb a.tris -- bisque-voxelize $grid
# The image does not fit into its cache, and goes to a temporary tiled file.
{
    echo 'P6 2048 2048 255'
    yes ABCDEFGHIJKL | head -c 12582912
} >large.ppm
all_closed a.nvdb a.vdb -- bisque-voxelize $grid --no-tris --texture large.ppm --memory 64M --vdb a.vdb --json
rm large.ppm
all_closed -- bisque-voxelize --parse-only scan.obj
ok run bisque-voxelize scan.obj -o scan.nvdb --resolution 32
all_closed -- bisque-voxelize --verify scan.tris scan.nvdb

maps="low.obj --device cpu --size 32 --samples 1 --threads 2 --progress json"
all_combinations a_normal.exr a_color.exr a.png -- bisque-bake scan.nvdb $maps --preview a.png -o 'a_<MAP>.exr'
all_closed a_normal.png a_mask.png -- bisque-bake scan.tris $maps --maps normal,mask --json -o 'a_<MAP>.png'
all_closed -- bisque-bake --list devices

run bisque-bake scan.nvdb $maps --maps normal -o grid.exr
run bisque-bake scan.tris $maps --maps normal -o exact.exr
all_combinations heat.png -- bisque-compare grid.exr exact.exr --progress json --heatmap heat.png
all_closed -- bisque-compare --version

finish

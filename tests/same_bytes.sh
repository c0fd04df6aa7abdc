#!/bin/sh
# Compares the outputs of two builds byte for byte, for changes that must not change results:
#
#   tests/same_bytes.sh OLD_BUILD NEW_BUILD [SCAN.obj LOW.obj [TEXTURE]]...
#
# OLD_BUILD and NEW_BUILD are build directories such as build/release. Both builds process the
# same generated scans, and any scans given as arguments, with different attributes, budgets and
# thread counts. Prints a line for each file that differs and exits with 1 if there is one.
set -u
LC_ALL=C
export LC_ALL
old=$(cd "${1:?is the old build directory}" && pwd) || exit 2
new=$(cd "${2:?is the new build directory}" && pwd) || exit 2
shift 2
start=$PWD
work=$(mktemp -d /tmp/bisque-same.XXXXXX) || exit 2
trap 'rm -rf "$work"' EXIT
trap 'exit 2' INT TERM HUP
gen=$old/tests/generate-scan
files=0 bad=0

# absolute FILE
absolute()
{
    case $1 in /*) echo "$1" ;; *) echo "$start/$1" ;; esac
}

# both NAME SCAN LOW [OPTION...]: sorts, voxelizes and bakes with each build, and compares.
both()
{
    name=$1 scan=$2 low=$3
    shift 3
    for build in old new; do
        mkdir "$work/$build" && cd "$work/$build" || exit 2
        eval "bin=\$$build/bin"
        {
            "$bin/bisque-voxelize" "$scan" -o s.nvdb --resolution 300 --vdb s.vdb "$@"
            "$bin/bisque-voxelize" s.tris -o fine.nvdb --resolution 900
            for surface in nvdb tris; do
                "$bin/bisque-bake" s.$surface "$low" -o "${surface}_<MAP>.exr" --size 300x200 --device cpu \
                    --maps normal,mask --preview $surface.png
                "$bin/bisque-bake" s.$surface "$low" -o "${surface}_<MAP>.png" --size 128 --device cpu --type 8
                "$bin/bisque-bake" s.$surface "$low" -o "${surface}_object_<MAP>.exr" --size 128 --device cpu \
                    --normal space=object --type float --samples 3
            done
            "$bin/bisque-bake" s.nvdb "$low" -o "opencl_<MAP>.exr" --size 128 --device opencl
            "$bin/bisque-compare" nvdb_normal.exr tris_normal.exr >comparison.txt
        } >../$build.out 2>../$build.err
    done
    cd "$work" || exit 2
    for file in old/*; do
        files=$((files + 1))
        # OpenVDB puts a random number into each file.
        [ "$file" = old/s.vdb ] && continue
        cmp -s "$file" "new/${file#old/}" || { echo "differs: $name: ${file#old/}"; bad=$((bad + 1)); }
    done
    [ "$(ls old)" = "$(ls new)" ] || { echo "other files: $name: $(ls old) | $(ls new)"; bad=$((bad + 1)); }
    [ -s old/comparison.txt ] || { echo "did not work: $name:"; cat old.err; bad=$((bad + 1)); }
    rm -rf old new
}

"$gen" vase-low -o "$work/low.obj"
"$gen" -n 60000 -c vase -o "$work/color.obj"
"$gen" -n 400000 --normals --uvs vase -o "$work/attributes.obj"
"$gen" -n 3000000 vase -o "$work/large.obj"
"$gen" -n 1000000 --shuffle 7 --corners 4 -c vase -o "$work/quads.obj"
"$gen" -n 200000 --corners 12 --shuffle 3 --offset 500000,0,4000000 vase -o "$work/far.obj"
both color "$work/color.obj" "$work/low.obj"
both attributes "$work/attributes.obj" "$work/low.obj" --threads 1
both flat "$work/color.obj" "$work/low.obj" --scan-normals flat
both large "$work/large.obj" "$work/low.obj"
both "large, 64M" "$work/large.obj" "$work/low.obj" --memory 64M
both "quads, shuffled" "$work/quads.obj" "$work/low.obj" --memory 128M
"$gen" --offset 500000,0,4000000 vase-low -o "$work/far_low.obj"
both "polygons, far away" "$work/far.obj" "$work/far_low.obj" --memory 64M
while [ $# -ge 2 ]; do
    scan=$(absolute "$1") low=$(absolute "$2")
    shift 2
    case ${1-} in
    *.png | *.jpg)
        both "$scan" "$scan" "$low" --texture "$(absolute "$1")"
        shift
        ;;
    *) both "$scan" "$scan" "$low" ;;
    esac
done
[ $bad -eq 0 ] && echo "same bytes: $files files"
[ $bad -eq 0 ]

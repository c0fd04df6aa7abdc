#!/bin/bash
# pace.sh REFERENCE [PAIRS] - does the core run as fast as it did at another commit?
#
# Builds the commit REFERENCE in build/pace and runs each job with the programs of that commit and
# with those of this tree, in turns, PAIRS times (5). Prints the median user time of both, in
# seconds, and their ratio. Exits with 1 if a ratio is above LIMIT (1.03).
# JOBS lists the jobs, TRIANGLES sets the size of the scan (10000000). Run nothing else meanwhile.
set -eu
reference=$(git rev-parse --short "$1") pairs=${2:-5}
new=$(realpath "$BIN") scan_of=$(realpath "$TESTS")/generate-scan
triangles=${TRIANGLES:-10000000} limit=${LIMIT:-1.03}
folder=$(pwd)/build/pace old=$(pwd)/build/pace/$reference/build/release/bin
mkdir -p "$folder"
cd "$folder"
if [ ! -x "$old/bisque-bake" ]; then
    rm -rf "$reference"
    git clone -q ../.. "$reference"
    git -C "$reference" checkout -q "$reference"
    make -C "$reference" -s -j"$(nproc)" >&2
fi
[ -s low.obj ] || "$scan_of" vase-low -o low.obj >/dev/null
[ -s "$triangles.obj" ] || {
    "$scan_of" --triangles "$triangles" vase -o part.obj >/dev/null
    mv part.obj "$triangles.obj"
}

# job NAME FOLDER WHO: runs a job with the programs in FOLDER.
job()
{
    local voxelize=$2/bisque-voxelize bake=$2/bisque-bake maps="x_<MAP>.exr --maps normal --size 2048"
    case $1 in
    parse) "$voxelize" --parse-only "$triangles.obj" ;;
    whole) "$voxelize" "$triangles.obj" -o "$3.nvdb" --memory 512M ;;
    small) "$voxelize" "$triangles.obj" -o x.nvdb --memory 64M ;;
    voxelize) "$voxelize" "$3.tris" -o x.nvdb --memory 256M ;;
    grid) "$bake" "$3.nvdb" low.obj --device cpu -o $maps ;;
    exact) "$bake" "$3.tris" low.obj --memory 512M -o $maps ;;
    esac >job.log 2>&1 || { cat job.log >&2; exit 70; }
}
median()
{
    sort -n "$1" | sed -n "$(((pairs + 1) / 2))p"
}

job whole "$old" old
job whole "$new" new
status=0
TIMEFORMAT=%U
echo "user seconds, median of $pairs pairs, $triangles triangles, reference $reference"
printf '%-10s %10s %10s %6s\n' job reference this ratio
for name in ${JOBS:-parse whole small voxelize grid exact}; do
    : >old.times
    : >new.times
    for ((i = 0; i < pairs; i++)); do
        { time job "$name" "$old" old; } 2>>old.times
        { time job "$name" "$new" new; } 2>>new.times
    done
    awk -v name="$name" -v a="$(median old.times)" -v b="$(median new.times)" -v limit="$limit" 'BEGIN {
        printf "%-10s %10.2f %10.2f %6.2f\n", name, a, b, b / a
        exit b / a > limit
    }' || status=1
done
exit $status

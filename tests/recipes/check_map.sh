#!/bin/sh
# check_map.sh - a map that was added as libbake/maps/README.md says, with the code shown
# there, in a copy of the sources: it comes from grids and from triangles, on all devices here.
# It compiles much of libbake, so only make check-long runs it.
. "$(dirname "$0")/../cli/lib.sh"

# add FIRST LAST FILE LINE: puts the lines of the README from one that has FIRST to one that has LAST
# before the first line of the copy's FILE that has LINE.
add()
{
    awk -v first="$1" -v last="$2" '$0 ~ first { on = 1 } on; $0 ~ last { on = 0 }' \
        "$top/libbake/maps/README.md" >code.txt
    awk -v line="$4" '!done && index($0, line) {
            while ((getline code <"code.txt") > 0) print code
            done = 1
        }
        { print }' "copy/$3" >changed
    holds "$3 takes the recipe's code" [ "$(wc -l <changed)" -gt "$(wc -l <"copy/$3")" ]
    cp changed "copy/$3"
}

git -C "$top" ls-files -z ':!tests/meshes' >files
mkdir -p copy/build
(cd "$top" && xargs -0 cp -p --parents -t "$work/here/copy") <files
cp -pr "$(dirname "$BIN")" copy/build/release

maps=libbake/kernel/bk_maps.h table=libbake/maps/map_table.c
command=make code=0
: >"$out" >"$err"
add 'X.objectnormal' 'X.objectnormal' $maps '    X(guide,'
add 'void bk_add_objectnormal' '^ *}$' $maps 'BK_FN void bk_add_guide('
add 'static void encode_directions' '^ *}$' $table 'const struct bake_map_row bake_map_table[]'
add '[[]BK_MAP_objectnormal' '},$' $table '[BK_MAP_guide]'
make -s -C copy -j2 build/release/bin/bisque-bake >"$out" 2>"$err" || code=$?
check 'the sources with the new map compile' $code

"$TESTS/generate-scan" -n 20000 vase -o scan.obj >"$out" || exit 1
"$TESTS/generate-scan" vase-low -o low.obj >"$out" || exit 1
ok run bisque-voxelize --resolution 256 scan.obj -o scan.nvdb
BIN=$work/here/copy/build/release/bin
for device in cpu opencl; do
    ok run bisque-bake --maps objectnormal --size 128 --device $device scan.nvdb low.obj -o $device.exr
done
holds 'the same bytes on the processor and by OpenCL' cmp cpu.exr opencl.exr
ok run bisque-bake --maps objectnormal --size 128 scan.tris low.obj -o exact.exr
ok run bisque-bake --maps normal --normal space=object --size 128 scan.nvdb low.obj -o normal.exr
ok run bisque-bake --help
holds 'the help has its summary' grep -q 'objectnormal *normals in object space' "$out"
ok run bisque-compare --type normal --max-mean 3 cpu.exr exact.exr
ok run bisque-compare --type normal --force --max-error 0.001 cpu.exr normal.exr
finish

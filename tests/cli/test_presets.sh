#!/bin/sh
# test_presets.sh - packed maps, presets, quality, folders as outputs, and what is said of long bakes.
. "$(dirname "$0")/lib.sh"
need_oracle
. "$top/tests/cli/texture_lib.sh"
bake="run bisque-bake --size 32 --rays ao=4"
p=bisque-bake:
ok run bisque-voxelize --resolution 40 plane.obj --channels roughness=ramp.png,metallic=slope.png \
    -o scan.nvdb
ok run bisque-voxelize --resolution 40 bare.obj -o bare.nvdb

# packed FILE TYPE WORD...: the channels of a file are those maps, baked alone with this type. The
# reader of OpenEXR files lists channels by name: A, B, G, R.
packed()
{
    file=$1
    shift
    python3 - "$file" "$@" <<'PYTHON'
import sys
import png
_, _, most, rows = png.read(sys.argv[1])
for channel, word in enumerate(sys.argv[2:]):
    if word in "01":
        expected = lambda x, y: int(word) * most
    else:
        inverted = word.startswith("1-")
        _, _, single, map = png.read("alone_%s.png" % word.replace("1-", ""))
        assert single == most
        expected = lambda x, y: most - map[y][x][0] if inverted else map[y][x][0]
    for y, row in enumerate(rows):
        for x, texel in enumerate(row):
            assert abs(texel[channel] - expected(x, y)) <= 1, (word, x, y, texel, expected(x, y))
PYTHON
    check "$file has the maps $*" $?
}
PYTHONPATH=$top/tests/cli
export PYTHONPATH

# ---- packs ----

ok $bake scan.nvdb low.obj --maps ao,mask,transfer:roughness,transfer:metallic -o 'alone_<MAP>.png' --type 16
rm -f packed_*
ok $bake scan.nvdb low.obj --pack orm=ao,roughness,metallic --maps mask -o 'packed_<MAP>.png' --type 16 --json
json '.maps | keys == ["mask", "orm"]'
packed packed_orm.png ao roughness metallic
holds "what is packed has no file of its own" [ ! -e packed_ao.png ]
ok $bake scan.nvdb low.obj --pack x=mask,0,1-roughness --pack y=1,ao -o 'packed_<MAP>.png' --type 16
packed packed_x.png mask 0 1-roughness
packed packed_y.png 1 ao 0
holds "without --maps, the default maps are baked too" [ -e packed_normal.png ]
in_parts 3 $bake scan.nvdb low.obj --pack orm=ao,roughness,metallic --maps mask -o 'task_<MAP>.png' --type 16
ok $bake scan.nvdb low.obj --pack orm=ao,roughness,metallic --maps mask -o 'packed_<MAP>.png' --type 16
same task_orm.png packed_orm.png
ok $bake scan.nvdb low.obj --pack m=metallic,ao,0,1-roughness -o 'packed_<MAP>.exr'
holds "an OpenEXR file says what is packed" grep -aq 'bisque:pack.*metallic,ao,0,1-roughness' packed_m.exr
for bad in orm= orm=ao,,mask =ao orm orm=normal,ao ORM=ao normal=ao,mask a=ao,ao,ao,ao,ao; do
    $bake scan.nvdb low.obj --pack "$bad" -o 'bad_<MAP>.png'
    refused_like 64 "^$p --pack"
done

# ---- presets ----

mkdir maps
ok $bake scan.nvdb low.obj --preset unreal -o maps/ --json
json '.maps == {"normal": "maps/T_low_N.png", "color": "maps/T_low_BC.png", "orm": "maps/T_low_ORM.png"}
    or .maps == {"normal": "maps/T_low_N.png", "orm": "maps/T_low_ORM.png"}'
# Real values have 16 bits, others 8; names are those of the engine, or their own.
for preset in "unity Normal" "gltf normal"; do
    # shellcheck disable=SC2086
    set -- $preset
    ok $bake scan.nvdb low.obj --preset "$1" -o maps/ --maps normal,height,curvature --json
    depth() { od -An -tu1 -j24 -N1 "$1" | tr -d ' '; }
    holds "$1: normals have 8 bits" [ "$(depth "maps/low_$2.png")" = 8 ]
    holds "$1: heights have 16 bits" [ "$(depth "$(jq -r .maps.height "$out")")" = 16 ]
    holds "$1: curvature has 16 bits" [ "$(depth maps/low_curvature.png)" = 16 ]
done
ok $bake scan.nvdb low.obj --preset unity -o 'unity_<MAP>.png' --maps mask
ok $bake scan.nvdb low.obj --maps ao,transfer:roughness,transfer:metallic -o 'alone_<MAP>.png' --type 8
packed unity_mask_map.png metallic ao 0 1-roughness
ok $bake scan.nvdb low.obj --preset gltf --normal green=down --maps normal -o 'down_<MAP>.png'
ok $bake scan.nvdb low.obj --preset unreal --maps normal -o 'unreal_<MAP>.png'
ok $bake scan.nvdb low.obj --preset gltf --maps normal -o 'gltf_<MAP>.png'
same down_normal.png unreal_normal.png
holds "presets differ in the green channel" sh -c '! cmp -s gltf_normal.png unreal_normal.png'
ok $bake scan.nvdb low.obj --preset blender -o maps
holds "Blender gets OpenEXR files" [ -e maps/low_normal.exr -a ! -e maps/low_orm.exr ]
run bisque-bake scan.nvdb low.obj --maps basecolor -o none.png
refused 65 "$p scan.nvdb has no colour; leave color out of --maps"
# What a scan does not have is a constant: rough, and no metal.
ok $bake bare.nvdb low.obj --preset gltf -o 'bare_<MAP>.png'
grep -q "warning: --preset: the scan has no roughness: the packed map has 1 there" "$err"
check "a warning of a channel that the scan lacks" $?
ok $bake bare.nvdb low.obj --maps ao -o 'alone_<MAP>.png' --type 8
packed bare_orm.png ao 1 0
$bake bare.nvdb low.obj --preset gltf -o 'bare_<MAP>.png' --strict
code 65

# ---- folders and sizes ----

$bake scan.nvdb low.obj -o missing/folder/
refused 73 "$p missing/folder/: No such file or directory"
ok $bake scan.nvdb low.obj --maps mask -o new/
holds "a folder is made" [ -e new/low_mask.exr ]
$bake scan.nvdb low.obj --maps transfer:nothing -o empty/
code 65
holds "a folder that stays empty goes" [ ! -e empty ]
cp low.obj second.obj
ok $bake scan.nvdb low.obj second.obj -o maps/ --maps mask --json
json '[.tiles[].maps.mask] | sort == ["maps/low_mask.exr", "maps/second_mask.exr"]'
cp low.obj '<MAP>.obj'
ok $bake scan.nvdb '<MAP>.obj' -o maps/ --maps mask --json
json '.tiles[0].maps.mask == "maps/_MAP__mask.exr"'
ok $bake scan.nvdb '<MAP>.obj' --preset unreal -o maps/ --maps mask --json
json '.tiles[0].maps.mask == "maps/T__MAP__mask.png"'
ok run bisque-bake --list tiles low.obj --size 4k --json
json '.tiles[0].width == 4096'
ok run bisque-bake --list tiles low.obj --size 1Kx512 --json
json '.tiles[0].width == 1024 and .tiles[0].height == 512'
for size in 1025k k 4kK 4kk 99999999999k; do
    run bisque-bake scan.nvdb low.obj -o x.exr --size $size
    code 64
done

# ---- quality ----

ok run bisque-bake scan.nvdb low.obj --size 32 --maps ao --quality draft -o draft.exr --json
json '.samples_per_axis == 1'
ok run bisque-bake scan.nvdb low.obj --size 32 --maps ao --samples 1 --rays ao=4,filter=surface -o same.exr
ok run bisque-compare draft.exr same.exr --max-error 0
ok run bisque-bake scan.nvdb low.obj --size 32 --maps ao --quality draft --samples 3 -o draft.exr --json
json '.samples_per_axis == 3'
# Only a draft is filtered.
ok run bisque-bake scan.nvdb low.obj --size 32 --maps ao --quality final --rays ao=16 -o final.exr
ok run bisque-bake scan.nvdb low.obj --size 32 --maps ao --samples 4 --rays ao=16,filter=none -o same.exr
ok run bisque-compare final.exr same.exr --max-error 0

# ---- what is said of long bakes ----

# A clock that runs so fast that a bake of a millisecond takes hours.
fast()
{
    FAULT_UNDER=$PWD FAULT_SPEED=10000000 LD_PRELOAD=$TESTS/faults.so run "$@"
}
if sanitized; then
    skip "lines of a log" "sanitizers want to be loaded first"
else
    ok fast bisque-bake scan.nvdb low.obj --size 256 --maps ao --threads 1 --device cpu -o long.exr
    grep -Eq "^$p tracing: [0-9]+ %" "$err"
    check "a line now and then without a terminal" $?
    ok fast bisque-simplify low.obj -o all.ply --triangles 1000000
    holds "a line without a share has a unit" grep -qx "bisque-simplify: collapsing edges: 0 triangles" "$err"
    ok fast bisque-bake scan.nvdb low.obj --size 256 --maps ao --threads 1 --device cpu -o long.exr --progress none
    holds "and none if none is asked for" [ ! -s "$err" ]
fi
at_look 1 TERM tracing bisque-bake scan.nvdb low.obj --size 4k --samples 8 --rays ao=512 --threads 1 \
    --maps ao -o long.exr
stopped
grep -Eq "^$p [0-9,]+ rays, about [0-9]+:[0-9][0-9] with 1 thread$" "$err"
check "the work that is expected" $?
finish

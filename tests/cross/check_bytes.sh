#!/bin/sh
# check_bytes.sh - programs for another processor write the bytes of this machine's programs. NATIVE
# is the folder of those.
native=$(cd "${NATIVE:?is the directory with programs for this machine}" && pwd) || exit 1
. "$(dirname "$0")/../cli/lib.sh"

# both NAME SCAN LOW OPTION...: sorts, voxelizes, simplifies and bakes with both.
both()
{
    scan=$2 low=$3
    own=$BIN
    for BIN in "$native" "$own"; do
        to=$1.other
        [ "$BIN" = "$own" ] || to=$1
        mkdir "$to"
        (shift 3 && run bisque-voxelize "$scan" -o "$to/s.nvdb" --resolution 150 "$@" && code 0) || exit
        ok run bisque-simplify "$to/s.tris" -o "$to/simple.obj" --triangles 500
        for surface in nvdb tris; do
            ok run bisque-bake "$to/s.$surface" "$low" -o "$to/${surface}_<MAP>.exr" --size 96x64 --device cpu \
                --maps all --samples 2 --rays ao=16 --rays thickness=16
            ok run bisque-bake "$to/s.$surface" "$low" -o "$to/${surface}_<MAP>.png" --size 100 --device cpu --type 8 \
                --maps normal,height --normal space=object
        done
    done
    BIN=$own
    for file in "$1"/*; do
        same "$file" "$1.other/${file##*/}"
    done
    holds "both wrote their files" [ "$(ls "$1")" = "$(ls "$1.other")" ]
}

gen=$native/../tests/generate-scan
"$gen" vase-low -o low.obj
"$gen" -n 20000 -c vase -o color.obj
"$gen" -n 20000 --normals --uvs vase -o attributes.obj
"$gen" -n 30000 --corners 12 --shuffle 3 --offset 500000,0,4000000 vase -o far.obj
"$gen" --offset 500000,0,4000000 vase-low -o far_low.obj
both color color.obj low.obj
both attributes attributes.obj low.obj --channels all
both flat color.obj low.obj --scan-normals flat
both "polygons, far away" far.obj far_low.obj --memory 64M
finish

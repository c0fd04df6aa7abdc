#!/bin/sh
# test_gltf_materials.sh - factors, vertex colours and wrap modes of glTF files, as viewers show them.
. "$(dirname "$0")/lib.sh"
squares="python3 $top/tests/cli/gltf_materials.py"
channels=roughness,metallic,occlusion

# values NAME TOLERANCE: the maps NAME.<map>.png have the values of the specification.
values()
{
    command="$squares check $*"
    holds "the maps $1 are what viewers show" $squares check "$@"
}

$squares make || exit 1
ok run bisque-voxelize squares.gltf --channels $channels,normal_map --resolution 1200 -o scan.nvdb
holds "nothing is lost" [ ! -s "$err" ]
for scan in scan.tris scan.nvdb; do
    ok run bisque-bake $scan low.obj --size 576x96 -o "$scan.<MAP>.png" \
        --maps normal,color,transfer:roughness,transfer:metallic,transfer:occlusion
    for map in roughness metallic occlusion; do
        [ -f $scan.$map.png ] || mv "$scan.transfer_$map.png" $scan.$map.png
    done
done
values scan.tris 0.004
values scan.nvdb 0.01
# Blender's reader and Cycles show the same (make check-long).
if [ "${LONG:-0}" -eq 0 ]; then
    :
elif "${BPY:-python3}" -c 'import bpy' 2>/dev/null; then
    command=gltf_blender.py
    "${BPY:-python3}" "$top/tests/cli/gltf_blender.py" "$PWD/squares.gltf" blender 576 96 >"$out" 2>"$err"
    check "Blender renders the squares" $?
    values blender 0.002 color roughness metallic normal
else
    skip "Blender's pictures" "there is no Python with the module bpy (set BPY)"
fi
finish

#!/bin/sh
# test_glb.sh - the low-poly mesh and its maps as a GLB file, read from the specification alone.
. "$(dirname "$0")/lib.sh"
p=bisque-bake:
PYTHONPATH=$top/tests/cli
export PYTHONPATH
glb="python3 $top/tests/cli/glb.py"

# is NAME ARGUMENT...: a check of glb.py.
is()
{
    name=$1
    shift
    command="$glb $*"
    holds "$name" $glb "$@"
}

$glb make || exit 1
printf 'mtllib waves.mtl\nusemtl wave\n' | cat - waves.obj >scan.obj
printf 'newmtl wave\nPr 0.25\nPm 0.75\nKe 0.5 2 4\nd 0.25\n' >waves.mtl
ok run bisque-voxelize scan.obj --channels all --resolution 200 -o scan.nvdb
bake="run bisque-bake scan.tris low.obj --size 128 --ray-directions face"
all="--maps normal,color,ao,transfer:roughness,transfer:metallic --rays ao=4"

# Shaded as glTF says, the file shows the scan's normals. 8 bits alone give 0.2 degrees.
ok $bake $all --type float -o 'a_<MAP>.exr' --glb a.glb
out_like '^a.glb: low-poly mesh with its maps$'
is "normals of the scan, with a mirrored chart and a hard edge" check a.glb 1
ok $bake $all --type 8 -o 'b_<MAP>.png' --glb b.glb --json
json '.glb_path == "b.glb"'
for map in normal:normal:1 color:color:0 ao:occlusion:1 roughness:roughness:1 metallic:metallic:1; do
    file=b_${map%%:*}.png texture=${map#*:}
    [ -f $file ] || file=b_transfer_${map%%:*}.png
    is "$texture is that of the map" same b.glb ${texture%:*} $file ${texture#*:}
done
# Green is up in the file, whatever the map has; bytes do not depend on threads and memory.
ok $bake $all --normal green=down -o 'c_<MAP>.png' --glb c.glb
is "green points up" check c.glb 1
for limits in '--threads 1' '--threads 5 --memory 64M'; do
    ok $bake $all $limits --type float -o 'd_<MAP>.exr' --glb d.glb
    same a.glb d.glb
done
# What is not baked is not in the file.
ok $bake --maps color -o color.exr --glb color.glb
holds "no texture but that of the colour" python3 -c '
import json, struct
data = open("color.glb", "rb").read()
root = json.loads(data[20:20 + struct.unpack_from("<I", data, 12)[0]])
assert len(root["images"]) == 1 and "normalTexture" not in root["materials"][0]
assert root["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0'

# Light above 1 has a factor; opacity is the alpha of the colour, or of white.
materials='
import glb, sys
document, binary = glb.read(sys.argv[1])
material, = document["materials"]
print(*(material.get(key) for key in ("alphaMode", "doubleSided", "emissiveFactor", "extensions")))
for texture in (material["pbrMetallicRoughness"].get("baseColorTexture"), material.get("emissiveTexture")):
    row = glb.image(document, binary, texture["index"])[3][64][16:112] if texture else []
    print(*[round(sum(values) / len(row)) for values in zip(*row)] or ["none"])'  # 8 bits are dithered
ok $bake --maps transfer:opacity,transfer:emission -o 'e_<MAP>.exr' --glb e.glb --material sides=two
holds "alpha and light" [ "$(python3 -c "$materials" e.glb)" = "BLEND True [1.0, 1.0, 1.0] {'KHR_materials_emissive_strength': {'emissiveStrength': 4.0}}
255 255 255 64
99 188 255" ]
ok $bake --maps color,transfer:opacity -o 'e_<MAP>.exr' --glb e.glb --material alpha=mask
holds "a mask of one side" [ "$(python3 -c "$materials" e.glb | sed '2s/.* //')" = "MASK None None None
64
none" ]
sed 's/^Ke.*/Ke 0 0 0/; s/^d .*/d 1/' waves.mtl >dark.mtl && sed 's/waves.mtl/dark.mtl/' scan.obj >dark.obj
ok run bisque-voxelize dark.obj --channels opacity,emission -o dark.tris
ok run bisque-bake dark.tris low.obj --size 128 --maps color,transfer:opacity,transfer:emission -o 'e_<MAP>.exr' --glb e.glb
holds "no light, and no alpha" [ "$(python3 -c "$materials" e.glb | sed '2s/ //g; 2s/[0-9]*/colour/')" = "None None None None
colour
none" ]

# The file is a low-poly mesh, and a scan, for Bisque itself.
ok run bisque-voxelize a.glb --channels all --resolution 64 -o again.nvdb
holds "read without a warning" [ ! -s "$err" ]

# Each UDIM tile is a material, and what lies in no tile that is baked has none.
sed 's/^vt 0\.[5-9]/&X/; s/^vt 0\(.*\)X/vt 1\1/' low.obj >tiles.obj
materials()
{
    python3 -c '
import glb, sys
document, binary = glb.read(sys.argv[1])
for primitive in document["meshes"][0]["primitives"]:
    uv = glb.elements(document, binary, primitive["attributes"]["TEXCOORD_0"])
    assert all(0 <= c <= 1 for pair in uv for c in pair) or "material" not in primitive
    print(document["materials"][primitive["material"]]["name"] if "material" in primitive else "none")' "$1"
}
ok run bisque-bake scan.tris tiles.obj --size 64 --maps normal -o 'tile_<UDIM>.exr' --glb tiles.glb
holds "a material for each tile" [ "$(materials tiles.glb)" = "tile 1001
tile 1002" ]
ok run bisque-bake scan.tris tiles.obj --size 64 --maps normal --tiles 1002 -o 'tile_<UDIM>.exr' --glb tiles.glb
holds "triangles without maps are kept" [ "$(materials tiles.glb)" = "tile 1002
none" ]

rm -f a.glb
$bake --maps normal --normal space=object -o x.exr --glb x.glb
refused 64 "$p x.glb: glTF has normals in tangent space only"
$bake -o 'x_<MAP>.exr' --glb x.gltf
refused 64 "$p x.gltf: its name must end in .glb"
$bake -o x.exr --maps normal --glb x.exr
code 64
$bake -o 'x_<MAP>.exr' --glb nowhere/x.glb
code 73
holds "nothing is left of what failed" [ -z "$(ls x* 2>/dev/null)" ]
finish

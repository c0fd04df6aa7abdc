#!/bin/sh
# test_mesh_formats.sh - the same mesh in each format gives the same chunks, grid and maps.
. "$(dirname "$0")/lib.sh"

# compare OPTION...: writes the vase in all formats and voxelizes each.
compare()
{
    for suffix in obj ply big.ply text.ply; do
        "$TESTS/generate-scan" --triangles 20000 "$@" vase -o "scan.$suffix"
        ok run bisque-voxelize "scan.$suffix" -o "scan.$suffix.nvdb" --resolution 100
    done
    for suffix in ply big.ply text.ply; do
        same scan.obj.tris "scan.$suffix.tris"
        same scan.obj.nvdb "scan.$suffix.nvdb"
    done
}

compare
# STL files have positions only, and no shared vertices.
for order in "" "--shuffle 7"; do
    for suffix in obj stl; do
        # shellcheck disable=SC2086 # the order is no option or two words
        "$TESTS/generate-scan" --triangles 20000 $order vase -o "scan.$suffix"
        ok run bisque-voxelize "scan.$suffix" -o "scan.$suffix.nvdb" --resolution 200
    done
    same scan.obj.tris scan.stl.tris
    same scan.obj.nvdb scan.stl.nvdb
done
ok run bisque-voxelize scan.stl -o small.nvdb --resolution 200 --memory 64M --threads 1
same scan.obj.nvdb small.nvdb

# GLB files of positions and normals.
for normals in "" "--normals --shuffle 3"; do
    # shellcheck disable=SC2086 # see above
    "$TESTS/generate-scan" --triangles 20000 $normals vase -o scan.obj
    python3 "$top/tests/scan/write_glb.py" scan.obj scan.glb
    for suffix in obj glb; do
        ok run bisque-voxelize "scan.$suffix" -o "scan.$suffix.nvdb" --resolution 200
    done
    same scan.obj.tris scan.glb.tris
    same scan.obj.nvdb scan.glb.nvdb
done
ok run bisque-voxelize scan.glb -o small.nvdb --resolution 200 --memory 64M --threads 1
same scan.obj.nvdb small.nvdb

compare --colors --normals --uvs --shuffle 1
compare --corners 6 --colors
compare --offset 500000,4000000,300

# More files than descriptors, most of them without a triangle.
head -c 84 /dev/zero >none.stl
printf '' >none.obj
for suffix in stl obj; do
    many='' i=0
    while [ $i -lt 200 ]; do
        many="$many none.$suffix" i=$((i + 1))
    done
    command="bisque-voxelize with 200 empty files and scan.$suffix" code=0
    # shellcheck disable=SC2086 # names without spaces
    (ulimit -n 60 && exec "$BIN/bisque-voxelize" $many "scan.$suffix" -o many.nvdb \
        --resolution 100 --threads 2) >"$out" 2>"$err" || code=$?
    code 0
done

# Files that other programs wrote.
for kind in plain colors faces linear twice; do
    ok run bisque-voxelize "$top/tests/meshes/$kind.obj" -o "$kind.nvdb" --voxel-size 0.02
    for file in "$top/tests/meshes/$kind".*.*; do
        ok run bisque-voxelize "$file" -o other.nvdb --tris other.tris --voxel-size 0.02
        same "$kind.nvdb" other.nvdb
        if [ $kind != faces ]; then # materials in the one, colours of faces in the other
            same "$kind.tris" other.tris
        fi
    done
done

ok run bisque-voxelize "$top/tests/meshes/plain.obj" -o plain.nvdb --voxel-size 0.02
find_python
for file in "$top/tests/meshes"/packed.*; do
    ok run bisque-voxelize "$file" -o packed.nvdb --voxel-size 0.02
    if [ -n "$python" ]; then
        "$python" -B "$top/tests/meshes/same_triangles.py" 0.00002 plain.tris packed.tris
        check "the triangles of $file" $?
    else
        lacks "the triangles of $file" "python3-numpy or python3-xxhash is not installed"
    fi
done

ok run bisque-voxelize "$top/tests/meshes/twice.obj" -o twice.nvdb --voxel-size 0.02
ok run bisque-voxelize "$top/tests/meshes/draco.blender.glb" -o draco.nvdb --voxel-size 0.02
if [ -n "$python" ]; then
    "$python" -B "$top/tests/meshes/same_triangles.py" 0.00003 twice.tris draco.tris
    check "the triangles of a mesh that Draco compressed" $?
fi

# Compressed files with damage end with a result or a message.
for file in packed.gltfpack.meshopt.glb draco.blender.glb; do
    rm -f bad.*.glb
    python3 "$top/tests/meshes/damage.py" "$top/tests/meshes/$file" 8
    for bad in bad.*.glb; do
        run bisque-voxelize --parse-only "$bad"
        [ "$code" -eq 0 ] || [ "$code" -eq 65 ] && [ "$(wc -l <"$err")" -eq $((code > 0)) ]
        check "$file with damage, $bad: exit code $code" $?
    done
done
python3 "$top/tests/meshes/damage.py" "$top/tests/meshes/draco.blender.glb" large
run bisque-voxelize --parse-only large.glb --memory 64M
refused_like 71 '^bisque-voxelize: the memory budget is too small: .* needs [0-9]* bytes'
# Counts that the compressed bytes cannot hold need no memory.
python3 "$top/tests/meshes/damage.py" "$top/tests/meshes/draco.blender.glb" huge
run bisque-voxelize --parse-only huge.glb --memory 64M
refused_like 65 '^bisque-voxelize: huge.glb: .*: [0-9]* compressed bytes cannot hold [0-9]* triangles$'

# What Draco wants beyond the budget is not given.
python3 "$top/tests/meshes/damage.py" "$top/tests/meshes/draco.blender.glb" greedy
if sanitized; then
    skip "a greedy mesh is refused within the budget" "sanitizers need far more addresses"
else
    run bisque-voxelize --parse-only greedy.glb --memory 64M
    refused_like 71 '^bisque-voxelize: greedy.glb: Draco or meshoptimizer needs more memory than its [0-9]* bytes of --memory'
fi

# Views that are compressed do not need their fallback.
python3 "$top/tests/meshes/damage.py" "$top/tests/meshes/packed.gltfpack.meshopt.glb" fallback
ok run bisque-voxelize "$top/tests/meshes/packed.gltfpack.meshopt.glb" -o packed.nvdb --voxel-size 0.02
ok run bisque-voxelize fallback.glb -o fallback.nvdb --voxel-size 0.02
same packed.nvdb fallback.nvdb

# Colours of faces and textures, as from MTL files.
cat >square.mtl <<'END'
newmtl red
Kd 1 0 0
newmtl blue
Kd 0 0 1
newmtl image
map_Kd image.ppm
END
printf 'P3\n2 2\n255\n255 0 0  0 255 0\n0 0 255  9 90 200\n' >image.ppm
points='0 0 0
1 0 0
1 1 0
0 1 0'
{
    echo 'mtllib square.mtl'
    echo "$points" | sed 's/^/v /'
    printf 'usemtl blue\nf 1 2 3\nusemtl red\nf 1 3 4\n'
} >faces.obj
xyz='property float x
property float y
property float z'
corners='property list uchar int vertex_index'
cat >faces.ply <<END
ply
format ascii 1.0
element face 2
$corners
property uchar red
property uchar green
property uchar blue
element vertex 4
$xyz
end_header
3 0 1 2 0 0 255
3 0 2 3 255 0 0
$points
END
{
    echo 'mtllib square.mtl'
    echo "$points" | sed 's/^/v /'
    printf 'vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl image\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n'
} >texture.obj
cat >texture.ply <<END
ply
format ascii 1.0
comment TextureFile image.ppm
element vertex 4
$xyz
element face 2
$corners
property list uchar float texcoord
end_header
$points
3 0 1 2 6 0 0 1 0 1 1
3 0 2 3 6 0 0 1 1 0 1
END
cat >vertices.ply <<END
ply
format ascii 1.0
comment TextureFile image.ppm
element vertex 4
$xyz
property float s
property float t
element face 2
$corners
end_header
0 0 0 0 0
1 0 0 1 0
1 1 0 1 1
0 1 0 0 1
3 0 1 2
3 0 2 3
END
# A texture without coordinates, and colours of faces beside those of vertices or a texture, are told.
colors='property uchar red
property uchar green
property uchar blue'
sed '/^property float [st]$/d; s/^\([01] [01] 0\) [01] [01]$/\1/' vertices.ply >bare.ply
loses()
{
    ok run bisque-voxelize $1 -o lost.tris
    holds "warning: $2" grep -q "^bisque-voxelize: warning: $1: $2\$" "$err"
    run bisque-voxelize $1 -o lost.tris --strict
    refused_like 65 "bisque-voxelize: $1: $2"
}
loses bare.ply 'no texture coordinates, so the texture .*image.ppm is not used'
awk -v colors="$colors" '{ print } /^property list uchar int/ { print colors }' vertices.ply |
    sed 's/^3 0 [12] [23]$/& 9 9 9/' >tinted.ply
loses tinted.ply 'colours of faces are not used beside a texture'
grep -v TextureFile bare.ply | awk -v colors="$colors" '{ print } /^property float z/ || /^property list/ { print colors }' |
    sed 's/^3 0 [12] [23]$/& 9 9 9/; s/^[01] [01] 0$/& 7 7 7/' >twice.ply
loses twice.ply 'colours of faces are not used beside those of vertices'

# A number of a texture beyond those that the file names is a loss; a negative one is none.
sed 's/^property list uchar float texcoord/&\nproperty int texnumber/
    s/^3 0 1 2 .*/& 0/; s/^3 0 2 3 .*/& 0\n3 0 1 3 0 -1\n3 1 2 3 0 1\n3 1 3 2 0 4294967297/
    s/^element face 2/element face 5/' texture.ply >beyond.ply
ok run bisque-voxelize beyond.ply -o beyond.nvdb --resolution 16
grep -qxF 'bisque-voxelize: warning: beyond.ply:20: faces whose texnumber, from 0, is not below the number of textures that the file names; they have no texture: 2; this is the first' "$err"
check 'a warning of textures beyond the file' $?
run bisque-voxelize beyond.ply -o beyond.nvdb --resolution 16 --strict
code 65

# Each colour of faces is a material. A budget that is too small for them says so.
awk 'BEGIN {
    print "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z"
    print "element face 400000\nproperty list uchar int vertex_index"
    print "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 0 0\n1 0 0\n0 1 0"
    for (i = 0; i < 400000; i++)
        print 3, 0, 1, 2, i % 256, int(i / 256) % 256, int(i / 65536)
}' >many.ply
run bisque-voxelize many.ply -o many.nvdb --resolution 16 --memory 56M --threads 1
refused_like 71 'the memory budget is too small: a (list|table) of materials and of colours of faces needs [0-9]* bytes'
ok run bisque-voxelize many.ply -o many.nvdb --resolution 16 --memory 256M --threads 1

for name in faces texture; do
    ok run bisque-voxelize $name.obj -o $name.nvdb --resolution 64
    out_like 'voxels'
    for file in $name.ply vertices.ply; do
        if [ $name.$file != faces.vertices.ply ]; then
            ok run bisque-voxelize $file -o other.nvdb --tris other.tris --resolution 64
            same $name.nvdb other.nvdb
        fi
    done
done

# The same texture in glTF files: beside the file, in a data URI, and in the binary chunk.
python3 "$top/tests/scan/write_square.py"
ok run bisque-voxelize texture.obj -o texture.nvdb --resolution 64
for file in beside.gltf inside.gltf image.glb; do
    ok run bisque-voxelize $file -o other.nvdb --tris other.tris --resolution 64
    out_like 'with colour'
    same texture.nvdb other.nvdb
    ok run bisque-voxelize other.tris -o again.nvdb --resolution 64
    same texture.nvdb again.nvdb
done
run bisque-voxelize beside.gltf -o a.nvdb --tris image.ppm
refused 64 'bisque-voxelize: image.ppm: this output would overwrite the texture that beside.gltf names'
run bisque-voxelize beside.gltf -o a.nvdb --tris square.bin
refused 64 'bisque-voxelize: square.bin: this output would overwrite the buffer that beside.gltf names'
run bisque-voxelize other.tris -o image.glb --resolution 64
refused_like 64 '^bisque-voxelize: image.glb: this output would overwrite .*, the texture that other.tris names$'

# Textures and geometry that are not read are a loss. A packed file's own textures cannot be named.
gzip -c image.glb >packed.glb.gz
sed 's/"image.ppm"/"https:\/\/example.org\/image.ppm"/' beside.gltf >web.gltf
sed 's/"source": 0/"sampler": 0/' beside.gltf >basisu.gltf
sed 's/"nodes": \[{"mesh": 0}/&, {"mesh": 0}/' beside.gltf >outside.gltf
jq '.meshes += .meshes' beside.gltf >unplaced.gltf
jq '.meshes[0].primitives += [{"attributes": {}}]' beside.gltf >bare.gltf
jq '.meshes[0].primitives[0].attributes.COLOR_1 = 0' beside.gltf >color_1.gltf
jq '.nodes[0].extensions = {"KHR_node_visibility": {"visible": false}}' beside.gltf >hidden.gltf
jq '.meshes[0].primitives[0].extensions = {"KHR_materials_variants": {"mappings": []}}' beside.gltf \
    >variants.gltf
for case in 'color_1.gltf primitives have COLOR_1 or the like without COLOR_0, which is not read' \
    'hidden.gltf nodes are hidden by KHR_node_visibility, but are read' \
    'variants.gltf primitives have KHR_materials_variants, of which only the first material is read' \
    'unplaced.gltf meshes are at no node and are not read' 'bare.gltf primitives without positions are not read' \
    'packed.glb.gz textures are inside of a packed file or a pipe: unpack it' \
    'web.gltf textures have a format or an address that is not read' \
    'basisu.gltf textures have a format or an address that is not read' \
    'outside.gltf nodes with meshes are not in the scene and are not read'; do
    file=${case%% *} line="${case%% *}: 1 ${case#* }"
    ok run bisque-voxelize "$file" -o a.nvdb --resolution 16
    holds "warning: $line" grep -qxF "bisque-voxelize: warning: $line" "$err"
    run bisque-voxelize "$file" -o a.nvdb --resolution 16 --strict
    refused 65 "bisque-voxelize: $line"
done

# Vertex colours out of range are clamped, which is told.
# write_colors RED GREEN BLUE FACTOR: a triangle with these colours of float.
write_colors()
{
    python3 - "$@" <<'END'
import base64, json, struct, sys
color = [float(word) for word in sys.argv[1:4]]
data = struct.pack("<18f", *([0, 0, 0, 1, 0, 0, 0, 1, 0] + 3 * color))
uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
print(json.dumps({
    "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data), "uri": uri}],
    "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
    "accessors": [accessor, dict(accessor, byteOffset=36)],
    "materials": [{"pbrMetallicRoughness": {"baseColorFactor": 3 * [float(sys.argv[4])] + [1]}}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "material": 0}]}],
    "nodes": [{"mesh": 0}]}))
END
}
write_colors 1 0 1 1 >within.gltf
write_colors 1.5 -1 1e30 1 >beyond.gltf
write_colors -1 -1 -1 1 >negative.gltf
write_colors 2 0 2 0.5 >halved.gltf
for name in within beyond negative halved; do
    ok run bisque-voxelize $name.gltf -o $name.nvdb --resolution 16
    clamped=$(grep -c "$name.gltf: colours out of range were clamped at 3 vertices" "$err")
    case $name in
    beyond | negative) check "$name.gltf: $clamped warnings" $((clamped != 1)) ;;
    *) check "$name.gltf: $clamped warnings" "$clamped" ;;
    esac
done
same within.nvdb beyond.nvdb
same within.nvdb halved.nvdb

# What is no image is not copied out of its file: no temporary file may have more than 100 KiB.
mkdir no_image
head -c 1000000 /dev/zero >no_image/image.ppm
(cd no_image && python3 "$top/tests/scan/write_square.py")
for file in inside.gltf image.glb; do
    command="bisque-voxelize no_image/$file" code=0
    (ulimit -f 200 && exec "$BIN/bisque-voxelize" no_image/$file -o a.tris) \
        >"$out" 2>"$err" || code=$?
    code 0
    holds "$file: the image is no image" grep -q "#b.*: not a readable image: it is no PNG, JPEG" "$err"
done

# A buffer is never replaced by another file of its name.
sed 's/"square.bin"/"tile7\/square.bin"/' beside.gltf >tile.gltf
run bisque-voxelize tile.gltf -o a.nvdb
refused 66 'bisque-voxelize: tile7/square.bin: no such buffer, which tile.gltf names'

mkfifo fifo.bin
for other in fifo.bin .; do
    sed "s/\"square.bin\"/\"$other\"/" beside.gltf >tile.gltf
    run bisque-voxelize tile.gltf -o a.nvdb
    refused 66 "bisque-voxelize: $other: not a regular file, which tile.gltf names as a buffer"
done

# A texture is an input: no output may replace it.
run bisque-voxelize texture.ply -o a.nvdb --tris image.ppm
refused 64 'bisque-voxelize: image.ppm: this output would overwrite the texture that texture.ply names'

# Low-poly meshes.
"$TESTS/generate-scan" --triangles 20000 --colors vase -o scan.ply
run bisque-voxelize scan.ply -o scan.nvdb --resolution 100
for suffix in obj ply big.ply text.ply; do
    "$TESTS/generate-scan" vase-low -o "low.$suffix"
    ok run bisque-bake scan.nvdb "low.$suffix" -o "low.$suffix.<MAP>.exr" --maps normal,color --size 64
done
for suffix in ply big.ply text.ply; do
    same low.obj.normal.exr "low.$suffix.normal.exr"
    same low.obj.color.exr "low.$suffix.color.exr"
done

# The textures of a low-poly mesh are not read, so its maps may take their names.
ok run bisque-bake texture.nvdb beside.gltf -o image.png --maps normal --size 16
mv image.png beside.png
sed 's/image.ppm/beside.png/' beside.gltf >again.gltf
sed 's/image.ppm/beside.png/' texture.ply >again.ply
for low in again.gltf again.ply; do
    ok run bisque-bake texture.nvdb $low -o beside.png --maps normal --size 16
done

# GLB files split vertices at texture seams. Normals that are missing stay smooth there.
grep -v '^vn' low.obj | sed 's|/[0-9]*\( \)|\1|g; s|/[0-9]*$||' >low.plain.obj
for kind in low low.plain; do
    python3 "$top/tests/scan/write_glb.py" "$kind.obj" "$kind.glb"
    for suffix in obj glb; do
        ok run bisque-bake scan.nvdb "$kind.$suffix" -o "$kind.$suffix.exr" --maps normal --size 128 --low normals=angle
    done
    ok run bisque-compare --type normal "$kind.obj.exr" "$kind.glb.exr" --max-mean 0.01
done
# By their specification, they are flat in glTF files.
for normals in auto angle flat; do
    ok run bisque-bake scan.nvdb low.plain.glb -o $normals.exr --maps normal --size 128 --low normals=$normals
done
same auto.exr flat.exr
! cmp -s auto.exr angle.exr
check "smooth normals are others" $?
for attribute in '' ',"TANGENT":0'; do
    printf '{"asset":{"version":"2.0"},"buffers":[{"uri":"square.bin","byteLength":86}],
"bufferViews":[{"buffer":0,"byteLength":80}],"accessors":[
{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
{"bufferView":0,"byteOffset":48,"componentType":5126,"count":3,"type":"VEC2"}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1%s}}]}]}' "$attribute" >low.gltf
    ok run bisque-bake scan.nvdb low.gltf -o a.exr --maps normal --size 16
    [ "$(grep -c "low.gltf: the file's tangents are not used: they are computed" "$err")" -eq \
        $((${#attribute} > 0)) ]
    check "warning of tangents: '$attribute'" $?
done
for scale in 2,2,2 2,1,2; do
    sed "s/\"meshes\"/\"nodes\":[{\"mesh\":0,\"scale\":[$scale]}],&/" low.gltf >scaled.gltf
    ok run bisque-bake scan.nvdb scaled.gltf -o a.exr --maps normal --size 16 --as-is
    [ "$(grep -c "scaled.gltf: a node has scales that differ by axis" "$err")" -eq \
        "$([ $scale = 2,1,2 ] && echo 1 || echo 0)" ]
    check "warning of scales: $scale" $?
done
ok run bisque-bake scan.nvdb low.plain.glb scaled.gltf -o a.exr --maps normal --size 16 --as-is
[ "$(grep -c "warning: scaled.gltf: \(the file's tangents\|a node has scales\)" "$err")" -eq 2 ]
check "warnings name the low-poly file that they are about" $?

# Other formats come by glTF files, as Assimp's program makes them.
meshes=$top/tests/meshes
for suffix in obj assimp.glb; do
    ok run bisque-voxelize "$meshes/uv.$suffix" -o uv.$suffix.nvdb --voxel-size 0.02
    ok run bisque-bake uv.$suffix.nvdb "$meshes/uv.$suffix" -o uv.$suffix.exr --maps normal --size 64 --low normals=angle
done
same uv.obj.nvdb uv.assimp.glb.nvdb
ok run bisque-compare --type normal uv.obj.exr uv.assimp.glb.exr --max-error 0.05
advice='make a GLB file of it, such as by `assimp export in.fbx in.glb` (Debian: assimp-utils)'
printf 'Kaydara FBX Binary  \0\032\0' >binary
run bisque-voxelize binary -o other.nvdb
refused 65 "bisque-voxelize: binary: cannot read an FBX file: $advice"
for name in text.fbx a.DAE b.3ds c.x.gz; do
    echo text | if [ "${name%.gz}" = "$name" ]; then cat; else gzip; fi >$name
    run bisque-voxelize $name -o other.nvdb
    refused 65 "bisque-voxelize: $name: cannot read files of this format: $advice"
    run bisque-bake uv.obj.nvdb $name -o other.exr --maps normal
    refused 65 "bisque-bake: $name: cannot read files of this format: $advice"
done

finish

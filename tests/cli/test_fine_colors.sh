#!/bin/sh
# test_fine_colors.sh - colours of vertices with more than 8 bits: exact maps have them, whatever the
# format; sources of 8 bits have the bytes that they always had; grids say that they have 8 bits.
. "$(dirname "$0")/lib.sh"
need_oracle
export PYTHONPATH="$top/tests/cli" PYTHONDONTWRITEBYTECODE=1
cat >low.obj <<END
v 0 0 0
v 5 0 0
v 5 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
f 1/1/1 2/2/1 3/3/1
f 1/1/1 3/3/1 4/4/1
END

# sorted CASE SUFFIX: sorts the mesh of a case, and bakes its colours.
sorted()
{
    python3 "$top/tests/cli/fine_colors.py" write "$1" "$1.$2"
    ok run bisque-voxelize "$1.$2" -o "$1.tris"
    ok run bisque-bake "$1.tris" low.obj --maps color --size 50 --scan normals=flat -o "$1.png"
    python3 "$top/tests/cli/fine_colors.py" expect "$1" "$1.png"
    check "the map has the colours of $1" $?
}

for case in ushort ascii_ushort float double float_255; do
    sorted $case ply
done
sorted gltf_ushort glb
sorted gltf_factor glb
ok run bisque-voxelize --verify ushort.tris float_255.tris gltf_factor.tris
ok oracle read_file ushort.tris
ok oracle read_file
for case in ascii_ushort float double float_255; do
    same ushort.tris $case.tris
done
ok run bisque-voxelize --info ushort.tris --json
json '.files[0] | .vertex_colors and .fine_colors'

# Sources of 8 bits, as numbers of any kind, are one file, without fine colours.
for case in bytes ushort_bytes float_bytes; do
    sorted $case ply
    same bytes.tris $case.tris
done
# Numbers of OBJ files are bytes with some digits.
sorted obj obj
sorted gltf_bytes glb
ok run bisque-voxelize --info bytes.tris obj.tris gltf_bytes.tris --json
json 'all(.files[]; .vertex_colors and (.fine_colors | not))'

# A grid has the nearest colours of 8 bits, and says so.
ok run bisque-voxelize ushort.ply --voxel-size 0.1 --no-tris -o ushort.nvdb
out_like '^kept: .*vertex colours of more than 8 bits'
out_like 'with colour in 8 bits, of more'
ok run bisque-voxelize ushort.tris --voxel-size 0.1 -o again.nvdb --json
json '.grid.rounds_colors and .grid.has_color'
same ushort.nvdb again.nvdb
ok run bisque-voxelize bytes.tris --voxel-size 0.1 -o bytes.nvdb --json
json '.grid.has_color and (.grid.rounds_colors | not)'

# Together with other files, in any order; of one chunk file with colours of 8 bits and one with more.
ok run bisque-voxelize bytes.ply ushort.ply float_255.ply obj.obj -o all.tris
ok run bisque-voxelize --verify all.tris
ok run bisque-voxelize bytes.tris ushort.tris -o joined.tris
ok run bisque-voxelize --verify joined.tris
ok oracle read_file joined.tris
ok run bisque-bake joined.tris low.obj --maps color --size 50 --scan normals=flat -o joined.png

# The same bytes for any threads, and with streams in memory or in files.
python3 - <<END
import random, struct
random.seed(7)
side = 700
with open("sheet.ply", "wb") as out:
    out.write(b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % side ** 2)
    out.write(b"".join(b"property float %s\n" % a for a in (b"x", b"y", b"z")))
    out.write(b"".join(b"property float %s\n" % a for a in (b"red", b"green", b"blue")))
    out.write(b"element face %d\nproperty list uchar int vertex_indices\nend_header\n" % (side - 1) ** 2)
    for i in range(side * side):
        # The first ones may range to 1 or to 255.
        most = 1 if i < side * side / 2 else 255
        out.write(struct.pack("<6f", i % side, i // side, 0, *(random.random() * most for _ in range(3))))
    for i in range(side * side):
        if i % side < side - 1 and i < side * (side - 1):
            out.write(struct.pack("<B4i", 4, i, i + 1, i + side + 1, i + side))
END
ok run bisque-voxelize sheet.ply -o one.tris --threads 1 --memory 1G
ok run bisque-voxelize sheet.ply -o two.tris --threads 2 --memory 60MiB --json
json '.scan.temp_bytes > 0 and .scan.has_fine_colors'
same one.tris two.tris
finish

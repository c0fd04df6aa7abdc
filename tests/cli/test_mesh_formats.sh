#!/bin/sh
# test_mesh_formats.sh - the same mesh in each format gives the same chunks, grid and maps.
. "$(dirname "$0")/lib.sh"

# compare OPTION...: writes the vase in all formats and voxelizes each.
compare()
{
    for suffix in obj ply big.ply text.ply; do
        "$TESTS/generate-scan" --triangles 20000 "$@" vase -o "scan.$suffix"
        run bisque-voxelize "scan.$suffix" -o "scan.$suffix.nvdb" --resolution 100
        code 0
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
        run bisque-voxelize "scan.$suffix" -o "scan.$suffix.nvdb" --resolution 200
        code 0
    done
    same scan.obj.tris scan.stl.tris
    same scan.obj.nvdb scan.stl.nvdb
done
run bisque-voxelize scan.stl -o small.nvdb --resolution 200 --memory 64M --threads 1
code 0
same scan.obj.nvdb small.nvdb

compare --colors --normals --uvs --shuffle 1
compare --corners 6 --colors
compare --offset 500000,4000000,300

# Files that other programs wrote.
for kind in plain colors; do
    run bisque-voxelize "$top/tests/meshes/$kind.obj" -o "$kind.nvdb" --voxel-size 0.02
    code 0
    for file in "$top/tests/meshes/$kind".*.*; do
        run bisque-voxelize "$file" -o other.nvdb --tris other.tris --voxel-size 0.02
        code 0
        same "$kind.nvdb" other.nvdb
        same "$kind.tris" other.tris
    done
done

# A budget that puts vertices into a file.
"$TESTS/generate-scan" --triangles 2000000 vase -o large.ply
run bisque-voxelize large.ply -o large.nvdb --resolution 100
code 0
run bisque-voxelize large.ply -o small.nvdb --resolution 100 --memory 64M --threads 1
code 0
same large.nvdb small.nvdb
same large.tris small.tris

# Low-poly meshes.
"$TESTS/generate-scan" --triangles 20000 --colors vase -o scan.ply
run bisque-voxelize scan.ply -o scan.nvdb --resolution 100
for suffix in obj ply big.ply text.ply; do
    "$TESTS/generate-scan" vase-low -o "low.$suffix"
    run bisque-bake scan.nvdb "low.$suffix" -o "low.$suffix.<MAP>.exr" --maps normal,color --size 64
    code 0
done
for suffix in ply big.ply text.ply; do
    same low.obj.normal.exr "low.$suffix.normal.exr"
    same low.obj.color.exr "low.$suffix.color.exr"
done

# Messages.
printf 'ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n' >points.ply
printf 'property float z\nend_header\n0 0 0\n' >>points.ply
run bisque-voxelize points.ply -o a.nvdb
code 65
err 'bisque-voxelize: points.ply: a point cloud of 1 points without faces; make a mesh of it'
head -c 100000 scan.ply >cut.ply
run bisque-voxelize cut.ply -o a.nvdb
code 65
err_like '^bisque-voxelize: cut\.ply: truncated: .*vertex'
run bisque-voxelize scan.ply scan.obj -o a.nvdb
code 65
err_like 'all files of a scan need one format'

finish

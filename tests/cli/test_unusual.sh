#!/bin/sh
# test_unusual.sh - files that are legitimate, but written in ways that few programs use.
. "$(dirname "$0")/lib.sh"
p=bisque-voxelize:
vox="run bisque-voxelize --resolution 8 --no-tris"
tab=$(printf '\t')

python3 -B "$top/tests/cli/unusual.py" . || exit 1
ok $vox plain.obj -o plain.nvdb
while IFS=$tab read -r name warning; do
    ok $vox "$name" -o other.nvdb
    same plain.nvdb other.nvdb
    [ "$(cat "$err")" = "${warning:+$p warning: $name: $warning}" ] ||
        [ "$(cat "$err")" = "${warning:+$p warning: $name:$warning}" ]
    check "$name: ${warning:-no warning}" $?
done <cases
holds "there are cases" [ "$(wc -l <cases)" -gt 60 ]

# What is no surface of polygons is an error with --strict.
$vox surface.obj -o other.nvdb --strict
code 65

# Real numbers of faces range to 1. Larger ones lose colour.
sed 's/^property list.*/&\nproperty float red\nproperty float green\nproperty float blue/
    s/^3 0 1 2/& 255 0 0/; s/^3 1 3 2/& 0 0.5 1/' <<'END' >faces.ply
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
1 1 0.5
3 0 1 2
3 1 3 2
END
ok $vox faces.ply -o other.nvdb
[ "$(cat "$err")" = "$p warning: faces.ply: 1 colours of faces are out of range and were clamped; real numbers range to 1" ]
check "colours of faces out of range" $?

# Factors beyond all colours make no damaged files.
ok run bisque-voxelize --resolution 8 huge.gltf -o huge.nvdb --channels opacity,roughness,emission
ok run bisque-voxelize --verify huge.tris huge.nvdb
finish

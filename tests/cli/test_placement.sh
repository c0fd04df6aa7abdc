#!/bin/sh
# test_placement.sh - --scale, --up and --translate: the grid of a scan that was moved by its writer.
. "$(dirname "$0")/lib.sh"
p=bisque-voxelize:
vox="run bisque-voxelize --resolution 40 --no-tris"

# write_moved EXPRESSIONS: a tetrahedron with normals, whose positions awk computes from x, y and z.
# All numbers are sums of powers of two, so that nothing is rounded.
write_moved()
{
    awk "BEGIN {
        OFMT = \"%.12g\"
        n = split(\"0 0 0 1 0 0 0.25 1 0.5 0.5 0.25 1\", c, \" \")
        for (i = 1; i <= n; i += 3) { x = c[i]; y = c[i + 1]; z = c[i + 2]; print \"v\", $1 }
        x = 0.5; y = 0.25; z = 1; print \"vn\", $2
        print \"f 1//1 3//1 2//1\nf 1//1 2//1 4//1\nf 2//1 3//1 4//1\nf 3//1 1//1 4//1\"
    }"
}

write_moved 'x, y, z' 'x, y, z' >plain.obj
write_moved '4 * x, 4 * y, 4 * z' 'x, y, z' >scaled.obj
write_moved 'x, z, -y' 'x, z, -y' >y.obj
write_moved 'x, -z, y' 'x, -z, y' >z.obj
write_moved '4 * x + 8, 4 * z - 16, -4 * y + 0.5' 'x, z, -y' >all.obj
write_moved 'x + 500000, y + 4000000, z' 'x, y, z' >far.obj
for name in plain scaled y z all; do
    ok $vox $name.obj -o $name.nvdb
done
while read -r name options; do
    ok $vox plain.obj $options -o moved.nvdb
    same $name.nvdb moved.nvdb
done <<'CASES'
scaled --scale 4
y --up y
z --up z
all --scale 4 --up y --translate 8,-16,0.5
plain --scale 1 --translate 0,0,0
CASES
# Doubles up to the choice of the origin: a scan far away loses nothing.
ok $vox far.obj --translate=-500000,-4000000,0 -o moved.nvdb
same plain.nvdb moved.nvdb

# Each file has its own place.
gzip -c plain.obj >packed.obj.gz
ok $vox plain.obj packed.obj.gz --scale 1 --scale 4 --translate 0,0,0 --translate 8,-16,0.5 -o moved.nvdb \
    --json
write_moved '4 * x + 8, 4 * y - 16, 4 * z + 0.5' 'x, y, z' >second.obj
ok $vox plain.obj second.obj -o both.nvdb
same both.nvdb moved.nvdb

# ---- every format ----

# Files by other programs hold the mesh of an OBJ file. place.py moves that one.
meshes=$top/tests/meshes
cp "$meshes"/*.mtl .
while read -r kind scale up translation; do
    python3 "$top/tests/cli/place.py" "$meshes/$kind.obj" "$scale" "$up" "$translation" moved.obj
    ok $vox moved.obj -o expected.nvdb
    turn="--up $up"
    [ $up != keep ] || turn=
    for file in "$meshes/$kind".obj "$meshes/$kind".*.*; do
        # shellcheck disable=SC2086 # the turn is no option or two words
        ok $vox --scale "$scale" "$file" $turn -o moved.nvdb --translate="$translation"
        same expected.nvdb moved.nvdb
    done
done <<'CASES'
plain 4 y 8,-16,0.5
colors 1 z 0,0,0
faces 2 y -0.5,0,0
linear 3 keep 0.25,0.5,-8
twice 0.5 y 1,2,3
uv 4 z 1000,0,-1
CASES

# Normals of each format turn with the mesh. Scales of powers of two round nothing.
"$TESTS/generate-scan" -n 2000 --normals vase -o vase.obj
for suffix in ply big.ply text.ply; do
    "$TESTS/generate-scan" -n 2000 --normals vase -o vase.$suffix
done
python3 "$top/tests/scan/write_glb.py" vase.obj vase.glb
for up in y z; do
    python3 "$top/tests/cli/place.py" vase.obj 4 $up 0,0,0 moved.obj
    ok run bisque-voxelize moved.obj -o expected.nvdb --resolution 40
    for file in vase.obj vase.ply vase.big.ply vase.text.ply vase.glb; do
        ok $vox $file --up $up --scale 4 -o moved.nvdb
        same expected.nvdb moved.nvdb
    done
    # The chunk file is where the scan was moved to.
    ok run bisque-voxelize vase.ply --up $up --scale 4 -o moved.tris
    same expected.tris moved.tris
    ok $vox moved.tris -o moved.nvdb
    same expected.nvdb moved.nvdb
done

# ---- several formats ----

# Options for each file may stand anywhere, and others are for all files.
for i in 1 2 3 4; do
    case $i in 1) scale=1 at=0,0,0 ;; 2) scale=4 at=8,0,-2 ;; 3) scale=0.5 at=-8,0.5,0 ;; 4) scale=2 at=1e3,0,1 ;; esac
    python3 "$top/tests/cli/place.py" "$meshes/plain.obj" $scale z $at $i.obj
done
ok $vox 1.obj 2.obj 3.obj 4.obj -o expected.nvdb
ok $vox --scale 1 "$meshes/plain.blender.ply" --translate 0,0,0 --scale 4 "$meshes/plain.trimesh.glb" \
    "$meshes/plain.numpy.stl" --up z --translate=8,0,-2 --scale 0.5 --translate=-8,0.5,0 \
    "$meshes/plain.obj" -o moved.nvdb --translate 1e3,0,1 --scale 2
same expected.nvdb moved.nvdb
command="bisque-voxelize ... - ..." code=0
"$BIN/bisque-voxelize" --resolution 40 --no-tris "$meshes/plain.numpy.stl" - "$meshes/plain.open3d.ply" \
    "$meshes/plain.obj" --scale 1 --scale 4 --scale 0.5 --scale 2 --up z --up z --up z --up z \
    --translate 0,0,0 --translate 8,0,-2 --translate=-8,0.5,0 --translate 1e3,0,1 -o moved.nvdb \
    --threads 1 --memory 52MiB <"$meshes/plain.trimesh.ply" >"$out" 2>"$err" || code=$?
code 0
same expected.nvdb moved.nvdb
# Normals too.
python3 "$top/tests/cli/place.py" vase.obj 2 y 0,0,0 1.obj
python3 "$top/tests/cli/place.py" vase.obj 1 z 0,0,0 2.obj
ok $vox 1.obj 2.obj 1.obj -o expected.nvdb
ok $vox vase.ply vase.glb vase.obj --up y --up z --up y --scale 2 --scale 1 --scale 2 -o moved.nvdb
same expected.nvdb moved.nvdb
$vox 1.obj 2.obj 3.obj --scale 1 --scale 2 -o bad.nvdb
refused 64 "$p --scale is given 2 times for 3 files: give it once, or once for each file"
$vox 1.obj --translate 1,2,3 --translate 4,5,6 -o bad.nvdb
refused 64 "$p --translate is given 2 times for 1 file: give it once, or once for each file"

# ---- misuse ----

run bisque-voxelize plain.obj -o job.tris

while read -r options; do
    $vox plain.obj $options -o bad.nvdb
    code 64
done <<'CASES'
--scale 0
--scale -1
--scale nan
--up x
--translate 1,2
--translate 1,2,3,4
--translate 1,2,inf
--translate 1,2,nan
--translate 1,2,1e999
--translate 0x1,2,3
--translate 1,2,3,
--translate ,1,2
--scale inf
--scale 0x2
--scale 1e-400
--up
--up y --up z
--translate 1,2,3 --translate 4,5,6
--scale 1 --scale 2
CASES
$vox job.tris --scale 2 -o bad.nvdb
refused 64 "$p job.tris is a chunk file: --scale, --up and --translate are for meshes"
run bisque-voxelize plain.obj --parse-only --up y
code 64
$vox plain.obj --scale 1e300 --translate 0,0,0 -o bad.nvdb
code 65
holds "no output" [ ! -e bad.nvdb ]
finish

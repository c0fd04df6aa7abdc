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
    $vox $name.obj -o $name.nvdb
    code 0
done
while read -r name options; do
    $vox plain.obj $options -o moved.nvdb
    code 0
    same $name.nvdb moved.nvdb
done <<'CASES'
scaled --scale 4
y --up y
z --up z
all --scale 4 --up y --translate 8,-16,0.5
plain --scale 1 --translate 0,0,0
CASES
# Doubles up to the choice of the origin: a scan far away loses nothing.
$vox far.obj --translate=-500000,-4000000,0 -o moved.nvdb
code 0
same plain.nvdb moved.nvdb

# Each file has its own place.
gzip -c plain.obj >packed.obj.gz
$vox plain.obj packed.obj.gz --scale 1 --scale 4 --translate 0,0,0 --translate 8,-16,0.5 -o moved.nvdb \
    --json
code 0
write_moved '4 * x + 8, 4 * y - 16, 4 * z + 0.5' 'x, y, z' >second.obj
$vox plain.obj second.obj -o both.nvdb
code 0
same both.nvdb moved.nvdb

# ---- resuming needs the same place ----

run bisque-voxelize plain.obj --scale 4 --voxel-size 1e-7 -o job.nvdb
[ -e job.tris.job ]
check "the record is there" $?
run bisque-voxelize plain.obj --scale 2 --resolution 40 -o job.nvdb --resume
code 64
err_like "^$p job.tris was made from scale 4, up 0, translate 0,0,0, not from scale 2, up 0, .*: this job cannot be resumed\$"
run bisque-voxelize plain.obj --resolution 40 -o job.nvdb --resume
code 64
run bisque-voxelize plain.obj --scale 4 --resolution 40 -o job.nvdb --resume --json
code 0
json .resumed
same scaled.nvdb job.nvdb

# ---- misuse ----

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
--scale 1 --scale 2
CASES
$vox job.tris --scale 2 -o bad.nvdb
code 64
err "$p job.tris is a chunk file: --scale, --up and --translate are for meshes"
run bisque-voxelize plain.obj --parse-only --up y
code 64
$vox plain.obj --scale 1e300 --translate 0,0,0 -o bad.nvdb
code 65
[ ! -e bad.nvdb ]
check "no output" $?
finish

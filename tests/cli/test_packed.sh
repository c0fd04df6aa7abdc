#!/bin/sh
# test_packed.sh - scans packed by gzip and Zstandard, and scans that come through pipes.
. "$(dirname "$0")/lib.sh"
p=bisque-voxelize: meshes=$top/tests/meshes
vox="run bisque-voxelize --resolution 24 --no-tris"

# A sheet of 60 x 60 quads as OBJ, large enough that it is read in several blocks.
awk 'BEGIN {
    print "mtllib clay.mtl\nusemtl clay"
    for (y = 0; y <= 60; y++) for (x = 0; x <= 60; x++)
        printf "v %.5f %.5f %.5f\n", x / 60, y / 60, sin(x / 9) * cos(y / 7) / 5
    for (k = 0; k < 20000; k++) print "# a line that has no meaning at all for anybody"
    for (y = 0; y < 60; y++) for (x = 0; x < 60; x++) {
        i = y * 61 + x + 1; printf "f %d %d %d %d\n", i, i + 1, i + 62, i + 61 }
}' >scan.obj
printf 'newmtl clay\nKd 0.5 0.4 0.3\n' >clay.mtl
ok $vox scan.obj -o plain.nvdb

# ---- packed files ----

gzip -c scan.obj >scan.obj.gz
head -c 300000 scan.obj | gzip -c >two.gz
tail -c +300001 scan.obj | gzip -1 -c >>two.gz
command -v zstd >/dev/null && zstd -q -c scan.obj >scan.obj.zst
for name in scan.obj.gz two.gz scan.obj.zst; do
    [ -e $name ] || continue
    ok $vox $name -o packed.nvdb
    same plain.nvdb packed.nvdb
done
# Blocks of plain files are cut by their last bytes, those of packed ones where they are unpacked: lines that go on after
# a backslash, lines longer than the bytes that are looked at, and either end of lines.
awk 'BEGIN {
    for (k = 0; k < 100000; k++) printf "v %.5f \\\n %.5f \\\r\n %.5f\n", k % 317 / 317, int(k / 317) / 317, sin(k) / 50
    for (k = 0; k < 40; k++) { printf "#"; for (i = 0; i < 5000; i++) printf " long"; print "" }
    for (k = 1; k < 99000; k++) if (k % 317) printf "f %d \\\n%d %d\r\n", k, k + 1, k + 318 }' >lines.obj
gzip -1 -c lines.obj >lines.obj.gz
ok $vox lines.obj -o plain.nvdb
ok $vox lines.obj.gz -o packed.nvdb
same plain.nvdb packed.nvdb
ok run bisque-voxelize --parse-only lines.obj
out_like '^lines.obj: 100,000 vertices, 98,687 faces'
rm lines.obj lines.obj.gz
ok $vox scan.obj -o plain.nvdb
# The content decides, not the name.
cp scan.obj.gz scan.stl
$vox scan.stl -o packed.nvdb
code 65
run bisque-voxelize --parse-only two.gz
out_like '^two.gz: 3,721 vertices, 3,600 faces'
# Packed files have the same chunks, too, also for the smallest budget.
ok run bisque-voxelize --resolution 24 --threads 1 --memory 52MiB scan.obj.gz -o packed.nvdb
same plain.nvdb packed.nvdb
rm packed.*

# ---- pipes ----

"$BIN/bisque-voxelize" - --resolution 24 --no-tris -o piped.nvdb <scan.obj.gz >"$out" 2>"$err"
code=$? command="bisque-voxelize - <scan.obj.gz"
code 0
same plain.nvdb piped.nvdb
"$BIN/bisque-voxelize" - --parse-only <"$meshes/plain.numpy.stl" >"$out" 2>"$err"
code=$? command="bisque-voxelize - <plain.numpy.stl"
code 0
mkfifo pipe
cat scan.obj >pipe &
ok $vox pipe -o piped.nvdb
same plain.nvdb piped.nvdb
$vox - - -o piped.nvdb
refused 64 "$p -: a pipe can be read only once"
$vox pipe ./pipe -o piped.nvdb
refused 64 "$p ./pipe: a pipe can be read only once"
# Nobody writes: a signal ends the wait.
at_look 20 TERM "" bisque-voxelize pipe -o piped.nvdb
stopped
mkfifo low.obj
run bisque-bake plain.nvdb low.obj --maps normal -o map.exr
refused 66 "bisque-bake: low.obj: not a regular file"
rm low.obj pipe piped.nvdb

# ---- damage ----

head -c 20000 scan.obj.gz >cut.obj.gz
$vox cut.obj.gz -o cut.nvdb
refused 65 "$p cut.obj.gz: byte 20000: truncated: the packed data end too early"
for size in 2 3; do
    printf '\037\213\010' | head -c $size >short.gz
    printf '\050\265\057' | head -c $size >short.zst
    for name in short.gz short.zst; do
        run bisque-voxelize --parse-only $name
        refused 65 "$p $name: byte $size: truncated: the packed data end too early"
    done
done
for stray in x xyz; do # even if they are fewer than a member's head
    { cat scan.obj.gz && printf $stray; } >stray.obj.gz
    $vox stray.obj.gz -o cut.nvdb
    refused 65 "$p stray.obj.gz: byte $(stat -c %s scan.obj.gz): bytes after the packed data that are no gzip member"
done
{ head -c 9000 scan.obj.gz; printf '\252\125\252\125'; tail -c +9005 scan.obj.gz; } >bad.obj.gz
$vox bad.obj.gz -o cut.nvdb
refused_like 65 "^$p bad.obj.gz: byte [0-9]*: damaged: |^$p bad.obj.gz:[0-9]*: "
gzip -c scan.obj.gz >twice.gz
$vox twice.gz -o cut.nvdb
refused 65 "$p twice.gz: cannot read a file packed by gzip twice: unpack it first"
gzip -c plain.nvdb >grid.gz
$vox grid.gz -o cut.nvdb
code 65
holds "no output" [ ! -e cut.nvdb ]

# ---- other formats ----

for mesh in plain.trimesh.glb plain.trimesh.gltf; do
    cp "$meshes/$mesh" "$meshes"/*.bin .
    gzip -c $mesh >$mesh.gz
    ok $vox $mesh -o a.nvdb
    ok $vox $mesh.gz -o b.nvdb
    same a.nvdb b.nvdb
done
for mesh in "$meshes"/*.ply "$meshes"/*.stl; do
    run bisque-voxelize --parse-only --json "$mesh"
    jq -c '[.scan.vertices, .scan.triangles]' "$out" >plain.json
    gzip -c "$mesh" >mesh.gz
    mv mesh.gz "$(basename "$mesh")"
    ok run bisque-voxelize --parse-only --json "$(basename "$mesh")"
    jq -c '[.scan.vertices, .scan.triangles]' "$out" >packed.json
    same plain.json packed.json
done
rm a.nvdb b.nvdb

# ---- low-poly meshes ----

write_box >box.obj
gzip -c box.obj >box.obj.gz
run bisque-voxelize box.obj --resolution 16 -o box.nvdb
run bisque-bake box.nvdb box.obj --size 32 --maps normal -o a.exr
ok run bisque-bake box.nvdb box.obj.gz --size 32 --maps normal -o b.exr
same a.exr b.exr

finish

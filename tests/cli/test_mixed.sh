#!/bin/sh
# test_mixed.sh - one scan from files of several formats.
. "$(dirname "$0")/lib.sh"
p=bisque-voxelize:
vox="run bisque-voxelize --resolution 60"

# strip N: quads of a wavy sheet, as OBJ text with normals; four strips lie side by side. All numbers
# are exact as float32.
strip()
{
    awk -v n="$1" 'BEGIN {
        for (i = 0; i < 2 * 41; i++) {
            x = (i % 41) / 8; y = n + int(i / 41)
            print "v", x, y, (i % 7) / 16
        }
        for (i = 0; i < 2 * 41; i++) print "vn", (i % 5) / 8, 0, 1
        for (i = 1; i < 41; i++)
            printf "f %d//%d %d//%d %d//%d\nf %d//%d %d//%d %d//%d\n",
                i, i, i + 1, i + 1, i + 42, i + 42, i, i, i + 42, i + 42, i + 41, i + 41
    }'
}

# to_ply FILE [COLOR]: the same mesh as PLY text; COLOR: of all vertices.
to_ply()
{
    awk -v color="${2:-}" '
        $1 == "v" { v[nv++] = $2 " " $3 " " $4 }
        $1 == "vn" { n[nn++] = $2 " " $3 " " $4 }
        $1 == "f" { gsub("//[0-9]*", ""); f[nf++] = "3 " $2 - 1 " " $3 - 1 " " $4 - 1 }
        END {
            print "ply\nformat ascii 1.0\nelement vertex", nv
            print "property float x\nproperty float y\nproperty float z"
            print "property float nx\nproperty float ny\nproperty float nz"
            if (color) print "property uchar red\nproperty uchar green\nproperty uchar blue"
            print "element face", nf "\nproperty list uchar int vertex_indices\nend_header"
            for (i = 0; i < nv; i++) print v[i], n[i], color
            for (i = 0; i < nf; i++) print f[i]
        }' "$1"
}

for n in 0 1 2 3; do
    strip $n >"s$n.obj"
    to_ply "s$n.obj" >"s$n.ply"
    python3 "$top/tests/scan/write_glb.py" "s$n.obj" "s$n.glb"
done

# ---- the same scan ----

ok $vox s0.obj s1.obj s2.obj s3.obj -o obj.nvdb
gzip -c s3.ply >s3.ply.gz
while read -r files; do
    ok $vox $files -o mixed.nvdb
    same obj.nvdb mixed.nvdb
    same obj.tris mixed.tris
done <<'CASES'
s0.obj s1.ply s2.glb s3.obj
s0.glb s1.glb s2.obj s3.ply.gz
s0.ply s1.obj s2.ply s3.glb --threads 1 --memory 64M
CASES
# Positions of a file are moved before the files are put together.
ok $vox s0.obj s0.ply s0.glb s3.obj --translate 0,0,0 --translate 0,1,0 --translate 0,2,0 \
    --translate 0,0,0 -o moved.nvdb
ok $vox s0.obj s0.obj s0.obj s3.obj --translate 0,0,0 --translate 0,1,0 --translate 0,2,0 \
    --translate 0,0,0 -o plain.nvdb
same plain.nvdb moved.nvdb
# Faces are checked against the vertices of their own file.
printf 'v 0 0 0\nv 1 0 0\nf 1 2 3\nv 0 1 0\nf 1 2 4294967297\n' >beyond.obj
$vox s1.ply beyond.obj -o beyond.nvdb
refused 65 'bisque-voxelize: beyond.obj:5: face refers to vertex 4294967297, file has 3'

ok run bisque-voxelize --parse-only s0.obj s1.ply

# ---- indices belong to their file ----

printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n' >bad.obj
for other in s0.obj s0.ply; do
    $vox bad.obj $other -o bad.nvdb
    refused 65 "$p bad.obj:4: face refers to vertex 4, file has 3"
    $vox $other bad.obj s1.glb -o bad.nvdb
    refused 65 "$p bad.obj:4: face refers to vertex 4, file has 3"
done

# Two formats, and then a file whose format nobody can tell.
gzip -c s2.obj | head -c 9 >cut.obj.gz
$vox s0.obj s1.ply cut.obj.gz -o bad.nvdb
refused_like 65 "^$p cut.obj.gz: byte 9: truncated"

# ---- files that add nothing ----

: >empty.obj
: >empty.glb
: >zero.tris
echo 'v 0 0 0' >points.obj
printf 'solid a\nendsolid a\n' >none.stl
nothing='it adds nothing to the scan; files like this:'
while read -r files_and_line; do
    files=${files_and_line%%:*} line=${files_and_line#*:}
    ok $vox $files -o empty.nvdb
    holds "warning: $line" grep -Fqx "$p warning: $line" "$err"
    $vox $files -o strict.nvdb --strict
    refused 65 "$p $line"
done <<CASES
empty.obj s0.obj:empty.obj: an empty file, $nothing 1
s0.obj empty.obj:empty.obj: an empty file, $nothing 1
s0.ply empty.glb s0.obj empty.obj:empty.glb: an empty file, $nothing 2
points.obj s0.obj:points.obj: no faces, only vertices; $nothing 1
s0.obj none.stl:none.stl: no faces; $nothing 1
CASES
command="bisque-voxelize - s0.obj </dev/null" code=0
"$BIN/bisque-voxelize" - s0.obj --strict -o strict.nvdb </dev/null >"$out" 2>"$err" || code=$?
refused 65 "$p -: an empty file, $nothing 1"
$vox s1.obj -o s1.nvdb
for files in zero.tris 'zero.tris s0.obj' 's1.tris zero.tris s0.obj'; do
    $vox $files -o strict.nvdb
    refused 65 "$p zero.tris: damaged chunk file: the header is cut off"
done

# ---- attributes that some files lack ----

grep -v '^vn' s1.obj | sed 's,//[0-9]*,,g' >bare.obj
ok $vox s0.ply bare.obj -o bare.nvdb
grep -Fqx "$p warning: bare.obj: no normals, so its facets stay flat; other files of the scan have normals; files like this: 1" "$err"
check "warning of normals" $?
to_ply s0.obj '10 20 30' >color.ply
ok $vox color.ply s1.obj s2.glb -o white.nvdb --strict
grep -Fqx "$p warning: s1.obj: no vertex colours, so what has no texture is white; other files of the scan have vertex colours; files like this: 2" "$err"
check "warning of colours" $?
printf 'newmtl red\nKd 1 0 0\n' >red.mtl
{
    echo 'mtllib red.mtl'
    echo 'usemtl red'
    cat s1.obj
} >red.obj
ok $vox color.ply red.obj -o lost.nvdb
lost='red.obj: colours of materials are not used, because other files of the scan have vertex colours; files like this: 1'
holds "warning of lost colours" grep -Fqx "$p warning: $lost" "$err"
$vox color.ply red.obj -o strict.nvdb --strict
refused 65 "$p $lost"
printf '#MRGB ff102030ff102030ff102030\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' |
    awk '/^v/ { print; next } /^#/ { paint = $0; next } { print paint; print }' >paint.obj
ok $vox paint.obj s1.ply -o paint.nvdb
holds "warning of polypaint" grep -q "warning: paint.obj: ZBrush's polypaint is not used beside files without it" "$err"
ok $vox paint.obj color.ply -o paint.nvdb --strict
$vox color.ply paint.obj -o paint.nvdb --strict
code 65
finish

#!/bin/sh
# test_meshes.sh - several low-poly meshes, and objects and materials with maps of their own. The
# scan is a sheet, red on the left and green on the right.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake"
p=bisque-bake

# sheet NAME X R G: a square sheet in one colour whose left side is at X.
sheet()
{
    awk -v x="$2" -v r="$3" -v g="$4" 'BEGIN {
        for (j = 0; j <= 4; j++) for (i = 0; i <= 4; i++)
            print "v", x + i / 4, j / 4, 0, r, g, 0
        for (j = 0; j < 4; j++) for (i = 0; i < 4; i++) {
            a = 1 + 5 * j + i; print "f", a, a + 1, a + 6, a + 5
        } }' >"$1"
}
sheet red.obj 0 1 0
sheet green.obj 2 0 1
ok run bisque-voxelize red.obj green.obj -o scan.nvdb --voxel-size 0.03125

# square X STATEMENT FIRST [U]: a square above one of the sheets, after a statement. Its first
# vertex has the number FIRST; its chart begins at U.
square()
{
    awk -v x="$1" -v s="$2" -v f="$3" -v u="${4:-0}" 'BEGIN {
        for (i = 0; i < 4; i++) {
            a = i == 1 || i == 2; b = i > 1
            print "v", x + 0.125 + 0.75 * a, 0.125 + 0.75 * b, 0
            print "vt", u + a, b
        }
        if (s != "") print s
        print "f", f "/" f, f + 1 "/" f + 1, f + 2 "/" f + 2, f + 3 "/" f + 3 }'
}
{ square 0 "o left" 1; square 2 "o right" 5; } >low.obj
{ square 0 "usemtl paint" 1; square 2 "usemtl rust" 5; } >materials.obj
{ square 0 "" 1; } >left.obj
{ square 2 "" 1; } >right.obj
{ square 0 "o same" 1; } >a.obj
{ square 2 "g same" 1 1; } >b.obj
small="--device cpu --size 16 --samples 2 --maps color --front 0.1 --back 0.1 --padding 0"

# alone NAME: a map of a single mesh.
alone()
{
    ok $bake $small scan.nvdb "$1.obj" -o "alone_$1.exr"
}
alone left
alone right

# ---- maps of their own ----

for mesh in low.obj "left.obj right.obj"; do
    ok $bake $small scan.nvdb $mesh -o 'own_<OBJECT>.exr' --json
    json '[.tiles[].object] == ["left", "right"] and [.tiles[].maps.color] ==
        ["own_left.exr", "own_right.exr"] and .misses == 0 and .overlapping_samples == 0'
    same own_left.exr alone_left.exr
    same own_right.exr alone_right.exr
    rm own_*.exr
done
json '.mesh_path == "left.obj" and .mesh_paths == ["left.obj", "right.obj"]'
ok $bake $small scan.nvdb materials.obj -o 'own_<MATERIAL>.exr' --json
json '[.tiles[].material] == ["paint", "rust"] and [.tiles[].object] == [null, null]'
same own_paint.exr alone_left.exr
same own_rust.exr alone_right.exr
ok $bake $small scan.nvdb materials.obj left.obj -o '<OBJECT>.<MATERIAL>.exr'
same materials.paint.exr alone_left.exr
same materials.rust.exr alone_right.exr
same left.none.exr alone_left.exr
gzip -c left.obj >packed.obj.gz
ok $bake $small scan.nvdb packed.obj.gz -o '<OBJECT>.<MATERIAL>.exr'
same packed.none.exr alone_left.exr

# Objects with one name are one object, whose tiles are named too.
ok $bake $small scan.nvdb a.obj b.obj -o '<OBJECT>_<UDIM>.exr'
same same_1001.exr alone_left.exr
same same_1002.exr alone_right.exr
$bake $small scan.nvdb a.obj b.obj -o 'own_<OBJECT>.exr'
refused 64 "$p: the low-poly mesh is in several UDIM tiles: 1001, 1002; to bake all, put \"<UDIM>\" into the output's name; to bake one, select it (--tiles)"
ok $bake $small scan.nvdb low.obj b.obj -o '<OBJECT>.exr' --tiles 1002 --json
json '[.tiles[] | [.object, .tile]] == [["same", 1002]]'
same same.exr alone_right.exr

# ---- shared maps ----

# Two charts in one place: the first takes the samples, and all of them are counted.
ok $bake $small scan.nvdb left.obj right.obj -o shared.exr --json
json '.overlapping_samples == .samples and .samples == 1024'
same shared.exr alone_left.exr
holds "overlapping meshes are said" grep -q '100.0 % of the samples lie in several triangles' "$err"
ok $bake $small scan.nvdb a.obj b.obj -o 'shared_<UDIM>.exr'
same shared_1001.exr alone_left.exr
same shared_1002.exr alone_right.exr
ok $bake --list tiles a.obj b.obj
holds "tiles of several meshes" [ "$(cat "$out")" = "$(printf '1001\n1002')" ]

# ---- names that would lead elsewhere ----

mkdir inner
{ square 0 "o ../evil" 1; square 2 "o <MAP>" 5; } >names.obj
ok $bake $small scan.nvdb names.obj -o 'inner/<OBJECT>.exr'
same inner/_._evil.exr alone_left.exr
same inner/_MAP_.exr alone_right.exr
{ square 0 "o a/b" 1; square 2 "o a<b" 5; } >twins.obj
$bake $small scan.nvdb twins.obj -o 'twin_<OBJECT>.exr'
refused 64 "$p: twin_a_b.exr: two outputs have this name: those of the objects \"a/b\" and \"a<b\""
{ square 0 "usemtl a/b" 1; square 2 "usemtl a<b" 5; } >twins.obj
$bake $small scan.nvdb twins.obj -o 'twin_<MATERIAL>.exr'
refused 64 "$p: twin_a_b.exr: two outputs have this name: those of the materials \"a/b\" and \"a<b\""
$bake $small scan.nvdb twins.obj -o 'twin_<OBJECT>_<MATERIAL>.exr'
refused 64 "$p: twin_twins_a_b.exr: two outputs have this name: those of object \"twins\" with material \"a/b\" and of object \"twins\" with material \"a<b\""
$bake $small scan.nvdb low.obj -o 'own_<OBJECT>.png' --preview own_right.png
refused 64 "$p: own_right.png: two outputs have this name"
$bake $small scan.nvdb low.obj red.obj -o 'own_<OBJECT>.exr'
refused_like 65 'red.obj: no texture coordinates'

# ---- arguments ----

$bake $small low.obj left.obj right.obj -o x.exr
refused 64 "$p: 0 scans (.nvdb, .tris) and 3 low-poly meshes given (see --help)"
$bake $small scan.nvdb left.obj right.obj --cage left.obj -o x.exr
refused 64 "$p: left.obj: a cage needs a single low-poly file, not 2 of them"
$bake $small scan.nvdb left.obj missing.obj -o x.exr
code 66
holds "no map is left" [ ! -e x.exr ]

finish

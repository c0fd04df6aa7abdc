#!/bin/sh
# test_parts.sh - several chunk files as one scan: the voxels of a scan that was sorted whole.
. "$(dirname "$0")/lib.sh"
need_oracle
p=bisque-voxelize:

# write_sheet FROM TO X EXTRA: a hilly sheet, of which only the columns FROM to TO are written, moved
# by X. It is coarse, so that smooth normals across the seams matter.
write_sheet()
{
    awk -v from="$1" -v to="$2" -v move="$3" -v extra="$4" 'BEGIN {
        n = 40
        for (y = 0; y <= n; y++) for (x = from; x <= to; x++)
            printf "v %.6f %.6f %.6f%s\n", move + x / n, y / n, sin(x / 5) * cos(y / 6) / 4,
                extra == "color" ? " 0.8 0.4 0.2" : ""
        w = to - from + 1
        for (y = 0; y < n; y++) for (x = 0; x < w - 1; x++) {
            i = y * w + x + 1
            printf "f %d %d %d\nf %d %d %d\n", i, i + 1, i + w + 1, i, i + w + 1, i + w }
    }'
}

for columns in '0 40 whole' '0 11 a' '11 23 b' '23 40 c'; do
    set -- $columns
    write_sheet "$1" "$2" 0 '' >"$3.obj"
    ok run bisque-voxelize "$3.obj" --resolution 8 -o x.nvdb --tris "$3.tris"
done
vox="run bisque-voxelize --resolution 300"
ok $vox whole.tris -o whole.nvdb --json
jq -c '[.grid.voxels, .grid.leaves, .grid.index_min, .grid.index_max]' "$out" >whole.json
ok $vox a.tris b.tris c.tris -o parts.nvdb --json
jq -c '[.grid.voxels, .grid.leaves, .grid.index_min, .grid.index_max]' "$out" >parts.json
same whole.json parts.json

# The same voxels, and records that differ by rounding only: maps of both grids show it.
write_square 0 0 1 0 >low.obj
for grid in whole parts; do
    ok run bisque-bake $grid.nvdb low.obj --size 256 --samples 1 --maps normal,position \
        --front 1 --back 1 -o "${grid}_<MAP>.exr"
done
ok run bisque-compare --type normal whole_normal.exr parts_normal.exr --max-error 0.05
ok run bisque-compare --type data whole_position.exr parts_position.exr --max-error 1e-5
# Without the other parts, normals at a seam are wrong by degrees.
$vox b.tris -o alone.nvdb
run bisque-bake alone.nvdb low.obj --size 256 --samples 1 --maps normal,mask --front 1 --back 1 \
    -o "alone_<MAP>.exr"
run bisque-compare --type normal whole_normal.exr alone_normal.exr --mask alone_mask.exr --max-error 0.05
code 1

# Neither the order nor threads nor the budget change a byte.
ok $vox c.tris a.tris b.tris -o other.nvdb --threads 1 --memory 60MiB
same parts.nvdb other.nvdb
cp b.tris elsewhere.tris
ok $vox elsewhere.tris c.tris a.tris -o other.nvdb --threads 3
same parts.nvdb other.nvdb

# More parts than descriptors.
command='bisque-voxelize with 60 parts and 40 descriptors' code=0
set --
for i in $(seq 20); do set -- "$@" a.tris b.tris c.tris; done
(ulimit -n 40 && exec "$BIN/bisque-voxelize" --resolution 30 "$@" -o many.nvdb) >"$out" 2>"$err" ||
    code=$?
code 0

# Attributes of some parts only; an origin that is not 0.
write_sheet 11 23 0 color >d.obj
run bisque-voxelize d.obj --resolution 8 -o x.nvdb
cp x.tris d.tris
ok $vox a.tris d.tris c.tris -o colored.nvdb --json
json '.grid.has_color'
jq -c '[.grid.voxels, .grid.leaves, .grid.index_min, .grid.index_max]' "$out" >parts.json
same whole.json parts.json
write_sheet 0 11 500000 '' >far_a.obj
write_sheet 11 40 500000 '' >far_b.obj
write_sheet 0 40 500000 '' >far.obj
for name in far far_a far_b; do
    ok run bisque-voxelize $name.obj --origin 500000,0,0 -o $name.tris
done
$vox far.tris -o far.nvdb --json
jq -c '[.grid.index_min, .grid.index_max]' "$out" >whole.json
ok $vox far_a.tris far_b.tris -o far_parts.nvdb --json
jq -c '[.grid.index_min, .grid.index_max]' "$out" >parts.json
same whole.json parts.json

# ---- parts far from zero, which need one origin ----

# write_ball FROM TO: longitudes FROM to TO of a coarse sphere, in the coordinates of a map. They
# have more digits than float32 holds.
write_ball()
{
    awk -v from="$1" -v to="$2" 'BEGIN {
        n = 48; pi = atan2(0, -1); w = to - from + 1
        for (y = 1; y < 24; y++) for (x = from; x <= to; x++) {
            a = (x % n) * 2 * pi / n; b = y * pi / 24
            printf "v %.4f %.4f %.4f\n", 500123.4 + 100 * sin(b) * cos(a),
                4000321.7 + 100 * sin(b) * sin(a), 50.3 + 100 * cos(b) }
        for (y = 0; y < 22; y++) for (x = 0; x < w - 1; x++) {
            i = y * w + x + 1
            printf "f %d %d %d\nf %d %d %d\n", i, i + w, i + w + 1, i, i + w + 1, i + 1 }
    }'
}

for columns in '0 48 ball' '0 15 p1' '15 31 p2' '31 48 p3'; do
    set -- $columns
    write_ball "$1" "$2" >"$3.obj"
    ok run bisque-voxelize "$3.obj" -o "$3.tris"
done
for output in x.nvdb x.tris; do
    run bisque-voxelize p1.tris p2.tris p3.tris -o $output
    refused_like 65 "^$p p[123].tris and p[123].tris have different origins: sort one of them again with --origin [0-9.e+-]*,[0-9.e+-]*,[0-9.e+-]*\$"
done
sed 's/.*--origin //' "$err" >origin.txt
for part in p1 p2 p3; do
    ok run bisque-voxelize $part.obj -o $part.tris --origin "$(cat origin.txt)"
done
ok $vox ball.tris -o ball.nvdb --json
jq -c '[.grid.voxels, .grid.index_min, .grid.index_max]' "$out" >whole.json
ok $vox p1.tris p2.tris p3.tris -o ball_parts.nvdb --json
jq -c '[.grid.voxels, .grid.index_min, .grid.index_max]' "$out" >parts.json
same whole.json parts.json
ok $vox p3.tris p1.tris p2.tris -o other.nvdb --threads 1 --memory 60MiB
same ball_parts.nvdb other.nvdb
write_square 500023 4000221 200 160 >above.obj
above="above.obj --size 128 --samples 1 --maps normal --front 1 --back 150"
for grid in ball ball_parts; do
    ok run bisque-bake $grid.nvdb $above -o $grid.exr
done
# A crease at the seams is 3 degrees.
ok run bisque-compare --type normal ball.exr ball_parts.exr --max-error 0.2
# The parts become one chunk file, whose exact maps are those of the whole, in any order. Parts that
# are baked side by side have normals of their own at the seams.
ok run bisque-voxelize p1.tris p2.tris p3.tris -o joined.tris
ok run bisque-voxelize --verify joined.tris
ok run bisque-voxelize p3.tris p1.tris p2.tris -o again.tris --threads 1 --memory 60MiB
same joined.tris again.tris
$vox joined.tris -o other.nvdb
same ball_parts.nvdb other.nvdb
run bisque-bake ball.tris $above -o ball.exr
ok run bisque-bake joined.tris $above -o exact.exr
ok run bisque-compare --type normal ball.exr exact.exr --max-error 0.2
ok run bisque-bake p1.tris p2.tris p3.tris $above -o exact.exr
run bisque-compare --type normal ball.exr exact.exr --max-error 0.2
code 1
ok run bisque-compare --type normal ball.exr exact.exr --max-error 5
ok run bisque-bake p3.tris p1.tris p2.tris $above -o other.exr --threads 1
same exact.exr other.exr

# Other programs measure and simplify the whole, too, with meshes beside the parts or without.
ok run bisque-simplify joined.tris -o joined.ply --triangles 300
for inputs in 'p2.tris p3.tris p1.tris' 'p2.tris p3.obj p1.tris'; do
    # shellcheck disable=SC2086 # several words
    ok run bisque-simplify $inputs -o parts.ply --triangles 300 --threads 1 --memory 60MiB
    same joined.ply parts.ply
done
run bisque-compare joined.ply joined.tris
sed 's/joined.tris/p3.tris/' "$out" >joined.txt
ok run bisque-compare joined.ply p3.tris p1.tris p2.tris
same "$out" joined.txt

# ---- other normals than a chunk file has ----

ok run bisque-voxelize ball.obj --resolution 8 -o x.nvdb --tris angle.tris --scan-normals angle
ok run bisque-voxelize ball.tris -o made.tris --scan-normals angle
same angle.tris made.tris
ok run bisque-voxelize made.tris -o made2.tris --scan-normals area --threads 1
same ball.tris made2.tris
ok run bisque-voxelize ball.tris -o flat.tris --scan-normals flat
$vox angle.tris -o angle.nvdb
$vox ball.tris -o other.nvdb --scan-normals angle
same angle.nvdb other.nvdb
$vox flat.tris -o flat.nvdb
$vox ball.tris -o other.nvdb --scan-normals flat
same flat.nvdb other.nvdb
run bisque-bake ball.tris $above --scan normals=angle -o x.exr
refused 64 'bisque-bake: ball.tris has smooth (area) normals: "bisque-voxelize ball.tris -o FILE.tris --scan-normals angle" makes a file with those'
run bisque-bake flat.tris $above --scan normals=max -o x.exr
refused 64 'bisque-bake: flat.tris has no normals: "bisque-voxelize flat.tris -o FILE.tris --scan-normals max" makes a file with those'
run bisque-bake ball.tris $above --scan normals=flat -o flat.exr
ok run bisque-bake flat.tris $above -o other.exr
ok run bisque-compare --type normal flat.exr other.exr --max-error 0
run bisque-bake ball.tris $above --scan normals=smooth -o exact.exr
ok run bisque-bake made2.tris $above -o other.exr
ok run bisque-compare --type normal exact.exr other.exr --max-error 0
# Without an option, chunk files keep what they have, also with meshes beside them.
ok run bisque-voxelize flat.tris -o made.tris
same flat.tris made.tris
$vox p1.obj -o x.nvdb --tris angle1.tris --scan-normals angle
for option in '' '--scan-normals angle'; do
    ok run bisque-voxelize angle1.tris p2.obj p3.obj $option -o "made${option:+2}.tris"
    $vox angle1.tris p2.obj p3.obj $option -o "made${option:+2}.nvdb"
done
same made.tris made2.tris
same made.nvdb made2.nvdb
# Meshes beside chunk files become one with them.
ok run bisque-voxelize p1.tris p2.obj p3.tris -o again.tris
same joined.tris again.tris

# ---- misuse ----

for origin in 1,2 1,2,x 1,2,3,4 1,2,inf ''; do
    run bisque-voxelize a.obj -o y.tris --origin "$origin"
    refused 64 "$p --origin: \"$origin\" is not of the form X,Y,Z"
done
run bisque-voxelize a.tris -o y.nvdb --origin 1,2,3
refused 64 "$p a.tris is already a chunk file: leave out --origin"
run bisque-voxelize a.obj --origin 1e39,0,0 -o y.tris
code 65

sed 's/^v .*/&\nvn 0 0 1/; s/ \([0-9]*\)/ \1/g' a.obj | awk '/^f/ { print $1, $2 "//" 1, $3 "//" 1,
    $4 "//" 1; next } { print }' >n.obj
ok run bisque-voxelize n.obj --resolution 8 -o x.nvdb --tris n.tris
$vox n.tris b.tris -o y.nvdb
refused_like 65 "^$p n.tris has normals, b.tris has none: such parts cannot be one scan\$"
# ---- chunk files beside meshes ----

# The meshes are sorted to a temporary part, so the bytes are those of chunk files alone.
for inputs in "a.tris b.obj c.tris" "b.obj c.tris a.tris --threads 1 --memory 60MiB --no-tris"; do
    # shellcheck disable=SC2086 # several words
    ok $vox $inputs -o other.nvdb --json
    json '.scan.triangles == 960 and .tris_path == null'
    same parts.nvdb other.nvdb
    holds "no chunk file has the name of the whole" [ ! -e other.tris ]
done
command='bisque-voxelize a.tris - c.tris' code=0
"$BIN/bisque-voxelize" --resolution 300 a.tris - c.tris -o other.nvdb <b.obj >"$out" 2>"$err" || code=$?
code 0
same parts.nvdb other.nvdb
run bisque-voxelize b.obj c.obj --resolution 8 -o x.nvdb --tris bc.tris
$vox a.tris bc.tris -o two.nvdb
ok $vox b.obj a.tris c.obj -o other.nvdb --tris kept.tris
grep -q '^2 files: .* 2,320 triangles' "$out" && grep -q '^kept.tris: ' "$out"
check "the report tells which files were sorted" $?
same two.nvdb other.nvdb
same bc.tris kept.tris
$vox n.tris b.obj -o y.nvdb
refused_like 65 "^$p n.tris has normals, .* has none: such parts cannot be one scan\$"
while read -r options; do
    # shellcheck disable=SC2086 # several words
    $vox a.tris b.obj $options
    code 64
    read -r message
    err "$p $message"
done <<'CASES'
-o y.nvdb --channels roughness
--channels: beside chunk files, meshes are kept with --tris only
-o y.nvdb --scale 2
a.tris is a chunk file: --scale, --up and --translate are for meshes
--parse-only
a.tris: --parse-only reads meshes
CASES
head -c 5000 b.tris >cut.tris
$vox a.tris cut.tris -o y.nvdb
refused_like 65 "^$p cut.tris: damaged chunk file: "
$vox a.tris none.tris -o y.nvdb
code 66
cp a.tris victim.tris
$vox a.tris victim.tris -o victim.tris
code 64
holds "an input is not overwritten" cmp -s a.tris victim.tris
holds "no output" [ ! -e y.nvdb ]

# ---- a noisy scan: which records its voxels have depends neither on parts nor on the order of faces ----

# write_noisy ORDER FROM TO: a sheet so rough that many voxels have two records, with a colour for each
# vertex. ORDER: 1, or -1 for faces in the reverse order. Only the columns of faces FROM to TO are written.
write_noisy()
{
    awk -v order="$1" -v from="$2" -v to="$3" 'BEGIN {
        n = 60
        seed = 1
        for (y = 0; y <= n; y++) for (x = 0; x <= n; x++) {
            seed = seed * 16807 % 2147483647
            printf "v %.6f %.6f %.6f %.3f %.3f %.3f\n", x / n, y / n, seed / 2147483647 / 25,
                seed % 7 / 7, seed % 11 / 11, seed % 13 / 13
        }
        for (k = 0; k < n * n; k++) {
            j = order > 0 ? k : n * n - 1 - k
            x = j % n
            i = j + (j - x) / n + 1
            if (x < from || x > to)
                continue
            a = "f " i " " i + 1 " " i + n + 2
            b = "f " i " " i + n + 2 " " i + n + 1
            print (order > 0 ? a "\n" b : b "\n" a)
        }
    }'
}

noisy="run bisque-voxelize --resolution 50"
write_noisy 1 0 59 >noisy.obj
write_noisy -1 0 59 >reversed.obj
write_noisy 1 0 29 >left.obj
write_noisy 1 30 59 >right.obj
for normals in smooth flat; do
    for part in left right; do
        ok run bisque-voxelize $part.obj -o $part.tris
    done
    $noisy noisy.obj -o noisy.nvdb --scan-normals $normals
    $noisy reversed.obj -o reversed.nvdb --scan-normals $normals
    ok $noisy left.tris right.tris -o halves.nvdb --scan-normals $normals
    for grid in noisy reversed halves; do
        oracle measure $grid.nvdb
        grep -E '^(voxels|second_records) ' "$out" >$grid.counts
        ok run bisque-bake $grid.nvdb low.obj --size 128 --samples 1 --scan sampling=nearest --two-sided \
            --maps normal,color,position --type float --front 1 --back 1 -o "${grid}_<MAP>.exr"
    done
    holds "$normals normals: many voxels have two records" [ "$(sed -n 's/^second_records //p' noisy.counts)" -gt 100 ]
    for grid in reversed halves; do
        same noisy.counts $grid.counts
        ok run bisque-compare --type normal noisy_normal.exr ${grid}_normal.exr --max-error 0.05
        ok run bisque-compare --type data noisy_position.exr ${grid}_position.exr --max-error 1e-4
        ok run bisque-compare --type data noisy_color.exr ${grid}_color.exr --max-error 0.01
    done
done

# ---- channels and ids that some parts lack ----

printf 'newmtl glossy\nPr 0.5\nPm 1\n' >pbr.mtl
{ printf 'mtllib pbr.mtl\nusemtl glossy\n' && cat a.obj; } >pbr.obj
ok run bisque-voxelize pbr.obj -o pbr.tris --channels roughness,metallic
ok run bisque-voxelize pbr.obj -o rough.tris --channels id,roughness
for inputs in 'pbr.tris rough.tris' 'rough.tris pbr.tris'; do
    # shellcheck disable=SC2086 # several words
    ok run bisque-voxelize $inputs -o rough_all.tris
    holds "warning of the channel" grep -qx "$p warning: pbr.tris: the channel metallic is not kept, because rough.tris has none" "$err"
    holds "warning of the ids" grep -qE "$p warning: ids are not kept, because (pbr|rough).tris and (pbr|rough).tris do not have the same kind$" "$err"
    run bisque-voxelize --info rough_all.tris --json
    json '.files[0].channels == ["roughness"]'
    # shellcheck disable=SC2086
    ok run bisque-voxelize $inputs --resolution 100 --channels roughness -o x.nvdb
    holds "no warning of what a grid does not need" [ ! -s "$err" ]
    # shellcheck disable=SC2086
    run bisque-voxelize $inputs --resolution 100 --channels metallic -o y.nvdb
    refused 65 "$p the scan has no channel metallic: make it with bisque-voxelize --channels metallic"
done

# ---- colours that some parts lack ----

write_sheet 0 23 3 color >vertex.obj
printf 'newmtl red\nKd 1 0 0\n' >red.mtl
{ printf 'mtllib red.mtl\nusemtl red\n' && cat a.obj; } >red.obj
for part in vertex red; do
    ok run bisque-voxelize $part.obj -o $part.tris
done
plain='no vertex colours, so what has no texture is white; other parts of the scan have vertex colours; parts like this: 2'
ok $vox vertex.tris b.tris c.tris -o white.nvdb --strict
holds "warning of white parts" grep -Eqx "$p warning: [bc].tris: $plain" "$err"
ok run bisque-voxelize vertex.tris b.tris -o painted.tris --json
json '.scan.has_colors and (.scan.has_texcoords | not) and (.scan.has_normals | not)'
lost='red.tris: colours of materials are not used, because other parts of the scan have vertex colours; parts like this: 1'
ok $vox vertex.tris red.tris -o lost.nvdb
holds "warning of lost colours" [ "$(cat "$err")" = "$p warning: $lost" ]
$vox vertex.tris red.tris -o strict.nvdb --strict
refused 65 "$p $lost"
ok run bisque-bake vertex.tris red.tris low.obj --size 16 --samples 1 --front 1 --back 1 -o 'lost_<MAP>.png'
holds "a bake keeps both" [ "$(grep -c 'colours of materials are not used' "$err")" -eq 0 ]
ok $vox red.tris b.tris -o red.nvdb
holds "no warning of materials alone" [ ! -s "$err" ]

finish

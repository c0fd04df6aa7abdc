#!/bin/sh
# test_voxelize.sh - messages, exit codes and files of bisque-voxelize.
. "$(dirname "$0")/lib.sh"

vox="run bisque-voxelize"
write_box >box.obj

# ---- help and version ----

help_and_man_page bisque-voxelize
ok $vox --version
out_like '^bisque-voxelize [0-9]+\.[0-9]+\.[0-9]+$'

command="bisque-voxelize --version >/dev/full" code=0
"$BIN/bisque-voxelize" --version >/dev/full 2>"$err" || code=$?
: >"$out"
refused 74 "bisque-voxelize: standard output: No space left on device"

# ---- usage ----

p=bisque-voxelize:
$vox
refused 64 "$p no input file given (see --help)"
$vox box.obj
refused 64 "$p no output given: add -o FILE.nvdb"
$vox box.obj -o box.vdb
refused 64 "$p box.vdb: a grid is a NanoVDB file: give -o FILE.nvdb, and --vdb box.vdb for an OpenVDB file beside it"
$vox --nonsense
refused 64 "$p unrecognized option '--nonsense' (see --help)"
$vox box.obj -o
refused 64 "$p option requires an argument -- 'o'"
$vox box.obj -o a.nvdb --resolution 100 --voxel-size 1
refused 64 "$p --resolution and --voxel-size exclude each other"
$vox box.obj -o a.nvdb --tris a.tris --no-tris
refused 64 "$p --tris and --no-tris exclude each other"
$vox box.obj -o a.nvdb --parse-only
refused 64 "$p --parse-only writes nothing: leave out --output"
$vox box.obj -o a.nvdb --progress often
refused 64 "$p --progress: \"often\" is not auto, bar, none, json, openjd, percent or alf"
for n in 0 -1 12.5 1073741825 18446744073709551617 ''; do
    $vox box.obj -o a.nvdb --resolution "$n"
    refused 64 "$p --resolution: \"$n\" is not a whole number from 1 to 1073741824"
done
for x in 0 -1 inf 0x1p3 1e999 '' 1mm; do
    $vox box.obj -o a.nvdb --voxel-size "$x"
    refused 64 "$p --voxel-size: \"$x\" is not a positive number"
done
for size in 0 -1G G 1.5.2G 4GG 0x10 ''; do
    $vox box.obj -o a.nvdb --memory "$size"
    refused 64 "$p --memory: \"$size\" is not a size such as 512MiB or 4G"
done
for size in 1e30 8388608T 99999999T 9223372036854775808; do
    $vox box.obj -o a.nvdb --memory "$size"
    refused 64 "$p --memory: \"$size\" is too large a size: less than 8388608T is possible"
done
$vox box.obj -o a.nvdb --threads 0
refused 64 "$p --threads: \"0\" is not a whole number from 1 to 65536"
$vox box.obj -o a.nvdb --threads 1 --memory 1k
refused_like 71 '^bisque-voxelize: --memory: 1.0 KiB is too small, 1 thread needs at least [0-9]+MiB$'
least=$(sed 's/.*at least //' "$err")
files box.obj

# ---- inputs that cannot be read ----

$vox none.obj -o a.nvdb
refused 66 "$p none.obj: No such file or directory"
$vox box.obj none.obj -o a.nvdb
refused 66 "$p none.obj: No such file or directory"
mkdir dir
$vox dir -o a.nvdb
refused 66 "$p dir: Is a directory"
rmdir dir
$vox box.obj -o a.nvdb --texture none.png
refused 66 "$p none.png: No such file or directory"
: >empty.obj
$vox empty.obj -o a.nvdb
refused_like 65 'empty\.obj.*no faces'
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\np 1 2 3\n' >points.obj
$vox points.obj -o a.nvdb
refused 65 "$p points.obj: no faces, only points or lines"
rm points.obj
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n' >range.obj
$vox range.obj -o a.nvdb
refused 65 "$p range.obj:4: face refers to vertex 99, file has 3"
printf 'v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n' >nan.obj
$vox nan.obj -o a.nvdb
refused 65 "$p warning: nan.obj:3: vertices without a finite position: 1; this is the first
$p nan.obj:4: 1 of 1 faces have a vertex without a finite position, more than 1 %; this is the first"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n' >zero.obj
$vox zero.obj -o a.nvdb
refused_like 65 '^bisque-voxelize: zero\.obj:4: '
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 1 1\n' >flat.obj
$vox flat.obj -o a.nvdb
refused_like 65 '^bisque-voxelize: flat\.obj: '
files box.obj empty.obj flat.obj nan.obj range.obj zero.obj
rm empty.obj flat.obj nan.obj range.obj zero.obj

# ---- outputs that cannot be written ----

$vox box.obj -o none/a.nvdb
refused 73 "$p none/a.nvdb: cannot be created: there is no folder none"
$vox box.obj -o a.nvdb --vdb none/a.vdb
refused 73 "$p none/a.vdb: cannot be created: there is no folder none"
$vox box.obj -o a.nvdb --tris none/a.tris
refused 73 "$p none/a.tris: cannot be created: there is no folder none"
$vox box.obj -o /dev/null --tris a.tris
refused 73 "$p /dev/null: exists and is not a regular file"
$vox box.obj -o a.nvdb --no-tris --tmpdir none
refused_like 73 '^bisque-voxelize: none: temporary file for .*: No such file or directory$'
$vox box.obj -o box.obj
refused 64 "$p box.obj: this output would overwrite the scan"
$vox box.obj -o ./../here/box.obj
refused 64 "$p ./../here/box.obj: this output would overwrite box.obj, the scan"
$vox box.obj -o a.nvdb --vdb box.obj
refused 64 "$p box.obj: this output would overwrite the scan"
$vox box.obj -o a.nvdb --vdb ./a.nvdb
refused 64 "$p ./a.nvdb: two outputs have this name"
ok $vox box.obj -o a.grid --resolution 24
rm a.grid a.grid.tris
files box.obj

# ---- a box of 8 x 16 x 24 voxels: its surface is 8 * 16 * 24 - 6 * 14 * 22 voxels ----

ok $vox box.obj -o box.nvdb --resolution 24 --json --tmpdir .
json '.program == "bisque-voxelize" and .inputs == ["box.obj"]'
json '.grid_path == "box.nvdb" and .tris_path == "box.tris" and .vdb_path == null'
json '.scan.vertices == 8 and .scan.faces == 6 and .scan.triangles == 12'
json '.scan.degenerate_triangles == 0'
json '(.scan.has_colors | not) and (.scan.has_normals | not)'
json '.grid.triangles == 12 and .grid.voxels == 1224 and .grid.voxel_size == 0.125'
json '(.grid.index_max[2] - .grid.index_min[2]) == 23'
json '.cost.memory_high_bytes <= .cost.memory_budget_bytes and .cost.memory_high_bytes > 0'
json '.cost.max_rss_bytes > 0 and .cost.seconds > 0'
json ".grid.grid_bytes == $(wc -c <box.nvdb) and .scan.tris_bytes == $(wc -c <box.tris)"
files box.nvdb box.obj box.tris

ok $vox box.obj -o again.nvdb --resolution 24
out_like '^box\.obj: 8 vertices, 6 faces, 12 triangles, '
out_like '^again\.nvdb: 1,224 voxels in 8 x 16 x 24, voxel size 0\.125, '
out_like '^memory: .* of a budget of '
same box.nvdb again.nvdb
same box.tris again.tris
rm again.*

ok $vox box.tris -o again.nvdb --resolution 24 --json
json '.scan == null and .grid.voxels == 1224'
same box.nvdb again.nvdb
ok $vox box.tris -o again.nvdb --voxel-size 0.125 --no-tris
files again.nvdb box.nvdb box.obj box.tris
rm again.nvdb

ok $vox box.obj -o one.nvdb --resolution 24 --threads 1 --memory "$least" --json
json '.cost.memory_high_bytes <= .cost.memory_budget_bytes and .cost.threads == 1'
ok $vox box.obj -o eight.nvdb --resolution 24 --threads 8
same one.nvdb eight.nvdb
same one.tris eight.tris
rm one.* eight.*

if command -v nanovdb_validate >/dev/null; then
    run_validate=$(nanovdb_validate box.nvdb 2>&1)
    check "nanovdb_validate accepts the grid: $run_validate" $?
else
    lacks "nanovdb_validate accepts the grid" "not installed"
fi

ok $vox box.obj -o a.nvdb --no-tris --resolution 24 --vdb a.vdb --json
json '.vdb_path == "a.vdb" and .tris_path == null'
files a.nvdb a.vdb box.nvdb box.obj box.tris
if command -v vdb_print >/dev/null; then
    vdb_print a.vdb | grep -q surface
    check "OpenVDB reads the export" $?
else
    lacks "OpenVDB reads the export" "not installed"
fi
rm a.*

# ---- misuse of chunk files ----

$vox box.tris -o a.nvdb --tris b.tris
refused 64 "$p box.tris is already a chunk file: leave out --tris"
$vox box.tris -o a.nvdb --texture t.png
refused 64 "$p box.tris is already a chunk file: leave out --texture"
$vox box.tris --parse-only
refused 64 "$p box.tris: --parse-only reads meshes"
$vox box.tris -o box.tris
refused 64 "$p box.tris: this output would overwrite the scan"
head -c 100 box.tris >short.tris
$vox short.tris -o a.nvdb
refused_like 65 '^bisque-voxelize: short\.tris: '
$vox box.nvdb -o a.nvdb
refused_like 65 '^bisque-voxelize: box\.nvdb'
rm short.tris
files box.nvdb box.obj box.tris

# ---- variants of OBJ files ----

ok $vox --parse-only box.obj
out_like '^box\.obj: 8 vertices, 6 faces, '
ok $vox --parse-only box.obj box.obj --json
json '.scan.vertices == 16 and .scan.faces == 12 and .grid == null and .grid_path == null'

sed 's/$/\r/' box.obj >crlf.obj
ok $vox crlf.obj -o crlf.nvdb --resolution 24
same crlf.nvdb box.nvdb
# Without comments and blank lines at the end, with tabs, continued lines and exponents.
sed 's/ /\t/; s/ 2 0$/ 2e0 \\\n0/' box.obj | head -c -1 >odd.obj
ok $vox odd.obj -o odd.nvdb --resolution 24
same odd.nvdb box.nvdb
rm crlf.* odd.*

# Two files, each with its own indices, negative ones in the second.
head -n 8 box.obj >first.obj
cp first.obj second.obj
printf 'f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\n' >>first.obj
printf 'f -6 -5 -1 -2\nf -8 -4 -1 -5\nf -7 -6 -2 -3\n' >>second.obj
ok $vox first.obj second.obj -o two.nvdb --resolution 24 --json
json '.inputs == ["first.obj", "second.obj"]'
json '.scan.triangles == 12 and .grid.voxels == 1224'
rm first.obj second.obj two.*

# Parts that are left out are counted.
{
    cat box.obj
    printf 'v 0.5 0.5 0.5\nv 0.6 0.6 0.6\nf 1 1 2\nf 1 2 3 3\nf 1 2\nnonsense\ng group\n# end\n'
} >extra.obj
ok $vox extra.obj -o extra.nvdb --resolution 24 --json
json '.scan.degenerate_triangles == 2 and .scan.short_faces == 1'
json '.scan.skipped_lines == 1 and .grid.voxels == 1224'
ok $vox extra.obj -o extra.nvdb --resolution 24
grep -q '^left out: 2 degenerate triangles, 1 face with fewer than three corners' "$out"
check "what is left out" $?
line=$(($(wc -l <box.obj) + 6))
[ "$(cat "$err")" = "$p warning: extra.obj:$line: lines with statements that are not of the format: 1; this is the first" ]
check "a warning with the first unknown line" $?
rm extra.*

# A file name with special characters.
cp box.obj "a box.obj"
ok $vox "a box.obj" -o "a box.nvdb" --resolution 24
same "a box.nvdb" box.nvdb
rm "a box."*

# An output that is replaced keeps its permissions; a new one has those of any new file.
echo old >old.nvdb
chmod 600 old.nvdb
(umask 022 && "$BIN/bisque-voxelize" box.obj -o old.nvdb --resolution 24 --no-tris >"$out")
same old.nvdb box.nvdb
holds "permissions of a replaced file" [ "$(stat -c %a old.nvdb)" = 600 ]
rm old.nvdb
(umask 022 && "$BIN/bisque-voxelize" box.obj -o old.nvdb --resolution 24 --no-tris >"$out")
holds "permissions of a new file" [ "$(stat -c %a old.nvdb)" = 644 ]
rm old.nvdb

# ---- progress ----

ok $vox box.obj -o a.nvdb --resolution 24 --progress json --json
json '.grid.voxels > 0'
jq -es 'length > 0 and all(has("stage") and has("unit") and .done <= .total)' "$err" >"$work/jq"
check "progress as JSON lines" $?
ok $vox box.obj -o a.nvdb --resolution 24 --progress bar
holds "the bar is taken away in the end" grep -q "$(printf '\033')\\[K\$" "$err"
ok $vox box.obj -o a.nvdb --resolution 24 --progress percent
[ ! -s "$err" ] && percentages 's/^Progress: \([0-9]*\)%$/\1/p'
check "percentages on standard output rise from 0 to 100" $?
$vox box.obj -o a.nvdb --resolution 24 --progress percent --json
refused 64 "$p --json and this --progress both write to standard output"
rm a.*

# ---- colours in comments (ZBrush) are those of the vertices ----

# paint FILE COUNT: adds comments with colours for COUNT vertices after the last vertex of colored.obj.
awk '/^v / { n++; print $1, $2, $3, $4, n * 7 % 256, n * 31 % 256, n * 101 % 256; next } { print }' box.obj >colored.obj
paint()
{
    awk -v most="$2" '/^v / { print $1, $2, $3, $4; c[++n] = sprintf("%02X%02x%02x%02X", n % 256, $5, $6, $7); next }
        n && !done { for (i = 1; i <= most; i++) printf "%s%s", i % 64 == 1 ? "\n#MRGB " : "", (i > n) ? "ffffffff" : c[i]; print ""; done = 1 }
        { print }' colored.obj >"$1"
}
vertices=$(grep -c '^v ' colored.obj)
ok $vox colored.obj -o colored.nvdb --resolution 24
paint zbrush.obj "$vertices"
ok $vox zbrush.obj -o zbrush.nvdb --resolution 24
holds "no warning of polypaint" [ ! -s "$err" ]
same zbrush.nvdb colored.nvdb
same zbrush.tris colored.tris
# The comments may follow the faces.
{ grep -v '#MRGB' zbrush.obj; grep '#MRGB' zbrush.obj; } >after.obj
ok $vox after.obj -o after.nvdb --resolution 24
same after.tris colored.tris
# Each of two files has its own colours.
$vox colored.obj colored.obj -o two.nvdb --resolution 24
ok $vox colored.obj zbrush.obj -o mixed.nvdb --resolution 24
ok $vox zbrush.obj after.obj -o painted.nvdb --resolution 24
same painted.tris two.tris
ok $vox zbrush.obj colored.obj -o mixed.nvdb --resolution 24
same mixed.tris two.tris
# Colours of vertices' own lines win.
{ cat colored.obj; grep '#MRGB' zbrush.obj | tr 0-9 9; } >both.obj
ok $vox both.obj -o both.nvdb --resolution 24
holds "no warning where there are colours" [ ! -s "$err" ]
same both.tris colored.tris
# Colours that do not fit the vertices are not used.
$vox box.obj -o plain.nvdb --resolution 24
for count in $((vertices - 1)) $((vertices + 1)) text; do
    if [ "$count" = text ]; then
        sed 's/^#MRGB .*/&0/' zbrush.obj >wrong.obj
    else
        paint wrong.obj "$count"
    fi
    ok $vox wrong.obj -o wrong.nvdb --resolution 24
    [ "$(cat "$err")" = "$p warning: wrong.obj: ZBrush's polypaint is not used, as it is not one colour for each vertex: export a texture of it for --texture" ]
    check "a warning of $count colours for $vertices vertices" $?
    same wrong.tris plain.tris
done
# The comments may be in other blocks of text than the vertices.
awk 'BEGIN { n = 250
    for (i = 0; i < n * n; i++) printf "v %.6f %.6f %.6f %d %d %d\n", i % n / n, int(i / n) / n, i * 37 % 101 / 9999, i % 256, i * 7 % 256, 255
    for (y = 1; y < n; y++) for (x = 1; x < n; x++) { a = (y - 1) * n + x; print "f", a, a + 1, a + n + 1, a + n } }' >colored.obj
paint zbrush.obj 62500
$vox colored.obj -o colored.nvdb --resolution 24
for options in '--threads 1' '--threads 3 --memory 100MiB'; do
    ok $vox zbrush.obj -o zbrush.nvdb --resolution 24 $options
    same zbrush.tris colored.tris
done
rm zbrush.* colored.* after.* two.* mixed.* painted.* both.* plain.* wrong.*

# ---- singular and plural ----

printf 'v 0 0 0 1 1 300\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >one.obj
ok $vox one.obj -o one.nvdb --resolution 1
grep -Eq '^one\.obj: 3 vertices, 1 face, 1 triangle, 40 B, ' "$out" && grep -Eq '^one\.tris: 1 chunk, ' "$out" &&
    grep -Eq '^one\.nvdb: 1 voxel in 1 x 1 x 1, ' "$out" &&
    [ "$(cat "$err")" = "$p warning: one.obj: colours out of range were clamped at 1 vertex" ]
check "counts of one" $?
rm one.*

# ---- failures during the work leave no partial output ----

$vox box.obj -o a.nvdb --no-tris --voxel-size 1e-12
refused_like 64 '^bisque-voxelize: .*voxel size of 1e-12'
files box.nvdb box.obj box.tris
# A grid that would take years is refused at once.
$vox box.obj -o a.nvdb --no-tris --voxel-size 1e-8
refused 64 "$p a.nvdb: about 2.2e+17 voxels of 1e-08 would be in the grid, which has no more than 4294967295 leaves of 8x8x8; \
choose larger voxels"
files box.nvdb box.obj box.tris

command="bisque-voxelize with a file size limit" code=0
(ulimit -f 8 && exec "$BIN/bisque-voxelize" box.obj -o a.nvdb --no-tris --resolution 512) \
    >"$out" 2>"$err" || code=$?
refused_like 74 '^bisque-voxelize: .*File too large$'
files box.nvdb box.obj box.tris

for signal in TERM INT HUP; do
    interrupted $signal voxelizing bisque-voxelize box.obj -o a.nvdb --no-tris --resolution 500
    files box.nvdb box.obj box.tris
done

finish

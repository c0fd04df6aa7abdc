#!/bin/sh
# test_verify.sh - --verify: valid files, damage anywhere, other versions, and
# files of other machines and programs.
. "$(dirname "$0")/lib.sh"

p=bisque-voxelize:
verify="run bisque-voxelize --verify"

# put FILE OFFSET BYTE...: writes bytes, given as numbers.
put()
{
    file=$1 at=$2
    shift 2
    for byte; do
        printf "\\$(printf %o "$byte")"
    done | dd of="$file" bs=1 seek="$at" conv=notrunc status=none
}

# byte FILE OFFSET: prints a byte as a number.
byte()
{
    od -An -tu1 -j "$2" -N 1 "$1" | tr -d ' '
}

write_box >box.obj
run bisque-voxelize box.obj -o box.nvdb --resolution 24 --scan-normals flat

# ---- valid files, alone and together ----

tris_line="box.tris: ok (chunk file of version 7: 12 triangles and 8 vertices in 1 chunk, $(wc -c <box.tris) B)"
ok $verify box.tris
[ "$(cat "$out")" = "$tris_line" ] && [ ! -s "$err" ]
check "$tris_line" $?
ok $verify box.nvdb box.tris
out_like '^box\.nvdb: ok \(surface grid of version 2: 1,224 voxels and 0 second records of 12 triangles, '
out_like '^box\.tris: ok '
ok $verify box.tris box.nvdb --json
json '.files | map(.ok) == [true, true]'
json '.files[0] | .kind == "tris" and .version == 7 and .triangles == 12 and .vertices == 8 and .chunks == 1'
json '.files[1] | .kind == "nvdb" and .voxels == 1224 and .voxel_size == 0.125'
files box.obj box.nvdb box.tris

# Threads that the machine has no use for are not started.
ok $verify box.nvdb --json --threads 65536
used=$(jq .cost.threads "$out")
[ "$used" -ge 64 ] && [ "$used" -lt 65536 ] &&
    [ "$(cat "$err")" = "$p warning: 65536 threads are more than this machine can use: $used are used" ]
check "a warning says that $used of 65536 threads are used" $?
ok $verify box.nvdb --json --threads 64
json '.cost.threads == 64'

# Attributes, several chunks, second records; memory for one chunk is enough.
"$TESTS/generate-scan" --triangles 150000 --colors --normals --uvs vase -o vase.obj
printf 'newmtl glaze\nKd .2 .4 .6\nmap_Kd dot.ppm\n' >vase.mtl
printf 'P3 1 1 255 9 9 9\n' >dot.ppm
{ printf 'mtllib vase.mtl\nusemtl glaze\n'; cat vase.obj; } >full.obj
ok run bisque-voxelize full.obj -o full.nvdb --resolution 300 --vdb full.vdb
ok $verify full.tris full.nvdb --json --threads 4 --memory 12M
json '.files[0].chunks > 2 and .files[1].has_color and .cost.memory_high_bytes < 12 * 1048576'
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 0 .02\nv 1 0 .02\nv 1 1 .02\nf 3 2 1\nf 4 5 6\n' >sheet.obj
run bisque-voxelize sheet.obj -o sheet.nvdb --resolution 16
ok $verify sheet.nvdb
out_like ' and [1-9][0-9]* second records of 2 triangles, '

# ---- all damaged files are reported; the exit code is that of the first ----

cp box.tris bad.tris
put bad.tris 200 $((255 - $(byte bad.tris 200)))
$verify bad.tris missing box.nvdb
code 65
[ "$(cat "$err")" = "$p bad.tris: damaged chunk file: chunk 0: the checksum does not match
$p missing: No such file or directory" ]
check "both failures are reported" $?
grep -q '^box\.nvdb: ok ' "$out" && [ "$(wc -l <"$out")" -eq 1 ]
check "and the sound file too" $?
$verify missing bad.tris
code 66
$verify bad.tris --json
code 65
json '.files == [{path: "bad.tris", ok: false, status: 65, error: "bad.tris: damaged chunk file: chunk 0: the checksum does not match"}]'

# ---- each changed byte is found ----

# damage FILE OFFSET...: the file is refused after any of these bytes is changed.
damage()
{
    file=$1 unseen= count=0
    shift
    for offset; do
        before=$(byte "$file" "$offset")
        put "$file" "$offset" $((before ^ 64))
        $verify "$file"
        [ "$code" -eq 65 ] && [ "$(wc -l <"$err")" -eq 1 ] && [ ! -s "$out" ] || unseen="$unseen $offset"
        put "$file" "$offset" "$before"
        count=$((count + 1))
    done
    $verify "$file"
    [ "$code" -eq 0 ] && [ -z "$unseen" ]
    check "each of $count damaged bytes of $file is found${unseen:+, not$unseen}" $?
}

end=$(wc -c <box.tris)
damage box.tris $(seq 0 3 $((end - 1)))
end=$(wc -c <box.nvdb)
damage box.nvdb $(seq 0 23 1100) $(seq 1101 9001 $((end - 2200))) $(seq $((end - 2199)) 47 $((end - 1)))
for file in box.tris box.nvdb; do
    head -c "$(($(wc -c <$file) / 2))" $file >part
    $verify part
    code 65
    { cat $file; echo; } >part
    $verify part
    code 65
done

# ---- files of other kinds: messages say what they are ----

# other FILE LINE: refused with this line.
other()
{
    $verify "$1"
    refused 65 "$p $1: $2"
}
reads='Bisque reads 32.4.2; make the grid with bisque-voxelize'
cp box.tris x.tris
put x.tris 8 8
other x.tris 'chunk file of version 8, this program reads version 7'
for version in 1 2 3 4 5 6; do
    put x.tris 8 $version
    other x.tris "version $version of chunk files is no longer read: sort the scan again with bisque-voxelize"
done
head -c 152 x.tris >short.tris # the length of an empty file of version 6
other short.tris 'version 6 of chunk files is no longer read: sort the scan again with bisque-voxelize'
run bisque-bake x.tris box.obj -o map.exr
refused 65 'bisque-bake: x.tris: version 6 of chunk files is no longer read: sort the scan again with bisque-voxelize'
put x.tris 8 0 0 0 7
other x.tris 'chunk file with its bytes in big-endian order: Bisque reads little-endian ones'
# A version is major << 21 | minor << 10 | patch.
cp box.nvdb x.nvdb
put x.nvdb 8 0 36 0 5
other x.nvdb "NanoVDB file of version 40.9.0: $reads"
put x.nvdb 8 0 28 0 4
other x.nvdb "NanoVDB file of version 32.7.0: $reads"
put x.nvdb 8 0 24 0 4 # as grids of type onindex had
other x.nvdb "NanoVDB file of version 32.6.0: $reads"
put x.nvdb 7 50 # "NanoVDB2", as newer files begin
other x.nvdb "NanoVDB file of version 32.6.0: $reads"
put x.nvdb 7 49
other x.nvdb 'a NanoVDB grid without file header'
printf '0BDVonaN' | dd of=x.nvdb conv=notrunc status=none
other x.nvdb 'NanoVDB file of a big-endian machine: Bisque reads little-endian ones'
cp box.nvdb x.nvdb
put x.nvdb $(($(wc -c <box.nvdb) - 184)) 9
other x.nvdb 'surface grid of version 9: this Bisque reads versions 2 to 4'

for type in 1:float 6:Vec3f 19:Index 20:OnIndex 21:IndexMask; do
    cp box.nvdb x.nvdb
    put x.nvdb 48 "${type%:*}"
    other x.nvdb "grid \"surface\" of type ${type#*:} is not a Bisque surface grid"
done
cp box.nvdb x.nvdb
put x.nvdb 48 99 # a type that NanoVDB may have some day
other x.nvdb 'grid "surface" of type number 99 is not a Bisque surface grid'
cp box.nvdb y.nvdb # another program's grid: the name has no padding
put y.nvdb 152 8
other y.nvdb 'grid "surface" of type Mask is not a Bisque surface grid'

# Grids of NanoVDB's own tool: of another type, of the same type, compressed, several.
if command -v nanovdb_convert >/dev/null; then
    nanovdb_convert -f -g N full.vdb n.nvdb >/dev/null 2>&1
    other n.nvdb 'grid "N" of type Vec3f is not a Bisque surface grid'
    nanovdb_convert -f -g surface full.vdb m.nvdb >/dev/null 2>&1
    other m.nvdb 'grid "surface" of type Mask is not a Bisque surface grid'
    nanovdb_convert -f -z -g surface full.vdb z.nvdb >/dev/null 2>&1
    other z.nvdb 'compressed NanoVDB file (codec ZIP): Bisque reads uncompressed ones'
else
    lacks "grids of NanoVDB's own tool" "nanovdb_convert is not installed"
fi
other full.vdb 'neither a chunk file nor a NanoVDB file, but an OpenVDB file'
other box.obj 'neither a chunk file nor a NanoVDB file; bisque-voxelize makes both from a mesh'
: >empty
other empty 'neither a chunk file nor a NanoVDB file'
$verify .
code 66

# The baker gives the same message.
run bisque-bake y.nvdb box.obj -o map.exr
refused 65 'bisque-bake: y.nvdb: grid "surface" of type Mask is not a Bisque surface grid'

# ---- usage ----

$verify
refused 64 "$p no input file given (see --help)"
$verify box.tris -o out.nvdb
refused 64 "$p --verify only checks files: leave out --output"
$verify box.tris --resolution 9
refused 64 "$p --verify only checks files: leave out --resolution"
finish

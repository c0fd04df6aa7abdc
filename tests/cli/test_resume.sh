#!/bin/sh
# test_resume.sh - --resume: what a job had finished when it was killed is used again, and only for the same job.
. "$(dirname "$0")/lib.sh"

p=bisque-voxelize:
voxelize="run bisque-voxelize"

# stopped ARGUMENT...: a run that sorts the scan and then fails, as no file may have more than 100 KiB.
stopped()
{
    command="bisque-voxelize $*" code=0
    (ulimit -f 200 && exec "$BIN/bisque-voxelize" "$@") >"$out" 2>"$err" || code=$?
    holds "stopped after sorting" [ "$code" -eq 74 ]
}

write_box >box.obj
printf 'newmtl red\nKd .8 .1 .1\n' >box.mtl
{ printf 'mtllib box.mtl missing.mtl\nusemtl red\n'; cat box.obj; } >a.obj
mkdir whole
ok $voxelize a.obj -o whole/box.nvdb --resolution 32
[ "$(ls -A whole)" = 'box.nvdb
box.tris' ]
check "a finished job leaves no note" $?

# ---- a job that was stopped goes on, and gives the same bytes ----

stopped a.obj -o box.nvdb --resolution 32
start="a.obj box.mtl box.obj box.tris box.tris.job whole"
files $start
cp box.tris.job job
ok $voxelize a.obj -o box.nvdb --resolution 32 --resume --json
json '.resumed and .scan == null and .grid.voxels > 0'
same box.nvdb whole/box.nvdb
same box.tris whole/box.tris
files a.obj box.mtl box.nvdb box.obj box.tris job whole
# With the note again (a job that is killed just before its end), and other options of the grid: only that is made.
cp job box.tris.job
rm box.nvdb
ok $voxelize a.obj -o box.nvdb --resolution 40 --resume --memory 100M --threads 1
grep -q '^box\.tris: complete from the run before, reading and sorting were skipped$' "$out" && ! grep -q vertices "$out"
check "it says what it skipped" $?
$voxelize whole/box.tris -o forty.nvdb --resolution 40
same box.nvdb forty.nvdb
rm box.nvdb forty.nvdb

# ---- nothing to go on from: the whole job ----

ok $voxelize a.obj -o box.nvdb --resolution 32 --resume --json
json '.resumed == false and .scan.triangles == 12'
same box.nvdb whole/box.nvdb
for damage in 'rm box.tris' ': >box.tris' 'cp other.tris box.tris' 'head -c 60 job >box.tris.job' ': >box.tris.job' \
    'head -c -1 job >box.tris.job' \
    'sed s/job.3/job.4/ job >box.tris.job' 'sed "s/version [0-9]*/version 99/" job >box.tris.job' \
    'sed "s/obj /tex /" job >box.tris.job'; do
    cp whole/box.tris box.tris
    printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >other.obj
    $voxelize other.obj -o other.nvdb --resolution 4
    cp job box.tris.job
    sh -c "$damage"
    ok $voxelize a.obj -o box.nvdb --resolution 32 --resume --json
    json '.resumed == false and .scan.triangles == 12'
    same box.tris whole/box.tris
done
rm -f other.* box.nvdb

# A complete chunk file is used as it is; damage inside of it is found where it is read.
cp whole/box.tris box.tris
printf 'X' | dd of=box.tris bs=1 seek=200 conv=notrunc status=none
cp job box.tris.job
$voxelize a.obj -o box.nvdb --resume
refused 65 "$p box.tris: damaged chunk file: chunk 0: the checksum does not match"
cp whole/box.tris box.tris

# ---- another job is refused, with what is another ----

here=$(pwd -P)
# refuses CODE LINE ARGUMENT...: and leaves everything as it was.
refuses()
{
    number=$1 line=$2
    shift 2
    cp job box.tris.job
    $voxelize "$@" -o box.nvdb --resume
    refused "$number" "$p $line: this job cannot be resumed"
    cmp -s box.tris whole/box.tris && cmp -s job box.tris.job && [ ! -e box.nvdb ]
    check "nothing was touched" $?
}
refuses 64 "box.tris was made from $here/a.obj, not from $here/box.obj" box.obj
refuses 64 "box.tris was made from fewer files, not from $here/box.obj" a.obj box.obj
printf 'P3 1 1 255 9 9 9\n' >dot.ppm
refuses 64 "box.tris was made from fewer files, not from $here/dot.ppm" a.obj --texture dot.ppm
cp -p a.obj kept.obj
cp -p box.mtl kept.mtl
echo '# more' >>a.obj
refuses 65 "$here/a.obj has changed since box.tris was made from it" a.obj
sed 's/^v 1 2 3$/v 1 2 4/' kept.obj >a.obj
touch -r kept.obj a.obj
refuses 65 "$here/a.obj has changed since box.tris was made from it" a.obj
cp kept.obj a.obj
refuses 65 "$here/a.obj has changed since box.tris was made from it" a.obj
cp -p kept.obj a.obj
echo 'Kd 0 0 0' >>box.mtl
refuses 65 "$here/box.mtl has changed since box.tris was made from it" a.obj
rm box.mtl
refuses 65 "$here/box.mtl has changed since box.tris was made from it" a.obj
cp -p kept.mtl box.mtl
rm a.obj
$voxelize a.obj -o box.nvdb --resume
refused 66 "$p a.obj: No such file or directory"
cp -p kept.obj a.obj
# Put back as it was, the job goes on, from another directory too, and with odd names.
cp job box.tris.job
mkdir elsewhere
cd elsewhere || exit 1
$voxelize ../a.obj -o ../box.nvdb --resolution 32 --resume --json
cd ..
code 0
json .resumed
same box.nvdb whole/box.nvdb
odd='100% of
it .obj'
cp box.obj "$odd"
stopped "$odd" -o odd.nvdb
ok $voxelize "$odd" -o odd.nvdb --resume --json
json .resumed

# A pipe cannot be read again, so its job has no note.
"$BIN/bisque-voxelize" - -o piped.tris --texture dot.ppm <box.obj >"$out" 2>"$err"
code=$? command="bisque-voxelize - --texture dot.ppm"
code 0
holds "no note of a pipe" [ ! -e piped.tris.job ]
"$BIN/bisque-voxelize" - -o piped.nvdb --resume <box.obj >"$out" 2>"$err"
code=$? command="bisque-voxelize - --resume"
refused 64 "$p - is a pipe or no file, which cannot be read again: if piped.tris is complete, make the grid from it instead of resuming"

# ---- killed while it voxelizes ----

rm -rf *
"$TESTS/generate-scan" --triangles 100000 vase -o vase.obj
ok $voxelize vase.obj -o whole.nvdb --resolution 1500
"$BIN/bisque-voxelize" vase.obj -o vase.nvdb --resolution 1500 >/dev/null 2>&1 &
wait_for vase.tris.job
kill -9 $!
wait $! 2>/dev/null
holds "killed before the grid was there" [ ! -e vase.nvdb ]
ok $voxelize vase.obj -o vase.nvdb --resolution 1500 --resume --json
json .resumed
same vase.nvdb whole.nvdb
same vase.tris whole.tris
holds "the note is gone" [ ! -e vase.tris.job ]

# ---- usage ----

$voxelize vase.obj -o x.nvdb --resume --no-tris
refused 64 "$p --resume continues from a chunk file: leave out --no-tris"
$voxelize vase.obj --parse-only --resume
refused 64 "$p --resume continues from a chunk file: leave out --parse-only"
$voxelize vase.tris -o x.nvdb --resume
refused 64 "$p vase.tris is already a chunk file: leave out --resume"
finish

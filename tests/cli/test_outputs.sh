#!/bin/sh
# test_outputs.sh - outputs that exist, are links, devices or other outputs; all outputs of a job or
# none; few descriptors.
. "$(dirname "$0")/lib.sh"
p=bisque-voxelize:

"$TESTS/generate-scan" -n 20000 --colors vase -o scan.obj
"$TESTS/generate-scan" vase-low -o low.obj
ok run bisque-voxelize scan.obj -o scan.nvdb --resolution 48
voxelize() { run bisque-voxelize scan.tris --resolution 48 "$@"; }
bake() { run bisque-bake scan.nvdb low.obj --device cpu --size 32 --samples 1 "$@"; }
inputs=$(ls)

# none_left: there are only the inputs.
none_left()
{
    holds "nothing is left: $command" [ "$(ls -A)" = "$inputs" ]
}

# ---- what cannot be replaced ----

mkfifo pipe
voxelize -o pipe
refused 73 "$p pipe: exists and is not a regular file"
voxelize -o /dev/null
refused 73 "$p /dev/null: exists and is not a regular file"
voxelize -o /dev/full
refused 73 "$p /dev/full: exists and is not a regular file"
mkdir folder
voxelize -o folder
refused 73 "$p folder: Is a directory"
voxelize -o folder/
refused 73 "$p \"folder/\" is not a file name"
for option in -o --vdb; do
    voxelize -o out.nvdb $option -
    refused 73 "$p -: no output can be standard output; ./- is a file of this name"
done
voxelize -o scan.obj/grid.nvdb
refused 73 "$p scan.obj/grid.nvdb: cannot be created: Not a directory"
command="standard output is a pipe" code=0
"$BIN/bisque-voxelize" scan.tris -o /dev/stdout 2>"$err" | cat >"$out"
err "$p /dev/stdout: exists and is not a regular file"
rmdir folder
rm pipe
none_left

# As another user, for whom permissions count.
if [ "$(id -u)" -eq 0 ] && command -v setpriv >/dev/null; then
    mkdir sticky && chmod 1777 sticky && echo root >sticky/out.nvdb && chmod 666 sticky/out.nvdb
    mkdir closed && chmod 755 closed
    chmod 755 . .. && chmod a+r scan.*
    other() { command="as another user: $*" code=0; setpriv --reuid 12345 --clear-groups "$BIN/$@" >"$out" 2>"$err" || code=$?; }
    other bisque-voxelize scan.tris -o sticky/out.nvdb --resolution 16
    refused 73 "$p sticky/out.nvdb: cannot be replaced: Operation not permitted"
    other bisque-voxelize scan.tris -o closed/out.nvdb --resolution 16
    refused 73 "$p closed/out.nvdb: cannot be created: Permission denied"
    other bisque-voxelize scan.tris -o sticky/new.nvdb --resolution 16
    code 0
    rm -r sticky closed
else
    skip "permissions of another user" "needs root and setpriv"
fi

echo old >fixed.nvdb
if command -v chattr >/dev/null && chattr +a fixed.nvdb 2>/dev/null; then
    voxelize -o fixed.nvdb
    refused 73 "$p fixed.nvdb: cannot be replaced: Operation not permitted"
    chattr -a fixed.nvdb
else
    skip "an output that can only be appended to" "needs chattr"
fi
rm fixed.nvdb

# A file that is mounted, as containers do, cannot be renamed over.
echo old >mounted.nvdb
command="unshare" code=0
if unshare -rm sh -c 'mount --bind mounted.nvdb mounted.nvdb' >/dev/null 2>&1; then
    command="an output that is a mount point" code=0
    unshare -rm sh -c 'mount --bind mounted.nvdb mounted.nvdb && exec "$0" scan.tris -o mounted.nvdb' "$BIN/bisque-voxelize" >"$out" 2>"$err" || code=$?
    refused 73 "$p mounted.nvdb: cannot be replaced: Device or resource busy"
else
    skip "an output that is a mount point" "mounting is not allowed"
fi
rm mounted.nvdb
none_left

# ---- two outputs with one name ----

twice() { err_like ": two outputs have this name\$" && code 64; }
ln -s b.nvdb a.nvdb
voxelize -o a.nvdb --vdb b.nvdb
twice
voxelize -o b.nvdb --vdb ./a.nvdb
twice
mkdir d && ln -s ../b.nvdb d/c.nvdb
voxelize -o d/../a.nvdb --vdb d/c.nvdb
twice
rm -r a.nvdb d
echo old >a.png && ln a.png b.png
bake --maps normal -o a.png --preview b.png
twice
rm a.png b.png
bake --maps normal -o 'x.png' --preview "$PWD/x.png"
twice
none_left

# ---- links, modes ----

mkdir store
ln -s store/grid.nvdb link.nvdb
voxelize -o link.nvdb
code 0
[ -L link.nvdb ] && [ -f store/grid.nvdb ]
check "a link to a file that does not exist is followed" $?
same store/grid.nvdb scan.nvdb
chmod 600 store/grid.nvdb
voxelize -o link.nvdb
code 0
[ -L link.nvdb ] && [ "$(stat -c %a store/grid.nvdb)" = 600 ]
check "the mode of an output is kept" $?
rm -r link.nvdb store
ln -s loop-b loop-a && ln -s loop-a loop-b
voxelize -o loop-a
refused 73 "$p loop-a: cannot be created: Too many levels of symbolic links"
rm loop-a loop-b
(umask 077 && "$BIN/bisque-voxelize" scan.tris -o new.nvdb --resolution 16 >"$out" 2>"$err")
holds "a new output has the mode that the umask leaves" [ "$(stat -c %a new.nvdb)" = 600 ]
rm new.nvdb
none_left

# ---- all outputs of a job, or none ----

run bisque-voxelize scan.tris -o a.nvdb --resolution 400 --vdb a.vdb --memory 64M --threads 1
refused_like 71 "the OpenVDB export"
none_left
echo old >a.nvdb
run bisque-voxelize scan.tris -o a.nvdb --resolution 400 --vdb a.vdb --memory 64M --threads 1
code 71
holds "the old grid stays if the export fails" [ "$(cat a.nvdb)" = old ]
rm a.nvdb
none_left

# ---- files of users ----

for name in .a.nvdb.backup.tmp .a.nvdb.abc123.tmp .a.nvdb.0123456789ab.tmp .a.nvdb.tmp; do
    echo "a user's" >$name
    voxelize -o a.nvdb
    code 0
    holds "$name is not removed" [ "$(cat $name)" = "a user's" ]
    rm $name
done
rm a.nvdb

# ---- few descriptors ----

# few PROGRAM ARGUMENT...: with each small number of descriptors the job succeeds, or says in one
# line that there are too many open files, and leaves nothing.
few()
{
    limit=3 code=1
    while [ "$code" -ne 0 ] && [ $limit -lt 64 ]; do
        limit=$((limit + 1)) code=0
        command="ulimit -n $limit; $*"
        (
            ulimit -n $limit
            program=$1
            shift
            exec "$BIN/$program" "$@"
        ) >"$out" 2>"$err" || code=$?
        [ "$code" -eq 0 ] || grep -q 'error while loading shared libraries' "$err" || {
            [ "$(wc -l <"$err")" -eq 1 ] && grep -q ': Too many open files$' "$err" &&
                { [ "$code" -eq 66 ] || [ "$code" -eq 73 ] || [ "$code" -eq 74 ]; } && [ "$(ls -A)" = "$inputs" ]
            check "one line, exit code $code, nothing left: $command" $?
        }
    done
    code 0
    holds "some limit was too small: $command" [ "$limit" -gt 4 ]
}
few bisque-voxelize scan.obj -o a.nvdb --resolution 48 --no-tris --threads 2
same a.nvdb scan.nvdb
rm a.nvdb
few bisque-voxelize scan.tris -o a.nvdb --resolution 48 --threads 2
same a.nvdb scan.nvdb
rm a.nvdb
few bisque-bake scan.nvdb low.obj --device cpu --size 32 --samples 1 --maps normal,color,mask -o 'a_<MAP>.exr'
rm a_*.exr

# Maps of many tiles are counted before the work.
awk 'BEGIN { for (t = 0; t < 100; t++) {
    u = t % 10; v = int(t / 10)
    printf "v %d %d 0\nv %d %d 0\nv %d %d 0\n", u, v, u + 1, v, u, v + 1
    printf "vt %.1f %.1f\nvt %.1f %.1f\nvt %.1f %.1f\n", u + .1, v + .1, u + .9, v + .1, u + .1, v + .9
    printf "f %d/%d %d/%d %d/%d\n", 3 * t + 1, 3 * t + 1, 3 * t + 2, 3 * t + 2, 3 * t + 3, 3 * t + 3 } }' >many.obj
run bisque-voxelize many.obj -o many.nvdb --no-tris --resolution 20
inputs=$(ls -A)
command="bisque-bake of 200 maps with 150 descriptors" code=0
(ulimit -n 150 && exec "$BIN/bisque-bake" many.nvdb many.obj --device cpu --size 8 --maps normal,height \
    -o '<MAP>.<UDIM>.exr' --progress json) >"$out" 2>"$err" || code=$?
code 73
tail -n 1 "$err" | grep -Eq "^bisque-bake: <MAP>\.<UDIM>\.exr: 200 outputs must be open together with [0-9]+ other files, the limit is 150: Too many open files\$" &&
    ! grep -q tracing "$err" && [ "$(ls -A)" = "$inputs" ]
check "refused before the work" $?
command="bisque-bake of 200 maps with 250 descriptors" code=0
(ulimit -n 250 && exec "$BIN/bisque-bake" many.nvdb many.obj --device cpu --size 8 --maps normal,height \
    -o '<MAP>.<UDIM>.exr') >"$out" 2>"$err" || code=$?
code 0
rm *.exr

finish

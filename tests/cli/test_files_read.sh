#!/bin/sh
# test_files_read.sh - the list of files that a job read (--json), and programs whose parent dies.
. "$(dirname "$0")/lib.sh"

printf 'P3 1 1 255 9 9 9\n' >dot.ppm
printf 'newmtl a\nmap_Kd dot.ppm\nnewmtl b\nmap_Kd gone.ppm\n' >two.mtl
cat >two.obj <<'END_OBJ'
mtllib two.mtl
v 0 0 0
v 2 0 0
v 2 1 0
vt 0 0
usemtl a
f 1/1 2/1 3/1
usemtl b
f 3/1 2/1 1/1
END_OBJ
# listed NAME: prints the identity of a file in the last list, "none" if it is not there.
listed()
{
    jq -r --arg name "$1" '[.files_read[] | select(.path | split("/")[-1] == $name)][0].identity // "none"' "$out"
}
# is_of NAME: the identity is that of the file: inode, size, and both times in nanoseconds.
is_of()
{
    [ "$(listed "$1")" = "$(stat -c '%i %s %.9Y %.9Z' "$1")" ]
}
ok run bisque-voxelize two.obj -o two.tris --json
holds "the mesh is listed as it was read" is_of two.obj
holds "so is its library" is_of two.mtl
holds "an image that is missing is listed" [ -z "$(listed gone.ppm)" ]
holds "outputs are not" [ "$(listed two.tris)" = none ]
ok run bisque-simplify two.tris -o low.obj --triangles 4 --json
holds "a chunk file is listed as it was read" is_of two.tris
holds "so are the images that it names" [ "$(listed dot.ppm)" != none ]

# Succeeds when a process has ended; an orphan may stay as a zombie, without a command.
ended()
{
    tries=0
    while [ -n "$(tr -d '\0' 2>/dev/null <"/proc/$1/cmdline")" ] && [ $tries -lt 3000 ]; do
        tries=$((tries + 1))
        sleep 0.02
    done
    [ $tries -lt 3000 ]
}
# A process whose parent is not the one that BSQ_PARENT names has lost it.
code=0
BSQ_PARENT=1 sh -c '"$@"; exit $?' - "$BIN/bisque-voxelize" two.obj -o lost.tris >"$out" 2>"$err" || code=$?
command="bisque-voxelize without its parent"
holds "a program ends with 75 if its parent is dead" [ "$code" -eq 75 ]
err_like "the parent, process 1 .*has ended"
holds "it writes nothing" [ ! -e lost.tris ]
# The parent waits for the named pipe to be open, and is killed while its child reads it.
mkfifo slow.obj
sh -c 'BSQ_PARENT=$$ "$@" & echo $! >child; wait' - "$BIN/bisque-voxelize" slow.obj -o slow.tris >"$out" 2>"$err" &
parent=$!
exec 9>slow.obj
cat two.obj >&9
holds "the child runs" kill -0 "$(cat child)"
kill -KILL $parent
wait $parent 2>/dev/null
holds "a child ends when its parent is killed" ended "$(cat child)"
exec 9>&-
holds "and writes nothing" [ ! -e slow.tris ]
finish

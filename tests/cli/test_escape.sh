#!/bin/sh
# test_escape.sh - names of files, and of things in files, reach terminal and logs escaped: control
# characters, and bytes that are not UTF-8.
. "$(dirname "$0")/lib.sh"

# checked PROGRAM ARGUMENT...: runs it, and names it in the test's own output without such bytes.
checked()
{
    run "$@"
    command=$(printf %s "$command" | tr -c ' -~' '?')
}

# clean: output and messages of the last run are UTF-8 without control characters but newlines.
clean()
{
    ! cat "$out" "$err" | LC_ALL=C tr -d '\n' | LC_ALL=C grep -q '[[:cntrl:]]' &&
        cat "$out" "$err" | iconv -f UTF-8 -t UTF-8 >/dev/null 2>&1 &&
        ! cat "$out" "$err" | iconv -f UTF-8 -t UTF-16LE | od -An -v -tx2 | grep -Eq ' (008|009)[0-9a-f]'
    check "nothing but text: $command" $?
}

# shows TEXT: output or messages contain it.
shows()
{
    cat "$out" "$err" | grep -Fq -- "$1"
    check "shows $1" $?
}

# A name with an escape sequence, C1's control sequence introducer, and a byte that is not UTF-8.
bad=$(printf 'a\033[31mb\302\233c\377d') shown='a\x1b[31mb\xc2\x9bc\xffd'

for program in bisque-voxelize bisque-simplify bisque-bake bisque-compare; do
    checked $program "--$bad"
    refused 64 "$program: unrecognized option '--$shown' (see --help)"
    checked $program "--memory=$bad" x
    code 64
    clean
    checked $program --help="$bad"
    code 64
    clean
done
checked bisque-voxelize "$bad.obj" -o a.nvdb
refused 66 "bisque-voxelize: $shown.obj: No such file or directory"
checked bisque-compare "$bad.exr" "$bad.exr"
code 66
clean
shows "$shown.exr"

# Names in files: statements, materials, libraries and textures.
printf 'v 0 0 0\n%s\n' "$bad" >statement.obj
{
    printf 'mtllib %s.mtl missing\033.mtl\n' "$bad"
    printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl %s\nf 1/1 2/1 3/1\n' "$bad"
} >materials.obj
printf 'newmtl %s\nKd %s\nmap_Kd %s.png\n' "$bad" "$bad" "$bad" >"$bad.mtl"
checked bisque-voxelize materials.obj -o a.nvdb --resolution 8
code 0
clean
shows "no such texture: material \"$shown\""
shows "not a colour, ignored: \"$shown\""
printf 'v 0 0 0\nv 1 0 0\nv %s 1 0\n' "$bad" >number.obj
checked bisque-voxelize number.obj -o b.nvdb
code 65
clean
shows "$shown"

# Reports and JSON: JSON has the name itself if it is UTF-8.
write_box >box.obj
checked bisque-voxelize box.obj -o "$bad.nvdb" --resolution 8
code 0
clean
shows "$shown.nvdb"
checked bisque-voxelize --verify "$bad.nvdb" --json
code 0
clean
json ".files[0].path == \"$(printf %s "$shown" | sed 's/\\/\\\\/g').nvdb\""
valid=$(printf 'a\033\302\233\303\237')
cp "$bad.nvdb" "$valid.nvdb"
checked bisque-voxelize --verify "$valid.nvdb" --json
code 0
clean
json '.files[0].path == "a\u001b\u009b\u00df.nvdb"'
checked bisque-voxelize --verify "$valid.nvdb" "$bad.obj" --json --progress json
clean
finish

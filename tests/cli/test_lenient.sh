#!/bin/sh
# test_lenient.sh - files that a scan names and that cannot be used: a warning before the scan is read,
# or an error with --strict.
. "$(dirname "$0")/lib.sh"
p="bisque-voxelize:"
vox="run bisque-voxelize --progress none"

cat >scan.obj <<'END'
mtllib scan.mtl
v 0 0 0
v 1 0 0
v 0 1 0
vt 0 0
usemtl a
f 1/1 2/1 3/1
END
mkdir folder
: >empty.png
echo text >text.png
printf '\211PNG\r\n\032\n\0\0\0\rIHDR\0\0\0\001\0\0\0\001\010\002\0\0\0\220wS\336' >cut.png
{ printf '\377\330\377\340' && head -c 100 /dev/zero; } >cut.jpg

# warns LINE OPTION...: a run with these options warns with exactly this line; with --strict it fails
# with it, before it reads the scan.
warns()
{
    line=$1
    shift
    ok $vox "$@" -o a.nvdb --resolution 8
    holds "warning: $line" [ "$(cat "$err")" = "$p warning: $line" ]
    rm a.*
    $vox "$@" -o a.nvdb --resolution 8 --strict
    refused 65 "$p $line"
    [ ! -e a.nvdb ] && [ ! -e a.tris ]
    check "nothing was written" $?
}

# ---- textures ----

# texture NAME PROBLEM: material a names this texture in line 3 of its library.
texture()
{
    printf 'newmtl a\nKd 1 0 0\nmap_Kd %s\n' "$1" >scan.mtl
    warns "scan.mtl:3: $1: $2: material \"a\" goes without it" scan.obj
}
texture gone.png 'no such texture'
texture . 'not a regular file'
texture folder 'not a regular file'
texture empty.png 'an empty file'
texture cut.png 'not a readable image: the file is cut off'
texture cut.jpg 'not a readable image: Premature end of JPEG file'
texture text.png 'not a readable image: it is no PNG, JPEG, TIFF, OpenEXR, JPEG 2000, WebP, BMP, Radiance HDR, PNM or TGA'

# OpenImageIO says nothing of these.
printf 'P6\n4 4\n255\n\377\0' >cut.ppm
texture cut.ppm 'damaged image: its decoder gives no reason, the file may be cut off'
printf 'P6\n4 4\n' >head.ppm
texture head.ppm 'not a readable image: its decoder gives no reason, the file may be cut off'

# Several materials that name a bad texture are counted, also those of another library.
printf 'newmtl a\nd 1\nmap_Kd gone.png\nnewmtl b\nmap_Kd gone.png\nmap_d gone.png\nnewmtl c\nmap_d gone.png\n' >scan.mtl
printf 'newmtl a\nmap_Kd gone.png\n' >more.mtl
sed 's/scan.mtl/more.mtl/' scan.obj >more.obj
warns 'scan.mtl:3: gone.png: no such texture: materials that go without it, such as "a": 2' scan.obj
warns 'scan.mtl:3: gone.png: no such texture: materials that go without it, such as "a": 3' scan.obj --channels opacity
warns 'scan.mtl:3: gone.png: no such texture: materials that go without it, such as "a": 3' scan.obj more.obj

# The warning comes before the scan is read: here the scan has an error.
printf 'newmtl a\nKd 1 0 0\nmap_Kd text.png\n' >scan.mtl
{ cat scan.obj; echo 'v x'; } >wrong.obj
$vox wrong.obj -o a.nvdb
code 65
[ "$(sed -n 1p "$err" | cut -d' ' -f 2-3)" = "warning: scan.mtl:3:" ] && [ "$(sed -n 2p "$err")" = "$p wrong.obj:8: \"x\" is not a number" ]
check "the texture comes first" $?
$vox wrong.obj -o a.nvdb --texture text.png
refused_like 65 "^$p text\\.png: not a readable image"

# A library that only a late part of the file names is checked after reading.
{ sed 1d scan.obj; awk 'BEGIN { for (i = 0; i < 30000; i++) print "# a comment of some length" }'; echo 'mtllib scan.mtl'; } >late.obj
texture_line='scan.mtl:3: text.png: not a readable image: it is no PNG, JPEG, TIFF, OpenEXR, JPEG 2000, WebP, BMP, Radiance HDR, PNM or TGA: material "a" goes without it'
warns "$texture_line" late.obj

# ---- libraries ----

rm scan.mtl
warns 'scan.obj:1: scan.mtl: No such file or directory: its materials are missing' scan.obj
mkdir scan.mtl
warns 'scan.obj:1: scan.mtl: not a regular file: its materials are missing' scan.obj
rmdir scan.mtl
: >scan.mtl
warns 'scan.obj:1: scan.mtl: an empty file: its materials are missing' scan.obj

{ printf '\n# long \\\n\nv \\\n0 0 0\n'; sed '1,2d; s/^usemtl/mtllib none.mtl\n&/' scan.obj; } >named.obj
warns 'named.obj:9: none.mtl: No such file or directory: its materials are missing' named.obj
sed '$s/scan/none/' late.obj >later.obj
warns "later.obj:$(wc -l <later.obj): none.mtl: No such file or directory: its materials are missing" later.obj

# Text of another kind.
printf '<!DOCTYPE html>\n<html>\n# Kd\n</html>\n' >scan.mtl
ok $vox scan.obj -o a.nvdb --resolution 8
[ "$(sed -n 1p "$err")" = "$p warning: scan.mtl:1: lines with statements that are not of the format: 3; this is the first" ]
check "a page instead of a library" $?
$vox scan.obj -o a.nvdb --resolution 8 --strict
refused 65 "$p scan.mtl:1: lines with statements that are not of the format: 3; this is the first"

# ---- colours that no face uses ----

printf 'newmtl a\nKd 1 0 0\n' >scan.mtl
{ cat scan.obj; printf 'usemtl x\nf 1 2 3\nusemtl y\nf 1 2 3\n'; } >unknown.obj
warns 'unknown.obj: no material library describes "x"; materials without a colour: 2 (see --texture)' unknown.obj
printf 'newmtl a\nmap_Kd scan.obj\n' >scan.mtl
sed '/usemtl/d; s/^f .*/f 1 2 3/; /^vt/d' scan.obj >unused.obj
warns 'unused.obj: no face has a material, so textures such as scan.obj are not used (see --texture)' unused.obj
rm scan.mtl
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl x\nf 1 2 3\nusemtl y\nf 1 2 3\n' >bare.obj
warns 'bare.obj: no material library is named; materials without a colour, such as "x": 2 (see --texture)' bare.obj
sed 's/^v .*/& 0 1 0/' bare.obj >vertex.obj
ok $vox vertex.obj -o a.nvdb
holds "no warning: $command" [ ! -s "$err" ]

# A file of zero bytes, such as a download that failed, has no line end. It is not read whole.
truncate -s 1G zero.obj
$vox zero.obj -o a.nvdb --memory 64M
refused 65 "$p zero.obj:1: not a text file (zero byte)"
rm zero.obj

# ---- what is lost in the scan ----

{ cat scan.obj; echo 'f 1/9 2/1 3/1'; } | sed '/mtl/d' >lost.obj
warns 'lost.obj:6: corners that refer to a texture coordinate that the file does not have: 1; this is the first' lost.obj
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 nan 0\nf 1 2 3\n' >nan.obj
warns 'nan.obj:4: vertices without a finite position: 1; this is the first' nan.obj
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\ng a\nodd one\nodder\n' >odd.obj
warns 'odd.obj:6: lines with statements that are not of the format: 2; this is the first' odd.obj

printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nusemap off\nf 1 2 3\nusemap wood.png\nf 3 2 1\n' >usemap.obj
warns 'usemap.obj:6: usemap statements, whose textures are not read (see --texture): 1; this is the first' usemap.obj
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nusemap \\\noff\nodd one\n' >continued.obj
warns 'continued.obj:7: lines with statements that are not of the format: 1; this is the first' continued.obj

# Faces that cannot use their texture: all of them, some, and none.
texture=red.ppm
printf 'P6\n1 1\n255\n\377\0\0' >$texture
printf 'newmtl a\nmap_Kd %s\nnewmtl b\nKd 1 0 0\n' "$texture" >scan.mtl
points='mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n'
printf "${points}usemtl a\nf 1 2 3\nf 3 2 1\nusemtl b\nf 1 2 3\n" >bare.obj
warns "bare.obj: faces without texture coordinates: 2; their texture, such as $texture, is not used" bare.obj
printf "${points}vt 0 0\nusemtl a\nf 1/1 2/1 3/1\nf 1/1 2 3/1\nusemtl b\nf 1 2 3\n" >some.obj
warns "some.obj: faces without texture coordinates: 1; their texture, such as $texture, is not used" some.obj
warns "some.obj: faces without texture coordinates: 2; their texture, such as $texture, is not used" some.obj --texture "$texture"
printf "${points}vt 0 0\nusemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1 2 3\n" >none.obj
ok $vox none.obj -o a.nvdb
holds "no warning: $command" [ ! -s "$err" ]
sed 's/^v .*/& 0 1 0/' some.obj >vertex.obj
ok $vox vertex.obj -o a.nvdb
holds "no warning: $command" [ ! -s "$err" ]
# Faces without a material beside a material with a colour or a texture.
triangles='o x\nf 1 2 3\nf 3 2 1\nusemtl %s\nf 1 2 3\n'
printf "${points}$triangles" b >plain.obj
lacks='faces without a material: 2; they have no colour (see --texture)'
warns "plain.obj: $lacks" plain.obj
warns "plain.obj: $lacks" plain.obj --channels id --id object
printf "${points}vt 0 0\nf 1/1 2/1 3/1\nusemtl a\nf 1/1 2/1 3/1\nusemtl\nf 3 2 1\n" >textured.obj
warns "textured.obj: $lacks" textured.obj
printf 'newmtl a\nPr 0.5\n' >gray.mtl
printf "mtllib gray.mtl\n${points#*.mtl?n}$triangles" a >gray.obj
ok $vox plain.obj gray.obj -o a.nvdb --resolution 8
holds "only faces of files with colours count" grep -Fqx "$p warning: plain.obj: $lacks" "$err"
# They are white.
printf 'newmtl b\nKd 1 0 0\nnewmtl white\nKd 1 1 1\n' >scan.mtl
printf "${points}v 1 1 1\nf 2 3 4\nusemtl b\nf 1 2 3\n" >plain.obj
sed 's/^f 2 3 4/usemtl white\n&/' plain.obj >white.obj
for name in plain white; do
    ok $vox $name.obj -o $name.nvdb --resolution 8
done
same white.nvdb plain.nvdb
rm scan.mtl

# A few vertices with a colour hide the colours of materials, also if a block or a file without any
# comes before them.
lacks='these are white, and colours of materials are not used, because other vertices have colours'
printf 'newmtl b\nKd 1 0 0\n' >scan.mtl
faces='usemtl b\nf 1 2 3\n'
printf "${points}v 5 5 5\nv 1 1 1 1 0 0\n$faces" >hidden.obj
warns "hidden.obj: faces at vertices without a colour: 1; $lacks" hidden.obj
printf "mtllib scan.mtl\nv 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0 0 1 0\n$faces" >middle.obj
warns "middle.obj: faces at vertices without a colour: 1; $lacks" middle.obj
printf 'v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\n' >colored.obj
warns "hidden.obj: faces at vertices without a colour: 1; $lacks" colored.obj hidden.obj
warns "hidden.obj: faces at vertices without a colour: 2; $lacks" hidden.obj colored.obj middle.obj
{ printf "$points" && awk 'BEGIN { for (i = 0; i < 90000; i++) print "v 0.5 0.5", i / 9e4 }' &&
    printf "v 1 1 1 1 0 0\n$faces" && echo f 4 5 80000; } >blocks.obj
warns "blocks.obj: faces at vertices without a colour: 2; $lacks" blocks.obj
# Nothing is lost if no face uses such a vertex, or if materials have no colours.
printf "mtllib scan.mtl\n$(grep '^v' colored.obj)\nv 5 5 5\n$faces" >all.obj
{ grep '^v' hidden.obj; echo 'f 1 2 3'; } >plain.obj
for name in all plain; do
    ok $vox $name.obj -o a.nvdb --resolution 8
    holds "no warning: $command" [ ! -s "$err" ]
done
rm scan.mtl a.*

# A few bright spots do not turn a scan dark.
awk 'BEGIN { for (i = 0; i < 1000; i++) print "v", i % 2, i / 999, 0, (i == 7 ? 2.5 : 0.8), 0.8, 0.8
    print "f 1 2 1000" }' >bright.obj
warns 'bright.obj: colours out of range were clamped at 1 vertex' bright.obj

# Each file is checked with its own library: the first has none here.
sed '/mtllib/d' scan.obj >bare.obj
printf 'newmtl b\nKd 1 0 0\n' >scan.mtl
ok $vox bare.obj scan.obj -o a.nvdb --resolution 8
[ "$(cat "$err")" = "$p warning: bare.obj: no material library is named; materials without a colour, such as \"a\": 1 (see --texture)
$p warning: scan.obj: no material library describes \"a\"; materials without a colour: 1 (see --texture)" ]
check "each file has a warning of its own" $?
rm scan.mtl

# The libraries of a pipe are beside nothing but the current directory, also several of them.
printf 'newmtl a\nKd 1 0 0\n' >one.mtl
mkfifo folder/pipe.obj
sed 's/scan.mtl/none.mtl one.mtl/' scan.obj >folder/pipe.obj &
ok run bisque-voxelize --progress none folder/pipe.obj -o a.nvdb --tris a.tris --resolution 8
wait
holds "the library of a pipe is found" grep -q 'with colour' "$out"
rm a.nvdb a.tris

# The low-poly mesh of a bake.
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/7\n' >low.obj
$vox lost.obj -o lost.nvdb --no-tris --resolution 8
line='low.obj:8: corners that refer to a normal that the file does not have: 1; this is the first'
ok run bisque-bake lost.nvdb low.obj -o map.exr --size 8 --device cpu --progress none
holds "warning: $line" [ "$(cat "$err")" = "bisque-bake: warning: $line" ]
rm map.exr
run bisque-bake lost.nvdb low.obj -o map.exr --size 8 --device cpu --strict
refused 65 "bisque-bake: $line"

# The mesh is read again to find the line of the refused face, but warns once.
sed 's/^vt .*/vt nan 0/; s,/7$,/1,' low.obj >nan_low.obj
line=$(grep -n '^vt' nan_low.obj | cut -d: -f1 | head -n 1) face=$(grep -n '^f' nan_low.obj | cut -d: -f1 | head -n 1)
count=$(grep -c '^vt' nan_low.obj)
run bisque-bake lost.nvdb nan_low.obj -o map.exr --size 8 --device cpu
code 65
[ "$(cat "$err")" = "bisque-bake: warning: nan_low.obj:$line: texture coordinates without finite numbers: $count; this is the first
bisque-bake: nan_low.obj:$face: face has no texture coordinates" ]
check "a refused low-poly mesh warns once" $?
finish

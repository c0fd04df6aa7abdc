#!/bin/sh
# test_images.sh - textures that other programs read, in processes of their own: sound, damaged, and
# of a program that crashes, stops early or never ends. SEED=7 COUNT=100000 damages other ones.
. "$(dirname "$0")/lib.sh"

images=$top/tests/images
count=300
[ -z "${LONG-}" ] || count=20000
sanitized && count=60
SEED=$(seed)
command="damage-images $SEED ${COUNT:-$count}" code=0
"$TESTS/damage-images" "$SEED" "${COUNT:-$count}" "$images"/* >"$out" 2>"$err" || code=$?
cat "$out"
code 0

write_square 0 0 1 0 >square.obj
vox="run bisque-voxelize square.obj --resolution 4 --no-tris -o square.nvdb --texture"
for image in "$images"/*; do
    ok $vox "$image"
    [ ! -s "$err" ]
    check "nothing is said of ${image##*/}" $?
done

# ---- kinds of TIFF and OpenEXR files, with the colours of others ----
python3 "$top/tests/cli/write_images.py" >all || check "kinds of images" $?
grep -v ' -$' all >kinds
grep -c . kinds >count
holds "there are kinds" [ "$(cat count)" -eq 23 ]
for like in $(cut -d ' ' -f 2 kinds | sort -u); do
    ok run bisque-voxelize square.obj --resolution 64 --no-tris -o "$like.nvdb" --texture "$like"
done
while read -r image like; do
    ok run bisque-voxelize square.obj --resolution 64 --no-tris -o kind.nvdb --texture "$image"
    holds "$image has the colours of $like" cmp -s kind.nvdb "$like.nvdb"
done <kinds
for image in signed.tif signed_deep.tif; do
    $vox "$image"
    refused 65 "bisque-voxelize: $image: not a readable image: its samples are signed: store them as unsigned integers or as floats"
done
for image in rgb_alpha_apart.tif deep_big_apart.tif; do
    $vox "$image"
    refused_like 65 "^bisque-voxelize: $image: not a readable image: its samples are of an unusual kind: "
done

# A program that decodes an image whole gets half of the memory, or says that it needs more.
python3 -c 'import sys; sys.stdout.buffer.write(bytes([0, 0, 2] + 9 * [0] + [0, 32, 0, 32, 24, 0]))' >large.tga
head -c 201326592 /dev/zero >>large.tga # 8192 x 8192
if ! sanitized; then
    $vox large.tga --memory 64M
    refused_like 71 '^bisque-voxelize: large.tga: OpenImageIO needs more memory than its [0-9]* bytes of --memory: '
fi
ok $vox large.tga --memory 700M
rm large.tga

# ---- a program that does not do its work ----
p=bisque-voxelize:
image=$images/strips.tif
mkdir -p copy/bin copy/lib/bisque
cp "$BIN/bisque-voxelize" copy/bin
BIN=$PWD/copy/bin
reader=copy/lib/bisque/bisque-tiff
acts() # TEXT: what the program does
{
    printf '#!/bin/sh\n%s\n' "$1" >$reader.new
    chmod +x $reader.new
    mv $reader.new $reader
}

acts 'kill -SEGV $$'
$vox "$image"
refused 65 "$p $image: cannot be read: libtiff crashed (Segmentation fault): the file is damaged"
acts 'exit 0'
$vox "$image"
refused_like 66 "^$p $image: .*/bisque-tiff is not of this program's build, or does not work"
acts 'kill -XCPU $$'
$vox "$image"
refused 65 "$p $image: cannot be read: libtiff has not read it in 30 seconds"
acts 'exit 71'
$vox "$image" --memory 64M
refused_like 71 "^$p $image: libtiff needs more memory than its [0-9]* bytes of --memory: "
acts 'printf -- "damaged image: \\033[2Jno\\n\\tidea"; exit 65'
$vox "$image"
refused 65 "$p $image: damaged image:  [2Jno  idea"
acts 'head -c 200 /dev/zero | tr "\\000" +'
$vox "$image"
refused_like 66 "^$p $image: .*/bisque-tiff is not of this program's build, or does not work"
[ ! -e square.nvdb.tmp ]
check "nothing is left" $?
# It never ends: a signal ends the wait, and the program.
acts 'echo $$ >reader; exec sleep 1000000'
cp "$TESTS/bin/bisque-voxelize" copy/bin
TESTS=$PWD/copy
at_look 60 TERM "" bisque-voxelize square.obj -o late.nvdb --texture "$image"
stopped
! kill -0 "$(cat reader)" 2>/dev/null
check "the program that reads the image has ended" $?
finish

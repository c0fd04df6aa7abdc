#!/bin/sh
# test_inputs.sh - inputs that are outputs too, that change under way, or that are no regular files.
. "$(dirname "$0")/lib.sh"
p=bisque-voxelize:
vox="run bisque-voxelize --resolution 16"
bake="run bisque-bake --device cpu --size 16 --samples 1"

# A textured box: box.obj names box.mtl, whose third line names box_color.png. A baked colour map is
# the texture.
write_box >low.obj
$vox low.obj -o low.nvdb
ok $bake low.nvdb low.obj --maps mask -o box_color.png
{ echo 'mtllib box.mtl'; write_box | sed 's/^f /usemtl skin\nf /'; } >box.obj
printf 'newmtl skin\nKd 1 1 1\nmap_Kd box_color.png\n' >box.mtl
rm low.nvdb low.tris
sums()
{
    cksum box.obj box.mtl box_color.png low.obj
}
before=$(sums)
start=$(ls -A)

# unchanged: no input was written to, and no file is new.
unchanged()
{
    holds "no input was changed by $command" [ "$(sums)" = "$before" ]
    files $start
}

# ---- outputs that would overwrite inputs that are not on the command line ----

here=$(pwd -P)
library="the material library that box.obj names"
texture="the texture that box.mtl:3 names"
$vox box.obj -o a.nvdb --tris box.mtl
refused 64 "$p box.mtl: this output would overwrite $library"
$vox box.obj -o box_color.png --no-tris
refused 64 "$p box_color.png: this output would overwrite $texture"
$vox box.obj -o a.nvdb --vdb ./box_color.png
refused 64 "$p ./box_color.png: this output would overwrite box_color.png, $texture"
ln box_color.png hard.nvdb
ln -s box.mtl soft.nvdb
start=$(ls -A)
$vox box.obj -o hard.nvdb
refused 64 "$p hard.nvdb: this output would overwrite box_color.png, $texture"
$vox box.obj -o soft.nvdb
refused 64 "$p soft.nvdb: this output would overwrite box.mtl, $library"
$vox low.obj --texture box_color.png -o hard.nvdb
refused 64 "$p hard.nvdb: this output would overwrite box_color.png, the texture"
unchanged
rm hard.nvdb soft.nvdb

# A texture that is missing may not be created.
sed 's/box_color/missing/' box.mtl >box2.mtl
sed 's/box.mtl/box2.mtl/' box.obj >box2.obj
start=$(ls -A)
$vox box2.obj -o missing.png
refused 64 "$p missing.png: this output would overwrite the texture that box2.mtl:3 names"
unchanged

# The chunk file names its textures.
ok $vox box.obj -o box.nvdb
start=$(ls -A)
for maps in color,normal normal,color mask,color; do
    $bake box.tris low.obj --maps $maps -o 'box_<MAP>.png'
    refused 64 "bisque-bake: box_color.png: this output would overwrite $here/box_color.png, the texture that box.tris names"
done
$bake box.tris low.obj -o 'box_<MAP>.png'
refused 64 "bisque-bake: box_color.png: this output would overwrite $here/box_color.png, the texture that box.tris names"
$bake box.tris low.obj --maps normal -o a.png --preview box_color.png
refused 64 "bisque-bake: box_color.png: this output would overwrite $here/box_color.png, the texture that box.tris names"
$vox box.tris -o box_color.png
refused 64 "$p box_color.png: this output would overwrite $here/box_color.png, the texture that box.tris names"
unchanged

# ---- images that are no images, and what a material library may name ----

rm -f hostile.obj
sed 's/box.mtl/hostile.mtl/' box.obj >hostile.obj
mkfifo pipe.png
printf '#EXTM3U\nhttp://127.0.0.1:9/a.ts\n' >stream.png
start=$(ls -A)
for name in pipe.png /dev/zero; do
    printf 'newmtl skin\nmap_Kd %s\n' "$name" >hostile.mtl
    $vox hostile.obj -o a.nvdb --no-tris --strict
    refused_like 65 "^bisque-voxelize: hostile\.mtl:2: $name: not a regular file: "
done
rm hostile.mtl
printf 'newmtl skin\nmap_Kd stream.png\n' >hostile.mtl
$vox hostile.obj -o a.nvdb --no-tris --strict
refused_like 65 '^bisque-voxelize: .*stream\.png: not a readable image: it is no PNG'
printf 'newmtl skin\nmap_Kd http://127.0.0.1:9/a.png\n' >hostile.mtl
ok $vox hostile.obj -o a.nvdb --no-tris
holds "a URL is no texture" grep -q 'no such texture' "$err"
rm a.nvdb hostile.mtl
files $(echo $start | tr ' ' '\n' | grep -v '^hostile.mtl$')
rm hostile.obj pipe.png stream.png

# ---- few threads ----

# Opening a module, or the program for a texture, at first starts eight threads to see that they can
# be. A texture is read twice. No other thread is started for one worker.
if sanitized; then
    skip "few threads" "sanitizers want to be loaded first"
else
    printf 'P6\n1 1\n255\nabc' >abc.ppm
    export LD_PRELOAD="$TESTS/faults.so"
    for most in 0 7; do
        export FAULT_THREADS=$most
        ok $vox box.obj -o a.nvdb --no-tris --threads 1 # its texture is PNG, which needs no module
        rm a.nvdb
        $vox box.obj --texture abc.ppm -o a.nvdb --no-tris --threads 1
        refused 71 "$p textures of this format need 8 threads, of which the system starts only $most"
        $vox low.obj -o a.nvdb --no-tris --threads 1 --vdb a.vdb
        refused 71 "$p OpenVDB files need 8 threads, of which the system starts only $most"
    done
    export FAULT_THREADS=16
    ok $vox box.obj --texture abc.ppm -o a.nvdb --no-tris --threads 1
    ok $vox low.obj -o a.nvdb --no-tris --threads 1
    unset LD_PRELOAD FAULT_THREADS
    rm a.nvdb abc.ppm
fi

finish

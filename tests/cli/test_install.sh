#!/bin/sh
# test_install.sh - an installation works: programs built with its headers, pkg-config files and
# libraries; its helpers; a moved copy of it. Uninstalling leaves no file.
. "$(dirname "$0")/lib.sh"
unsanitized "an installation" "nobody installs programs with sanitizers"
build=$(dirname "$BIN")
prefix=$work/prefix

# make_top TARGET VARIABLE=VALUE...: runs make in the source tree, on the build that is tested.
make_top()
{
    command="make $*" code=0
    make -C "$top" --no-print-directory BUILD="$build" "$@" >"$out" 2>"$err" || code=$?
    check "make $1" "$code"
}

# is_there FILE...: checks that the files are under the prefix and not empty.
is_there()
{
    for file; do
        holds "$file is installed" [ -s "$prefix/$file" ]
    done
}

make_top install DESTDIR= prefix="$prefix"
for program in bisque-voxelize bisque-bake bisque-compare; do
    is_there "bin/$program" "share/man/man1/$program.1"
done
is_there share/bisque/farm/bisque-slurm share/bisque/farm/asset.openjd.yaml share/bisque/farm/assets.openjd.yaml
is_there share/bisque/farm/bisque-openjd share/bisque/farm/bisque-image share/bisque/farm/parts.openjd.yaml share/bisque/farm/bake.openjd.yaml \
    share/bisque/farm/tiles.openjd.yaml
is_there share/bisque/farm/deadline/template.yaml share/bisque/report.html share/bisque/report.js
is_there lib/bisque/bisque-texture lib/bisque/bisque-tiff lib/bisque/bisque-vdb lib/bisque/bisque-devices
is_there lib/bisque/bisque-gltf
command="tests/lint/symbols.sh" code=0
"$top/tests/lint/symbols.sh" "$build/lib" >"$out" 2>"$err" || code=$?
check "exported symbols have their library's prefix" "$code"
nm -D --defined-only "$prefix/lib/libbisque.so.0" | awk '$2 != "A" { print $3 }' >"$out"
grep -q '^vox_voxelize@@BISQUE_0$' "$out" && ! grep -Evq '^(bsq|fmt|vox|bake)_.*@@BISQUE_0$' "$out" &&
    ! grep -q '^bsq_file_open@' "$out"
check "the shared library exports the public functions, with a version" $?

# ---- the programs of examples/, built with the installation ----
PKG_CONFIG_PATH=$prefix/lib/pkgconfig
export PKG_CONFIG_PATH
pkg-config --libs bisque >"$out" 2>"$err"
grep -q -- "-L$prefix/lib -lbisque" "$out" && ! grep -Eiq 'openimageio|openvdb|stdc|png' "$out"
check "pkg-config --libs bisque" $?
for example in voxelize_scan bake_maps compare_maps; do
    command="cc $example.c" code=0
    cc -std=c99 -Wall -Wextra -Werror -o $example-shared "$top/examples/$example.c" \
        $(pkg-config --cflags --libs bisque) -Wl,-rpath,"$prefix/lib" >"$out" 2>"$err" || code=$?
    check "$example.c is compiled with the installed headers and the shared library" "$code"
    cc -std=c99 -o $example "$top/examples/$example.c" $(pkg-config --cflags bisque) \
        "$prefix/lib/libbisque.a" $(pkg-config --static --libs bisque | sed 's/-lbisque//') \
        >"$out" 2>"$err" || code=$?
    check "$example.c is compiled with the static library" "$code"
done

write_box >box.obj
printf 'P3\n1 1\n255\n255 0 0\n' >red.ppm
BIN=$PWD
voxelize="voxelize_scan box.obj box.tris box.nvdb 32"
ok run $voxelize
out_like '^12 triangles, [0-9]* voxels, no color$'
ok run voxelize_scan-shared box.obj shared.tris shared.nvdb 32 red.ppm
out_like ', color$'
ok run bake_maps box.nvdb box.obj 'box_<MAP>.png' 64
out_like '^hits on '
[ -s box_normal.png ] && [ ! -e box_color.png ]
check "maps of a scan without colours" $?
ok run $voxelize red.ppm box.vdb
out_like ', color$'
run bake_maps box.nvdb box.obj 'box_<MAP>.png' 64
[ -s box_color.png ] && [ -s box.vdb ]
check "maps of a textured scan, and its OpenVDB file" $?

# Helpers beside a program that is started by its bare name, so that argv[0] has no directory.
mkdir bin && mv voxelize_scan bin && mv "$prefix"/lib/bisque/* bin
command="voxelize_scan with a texture, found by PATH" code=0
(PATH=$PWD/bin:$PATH && $voxelize red.ppm) >"$out" 2>"$err" || code=$?
out_like ', color$'
mv bin/voxelize_scan . && mv bin/* "$prefix/lib/bisque"

# ---- helpers that are missing, broken, or of another build ----
cp -r "$prefix" moved
rm "$prefix"/lib/bisque/*
ok run $voxelize
run $voxelize red.ppm
places="$PWD, ${PWD%/*}/lib/bisque or $prefix/lib/bisque"
refused 66 "textures of this format need the program bisque-texture, which is not in $places"
run $voxelize '' box.vdb
refused 66 "OpenVDB files need the program bisque-vdb, which is not in $places"
# The error comes before any work.
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >one.obj
command="bisque-voxelize --vdb without its helper" code=0
"$prefix/bin/bisque-voxelize" one.obj -o one.nvdb --vdb one.vdb >"$out" 2>"$err" || code=$?
refused_like 66 '^bisque-voxelize: OpenVDB files need the program bisque-vdb'
[ ! -e one.tris ] && [ ! -e one.nvdb ]
check "nothing was done before the program was missed" $?
printf 'no program\n' >"$prefix/lib/bisque/bisque-texture"
run $voxelize red.ppm
refused_like 66 "^red.ppm: the program of OpenImageIO does not start: "
stamp=$(grep -aEo '[0-9]+\.[0-9]+\.[0-9]+-[0-9]{6,}' moved/lib/bisque/bisque-texture | head -n 1)
other=$(echo "$stamp" | tr 0-9 1-90)
sed "s/$stamp/$other/g" moved/lib/bisque/bisque-texture >"$prefix/lib/bisque/bisque-texture"
chmod +x "$prefix/lib/bisque/bisque-texture"
run $voxelize red.ppm
refused 66 "red.ppm: $prefix/lib/bisque/bisque-texture is not of this program's build, or does not work"
printf 'no program\n' >"$prefix/lib/bisque/bisque-vdb"
run $voxelize '' box.vdb
refused_like 66 "^box.vdb: the program of OpenVDB does not start: "
sed "s/$stamp/$other/g" moved/lib/bisque/bisque-vdb >"$prefix/lib/bisque/bisque-vdb"
chmod +x "$prefix/lib/bisque/bisque-vdb"
run $voxelize '' box.vdb
refused 66 "box.vdb: $prefix/lib/bisque/bisque-vdb is not of this program's build, or does not work"

# ---- a moved installation, and programs that open no more than they need ----
BIN=$PWD/moved/bin
ok run bisque-voxelize box.obj --texture red.ppm --vdb moved.vdb -o moved.nvdb --resolution 32
command="bisque-voxelize --vdb" code=0
holds "the same OpenVDB file from a moved installation" cmp -s box.vdb moved.vdb
cp moved/bin/bisque-voxelize moved/bin/replaced
exec 9<moved/bin/replaced
rm moved/bin/replaced
/proc/self/fd/9 box.obj --texture red.ppm --vdb moved.vdb -o moved.nvdb --resolution 32 >"$out" 2>"$err"
check "a program that was replaced finds its helpers" $?
exec 9<&-
for program in bisque-voxelize bisque-bake bisque-compare; do
    command="ldd $program" code=0
    ldd "$BIN/$program" >"$out" 2>"$err"
    [ "$(wc -l <"$out")" -lt 20 ] && ! grep -Eq 'OpenImageIO|openvdb|libtbb' "$out"
    check "$program needs few libraries" $?
done

# ---- removal, and a staged installation ----
make_top uninstall DESTDIR= prefix="$prefix"
find "$prefix" ! -type d >"$out"
[ ! -s "$out" ] && [ ! -e "$prefix/include/bisque" ] && [ ! -e "$prefix/lib/bisque" ]
check "uninstall leaves nothing" $?
make_top install DESTDIR="$work/stage" prefix=/opt/bisque
grep -rl "$work/stage" "$work/stage" >"$out"
[ ! -s "$out" ] && grep -q '^prefix=/opt/bisque$' "$work"/stage/opt/bisque/lib/pkgconfig/bisque.pc
check "nothing in a staged installation names the stage" $?
finish

#!/bin/sh
# test_oracle.sh - Bisque's readers of .tris and .nvdb files, and readers in Python that were written
# from FORMATS.md alone, accept the same files and read the same content. Compares COUNT files of each
# kind, made from SEED; LONG=1 takes many from a new seed. Files on which they differ are kept in
# KEEP; tests/oracle/read_file.py and --verify repeat the verdicts.
. "$(dirname "$0")/lib.sh"
if [ -n "${LONG-}" ]; then
    count=${COUNT:-40000}
else
    count=${COUNT:-1500}
fi
seed=$(seed)
keep=${KEEP:-$(dirname "$TESTS")/disagreements}

need_oracle

"$TESTS/generate-scan" --triangles 2000 --colors --normals --uvs vase -o vase.obj
printf 'newmtl glaze\nKd .2 .4 .6\nmap_Kd dot.ppm\n' >vase.mtl
printf 'P3 1 1 255 9 9 9\n' >dot.ppm
{ printf 'mtllib vase.mtl\nusemtl glaze\n'; cat vase.obj; } >full.obj
ok run bisque-voxelize full.obj -o full.nvdb --resolution 30
ok run bisque-voxelize full.tris -o other.nvdb --resolution 20
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 0 .02\nv 1 0 .02\nv 1 1 .02\nf 3 2 1\nf 4 5 6\n' >sheet.obj
ok run bisque-voxelize sheet.obj -o sheet.nvdb --resolution 16

oracle read_file ./*.tris ./*.nvdb
[ "$code" -eq 0 ] && [ "$(grep -c ': ok$' "$out")" -eq 5 ]
check "files of bisque-voxelize are as FORMATS.md says" $?

oracle compare --count "$count" --seed "$seed" --keep "$keep" "$TESTS/read-files" \
    ./*.tris ./*.nvdb "$top"/tests/fuzz/corpus/tris/*
grep '^#' "$out"
check "both readers agree on $count files of each kind; others are in $keep" "$code"
finish

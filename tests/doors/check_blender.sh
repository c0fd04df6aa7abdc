#!/bin/sh
# check_blender.sh - bakes from inside Blender with the extension, EXTENSION, that `make extension` made. BPY is a
# Python with the module bpy; PICTURES is a folder for what it renders. LARGE="SCAN LOW" bakes only these files, of
# any size, and measures Blender's memory.
. "$(dirname "$0")/../cli/lib.sh"
extension=$top/${EXTENSION:?is the extension, bisque.zip}
pictures=${PICTURES:+$top/$PICTURES}
pictures=${pictures:-$work/pictures}
mkdir -p "$pictures"
"$TESTS/generate-scan" --triangles 100000 --colors vase -o vase.obj || exit 1
"$TESTS/generate-scan" vase-low -o vase_low.obj || exit 1
printf 'newmtl metal\nPr 0.25\nPm 0.75\n' >metal.mtl
{ printf 'mtllib metal.mtl\nusemtl metal\n' && cat vase.obj; } >metal.obj
cp vase.obj body_high.obj
awk '/^v / { $2 += 2 } 1' vase.obj >belt_high.obj
command="blender.py"
# shellcheck disable=SC2086
"${BPY:?is a Python with bpy}" "$top/tests/doors/blender.py" "$extension" "$pictures" ${LARGE:-} >"$out" 2>"$err"
code=$?
grep -E '^(ok|not ok|stages|mean|Blender)' "$out"
passed=$((passed + $(grep -c '^ok' "$out"))) failed=$((failed + $(grep -c '^not ok' "$out")))
check "blender.py ends" $code
mkdir unpacked && python3 -m zipfile -e "$extension" unpacked
holds "the wheel is as it was made" cmp unpacked/wheels/bisque-*.whl "$(dirname "$extension")"/../wheel/bisque-*.whl
holds "one cffi serves both Pythons of Blender" [ "$(python3 -m zipfile -l unpacked/wheels/cffi-*-cp311.cp313-*.whl |
    grep -c '^_cffi_backend.cpython-31[13]-')" = 2 ]
version=$(sed -n 's/^version = "\(.*\)"/\1/p' unpacked/blender_manifest.toml)
holds "the extension has the version of the programs" [ "$("$BIN/bisque-bake" --version)" = "bisque-bake $version" ]
holds "the extension stays below 900 lines" [ "$(cat "$top"/tools/blender/bisque/*.* | wc -l)" -lt 900 ]
finish

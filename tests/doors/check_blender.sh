#!/bin/sh
# check_blender.sh - bakes from inside Blender with the extension in tools/blender. BPY is a Python with
# the module bpy; PICTURES is a folder for what it renders.
. "$(dirname "$0")/../cli/lib.sh"
pictures=${PICTURES:+$top/$PICTURES}
pictures=${pictures:-$work/pictures}
mkdir -p "$pictures"
"$TESTS/generate-scan" --triangles 100000 --colors vase -o vase.obj || exit 1
"$TESTS/generate-scan" vase-low -o vase_low.obj || exit 1
command="blender.py"
PATH=$BIN:$PATH "${BPY:?is a Python with bpy}" "$top/tests/doors/blender.py" "$BIN" "$pictures" >"$out" 2>"$err"
code=$?
grep -E '^(ok|not ok|skipped|mean|Blender)' "$out"
passed=$((passed + $(grep -c '^ok' "$out"))) failed=$((failed + $(grep -c '^not ok' "$out")))
check "blender.py ends" $code
holds "the extension stays below 900 lines" [ "$(cat "$top"/tools/blender/bisque/* 2>/dev/null | wc -l)" -lt 900 ]
finish

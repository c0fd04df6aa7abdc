#!/bin/sh
# test_hostile.sh - what others do meanwhile: links in a directory where everybody may write, the
# system's clock that jumps, and names with line breaks.
. "$(dirname "$0")/lib.sh"

vox="run bisque-voxelize --resolution 8" bake="run bisque-bake --size 32"
write_box >low.obj
ok $vox low.obj -o scan.nvdb

# ---- a shared directory ----

mkdir shared private
chmod 1777 shared
echo mine >private/file
if [ "$(id -u)" -eq 0 ]; then
    ln -s "$PWD/private/file" shared/scan.nvdb
    ln -s "$PWD/private/new" shared/new.nvdb
    chown -h 65534 shared/*.nvdb
    for name in scan new; do
        $vox low.obj -o shared/$name.nvdb --no-tris
        refused 73 "bisque-voxelize: shared/$name.nvdb: cannot be created: Permission denied"
    done
    holds "a link of somebody else does not choose what is replaced" [ "$(cat private/file)" = mine ]
    holds "nor what is created" [ ! -e private/new ]
else
    skip "links of other users in a shared directory" "needs root"
fi
ln -s "$PWD/private/own.nvdb" shared/own.nvdb
ok $vox low.obj -o shared/own.nvdb --no-tris
holds "a link of one's own is followed" [ -s private/own.nvdb ]

if sanitized; then
    skip "planted names and clocks that jump" "sanitizers want to be loaded first"
else
    # Names that look like those of temporary files, on a file system that needs names: a link, a pipe
    # and a folder, which nobody waits for, follows or removes.
    python3 - >names <<'PYTHON'
def name(of, letters):
    h = 0xcbf29ce484222325
    for c in (of + "." + letters).encode():
        h = (h ^ c) * 0x100000001b3 % 2**64
    check = ""
    for _ in range(6):
        check += "abcdefghijklmnopqrstuvwxyz0123456789"[h % 36]
        h //= 36
    return "." + of + "." + letters + check + ".tmp"
print(name("x.nvdb", "aaaaaa"), name("x.nvdb", "bbbbbb"), name("x.nvdb", "cccccc"),
      name("x.nvdb", "dddddd"))
PYTHON
    read -r link pipe folder empty <names
    ln -s "$PWD/private/file" "shared/$link"
    mkfifo "shared/$pipe"
    mkdir "shared/$folder"
    : >"shared/$empty"
    FAULT_UNDER=$PWD FAULT_PLAIN=1 LD_PRELOAD=$TESTS/faults.so ok $vox low.obj -o shared/x.nvdb --no-tris
    holds "the grid is there" cmp -s shared/x.nvdb scan.nvdb
    holds "a link stays, and its file" [ -h "shared/$link" -a "$(cat private/file)" = mine ]
    holds "a pipe and a folder stay" [ -p "shared/$pipe" -a -d "shared/$folder" ]
    holds "an empty file with this name was a leftover" [ ! -e "shared/$empty" ]

    # ---- the system's clock ----

    ok $bake scan.nvdb low.obj -o 'one_<MAP>.exr' --maps normal,mask
    jumping()
    {
        FAULT_UNDER=$PWD FAULT_CLOCK=$jump LD_PRELOAD=$TESTS/faults.so run "$@"
    }
    for jump in 86400 -86400; do
        ok jumping bisque-voxelize --resolution 8 low.obj -o clock.nvdb --tris clock.tris
        same clock.nvdb scan.nvdb
        touch -d "@$(($(date +%s) + jump))" scan.nvdb
        in_parts 2 jumping bisque-bake --size 32 scan.nvdb low.obj -o 'two_<MAP>.exr' --maps normal,mask
        same two_normal.exr one_normal.exr
        rm -f two_* clock.*
    done
fi

# ---- names ----

# A line break, a carriage return and an escape sequence would forge lines of a log.
name=$(printf 'a\nbisque-bake: all is well\r\033[2K') shown='a\x0abisque-bake: all is well\x0d\x1b[2K'
cp low.obj "$name.obj"
$vox "$name.obj" -o "none/$name.nvdb"
command="bisque-voxelize of names with line breaks"
[ "$(wc -l <"$err")" -eq 1 ] && grep -Fq "none/$shown.nvdb" "$err"
check "one line for a name with line breaks" $?
run bisque-bake scan.nvdb "$name.obj" -o "$name.png" --maps mask --size 32 --json
command="bisque-bake of names with line breaks"
code 0
jq -e --arg name "$name" '.mesh_path == $name + ".obj" and .maps.mask == $name + ".png"' "$out" >/dev/null
check "JSON has the names as they are" $?
run bisque-compare "$name.obj" "$name.png"
command="bisque-compare of names with line breaks"
[ "$(wc -l <"$err")" -eq 1 ] && grep -Fq "$shown" "$err"
check "one line" $?
run bisque-bake scan.nvdb low.obj -o "$name.exr" --maps mask --size 32 --part 1/1
command="bisque-bake bakes a part"
code 0
[ "$(head -n 1 "$out" | grep -Fc "$shown.exr: part 1/1")" -eq 1 ]
check "a part's report is one line" $?
finish

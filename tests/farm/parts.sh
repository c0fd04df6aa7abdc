# parts.sh - a scan in eight parts, for tests of farms. Needs tests/cli/lib.sh.

# write_parts SCAN.obj: writes part_0.obj to part_7.obj, with an eighth of the faces each, and their
# list parts.txt.
write_parts()
{
    grep '^f ' "$1" >faces && split -n l/8 -d -a 1 faces faces_
    for i in 0 1 2 3 4 5 6 7; do
        { grep -v '^f ' "$1" && cat faces_$i; } >part_$i.obj
        echo part_$i.obj
    done >parts.txt
}

# voxelize_parts RESOLUTION: sorts the parts here, and writes parts.nvdb of all chunk files at once.
voxelize_parts()
{
    mkdir -p here
    for i in 0 1 2 3 4 5 6 7; do
        run bisque-voxelize part_$i.obj -o here/$i.tris
        code 0
    done
    run bisque-voxelize here/*.tris -o parts.nvdb --resolution "$1"
    code 0
}

#!/bin/sh
# test_threads.sh - the programs write the same bytes on one thread and on eight: both stages of a
# textured scan with several chunks and regions, previews, comparisons. With config=tsan it finds
# races.
. "$(dirname "$0")/lib.sh"
ldd "$BIN/bisque-voxelize" | grep -q libtsan ||
    unsanitized "the same bytes on one thread and on eight" "AddressSanitizer looks for other faults"

"$TESTS/generate-scan" --triangles 100000 --uvs vase -o vase.obj
"$TESTS/generate-scan" vase-low -o low.obj

# Any image can be a texture; here it is a map.
ok run bisque-voxelize vase.obj -o plain.nvdb --resolution 64 --no-tris
ok run bisque-bake plain.nvdb low.obj -o texture.png --maps normal --size 128 --device cpu

for threads in 1 8; do
    mkdir $threads
    ok run bisque-voxelize vase.obj --texture texture.png -o $threads/vase.nvdb --resolution 200 --threads $threads
    ok run bisque-voxelize $threads/vase.tris -o $threads/smooth.nvdb --resolution 140 --threads $threads
    for scan in vase.nvdb vase.tris; do
        to=$threads/${scan#*.}
        ok run bisque-bake $threads/$scan low.obj -o "${to}_<MAP>.exr" --maps normal,color,mask --size 100x75 \
            --samples 2 --preview "${to}_preview.png" --device cpu --threads $threads
        ok run bisque-bake $threads/$scan low.obj -o "${to}_<MAP>.png" --maps normal,color --size 100x75 \
            --samples 1 --type 8 --device cpu --threads $threads
    done
    ok run bisque-compare $threads/nvdb_normal.exr $threads/tris_normal.exr --mask-a $threads/nvdb_mask.exr \
        --mask-b $threads/tris_mask.exr --heatmap $threads/heat.png --json --threads $threads
    jq -S 'del(.cost, .files_read) | walk(if type == "string" then sub("^[18]/"; "") else . end)' "$out" \
        >$threads/compared.json
done
(cd 1 && ls) >names
for name in $(cat names); do
    same 1/$name 8/$name
done
holds "all files were compared: $(tr '\n' ' ' <names)" [ "$(wc -l <names)" -eq 17 ]
# The files are not empty: a share of texels was hit, and the colours are those of the texture.
cmp -s 1/nvdb_normal.exr 1/tris_normal.exr
holds "the grid's map is not that of the triangles" [ $? -eq 1 ]
finish

#!/bin/sh
# check_image.sh - a bake in the image of `make image`, as its ordinary user, gives the maps of this build.
# IMAGE is the archive. Containers run with buildah's chroot isolation, which hides no processes and no
# network: that is all that a build machine has. Needs root.
image=$(readlink -f "${IMAGE:?is the archive}") || exit 1
. "$(dirname "$0")/../cli/lib.sh"
export STORAGE_DRIVER=vfs BUILDAH_ISOLATION=chroot
buildah() { command buildah --root "$work/storage" --runroot "$work/run" "$@"; }
mkdir data
"$TESTS/generate-scan" --triangles 20000 --colors vase -o data/scan.obj
"$TESTS/generate-scan" vase-low -o data/low.obj
chmod 777 data
container=$(buildah from "oci-archive:$image") || exit 1
# in_image WORD...: runs a program in the image, which must succeed.
in_image()
{
    command="image: $*" code=0
    buildah run --volume "$PWD/data:/work" "$container" -- "$@" >"$out" 2>"$err" || code=$?
    code 0
}
in_image sh -c 'id -u'
holds "the user is not root" [ "$(cat "$out")" = 1000 ]
in_image bisque-voxelize scan.obj -o scan.nvdb --resolution 128
for step in "--part 1/2" "--part 2/2" "--merge 2"; do
    in_image bisque-bake scan.nvdb low.obj --size 128 --maps normal,color -o 'map_<MAP>.png' $step
done
ok run bisque-bake data/scan.nvdb data/low.obj --size 128 --maps normal,color -o 'map_<MAP>.png'
same map_normal.png data/map_normal.png
same map_color.png data/map_color.png
in_image bisque-voxelize scan.obj -o other.nvdb --resolution 32 --vdb other.vdb
in_image bisque-bake scan.tris low.obj --size 32 --report page.html -o 'exact_<MAP>.exr'
# Links to bisque-image stand for programs.
mkdir bin
for program in voxelize bake; do
    ln -s "$top/tools/farm/bisque-image" bin/bisque-$program
done
export BISQUE_IMAGE="$container" BISQUE_RUN="buildah --root $work/storage --runroot $work/run run --volume $PWD/data:/work"
command="bin/bisque-voxelize" code=0
bin/bisque-voxelize scan.obj -o linked.nvdb --resolution 128 --no-tris >"$out" 2>"$err" || code=$?
code 0
same data/scan.nvdb data/linked.nvdb
command="bin/bisque-bake" code=0
bin/bisque-bake missing.nvdb low.obj -o 'x_<MAP>.png' >"$out" 2>"$err" || code=$?
code 66
buildah rm "$container" >"$out"
finish

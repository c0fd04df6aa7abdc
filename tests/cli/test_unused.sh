#!/bin/sh
# test_unused.sh - options that have no effect on a bake are named, and those that have one are not.
. "$(dirname "$0")/lib.sh"

"$TESTS/generate-scan" -n 2000 vase -o scan.obj
"$TESTS/generate-scan" vase-low -o vase-low.obj
ok run bisque-voxelize scan.obj -o vase-high.nvdb --resolution 16
sed 's/^f .*//' scan.obj >with.obj # the same scan with normals, of which all point up
echo 'vn 0 0 1' >>with.obj
sed -n 's/^f \([0-9]*\)[^ ]* \([0-9]*\)[^ ]* \([0-9]*\).*/f \1\/\/1 \2\/\/1 \3\/\/1/p' scan.obj >>with.obj
ok run bisque-voxelize with.obj -o with.tris
bake() { run bisque-bake vase-high.nvdb vase-low.obj --progress none --size 4 --samples 1 "$@"; }

# unused NEEDS OPTION VALUE -- USE...: the option has no effect alone, and has one beside USE.
unused()
{
    needs=$1 option=$2
    shift 2
    values=
    while [ "$1" != -- ]; do
        values="$values $1"
        shift
    done
    shift
    name=$option
    case $values in *=*) name=$option${values%%=*} ;; esac
    # shellcheck disable=SC2086 # a value is a word
    bake --maps mask --device cpu -o map.exr $option $values
    code 0
    holds "a warning of $name" [ "$(cat "$err")" = "bisque-bake: warning: $name has no effect: it needs $needs" ]
    # shellcheck disable=SC2086
    bake --device cpu $option $values "$@"
    code 0
    holds "none of $option beside $*" [ ! -s "$err" ]
}

unused "the map height" --range height=1 -- --maps height -o map.png
unused "the map position" --range position=box -- --maps position -o map.png
unused "the map curvature" --distance curvature=0.1 -- --maps curvature -o map.png
unused "the map curvature" --range curvature=1 -- --maps curvature -o map.png
unused "the map ao or bent" --rays ao=2 -- --maps ao -o map.png
unused "the map ao or bent" --ao spread=90 -- --maps bent -o map.png
unused "the map ao or bent" --distance ao=1 -- --maps mask,bent -o '<MAP>.png'
unused "the map ao or bent or thickness" --ao coarse=none -- --maps bent -o map.png
unused "the map thickness" --range thickness=1 -- --maps thickness -o map.png
unused "the map thickness" --rays thickness=2 -- --maps thickness -o map.png
unused "the map thickness" --distance thickness=1 -- --maps thickness -o map.png
unused "the map normal or bent" --normal space=object -- --maps normal -o map.png
unused "the map normal or bent" --normal green=down -- --maps bent -o map.png
unused "--preview or --report" --view count=1 -- --preview preview.png -o '<MAP>.png'
unused "--preview or --report" --view up=z -- --preview preview.png -o '<MAP>.png'
unused "--preview or --report" --view from=90 -- --preview preview.png -o '<MAP>.png'
unused "--preview or --report" --view above=30 -- --preview preview.png -o '<MAP>.png'
unused "--glb" --material alpha=mask -- --glb m.glb -o '<MAP>.png'
unused "--glb" --material sides=two -- --glb m.glb -o '<MAP>.png'
unused "a device other than cpu" --gpu-memory 1G -- --device auto -o '<MAP>.png'

# nothing NEEDS OPTION SCAN ARGUMENT...: the option has no effect on maps of the scan.
nothing()
{
    needs=$1 option=$2 scan=$3
    shift 2
    ok run bisque-bake "$@" vase-low.obj --progress none --size 4 --samples 1 -o '<MAP>.exr'
    holds "a warning of $option on $scan" [ "$(cat "$err")" = "bisque-bake: warning: $option has no effect: it needs $needs" ]
}
for words in "--ao coarse=none" "--scan sampling=trilinear"; do
    # shellcheck disable=SC2086 # an option and its value
    nothing "a grid" "${words%[ =]*}" vase-high.tris --maps ao $words
    # shellcheck disable=SC2086
    ok run bisque-bake vase-high.tris vase-high.nvdb vase-low.obj --progress none --size 4 --samples 1 --maps ao \
        $words -o map.exr
    holds "none of $words for a grid beside triangles" [ ! -s "$err" ]
done
nothing "triangles without normals" "--scan normals" with.tris --scan normals=flat --two-sided
nothing "triangles without normals" "--scan normals" vase-high.nvdb --scan normals=auto
nothing "--normal space=tangent" "--normal green" vase-high.nvdb --normal green=up,space=object
bake --scan normals=flat -o '<MAP>.exr'
code 64
ok run bisque-bake vase-high.tris vase-low.obj --progress none --size 4 --samples 1 --scan normals=flat -o '<MAP>.exr'
holds "none of --scan normals for triangles without normals" [ ! -s "$err" ]
unused "a map other than mask" --padding 3 -- --maps mask,height -o '<MAP>.png'

# An option that needs two others is named for the one that lacks.
bake --maps mask --distance ao=1 --ao falloff=linear -o map.exr
code 0
holds "both options of ao" [ "$(grep -c "has no effect: it needs the map ao or bent" "$err")" -eq 2 ]
finish

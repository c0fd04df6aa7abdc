#!/bin/sh
# test_options.sh - options by key, and options by the names of an earlier release.
. "$(dirname "$0")/lib.sh"
p=bisque-bake:

"$TESTS/generate-scan" -n 2000 vase -o vase_high.obj
"$TESTS/generate-scan" vase-low -o vase_low.obj
ok run bisque-voxelize vase_high.obj -o vase_high.nvdb --resolution 16

# plan FILE OPTION...: writes a plan of a bake with these options, and its options to FILE.
plan()
{
    to=$1
    shift
    rm -f plan.json
    ok run bisque-bake vase_high.nvdb vase_low.obj -o 'a_<MAP>.exr' --size 8 --maps all --preview a.png --tasks 1 \
        --plan plan.json --progress none "$@"
    jq .options plan.json >"$to"
}

# alias_of OLD -- NEW: a bake with the old options has the options of one with the new ones.
plan usual
alias_of()
{
    old=
    while [ "$1" != -- ]; do
        old="$old $1"
        shift
    done
    shift
    # shellcheck disable=SC2086 # an option and its value
    plan old $old
    plan new "$@"
    cmp -s old new && ! cmp -s old usual
    check "$old is $*" $?
}

if command -v jq >/dev/null; then
    alias_of --height-range 2 -- --range height=2
    alias_of --position-in box -- --range position=box
    alias_of --curvature-range 3 -- --range curvature=3
    alias_of --curvature-radius 0.5 -- --distance curvature=0.5
    alias_of --ao-distance 0.5 --ao-falloff linear -- --distance ao=0.5 --ao falloff=linear
    alias_of --thickness-distance 0.5 -- --distance thickness=0.5
    alias_of --ao-rays 3 --thickness-rays 4 -- --rays ao=3,thickness=4
    alias_of --ao-spread 90 --ao-coarse none -- --ao spread=90,coarse=none
    alias_of --preview-views 2 --up z -- --view count=2,up=z
    alias_of --half -- --type half
    alias_of --float -- --type float
    alias_of --match name --match-suffixes _low,_high --float -- --match name --type float
    alias_of --match name --match-suffixes _low,_high -- --match _low,_high
else
    lacks "options of plans" "jq is not installed"
fi
ok run bisque-bake vase_high.nvdb vase_low.obj -o a.png --maps normal --size 8 --png-bits 8
holds "--png-bits 8 gives 8 bits" [ "$(od -An -tu1 -j24 -N1 a.png | tr -d ' ')" = 8 ]
for list in devices tiles; do
    files=
    [ $list = devices ] || files=vase_low.obj
    # shellcheck disable=SC2086 # one file or none
    ok run bisque-bake --list $list $files
    cp "$out" new
    # shellcheck disable=SC2086
    run bisque-bake --list-$list $files
    holds "--list-$list is --list $list" cmp -s "$out" new
done
ok run bisque-bake --verify vase_high.nvdb
out_like '^vase_high.nvdb: ok '

# What is wrong with a value is said with the name that was given.
bake="run bisque-bake vase_high.nvdb vase_low.obj -o a_<MAP>.exr"
$bake --ao-rays 0
refused 64 "$p --ao-rays: \"0\" is not a whole number from 1 to 4096"
$bake --rays ao=3,thickness=0
refused 64 "$p --rays thickness: \"0\" is not a whole number from 1 to 4096"
for words in 3 bent=3 =3 aoo=3; do
    $bake --rays $words
    refused 64 "$p --rays: \"${words%%=*}\" is not KEY=VALUE with a key of --help"
done
finish

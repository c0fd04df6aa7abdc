#!/bin/sh
# test_options.sh - options by key, and wrong names of options.
. "$(dirname "$0")/lib.sh"
p=bisque-bake:

"$TESTS/generate-scan" -n 2000 vase -o vase_high.obj
"$TESTS/generate-scan" vase-low -o vase_low.obj
ok run bisque-voxelize vase_high.obj -o vase_high.nvdb --resolution 16

# options FILE OPTION...: bakes a part with these options, and writes the checksum of its options to FILE.
options()
{
    to=$1
    shift
    rm -f a_part*
    ok run bisque-bake vase_high.nvdb vase_low.obj -o 'a_<MAP>.exr' --size 8 --maps all --part 1/1 --progress none "$@"
    LC_ALL=C grep -ao 'bisque:options.string.*bisque:' a_part-1-of-1.exr >"$to"
    holds "there is a checksum of $*" [ -s "$to" ]
}

options usual
options together --rays ao=3,thickness=4 --match _low,_high
options apart --rays thickness=4 --match name --rays ao=3
cmp -s together apart && ! cmp -s apart usual
check "keys may be given together or apart" $?
# Each option that texels depend on is in it, and no other is.
for option in "--rays ao=3" "--distance ao=1" "--samples 1" "--front 1" "--back 1" "--extrude 1" "--two-sided" "--ray-directions face" \
    "--normal space=object" "--ao spread=90" "--low normals=flat --as-is" "--size 9"; do
    options other $option
    ! cmp -s usual other
    check "$option is in the checksum" $?
done
for option in "--padding 2" "--type half" "--device cpu" "--threads 1" "--range height=1" "--exr-tiles 16" "--max-missed 3" "--view count=1"; do
    options other $option
    same usual other
done
ok run bisque-bake vase_high.nvdb vase_low.obj -o a.png --maps normal --size 8 --type 8
holds "--type 8 gives 8 bits" [ "$(od -An -tu1 -j24 -N1 a.png | tr -d ' ')" = 8 ]

# What is wrong with a value is said with the name of the option.
bake="run bisque-bake vase_high.nvdb vase_low.obj -o a_<MAP>.exr"
$bake --rays ao=3,thickness=0
refused 64 "$p --rays thickness: \"0\" is not a whole number from 1 to 4096"
for words in 3 bent=3 =3 aoo=3; do
    $bake --rays $words
    refused 64 "$p --rays: \"${words%%=*}\" is not KEY=VALUE with a key of --help"
done

# A wrong name is refused with the nearest right one, if there is one: at most three letters differ, and at most a third.
while read -r wrong nearest; do
    $bake "$wrong" 3
    refused 64 "$p unrecognized option '$wrong'; the nearest is $nearest"
done <<'CASES'
--ao-rays --rays ao=N
--ao-rays=3 --rays ao=N
--thicknes-ray --rays thickness=N
--rays-thickness --rays thickness=N
--range-hight --range height=D
--position-in --range position=SHAPE
--green --normal green=DIR
--sampling --scan sampling=MODE
--up --view up=AXIS
--padd1ng --padding N
--two-side-d --two-sided
--memroy --memory SIZE
--resolution --size N | WxH
CASES
for wrong in --match-suffixes --half --list-devices --curvature-radius --zz "--$(printf '%0200d' 0)" --=; do
    $bake "$wrong" 3
    refused 64 "$p unrecognized option '$wrong' (see --help)"
done
run bisque-voxelize vase_high.obj -o a.nvdb --resume
refused 64 "bisque-voxelize: unrecognized option '--resume' (see --help)"
finish

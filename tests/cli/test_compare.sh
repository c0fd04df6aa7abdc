#!/bin/sh
# test_compare.sh - runs bisque-compare: figures, limits, exit codes, pictures.
. "$(dirname "$0")/lib.sh"

compare="run bisque-compare"
p=bisque-compare:
write_box >low.obj
run bisque-voxelize low.obj -o box.nvdb --no-tris --resolution 48
run bisque-bake box.nvdb low.obj --size 64 --maps normal,mask --normal-space object --float -o 'a_<MAP>.exr'
code 0
run bisque-bake box.nvdb low.obj --size 32 --maps normal --float -o small.exr
code 0
start="a_mask.exr a_normal.exr box.nvdb low.obj small.exr"

$compare --help
code 0
options="type mask mask-a mask-b force heatmap histogram scale max-mean max-median max-p95 max-p99 max-error min-psnr
    min-agreement memory threads progress json help version"
for option in $options; do
    out_like "--$option"
done
man_page bisque-compare $options

$compare a_normal.exr a_normal.exr
code 0
out_like 'compared as normal$'
out_like '^degrees: mean 0, rms 0, median 0, p95 0, p99 0, max 0 at '
$compare a_mask.exr a_mask.exr --json
code 0
json '.type == "data" and .max == 0 and .agreement == 1 and .within_limits'
$compare a_normal.exr a_normal.exr --type color --json
code 0
json '.psnr == null and .mean == 0'

# Maps of tangent and object space are refused; with --force they are far apart, and a limit fails.
run bisque-bake box.nvdb low.obj --size 64 --maps normal --float -o t.exr
$compare t.exr a_normal.exr --mask a_mask.exr
refused 65 "$p t.exr has bisque:normalSpace \"tangent\", a_normal.exr has \"object\": these maps cannot be compared"
$compare t.exr a_normal.exr --mask a_mask.exr --force --max-mean 1 --max-p95 5 --json
code 1
json '.mean > 20 and (.within_limits | not)'
grep -q "^$p mean .* is above --max-mean 1$" "$err"
check "the limit that does not hold is named" $?
$compare t.exr a_normal.exr --force --max-mean 180
code 0

# Maps with green up and green down, or a mask and a normal map, differ in meaning, not by some degrees.
run bisque-bake box.nvdb low.obj --size 64 --maps normal --green down --float -o d.exr
$compare t.exr d.exr
refused 65 "$p t.exr has bisque:green \"up\", d.exr has \"down\": these maps cannot be compared"
$compare d.exr t.exr --type data
refused 65 "$p d.exr has bisque:green \"down\", t.exr has \"up\": these maps cannot be compared"
$compare d.exr t.exr --force
code 0
$compare d.exr d.exr
code 0
$compare a_mask.exr a_normal.exr
refused 65 "$p a_mask.exr has bisque:map \"mask\", a_normal.exr has \"normal\": these maps cannot be compared"
rm d.exr

$compare a_normal.exr a_normal.exr --mask-a a_mask.exr --mask-b a_mask.exr --heatmap h.png --histogram g.png
code 0
out_like '^hit agreement: 100.0000 %'
[ "$(od -An -tx1 -N 4 h.png | tr -d ' \n')" = 89504e47 ] && [ -s g.png ]
check "pictures are PNG files" $?
rm h.png g.png t.exr

$compare
refused 64 "$p two EXR files are needed (see --help)"
$compare a_normal.exr a_normal.exr --max-mean -1
code 64
$compare a_normal.exr a_normal.exr --min-agreement 2 --mask-a a_mask.exr --mask-b a_mask.exr
refused 64 "$p --min-agreement: 2 is not a share from 0 to 1"
for mask in '' '--mask a_mask.exr' '--mask-a a_mask.exr'; do
    $compare a_normal.exr a_normal.exr --min-agreement 0.5 $mask
    refused 64 "$p --min-agreement needs --mask-a and --mask-b"
done
$compare a_normal.exr a_normal.exr --min-psnr 30
refused 64 "$p --min-psnr is for colours, these maps were compared as normal"
$compare a_normal.exr small.exr
refused 65 "$p a_normal.exr has 64 x 64 texels, small.exr has 32 x 32"
$compare a_normal.exr missing.exr
code 66
: >empty.exr
$compare a_normal.exr empty.exr
refused 65 "$p empty.exr: Unable to read magic and version flags"
rm empty.exr
$compare a_normal.exr low.obj
code 65
$compare a_normal.exr a_normal.exr --heatmap a_normal.exr
code 64
$compare a_normal.exr a_normal.exr --heatmap h.png --histogram ./h.png
refused 64 "$p ./h.png: two outputs have this name"
$compare a_normal.exr a_normal.exr --histogram h.exr
refused 64 "$p h.exr: the picture is a PNG file: its name must end in .png"
$compare a_normal.exr a_normal.exr --heatmap nowhere/h.png
code 73
files $start
finish

#!/bin/sh
# test_compare.sh - runs bisque-compare: figures, limits, exit codes, pictures.
. "$(dirname "$0")/lib.sh"

compare="run bisque-compare"
p=bisque-compare:
write_box >low.obj
run bisque-voxelize low.obj -o box.nvdb --no-tris --resolution 48
ok run bisque-bake box.nvdb low.obj --size 64 --maps normal,mask --normal space=object --type float -o 'a_<MAP>.exr'
ok run bisque-bake box.nvdb low.obj --size 32 --maps normal --type float -o small.exr
start="a_mask.exr a_normal.exr box.nvdb low.obj small.exr"

help_and_man_page bisque-compare

ok $compare a_normal.exr a_normal.exr
out_like 'compared as normal$'
out_like '^degrees: mean 0, rms 0, median 0, p95 0, p99 0, max 0 at '
ok $compare a_mask.exr a_mask.exr --json
json '.type == "data" and .max == 0 and .agreement == 1 and .within_limits'
ok $compare a_normal.exr a_normal.exr --type color --json
json '.psnr == null and .mean == 0'

# Maps of tangent and object space are refused; with --force they are far apart, and a limit fails.
run bisque-bake box.nvdb low.obj --size 64 --maps normal --type float -o t.exr
$compare t.exr a_normal.exr --mask a_mask.exr
refused 65 "$p t.exr has bisque:normalSpace \"tangent\", a_normal.exr has \"object\": these maps cannot be compared"
$compare t.exr a_normal.exr --mask a_mask.exr --force --max-mean 1 --max-p95 5 --json
code 1
json '.mean > 20 and (.within_limits | not)'
holds "the limit that does not hold is named" grep -q "^$p mean .* is above --max-mean 1$" "$err"
ok $compare t.exr a_normal.exr --force --max-mean 180

# Maps with green up and green down, or a mask and a normal map, differ in meaning, not by some degrees.
run bisque-bake box.nvdb low.obj --size 64 --maps normal --normal green=down --type float -o d.exr
$compare t.exr d.exr
refused 65 "$p t.exr has bisque:green \"up\", d.exr has \"down\": these maps cannot be compared"
$compare d.exr t.exr --type data
refused 65 "$p d.exr has bisque:green \"down\", t.exr has \"up\": these maps cannot be compared"
ok $compare d.exr t.exr --force
ok $compare d.exr d.exr
$compare a_mask.exr a_normal.exr
refused 65 "$p a_mask.exr has bisque:map \"mask\", a_normal.exr has \"normal\": these maps cannot be compared"
rm d.exr

ok $compare a_normal.exr a_normal.exr --mask-a a_mask.exr --mask-b a_mask.exr --heatmap h.png
out_like '^hit agreement: 100.0000 %'
out_like '^h.png: from black, 0, to light yellow, 1 degrees and more$'
[ "$(od -An -tx1 -N 4 h.png | tr -d ' \n')" = 89504e47 ]
check "the heat map is a PNG file" $?
rm h.png t.exr

# bytes HEX...: writes bytes.
bytes()
{
    for byte; do
        printf "\\$(printf %03o "0x$byte")"
    done
}
# map NAME VALUE...: writes an EXR file of one row and the channel Y; values are float32 as four
# bytes in hexadecimal, the lowest first.
map()
{
    name=$1 box='00 00 00 00 00 00 00 00' count=$(($# - 1))
    shift
    corner="$(printf %02x $((count - 1))) 00 00 00 00 00 00 00"
    {
        bytes 76 2f 31 01 02 00 00 00
        printf 'channels\0chlist\0' && bytes 13 00 00 00 59 00 02 00 00 00 00 00 00 00 01 00 00 00 01 00 00 00 00
        printf 'compression\0compression\0' && bytes 01 00 00 00 00
        printf 'dataWindow\0box2i\0' && bytes 10 00 00 00 $box $corner
        printf 'displayWindow\0box2i\0' && bytes 10 00 00 00 $box $corner
        printf 'lineOrder\0lineOrder\0' && bytes 01 00 00 00 00
        printf 'pixelAspectRatio\0float\0' && bytes 04 00 00 00 00 00 80 3f
        printf 'screenWindowCenter\0v2f\0' && bytes 08 00 00 00 $box
        printf 'screenWindowWidth\0float\0' && bytes 04 00 00 00 00 00 80 3f 00
    } >"$name"
    start_of_row=$(($(wc -c <"$name") + 8))
    {
        bytes "$(printf %02x $((start_of_row % 256)))" "$(printf %02x $((start_of_row / 256)))" 00 00 00 00 00 00
        bytes 00 00 00 00 "$(printf %02x $((4 * count)))" 00 00 00 $*
    } >>"$name"
}
one='00 00 80 3f' nan='00 00 c0 7f' inf='00 00 80 7f'
map ones.exr "$one" "$one" "$one" "$one"
map nan.exr "$nan" "$nan" "$nan" "$nan"
map some.exr "$one" "$nan" "$one" "$inf"

# NaN and infinite values are outside of every limit, in either map.
ok $compare ones.exr ones.exr --max-error 0
for pair in 'nan.exr nan.exr' 'nan.exr ones.exr' 'ones.exr nan.exr' 'some.exr ones.exr' 'ones.exr some.exr'; do
    for limit in --max-error --max-mean --max-median --max-p95 --max-p99; do
        $compare $pair $limit 1000
        code 1
        holds "they are named" grep -Eq "^$p [24] texels are NaN or infinite: outside of every limit$" "$err"
    done
    ok $compare $pair
    out_like '^NaN or infinite: [24] texels'
done
$compare some.exr ones.exr --json --max-error 0
code 1
json '.compared == 2 and .not_finite == 2 and .not_finite_a == 2 and .not_finite_b == 0 and .max == 0 and (.within_limits | not)'
ok $compare nan.exr ones.exr --json
json '.compared == 0 and .not_finite == 4 and .mean == null and .max == null and .within_limits'
ok $compare some.exr ones.exr --json --max-error 0 --ignore-nan
json '.compared == 2 and .not_finite == 2 and .within_limits'
$compare nan.exr ones.exr --ignore-nan
refused 65 "$p no texel is covered by both nan.exr and ones.exr and finite in both"
$compare ones.exr ones.exr --mask some.exr --max-error 0
code 1
$compare ones.exr ones.exr --mask-a ones.exr --mask-b some.exr --min-agreement 0.5
code 1
ok $compare ones.exr ones.exr --mask some.exr --max-error 0 --ignore-nan

# Other channels, other sizes.
map wide.exr "$one" "$one" "$one" "$one" "$one"
$compare ones.exr wide.exr
refused 65 "$p ones.exr has 4 x 1 texels, wide.exr has 5 x 1"
$compare ones.exr ones.exr --mask wide.exr
refused 65 "$p wide.exr has 5 x 1 texels, ones.exr has 4 x 1"
sed s/Y/Z/ ones.exr >z.exr # the name of its channel
$compare ones.exr z.exr
refused 65 "$p ones.exr and z.exr have different channels"
$compare ones.exr ones.exr --type color
refused 65 "$p ones.exr has no channels R, G and B"
rm ones.exr nan.exr some.exr wide.exr z.exr

$compare
refused 64 "$p two maps, or a mesh and a scan, are needed (see --help)"
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
$compare a_normal.exr a_normal.exr --min-psnr 30 --report refused.html
refused 64 "$p --min-psnr is for colours, these maps were compared as normal"
holds "no page of a refused comparison" [ ! -e refused.html ]
$compare a_normal.exr small.exr
refused 65 "$p a_normal.exr has 64 x 64 texels, small.exr has 32 x 32"
$compare a_normal.exr missing.exr
code 66
: >empty.exr
$compare a_normal.exr empty.exr
refused 65 "$p empty.exr: not a readable image: it is no PNG, JPEG, TIFF, OpenEXR, JPEG 2000, WebP, BMP, Radiance HDR, PNM or TGA"
rm empty.exr
$compare a_normal.exr low.obj
code 65
$compare a_normal.exr a_normal.exr --heatmap a_normal.exr
code 64
$compare a_normal.exr a_normal.exr --heatmap h.exr
refused 64 "$p h.exr: the picture is a PNG file: its name must end in .png"
$compare a_normal.exr a_normal.exr --heatmap nowhere/h.png
code 73
files $start

# ---- PNG files ----

# A map in PNG is that in OpenEXR, but for the rounding of its samples. Channel errors of 8 bits are at
# most a dithered step, or half a step (rounded: 17/32) for normals, of which three bound the angle.
awk '/^v / { print $0, ($2 > 0 ? 0.9 : 0.1), 0.4, 0.7; next } { print }' low.obj >painted.obj
ok run bisque-voxelize painted.obj -o painted.nvdb --resolution 48
for bits in 8 16; do
    case $bits in
    8) limits="normal:0.42 color:1.2 mask:0.0042 height:0.0042" ;;
    16) limits="normal:0.002 color:0.05 mask:0.0005 height:0.00002" ;;
    esac
    bake="run bisque-bake painted.nvdb low.obj --size 64 --maps normal,color,height,mask"
    ok $bake --type $bits -o "png_<MAP>.png"
    ok $bake --type float -o "exr_<MAP>.exr"
    for limit in $limits; do
        map=${limit%:*}
        for pair in "png_$map.png exr_$map.exr" "exr_$map.exr png_$map.png"; do
            ok $compare $pair --max-error "${limit#*:}" --json
            case $map in height | mask) kind=data ;; *) kind=$map ;; esac
            json ".type == \"$kind\" and (.max > 0 or \"$map\" == \"mask\")"
        done
    done
done
# The same pixels without attributes, as another program has them: A decides what they are. Grey is
# compared with each of R, G and B; opaque alpha is nothing.
PYTHONPATH=$top/tests/cli python3 - <<'END'
import png
rows = png.read("png_normal.png")[3]
png.write("foreign.png", 16, rows)
png.write("alpha.png", 16, [[(*t, 65535) for t in row] for row in rows])
rows = png.read("png_mask.png")[3]
png.write("mask_rgb.png", 16, [[(v, v, v) for v, in row] for row in rows])
ramp = [[(1000 * x + y,) for x in range(64)] for y in range(64)]
png.write("grey.png", 16, ramp)
png.write("rgb.png", 16, [[(v, v, v) for v, in row] for row in ramp])
png.write("blue.png", 16, [[(v, v, v + 655) for v, in row] for row in ramp])
END
for pair in "exr_normal.exr foreign.png" "foreign.png exr_normal.exr" "exr_normal.exr alpha.png"; do
    ok $compare $pair --max-error 0.002 --json
    json '.type == "normal"'
done
for pair in "grey.png rgb.png" "rgb.png grey.png" "exr_mask.exr mask_rgb.png"; do
    ok $compare $pair --max-error 0 --json
    json '.type == "data"'
done
ok $compare grey.png blue.png --json
json '.max > 0.00999 and .max < 0.01' # 655 / 65535
ok $compare png_normal.png png_normal.png --mask png_mask.png --heatmap h.png
$compare exr_height.exr exr_normal.exr
refused 65 "$p exr_height.exr has bisque:map \"height\", exr_normal.exr has \"normal\": these maps cannot be compared"
head -c 3000 png_normal.png >cut.png
$compare cut.png png_normal.png
refused_like 65 "^$p cut.png: damaged image: the file is cut off$"
printf 'no image' >text.png
$compare text.png png_normal.png
refused_like 65 '^bisque-compare: text.png: not a readable image: it is no PNG'
finish

#!/bin/sh
# test_bake.sh - bisque-bake from the outside: messages, exit codes, files.
. "$(dirname "$0")/lib.sh"

bake="run bisque-bake"
write_box >low.obj
# The same box as a scan with vertex colours.
awk '/^v / { print $0, ($2 + 0.0), ($3 / 2), ($4 / 3); next } { print }' low.obj >colored.obj
for scan in low colored; do
    ok run bisque-voxelize $scan.obj -o $scan.nvdb --no-tris --resolution 48
done
mv low.nvdb plain.nvdb
rm colored.obj
ok run bisque-voxelize low.obj -o box.nvdb --resolution 8
rm box.nvdb
start="box.tris colored.nvdb low.obj plain.nvdb"
files $start

magic()
{
    od -An -tx1 -N "$2" "$1" | tr -d ' \n'
}
is_exr()
{
    holds "$1 is an OpenEXR file" [ "$(magic "$1" 4)" = 762f3101 ]
}
# is_png FILE WIDTH HEIGHT BITS
is_png()
{
    [ "$(magic "$1" 25)" = "89504e470d0a1a0a0000000d49484452$(printf %08x%08x%02x "$2" "$3" "$4")" ]
    check "$1 is a PNG file of $2 x $3, $4 bit" $?
}

# ---- help, version, devices ----

help_and_man_page bisque-bake
ok $bake --help
maps=$(sed -n '/^Maps:$/,$s/^ \{6\}\([a-z_0-9:]*\)  .*/\1/p' "$out")
holds "the help lists maps" [ -n "$maps" ]
# The man page describes each map that the help lists.
for map in $maps; do
    holds "the man page describes map $map" grep -q "^\.It Cm $map\$" "$top/man/bisque-bake.1"
done
ok $bake --version
out_like '^bisque-bake [0-9]+\.[0-9]+\.[0-9]+$'
ok $bake --list devices
holds "the processor is a device" grep -q '^cpu ' "$out"
ok $bake --list devices --json
json '.devices | map(.id) | contains(["cpu"])'

# ---- usage ----

p=bisque-bake:
$bake
refused 64 "$p 0 input files given, not two: SCAN.nvdb and LOW.obj (see --help)"
$bake plain.nvdb
refused 64 "$p 1 input file given, not two: SCAN.nvdb and LOW.obj (see --help)"
$bake plain.nvdb plain.nvdb plain.nvdb -o a.exr
refused 64 "$p 3 scans (.nvdb, .tris) and 0 low-poly meshes given (see --help)"
$bake plain.nvdb low.obj
refused 64 "$p no output given: add -o 'OUT_<MAP>.exr'"
$bake low.obj plain.nvdb -o 'a_<MAP>.exr'
refused 64 "$p low.obj is a low-poly mesh, and plain.nvdb a scan: swap them"
$bake --list devices low.obj
refused 64 "$p --list devices takes no files"
$bake --nonsense
refused 64 "$p unrecognized option '--nonsense' (see --help)"
good="plain.nvdb low.obj -o a_<MAP>.exr"
known="$(echo $maps | sed 's/ /, /g') or transfer:NAME" # normal, color or transfer:NAME
$bake $good --maps normal,hight
refused 64 "$p --maps: \"hight\" is not $known"
$bake $good --maps normal,
refused 64 "$p --maps: \"\" is not $known"
$bake $good --maps norm
refused 64 "$p --maps: \"norm\" is not $known"
for size in 0 -1 x 1.5 1048577 99999999999999999999 '' 16x 16x0 x16 16x16x16 16X16 '16 x16' 0x10; do
    $bake $good --size "$size"
    refused 64 "$p --size: \"$size\" is not N, WxH or TILE=SIZE,...,*=SIZE with numbers from 1 to 1048576"
done
for sizes in 1001=64,1001=32 1001=64,1002=8,1001=64 '*=8,1001=64x32,1001=64'; do
    $bake $good --size "$sizes"
    refused 64 "$p --size: tile 1001 is given twice"
done
$bake $good --size 1001=64 --size 1001=32
refused 64 "$p --size: tile 1001 is given twice"
$bake $good --size '*=64,1001=8,*=32'
refused 64 "$p --size: * is given twice"
$bake $good --samples 0
refused 64 "$p --samples: \"0\" is not a whole number from 1 to 64"
$bake $good --front -1
refused 64 "$p --front: \"-1\" is not a non-negative number"
$bake $good --back far
refused 64 "$p --back: \"far\" is not a non-negative number"
for range in 0 -1 none nan; do
    $bake $good --range height=$range
    refused 64 "$p --range height: \"$range\" is not a positive number"
done
for option in "range height" "range curvature" "range thickness" "distance ao" "distance thickness"; do
    # shellcheck disable=SC2086 # an option and its key
    $bake $good --maps normal --$option=1e308
    refused_like 64 "^$p --$option: 1e308 is above "
    [ ! -e out.exr ] && [ ! -e out.png ]
    check "no map with --$option 1e308" $?
done
for option in "distance curvature" "range curvature"; do
    # shellcheck disable=SC2086 # an option and its key
    $bake $good --$option=0
    refused 64 "$p --$option: \"0\" is not a positive number"
done
$bake $good --range position=cube
refused 64 "$p --range position: \"cube\" is not sphere or box"
$bake $good --padding some
refused 64 "$p --padding: \"some\" is not a whole number from 0 to 4294967294"
$bake $good --normal green=left
refused 64 "$p --normal green: \"left\" is not up or down"
$bake $good --normal space=world
refused 64 "$p --normal space: \"world\" is not tangent or object"
$bake $good --normal space=object,green=down
refused 64 "$p an object-space map has no green direction to flip"
$bake $good --scan sampling=cubic
refused 64 "$p --scan sampling: \"cubic\" is not trilinear or nearest"
$bake $good --type 8
refused 64 "$p a_<MAP>.exr: OpenEXR files have no 8-bit samples"
$bake plain.nvdb low.obj -o a.png --type float
refused 64 "$p a.png: PNG files have no float samples"
$bake plain.nvdb low.obj -o a.png --type 12
refused 64 "$p --type: \"12\" is not auto, 8, 16, half, float or 8+16"
$bake colored.nvdb low.obj -o a.exr --maps normal,color
refused 64 "$p a.exr: several maps need \"<MAP>\" in the output's name"
$bake plain.nvdb low.obj -o 'a_<Map>.exr' --maps normal
refused 64 "$p a_<Map>.exr: \"<MAP>\" in the output's name needs capital letters"
$bake plain.nvdb low.obj -o '<object>_<MAP>.exr'
refused 64 "$p <object>_<MAP>.exr: \"<OBJECT>\" in the output's name needs capital letters"
$bake $good --max-missed 100.5
refused 64 "$p --max-missed: 100.5 is above 100"
$bake $good --gpu-memory much
refused 64 "$p --gpu-memory: \"much\" is not a size such as 512MiB or 4G"
# Device names are checked before any file is opened, also for exact bakes, which need no device.
for name in abacus '' cpu:0 cuda: cuda:x opencl:-1 opencl:4000000000; do
    for scan in plain.nvdb plain.tris none.nvdb; do
        $bake $scan low.obj -o a.exr --device "$name"
        refused 64 "$p --device: \"$name\" is not auto, cpu, cuda, cuda:N, opencl or opencl:N"
    done
done
$bake $good --device opencl:999
code 69
files $start

# ---- inputs that cannot be used ----

$bake none.nvdb low.obj -o a.exr
refused 66 "$p none.nvdb: No such file or directory"
$bake plain.nvdb none.obj -o a.exr --maps normal
refused 66 "$p none.obj: No such file or directory"
$bake low.obj low.obj -o a.exr
refused 65 "$p low.obj: neither a chunk file nor a NanoVDB file; bisque-voxelize makes both from a mesh"
$bake plain.nvdb low.obj -o 'a_<MAP>.exr' --maps normal,color
refused_like 65 '^bisque-bake: plain\.nvdb.*colour'
sed 's,/[0-9]*,,g; /^vt/d' low.obj >bare.obj
$bake plain.nvdb bare.obj -o a.exr
refused 65 "$p bare.obj: no texture coordinates: the low-poly mesh has to be unwrapped"
sed '$s,/[0-9]*,,g' low.obj >bare.obj
$bake plain.nvdb bare.obj -o a.exr
refused_like 65 "^bisque-bake: bare\.obj:$(wc -l <bare.obj): face has no texture coordinates"
grep '^v' low.obj >points.obj
$bake plain.nvdb points.obj -o a.exr
refused 65 "$p points.obj: no faces, only points or lines"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt .5 .5\nvt .5001 .5\nvt .5 .5001\nf 1/1 2/2 3/3\n' >bare.obj
for scan in plain.nvdb box.tris; do
    $bake $scan bare.obj -o a.exr --as-is
    refused 65 "$p bare.obj: no texel lies in a triangle: is the mesh unwrapped?"
done
$bake box.tris low.obj -o a.exr --scan sampling=nearest
refused 64 "$p box.tris has triangles: nearest-voxel sampling needs a voxel grid"
head -c 5000 plain.nvdb >short.nvdb
$bake short.nvdb low.obj -o a.exr
refused_like 65 '^bisque-bake: short\.nvdb: truncated'
rm bare.obj points.obj short.nvdb
files $start

# ---- outputs that cannot be written ----

$bake plain.nvdb low.obj -o none/a.exr
refused 73 "$p none/a.exr: cannot be created: there is no folder none"
$bake plain.nvdb low.obj -o a.exr --preview none/p.png
refused 73 "$p none/p.png: cannot be created: there is no folder none"
cp plain.nvdb plain.exr
$bake plain.exr low.obj -o plain.exr
refused 64 "$p plain.exr: this output would overwrite the scan"
rm plain.exr
for name in a.jpg a 'a_<MAP>.tif' exr; do
    $bake plain.nvdb low.obj -o "$name"
    refused 64 "$p $name: maps are OpenEXR or PNG files: the name must end in .exr or .png"
done
$bake plain.nvdb low.obj -o a.exr --preview p.jpg
refused 64 "$p p.jpg: the picture is a PNG file: its name must end in .png"
$bake plain.nvdb low.obj -o a.PNG --type half
refused 64 "$p a.PNG: PNG files have no half-float samples"
$bake plain.nvdb low.obj -o a.png --preview low.obj
refused 64 "$p low.obj: this output would overwrite the low-poly mesh"
$bake plain.nvdb low.obj -o a.png --preview ./a.png
refused 64 "$p a.png: two outputs have this name"
files $start

# ---- grids that do not fit a device ----

if has_opencl; then
    awk '/^v / { print "v", $2 + 9, $3 + 9, $4 + 9; next } { print }' low.obj >moved.obj
    ok run bisque-voxelize moved.obj -o large.nvdb --no-tris --resolution 1300
    tenth=$(($(wc -c <large.nvdb) / 10))
    ok $bake --device cpu --size 160 large.nvdb moved.obj -o one.exr
    device="--device opencl:0 --size 160 --threads 2 large.nvdb moved.obj"
    ok $bake $device -o few.exr --gpu-memory $tenth --json
    json '.device == "cpu, 2 threads"'
    grep -Eq 'warning: the grid needs [0-9.]+ MiB of memory, .* has [0-9.]+ MiB for it: the processor bakes it$' "$err"
    check "a line says that the processor bakes a grid ten times as large as the device's memory" $?
    same few.exr one.exr
    ok $bake $device -o few.exr --json
    json '(.device | startswith("cpu,") | not) and .kernel_calls > 0'
    $bake $device -o few2.exr --gpu-memory 1000
    refused_like 69 '^bisque-bake: .*texels and the low-poly mesh take [0-9]+ bytes'
    rm large.nvdb moved.obj one.exr few.exr
else
    lacks "grids that do not fit a device" "there is no OpenCL device"
fi
files $start

# ---- maps ----

small="--device cpu --size 96 --samples 1"
ok $bake $small colored.nvdb low.obj -o 'c_<MAP>.exr' --json
json '.program == "bisque-bake" and .maps == {"normal": "c_normal.exr", "color": "c_color.exr"}'
json '.width == 96 and .height == 96 and .samples_per_axis == 1 and .low_triangles == 12 and .low_polygons == 6'
json '.hits + .misses == .samples and .misses * 100 < .samples and .overlapping_samples == 0'
# Six squares of 0.23 of the map's width: (0.23 * 96)^2 * 6 = 2925 texels.
json '.covered_texels > 2800 and .covered_texels < 3050 and .samples == .covered_texels'
json '.degenerate_uv_triangles == 0 and .outside_uv_triangles == 0'
json '.front > 0 and .back > 0'
json '.cost.memory_high_bytes <= .cost.memory_budget_bytes and .cost.memory_high_bytes > 0'
files c_color.exr c_normal.exr $start
is_exr c_color.exr
is_exr c_normal.exr

# The same maps for any number of threads.
for threads in 1 5; do
    ok $bake $small --threads $threads colored.nvdb low.obj -o "t${threads}_<MAP>.exr"
    out_like '^low\.obj: 12 triangles, [0-9,]+ of 96x96 texels covered$'
    same t${threads}_normal.exr c_normal.exr
    same t${threads}_color.exr c_color.exr
done
rm t?_*.exr c_*.exr

# Of a grid without colours only normals are baked by default.
ok $bake $small plain.nvdb low.obj -o 'p_<MAP>.exr'
files p_normal.exr $start
cp p_normal.exr half.exr
ok $bake $small plain.nvdb low.obj -o float.exr --type float
holds "float samples take more bytes than half" [ "$(wc -c <float.exr)" -gt "$(wc -c <half.exr)" ]
rm p_normal.exr half.exr float.exr

ok $bake --device cpu --size 96x48 plain.nvdb low.obj -o n.png --preview look.png --maps normal
out_like '^look\.png: preview$'
is_png n.png 96 48 16
is_png look.png 1160 1644 8
ok $bake --device cpu --size 96x48 colored.nvdb low.obj -o n.png --preview grey.png --maps normal
holds "without a colour map the preview shows the scan without colours" cmp -s look.png grey.png
ok $bake --device cpu --size 96x48 plain.nvdb low.obj -o n.png --preview grey.png --maps normal \
    --view count=1,up=z
is_png grey.png 2312 792 8
for value in 0 361 -1 many; do
    $bake $small plain.nvdb low.obj -o n.png --preview grey.png --view count=$value
    code 64
done
$bake $small plain.nvdb low.obj -o n.png --preview grey.png --view up=x
code 64
ok $bake --device cpu $small plain.nvdb low.obj -o n.png --preview look.png --maps normal --view count=1
ok $bake --device cpu $small plain.nvdb low.obj -o n.png --preview grey.png --maps normal \
    --view from=30,count=1
holds "the first view is from 30 degrees" cmp -s look.png grey.png
rm grey.png
ok $bake $small plain.nvdb low.obj -o lines.exr --maps normal
ok $bake $small plain.nvdb low.obj -o tiles.exr --maps normal --exr-tiles 40
ok run bisque-compare lines.exr tiles.exr --max-error 0
cmp -s lines.exr tiles.exr
check "tiles make another file" $((! $?))
rm lines.exr tiles.exr
$bake $small plain.nvdb low.obj -o n.png --maps normal --exr-tiles 40
refused_like 64 'PNG files have no tiles'
for value in 7 8193 0; do
    $bake $small plain.nvdb low.obj -o n.exr --maps normal --exr-tiles $value
    code 64
done
ok $bake $small plain.nvdb low.obj -o n8.png --type 8 --maps normal
is_png n8.png 96 96 8
ok $bake $small plain.nvdb low.obj -o m.png --maps mask
files look.png m.png n.png n8.png $start
rm look.png m.png n.png

# "all" is every map that the scan gives; "opacity" is the mask.
ok $bake $small plain.nvdb low.obj -o 'all_<MAP>.exr' --maps all --json
files all_ao.exr all_bent.exr all_confidence.exr all_curvature.exr all_height.exr all_mask.exr all_normal.exr all_position.exr \
    all_thickness.exr n8.png $start
json '.encodings | keys == ["curvature", "height", "position", "thickness"]'
json '.encodings.curvature | .unit == "1 / mesh unit" and .radius > 0 and .range > 0'
json '.encodings.position | .unit == "mesh unit" and .scale == [1, 1, 1] and .offset == [0, 0, 0] and .origin == [0, 0, 0]'
ok $bake $small colored.nvdb low.obj -o 'all_<MAP>.png' --maps all,color --range position=box --range height=2 --json
json '.maps | keys == ["ao", "bent", "color", "confidence", "curvature", "height", "mask", "normal", "position", "thickness"]'
json '.encodings.height == {"unit": "mesh unit", "radius": 0, "range": 2, "scale": [4], "offset": [-2], "origin": [0]}'
json '.encodings.position | .scale == [1, 2, 3] and .offset == [0, 0, 0] and .range == 1.5'
# Curvature of a radius that is given, with a range that is given.
ok $bake $small plain.nvdb low.obj -o 'curved.png' --maps curvature --distance curvature=0.25 --range curvature=8 --json
json '.encodings.curvature == {"unit": "1 / mesh unit", "radius": 0.25, "range": 8, "scale": [16], "offset": [-8],
    "origin": [0]}'
is_png curved.png 96 96 16
# A radius larger than the scan finds nothing around the hits.
ok $bake $small plain.nvdb low.obj -o curved.png --maps curvature --distance curvature=100
grep -Eq 'warning: map curvature: no surface around the hits of ([0-9]+) of \1 texels, at a radius of 100; they became 0' "$err"
check "all texels of unknown curvature are counted" $?
rm curved.png
$bake $small plain.nvdb low.obj -o curved.png --maps curvature --distance curvature=100 --strict
code 65
holds "no map of unknown curvature in a strict bake" [ ! -e curved.png ]
is_png all_height.png 96 96 16
is_png all_position.png 96 96 16
rm all_*
ok $bake $small plain.nvdb low.obj -o '<MAP>.exr' --maps opacity,mask
files mask.exr n8.png $start
ok $bake $small plain.nvdb low.obj -o h.exr --maps height
out_like '^h\.exr: height map, range [0-9.e-]+ \(mesh unit\)$'
rm mask.exr h.exr

# A box is convex: all of it is open, and bent normals are its normals. From triangles too, in groups of chunks.
ok $bake $small box.tris low.obj -o 'exact_<MAP>.exr' --maps all --json
json '(.maps | keys == ["ao", "bent", "confidence", "curvature", "height", "mask", "normal", "position", "thickness"]) and .chunk_loads > 0'
ok run bisque-compare exact_bent.exr exact_normal.exr --mask exact_mask.exr --force --type normal --max-mean 3
rm exact_*
hits="$small plain.nvdb low.obj --maps ao,bent,thickness,normal,mask"
ok $bake $hits -o '1_<MAP>.exr' --threads 1
ok $bake $hits -o '2_<MAP>.exr' --threads 3 --memory 64M
for map in ao bent thickness; do
    same 1_$map.exr 2_$map.exr
done
ok run bisque-compare 1_bent.exr 1_normal.exr --mask 1_mask.exr --force --type normal --max-mean 3
ok $bake $hits -o '3_<MAP>.png' --rays ao=16 --distance thickness=2 --json
json '.encodings.thickness | .unit == "mesh unit" and .scale == [2] and .offset == [0] and .range == 1'
# Without a length, white is what the box is thick, not its diagonal of 3.74.
ok $bake $hits -o '3_<MAP>.png' --rays ao=16 --json
json '.encodings.thickness | .scale[0] > 0.5 and .scale[0] < 3 and (.range * 2 - .scale[0] | fabs) < 1e-12'
is_png 3_ao.png 96 96 16
for bad in '--rays ao=0' '--rays ao=4097' '--ao spread=181' '--ao spread=0' '--ao falloff=square' '--distance ao=0' \
    '--ao falloff=linear' '--ao coarse=0' '--ao coarse=far' '--rays thickness=0' '--distance thickness=-1'; do
    $bake $hits -o 'x_<MAP>.exr' $bad
    code 64
done
rm [123]_*

# UDIM tiles share a range: that of the side which is farther from the scan. A tile alone has its own.
awk '/^v / && $2 == 1 { $2 = 0.9 } /^vt / && ++corner > 20 { $2 += 1 } { print }' low.obj >tiles.obj
heights="--maps height --front 0.3 --back 0.3"
ok $bake $small $heights plain.nvdb tiles.obj -o 'both_<UDIM>.png' --json
range=$(jq .encodings.height.range "$out")
$bake $small $heights plain.nvdb tiles.obj -o 'alone_<UDIM>.png' --tiles 1001 --json
first=$(jq .encodings.height.range "$out")
$bake $small $heights plain.nvdb tiles.obj -o 'alone_<UDIM>.png' --tiles 1002 --json
json ".encodings.height.range as \$second | $range == ([$first, \$second] | max) and $first != \$second"
for tile in 1001 1002; do
    ok $bake $small $heights plain.nvdb tiles.obj -o 'given_<UDIM>.png' --tiles $tile --range height="$range"
    same given_$tile.png both_$tile.png
done
# White of thickness is twice the range that the report has.
thick="--maps thickness --front 0.3 --back 0.3 --rays thickness=8"
ok $bake $small $thick plain.nvdb tiles.obj -o 'both_<UDIM>.png' --json
white=$(jq '2 * .encodings.thickness.range' "$out")
for tile in 1001 1002; do
    ok $bake $small $thick plain.nvdb tiles.obj -o 'given_<UDIM>.png' --tiles $tile --range thickness="$white"
    same given_$tile.png both_$tile.png
done
rm both_* alone_* given_* tiles.obj

# The scan of a flat square is the same square: what heights and curvature it has are rounding errors, which are grey.
printf 'v 0 0 0\nv 1 0 0.1\nv 1 1 0.3\nv 0 1 0.2\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n' >flat.obj
ok run bisque-voxelize flat.obj -o flat.nvdb --resolution 64
for scan in flat.nvdb flat.tris; do
    ok $bake $small $scan flat.obj -o 'flat_<MAP>.png' --maps height,curvature --json
    json '.encodings | (.height.range * 65536 / (2.09 | sqrt) - 1 | fabs) < 1e-6
        and (.curvature.range * 100 * (2.09 | sqrt) - 1 | fabs) < 1e-6'
done
rm flat*

# Far from 0, positions have an origin, the same from a grid and from triangles.
awk '/^v / { printf "v %.4f %.4f %.4f\n", $2 + 500000.25, $3 + 4400000.5, $4; next } { print }' low.obj >far.obj
ok run bisque-voxelize far.obj -o far.nvdb --resolution 96
for surface in nvdb tris; do
    ok $bake --device cpu --size 96 far.$surface far.obj -o "${surface}_<MAP>.exr" --maps height,position --json
    json '.encodings.position.origin == [500000.75, 4400001.5, 1.5]'
done
# Voxels are 0.031 wide, and the maps differ by less than half of that at edges. Without an origin, steps of float32 would be 0.5.
run bisque-compare nvdb_height.exr tris_height.exr --max-median 1e-5 --max-error 0.0155
check "heights from a grid and from triangles agree" "$code"
run bisque-compare nvdb_position.exr tris_position.exr --max-median 1e-5 --max-error 0.0155
check "positions from a grid and from triangles agree" "$code"
$bake $small plain.nvdb low.obj -o near.exr --maps position
run bisque-compare near.exr nvdb_position.exr
refused_like 65 '^bisque-compare: near\.exr has bisque:origin "0 0 0", nvdb_position\.exr has "500000\.75 4400001\.5 1\.5"'
rm far.* nvdb_* tris_* near.exr

# Options change the map.
for option in "--normal green=up" "--normal green=down" "--normal space=object" "--padding 0" "--padding all" \
    "--scan sampling=nearest" "--samples 3"; do
    ok $bake $small $option plain.nvdb low.obj -o b.png --type 8 --maps normal
    case $option in
    "--normal green=up")
        same b.png n8.png
        ;;
    *) # only these change a box: its green is 0.5 everywhere, and its nearest normals are exact
        case $option in *object | *padding*) ! cmp -s b.png n8.png
            check "$option changes the map" $? ;;
        esac
        ;;
    esac
done
rm b.png n8.png

# ---- misses ----

# After a move along x, short rays do not reach the two sides across x.
awk '/^v / { $2 += 0.0625 } { print }' low.obj >moved.obj
ok $bake $small plain.nvdb moved.obj -o moved.exr --front 0.03125 --back 0.03125 --json
json '.misses * 4 > .samples and .misses * 2 < .samples'
json '.front == 0.03125 and .back == 0.03125'
grep -q '^bisque-bake: warning: .* % of the samples found no surface within 0.03125 in front and 0.03125 behind: ' "$err"
check "a hint at misses" $?
rm moved.*

# A box within the box, one farther away, and one in other units: no ray hits.
spans='no ray hit within 0\.0625 in front and 0\.0625 behind: the scan spans \(0 0 0\) to \(1 2 3\), the low-poly mesh '
# without_hit SCALE MOVE TEXT OPTION...: moves the vertices along x and scales them from the scan's centre.
without_hit()
{
    awk -v s="$1" -v m="$2" '/^v / { $2 = .5 + ($2 - .5) * s + m; $3 = 1 + ($3 - 1) * s; $4 = 1.5 + ($4 - 1.5) * s }
        { print }' low.obj >away.obj
    text=$3
    shift 3
    $bake $small plain.nvdb away.obj -o a.exr --front 0.0625 --back 0.0625 "$@"
    refused_like 65 "^$p $spans.*$text\$"
}
without_hit 0.75 0 ': try a larger --front and --back, or --two-sided if the scan.s faces are wound inwards'
without_hit 0.75 0 ': try a larger --front and --back' --two-sided
without_hit 1 5000000 '\(5000000 0 0\) to \(5000001 2 3\): are they in the same place and units\?'
without_hit 1000 0 ': are they in the same place and units\?' --as-is
without_hit 1000 0 ': are they in the same place and units\?' --max-missed 100 --as-is
rm away.obj
files $start

# ---- charts that overlap ----

# All six sides in one place.
awk '/^vt / { $2 = NR % 4 < 2 ? .25 : .75; $3 = NR % 4 == 1 || NR % 4 == 2 ? .25 : .75 } { print }' low.obj >stacked.obj
ok $bake $small plain.nvdb stacked.obj -o charts.exr --json
json '.overlapping_samples == .samples'
grep -q "^$p warning: 100\.0 % of the samples lie in several triangles, because charts overlap: " "$err"
check "a hint at charts that overlap" $?
# Layouts with mirrored charts are intended.
ok $bake $small plain.nvdb stacked.obj -o charts.exr --strict
rm charts.exr stacked.obj

# ---- UDIM tiles ----

# The charts in two tiles: 1002, and 1011 from half the height of the map on.
awk '/^vt / { $2 += 1; $3 *= 2 } { print }' low.obj >two.obj
for words in two.obj "$small plain.nvdb two.obj -o m_<MAP>.<UDIM>.exr"; do
    ok $bake --list tiles $words
    [ "$(cat "$out")" = "1002
1012" ]
    check "tiles are listed" $?
done
ok $bake --list tiles two.obj --json --size '1012=64x32,*=16'
json '[.tiles[] | [.tile, .width, .height]] == [[1002, 16, 16], [1012, 64, 32]]'
$bake --list tiles two.obj --size '5=64'
refused_like 64 "^$p a size for tile 5: UDIM tiles are 1001 to "
for words in "" plain.nvdb; do
    $bake --list tiles $words
    refused 64 "$p --list tiles takes files: LOW.obj..."
done
$bake $small plain.nvdb two.obj -o 'one_<MAP>.exr'
refused_like 64 "^$p two\.obj is in several UDIM tiles: 1002, 1012; to bake all, put \"<UDIM>\" into the output's name; "
files two.obj $start
ok $bake $small --padding 0 plain.nvdb two.obj -o 'm_<MAP>.<UDIM>.exr' --preview look.png --json
json '.maps == {"normal": "m_normal.<UDIM>.exr"} and [.tiles[].maps.normal] == ["m_normal.1002.exr", "m_normal.1012.exr"]'
json '[.tiles[].tile] == [1002, 1012] and .outside_uv_triangles == 0 and .misses * 100 < .samples'
files look.png m_normal.1002.exr m_normal.1012.exr two.obj $start
# Each tile alone is the same, also under another name.
ok $bake $small --padding 0 plain.nvdb two.obj -o n.exr --tiles 1012 --json
json '.outside_uv_triangles > 0 and (.tiles | length) == 1'
same n.exr m_normal.1012.exr
ok $bake $small --padding 0 --threads 1 --memory 16M plain.nvdb two.obj -o 'b_<UVTILE>.exr' --tiles 1001-1009
out_like '^b_u2_v1\.exr: normal map$'
same b_u2_v1.exr m_normal.1002.exr
# Tiles of two sizes, from triangles.
ok $bake $small box.tris two.obj -o '<UDIM>.png' --size '1002=32x48,*=64'
out_like '^two\.obj: 12 triangles, [0-9,]+ texels covered in 2 tiles$'
is_png 1002.png 32 48 16
is_png 1012.png 64 64 16
# Memory does not grow with finished tiles, and the textures of a preview shrink.
awk 'BEGIN {
    for (t = 0; t < 150; t++) {
        for (i = 0; i < 4; i++) {
            a = i == 1 || i == 2; b = i > 1
            printf "v %g %g 3\nvt %g %g\n", (t + a) / 150, b, t % 10 + a, int(t / 10) + b
        }
        n = 4 * t
        printf "f %d/%d %d/%d %d/%d %d/%d\n", n + 1, n + 1, n + 2, n + 2, n + 3, n + 3, n + 4, n + 4
    }
}' >many.obj
mkdir many
ok $bake --device cpu --threads 1 --size 64 --samples 1 --maps normal plain.nvdb many.obj -o 'many/<UDIM>.exr' --memory 3M
ok $bake --device cpu --threads 1 --size 64 --samples 1 --maps normal plain.nvdb many.obj -o 'many/<UDIM>.exr' \
    --preview many/look.png --memory 16M
rm -r many many.obj
# A picture that is also a map of a tile, and directories of tiles that do not exist, are found
# before the work.
$bake $small plain.nvdb two.obj -o 'm_<UDIM>.png' --maps normal --preview m_1012.png
refused 64 "$p m_1012.png: two outputs have this name"
mkdir -p d/1002
$bake $small plain.nvdb two.obj -o 'd/<UDIM>/n.exr' --maps normal --progress json
code 73
! grep -q tracing "$err"
check "nothing was traced" $?
ok $bake $small plain.nvdb two.obj -o 'd/<UDIM>/n.exr' --maps normal --tiles 1002
# Images that do not fit in memory go to a directory of maps.
mkdir d/normal d/mask
ok $bake --device cpu --samples 1 --memory 20M --size 2048 plain.nvdb low.obj -o 'd/<MAP>/n.exr' --maps normal,mask
holds "maps are in their directories" [ -s d/mask/n.exr ]
rm -r d
# Half-float samples stay finite. One warning holds for both tiles. The box is 300000 units high.
for mesh in low two; do
    awk '/^v / { for (i = 2; i < 5; i++) $i *= 100000 } { print }' $mesh.obj >huge_$mesh.obj
done
ok run bisque-voxelize huge_low.obj -o huge.tris
huge="$small huge.tris huge_two.obj --maps position,mask"
ok $bake $huge --type half -o 'huge_<MAP>.<UDIM>.exr'
[ "$(sed 's/bits: [1-9][0-9]*;/bits: N;/' "$err")" = "$p warning: map position: samples too large for 16 bits: N; \
they became 65504 or -65504: --type float holds them" ]
check "one warning of large samples" $?
ok $bake $huge --type float -o 'float_<MAP>.<UDIM>.exr'
holds "no warning of 32-bit samples" [ ! -s "$err" ]
ok run bisque-compare --type data --max-error 234500 huge_position.1002.exr float_position.1002.exr
$bake $huge --type half -o 'strict_<MAP>.<UDIM>.exr' --strict
refused_like 65 "^$p map position: samples too large for 16 bits: "
holds "no map of a strict job" [ ! -e strict_mask.1002.exr ]
rm huge* float_*
# The size of other tiles may be given before.
ok $bake --list tiles two.obj --json --size 16 --size 1012=64x32
json '[.tiles[] | [.tile, .width, .height]] == [[1002, 16, 16], [1012, 64, 32]]'
# What lies in no tile is an error, unless it is left out on purpose.
awk '/^vt / { $2 -= 0.5 } { print }' low.obj >outside.obj
$bake $small plain.nvdb outside.obj -o n.exr
refused_like 64 "^$p outside\.obj: [0-9]+ triangles have texture coordinates outside of all UDIM tiles, the first at \(-"
ok $bake $small plain.nvdb outside.obj -o n.exr --tiles 1001
out_like '^left out: [0-9]+ triangles reaching out of the baked tiles$'
for list in 1000 1001-1000 10001 x 1001, 1001- 1001x; do
    $bake $small plain.nvdb two.obj -o n.exr --tiles $list
    code 64
done
for list in '1001=' '=5' '*=0' '1001=4x' '1001=4,' '1000=4' '4,5'; do
    $bake plain.nvdb two.obj -o n.exr --size "$list"
    code 64
done
rm look.png *_normal.10??.exr n.exr b_u2_v1.exr 10?2.png outside.obj two.obj

# Inputs are files.
for inputs in 'plain.nvdb -' '- low.obj' '- plain.nvdb low.obj'; do
    $bake $inputs -o n.exr </dev/null
    refused 64 'bisque-bake: -: standard input is not read: scans and low-poly meshes must be files'
done

# ---- failures on the way ----

command="bisque-bake with a file size limit" code=0
(ulimit -f 8 && exec "$BIN/bisque-bake" --device cpu --low normals=angle --size 1024 --type float plain.nvdb low.obj \
    --padding all -o a.exr) >"$out" 2>"$err" || code=$?
refused_like 74 '^bisque-bake: a\.exr: '
files $start

interrupted TERM tracing bisque-bake --device cpu --size 512 plain.nvdb low.obj -o a.exr
files $start

finish

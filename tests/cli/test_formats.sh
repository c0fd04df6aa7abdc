#!/bin/sh
# test_formats.sh - files are as formats/FORMATS.md says. Readers in Python, written from that page
# alone, find in them what the programs report, what the OBJ file has, and what is known of a box.
. "$(dirname "$0")/lib.sh"

need_oracle

# value NAME: prints the numbers that measure.py printed for NAME.
value()
{
    sed -n "s/^$1 //p" "$out"
}

# is NAME "NUMBER..." TOLERANCE: the values are these, within a tolerance relative to them or to 1.
is()
{
    echo "$(value "$1") | $2" | awk -v tolerance="$3" '
        { for (half = 1; half <= NF && $half != "|"; half++) ; bad = half < 2 || NF != 2 * half - 1
          for (i = 1; i < half && !bad; i++) {
              d = $i - $(half + i); d = d < 0 ? -d : d
              size = $(half + i); size = size < 0 ? -size : size
              bad = d > tolerance * (size > 1 ? size : 1) } }
        END { exit bad }'
    check "$1 is $2, found $(value "$1")" $?
}

# reports NAME EXPRESSION: the value is what bisque-voxelize reported.
reports()
{
    is "$1" "$(jq -r "[$2] | flatten | map(tostring) | join(\" \")" "$work/report.json")" 1e-12
}

voxelize()
{
    ok run bisque-voxelize "$@" --json
    cp "$out" "$work/report.json"
}

# Prints the triangles of an OBJ file as measure.py does: the least corner first, normals last.
# Variables: uv, rgb, n are 1 to print these attributes; m is the material.
cat >"$work/triangles.awk" <<'AWK'
{ gsub(/-0[.]000000/, "0.000000") }
$1 == "v" {
    v++; x[v] = $2 + 0; y[v] = $3 + 0; z[v] = $4 + 0; p[v] = $2 " " $3 " " $4
    c[v] = int($5 * 255 + 0.5) " " int($6 * 255 + 0.5) " " int($7 * 255 + 0.5)
}
$1 == "vt" { t[++ts] = $2 " " $3 }
$1 == "vn" { normal[++ns] = $2 " " $3 " " $4 }
function before(a, b) { return x[a] != x[b] ? x[a] < x[b] : y[a] != y[b] ? y[a] < y[b] : z[a] < z[b] }
$1 == "f" {
    least = 1
    for (i = 1; i <= 3; i++) {
        split($(i + 1), k, "/"); a[i] = k[1]; b[i] = k[2]; d[i] = k[3]
        if (before(a[i], a[least])) least = i
    }
    line = ""
    for (i = 0; i < 3; i++) line = line p[a[(least + i - 1) % 3 + 1]] " "
    for (i = 0; uv && i < 3; i++) line = line t[b[(least + i - 1) % 3 + 1]] " "
    for (i = 0; rgb && i < 3; i++) line = line c[a[(least + i - 1) % 3 + 1]] " "
    line = line (m != "" ? m " " : "") "|"
    for (i = 0; n && i < 3; i++) line = line " " normal[d[(least + i - 1) % 3 + 1]]
    print line
}
AWK

# same_triangles OBJ TRIS [VARIABLE...]: both have the same triangles and attributes. Normals may
# differ by the error of 16 bits and of six digits in the OBJ file.
same_triangles()
{
    obj=$1 tris=$2
    shift 2
    awk "$@" -f "$work/triangles.awk" "$obj" | sort >"$work/a"
    oracle measure --triangles "$tris"
    sort "$out" >"$work/b"
    cut -d'|' -f1 "$work/a" >"$work/a.1"
    cut -d'|' -f1 "$work/b" >"$work/b.1"
    [ "$code" -eq 0 ] && [ -s "$work/a" ] && cmp "$work/a.1" "$work/b.1" >"$out" 2>&1
    check "$tris has the triangles of $obj, $(wc -l <"$work/b") of them" $?
    paste -d'|' "$work/a" "$work/b" | awk -F'|' '
        { fields = split($2, a, " "); if (split($4, b, " ") != fields) exit bad = 1
          for (i = 1; i <= fields; i++) if ((a[i] - b[i])^2 > 1e-8) exit bad = 1 }
        END { exit bad }'
    check "$tris has the normals of $obj" $?
}

# Prints the triangle count, bounds, area and volume of an OBJ file of triangles.
measure()
{
    awk '
        $1 == "v" { v++; for (k = 1; k <= 3; k++) { p[v, k] = $(k + 1)
                        if (v == 1 || $(k + 1) < lo[k]) lo[k] = $(k + 1)
                        if (v == 1 || $(k + 1) > hi[k]) hi[k] = $(k + 1) } }
        $1 == "f" {
            for (i = 1; i <= 3; i++) { split($(i + 1), s, "/"); c[i] = s[1] }
            for (k = 1; k <= 3; k++) { a[k] = p[c[2], k] - p[c[1], k]; b[k] = p[c[3], k] - p[c[1], k] }
            n[1] = a[2] * b[3] - a[3] * b[2]; n[2] = a[3] * b[1] - a[1] * b[3]; n[3] = a[1] * b[2] - a[2] * b[1]
            area += sqrt(n[1]^2 + n[2]^2 + n[3]^2) / 2; faces++
            for (k = 1; k <= 3; k++) volume += p[c[1], k] * n[k] / 6 }
        END { printf "faces=%d area=%.9g volume=%.9g low=\"%.9g %.9g %.9g\" high=\"%.9g %.9g %.9g\"\n",
              faces, area, volume, lo[1], lo[2], lo[3], hi[1], hi[2], hi[3] }' "$1"
}

# ---- a box of 1 x 2 x 3, whose values are all known ----

write_box >box.obj
voxelize box.obj -o box.nvdb --resolution 24 --scan-normals flat
ok oracle measure box.tris
is triangles 12 0
is source_faces 6 0
is vertices 8 0
is skipped 0 0
is origin "0 0 0" 0
is min "0 0 0" 0
is max "1 2 3" 0
is area 22 1e-12
is volume 6 1e-12
# 8 x 16 x 24 voxels. 1048 have one face of the box, half a voxel from the centre, coverage 1. 168
# have an edge: the mean of two faces is (1, 1) / sqrt 2 at a distance of sqrt 2 / 4. 8 have a
# corner of three faces.
ok oracle measure box.nvdb
is voxels 1224 0
is second_records 0 0
is shaded 0 0
is triangles 12 0
is scan_min "0 0 0" 0
is scan_max "1 2 3" 0
is index_min "0 0 0" 0
is index_max "7 15 23" 0
is voxel_size 0.125 0
is translation "0.0625 0.0625 0.0625" 1e-15
is sum_offset "$(awk 'BEGIN { print 1048 / 2 + 168 * sqrt(2) / 4 + 8 * sqrt(3) / 6 }')" 1e-4
is sum_coverage "$(awk 'BEGIN { print 1048 + 168 / sqrt(2) + 8 / sqrt(3) }')" 1e-3
is sum_normal "0 0 0" 1e-2 # rounding, 1224 times

# ---- a sheet thinner than a voxel has two records ----

{
    printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 .02\nv 1 0 .02\nv 1 1 .02\nv 0 1 .02\n'
    printf 'f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 3 4 8 7\nf 1 5 8 4\nf 2 3 7 6\n'
} >sheet.obj
voxelize sheet.obj -o sheet.nvdb --resolution 16 --scan-normals flat
printf '.5 .5 0\n.5 .5 .02\n.53125 .71875 0\n.3 .3 .5\n2 0 0\n-.1 -.1 0\n' >points
ok oracle measure sheet.nvdb points
is voxels 256 0
is second_records 256 0
reports second_records .grid.second_records
is points 6 0
is points_found 3 0
is points_from_plane 0 1e-4

# ---- a square on the lower faces of its voxels, with vertex normals that lean by 45 degrees ----

printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 1 0 1\nf 1//1 2//1 3//1 4//1\n' >lean.obj
voxelize lean.obj -o lean.nvdb --resolution 8
ok oracle measure lean.nvdb
is voxels 64 0
# Normals of the scan's own on triangles of eight voxels: all are inconsistent with their planes.
is shaded 64 0
lean=$(awk 'BEGIN { print 64 * sqrt(2) / 2 }')
is sum_normal "$lean 0 $lean" 1e-4
is sum_offset "$(awk "BEGIN { print -$lean / 2 }")" 1e-4
is sum_coverage "$lean" 2e-3

# ---- a vase with colours and normals, in several chunks ----

"$TESTS/generate-scan" --triangles 150000 --colors --normals vase -o vase.obj
eval "$(measure vase.obj)"
voxelize vase.obj -o vase.nvdb --resolution 300
same_triangles vase.obj vase.tris -v rgb=1 -v n=1
ok oracle measure vase.tris
is attributes 5 0
is triangles "$faces" 0
is area "$area" 1e-6
is volume "$volume" 1e-6
is min "$low" 1e-6
is max "$high" 1e-6
reports triangles .scan.triangles
reports chunks .scan.chunks
reports source_faces .scan.faces
reports skipped .scan.degenerate_triangles
holds "several chunks" [ "$(value chunks)" -gt 2 ]
hash=$(value hash)

# Each vertex of the scan is in a voxel, near its plane, and has its colour. Triangles are about two
# voxels wide.
sed -n 's/^v //p' vase.obj >points
ok oracle measure vase.nvdb points
is color 1 0
is scan_min "$low" 1e-6
is scan_max "$high" 1e-6
is points_found "$(wc -l <points)" 0
awk "BEGIN { exit !($(value points_from_plane) < 0.05 && $(value points_from_color) < 2) }"
check "vertices are $(value points_from_plane) voxels and $(value points_from_color) / 255 off" $?
for name in voxels second_records leaves lowers uppers triangles voxel_size index_min index_max; do
    reports $name .grid.$name
done

"$TESTS/generate-scan" --triangles 150000 --colors --normals --shuffle 7 vase -o shuffled.obj
run bisque-voxelize shuffled.obj -o shuffled.nvdb --resolution 300
oracle measure shuffled.tris
holds "shuffled faces are the same triangles" [ "$(value hash)" = "$hash" ]

# ---- a textured vase: red grows with u, green with v (0 at the lower edge of the image) ----

awk 'BEGIN { print "P3 256 256 255"
     for (y = 0; y < 256; y++) for (x = 0; x < 256; x++) print x, 255 - y, 128 }' >ramp.ppm
printf 'newmtl glaze\nKd 0.2 0.4 0.6\nmap_Kd ramp.ppm\n' >vase.mtl
"$TESTS/generate-scan" --triangles 20000 --uvs vase -o plain.obj
{
    printf 'mtllib vase.mtl\nusemtl glaze\n'
    cat plain.obj
} >textured.obj
voxelize textured.obj -o textured.nvdb --resolution 300
same_triangles textured.obj textured.tris -v uv=1 -v m=m0
ok oracle measure textured.tris
is attributes 10 0
[ "$(sed -n 's/^material //p' "$out")" = "0.2 0.4 0.6 $PWD/ramp.ppm" ]
check "the material is that of the MTL file: $(value material)" $?
# Without the image's borders, where filtering mixes in colours of the opposite side.
awk '$1 == "v" { p[++v] = $2 " " $3 " " $4 }
     $1 == "vt" { u[++t] = $2; w[t] = $3 }
     $1 == "f" { split($2, k, "/"); i = k[2]
         if (u[i] > 0.05 && u[i] < 0.95 && w[i] > 0.05 && w[i] < 0.95) print p[k[1]], u[i], w[i], 128 / 255 }
    ' textured.obj >points
ok oracle measure textured.nvdb points
is points_found "$(wc -l <points)" 0
holds "vertices are $(value points_from_color) / 255 off the texture" awk "BEGIN { exit !($(value points_from_color) < 2) }"

# ---- separate triangles far from zero: more vertices than 16 bits count, and an origin ----

awk 'BEGIN { for (i = 0; i < 40000; i++) { x = 500000 + i % 200 / 4; y = 5000000 + int(i / 200) / 4
         printf "v %.6f %.6f 100.000000\nv %.6f %.6f 100.125000\nv %.6f %.6f 100.000000\n",
                x, y, x + 0.125, y, x, y + 0.125 }
     for (i = 0; i < 40000; i++) print "f", 3 * i + 1, 3 * i + 2, 3 * i + 3 }' >far.obj
voxelize far.obj -o far.nvdb --voxel-size 0.25
same_triangles far.obj far.tris
oracle measure far.tris
is vertices 120000 0
is chunks 1 0
reports origin .scan.origin
is min "500000 5000000 100" 0
is max "500049.875 5000049.875 100.125" 0
sed -n 's/^v //p' far.obj >points
oracle measure far.nvdb points
is points_found 120000 0
is index_min "2000000 20000000 400" 0
reports index_min .grid.index_min

# ---- damage: each changed byte is found ----

# put FILE OFFSET BYTE: writes a byte.
put()
{
    printf "\\$(printf %o "$3")" | dd of="$1" bs=1 seek="$2" conv=notrunc status=none
}

for file in box.tris:1 box.nvdb:3001; do
    ok oracle measure --damage "${file%:*}" "${file#*:}"
done

# An unknown version is refused by name, also by Bisque.
cp box.tris new.tris
put new.tris 8 9
oracle measure new.tris
err "new.tris: version 9"
run bisque-voxelize new.tris -o new.nvdb
err_like '^bisque-voxelize: new\.tris: chunk file of version 9, '
"$TESTS/generate-scan" vase-low -o low.obj
cp box.nvdb new.nvdb
put new.nvdb 8 3
oracle measure new.nvdb
err "new.nvdb: version 32.4.3"
run bisque-bake new.nvdb low.obj -o new.exr
err_like '^bisque-bake: new\.nvdb: NanoVDB file of version 32\.4\.3: '
for version in 1 5; do
    cp box.nvdb new.nvdb
    put new.nvdb $(($(wc -c <box.nvdb) - 184)) $version
    oracle measure new.nvdb
    err "new.nvdb: bisque trailer of version $version"
    run bisque-bake new.nvdb low.obj -o new.exr
    err_like "^bisque-bake: new\\.nvdb: surface grid of version $version: "
done

# ---- headers of maps ----

# header FILE "ATTRIBUTE=VALUE"...: the EXR file has these string attributes, in this order.
header()
{
    file=$1 command="header of $1" code=0
    shift
    head -c 1500 "$file" | tr -d '\000-\037' >"$out"
    for attribute; do
        holds "$file: $attribute" grep -aqF "${attribute%%=*}string${attribute#*=}" "$out"
    done
}

ok run bisque-bake vase.nvdb low.obj --maps normal,color,mask --size 32x16 --front 0.05 --back 0.025 --normal green=down \
    -o 'map_<MAP>.exr'
header map_normal.exr colorInteropID=data oiio:ColorSpace=Raw bisque:map=normal bisque:normalSpace=tangent \
    bisque:tangents=MikkTSpace bisque:green=down "bisque:encoding=n / 2 + 1/2" "bisque:samples=2 x 2" \
    bisque:sampling=trilinear bisque:rays=smooth bisque:front=0.05 bisque:back=0.025
header map_color.exr colorInteropID=lin_rec709_scene oiio:ColorSpace=Linear bisque:map=color
header map_mask.exr colorInteropID=data oiio:ColorSpace=Raw bisque:map=mask
ok run bisque-bake vase.tris low.obj --maps normal --size 32x16 --normal space=object -o exact.exr
header exact.exr bisque:normalSpace=object bisque:tangents=none bisque:green=up bisque:sampling=exact
ok run bisque-bake vase.nvdb low.obj --maps normal,color,mask --size 32x16 -o 'map_<MAP>.png'
# IHDR: width, height, 16 bits, colour type 2 (RGB) or 0 (grey), no interlacing.
for map in normal:02 color:02 mask:00; do
    [ "$(od -An -tx1 -j 16 -N 13 "map_${map%:*}.png")" = " 00 00 00 20 00 00 00 10 10 ${map#*:} 00 00 00" ]
    check "map_${map%:*}.png: IHDR" $?
done
grep -aq sRGB map_color.png && ! grep -aq sRGB map_normal.png && ! grep -aq sRGB map_mask.png
check "only the colour map is tagged sRGB" $?

finish

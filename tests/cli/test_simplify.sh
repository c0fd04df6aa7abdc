#!/bin/sh
# test_simplify.sh - bisque-simplify, and bisque-compare of a mesh with its scan: results and their
# measured distances, the same bytes on any machine, messages, and signals.
. "$(dirname "$0")/lib.sh"

p=bisque-simplify:
help_and_man_page bisque-simplify

# ---- results ----

triangles=120000
sanitized && triangles=40000
"$TESTS/generate-scan" --triangles $triangles vase -o vase.obj
ok run bisque-voxelize vase.obj -o vase.tris
ok run bisque-simplify vase.tris -o low.obj --triangles 3000 --json
json '.meshes | length == 1'
json '.meshes[0] | .triangles <= 3000 and .triangles > 2990 and .target == 3000'
json '.diagonal as $d | .meshes[0] | .from_scan.mean < 0.001 * $d and .from_scan.max < 0.01 * $d'
json '.meshes[0] | .to_scan.max < 2 * .from_scan.max and .from_scan.p99 <= .from_scan.max'
[ "$(grep -c '^f ' low.obj)" = "$(jq '.meshes[0].triangles' "$out")" ] &&
    [ "$(grep -c '^v ' low.obj)" = "$(jq '.meshes[0].vertices' "$out")" ]
check "the file has the triangles and vertices of the report" $?
jq '.meshes[0] | {from_scan, to_scan}' "$out" >measured

# Others that read the mesh see the same distances, up to the rounding of its text.
ok run bisque-compare low.obj vase.tris --json
jq -e --slurpfile m measured 'def near($a; $b): ($a - $b) * ($a - $b) <= 1e-6 * $b * $b;
    near(.from_scan.mean; $m[0].from_scan.mean) and near(.from_scan.max; $m[0].from_scan.max) and
    (.to_scan.mean / $m[0].to_scan.mean - 1 | fabs) < 0.05' "$out" >/dev/null
check "bisque-compare measures the same" $?
ok run bisque-compare low.obj vase.tris --max-error 1
run bisque-compare low.obj low.obj
refused 64 "bisque-compare: low.obj: a mesh is compared with a scan in chunks, which bisque-voxelize low.obj -o scan.tris makes"
run bisque-compare vase.tris low.obj
refused 64 "bisque-compare: vase.tris is the scan, and low.obj the mesh: swap them"
run bisque-compare low.obj vase.tris --max-mean 1e-9
code 1
grep -q 'mean .* is above --max-mean 1e-09' "$err"
check "a limit that does not hold is named" $?
run bisque-compare low.obj vase.tris --min-psnr 20
refused 64 "bisque-compare: --min-psnr is for maps, not for a mesh and a scan"

# Threads and memory do not show; nor does whether the scan was sorted before.
ok run bisque-simplify vase.tris -o one.ply --triangles 2000 --threads 1 --memory 64M
ok run bisque-simplify vase.tris -o more.ply --triangles 2000 --threads 5 --memory 1G
ok run bisque-simplify vase.obj -o mesh.ply --triangles 2000
same one.ply more.ply
same one.ply mesh.ply

# Several levels in one run; each is one of the next larger one.
ok run bisque-simplify vase.tris -o 'lod_<N>.ply' --triangles 500,4000,2000 --json
json '.meshes | map(.target) == [4000, 2000, 500]'
json '[.meshes[].from_scan.mean] | .[0] < .[1] and .[1] < .[2]'
for n in 4000 2000 500; do
    faces=$(sed -n '/^element face /s///p;/^end_header/q' lod_$n.ply)
    [ "$faces" -le $n ] && [ "$faces" -gt $((n * 98 / 100)) ]
    check "lod_$n.ply has about $n triangles" $?
done

# An error is kept, as another program measures it.
diagonal=$(jq .diagonal "$out")
error=$(echo "$diagonal" | awk '{ printf "%.6g", $1 * 0.003 }')
ok run bisque-simplify vase.tris -o error.ply --error "$error" --json
json ".meshes[0] | .from_scan.max <= $error and .to_scan.max <= $error and .target == 0"
found=$(jq '.meshes[0].triangles' "$out")
ok run bisque-compare error.ply vase.tris --max-error "$error"
# As many triangles are farther away if not each place has its limit.
ok run bisque-simplify vase.tris -o less.ply --triangles "$found" --json
json "[.meshes[0] | .from_scan.max, .to_scan.max] | max > $error"
ok run bisque-simplify vase.tris -o threads.ply --error "$error" --threads 5 --memory 64M
same error.ply threads.ply

# Shares of the scan: a tenth of its triangles, and of its diagonal.
ok run bisque-simplify vase.tris -o 'share_<N>.ply' --triangles 10%,3000 --json
json "[.meshes[].target] == [(.triangles / 10 | round), 3000]"
tenth=$(jq '.triangles / 10 | round' "$out")
[ -s share_3000.ply ] && [ -s "share_$tenth.ply" ]
check "files have the numbers of triangles in their names" $?
ok run bisque-simplify vase.tris -o share.ply --error 0.3% --json
json '.diagonal as $d | .meshes[0] | [.from_scan.max, .to_scan.max] | max <= 0.003 * $d and max > 0.0025 * $d'

# ---- pieces and edges ----

# A cube of 12 triangles and a far smaller one.
cube()
{
    for z in 0 1; do for y in 0 1; do for x in 0 1; do
        echo "$x $y $z" | awk -v s="$1" -v o="$2" '{ print "v", o + s * $1, s * $2, s * $3 }'
    done; done; done
    for f in '1 3 4 2' '5 6 8 7' '1 2 6 5' '3 7 8 4' '1 5 7 3' '2 4 8 6'; do
        echo "f $f" | awk -v n="$3" '{ print "f", n + $2, n + $3, n + $4, n + $5 }'
    done
}
{ cube 1 0 0; cube 0.01 3 8; } >cubes.obj
ok run bisque-simplify cubes.obj -o cubes_low.obj --triangles 24 --hard-angle 60 --json
json '.dropped_pieces == 0 and .meshes[0].triangles == 24'
[ "$(grep -c '^vn' cubes_low.obj)" -eq 48 ]
check "corners of a cube have three normals each" $?
ok run bisque-simplify cubes.obj -o cubes_low.obj --triangles 24 --min-component 5 --json
json '.dropped_pieces == 1 and .dropped_triangles == 12 and .meshes[0].triangles == 12'
{ cat cubes.obj; printf 'v %s 9\n' '0 0' '9 0' '0 9'; echo f 17 18 19; } >triangle.obj
ok run bisque-simplify triangle.obj -o cubes_low.obj --triangles 24 --min-triangles 2 --json
json '.dropped_pieces == 1 and .dropped_triangles == 1 and .meshes[0].triangles == 24'
run bisque-simplify triangle.obj -o cubes_low.obj --triangles 24 --min-triangles 13
refused_like 65 "^$p cubes_low.obj: no piece is as large as the least component, "
ok run bisque-simplify cubes.obj -o cubes_low.obj --triangles 24 --min-component 5% --json
json '.dropped_pieces == 1 and .dropped_triangles == 12 and .meshes[0].triangles == 12'
[ "$(grep -c '^vn' cubes_low.obj)" -eq 8 ]
check "without hard edges, corners of a cube have one normal each" $?
ok run bisque-simplify cubes.obj -o cubes_low.obj --triangles 4 --json
json '.dropped_pieces >= 1 and .meshes[0].triangles == 4 and .meshes[0].from_scan.max > 1.5'

# The hole of a frame stays.
printf 'v %s 0\n' '0 0' '3 0' '3 3' '0 3' '1 1' '2 1' '2 2' '1 2' >frame.obj
printf 'f %s\n' '1 2 6 5' '2 3 7 6' '3 4 8 7' '4 1 5 8' >>frame.obj
ok run bisque-simplify frame.obj -o frame_low.obj --triangles 4
grep -q "^$p warning: frame_low.obj: 6 triangles instead of 4: " "$err"
check "a target that cannot be reached is told" $?

# Faces that only nearly meet are pieces. None vanishes but for the target, and then that is told.
{ cube 1 0 0; } | awk 'BEGIN { srand(1) } $1 == "v" { x[++n] = $2; y[n] = $3; z[n] = $4 } $1 == "f" {
    for (i = 2; i <= 5; i++) {
        printf "v"
        split(x[$i] " " y[$i] " " z[$i], p)
        for (k = 1; k <= 3; k++) printf " %.9f", p[k] + 2e-7 * (rand() - 0.5)
        print ""
    }
    print "f", ++m, ++m, ++m, ++m
}' >apart.obj
ok run bisque-simplify apart.obj -o apart_low.obj --triangles 6 --json
json '.dropped_pieces == 0 and .meshes[0].triangles == 6'
ok run bisque-simplify apart.obj -o apart_low.obj --triangles 4 --json
json '.dropped_pieces == 2 and .meshes[0].triangles == 4 and .meshes[0].from_scan.max > 0.3'

# Materials of a scan leave no trace.
awk -v n=80 'BEGIN {
    print "mtllib two.mtl"
    for (y = 0; y <= n; y++) for (x = 0; x <= n; x++) print "v", x, y, sin(x / 7) * cos(y / 9)
    split("red blue", names)
    for (m = 1; m <= 2; m++) {
        print "usemtl", names[m]
        for (y = 0; y < n; y++) for (x = 0; x < n; x++)
            if ((x < 40 + y / 4) == (m == 1)) {
                a = y * (n + 1) + x + 1
                print "f", a, a + 1, a + n + 2, a + n + 1
            }
    }
}' >two.obj
printf 'newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n' >two.mtl
ok run bisque-simplify two.obj -o two_low.obj --triangles 400
awk '$1 == "v" { x[++n] = $2; y[n] = $3 } $1 == "usemtl" { bad = 1 } $1 == "f" {
    split($2 " " $3 " " $4, v, "[/ ]+")
    a = v[1]; b = v[3]; c = v[5]
    area += ((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])) / 2
} END { exit bad || area < 6399 || area > 6401 }' two_low.obj
check "the area of both materials is one mesh" $?

# A GLB file has the triangles of the OBJ file, and normals.
ok run bisque-simplify two.obj -o two_low.glb --triangles 400 --json
python3 - two_low.glb >glb.txt <<'END'
import json, struct, sys
data = open(sys.argv[1], "rb").read()
size, = struct.unpack_from("<I", data, 12)
doc = json.loads(data[20:20 + size])
binary = data[20 + size + 8:]
def read(number):
    a = doc["accessors"][number]
    v = doc["bufferViews"][a["bufferView"]]
    kind, n = ("I", 1) if a["componentType"] == 5125 else ("f", 3)
    step = v.get("byteStride", 4 * n)
    at = v["byteOffset"] + a["byteOffset"]
    return [struct.unpack_from("<%d%s" % (n, kind), binary, at + step * i) for i in range(a["count"])]
p, = doc["meshes"][0]["primitives"]
xyz, i = read(p["attributes"]["POSITION"]), [x for x, in read(p["indices"])]
off = max(abs(sum(x * x for x in n) - 1) for n in read(p["attributes"]["NORMAL"]))
area = sum((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]) for a, b, c in zip(*(iter(xyz[k] for k in i),) * 3))
print(round(area / 2000, 1), len(i) // 3, off < 1e-5, "material" in p)
END
[ "$(cat glb.txt)" = "6.4 $(jq '.meshes[0].triangles' "$out") True False" ]
check "the GLB file has the mesh" $?

# A flat scan, some of whose faces have no area: the outline stays, and few triangles.
awk -v n=60 'BEGIN {
    for (y = 0; y <= n; y++) for (x = 0; x <= n; x++) {
        moved = x % 7 == 3 && y % 7 == 3 # to the diagonal of a square
        print "v", x + moved / 2, y - moved / 2, 0
    }
    for (y = 0; y < n; y++) for (x = 0; x < n; x++) {
        a = y * (n + 1) + x + 1
        print "f", a, a + 1, a + n + 2
        print "f", a, a + n + 2, a + n + 1
    }
}' >flat.obj
ok run bisque-simplify flat.obj -o flat_low.obj --triangles 20 --json
json '.meshes[0].triangles <= 20 and .meshes[0].from_scan.max < 1e-3'
awk '$1 == "v" { x[++n] = $2; y[n] = $3 } $1 == "f" {
    split($2 " " $3 " " $4, v, "[/ ]+")
    a = v[1]; b = v[3]; c = v[5]
    area = ((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])) / 2
    sum += area
    if (!(area > 0.01)) exit bad = 1
} END { exit bad || sum < 3599.9 || sum > 3600.1 }' flat_low.obj
check "a flat scan keeps its outline and has no empty triangles" $?

# Far from the origin, positions keep their detail.
awk '$1 == "v" { $2 = 500000 + $2 } 1' OFMT=%.12g CONVFMT=%.12g vase.obj >far.obj
ok run bisque-simplify far.obj -o far_low.obj --triangles 2000 --json
json '.diagonal as $d | .meshes[0].from_scan.mean < 0.002 * $d'
ok run bisque-voxelize far.obj -o far.tris
ok run bisque-compare far_low.obj far.tris --max-mean "$(echo "$diagonal" | awk '{ print $1 * 0.002 }')"

# ---- messages ----

run bisque-simplify vase.tris -o low.stl --triangles 100
refused 64 "$p low.stl: the name of a mesh must end in .obj, .ply or .glb"
run bisque-simplify vase.tris -o low.obj
refused 64 "$p either --triangles or --error is needed"
run bisque-simplify vase.tris -o low.obj --triangles 100 --error 1
refused 64 "$p either --triangles or --error is needed"
run bisque-simplify vase.tris -o low.obj --triangles 100,x
refused 64 "$p --triangles: \"100,x\" is not a list of numbers of 4 or more, or of percentages"
run bisque-simplify vase.tris -o low.obj --triangles 101%
refused 64 "$p --triangles: \"101%\" is not a list of numbers of 4 or more, or of percentages"
run bisque-simplify vase.tris -o low.obj --error 0%
refused 64 "$p --error: \"0%\" is not above 0"
run bisque-simplify vase.tris -o low.obj --error 1mm
refused 64 "$p --error: \"1mm\" is not a non-negative number"
run bisque-simplify vase.tris -o low.obj --triangles 100 --min-component 101%
refused 64 "$p --min-component: 101 is above 100"
run bisque-simplify vase.tris -o low.obj --triangles 100,100
refused 64 "$p --triangles: 100 twice"
run bisque-simplify vase.tris -o 'low_<N>.obj' --triangles 10%,10.0%
refused 64 "$p --triangles: $tenth twice"
run bisque-simplify vase.tris -o low.obj --triangles 200,100
refused 64 "$p low.obj: the name of 2 meshes must contain <N>"
run bisque-simplify none.tris -o low.obj --triangles 200
refused_like 66 '^bisque-simplify: none.tris: '
run bisque-simplify vase.obj -o vase.obj --triangles 200
refused_like 64 'vase.obj'
run bisque-simplify vase.tris -o cubes.obj --error 1e-30
refused_like 65 "^$p --error: 1e-30 cannot be kept: "
head -c 3000 vase.tris >cut.tris
run bisque-simplify cut.tris -o low.ply --triangles 200
refused_like 65 '^bisque-simplify: cut.tris: '
[ ! -e low.ply ]
check "a failed run leaves no mesh" $?

interrupted TERM measuring bisque-simplify vase.tris -o late.obj --triangles 50000
interrupted INT 'collapsing edges' bisque-simplify vase.tris -o late.obj --triangles 2000
[ ! -e late.obj ]
check "an interrupted run leaves no mesh" $?

finish

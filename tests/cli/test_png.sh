#!/bin/sh
# test_png.sh - PNG maps as engines and browsers take them: chunks of colour spaces, and flat normals.
. "$(dirname "$0")/lib.sh"

# A flat, tilted scan of unequal triangles with colours, and a square that covers most of the map.
python3 - <<'END'
import random
from math import cos, sin
random.seed(3)
SIDE, A, B = 60, 0.3, 0.5

def tilt(x, y, z):
    y, z = y * cos(A) - z * sin(A), y * sin(A) + z * cos(A)
    return "%.9g %.9g %.9g\n" % (x * cos(B) + z * sin(B), y, -x * sin(B) + z * cos(B))

with open("flat.obj", "w") as file:
    for j in range(SIDE + 1):
        for i in range(SIDE + 1):
            x, y = (k + random.uniform(-.3, .3) * (0 < k < SIDE) for k in (i, j))
            file.write("v %s 0.5 0.25 1\n" % tilt(x / SIDE, y / SIDE, 0).strip())
    for j in range(SIDE):
        for a in range(j * (SIDE + 1) + 1, j * (SIDE + 1) + SIDE + 1):
            b, c, d = a + 1, a + SIDE + 2, a + SIDE + 1
            file.write("f %d %d %d\nf %d %d %d\n" % (a, b, c, a, c, d))
with open("low.obj", "w") as file:
    for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
        file.write("v " + tilt(x, y, 0) + "vt %g %g\n" % (.1 + .8 * x, .1 + .8 * y))
    file.write("vn " + tilt(0, 0, 1) + "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n")
END
ok run bisque-voxelize flat.obj --resolution 200 -o flat.nvdb

# chunks FILE KINDS: the file has these kinds of chunks, and no others.
chunks()
{
    holds "$1: $2" [ "$(python3 -c 'import png, sys; print(png.chunks(sys.argv[1]))' "$1")" = "$2" ]
}

PYTHONPATH=$top/tests/cli
export PYTHONPATH
size=128
sanitized && size=64
for scan in flat.nvdb flat.tris; do
    for green in up down; do
        ok run bisque-bake $scan low.obj --size $size --type 8 --maps normal,bent,color,ao,mask \
            --rays ao=4 --normal green=$green --padding 4 -o "<MAP>.png" --preview preview.png
        command="normal.png and bent.png of $scan"
        holds "flat normals and backgrounds are (128, 128, 255)" python3 -c "
import png
assert {t for row in png.read('normal.png')[3] for t in row} == {(128, 128, 255)}
assert set(png.read('bent.png')[3][0]) == {(128, 128, 255)}"
    done
    for map in normal bent ao mask; do
        chunks $map.png "IHDR tEXt IDAT IEND"
    done
    chunks color.png "IHDR gAMA sRGB cHRM tEXt IDAT IEND"
    chunks preview.png "IHDR gAMA sRGB cHRM IDAT IEND"
    ok run bisque-bake $scan low.obj --size $size --maps normal,height -o "<MAP>.png"
    chunks normal.png "IHDR tEXt IDAT IEND"
    chunks height.png "IHDR tEXt IDAT IEND"
done
finish

# texture_lib.sh - planes with textures by formula. Needs tests/cli/lib.sh and $TESTS.
#
# Writes the textures of transfer.py and these meshes, with x and y from 0 to 1:
#   plane.obj  5 x 5 quads with texture coordinates u = x, v = y
#   two.obj    the same with the materials "left" and "right" of two.mtl, which change at x = 0.6
#   low.obj    a square over them with u = y, v = x
#   bare.obj   the square without texture coordinates
#
#   values FILE FUNCTION TOLERANCE   checks that the map has the values of a function of transfer.py

maps="python3 -B $top/tests/cli/transfer.py"
awk 'BEGIN {
    for (j = 0; j <= 5; j++)
        for (i = 0; i <= 5; i++)
            printf "v %.2f %.2f 0\nvt %.2f %.2f\n", i / 5, j / 5, i / 5, j / 5
    for (j = 0; j < 5; j++)
        for (i = 1; i <= 5; i++) {
            a = 6 * j + i
            printf "f %d/%d %d/%d %d/%d %d/%d\n", a, a, a + 1, a + 1, a + 7, a + 7, a + 6, a + 6
        }
}' >plane.obj
awk '/^f/ { print "usemtl " (n++ % 5 < 3 ? "left" : "right") } { print }
    BEGIN { print "mtllib two.mtl" }' plane.obj >two.obj
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 0 1\nvt 1 1\nvt 1 0\nf 1/1 2/2 3/3 4/4\n' >low.obj
printf 'v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n' >bare.obj
$maps make || exit 1

values()
{
    $maps check "$@" >"$out"
    check "$1 shows $2" $?
}

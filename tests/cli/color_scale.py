"""Writes a sheet of vertices whose colours have a scale that the first ones do not tell.

usage: color_scale.py CASE DIRECTORY

CASE is a key of CASES. DIRECTORY gets the sheet as scan.obj, text.ply, binary.ply and, with the
colours that it should have as bytes, as bytes.ply.
"""
import struct
import sys

SIDE = 160
COUNT = SIDE * SIDE


def late_bytes(i):
    """Black and nearly black, then bytes."""
    return (i % 2, 0, 1) if i < 0.9 * COUNT else (i % 256, 255 - i % 200, 7)


def late_units(i):
    """Pure colours, one of which is too large, come first, then fractions of 1."""
    return (2 * (i == 0.4 * COUNT), 0, 1) if i < 0.5 * COUNT else (i % 64 / 64, 0.5, 1 - i % 128 / 128)


# Each with the factor to bytes.
CASES = {"late_bytes": (late_bytes, 1), "late_units": (late_units, 255)}


def main():
    color, factor = CASES[sys.argv[1]]
    folder = sys.argv[2] + "/"
    vertices = [(i % SIDE, i // SIDE, 0) for i in range(COUNT)]
    colors = [color(i) for i in range(COUNT)]
    step = 3
    faces = [(i, i + step, i + step + step * SIDE, i + step * SIDE) for y in range(0, SIDE - step, step)
             for x in range(0, SIDE - step, step) for i in (y * SIDE + x,)]

    def header(encoding, kind):
        lines = ["ply", f"format {encoding} 1.0", f"element vertex {COUNT}"]
        lines += [f"property float {name}" for name in "xyz"]
        lines += [f"property {kind} {name}" for name in ("red", "green", "blue")]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        return ("\n".join(lines) + "\n").encode()

    with open(folder + "scan.obj", "w") as out:
        out.writelines("v %g %g %g %.9g %.9g %.9g\n" % (v + c) for v, c in zip(vertices, colors))
        out.writelines("f %d %d %d %d\n" % tuple(i + 1 for i in f) for f in faces)
    with open(folder + "text.ply", "wb") as out:
        out.write(header("ascii", "float"))
        out.writelines(b"%g %g %g %.9g %.9g %.9g\n" % (v + c) for v, c in zip(vertices, colors))
        out.writelines(b"4 %d %d %d %d\n" % f for f in faces)
    for name, layout, kind in (("binary", "<6f", "float"), ("bytes", "<3f3B", "uchar")):
        values = colors
        if name == "bytes":
            values = [tuple(min(int(x * factor + 0.5), 255) for x in c) for c in colors]
        with open(folder + name + ".ply", "wb") as out:
            out.write(header("binary_little_endian", kind))
            out.writelines(struct.pack(layout, *v, *c) for v, c in zip(vertices, values))
            out.writelines(struct.pack("<B4i", 4, *f) for f in faces)


main()

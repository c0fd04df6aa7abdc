"""pairs.py - writes a mesh of a shape as OBJ, for pairs of scan and low-poly mesh.

    pairs.py FILE SHAPE ROWS [KEY=VALUE]...

A shape is a closed surface over latitude and longitude, or a sheet over a square, with normals and
texture coordinates. Keys, in the order in which they are applied: detail (height of fine waves on
the surface), part (share of the longitudes, or of the square, from 0 on), scale, turn (what becomes
of x, y and z, such as x,-z,y), mirror, invert (1), shift (x,y,z), name (of an object), bare (1: no
normals).
"""

import math
import sys


def star(u, v, bumps):
    """The point of a unit sphere at (u, v), moved out by bumps (direction, width, height)."""
    a, b = 2 * math.pi * u, math.pi * v
    d = (math.sin(b) * math.cos(a), math.cos(b), -math.sin(b) * math.sin(a))
    r = 1.0
    for direction, width, height in bumps:
        cosine = sum(p * q for p, q in zip(d, direction)) / math.hypot(*direction)
        r += height * math.exp((cosine - 1) / width)
    return tuple(r * c for c in d)


def stretch(p, by):
    return tuple(c * s for c, s in zip(p, by))


HEAD = [((0.2, 0, 1), 0.03, 0.35), ((1, 0.4, 0), 0.05, 0.25), ((-1, 0.9, -0.2), 0.1, 0.2),
        ((0.3, -1, -0.6), 0.2, 0.3)]
STATUE = [((1, 0.2, 0.3), 0.04, 0.8), ((-0.4, 0.5, 0.8), 0.05, 0.5), ((0, 1, -0.3), 0.08, 0.4)]


def torus(u, v):
    a, b = 2 * math.pi * u, 2 * math.pi * v
    r = 1 + 0.35 * math.cos(b)
    return (r * math.cos(a), 0.35 * math.sin(b), r * math.sin(a))


def cube(u, v):
    p = star(u, v, [])
    most = max(abs(c) for c in p)
    return tuple(c / most for c in p)


SHAPES = {
    "sphere": lambda u, v: star(u, v, []),
    "ellipsoid": lambda u, v: stretch(star(u, v, []), (1, 1.7, 0.6)),
    "head": lambda u, v: star(u, v, HEAD),
    "statue": lambda u, v: stretch(star(u, v, STATUE), (0.5, 1.6, 0.4)),
    "torus": torus,
    "cube": cube,
    "bust": lambda u, v: star(u, 0.75 * v, HEAD),
    "sheet": lambda u, v: (2 * u, 0.2 * math.sin(4 * u) * math.cos(3 * v), -3 * v),
    "flat": lambda u, v: (2 * u, 0, -2 * v),
}


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a):
    length = math.hypot(*a) or 1
    return tuple(c / length for c in a)


def normal(shape, u, v):
    """Outwards: u grows eastwards, v southwards."""
    e = 1e-4
    v = min(max(v, 2 * e), 1 - 2 * e)
    du = [a - b for a, b in zip(shape(u + e, v), shape(u - e, v))]
    dv = [a - b for a, b in zip(shape(u, v + e), shape(u, v - e))]
    return unit(cross(dv, du))


def turn(p, axes):
    return tuple((-1 if a[0] == "-" else 1) * p["xyz".index(a[-1])] for a in axes)


def main():
    path, name, rows = sys.argv[1], sys.argv[2], int(sys.argv[3])
    keys = dict(argument.split("=") for argument in sys.argv[4:])
    shape = SHAPES[name]
    detail, part = float(keys.get("detail", 0)), float(keys.get("part", 1))
    scale, axes = float(keys.get("scale", 1)), keys.get("turn", "x,y,z").split(",")
    shift = [float(s) for s in keys.get("shift", "0,0,0").split(",")]
    mirror, invert = "mirror" in keys, "invert" in keys
    columns = 2 * rows
    lines = ["o " + keys["name"]] if "name" in keys else []
    for j in range(rows + 1):
        for i in range(columns + 1):
            u, v = part * i / columns, j / rows
            p, n = shape(u, v), normal(shape, u, v)
            wave = detail * math.sin(61 * u * math.pi) * math.sin(47 * v * math.pi)
            p = turn([scale * (c + wave * d) for c, d in zip(p, n)], axes)
            n = turn(n, axes)
            if mirror:
                p, n = (-p[0], *p[1:]), (-n[0], *n[1:])
            if invert:
                n = tuple(-c for c in n)
            lines.append("v %.9g %.9g %.9g" % tuple(c + s for c, s in zip(p, shift)))
            lines.append("vt %.6f %.6f" % (i / columns, 1 - j / rows))
            if "bare" not in keys:
                lines.append("vn %.6f %.6f %.6f" % n)
    corner = "%d/%d" if "bare" in keys else "%d/%d/%d"
    for j in range(rows):
        for i in range(columns):
            a = j * (columns + 1) + i + 1
            face = [a, a + columns + 1, a + columns + 2, a + 1]
            face = face[::-1] if mirror != invert else face
            for k in (1, 2):
                three = [face[0], face[k], face[k + 1]]
                lines.append("f " + " ".join(corner % ((c,) * corner.count("%")) for c in three))
    with open(path, "w", encoding="ascii") as file:
        file.write("\n".join(lines) + "\n")


main()

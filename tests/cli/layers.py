"""layers.py - scans whose surfaces lie close to each other, and low-poly meshes of them.

layers.py write SCENE: writes SCENE.obj and SCENE_low.obj. Each part is an object, named alike in
both; the low-poly mesh has vertices on the scan. layers.py wrong ID EXPECTED: prints the share in
percent of the texels of an id map that show another part than the low-poly mesh's own."""
import math
import sys

import png


def capsule(a, b, radius):
    """A surface around the line from a to b: v runs from one end to the other, u around it."""
    axis = [q - p for p, q in zip(a, b)]
    length = math.sqrt(sum(x * x for x in axis)) or 1.0
    w = [x / length for x in axis]
    if not any(axis):
        w = [0, 0, 1]
    s = [0, -w[2], w[1]] if abs(w[0]) < 0.6 else [w[2], 0, -w[0]]
    size = math.sqrt(sum(x * x for x in s))
    s = [x / size for x in s]
    t = [w[1] * s[2] - w[2] * s[1], w[2] * s[0] - w[0] * s[2], w[0] * s[1] - w[1] * s[0]]
    straight = sum(x * x for x in axis) ** 0.5
    whole = math.pi * radius + straight

    def at(u, v):
        way = v * whole
        if way < math.pi / 2 * radius:
            angle, along = way / radius, 0
        elif way > whole - math.pi / 2 * radius:
            angle, along = math.pi - (whole - way) / radius, straight
        else:
            angle, along = math.pi / 2, way - math.pi / 2 * radius
        x, y, z = (math.sin(angle) * math.cos(2 * math.pi * u),
                   math.sin(angle) * math.sin(2 * math.pi * u), -math.cos(angle))
        normal = [x * i + y * j + z * k for i, j, k in zip(s, t, w)]
        return [p + along * k + radius * n for p, k, n in zip(a, w, normal)], normal
    return at


def disc(centre, radius, height):
    """A flat ellipsoid."""
    def at(u, v):
        angle = math.pi * v
        n = [math.sin(angle) * math.cos(2 * math.pi * u),
             math.sin(angle) * math.sin(2 * math.pi * u), -math.cos(angle)]
        point = [c + r * x for c, r, x in zip(centre, (radius, radius, height), n)]
        normal = [x / r for r, x in zip((radius, radius, height), n)]
        size = math.sqrt(sum(x * x for x in normal))
        return point, [x / size for x in normal]
    return at


# Parts: name, surface, faces around and along in the low-poly mesh; 0: the scan alone has the part.
SCENES = {
    # Two spheres, 2.5 % apart.
    "spheres": [("inner", capsule((0, 0, 0), (0, 0, 0), 1), 0, 0),
                ("outer", capsule((0, 0, 0), (0, 0, 0), 1.025), 16, 8)],
    # A body in a coat, thin arms beside it, and a head under the brim of a hat.
    "figure": [("body", capsule((0, 0, 0), (0, 0, 1), 0.3), 0, 0),
               ("coat", capsule((0, 0, 0), (0, 0, 1), 0.31), 12, 10),
               ("left", capsule((0.36, 0, 0.1), (0.4, 0, 1), 0.04), 6, 8),
               ("right", capsule((-0.36, 0, 0.1), (-0.4, 0, 1), 0.04), 6, 8),
               ("head", capsule((0, 0, 1.55), (0, 0, 1.55), 0.2), 10, 6),
               ("hat", disc((0, 0, 1.775), 0.35, 0.02), 12, 6)],
    # Fingers side by side, with gaps of a tenth of their width.
    "fingers": [("f%d" % i, capsule((0.22 * i, 0, 0), (0.22 * i, 0.05 * i, 0.8), 0.1), 6, 6)
                for i in range(4)],
}


def write(path, parts, cells):
    """Writes parts of around x along quads each, with texture coordinates in cells of a square."""
    side = math.ceil(math.sqrt(cells))
    first = 1
    with open(path, "w") as file:
        for number, (name, at, around, along) in enumerate(parts):
            file.write("o %s\n" % name)
            for j in range(along + 1):
                for i in range(around + 1):
                    u, v = i / around, j / along
                    # Both ends of a row are one point.
                    point, normal = at(u % 1 if 0 < j < along else 0, v)
                    cell = [((number % side) + 0.04 + 0.92 * u) / side,
                            (number // side + 0.04 + 0.92 * v) / side]
                    file.write("v %.9g %.9g %.9g\nvn %.9g %.9g %.9g\nvt %.9g %.9g\n"
                               % (*point, *normal, *cell))
            for j in range(along):
                for i in range(around):
                    a = first + j * (around + 1) + i
                    quad = [a, a + 1, a + around + 2, a + around + 1]
                    if j == 0:
                        quad = [a, a + around + 2, a + around + 1]
                    elif j == along - 1:
                        quad = [a, a + 1, a + around + 1]
                    file.write("f %s\n" % " ".join("%d/%d/%d" % (k, k, k) for k in quad))
            first += (around + 1) * (along + 1)


def main(command, *names):
    if command == "write":
        parts = SCENES[names[0]]
        low = [part for part in parts if part[2] > 0]
        write(names[0] + ".obj", [(name, at, 128, 96) for name, at, _, _ in parts], len(parts))
        write(names[0] + "_low.obj", low, len(low))
    else:
        shown, expected = (png.read(name)[3] for name in names)
        pairs = [(a, b) for x, y in zip(shown, expected) for a, b in zip(x, y)]
        covered = [(a, b) for a, b in pairs if any(b)]
        print("%.2f" % (100 * sum(a != b for a, b in covered) / len(covered)))


main(*sys.argv[1:])

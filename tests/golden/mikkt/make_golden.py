"""Makes the golden tangents in this directory with Blender, whose mesh tangents follow MikkTSpace.

    blender -b --factory-startup -P tests/golden/mikkt/make_golden.py

Written with Blender 3.4.1 (Debian 12). Each mesh becomes NAME.csv: a header line, then one line per
corner, three corners per triangle:

    position x y z, normal x y z, texture u v, tangent x y z, sign

All are float32 values, printed so that they are read back exactly. Normals are those that Blender
worked with, so they belong to the input.
"""

import math
import os
import random

import bpy

HERE = os.path.dirname(os.path.abspath(__file__))


def write(name, vertices, triangles, uvs, normals=None, smooth=True):
    """uvs and normals: per corner, in the order of the triangles."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], triangles)
    mesh.uv_layers.new(name="uv")
    for loop, uv in zip(mesh.uv_layers[0].data, uvs):
        loop.uv = uv
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(triangles))
    if normals:
        mesh.use_auto_smooth = True
        mesh.auto_smooth_angle = math.pi
        mesh.normals_split_custom_set(normals)
    mesh.calc_tangents(uvmap="uv")
    with open(os.path.join(HERE, name + ".csv"), "w", newline="\n") as out:
        out.write("px,py,pz,nx,ny,nz,u,v,tx,ty,tz,sign\n")
        for loop, uv in zip(mesh.loops, mesh.uv_layers[0].data):
            position = mesh.vertices[loop.vertex_index].co
            numbers = [*position, *loop.normal, *uv.uv, *loop.tangent, loop.bitangent_sign]
            out.write(",".join("%.9g" % n for n in numbers) + "\n")
    print(name, len(triangles), "triangles")


def grid(columns, rows, height):
    """A height field: vertices and triangles, two a cell, with diagonals that alternate."""
    vertices = [(x / columns - 0.5, y / rows - 0.5, height(x / columns, y / rows))
                for y in range(rows + 1) for x in range(columns + 1)]
    triangles = []
    for y in range(rows):
        for x in range(columns):
            a = y * (columns + 1) + x
            b, c, d = a + 1, a + columns + 2, a + columns + 1
            triangles += [(a, b, c), (a, c, d)] if (x + y) % 2 else [(a, b, d), (b, c, d)]
    return vertices, triangles


def per_corner(triangles, values):
    return [values[v] for triangle in triangles for v in triangle]


def waves(x, y):
    return 0.1 * math.sin(7 * x) * math.cos(5 * y + 1)


def make_torus():
    """Shared vertices; seams where u and v wrap around."""
    n, m = 12, 7
    vertices, triangles, uvs = [], [], []
    for i in range(n):
        for j in range(m):
            a, b = 2 * math.pi * i / n, 2 * math.pi * j / m
            r = 1 + 0.4 * math.cos(b)
            vertices.append((r * math.cos(a), r * math.sin(a), 0.4 * math.sin(b)))
    for i in range(n):
        for j in range(m):
            cell = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            for corners in ((0, 1, 2), (0, 2, 3)):
                triangles.append(tuple(cell[k][0] % n * m + cell[k][1] % m for k in corners))
                uvs += [(cell[k][0] / n, 0.3 * cell[k][1] / m + cell[k][0] / n / 9)
                        for k in corners]
    write("torus_seams", vertices, triangles, uvs)


def make_cube():
    """Hard edges: flat normals; every side has a chart of its own, rotated differently."""
    vertices = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles, uvs = [], []
    for side, q in enumerate(quads):
        turn = math.radians(37 * side)
        square = []
        for k in range(4):
            angle = turn + k * math.pi / 2
            square.append((0.2 + 0.3 * (side % 3) + 0.1 * math.cos(angle),
                           0.3 + 0.4 * (side // 3) + 0.1 * math.sin(angle)))
        for k in ((0, 1, 2), (0, 2, 3)):
            triangles.append(tuple(q[i] for i in k))
            uvs += [square[i] for i in k]
    write("cube_hard_edges", vertices, triangles, uvs, smooth=False)


def make_split_normals():
    """Custom normals: smooth on one side of x = 0, one normal per triangle on the other."""
    vertices, triangles = grid(6, 6, waves)
    normals = []
    for triangle in triangles:
        left = all(vertices[v][0] <= 0 for v in triangle)
        for v in triangle:
            x, y, _ = vertices[v]
            n = (-0.5 * x, 0.6 * y, 1) if left else (0.2 * triangle[0] % 0.7, 0.3, 1)
            length = math.sqrt(sum(k * k for k in n))
            normals.append(tuple(k / length for k in n))
    uvs = per_corner(triangles, [(x + 0.5 + 0.2 * y, y * y + 0.7 * y) for x, y, _ in vertices])
    write("split_normals", vertices, triangles, uvs, normals)


def make_mirrored():
    """Both halves use the same texture space, so the right one is mirrored."""
    vertices, triangles = grid(8, 5, waves)
    uvs = per_corner(triangles, [(abs(x), y + 0.5 + 0.3 * x * x) for x, y, _ in vertices])
    write("mirrored", vertices, triangles, uvs)


def make_degenerate_uvs():
    """Triangles without area in texture space: single, in strips, around a whole vertex, between
    mirrored neighbours, and a piece where nothing has any."""
    vertices, triangles = grid(8, 6, waves)
    points = []
    for x, y, _ in vertices:
        points.append([round(16 * abs(x)) / 16, round(12 * y) / 16 + 0.5])
    for column in (2, 3):  # a strip squeezed into a line
        for row in range(7):
            points[row * 9 + column] = [0.25, points[row * 9 + column][1]]
    for row in (2, 3, 4):  # a vertex whose triangles all shrink to a point
        for column in (6, 7, 8):
            points[row * 9 + column] = [0.125, 0.75]
    uvs = per_corner(triangles, points)
    base = len(vertices)
    vertices += [(3, 0, 0), (4, 0, 0), (4, 1, 0.5), (3, 1, 0)]
    triangles += [(base, base + 1, base + 2), (base, base + 2, base + 3)]
    uvs += [(0.5, 0.5)] * 6
    write("degenerate_uvs", vertices, triangles, uvs)


def make_degenerate_triangles():
    """Triangles that have one vertex twice: along edges, at a border, and with a texture coordinate
    that no other triangle has there."""
    vertices, triangles = grid(4, 4, waves)
    points = [(x + 0.5, y + 0.5) for x, y, _ in vertices]
    for a, b in ((6, 7), (7, 12), (12, 17), (24, 19)):
        triangles.insert(3 * (a % 5), (a, b, b))
    uvs = per_corner(triangles, points)
    triangles.append((12, 12, 11))
    uvs += [points[12], (0.9, 0.1), points[11]]
    write("degenerate_triangles", vertices, triangles, uvs)


def make_non_manifold():
    """Five sheets that meet in one edge, wound either way, and a Moebius strip."""
    vertices, triangles = [(0, 0, 0), (0, 0, 1), (0, 0, 2)], []
    points = [(0.5, 0), (0.5, 0.4), (0.5, 1)]
    for sheet in range(5):
        a = len(vertices)
        for k in range(3):
            angle = 1.2 * sheet + 0.1
            vertices.append((math.cos(angle), math.sin(angle), k + 0.1 * sheet))
            points.append((0.9 - 0.15 * sheet, k / 2))
        cells = [(0, 1, a), (1, a + 1, a), (1, 2, a + 1), (2, a + 2, a + 1)]
        triangles += [c[::-1] for c in cells] if sheet in (1, 2) else cells
    base, n = len(vertices), 9
    for i in range(n):
        a = 2 * math.pi * i / n
        for side in (-1, 1):
            r = 2 + 0.5 * side * math.cos(a / 2)
            vertices.append((r * math.cos(a) + 5, r * math.sin(a), 0.5 * side * math.sin(a / 2)))
            points.append((i / n, 0.25 + 0.25 * side))
    for i in range(n):
        a = base + 2 * i
        c = (a + 2, a + 3) if i < n - 1 else (base + 1, base)
        triangles += [(a, c[0], a + 1), (c[0], c[1], a + 1)]
    write("non_manifold", vertices, triangles, per_corner(triangles, points))


def make_soup():
    """Coarse random texture coordinates: mirrored, flat and healthy triangles side by side in every
    combination, in random order and with random first corners."""
    rng = random.Random(20080617)
    vertices, triangles = grid(9, 9, waves)
    points = [(rng.randrange(4) / 4, rng.randrange(4) / 4) for _ in vertices]
    triangles = [t[k:] + t[:k] for t in triangles for k in [rng.randrange(3)]]
    rng.shuffle(triangles)
    write("soup", vertices, triangles, per_corner(triangles, points))


make_torus()
make_cube()
make_split_normals()
make_mirrored()
make_degenerate_uvs()
make_degenerate_triangles()
make_non_manifold()
make_soup()

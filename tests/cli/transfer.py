"""transfer.py make: writes textures whose values are functions of u and v.
transfer.py check FILE FUNCTION TOLERANCE [swap]: checks that the texels of a map are values of a
function of the scan's texture coordinates, of which x of the map is v and y is u.
transfer.py glass: writes glass.png, whose colours are those of light.png and whose alpha is that of
slope.png, and planes with it as glTF files, blend.gltf and others.
transfer.py sphere: writes a sphere, ball.obj, whose image ball.png shows its position, and
ball_low.obj. transfer.py on_sphere PLACE ROUGHNESS NORMAL TOLERANCE: checks maps of it.
transfer.py gltf OBJ: writes the mesh of two.obj as two.gltf, with the materials of pbr.mtl.

The functions are known by the names of the textures. u grows to the right, v upwards."""
import base64
import json
import math
import struct
import sys

import png

SIDE = 64


def to_srgb(c):
    return 12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055


def to_linear(c):
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


def light(u, v):
    return 0.1 + 0.8 * u, 0.2 + 0.6 * v, 0.3


# Values of data, or linear light; all are linear in u and v, so filters keep them. Those of two
# materials change at u = 0.6, see test_transfer.sh.
FUNCTIONS = {
    "ramp": lambda u, v: (u,),
    "slope": lambda u, v: (0.25 + 0.5 * v,),
    "half_slope": lambda u, v: (0.125 + 0.25 * v,),
    "three": lambda u, v: (u, v, 0.5 + 0.25 * u - 0.5 * v),
    "light": light,
    "moved_light": lambda u, v: light(0.25 + 0.5 * u, 0.75 - 0.5 * v),
    "two_rough": lambda u, v: (0.3 if u < 0.6 else u,),
    "two_metal": lambda u, v: (v if u < 0.6 else 0.75,),
    "orm": lambda u, v: (0.25 + 0.5 * v, u, v),
    "pbr_rough": lambda u, v: (u if u < 0.6 else 0.5,),
    "two_opacity": lambda u, v: (0.5 if u < 0.6 else 0.75,),
    "half": lambda u, v: (0.5,),
    "whole": lambda u, v: (1,),
    "none": lambda u, v: (0,),
    "upper": lambda u, v: (1 if v >= 0.5 else 0,),
    "v": lambda u, v: (v,),
    "two_light": lambda u, v: light(0.25 + 0.5 * u, 0.75 - 0.5 * v) if u < 0.6 else
                 [to_linear(c) for c in (0.2, 0.4, 0.6)],
}


# A tangent-space normal map, and what it makes of the normal of a plane, as maps in object space show
# it: if texture coordinates are positions, and if u grows to the left.
def tilt(u, v):
    return 0.3 + 0.4 * u, 0.6 - 0.3 * v, 0.9


def tilted(u, v, x=1):
    n = [2 * c - 1 for c in tilt(u, v)]
    length = math.hypot(*n)
    return 0.5 + x * n[0] / length / 2, 0.5 + n[1] / length / 2, 0.5 + n[2] / length / 2


FUNCTIONS["tilt"] = tilt
FUNCTIONS["tilted"] = tilted
FUNCTIONS["tilted_left"] = lambda u, v: tilted(1 - u, v, -1)
FUNCTIONS["flat"] = lambda u, v: (0.5, 0.5, 1)
FUNCTIONS["half_tilted"] = lambda u, v: tilted(u, v) if u < 0.6 else (0.5, 0.5, 1)


# Tiles (0, 0) and (1, 0) of one texture; the third is missing.
def tile_light(u, v):
    return light(u, v) if u < 1 else (0.9 - 0.4 * (u - 1), 0.2 + 0.6 * v, 0.3)


FUNCTIONS["two_tiles_light"] = lambda u, v: tile_light(2 * u, v)


def make_tiles():
    for tile, name in enumerate(("udim.1001.png", "udim.1002.png")):
        rows = [[tuple(round(65535 * to_srgb(c))
                       for c in tile_light(tile + (x + 0.5) / SIDE, 1 - (y + 0.5) / SIDE))
                 for x in range(SIDE)] for y in range(SIDE)]
        png.write(name, 16, rows)


def make():
    make_tiles()
    for name, bits in (("ramp", 16), ("slope", 8), ("three", 16), ("light", 16), ("tilt", 16),
                       ("orm", 16)):
        most = 2**bits - 1
        encode = to_srgb if name == "light" else float
        rows = [[tuple(round(most * encode(c))
                       for c in FUNCTIONS[name]((x + 0.5) / SIDE, 1 - (y + 0.5) / SIDE))
                 for x in range(SIDE)] for y in range(SIDE)]
        png.write(name + ".png", bits, rows)


def glass():
    rows = [[tuple(round(65535 * c) for c in (*map(to_srgb, light(u, v)), 0.25 + 0.5 * v))
             for u in ((x + 0.5) / SIDE for x in range(SIDE))]
            for v in (1 - (y + 0.5) / SIDE for y in range(SIDE))]
    png.write("glass.png", 16, rows)
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    data = b"".join(struct.pack("<3f", x, y, 0) for x, y in corners) + \
        b"".join(struct.pack("<2f", x, 1 - y) for x, y in corners) + struct.pack("<6H", 0, 1, 2, 0, 2, 3)
    for name, alpha, factor in (
            ("blend", {"alphaMode": "BLEND"}, 1), ("opaque", {}, 1), ("thin", {"alphaMode": "BLEND"}, 0.5),
            ("mask", {"alphaMode": "MASK"}, 1), ("faint", {"alphaMode": "MASK", "alphaCutoff": 0.25}, 0.5),
            ("gone", {"alphaMode": "MASK", "alphaCutoff": 1e-30}, 0)):
        with open(name + ".gltf", "w") as file:
            json.dump({
                "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1},
                                            "indices": 2, "material": 0}]}],
                "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0},
                                                        "baseColorFactor": [1, 1, 1, factor]}, **alpha}],
                "textures": [{"source": 0}], "images": [{"uri": "glass.png"}],
                "accessors": [
                    {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                     "min": [0, 0, 0], "max": [1, 1, 0]},
                    {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
                    {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}],
                "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": size}
                                for at, size in ((0, 48), (48, 32), (80, 12))],
                "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," +
                             base64.b64encode(data).decode()}]}, file)


def check(path, name, tolerance):
    width, height, most, rows = png.read(path)
    worst = 0
    for y in range(height):
        for x in range(width):
            u, v = 1 - (y + 0.5) / height, (x + 0.5) / width
            # Filters wrap at borders; materials or tiles meet.
            if min(u, v, 1 - u, 1 - v, abs(u - 0.6), abs(u - 0.5)) < 1.5 / SIDE:
                continue
            if name == "upper" and abs(v - 0.5) < 5 / SIDE:  # voxels and filters mix both sides
                continue
            expected = FUNCTIONS[name](u, v)
            if name.endswith("light"):
                expected = [to_srgb(c) for c in expected]
            assert len(expected) == len(rows[y][x]), f"{path}: {len(rows[y][x])} channels"
            worst = max(worst, *(abs(c / most - e) for c, e in zip(rows[y][x], expected)))
    print(f"{path}: at most {worst:.6f} from {name}")
    sys.exit(not worst <= float(tolerance))


# ---- a sphere ----

TURNS, RINGS = 96, 48


def point(u, v):
    """The point of the unit sphere at texture coordinates."""
    a, b = 2 * math.pi * u, math.pi * v
    return math.sin(b) * math.cos(a), math.sin(b) * math.sin(a), -math.cos(b)


def values_at(p):
    """The image's values, a function of the position."""
    return tuple(0.5 + 0.4 * c for c in p)


def write_sphere(path, turns, rings, radius):
    with open(path, "w") as file:
        for j in range(rings + 1):
            for i in range(turns + 1):
                u, v = i / turns, j / rings
                file.write("v %.9f %.9f %.9f\nvt %.9f %.9f\n" % (
                    *(radius * c for c in point(u, v)), u, v))
        for j in range(rings):
            for i in range(turns):
                a = j * (turns + 1) + i + 1
                corners = [a, a + 1, a + turns + 2, a + turns + 1]
                file.write("f " + " ".join(f"{c}/{c}" for c in corners) + "\n")


def sphere():
    write_sphere("ball.obj", TURNS, RINGS, 1)
    write_sphere("ball_low.obj", 24, 12, 1)
    width, height = 256, 128
    png.write("ball.png", 16, [
        [tuple(round(65535 * c) for c in values_at(point((x + 0.5) / width, 1 - (y + 0.5) / height)))
         for x in range(width)] for y in range(height)])


def on_sphere(place, roughness, normal, tolerance):
    """The normal of a sphere is its position; roughness is the first value."""
    maps = [png.read(path) for path in (place, roughness, normal)]
    width, height, most, _ = maps[0]
    worst = 0
    for y in range(height // 8, height - height // 8):  # the image turns fast at the poles
        for x in range(2, width - 2):  # filters wrap
            values, grey, n = ([c / most for c in m[3][y][x]] for m in maps)
            expected = values_at([2 * c - 1 for c in n])
            worst = max(worst, abs(grey[0] - expected[0]),
                        *(abs(a - b) for a, b in zip(values, expected)))
    print(f"{place}: at most {worst:.6f} from the function")
    sys.exit(not worst <= float(tolerance))


# ---- glTF ----

def texture(index, scale=(1, 1), offset=(0, 0)):
    """v of offset and scale points downwards."""
    return {"index": index,
            "extensions": {"KHR_texture_transform": {"scale": scale, "offset": offset}}}


def materials():
    """Texture coordinates of both materials are those of a base colour that is moved."""
    base = {"baseColorTexture": texture(0, (2, 4), (0.25, 0.5))}
    occlusion = {"occlusionTexture": texture(1)}
    return [{"name": "left", **occlusion, "emissiveFactor": [1, 1, 1],
             "emissiveTexture": texture(2, (0.5, -0.5), (0.25, 0.75)),
             "pbrMetallicRoughness": {**base, "metallicRoughnessTexture": texture(1)}},
            {"name": "right", **occlusion, "emissiveFactor": [to_linear(c) for c in (0.2, 0.4, 0.6)],
             "pbrMetallicRoughness": {**base, "metallicFactor": 0.75, "roughnessFactor": 0.5}}]


def gltf(path):
    """Quads become two triangles; vertices and texture coordinates of the mesh have one index."""
    points, coords, faces, material = [], [], ([], []), 0
    for line in open(path):
        word, *rest = line.split()
        if word == "v":
            points.append([float(c) for c in rest])
        elif word == "vt":
            coords.append((float(rest[0]), 1 - float(rest[1])))
        elif word == "usemtl":
            material = ("left", "right").index(rest[0])
        elif word == "f":
            a, b, c, d = (int(corner.split("/")[0]) - 1 for corner in rest)
            faces[material].extend((a, b, c, a, c, d))
    parts = [struct.pack(f"<{3 * len(points)}f", *(c for p in points for c in p)),
             struct.pack(f"<{2 * len(coords)}f", *(c for p in coords for c in p)),
             *(struct.pack(f"<{len(f)}I", *f) for f in faces)]
    views, at = [], 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(part)})
        at += len(part)
    kinds = [(5126, "VEC3", len(points)), (5126, "VEC2", len(coords)),
             *((5125, "SCALAR", len(f)) for f in faces)]
    data = base64.b64encode(b"".join(parts)).decode()
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    json.dump({
        "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_texture_transform"],
        "buffers": [{"byteLength": at, "uri": "data:application/octet-stream;base64," + data}],
        "bufferViews": views,
        "accessors": [{"bufferView": i, "componentType": c, "type": t, "count": n}
                      for i, (c, t, n) in enumerate(kinds)],
        "images": [{"uri": name} for name in ("three.png", "orm.png", "light.png")],
        "textures": [{"source": i} for i in range(3)],
        "materials": materials(),
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 2 + i, "material": i}
                                   for i in range(2)]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0},
        open("two.gltf", "w"))


{"make": make, "glass": glass, "gltf": gltf, "check": check, "sphere": sphere, "on_sphere": on_sphere}[sys.argv[1]](*sys.argv[2:])

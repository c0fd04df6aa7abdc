"""gltf_materials.py - a row of squares with glTF materials, and the values that the glTF 2.0
specification gives them (sections 3.7.2.1, 3.8.4.1, 3.9.2 and 3.9.3).

    gltf_materials.py make         writes squares.gltf, low.obj and images
    gltf_materials.py check NAME TOLERANCE [MAP]...   compares NAME.<map>.png with them
"""
import base64
import json
import math
import struct
import sys

import png

SIDE, BLOCKS, MAP = 64, 4, 96  # texels of an image, its blocks along a side, texels of a square
WRAPS = {10497: lambda x: x % 1, 33071: lambda x: min(max(x, 0), 0.999999),
         33648: lambda x: min(abs(x - 2 * round(x / 2)), 0.999999)}
TILT = (200, 96, 220)
# Of each square: factor of the base colour, whether it has a texture and COLOR_0, wrap modes,
# the range of texture coordinates, roughness, metallic, strength of occlusion, scale of normals.
SQUARES = [
    ((0.5, 0.25, 1), True, False, (10497, 10497), (0, 1), 0.5, 0.25, 0.5, 1),
    ((1, 1, 1), True, True, (10497, 10497), (0, 1), None, None, None, 0.5),
    ((0.5, 0.25, 1), False, True, (10497, 10497), (0, 1), 0.125, 1, None, 0),
    ((1, 1, 1), True, False, (33071, 10497), (-1, 2), 1, None, 1, None),
    ((1, 1, 1), True, False, (33648, 33071), (-1, 2), None, 0.5, 0, 2),
    ((0.75, 1, 0.5), True, True, (33648, 33648), (-1.5, 1.5), 0.75, 0.75, 0.25, 0.25),
]
LEFT, RIGHT = (1, 0.5, 0.125), (0.25, 1, 0.75)  # COLOR_0 at both sides of a square


def color(i, j):
    return (40 + 50 * i, 230 - 40 * j, 60 + 30 * (i + j))


def pbr(i, j):
    return (250 - 30 * i - 20 * j, 80 + 40 * i, 200 - 45 * j)


def image(texel):
    side = SIDE // BLOCKS
    return [[texel(x // side, y // side) for x in range(SIDE)] for y in range(SIDE)]


def material(number):
    factor, textured, _, _, _, roughness, metallic, strength, scale = SQUARES[number]
    out = {"pbrMetallicRoughness": {"baseColorFactor": [*factor, 1],
                                    "metallicRoughnessTexture": {"index": 3 * number + 1}},
           "occlusionTexture": {"index": 3 * number + 1},
           "normalTexture": {"index": 3 * number + 2}}
    if textured:
        out["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 3 * number}
    for where, key, value in ((out["pbrMetallicRoughness"], "roughnessFactor", roughness),
                              (out["pbrMetallicRoughness"], "metallicFactor", metallic),
                              (out["occlusionTexture"], "strength", strength),
                              (out["normalTexture"], "scale", scale)):
        if value is not None:
            where[key] = value
    return out


def make():
    png.write("color.png", 8, image(color), gamma=1)  # which the specification ignores
    png.write("pbr.png", 8, image(pbr))
    png.write("tilt.png", 8, image(lambda i, j: TILT))
    accessors, data, primitives = [], b"", []
    for number, square in enumerate(SQUARES):
        low, high = square[4]
        corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
        arrays = [("POSITION", "VEC3", [(number + x, y, 0) for x, y in corners]),
                  ("TEXCOORD_0", "VEC2", [(low + x * (high - low), high - y * (high - low))
                                          for x, y in corners])]
        if square[2]:
            arrays.append(("COLOR_0", "VEC3", [RIGHT if x else LEFT for x, y in corners]))
        primitives.append({"attributes": {}, "material": number, "mode": 6})
        for name, kind, values in arrays:
            primitives[-1]["attributes"][name] = len(accessors)
            accessors.append({"bufferView": 0, "byteOffset": len(data), "componentType": 5126,
                              "count": 4, "type": kind})
            data += b"".join(struct.pack("<%df" % len(v), *v) for v in values)
    json.dump({
        "asset": {"version": "2.0"}, "accessors": accessors,
        "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," +
                     base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "images": [{"uri": name} for name in ("color.png", "pbr.png", "tilt.png")],
        "samplers": [{"wrapS": square[3][0], "wrapT": square[3][1]} for square in SQUARES],
        "textures": [{"source": i, "sampler": n} for n in range(len(SQUARES)) for i in range(3)],
        "materials": [material(n) for n in range(len(SQUARES))],
        "meshes": [{"primitives": primitives}], "nodes": [{"mesh": 0}]}, open("squares.gltf", "w"))
    with open("low.obj", "w") as file:
        for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
            file.write(f"v {x * len(SQUARES)} {y} 0\nvt {x} {y}\n")
        file.write("vn 0 0 1\nf 1/1/1 2/2/1 3/3/1 4/4/1\n")


def to_linear(byte):
    s = byte / 255
    return s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4


def to_srgb(v):
    return 12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055


def expected(number, x, y):
    """Returns the values of all maps at a place of a square; None near borders of blocks."""
    factor, textured, colored, wraps, (low, high), roughness, metallic, strength, scale = \
        SQUARES[number]
    at = (low + x * (high - low), high - y * (high - low))
    blocks = [WRAPS[wrap](c) * BLOCKS for wrap, c in zip(wraps, at)]
    if any(abs(b % 1 - 0.5) > 0.25 for b in blocks):
        return None
    i, j = int(blocks[0]), int(blocks[1])
    base = [to_linear(c) if textured else 1 for c in color(i, j)]
    vertex = [a + x * (b - a) if colored else 1 for a, b in zip(LEFT, RIGHT)]
    red, green, blue = (c / 255 for c in pbr(i, j))
    normal = [2 * c / 255 - 1 for c in TILT]
    s = 1 if scale is None else scale
    normal = [normal[0] * s, normal[1] * s, normal[2]]
    length = math.sqrt(sum(c * c for c in normal))
    return {"color": [to_srgb(a * b * c) for a, b, c in zip(base, vertex, factor)],
            "roughness": [green * (1 if roughness is None else roughness)],
            "metallic": [blue * (1 if metallic is None else metallic)],
            "occlusion": [1 + (1 if strength is None else strength) * (red - 1)],
            "normal": [(c / length + 1) / 2 for c in normal]}


def check(name, tolerance, *names):
    maps = {m: png.read(f"{name}.{m}.png") for m in names or expected(0, 0.125, 0.125)}
    checked, worst = 0, (0, "")
    for y in range(MAP):
        for x in range(MAP * len(SQUARES)):
            number, place = x // MAP, ((x % MAP + 0.5) / MAP, 1 - (y + 0.5) / MAP)
            values = expected(number, *place)
            for m in maps if values else ():
                _, _, most, rows = maps[m]
                for a, b in zip(values[m], rows[y][x]):
                    worst = max(worst, (abs(a - b / most), f"{m} of square {number} at {place}"))
            checked += values is not None
    if worst[0] > float(tolerance) or checked < MAP * MAP * len(SQUARES) / 6:
        sys.exit(f"{name}: {checked} texels, worst {worst}")


{"make": make, "check": check}[sys.argv[1]](*sys.argv[2:])

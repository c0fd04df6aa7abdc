"""glb.py - a scan of waves on two planes, a low-poly mesh of two squares, and checks of GLB files, from
the glTF 2.0 specification alone.

    glb.py make                        writes waves.obj and low.obj
    glb.py check FILE DEGREES          the file is sound; its normal texture gives the waves' normals
    glb.py same FILE TEXTURE IMAGE MOST   a texture is an image, up to MOST levels

The first square has a mirrored chart and normals that are not those of its face, the second one a
turned chart. Between them is a hard edge."""
import json
import math
import struct
import sys

import png

CHARTS = [lambda x, y: (0.45 - 0.4 * x, 0.05 + 0.4 * y),
          lambda x, z: (0.55 + 0.4 * (z + 1), 0.45 - 0.4 * x)]


def wave(x, y):
    """Returns the height, and its derivatives."""
    a, b = 4 * math.pi * x, 4 * math.pi * y
    return (0.01 * math.sin(a) * math.cos(b), 0.04 * math.pi * math.cos(a) * math.cos(b),
            -0.04 * math.pi * math.sin(a) * math.sin(b))


def unit(v):
    length = math.sqrt(sum(c * c for c in v))
    return [c / length for c in v]


def surface(plane, a, b):
    """Returns position and normal of the scan."""
    h, da, db = wave(a, b)
    return ((a, b, h), unit((-da, -db, 1))) if plane == 0 else ((a, -h, b), unit((-da, -1, -db)))


def make():
    side = 200
    with open("waves.obj", "w") as file:
        for plane in range(2):
            for j in range(side + 1):
                for i in range(side + 1):
                    p, n = surface(plane, i / side, j / side - plane)
                    file.write("v %.9g %.9g %.9g %g 0.5 0.25\nvn %.9g %.9g %.9g\n" % (*p, i / side, *n))
            for j in range(side):
                for i in range(side):
                    a = plane * (side + 1)**2 + j * (side + 1) + i + 1
                    file.write("f " + " ".join(f"{c}//{c}" for c in (a, a + 1, a + side + 2, a + side + 1)) + "\n")
    with open("low.obj", "w") as file:
        for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
            file.write("v %g %g 0\nvt %g %g\nvn %g %g 1\n" % (x, y, *CHARTS[0](x, y), .4 * x - .2, .4 * y - .2))
        for x, z in ((0, -1), (1, -1), (1, 0), (0, 0)):
            file.write("v %g 0 %g\nvt %g %g\nvn 0 -1 0\n" % (x, z, *CHARTS[1](x, z)))
        file.write("f 1/1/1 2/2/2 3/3/3\nf 1/1/1 3/3/3 4/4/4\nf 5/5/5 6/6/6 7/7/7\nf 5/5/5 7/7/7 8/8/8\n")


def read(path):
    """Returns the JSON, and the bytes of its binary chunk. Checks the frame of the file."""
    data = open(path, "rb").read()
    magic, version, size = struct.unpack_from("<4sII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data)) and size % 4 == 0
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and length % 4 == 0
    binary, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0" and 28 + length + binary == size
    return json.loads(data[20:20 + length]), data[28 + length:]


def image(document, binary, texture, path="image.png"):
    """Returns what png.read() does."""
    view = document["bufferViews"][document["images"][document["textures"][texture]["source"]]["bufferView"]]
    with open(path, "wb") as file:
        file.write(binary[view["byteOffset"]:view["byteOffset"] + view["byteLength"]])
    return png.read(path)


def elements(document, binary, number):
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    count, letter = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]], {5126: "f", 5125: "I"}[accessor["componentType"]]
    stride, first = view.get("byteStride", 4 * count), accessor.get("byteOffset", 0)
    assert first + (accessor["count"] - 1) * stride + 4 * count <= view["byteLength"]
    return [struct.unpack_from(f"<{count}{letter}", binary, view["byteOffset"] + first + i * stride)
            for i in range(accessor["count"])]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def mix(weights, rows):
    return [sum(w * row[k] for w, row in zip(weights, rows)) for k in range(len(rows[0]))]


def places(corners, width, height):
    """Gives the texels inside of a triangle, with barycentric weights."""
    (ax, ay), (bx, by), (cx, cy) = corners
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    for y in range(height):
        for x in range(width):
            u, v = (x + 0.5) / width, (y + 0.5) / height
            w1 = ((u - ax) * (cy - ay) - (cx - ax) * (v - ay)) / area
            w2 = ((bx - ax) * (v - ay) - (u - ax) * (by - ay)) / area
            if min(w1, w2, 1 - w1 - w2) > 0.01:
                yield x, y, (1 - w1 - w2, w1, w2)


def check(path, degrees):
    document, binary = read(path)
    primitive, = document["meshes"][0]["primitives"]
    material = document["materials"][primitive["material"]]
    at = {name: elements(document, binary, number) for name, number in primitive["attributes"].items()}
    indices = [i for i, in elements(document, binary, primitive["indices"])]
    assert len(indices) == 12 and len(at["POSITION"]) == len(set(zip(*at.values()))) == 8
    bounds = document["accessors"][primitive["attributes"]["POSITION"]]
    assert bounds["min"] == [min(c) for c in zip(*at["POSITION"])]
    assert bounds["max"] == [max(c) for c in zip(*at["POSITION"])]
    assert all(abs(sum(c * c for c in v[:3]) - 1) < 1e-5 for v in at["NORMAL"] + at["TANGENT"])
    assert {v[3] for v in at["TANGENT"]} == {-1, 1}  # one of the charts is mirrored
    width, height, most, rows = image(document, binary, material["normalTexture"]["index"])
    shift = document["nodes"][0]["translation"]
    errors = []
    for t in range(0, 12, 3):
        corner = [{name: values[i] for name, values in at.items()} for i in indices[t:t + 3]]
        for x, y, weights in places([c["TEXCOORD_0"] for c in corner], width, height):
            p = [a + b for a, b in zip(mix(weights, [c["POSITION"] for c in corner]), shift)]
            n = mix(weights, [c["NORMAL"] for c in corner])
            *tangent, w = mix(weights, [c["TANGENT"] for c in corner])
            bitangent = [w * c for c in cross(n, tangent)]
            texel = [2 * c / most - 1 for c in rows[y][x]]
            found = unit(mix(texel, [tangent, bitangent, n]))
            plane = 0 if abs(p[2]) < 1e-6 and p[1] > 1e-6 else 1
            _, expected = surface(plane, p[0], p[1] if plane == 0 else p[2])
            errors.append(math.degrees(math.acos(min(1, sum(a * b for a, b in zip(found, expected))))))
    errors.sort()
    if len(errors) < width * height / 8 or sum(errors) / len(errors) > float(degrees):
        sys.exit(f"{path}: {len(errors)} texels, mean {sum(errors) / len(errors)}, worst {errors[-1]}")


def same(path, texture, other, most):
    document, binary = read(path)
    material = document["materials"][0]
    pbr = material["pbrMetallicRoughness"]
    number = {"color": pbr.get("baseColorTexture"), "normal": material.get("normalTexture"),
              "occlusion": material.get("occlusionTexture"), "roughness": pbr.get("metallicRoughnessTexture"),
              "metallic": pbr.get("metallicRoughnessTexture")}[texture]["index"]
    k = {"occlusion": 0, "roughness": 1, "metallic": 2}.get(texture)
    width, height, _, a = image(document, binary, number)
    w, h, _, b = png.read(other)
    assert (w, h) == (width, height)
    worst = max(abs(s - t) for i, j in zip(a, b) for p, q in zip(i, j)
                for s, t in zip(p if k is None else p[k:k + 1], q))
    if worst > int(most):
        sys.exit(f"{path}: {texture} differs by {worst} levels")


if __name__ == "__main__":
    {"make": make, "check": check, "same": same}[sys.argv[1]](*sys.argv[2:])

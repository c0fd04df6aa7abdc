"""Writes squares in a row whose colours need more than 8 bits, or looks at a map of them.

usage: fine_colors.py write CASE FILE     a mesh; CASE is a key of CASES
       fine_colors.py expect CASE MAP.png the texel in the middle of each square: 16 bits, 8 where
                                          the case has no more
"""
import json
import struct
import sys

import png

# Of 65535, sRGB-encoded. The last one is of 8 bits.
USHORTS = [(1000, 12345, 40000), (0, 65535, 65534), (1, 128, 129), (32639, 32640, 32896), (257, 257 * 77, 257 * 200)]
BYTES = [(1, 128, 254), (0, 255, 99), (17, 18, 19), (3, 200, 77), (254, 253, 16)]


def encode(v):
    """sRGB of linear light, IEC 61966-2-1."""
    return 12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055


def of(values, most, scale=1):
    return [tuple(x / most * scale for x in c) for c in values]


# What a map of 16 bits holds, as shares of white.
UNITS = of(USHORTS, 65535)
CASES = {
    "ushort": UNITS, "ascii_ushort": UNITS, "float": UNITS, "double": UNITS, "float_255": UNITS,
    "obj": [tuple(round(255 * x) / 255 for x in c) for c in UNITS], "bytes": of(BYTES, 255), "ushort_bytes": of(BYTES, 255), "float_bytes": of(BYTES, 255),
    "gltf_ushort": [tuple(map(encode, c)) for c in UNITS],
    "gltf_bytes": [tuple(round(255 * encode(x)) / 255 for x in c) for c in of(BYTES, 255)],
    "gltf_factor": [tuple(encode(x * f) for x, f in zip(c, (0.5, 1, 0.3))) for c in of(BYTES, 255)],
}


def squares(count):
    positions = [(i + dx, dy, 0) for i in range(count) for dx, dy in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return positions, [(4 * i + a, 4 * i + b, 4 * i + c) for i in range(count) for a, b, c in ((0, 1, 2), (0, 2, 3))]


def write_ply(path, kind, values):
    """The bytes of a text are those of its numbers: 9 digits."""
    positions, faces = squares(len(values))
    colors = [c for c in values for _ in range(4)]
    text = kind.startswith("ascii_")
    kind = kind.replace("ascii_", "")
    code = {"uchar": "B", "ushort": "H", "float": "f", "double": "d"}[kind]
    header = ["ply", "format %s 1.0" % ("ascii" if text else "binary_little_endian"),
              f"element vertex {len(positions)}", *(f"property float {a}" for a in "xyz"),
              *(f"property {kind} {a}" for a in ("red", "green", "blue")),
              f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    with open(path, "wb") as out:
        out.write(("\n".join(header) + "\n").encode())
        for p, c in zip(positions, colors):
            out.write(b"%g %g %g %.9g %.9g %.9g\n" % (*p, *c) if text else struct.pack(f"<3f3{code}", *p, *c))
        for f in faces:
            out.write(b"3 %d %d %d\n" % f if text else struct.pack("<B3i", 3, *f))


def write_obj(path, values):
    positions, faces = squares(len(values))
    with open(path, "w") as out:
        for i, p in enumerate(positions):
            out.write("v %g %g %g " % p + "%.9g %.9g %.9g" % values[i // 4] + "\n")
        out.writelines("f %d %d %d\n" % tuple(i + 1 for i in f) for f in faces)


def write_gltf(path, code, values, factor=(1, 1, 1)):
    """Colours have alpha, which fills each vertex to a multiple of 4 bytes."""
    positions, faces = squares(len(values))
    parts = [b"".join(struct.pack("<3f", *p) for p in positions),
             b"".join(struct.pack("<4" + code, *values[i // 4], 0) for i in range(len(positions))),
             b"".join(struct.pack("<3I", *f) for f in faces)]
    views, at = [], 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(part)})
        at += len(part)
    count = len(positions)
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [*factor, 1]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3",
             "min": [0, 0, 0], "max": [len(values), 1, 0]},
            {"bufferView": 1, "componentType": {"B": 5121, "H": 5123}[code], "count": count, "type": "VEC4",
             "normalized": True},
            {"bufferView": 2, "componentType": 5125, "count": 3 * len(faces), "type": "SCALAR"}],
        "bufferViews": views, "buffers": [{"byteLength": at}]}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(parts)
    with open(path, "wb") as out:
        out.write(struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(body), len(text), 0x4E4F534A) + text)
        out.write(struct.pack("<II", len(body), 0x004E4942) + body)


def write(case, path):
    if case in ("ushort", "ascii_ushort"):
        write_ply(path, case, USHORTS)
    elif case in ("float", "double"):
        write_ply(path, case, UNITS)
    elif case == "float_255":
        write_ply(path, "float", of(USHORTS, 257))
    elif case == "bytes":
        write_ply(path, "uchar", BYTES)
    elif case == "ushort_bytes":
        write_ply(path, "ushort", [tuple(257 * x for x in c) for c in BYTES])
    elif case == "float_bytes":
        write_ply(path, "float", of(BYTES, 255))
    elif case == "obj":
        write_obj(path, UNITS)
    else:
        write_gltf(path, "H" if case == "gltf_ushort" else "B", USHORTS if case == "gltf_ushort" else BYTES,
                   (0.5, 1, 0.3) if case == "gltf_factor" else (1, 1, 1))


def expect(case, path):
    width, height, most, rows = png.read(path)
    values = CASES[case]
    # Chunk files round to 1/1024 of a step of 8 bits, which is exact for 16 bits.
    limit = 0.5 + 257 / 2048 if case.startswith("gltf") else 0.5
    assert most == 65535, most
    for i, color in enumerate(values):
        texel = rows[height // 2][(2 * i + 1) * width // (2 * len(values))]
        off = [abs(t - 65535 * c) for t, c in zip(texel, color)]
        assert max(off) <= limit + 0.01, (case, i, texel, [65535 * c for c in color])


{"write": write, "expect": expect}[sys.argv[1]](*sys.argv[2:])

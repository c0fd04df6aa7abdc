#!/usr/bin/env python3
"""write_glb.py IN.obj OUT.glb [--no-normals]: writes an OBJ file of triangles as GLB.

If the file has texture coordinates, each vertex is written once for each combination of position,
texture coordinate and normal. Otherwise normals must have the numbers of their vertices.
"""
import json
import struct
import sys
from array import array


def read(source):
    """Returns positions, normals and texture coordinates, and the indices of each corner."""
    values = {"v": [], "vn": [], "vt": []}
    corners = []
    with open(source) as file:
        for line in file:
            words = line.split()
            if words and words[0] in values:
                values[words[0]].append([float(word) for word in words[1:4]])
            elif words[:1] == ["f"]:
                face = [tuple(int(i or 0) - 1 for i in word.split("/")) for word in words[1:]]
                for i in range(1, len(face) - 1):
                    corners += [face[0], face[i], face[i + 1]]
    return values["v"], values["vn"], values["vt"], corners


def split(positions, normals, texcoords, corners):
    """Returns arrays in which all attributes of a corner have one index, and these indices."""
    numbers = {}
    indices = array("I", (numbers.setdefault(corner, len(numbers)) for corner in corners))
    return ([positions[c[0]] for c in numbers], [normals[c[2]] for c in numbers if len(c) > 2],
            [(texcoords[c[1]][0], 1 - texcoords[c[1]][1]) for c in numbers], indices)


def main(source, target, option=None):
    positions, normals, texcoords, corners = read(source)
    if texcoords:
        positions, normals, texcoords, indices = split(positions, normals, texcoords, corners)
    else:
        indices = array("I", (corner[0] for corner in corners))
    arrays = {"POSITION": positions, "NORMAL": [] if option else normals, "TEXCOORD_0": texcoords}
    views, accessors, attributes, data = [], [], {}, b""

    def add(values, kind, component, count):
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": 4 * len(values)})
        accessors.append({"bufferView": len(accessors), "type": kind, "componentType": component,
                          "count": count})
        data += values.tobytes()

    add(indices, "SCALAR", 5125, len(indices))
    for name, values in arrays.items():
        if values:
            attributes[name] = len(accessors)
            add(array("f", (number for value in values for number in value)),
                "VEC%d" % len(values[0]), 5126, len(values))
    text = json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
                       "nodes": [{"mesh": 0}], "bufferViews": views, "accessors": accessors,
                       "meshes": [{"primitives": [{"attributes": attributes, "indices": 0}]}],
                       "buffers": [{"byteLength": len(data)}]}).encode()
    text += b" " * (-len(text) % 4)
    with open(target, "wb") as file:
        file.write(struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(data), len(text),
                               b"JSON"))
        file.write(text + struct.pack("<I4s", len(data), b"BIN\0") + data)


if __name__ == "__main__":
    main(*sys.argv[1:])

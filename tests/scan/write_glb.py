#!/usr/bin/env python3
"""write_glb.py IN.obj OUT.glb: writes the positions, normals and triangles of an OBJ file as GLB.

Normals must have the numbers of their vertices.
"""
import json
import struct
import sys
from array import array


def read(source):
    """Returns the components of an OBJ file's positions and normals, and the corners' vertices."""
    positions, normals, corners = array("f"), array("f"), array("I")
    with open(source) as file:
        for line in file:
            words = line.split()
            if words[:1] == ["v"]:
                positions.extend(map(float, words[1:4]))
            elif words[:1] == ["vn"]:
                normals.extend(map(float, words[1:4]))
            elif words[:1] == ["f"]:
                corners.extend(int(word.split("/")[0]) - 1 for word in words[1:])
    return positions, normals, corners


def main(source, target):
    positions, normals, corners = read(source)
    views, accessors, data = [], [], b""
    for values in [positions, corners] + ([normals] if normals else []):
        vectors = values is not corners
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": 4 * len(values)})
        accessors.append({"bufferView": len(accessors), "type": "VEC3" if vectors else "SCALAR",
                          "componentType": 5126 if vectors else 5125,
                          "count": len(values) // (3 if vectors else 1)})
        data += values.tobytes()
    attributes = {"POSITION": 0, "NORMAL": 2} if normals else {"POSITION": 0}
    text = json.dumps({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
                       "nodes": [{"mesh": 0}], "bufferViews": views, "accessors": accessors,
                       "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
                       "buffers": [{"byteLength": len(data)}]}).encode()
    text += b" " * (-len(text) % 4)
    with open(target, "wb") as file:
        file.write(struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(data), len(text),
                               b"JSON"))
        file.write(text + struct.pack("<I4s", len(data), b"BIN\0") + data)


if __name__ == "__main__":
    main(*sys.argv[1:])

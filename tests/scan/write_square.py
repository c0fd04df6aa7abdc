#!/usr/bin/env python3
"""write_square.py: writes a textured square as beside.gltf, inside.gltf and image.glb.

The texture is image.ppm of the current directory.
"""
import base64
import json
import struct
from array import array


def document(image, buffer, views):
    return {
        "asset": {"version": "2.0"},
        "buffers": [buffer],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48},
                        {"buffer": 0, "byteOffset": 48, "byteLength": 32},
                        {"buffer": 0, "byteOffset": 80, "byteLength": 6}] + views,
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
                      {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
                      {"bufferView": 2, "componentType": 5121, "count": 6, "type": "SCALAR"}],
        "images": [image], "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2,
                                    "material": 0}]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}


def data_uri(data):
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


points = array("f", (0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0))
coordinates = array("f", (0, 1, 1, 1, 1, 0, 0, 0))
data = points.tobytes() + coordinates.tobytes() + bytes([0, 1, 2, 0, 2, 3])
with open("image.ppm", "rb") as file:
    image = file.read()

with open("square.bin", "wb") as file:
    file.write(data)
with open("beside.gltf", "w") as file:
    json.dump(document({"uri": "image.ppm"}, {"uri": "square.bin", "byteLength": 86}, []), file)
with open("inside.gltf", "w") as file:
    buffer = {"uri": data_uri(data), "byteLength": 86}
    json.dump(document({"uri": data_uri(image)}, buffer, []), file, indent=1)

view = {"buffer": 0, "byteOffset": 88, "byteLength": len(image)}
chunk = data + b"\0\0" + image
chunk += b"\0" * (-len(chunk) % 4)
text = json.dumps(document({"bufferView": 3, "mimeType": "image/x-portable-pixmap"},
                           {"byteLength": len(chunk)}, [view])).encode()
text += b" " * (-len(text) % 4)
with open("image.glb", "wb") as file:
    file.write(struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(chunk), len(text), b"JSON"))
    file.write(text + struct.pack("<I4s", len(chunk), b"BIN\0") + chunk)

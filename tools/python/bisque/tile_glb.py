"""GLB files of tiles, made of the vertices and images of a baked one."""
from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from .glb import Glb

HEADER, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
#: Position, normal, tangent and texture coordinates of a vertex of bisque-bake.
COLUMNS = 12
FLOAT, UINT32 = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def rows_of(baked: Glb, primitive: dict) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices of a primitive of bisque-bake, rows of COLUMNS, and its triangles."""
    views = [baked.head["accessors"][number]["bufferView"]
             for number in (primitive["attributes"]["POSITION"], primitive["indices"])]
    return (np.frombuffer(baked.view(views[0]), "<f4").reshape(-1, COLUMNS),
            np.frombuffer(baked.view(views[1]), "<u4").reshape(-1, 3))


def write(path: Path, generator: str, rows: np.ndarray, faces: np.ndarray, material: dict, images: list[memoryview],
          sampler: dict | None) -> None:
    """Writes a mesh with one material, whose textures have the numbers of the images (PNG). rows: as rows_of()
    returns them. Raises OSError."""
    blobs = [np.ascontiguousarray(rows, "<f4").tobytes(), np.ascontiguousarray(faces, "<u4").tobytes(), *images]
    views, at = [], 0
    for blob in blobs:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(blob)})
        at += len(blob) + -len(blob) % 4
    views[0].update(byteStride=4 * COLUMNS, target=ARRAY_BUFFER)
    views[1].update(target=ELEMENT_ARRAY_BUFFER)
    layout = (("POSITION", "VEC3", 0), ("NORMAL", "VEC3", 12), ("TANGENT", "VEC4", 24), ("TEXCOORD_0", "VEC2", 40))
    accessors = [{"bufferView": 0, "byteOffset": offset, "componentType": FLOAT, "count": len(rows), "type": kind}
                 for _, kind, offset in layout]
    accessors[0].update(min=rows[:, :3].min(axis=0).tolist(), max=rows[:, :3].max(axis=0).tolist())
    accessors.append({"bufferView": 1, "componentType": UINT32, "count": faces.size, "type": "SCALAR"})
    primitive = {"attributes": {name: i for i, (name, _, _) in enumerate(layout)}, "indices": len(layout),
                 "mode": 4, "material": 0}
    root = {"asset": {"version": "2.0", "generator": generator}, "scene": 0,
            "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}],
            "buffers": [{"byteLength": at}], "bufferViews": views, "accessors": accessors, "materials": [material]}
    if images:
        root.update(samplers=[sampler], textures=[{"source": i, "sampler": 0} for i in range(len(images))],
                    images=[{"bufferView": 2 + i, "mimeType": "image/png"} for i in range(len(images))])
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(HEADER.pack(b"glTF", 2, HEADER.size + 2 * CHUNK.size + len(text) + at))
        file.write(CHUNK.pack(len(text), b"JSON") + text + CHUNK.pack(at, b"BIN\0"))
        for blob in blobs:
            file.write(blob)
            file.write(b"\0" * (-len(blob) % 4))

"""GLB files: reads and writes those of Bisque, and packs images and geometry.

Geometry is packed by meshoptimizer (EXT_meshopt_compression over KHR_mesh_quantization) or by Draco
(KHR_draco_mesh_compression), images become JPEG files. What that loses is measured on the packed file."""
from __future__ import annotations

import copy
import json
import mmap
import os
import struct
from importlib import metadata
from pathlib import Path
from typing import Any, Sequence

import numpy as np

from . import core
from .lib._core import ffi, lib
from .mesh import Error, Mesh

#: By glTF's componentType, and the components of its types.
TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
MESHOPT, DRACO, QUANTIZED = "EXT_meshopt_compression", "KHR_draco_mesh_compression", "KHR_mesh_quantization"
#: Bits of packed positions, directions and texture coordinates.
POSITION_BITS, DIRECTION_BITS, TEXCOORD_BITS = 16, 12, 16
#: Qualities of JPEG files.
QUALITY, NORMAL_QUALITY = 90, 95
GEOMETRIES, IMAGES = ("none", "meshopt", "draco"), ("png", "jpeg", "all-jpeg")


def check_options(images: Any, geometry: Any) -> None:
    """Refuses values that make no sense, by ValueError, and Draco where it is not installed, by Error."""
    for name, value, words in (("images", images, IMAGES), ("geometry", geometry, GEOMETRIES)):
        if value not in words:
            raise ValueError(f"{name}: {value!r} is none of {', '.join(words)}")
    if geometry == "draco":
        _draco()


#: Those of the header and of a chunk.
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942


class Glb:
    """A GLB file whose buffer is in it. It is mapped, and not to change. Raises Error for other files."""

    def __init__(self, path: str | os.PathLike):
        with open(path, "rb") as file:
            begin = file.read(20)
            magic, _, _, length, kind = struct.unpack("<5I", begin) if len(begin) == 20 else (0,) * 5
            if magic != _MAGIC or kind != _JSON:
                raise Error(65, f"{path}: not a GLB file")
            data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        self.head, self.data = json.loads(bytes(data[20:20 + length])), data[28 + length:]

    def view(self, number: int) -> Any:
        """Returns the bytes of a buffer view, unpacked."""
        where = self.head["bufferViews"][number]
        packed = where.get("extensions", {}).get(MESHOPT, where)
        found = self.data[packed.get("byteOffset", 0):][:packed["byteLength"]]
        return found if packed is where else _unpack(found, packed)

    def accessor(self, number: int) -> np.ndarray:
        """Returns the rows of an accessor, those of floats and normalized integers as float64."""
        a = self.head["accessors"][number]
        kind, width = np.dtype(TYPES[a["componentType"]]), WIDTHS[a["type"]]
        stride = self.head["bufferViews"][a["bufferView"]].get("byteStride", kind.itemsize * width)
        rows = np.ndarray((a["count"], width), kind, self.view(a["bufferView"]), a.get("byteOffset", 0),
                          (stride, kind.itemsize))
        if a.get("normalized"):
            return np.maximum(rows.astype(np.float64) / np.iinfo(kind).max, -1)
        return rows.astype(np.float64 if kind.kind == "f" else np.int64)

    def primitive(self, primitive: dict) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Returns the attributes of the vertices of a primitive, and its triangles."""
        if DRACO in primitive.get("extensions", {}):
            return _undraco(self, primitive["extensions"][DRACO])
        attributes = {name: self.accessor(number) for name, number in primitive["attributes"].items()}
        return attributes, self.accessor(primitive["indices"]).reshape(-1, 3)

    def image(self, texture: dict) -> Any:
        """Returns the bytes of the image of a texture of a material."""
        return self.view(self.head["images"][self.image_number(texture)]["bufferView"])

    def image_number(self, texture: dict) -> int:
        return self.head["textures"][texture["index"]]["source"]


def write_glb(path: Path, head: dict, parts: Sequence[Any], length: int) -> None:
    """Writes a GLB file. parts: those of its buffer, of `length` bytes in all, a multiple of 4. Raises OSError."""
    text = json.dumps(head, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<5I", _MAGIC, 2, 28 + len(text) + length, len(text), _JSON) + text)
        file.write(struct.pack("<2I", length, _BINARY))
        file.writelines(parts)


# ---- geometry ----

def _unpack(data: Any, packed: dict) -> Any:
    """Decodes a buffer view of EXT_meshopt_compression."""
    count, stride = packed["count"], packed["byteStride"]
    found = np.empty(count * stride, np.uint8)
    decode = lib.meshopt_decodeVertexBuffer if packed["mode"] == "ATTRIBUTES" else lib.meshopt_decodeIndexBuffer
    if decode(ffi.from_buffer(found), count, stride, ffi.from_buffer(data), len(data)) != 0:
        raise Error(65, "damaged geometry of a GLB file")
    if packed.get("filter") == "OCTAHEDRAL":
        lib.meshopt_decodeFilterOct(ffi.from_buffer(found), count, stride)
    return found.data


def _encode(bound: int, encode: Any, *arguments: Any) -> bytes:
    buffer = np.empty(bound, np.uint8)
    return buffer[:encode(ffi.from_buffer("unsigned char[]", buffer), bound, *arguments)].tobytes()


def _draco() -> Any:
    try:
        import DracoPy
    except ImportError:
        raise Error(69, "DracoPy is not installed: pip install DracoPy") from None
    return DracoPy


def _undraco(glb: Glb, packed: dict) -> tuple[dict[str, np.ndarray], np.ndarray]:
    mesh = _draco().decode(bytes(glb.view(packed["bufferView"])))
    by_id = {a["unique_id"]: np.asarray(a["data"], np.float64) for a in mesh.attributes}
    return {name: by_id[number] for name, number in packed["attributes"].items()}, np.asarray(mesh.faces, np.int64)


def _oct(values: np.ndarray) -> np.ndarray:
    """Returns directions, with a fourth number that is kept, as meshoptimizer's filter has them."""
    values = np.ascontiguousarray(values, np.float32)
    found = np.empty((len(values), 4), np.int16)
    lib.meshopt_encodeFilterOct(ffi.from_buffer(found), len(values), 8, DIRECTION_BITS,
                                ffi.from_buffer("float[]", values))
    return found


class Writer:
    """Collects the parts of a GLB file."""

    def __init__(self, head: dict):
        self.head, self.parts, self.length, self.unpacked = head, [], 0, 0
        head.update(bufferViews=[], accessors=[], buffers=[{}])

    def add(self, data: bytes, **view: Any) -> int:
        """Adds a buffer view."""
        self.head["bufferViews"].append({"buffer": 0, "byteOffset": self.length, "byteLength": len(data), **view})
        self.parts += [data, bytes(-len(data) % 4)]
        self.length += len(data) + -len(data) % 4
        return len(self.head["bufferViews"]) - 1

    def add_packed(self, data: bytes, count: int, stride: int, mode: str, **more: Any) -> int:
        """Adds a buffer view of EXT_meshopt_compression; its place in the buffer without bytes is what it
        has when it is unpacked."""
        packed = {"buffer": 0, "byteOffset": self.length, "byteLength": len(data), "byteStride": stride,
                  "count": count, "mode": mode, **more}
        number = self.add(data, extensions={MESHOPT: packed})
        self.head["bufferViews"][number].update(buffer=1, byteOffset=self.unpacked, byteLength=count * stride)
        if mode == "ATTRIBUTES":
            self.head["bufferViews"][number].update(byteStride=stride, target=34962)
        self.unpacked += count * stride + -count * stride % 4
        return number

    def add_accessor(self, view: int | None, kind: int, count: int, width: int, **more: Any) -> int:
        name = next(name for name, components in WIDTHS.items() if components == width)
        where = {} if view is None else {"bufferView": view}
        self.head["accessors"].append({**where, "componentType": kind, "count": count, "type": name, **more})
        return len(self.head["accessors"]) - 1

    def use(self, extension: str) -> None:
        for key in ("extensionsUsed", "extensionsRequired"):
            self.head[key] = sorted({*self.head.get(key, []), extension})

    def write(self, path: Path) -> None:
        self.head["buffers"] = [{"byteLength": self.length}]
        if self.unpacked:
            self.head["buffers"].append({"byteLength": self.unpacked, "extensions": {MESHOPT: {"fallback": True}}})
        write_glb(path, self.head, self.parts, self.length)


def write_plain(out: Writer, attributes: dict[str, np.ndarray], faces: np.ndarray) -> dict:
    """Adds a primitive as bake() writes it: rows of floats, and indices. Returns what describes it."""
    rows = np.ascontiguousarray(np.concatenate(list(attributes.values()), axis=1), "<f4")
    view, at, found = out.add(rows.tobytes(), byteStride=rows.shape[1] * 4, target=34962), 0, {}
    for name, values in attributes.items():
        more = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if name == "POSITION" else {}
        found[name] = out.add_accessor(view, 5126, len(values), values.shape[1], byteOffset=4 * at, **more)
        at += values.shape[1]
    indices = out.add(np.ascontiguousarray(faces, "<u4").tobytes(), target=34963)
    return {"attributes": found, "indices": out.add_accessor(indices, 5125, faces.size, 1)}


def _write_meshopt(out: Writer, attributes: dict[str, np.ndarray], faces: np.ndarray, low: np.ndarray,
                   step: float) -> dict:
    """Quantizes and packs a primitive. low, step: what positions are relative to, and the length of 1."""
    faces = np.ascontiguousarray(faces, np.uint32)
    order, remap = np.empty_like(faces), np.empty(len(attributes["POSITION"]), np.uint32)
    count = len(remap)
    lib.meshopt_optimizeVertexCache(ffi.from_buffer("unsigned[]", order), ffi.from_buffer("unsigned[]", faces),
                                    faces.size, count)
    lib.meshopt_optimizeVertexFetchRemap(ffi.from_buffer("unsigned[]", remap), ffi.from_buffer("unsigned[]", order),
                                         faces.size, count)
    faces, found = remap[order], {}
    for name, values in attributes.items():
        values, moved = np.concatenate([values, np.zeros((count, -values.shape[1] % 4))], axis=1), np.empty(count, int)
        moved[remap] = np.arange(count)
        values, width, more, packing = values[moved], values.shape[1], {}, {}
        if name == "POSITION":
            values[:, :3] = (values[:, :3] - low) / step
            values, kind, width = np.round(values).astype("<u2"), 5123, 3
            more = {"min": values[:, :3].min(axis=0).tolist(), "max": values[:, :3].max(axis=0).tolist()}
        elif name in ("NORMAL", "TANGENT"):
            values, kind, width = _oct(values), 5122, 3 if name == "NORMAL" else 4
            more, packing = {"normalized": True}, {"filter": "OCTAHEDRAL"}
        elif name == "TEXCOORD_0" and values.min() >= 0 and values.max() <= 1:
            values, kind, width = np.round(values[:, :2] * 65535).astype("<u2"), 5123, 2
            more = {"normalized": True}
        else:
            values, kind, width = values.astype("<f4"), 5126, attributes[name].shape[1]
        stride = values.strides[0]
        values = np.ascontiguousarray(values)
        data = _encode(lib.meshopt_encodeVertexBufferBound(count, stride), lib.meshopt_encodeVertexBuffer,
                       ffi.from_buffer(values), count, stride)
        view = out.add_packed(data, count, stride, "ATTRIBUTES", **packing)
        found[name] = out.add_accessor(view, kind, count, width, **more)
    faces = np.ascontiguousarray(faces, np.uint32)
    data = _encode(lib.meshopt_encodeIndexBufferBound(faces.size, count), lib.meshopt_encodeIndexBuffer,
                   ffi.from_buffer("unsigned[]", faces), faces.size)
    view = out.add_packed(data, faces.size, 4, "TRIANGLES")
    return {"attributes": found, "indices": out.add_accessor(view, 5125, faces.size, 1)}


def _write_draco(out: Writer, attributes: dict[str, np.ndarray], faces: np.ndarray) -> dict:
    others = {name: values for name, values in attributes.items() if name not in ("POSITION", "NORMAL", "TEXCOORD_0")}
    data = _draco().encode(
        attributes["POSITION"].astype(np.float32), faces.astype(np.uint32), quantization_bits=POSITION_BITS,
        compression_level=7, normals=attributes["NORMAL"].astype(np.float64), normal_quantization_bits=DIRECTION_BITS,
        tex_coord=attributes["TEXCOORD_0"].astype(np.float64), tex_coord_quantization_bits=TEXCOORD_BITS,
        generic_attributes={i: values.astype(np.float32) for i, values in enumerate(others.values())})
    mesh = _draco().decode(data)
    kinds = {0: "POSITION", 1: "NORMAL", 3: "TEXCOORD_0"}  # of Draco's attributes
    ids = {kinds.get(int(a["attribute_type"])): a["unique_id"] for a in mesh.attributes}
    ids.update({name: i for i, name in enumerate(others)})
    points = np.asarray(mesh.points, np.float32)
    found = {}
    for name, values in attributes.items():
        more = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()} if name == "POSITION" else {}
        found[name] = out.add_accessor(None, 5126, len(points), values.shape[1], **more)
    packed = {"bufferView": out.add(data), "attributes": {name: ids[name] for name in attributes}}
    return {"attributes": found, "indices": out.add_accessor(None, 5125, np.size(mesh.faces), 1),
            "extensions": {DRACO: packed}}


def _pack_geometry(glb: Glb, out: Writer, geometry: str) -> None:
    """Packs all primitives. Quantized positions share one cube, so that borders between primitives fit."""
    if geometry != "none":
        out.use(DRACO if geometry == "draco" else MESHOPT)
    meshes = [[glb.primitive(p) for p in mesh["primitives"]] for mesh in glb.head["meshes"]]
    if geometry == "meshopt":
        out.use(QUANTIZED)
        points = np.concatenate([attributes["POSITION"] for mesh in meshes for attributes, _ in mesh])
        low = points.min(axis=0)
        step = float((points.max(axis=0) - low).max()) / (2 ** POSITION_BITS - 1) or 1.0
        for node in out.head["nodes"]:
            if "mesh" in node:
                node["translation"] = (low + node.get("translation", [0, 0, 0])).tolist()
                node["scale"] = [step] * 3
    for mesh, target in zip(meshes, out.head["meshes"]):
        for (attributes, faces), primitive in zip(mesh, target["primitives"]):
            if geometry == "meshopt":
                primitive.update(_write_meshopt(out, attributes, faces, low, step))
            else:
                write = _write_draco if geometry == "draco" else write_plain
                primitive.update(write(out, attributes, faces))


# ---- images ----

def _uses(head: dict) -> dict[int, tuple[str, int, int, bool]]:
    """Returns of each image its name, kind (enum image_use), channels, and whether JPEG has all of it."""
    found: dict[int, tuple[str, int, int, bool]] = {}
    source = [texture.get("source") for texture in head.get("textures", [])]
    for material in head.get("materials", []):
        metal = material.get("pbrMetallicRoughness", {})
        opaque = material.get("alphaMode", "OPAQUE") == "OPAQUE"
        grey = "metallicRoughnessTexture" not in metal
        for texture, name, kind, channels, whole in (
                (metal.get("baseColorTexture"), "color", lib.IMAGE_COLOR, 3, opaque),
                (material.get("emissiveTexture"), "emission", lib.IMAGE_COLOR, 3, True),
                (material.get("normalTexture"), "normal", lib.IMAGE_NORMAL, 3, True),
                (metal.get("metallicRoughnessTexture"), "orm", lib.IMAGE_DATA, 3, True),
                (material.get("occlusionTexture"), "ao" if grey else "orm", lib.IMAGE_DATA, 1 if grey else 3, True)):
            if texture:
                found.setdefault(source[texture["index"]], (name, kind, channels, whole))
    return found


def copy_image(path: Any, output: Any, use: int, *, factor: int = 1, channels: int = 3, quality: int = 0,
               **job: Any) -> None:
    """Writes a copy of an image (struct image_copy). Raises Error."""
    with core.Job(job.get("memory"), job.get("threads", 0), None, job.get("progress")) as work:
        how = ffi.new("struct image_copy *", {"path": work.string(path), "output": work.string(output), "use": use,
                                              "factor": factor, "channels": channels, "quality": quality})
        work.run(lib.images_copy, how)


def _pack_images(glb: Glb, out: Writer, folder: Path, images: str, factor: int, job: dict) -> dict:
    """Adds the images, smaller ones or JPEG files. Returns what JPEG lost, by names."""
    lost = {}
    for number, image in enumerate(out.head.get("images", [])):
        data = glb.view(glb.head["images"][number]["bufferView"])
        name, use, channels, whole = _uses(glb.head).get(number, ("", 0, 3, False))
        jpeg = whole and (images == "all-jpeg" or (images == "jpeg" and use != lib.IMAGE_NORMAL))
        if jpeg or factor > 1:
            before, after = folder / f"{number}.png", folder / f"{number}.{'jpg' if jpeg else 'new.png'}"
            before.write_bytes(data)
            if channels == 1:  # of the image's first one
                copy_image(before, folder / "first.png", use, channels=1, **job)
                os.replace(folder / "first.png", before)
            quality = NORMAL_QUALITY if use == lib.IMAGE_NORMAL else QUALITY
            copy_image(before, after, use, factor=factor, channels=channels if jpeg else 3,
                       quality=quality if jpeg else 0, **job)
            if jpeg and factor == 1 and after.stat().st_size >= len(data):
                jpeg = False  # such as one that is the same everywhere
            elif jpeg and factor == 1:
                kind = {lib.IMAGE_COLOR: "color", lib.IMAGE_NORMAL: "normal"}.get(use, "data")
                error = core.compare(after, before, kind=kind, force=True, **job)
                lost[name] = {"quality": quality, "bytes": after.stat().st_size, "png_bytes": len(data),
                              **{key: error[key] for key in ("unit", "mean", "p99", "max")}}
            data = after.read_bytes() if jpeg or factor > 1 else data
            before.unlink()
            after.unlink()
        image.update(bufferView=out.add(bytes(data)), mimeType="image/jpeg" if jpeg else "image/png")
    return lost


# ---- the file ----

def surface(glb: Glb) -> Mesh:
    """Returns the triangles of a file with one node, where they are."""
    node, = glb.head["nodes"]
    points, triangles, count = [], [], 0
    for primitive in glb.head["meshes"][0]["primitives"]:
        attributes, faces = glb.primitive(primitive)
        points.append(attributes["POSITION"] * node.get("scale", 1) + node.get("translation", 0))
        triangles.append(faces + count)
        count += len(points[-1])
    return Mesh(np.concatenate(points), np.concatenate(triangles))


def pack(source: Path, target: Path, folder: Path, *, images: str = "png", geometry: str = "none", factor: int = 1,
         progress: core.Progress | None = None, **job: Any) -> dict:
    """Writes a GLB file as another one. images: "jpeg" makes JPEG files of colours, occlusion, roughness and metal
    (quality 90), "all-jpeg" also of normals (quality 95). geometry: "meshopt" or "draco". factor: of images, texels
    of a side that become one. folder: for temporary files. Returns what that loses: of images by names, and how far
    the surfaces before and after are from each other."""
    glb = Glb(source)
    out = Writer(copy.deepcopy(glb.head))
    lost = _pack_images(glb, out, folder, images, factor, {**job, "progress": progress})
    _pack_geometry(glb, out, geometry)
    out.write(target)
    found = {"bytes": target.stat().st_size, "bytes_before": source.stat().st_size, "images": lost}
    if geometry != "none":
        apart = core.measure(surface(Glb(target)), surface(glb), progress=progress, **job)
        found["geometry"] = {"packed": geometry, "distance": max(of["max"] for of in apart.values())}
    return found


def packed(steps: Any, level: dict, source: Path, job: dict) -> tuple[dict[Path, Path], dict]:
    """Packs the GLB file of a level in a step, once for each size that the images of its outputs have.
    Returns the files by outputs, and what packing lost by the names of outputs."""
    how = {"images": level["images"], "geometry": level["geometry"]}
    if how == {"images": "png", "geometry": "none"} and {size for size, _ in level["outputs"]} == {level["size"]}:
        return {path: source for _, path in level["outputs"]}, {}
    files = {path: source.with_name(f"packed_{size}.glb") for size, path in level["outputs"]}
    factors = {files[path]: level["size"] // size for size, path in level["outputs"]}

    def make() -> dict:
        lost = {file: pack(source, file, source.parent, factor=factor, **how, progress=steps.report, **job)
                for file, factor in factors.items()}
        return {path.name: lost[file] for path, file in files.items()}

    options = {**how, "sizes": [size for size, _ in level["outputs"]], "names": [path.name for path in files]}
    if how["geometry"] == "draco":
        options["version"] = metadata.version("DracoPy")
    return files, steps.run(f"pack {level['name']}", [source], options, list(factors), make)

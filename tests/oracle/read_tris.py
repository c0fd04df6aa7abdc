"""Reads .tris files, written from formats/FORMATS.md alone.

read(data, verify) returns the content or raises Refused. With verify=False it makes the checks
that FORMATS.md asks of a reader that opens a file and loads all chunks, with verify=True also those
of a reader that verifies the whole file.
"""
import re
from dataclasses import dataclass, field

import numpy

from refusal import Refused, array, checksum, fields, has_minus_32768, is_finite, is_zero, need

HEADER_BYTES, ENTRY_BYTES, SOURCE_BYTES, CREASE_BYTES = 176, 104, 36, 16
NORMALS, TEXCOORDS, COLORS, MATERIALS, SAMPLES, FINE_COLORS = 1, 2, 4, 8, 16, 32
NONE = 0xFFFFFFFF


@dataclass
class Header:
    version: int
    attributes: int
    triangle_count: int
    chunk_count: int
    source_faces: int
    skipped_triangles: int
    origin: tuple
    bounds_min: tuple
    bounds_max: tuple
    chunks_offset: int
    materials_offset: int
    table_offset: int
    file_bytes: int
    material_count: int
    channel_count: int
    ids: int
    made_normals: int
    images_checksum: int
    materials_checksum: int
    table_checksum: int
    header_checksum: int


@dataclass
class Entry:
    offset: int
    size_bytes: int
    first_triangle: int
    triangle_count: int
    vertex_count: int
    bounds_min: tuple
    bounds_max: tuple
    checksum: int
    sample_checksum: int
    normals_offset: int
    creases_offset: int
    normals_checksum: int
    crease_count: int
    reserved: int


@dataclass
class Chunk:
    entry: Entry
    positions: numpy.ndarray
    triangles: numpy.ndarray
    normals: numpy.ndarray = None
    texcoords: numpy.ndarray = None
    colors: numpy.ndarray = None
    fine_colors: numpy.ndarray = None
    materials: numpy.ndarray = None
    samples: numpy.ndarray = None
    made_normals: numpy.ndarray = None
    creases: numpy.ndarray = None  # vertex, reserved, second


@dataclass
class Content:
    header: Header
    channels: list  # names
    # of (diffuse, path or None, flags, name, scale and offset, sources), with sources of (value,
    # component, scale and offset, path or None)
    materials: list
    chunks: list = field(default_factory=list)


def _read_header(data):
    need(len(data) >= HEADER_BYTES and data[:8] == b"BSQTRIS\n", "not a chunk file")
    n = fields(data, 8, "IIQQQQ3d3f3fQQQQIIIIQQQQ")
    header = Header(*n[:6], n[6:9], n[9:12], n[12:15], *n[15:])
    need(header.version == 7, f"version {header.version}")
    need(header.header_checksum == checksum(data[:168]), "checksum of the header")
    need(header.file_bytes == len(data), "length of the file")
    need(header.attributes < 64, "unknown attributes")
    need(header.attributes & COLORS or not header.attributes & FINE_COLORS, "fine colours alone")
    need(header.made_normals <= 3 and not (header.made_normals and header.attributes & NORMALS),
         "unknown normals")
    need(header.ids <= 3, "unknown ids")
    need(is_finite(header.origin), "origin is not finite")
    need(is_finite(header.bounds_min + header.bounds_max), "bounds are not finite")
    need(all(a <= b for a, b in zip(header.bounds_min, header.bounds_max)), "order of the bounds")
    need(HEADER_BYTES <= header.chunks_offset <= header.materials_offset <= header.table_offset
         <= len(data), "order of the parts")
    need(header.chunks_offset % 8 == 0, "length of the images")
    need((header.table_offset - header.materials_offset) % 8 == 0, "length of the materials")
    need(header.table_offset + ENTRY_BYTES * header.chunk_count == len(data), "length of the table")
    return header


def _is_name(text):
    return text[:1].isalpha() and all(c in b"abcdefghijklmnopqrstuvwxyz0123456789_" for c in text)


def _read_path(part, at, path_bytes, header):
    if path_bytes == NONE:
        return None, at
    need(len(part) - at >= path_bytes, "path beyond the materials")
    path = bytes(part[at:at + path_bytes])
    need(0 not in path, "zero byte in a path")
    if path.startswith(b"#"):
        number = re.fullmatch(rb"#bytes=(\d+)\+(\d+)", path)
        need(number, "a range of an image")
        offset, size = int(number[1]), int(number[2])
        need(HEADER_BYTES <= offset <= header.chunks_offset
             and size <= header.chunks_offset - offset, "an image beyond the images")
    else:
        need(path.startswith(b"/"), "a path that is not absolute")
    return path, at + path_bytes


def _read_name(part, at):
    need(len(part) - at >= 4, "names beyond the materials")
    size, = fields(part, at, "I")
    at += 4
    need(len(part) - at >= size, "name beyond the materials")
    name = bytes(part[at:at + size])
    need(0 not in name, "zero byte in a name")
    return name, at + size


def _read_channels(part, count):
    need(count <= len(part), "number of channels")
    names, at = [], 0
    for _ in range(count):
        name, at = _read_name(part, at)
        names.append(name)
        need(_is_name(name) and names.count(name) == 1, "name of a channel")
    return names, at


def _are_bits(bits, count):
    """Whether bits 0 to 7 are below `count`, and two wrap modes and a bit follow."""
    wraps = bits >> 8
    return bits & 255 < count and wraps < 32 and wraps & 3 < 3 and wraps >> 2 & 3 < 3


def _read_source(part, at, count, header):
    need(len(part) - at >= SOURCE_BYTES, "materials beyond their part")
    *numbers, path_bytes = fields(part, at, "3fI4fI")
    value, bits, coordinates = tuple(numbers[:3]), numbers[3], tuple(numbers[4:])
    need(is_finite(value) and is_finite(coordinates), "a number is not finite")
    need(_are_bits(bits, count), "flags or component")
    path, at = _read_path(part, at + SOURCE_BYTES, path_bytes, header)
    return (value, bits, coordinates, path), at


def _read_materials(data, header):
    part = data[header.materials_offset:header.table_offset]
    need(header.materials_checksum == checksum(part), "checksum of the materials")
    channels, at = _read_channels(part, header.channel_count)
    materials = []
    for _ in range(header.material_count):
        (diffuse, flags, coordinates, path), at = _read_source(part, at, 4, header)
        name, at = _read_name(part, at)
        sources = []
        for _ in channels:
            source, at = _read_source(part, at, 5, header)
            sources.append(source)
        materials.append((diffuse, path, flags, name, coordinates, sources))
    need(len(part) - at < 8 and is_zero(part[at:]), "materials do not fill their part")
    return channels, materials


def _index_type(vertex_count):
    return "u2" if vertex_count <= 65536 else "u4"


def _arrays(header, entry):
    """Returns name, type and shape of each array of a chunk, in the order of the file."""
    nt, nv = entry.triangle_count, entry.vertex_count
    arrays = [("positions", "f4", (nv, 3))]
    if header.attributes & NORMALS:
        arrays.append(("normals", "u4", (nv,)))
    if header.attributes & TEXCOORDS:
        arrays.append(("texcoords", "f4", (nv, 2)))
    if header.attributes & COLORS:
        arrays.append(("colors", "u4", (nv,)))
    if header.attributes & FINE_COLORS:
        arrays.append(("fine_colors", "u4", (nv,)))
    if header.attributes & MATERIALS:
        arrays.append(("materials", "u4", (nt,)))
    if header.attributes & SAMPLES:
        arrays.append(("samples", "u1", (16 * ((nt + 63) // 64),)))
    arrays.append(("triangles", _index_type(nv), (nt, 3)))
    return arrays


def _array_bytes(kind, shape):
    return int(kind[1:]) * int(numpy.prod(shape, dtype=object))


def _unpadded_bytes(header, entry):
    return sum(_array_bytes(kind, shape) for _, kind, shape in _arrays(header, entry))


def _is_inside(low, high, header):
    return all(a <= b for a, b in zip(low, high)) and \
        all(a >= b for a, b in zip(low, header.bounds_min)) and \
        all(a <= b for a, b in zip(high, header.bounds_max))


def _normals_end(header, entries, normals):
    """Checks the places of normals, from `normals` on, and returns where they end."""
    creases = normals + 8 * sum(entry.vertex_count for entry in entries)
    if not header.made_normals:
        for i, e in enumerate(entries):
            need(e.normals_offset == e.creases_offset == e.normals_checksum == 0 and
                 e.crease_count == e.reserved == 0, f"chunk {i}: no normals")
        return normals
    for i, entry in enumerate(entries):
        need((entry.normals_offset, entry.creases_offset) == (normals, creases) and
             entry.crease_count <= entry.vertex_count and entry.reserved == 0,
             f"chunk {i}: place of its normals")
        normals += 8 * entry.vertex_count
        creases += CREASE_BYTES * entry.crease_count
    return creases


def _read_table(data, header):
    part = data[header.table_offset:]
    need(header.table_checksum == checksum(part), "checksum of the table")
    entries, offset, triangles = [], header.chunks_offset, 0
    for i in range(header.chunk_count):
        n = fields(part, i * ENTRY_BYTES, "QQQII3f3fQQQQQII")
        entry = Entry(*n[:5], n[5:8], n[8:11], *n[11:])
        need(1 <= entry.triangle_count <= 65536, f"chunk {i}: triangle count")
        need(1 <= entry.vertex_count <= 3 * entry.triangle_count, f"chunk {i}: vertex count")
        size = (_unpadded_bytes(header, entry) + 7) // 8 * 8
        need(entry.offset == offset and entry.size_bytes == size, f"chunk {i}: place")
        need(entry.first_triangle == triangles, f"chunk {i}: first triangle")
        need(is_finite(entry.bounds_min + entry.bounds_max), f"chunk {i}: bounds are not finite")
        need(_is_inside(entry.bounds_min, entry.bounds_max, header), f"chunk {i}: bounds")
        need(header.attributes & SAMPLES or entry.sample_checksum == 0, f"chunk {i}: no sample")
        offset += size
        triangles += entry.triangle_count
        entries.append(entry)
    need(_normals_end(header, entries, offset) == header.materials_offset,
         "chunks or normals do not end at the materials")
    need(triangles == header.triangle_count, "triangle count of the header")
    return entries


def _load_chunk(data, header, entry):
    at, end = entry.offset, entry.offset + entry.size_bytes
    need(entry.checksum == checksum(data[at:end]), "checksum")
    chunk = Chunk(entry, None, None)
    for name, kind, shape in _arrays(header, entry):
        setattr(chunk, name, array(data, at, kind, *shape))
        at += _array_bytes(kind, shape)
    need(is_zero(data[at:end]), "padding")
    need((chunk.triangles < entry.vertex_count).all(), "vertex number")
    if chunk.materials is not None:
        known = (chunk.materials < header.material_count) | (chunk.materials == NONE)
        need(known.all(), "material number")
    p = chunk.positions
    need((p >= entry.bounds_min).all() and (p <= entry.bounds_max).all(), "position")
    need(chunk.texcoords is None or is_finite(chunk.texcoords), "texture coordinates")
    if header.made_normals:
        _load_normals(data, chunk)
    return chunk


def _load_normals(data, chunk):
    entry = chunk.entry
    first, creases = entry.normals_offset, entry.creases_offset
    end = creases + CREASE_BYTES * entry.crease_count
    need(entry.normals_checksum ==
         checksum(data[first:first + 8 * entry.vertex_count] + data[creases:end]),
         "checksum of the normals")
    chunk.made_normals = array(data, first, "u8", entry.vertex_count)
    chunk.creases = numpy.frombuffer(data[creases:end],
                                     [("vertex", "<u4"), ("reserved", "<u4"), ("second", "<u8")])
    vertices = chunk.creases["vertex"].astype("i8")
    need((vertices < entry.vertex_count).all() and (numpy.diff(vertices) > 0).all() and
         not chunk.creases["reserved"].any(), "order of the creases")


def unpack_normals(packed):
    """Returns unit normals, zero where there is none, and rises."""
    x, y = (((packed >> at) & 0x3FFFFF).astype("f8") - 2097152 for at in (numpy.uint64(0), numpy.uint64(22)))
    x, y = x / 2097151, y / 2097151
    z = 1 - abs(x) - abs(y)
    folded = z < 0
    x, y = (numpy.where(folded, numpy.copysign(1 - abs(b), a), a) for a, b in ((x, y), (y, x)))
    n = numpy.stack([x, y, z], axis=-1)
    n /= numpy.linalg.norm(n, axis=-1, keepdims=True)
    rises = ((packed >> numpy.uint64(44)) << numpy.uint64(12)).astype("<u4").view("<f4")
    return numpy.where((packed == 0)[..., None], 0, n), rises


def _verify_normals(packed):
    with numpy.errstate(all="ignore"):
        finite = numpy.isfinite(unpack_normals(packed)[1])
    valid = (packed & 0x3FFFFF != 0) & (packed >> numpy.uint64(22) & 0x3FFFFF != 0) & finite
    need((valid | (packed == 0)).all(), "a made normal")


def _verify_sample(records):
    lower, upper = records["normal"] & 0xFFFF, records["normal"] >> 16
    need((records["low"] <= records["high"]).all(), "low of a sample's record")
    need(((upper == 0x8000) & (lower < 64) | (upper != 0x8000) & (lower != 0x8000)).all(),
         "normal of a sample's record")
    zero = [record.tobytes() == bytes(16) for record in records]
    need(zero == sorted(zero), "a record after the last one of a sample")


def _verify_chunk(chunk):
    p = chunk.positions
    need((p.min(axis=0) == chunk.entry.bounds_min).all(), "lower bounds are not exact")
    need((p.max(axis=0) == chunk.entry.bounds_max).all(), "upper bounds are not exact")
    used = numpy.zeros(len(p), bool)
    used[chunk.triangles.ravel()] = True
    need(used.all(), "a vertex is not used")
    need(chunk.normals is None or not has_minus_32768(chunk.normals), "-32768 in a normal")
    if chunk.made_normals is not None:
        _verify_normals(chunk.made_normals)
        _verify_normals(chunk.creases["second"])
    need(chunk.colors is None or (chunk.colors >> 24 == 255).all(), "a colour is not opaque")
    need(chunk.fine_colors is None or (chunk.fine_colors >> 30 == 0).all(), "bits of a fine colour")
    if chunk.samples is not None:
        need(chunk.entry.sample_checksum == checksum(chunk.samples.tobytes()),
             "checksum of a sample")
        _verify_sample(chunk.samples.view([("low", "<u2", 3), ("high", "<u2", 3), ("normal", "<u4")]))


def _verify_bounds(content):
    header, low, high = content.header, (0, 0, 0), (0, 0, 0)
    if content.chunks:
        low = numpy.min([c.entry.bounds_min for c in content.chunks], axis=0)
        high = numpy.max([c.entry.bounds_max for c in content.chunks], axis=0)
    need(tuple(low) == header.bounds_min and tuple(high) == header.bounds_max,
         "bounds of the header are not exact")


def _verify_images(data, header):
    images = data[HEADER_BYTES:header.chunks_offset]
    need(header.images_checksum == checksum(images), "checksum of the images")


def read(data, verify):
    """Returns the Content of a file, or raises Refused."""
    header = _read_header(data)
    content = Content(header, *_read_materials(data, header))
    for i, entry in enumerate(_read_table(data, header)):
        try:
            chunk = _load_chunk(data, header, entry)
            if verify:
                _verify_chunk(chunk)
        except Refused as reason:
            raise Refused(f"chunk {i}: {reason}") from None
        content.chunks.append(chunk)
    if verify:
        _verify_bounds(content)
        _verify_images(data, header)
    return content

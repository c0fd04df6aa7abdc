"""Reads .tris files, written from formats/FORMATS.md alone.

read(data, verify) returns the content or raises Refused. With verify=False it makes the checks
that FORMATS.md asks of a reader that opens a file and loads all chunks, with verify=True also those
of a reader that verifies the whole file.
"""
import re
from dataclasses import dataclass, field

import numpy

from refusal import Refused, array, checksum, fields, has_minus_32768, is_finite, is_zero, need

HEADER_BYTES, ENTRY_BYTES, MATERIAL_BYTES = 152, 56, 16
NORMALS, TEXCOORDS, COLORS, MATERIALS, SAMPLES = 1, 2, 4, 8, 16
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
    materials_offset: int
    table_offset: int
    file_bytes: int
    material_count: int
    reserved: int
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


@dataclass
class Chunk:
    entry: Entry
    positions: numpy.ndarray
    triangles: numpy.ndarray
    normals: numpy.ndarray = None
    texcoords: numpy.ndarray = None
    colors: numpy.ndarray = None
    materials: numpy.ndarray = None
    samples: numpy.ndarray = None


@dataclass
class Content:
    header: Header
    ids: int = 0
    channels: list = None  # names; None before version 3
    # of (diffuse, path or None), in version 2 (diffuse, path or None, flags, name), in version 3
    # also (scale and offset), and for each channel (value, component, scale and offset, path)
    materials: list = field(default_factory=list)
    chunks: list = field(default_factory=list)


def _read_header(data):
    need(len(data) >= HEADER_BYTES and data[:8] == b"BSQTRIS\n", "not a chunk file")
    n = fields(data, 8, "IIQQQQ3d3f3fQQQIIQQQ")
    header = Header(*n[:6], n[6:9], n[9:12], n[12:15], *n[15:])
    need(header.version in (1, 2, 3, 4, 5, 6), f"version {header.version}")
    need(header.header_checksum == checksum(data[:144]), "checksum of the header")
    need(header.file_bytes == len(data), "length of the file")
    need(header.attributes < 32, "unknown attributes")
    need((header.attributes >= SAMPLES) == (header.version == 6), "samples and the version")
    need(header.reserved == 0, "reserved is not 0")
    need(is_finite(header.origin), "origin is not finite")
    need(is_finite(header.bounds_min + header.bounds_max), "bounds are not finite")
    need(all(a <= b for a, b in zip(header.bounds_min, header.bounds_max)), "order of the bounds")
    need(HEADER_BYTES <= header.materials_offset <= header.table_offset <= len(data),
         "order of the parts")
    need((header.table_offset - header.materials_offset) % 8 == 0, "length of the materials")
    need(header.table_offset + ENTRY_BYTES * header.chunk_count == len(data), "length of the table")
    return header


SAME = (1, 1, 0, 0)


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
        need(HEADER_BYTES <= offset <= header.file_bytes and size <= header.file_bytes - offset,
             "an image beyond the file")
    else:
        need(path.startswith(b"/"), "a path that is not absolute")
    return path, at + path_bytes


def _read_channels(part, at):
    need(len(part) - at >= 8, "no channels")
    count, zero = fields(part, at, "II")
    need(zero == 0 and count <= len(part), "number of channels")
    names, at = [], at + 8
    for _ in range(count):
        need(len(part) - at >= 4, "channels beyond their part")
        size, = fields(part, at, "I")
        need(len(part) - at - 4 >= size, "name of a channel beyond the materials")
        names.append(bytes(part[at + 4:at + 4 + size]))
        need(_is_name(names[-1]) and names.count(names[-1]) == 1, "name of a channel")
        at += 4 + size
    return names, at


def _are_flags(flags, version, count):
    """Whether flags are below `count`, and in version 4 have two wrap modes from bit 8 on, and bit 12."""
    wraps = flags >> 8
    return flags & 255 < count and (
        wraps == 0 or version > 3 and wraps < 32 and wraps & 3 < 3 and wraps >> 2 & 3 < 3)


def _read_sources(part, at, channels, header):
    """Returns what version 3 adds to a material, and its end. Textures have no factor before
    version 4."""
    version = header.version
    need(len(part) - at >= 16, "coordinates beyond their part")
    moved, sources, at = fields(part, at, "4f"), [], at + 16
    need(is_finite(moved), "coordinates are not finite")
    for _ in channels:
        need(len(part) - at >= 36, "channels of a material beyond their part")
        *value, component, a, b, c, d, path_bytes = fields(part, at, "3fI4fI")
        need(is_finite(value) and is_finite((a, b, c, d)) and _are_flags(component, version, 5),
             "value of a channel")
        path, at = _read_path(part, at + 36, path_bytes, header)
        if version == 3 and path and component != 4:
            value = (1, 1, 1)
        sources.append((tuple(value), component, (a, b, c, d), path))
    return (tuple(moved), sources), at


def _needs_factors(material):
    return material[2] > 1 or any(
        component > 4 or path and component != 4 and value != (1, 1, 1)
        for value, component, _, path in material[5])


def _read_materials(data, header):
    part = data[header.materials_offset:header.table_offset]
    need(header.materials_checksum == checksum(part), "checksum of the materials")
    ids, channels, materials, at = 0, None, [], 0
    if header.version >= 2:
        need(len(part) >= 8, "no ids")
        ids, zero = fields(part, 0, "II")
        need(3 - header.version <= ids <= 3 and zero == 0, "unknown ids")
        at = 8
    if header.version >= 3:
        channels, at = _read_channels(part, at)
    for _ in range(header.material_count):
        need(len(part) - at >= MATERIAL_BYTES, "materials beyond their part")
        *diffuse, path_bytes = fields(part, at, "3fI")
        at += MATERIAL_BYTES
        need(is_finite(diffuse), "diffuse colour is not finite")
        path, at = _read_path(part, at, path_bytes, header)
        material = (tuple(diffuse), path)
        if header.version >= 2:
            need(len(part) - at >= 8, "names beyond their part")
            flags, name_bytes = fields(part, at, "II")
            at += 8
            need(_are_flags(flags, header.version, 2 if header.version < 4 else 4),
                 "flags of a material")
            need(len(part) - at >= name_bytes, "name beyond the materials")
            name = bytes(part[at:at + name_bytes])
            need(0 not in name, "zero byte in a name")
            at += name_bytes
            material += (flags, name)
        if header.version >= 3:
            more, at = _read_sources(part, at, channels, header)
            material += more
        materials.append(material)
    need(len(part) - at < 8 and is_zero(part[at:]), "materials do not fill their part")
    need(header.version != 3 or channels or any(m[4] != SAME for m in materials),
         "no need of version 3")
    need(header.version != 4 or any(_needs_factors(m) for m in materials), "no need of version 4")
    return ids, channels, materials


def _paths_of_images(material):
    paths = [material[1]] + [source[3] for source in (material[5] if len(material) > 5 else [])]
    return [path for path in paths if path and path.startswith(b"#")]


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
    if header.attributes & MATERIALS:
        arrays.append(("materials", "u4", (nt,)))
    if header.attributes & SAMPLES:
        arrays.append(("samples", "u1", (8 + 16 * ((nt + 63) // 64),)))
    arrays.append(("triangles", _index_type(nv), (nt, 3)))
    return arrays


def _array_bytes(kind, shape):
    return int(kind[1:]) * int(numpy.prod(shape, dtype=object))


def _unpadded_bytes(header, entry):
    return 16 + sum(_array_bytes(kind, shape) for _, kind, shape in _arrays(header, entry))


def _is_inside(low, high, header):
    return all(a <= b for a, b in zip(low, high)) and \
        all(a >= b for a, b in zip(low, header.bounds_min)) and \
        all(a <= b for a, b in zip(high, header.bounds_max))


def _read_table(data, header, first):
    part = data[header.table_offset:]
    need(header.table_checksum == checksum(part), "checksum of the table")
    entries, offset, triangles = [], first, 0
    for i in range(header.chunk_count):
        n = fields(part, i * ENTRY_BYTES, "QQQII3f3f")
        entry = Entry(*n[:5], n[5:8], n[8:11])
        need(1 <= entry.triangle_count <= 65536, f"chunk {i}: triangle count")
        need(1 <= entry.vertex_count <= 3 * entry.triangle_count, f"chunk {i}: vertex count")
        size = (_unpadded_bytes(header, entry) + 7) // 8 * 8
        need(entry.offset == offset and entry.size_bytes == size, f"chunk {i}: place")
        need(entry.first_triangle == triangles, f"chunk {i}: first triangle")
        need(is_finite(entry.bounds_min + entry.bounds_max), f"chunk {i}: bounds are not finite")
        need(_is_inside(entry.bounds_min, entry.bounds_max, header), f"chunk {i}: bounds")
        offset += size
        triangles += entry.triangle_count
        entries.append(entry)
    need(offset == header.materials_offset, "chunks do not end at the materials")
    need(triangles == header.triangle_count, "triangle count of the header")
    return entries


def _load_chunk(data, header, entry):
    at, end = entry.offset, entry.offset + entry.size_bytes
    stored, nt, nv = fields(data, at, "QII")
    need(stored == checksum(data[at + 8:end]), "checksum")
    need((nt, nv) == (entry.triangle_count, entry.vertex_count), "counts")
    chunk = Chunk(entry, None, None)
    at += 16
    for name, kind, shape in _arrays(header, entry):
        setattr(chunk, name, array(data, at, kind, *shape))
        at += _array_bytes(kind, shape)
    need(is_zero(data[at:end]), "padding")
    need((chunk.triangles < nv).all(), "vertex number")
    if chunk.materials is not None:
        known = (chunk.materials < header.material_count) | (chunk.materials == NONE)
        need(known.all(), "material number")
    p = chunk.positions
    need((p >= entry.bounds_min).all() and (p <= entry.bounds_max).all(), "position")
    need(chunk.texcoords is None or is_finite(chunk.texcoords), "texture coordinates")
    return chunk


def _verify_chunk(chunk):
    p = chunk.positions
    need((p.min(axis=0) == chunk.entry.bounds_min).all(), "lower bounds are not exact")
    need((p.max(axis=0) == chunk.entry.bounds_max).all(), "upper bounds are not exact")
    used = numpy.zeros(len(p), bool)
    used[chunk.triangles.ravel()] = True
    need(used.all(), "a vertex is not used")
    need(chunk.normals is None or not has_minus_32768(chunk.normals), "-32768 in a normal")
    need(chunk.colors is None or (chunk.colors >> 24 == 255).all(), "a colour is not opaque")
    if chunk.samples is not None:
        sample = chunk.samples.tobytes()
        need(fields(sample, 0, "Q")[0] == checksum(sample[8:]), "checksum of a sample")


def _verify_bounds(content):
    header, low, high = content.header, (0, 0, 0), (0, 0, 0)
    if content.chunks:
        low = numpy.min([c.entry.bounds_min for c in content.chunks], axis=0)
        high = numpy.max([c.entry.bounds_max for c in content.chunks], axis=0)
    need(tuple(low) == header.bounds_min and tuple(high) == header.bounds_max,
         "bounds of the header are not exact")


def _images_end(data, content):
    """Returns where the chunks begin: after the images and their checksum, if there are any."""
    header = content.header
    images = any(_paths_of_images(m) for m in content.materials)
    need(images == (header.version == 5) or header.version == 6, "images and the version")
    if not images or header.chunk_count == 0:
        return HEADER_BYTES
    first, = fields(data, header.table_offset, "Q")
    need(first % 8 == 0 and HEADER_BYTES <= first <= header.materials_offset, "end of the images")
    return first


def _verify_images(data, first):
    if first > HEADER_BYTES:
        stored, = fields(data, first - 8, "Q")
        need(stored == checksum(data[HEADER_BYTES:first - 8]), "checksum of the images")


def read(data, verify):
    """Returns the Content of a file, or raises Refused."""
    header = _read_header(data)
    content = Content(header, *_read_materials(data, header))
    first = _images_end(data, content)
    for i, entry in enumerate(_read_table(data, header, first)):
        try:
            chunk = _load_chunk(data, header, entry)
            if verify:
                _verify_chunk(chunk)
        except Refused as reason:
            raise Refused(f"chunk {i}: {reason}") from None
        content.chunks.append(chunk)
    if verify:
        _verify_bounds(content)
        _verify_images(data, first)
    return content

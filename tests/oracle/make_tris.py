"""Makes random .tris files from formats/FORMATS.md: sound ones, and ones with one odd property."""
import struct

import numpy

from read_tris import (COLORS, CREASE_BYTES, ENTRY_BYTES, FINE_COLORS, HEADER_BYTES, MATERIALS, NONE, NORMALS,
                       SAMPLES, TEXCOORDS)
from refusal import checksum

COORDINATES = [0.0, -0.0, 1.0, -1.5, 1e-45, -1e-38, 3.4028235e38, -3.4028235e38, 500000.125]


def _pad(data):
    return data + bytes(-len(data) % 8)


def _positions(random, count):
    if random.random() < 0.3:
        return random.choice(COORDINATES, (count, 3)).astype("<f4")
    return random.normal(0, 10, (count, 3)).astype("<f4")


def _normals(random, count):
    halves = random.integers(-32767, 32768, (count, 2)).astype("<i2")
    return halves.view("<u4").ravel()


def _moved(random):
    same = random.random() < 0.5
    return (1, 1, 0, 0) if same else tuple(random.choice([1, -2.5, 0.125, 0], 4))


def _wraps(random):
    """Wrap modes of u and v, and whether an image is sRGB."""
    if random.random() < 0.5:
        return 0
    return sum(int(random.integers(0, n)) << at for n, at in ((3, 8), (3, 10), (2, 12)))


def _source(random, count, paths):
    """A value, flags or a component below `count`, coordinates and a path."""
    return (random.random(3), int(random.integers(0, count)) | _wraps(random), _moved(random),
            paths[random.integers(0, len(paths))])


def _material(random, channels):
    diffuse, flags, moved, path = _source(random, 4, [None, b"/a.png", b"/textures/\xc3\xa9 b.jpg"])
    name = [b"", b"stone", b"\xc3\xa9\xff glass"][random.integers(0, 3)]
    return (diffuse, path, flags, name, moved,
            [_source(random, 5, [None, b"/r.png"]) for _ in channels])


def _sample(random, count):
    """Records of planes and of boxes, and zeros after the last one."""
    records = numpy.zeros(count, [("box", "<u2", (2, 3)), ("normal", "<u4")])
    used = random.integers(0, count + 1)
    records["box"][:used] = numpy.sort(random.integers(0, 65536, (used, 2, 3)), axis=1)
    records["normal"][:used] = numpy.where(random.random(used) < 0.5, _normals(random, used),
                                           0x80000000 + random.integers(0, 64, used))
    return records.view("u1")


def _make_chunk(random, attributes, material_count):
    nt = int(random.choice([1, 2, 3, 7, 50, 300]))
    nv = int(random.integers(1, 3 * nt + 1))
    corners = random.integers(0, nv, 3 * nt)
    corners[random.permutation(3 * nt)[:nv]] = numpy.arange(nv)
    chunk = {"positions": _positions(random, nv)}
    if attributes & NORMALS:
        chunk["normals"] = _normals(random, nv)
    if attributes & TEXCOORDS:
        chunk["texcoords"] = random.normal(0, 1, (nv, 2)).astype("<f4")
    if attributes & COLORS:
        chunk["colors"] = (random.integers(0, 1 << 24, nv) | 0xFF000000).astype("<u4")
    if attributes & FINE_COLORS:
        chunk["fine_colors"] = random.integers(0, 1 << 30, nv).astype("<u4")
    if attributes & MATERIALS:
        numbers = list(range(material_count)) + [NONE]
        chunk["materials"] = random.choice(numbers, nt).astype("<u4")
    if attributes & SAMPLES:
        chunk["samples"] = _sample(random, (nt + 63) // 64)
    chunk["made_normals"] = _made_normals(random, nv)
    chunk["creases"] = _creases(random, nv)
    chunk["triangles"] = corners.reshape(nt, 3).astype("<u4")
    chunk["bounds"] = _bounds(chunk["positions"])
    return chunk


def _made_normals(random, count):
    """Packed normals and rises; some vertices have none."""
    x, y = random.integers(1, 1 << 22, (2, count), dtype="u8")
    rise = random.normal(0, 1, count).astype("<f4").view("<u4").astype("u8") >> numpy.uint64(12)
    packed = x | y << numpy.uint64(22) | rise << numpy.uint64(44)
    return numpy.where(random.random(count) < 0.2, 0, packed).astype("<u8")


def _creases(random, vertex_count):
    vertices = numpy.flatnonzero(random.random(vertex_count) < 0.3)
    creases = numpy.zeros(len(vertices), [("vertex", "<u4"), ("reserved", "<u4"), ("second", "<u8")])
    creases["vertex"] = vertices
    creases["second"] = _made_normals(random, len(vertices))
    return creases


def _bounds(positions):
    return numpy.stack([positions.min(axis=0), positions.max(axis=0)])


def make(random):
    """Returns a random scan as a dictionary that encode() takes."""
    attributes = int(random.integers(0, 64))
    if not attributes & COLORS:
        attributes &= ~FINE_COLORS
    channels = []
    if random.random() < 0.5:
        channels = list(random.permutation([b"roughness", b"a", b"x_1"])[:random.integers(1, 4)])
    materials = [_material(random, channels) for _ in range(random.integers(0, 4))]
    chunks = [_make_chunk(random, attributes, len(materials)) for _ in range(random.integers(0, 5))]
    image = b""
    if random.random() < 0.3:
        image = random.bytes(random.integers(1, 40))
        materials = [(m[0], b"#bytes=%d+%d" % (HEADER_BYTES, len(image)), *m[2:]) for m in materials]
    made = 0 if attributes & NORMALS else int(random.integers(0, 4))
    return {"attributes": attributes, "made_normals": made, "ids": int(random.integers(0, 4)),
            "channels": [bytes(c) for c in channels], "materials": materials, "image": image,
            "origin": random.choice([0.0, 5e5, -1e300], 3),
            "counts": random.integers(0, 1 << 62, 2), "chunks": chunks}


def _encode_chunk(chunk):
    data = b""
    for name in ("positions", "normals", "texcoords", "colors", "fine_colors", "materials", "samples"):
        if name in chunk:
            data += chunk[name].tobytes()
    kind = "<u2" if len(chunk["positions"]) <= 65536 else "<u4"
    return _pad(data + chunk["triangles"].astype(kind).tobytes())


def _encode_entry(offset, size, triangles, chunk, part, places):
    sample = chunk["samples"].tobytes() if "samples" in chunk else None
    made = (0, 0, 0, 0)
    if places:
        normals = chunk["made_normals"].tobytes() + chunk["creases"].tobytes()
        made = (*places, checksum(normals), len(chunk["creases"]))
    return struct.pack("<QQQII6fQQQQQII", offset, size, triangles, len(chunk["triangles"]),
                       len(chunk["positions"]), *chunk["bounds"].ravel(), checksum(part),
                       0 if sample is None else checksum(sample), *made, 0)


def _encode_source(value, bits, coordinates, path):
    return struct.pack("<3fI4fI", *value, bits, *coordinates,
                       NONE if path is None else len(path)) + (path or b"")


def _encode_name(name):
    return struct.pack("<I", len(name)) + name


def _encode_materials(channels, materials):
    part = b"".join(map(_encode_name, channels))
    for diffuse, path, flags, name, coordinates, sources in materials:
        part += _encode_source(diffuse, flags, coordinates, path) + _encode_name(name)
        part += b"".join(_encode_source(*source) for source in sources)
    return _pad(part)


def encode(scan):
    """Returns the bytes of a scan."""
    images = _pad(scan["image"])
    first = HEADER_BYTES + len(images)
    parts = [_encode_chunk(chunk) for chunk in scan["chunks"]]
    table, triangles, offset = b"", 0, first
    normals = first + sum(map(len, parts))
    creases = normals + sum(8 * len(chunk["made_normals"]) for chunk in scan["chunks"])
    for chunk, part in zip(scan["chunks"], parts):
        places = (normals, creases) if scan["made_normals"] else None
        table += _encode_entry(offset, len(part), triangles, chunk, part, places)
        offset += len(part)
        triangles += len(chunk["triangles"])
        normals += 8 * len(chunk["made_normals"])
        creases += CREASE_BYTES * len(chunk["creases"])
    made = b""
    if scan["made_normals"]:
        made = b"".join(chunk[name].tobytes() for name in ("made_normals", "creases")
                        for chunk in scan["chunks"])
    offset += len(made)
    materials = _encode_materials(scan["channels"], scan["materials"])
    bounds = numpy.zeros((2, 3), "<f4")
    if parts:
        boxes = numpy.stack([chunk["bounds"] for chunk in scan["chunks"]])
        bounds = numpy.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    bounds = scan.get("bounds", bounds)
    table_offset = offset + len(materials)
    header = b"BSQTRIS\n" + struct.pack(
        "<IIQQQQ3d6fQQQQIIIIQQQ", 7, scan["attributes"], triangles, len(parts),
        *map(int, scan["counts"]), *scan["origin"], *bounds.ravel(), first, offset, table_offset,
        table_offset + len(table), len(scan["materials"]), len(scan["channels"]), scan["ids"],
        scan["made_normals"],
        checksum(images), checksum(materials), checksum(table))
    return header + struct.pack("<Q", checksum(header)) + images + b"".join(parts) + made + materials + table


# ---- odd properties ----

def _add_material(scan, diffuse, path=None, flags=0, name=b"", moved=(1, 1, 0, 0), sources=None):
    sources = sources or [((0, 0, 0), 0, (1, 1, 0, 0), None)] * len(scan["channels"])
    scan["materials"].append((diffuse, path, flags, name, moved, sources))


def _odd_path(random, scan):
    path = random.choice([b"", b"a.png", b"/", b"//h/a.png", b"/a\n", b"http://h/a.png",
                          b"/a\0b", b"/" + b"x" * 5000])
    _add_material(scan, random.random(3), bytes(path))


def _odd_diffuse(random, scan):
    value = random.choice([-1.0, 2.0, 1e30, numpy.inf, numpy.nan])
    _add_material(scan, [0.5, value, 0.5])


def _odd_name(random, scan):
    flags, name = int(random.choice([0, 3, 4, 1 << 13])), random.choice([b"", b"a", b"a\0b", b"x" * 5000])
    scan["ids"] = int(random.choice([0, 1, 3, 4]))
    _add_material(scan, [0.5, 0.5, 0.5], None, flags, bytes(name))


def _odd_channel(random, scan):
    name = random.choice([b"", b"a", b"A", b"1", b"a\0", b"x" * 5000])
    scan["channels"] = [b"a"] * int(random.integers(0, 2)) + [bytes(name)]
    odd = random.choice([numpy.nan, numpy.inf, 1.0])
    sources = [((odd, 0, 0), int(random.choice([0, 2, 5])), (1, odd, 0, 0), None)
               for _ in scan["channels"]]
    scan["materials"] = []
    _add_material(scan, [0.5, 0.5, 0.5], moved=(1, 1, 0, odd), sources=sources)
    for chunk in scan["chunks"]:
        if "materials" in chunk:
            chunk["materials"][:] = 0


def _odd_bounds(random, scan):
    for chunk in scan["chunks"][:1]:
        row, column = random.integers(0, 2), random.integers(0, 3)
        chunk["bounds"][row, column] += random.choice([-1, 1, numpy.nan, -0.0])


def _odd_header_bounds(random, scan):
    low, high = random.choice([-4e30, -1, -0.0, 0, 1, 4e30, numpy.nan], 2)
    scan["bounds"] = numpy.array([[low] * 3, [high] * 3], "<f4")


def _odd_vertex(random, scan):
    for chunk in scan["chunks"][:1]:
        at = random.integers(0, len(chunk["positions"]))
        chunk["positions"][at, random.integers(0, 3)] = random.choice([numpy.nan, numpy.inf, 1e38])
        if random.random() < 0.5:
            chunk["bounds"] = _bounds(chunk["positions"])


def _odd_triangle(random, scan):
    for chunk in scan["chunks"][:1]:
        nv = len(chunk["positions"])
        chunk["triangles"][random.integers(0, len(chunk["triangles"]))] = random.integers(0, nv + 1)


def _odd_attribute(random, scan):
    for chunk in scan["chunks"][-1:]:
        names = [n for n in ("normals", "colors", "fine_colors", "materials", "texcoords", "samples",
                             "made_normals", "creases") if len(chunk.get(n, ()))]
        if names:
            values = chunk[random.choice(names)].view("<u4").ravel()
            values[random.integers(0, len(values))] = random.choice(
                [0, 1, 2, 3, 0x8000, 0x80000000, 0x7F800000, 0x7FC00000, 0xFF7FFFFF, 0xFFFFFFFF])


def _odd_many_vertices(random, scan):
    nt = random.choice([21846, 40000, 65536, 65537])
    nv = random.choice([65535, 65536, 65537])
    chunk = {"positions": _positions(random, nv), "triangles":
             numpy.resize(numpy.arange(nv), (nt, 3)).astype("<u4")}
    chunk["bounds"] = _bounds(chunk["positions"])
    chunk["made_normals"] = _made_normals(random, nv)
    chunk["creases"] = _creases(random, nv)
    scan["attributes"] = 0
    scan["chunks"] = [chunk]


def _odd_empty_chunk(_, scan):
    for chunk in scan["chunks"][:1]:
        for name in chunk:
            if name != "bounds":
                chunk[name] = chunk[name][:0]


ODD = [_odd_path, _odd_diffuse, _odd_name, _odd_channel, _odd_bounds, _odd_header_bounds, _odd_vertex, _odd_triangle,
       _odd_attribute, _odd_many_vertices, _odd_empty_chunk]
ODD_WEIGHTS = numpy.array([3, 2, 3, 3, 3, 2, 3, 3, 6, 0.2, 0.5])


def make_odd(random, scan):
    """Gives a scan one odd property, which may make it unsound."""
    ODD[random.choice(len(ODD), p=ODD_WEIGHTS / ODD_WEIGHTS.sum())](random, scan)


# ---- checksums ----

def mend(data):
    """Corrects length and checksums of a damaged file, a bytearray, as far as its parts exist."""
    if len(data) < HEADER_BYTES:
        return
    first, materials, table = struct.unpack_from("<QQQ", data, 96)
    struct.pack_into("<Q", data, 120, len(data))
    for at in range(table, len(data) - ENTRY_BYTES + 1, ENTRY_BYTES):
        _mend_entry(data, at)
    for at, begin, end in ((144, HEADER_BYTES, first), (152, materials, table),
                           (160, table, len(data))):
        if begin <= end <= len(data):
            struct.pack_into("<Q", data, at, checksum(data[begin:end]))
    struct.pack_into("<Q", data, 168, checksum(data[:168]))


def _mend_entry(data, at):
    offset, size, _, nt, nv = struct.unpack_from("<QQQII", data, at)
    attributes, = struct.unpack_from("<I", data, 12)
    if offset > len(data) or size > len(data) - offset:
        return
    chunk = data[offset:offset + size]
    struct.pack_into("<Q", data, at + 56, checksum(chunk))
    normals, creases, _, count = struct.unpack_from("<QQQI", data, at + 72)
    if any(data[140:144]) and normals + 8 * nv <= len(data) and creases + 16 * count <= len(data):
        made = data[normals:normals + 8 * nv] + data[creases:creases + 16 * count]
        struct.pack_into("<Q", data, at + 88, checksum(made))
    if attributes & SAMPLES:
        of_vertices = sum(b for a, b in ((NORMALS, 4), (TEXCOORDS, 8), (COLORS, 4), (FINE_COLORS, 4)) if attributes & a)
        begin = nv * (12 + of_vertices) + (4 * nt if attributes & MATERIALS else 0)
        end = begin + 16 * ((nt + 63) // 64)
        if end <= size:
            struct.pack_into("<Q", data, at + 64, checksum(chunk[begin:end]))



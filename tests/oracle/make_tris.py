"""Makes random .tris files from formats/FORMATS.md: sound ones, and ones with one odd property."""
import struct

import numpy

from read_tris import COLORS, MATERIALS, NONE, NORMALS, SAMPLES, TEXCOORDS
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


def _names(random, materials):
    """Gives materials flags and names."""
    names = [b"", b"stone", b"\xc3\xa9\xff glass"]
    return [(*m, int(random.integers(0, 2)), names[random.integers(0, 3)]) for m in materials]


def _moved(random):
    same = random.random() < 0.5
    return (1, 1, 0, 0) if same else tuple(random.choice([1, -2.5, 0.125, 0], 4))


def _wraps(random, factors):
    """Wrap modes of u and v, and whether an image is sRGB, for version 4."""
    bits = [int(random.integers(0, n)) << at for n, at in ((3, 8), (3, 10), (2, 12))]
    return sum(bits) if factors else 0


def _sources(random, materials, channels, factors):
    """Gives materials what version 3 adds, or version 4."""
    paths = [None, b"/r.png"]
    return [(*m[:2], m[2] | 2 * factors | _wraps(random, factors), m[3], _moved(random),
             [(random.random(3), int(random.integers(0, 3)) | _wraps(random, factors),
               _moved(random), paths[random.integers(0, 2)]) for _ in channels])
            for m in materials]


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
    if attributes & MATERIALS:
        numbers = list(range(material_count)) + [NONE]
        chunk["materials"] = random.choice(numbers, nt).astype("<u4")
    if attributes & SAMPLES:
        sample = random.bytes(16 * ((nt + 63) // 64))
        chunk["samples"] = numpy.frombuffer(struct.pack("<Q", checksum(sample)) + sample, "u1")
    chunk["triangles"] = corners.reshape(nt, 3).astype("<u4")
    chunk["bounds"] = _bounds(chunk["positions"])
    return chunk


def _bounds(positions):
    return numpy.stack([positions.min(axis=0), positions.max(axis=0)])


def make(random):
    """Returns a random scan as a dictionary that encode() takes."""
    attributes = int(random.integers(0, 32))
    materials = [(random.random(3), random.choice([None, b"/a.png", b"/textures/\xc3\xa9 b.jpg"]))
                 for _ in range(random.integers(0, 4))]
    ids = int(random.choice([0, 0, 1, 2, 3]))
    channels, factors = None, False
    if random.random() < 0.3:
        factors = bool(materials) and random.random() < 0.5
        channels = list(random.permutation([b"roughness", b"a", b"x_1"])[:random.integers(1, 4)])
        channels = [bytes(c) for c in channels]
        materials = _sources(random, _names(random, materials), channels, factors)
    elif attributes & SAMPLES:
        channels = []
        materials = _sources(random, _names(random, materials), channels, False)
    elif ids:
        materials = _names(random, materials)
    chunks = [_make_chunk(random, attributes, len(materials)) for _ in range(random.integers(0, 5))]
    image = b""
    if factors and chunks and random.random() < 0.7:
        image = random.bytes(random.integers(1, 40))
        materials[0] = (materials[0][0], b"#bytes=152+%d" % len(image), *materials[0][2:])
    return {"attributes": attributes, "ids": ids, "channels": channels, "materials": materials,
            "factors": factors, "image": image,
            "origin": random.choice([0.0, 5e5, -1e300], 3),
            "counts": random.integers(0, 1 << 62, 2), "chunks": chunks}


def _encode_chunk(chunk):
    nt, nv = len(chunk["triangles"]), len(chunk["positions"])
    data = struct.pack("<II", nt, nv)
    for name in ("positions", "normals", "texcoords", "colors", "materials", "samples"):
        if name in chunk:
            data += chunk[name].tobytes()
    data = _pad(data + chunk["triangles"].astype("<u2" if nv <= 65536 else "<u4").tobytes())
    return struct.pack("<Q", checksum(data)) + data


def _path(path):
    return struct.pack("<I", NONE if path is None else len(path)) + (path or b"")


def _encode_sources(more, channels):
    moved, sources = more or ((1, 1, 0, 0), [((0, 0, 0), 0, (1, 1, 0, 0), None)] * len(channels))
    part = struct.pack("<4f", *moved)
    for value, component, uv, path in sources:
        part += struct.pack("<3fI4f", *value, component, *uv) + _path(path)
    return part


def _encode_materials(ids, channels, materials):
    part = struct.pack("<II", ids, 0) if ids or channels is not None else b""
    if channels is not None:
        part += struct.pack("<II", len(channels), 0)
        part += b"".join(struct.pack("<I", len(name)) + name for name in channels)
    for diffuse, path, *more in materials:
        part += struct.pack("<3f", *diffuse) + _path(path)
        if ids or channels is not None:
            flags, name = more[:2] or (0, b"")
            part += struct.pack("<II", flags, len(name)) + name
        if channels is not None:
            part += _encode_sources(more[2:], channels)
    return _pad(part)


def _version(scan):
    if scan["attributes"] & SAMPLES:
        return 6
    return 5 if scan.get("image") else 4 if scan.get("factors") else 3 if scan["channels"] is not None else 2 if scan["ids"] else 1


def encode(scan):
    """Returns the bytes of a scan."""
    images = _pad(scan.get("image", b""))
    images += struct.pack("<Q", checksum(images)) if images else b""
    parts, table, triangles, offset = [], b"", 0, 152 + len(images)
    for chunk in scan["chunks"]:
        part = _encode_chunk(chunk)
        nt, nv = len(chunk["triangles"]), len(chunk["positions"])
        table += struct.pack("<QQQII6f", offset, len(part), triangles, nt, nv,
                             *chunk["bounds"].ravel())
        parts.append(part)
        offset += len(part)
        triangles += nt
    materials = _encode_materials(scan["ids"], scan["channels"], scan["materials"])
    bounds = numpy.zeros((2, 3), "<f4")
    if parts:
        boxes = numpy.stack([chunk["bounds"] for chunk in scan["chunks"]])
        bounds = numpy.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    bounds = scan.get("bounds", bounds)
    table_offset = offset + len(materials)
    header = b"BSQTRIS\n" + struct.pack(
        "<IIQQQQ3d6fQQQIIQQ", _version(scan), scan["attributes"], triangles, len(parts),
        *map(int, scan["counts"]), *scan["origin"], *bounds.ravel(), offset, table_offset,
        table_offset + len(table), len(scan["materials"]), 0, checksum(materials), checksum(table))
    return header + struct.pack("<Q", checksum(header)) + images + b"".join(parts) + materials + table


# ---- odd properties ----

def _odd_path(random, scan):
    path = random.choice([b"", b"a.png", b"/", b"//h/a.png", b"/a\n", b"http://h/a.png",
                          b"/a\0b", b"/" + b"x" * 5000])
    scan["materials"].append((random.random(3), bytes(path)))


def _odd_diffuse(random, scan):
    value = random.choice([-1.0, 2.0, 1e30, numpy.inf, numpy.nan])
    scan["materials"].append(([0.5, value, 0.5], None))


def _odd_name(random, scan):
    flags, name = int(random.choice([0, 1, 2])), random.choice([b"", b"a", b"a\0b", b"x" * 5000])
    scan["ids"] = int(random.choice([0, 1, 3, 4]))
    scan["materials"].append(([0.5, 0.5, 0.5], None, flags, bytes(name)))


def _odd_channel(random, scan):
    name = random.choice([b"", b"a", b"A", b"1", b"a\0", b"x" * 5000])
    scan["channels"] = [b"a"] * int(random.integers(0, 2)) + [bytes(name)]
    odd = random.choice([numpy.nan, numpy.inf, 1.0])
    sources = [((odd, 0, 0), int(random.choice([0, 2, 3])), (1, odd, 0, 0), None)
               for _ in scan["channels"]]
    scan["materials"] = [([0.5, 0.5, 0.5], None, 0, b"", (1, 1, 0, odd), sources)]
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
        names = [n for n in ("normals", "colors", "materials", "texcoords") if n in chunk]
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
    if len(data) < 152:
        return
    struct.pack_into("<Q", data, 112, len(data))
    materials, table = struct.unpack_from("<QQ", data, 96)
    if materials <= table <= len(data):
        first, = struct.unpack_from("<Q", data, table) if len(data) - table >= 8 else (152,)
        if data[8] == 5 and 160 <= first <= materials:
            struct.pack_into("<Q", data, first - 8, checksum(data[152:first - 8]))
        for at in range(table, len(data) - 55, 56):
            _mend_chunk(data, materials, *struct.unpack_from("<QQ", data, at))
        struct.pack_into("<QQ", data, 128, checksum(data[materials:table]), checksum(data[table:]))
    struct.pack_into("<Q", data, 144, checksum(data[:144]))


def _mend_chunk(data, end, offset, size):
    if 8 <= size <= end and offset <= end - size:
        struct.pack_into("<Q", data, offset, checksum(data[offset + 8:offset + size]))

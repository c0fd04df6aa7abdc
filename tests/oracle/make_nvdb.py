"""Makes random .nvdb grids from formats/FORMATS.md: sound ones, and ones with one odd property."""
import struct
import zlib
from types import SimpleNamespace

import numpy

import read_nvdb
from read_nvdb import CLASS, GRID, ROOT, ROOT_BYTES, TREE, TYPE, VERSION
from refusal import checksum


def _planes(random, count, marks):
    d = random.integers(-28377, 28378, count).astype("<i2").view("<u2").astype("<u4")
    inconsistent = random.integers(0, 2, count)
    noise = random.integers(0, 8, count) * (1 - inconsistent)
    coverage = random.integers(0, 256, count)
    return (d | coverage << 16 | marks << 24 | inconsistent << 25 | noise << 26).astype("<u4")


def _positions(random):
    """Returns distinct voxels in clumps, some at the ends of the coordinate range."""
    clumps = []
    for _ in range(random.integers(1, 4)):
        centre = random.choice([0, 5, 127, 128, -1, 4095, 4096, -4096, 2**31 - 9, -2**31 + 8], 3)
        if random.random() < 0.7:
            centre = random.integers(-500, 500, 3)
        clumps.append(centre + random.integers(-8, 9, (random.integers(1, 40), 3)))
    return numpy.unique(numpy.concatenate(clumps), axis=0)


def _bit(positions, node_log2, log2):
    """Returns the number of the child or voxel that has these positions."""
    a = positions >> node_log2 - log2 & (1 << log2) - 1
    return a[:, 0] << 2 * log2 | a[:, 1] << log2 | a[:, 2]


def _keys(positions):
    parts = (positions & 0xFFFFFFFF) >> 12
    return parts[:, 0] << 42 | parts[:, 1] << 21 | parts[:, 2]


def _sort(positions):
    """Returns the positions in the order of the file."""
    keys = [_bit(positions, 3, 3), _bit(positions, 7, 4), _bit(positions, 12, 5), _keys(positions)]
    return positions[numpy.lexsort(keys)]


def make(random):
    """Returns a random grid that encode() takes."""
    positions = _sort(_positions(random))
    voxels = len(positions)
    marks = (random.random(voxels) < random.choice([0, 0.2, 1])).astype(int)
    seconds = int(marks.sum())
    records = 1 + voxels + seconds
    color = (random.integers(0, 1 << 24, records) | 0xFF000000).astype("<u4")
    color[random.random(records) < 0.1] = 0
    normal = random.integers(-32767, 32768, (records, 2)).astype("<i2").view("<u4").ravel()
    plane = _planes(random, records, numpy.r_[0, marks, numpy.zeros(seconds, int)])
    normal[0] = plane[0] = color[0] = 0
    ids = (random.integers(0, 1 << 24, records) | 0xFF000000).astype("<u4")
    ids[0] = 0
    names = struct.pack("<II", 1, 3) + b"\0\0\0\0\1\0\0\0a\4\0\0\0a \xc3\xa9"
    channels = random.choice(["", "roughness", "coat,metallic", "emission"])
    words = read_nvdb.values_of(channels.split(",")) if channels else 0
    values = random.normal(0, 1, (records, words)).astype("<f4")
    values[0] = 0
    return SimpleNamespace(
        channels=str(channels), words=words, values=values,
        has_ids=bool(random.integers(0, 2)), id=ids,
        names=names if random.integers(0, 2) else struct.pack("<II", 3, 0),
        version=VERSION, positions=positions, has_second=marks,
        has_color=bool(random.integers(0, 2)), normal=normal, plane=plane, color=color,
        voxel_size=float(random.choice([1, 0.1, 3e-39, 1e39, 7e-308, 5e307])),
        translation=[float(t) for t in random.choice([0, -0.5, 1e6 / 3, 1e-320, -1e300], 3)],
        scan_bounds=numpy.sort(random.normal(0, 1, 6)), triangles=int(random.integers(0, 1 << 62)),
        trailer_version=None)  # an odd one, or that of what the grid has


# ---- nodes ----

def _groups(keys):
    """Returns where runs of equal rows begin, and the run of each row."""
    keys = keys.reshape(len(keys), -1)
    new = numpy.r_[True, (keys[1:] != keys[:-1]).any(axis=1)]
    return numpy.flatnonzero(new), numpy.cumsum(new) - 1


def _pack_bits(rows, bits, row_count, bit_count):
    mask = numpy.zeros((row_count, bit_count), "u1")
    mask[rows, bits] = 1
    return numpy.packbits(mask, axis=1, bitorder="little")


def _encode_leaves(positions):
    starts, leaf = _groups(positions >> 3)
    layout = numpy.dtype([("low", "<i4", 3), ("extent", "u1", 3), ("flags", "u1"),
                          ("mask", "u1", 64), ("first", "<u8"), ("sums", "<u8")])
    leaves = numpy.zeros(len(starts), layout)
    bits = _bit(positions, 3, 3)
    low = numpy.minimum.reduceat(positions, starts)
    high = numpy.maximum.reduceat(positions, starts)
    leaves["low"], leaves["extent"], leaves["flags"] = low, high - low, 2
    leaves["mask"] = _pack_bits(leaf, bits, len(starts), 512)
    leaves["first"] = 1 + starts
    for k in range(7):
        counts = numpy.bincount(leaf[bits >> 6 <= k], minlength=len(starts)).astype("u8")
        leaves["sums"] |= counts << numpy.uint64(9 * k)
    return leaves.tobytes(), positions[starts], low, high


def _encode_level(children, low, high, node_log2, log2, child_bytes, node_bytes):
    """Returns the nodes above `children`, whose bounds are low and high."""
    starts, node = _groups(children >> node_log2)
    count, child_count = len(starts), 1 << 3 * log2
    layout = numpy.dtype([("low", "<i4", 3), ("high", "<i4", 3), ("flags", "<u8"),
                          ("values", "u1", child_count // 8), ("child", "u1", child_count // 8),
                          ("spare", "u1", 32), ("offsets", "<i8", child_count)])
    nodes = numpy.zeros(count, layout)
    low, high = numpy.minimum.reduceat(low, starts), numpy.maximum.reduceat(high, starts)
    nodes["low"], nodes["high"], nodes["flags"] = low, high, 2
    bits = _bit(children, node_log2, log2)
    nodes["child"] = _pack_bits(node, bits, count, child_count)
    places = count * node_bytes + child_bytes * numpy.arange(len(children))
    nodes["offsets"][node, bits] = places - node_bytes * node
    return nodes.tobytes(), children[starts], low, high


# ---- the file ----

def _encode_second(voxels, has_second):
    words = voxels // 32 + 1
    bits = numpy.zeros(32 * words, "u1")
    bits[1:1 + voxels] = has_second
    packed = numpy.packbits(bits, bitorder="little").view("<u4")
    counts = bits.reshape(-1, 32).sum(axis=1, dtype="u4").cumsum(dtype="u4")
    return numpy.stack([packed, numpy.r_[0, counts[:-1]]], axis=1).astype("<u4").tobytes()


def _diagonal(value):
    return [value, 0, 0, 0, value, 0, 0, 0, value]


def _f32(values):
    with numpy.errstate(all="ignore"):
        return numpy.array(values, "<f8").astype("<f4").tobytes()


def _encode_grid_data(grid, layout, low, high, size):
    h, t = grid.voxel_size, grid.translation
    with numpy.errstate(all="ignore"):
        inverse = float(numpy.float64(1) / numpy.float64(h))
    world = [read_nvdb.world(low[k], h, t[k]) for k in range(3)] + \
        [read_nvdb.world(int(high[k]) + 1, h, t[k]) for k in range(3)]
    data = b"NanoVDB0" + struct.pack("<IIIIIIQ", 0, 0xFFFFFFFF, grid.version, 34, 0, 1, size - GRID)
    data += b"surface".ljust(256, b"\0")
    data += _f32(_diagonal(h) + _diagonal(inverse) + list(t) + [1])
    data += struct.pack("<9d9d3dd6d3d", *_diagonal(h), *_diagonal(inverse), *t, 1, *world, h, h, h)
    return data + struct.pack("<IIqIIQQ", CLASS, TYPE,
                              layout.sections["blind"][0] - GRID,
                              len(read_nvdb.channels_of(layout)), 0, 1 + layout.voxel_count, 0)


def _encode_file_header(grid, layout, body, size):
    data = struct.pack("<QIHHQQQQII", read_nvdb.MAGIC, grid.version, 1, 0, size - GRID,
                       size - GRID, read_nvdb.name_key(b"surface"), layout.voxel_count,
                       TYPE, CLASS)
    data += body[560:608] + body[ROOT - GRID:ROOT - GRID + 24] + body[608:632]
    data += struct.pack("<I4I3IHHI", 32, layout.leaf_count, layout.lower_count,
                        layout.upper_count, 1, 0, 0, 0, 0, 0, grid.version)
    return data + b"surface".ljust(32, b"\0")


def _encode_tree(layout):
    places = [layout.sections[name][0] - TREE for name in ("leaf", "lower", "upper")]
    return struct.pack("<4Q3I3IQ", *places, ROOT - TREE, layout.leaf_count, layout.lower_count,
                       layout.upper_count, 0, 0, 0, layout.voxel_count)


def _encode_root(layout, origins, low, high):
    data = struct.pack("<6iI", *low, *high, layout.upper_count).ljust(ROOT_BYTES, b"\0")
    for i, key in enumerate(_keys(origins)):
        offset = layout.sections["upper"][0] + read_nvdb.UPPER_BYTES * i - ROOT
        data += struct.pack("<Qq16x", int(key), offset)
    return data


def _encode_blind(layout):
    data = b""
    start = layout.sections["blind"][0]
    for name, values, value_bytes, semantic, kind in read_nvdb.channels_of(layout):
        offset = layout.sections[name][0] - start - len(data)
        data += struct.pack("<qQIIII", offset, values, value_bytes, semantic, 4, kind)
        data += name.encode().ljust(256, b"\0")
    return data


def _encode_trailer(grid, layout):
    version, flags = (3, 2) if grid.has_ids else (2, 0)
    if grid.words:
        version, flags = 4, flags + 4
    version = grid.trailer_version or version
    trailer = struct.pack("<IIQQ6d", version, flags + int(grid.has_color), grid.triangles,
                         layout.second_count, *grid.scan_bounds).ljust(160, b"\0")
    return b"BISQUE\r\n" + trailer + struct.pack("<QQQ", layout.name_bytes, 0, 0)


def _channels_head(grid):
    head = struct.pack("<II", grid.words, len(grid.channels)) + grid.channels.encode()
    return head + bytes(-len(head) % 64)


def _layout(grid, uppers, lowers, leaves):
    layout = read_nvdb.Grid()
    layout.has_color, layout.has_ids = grid.has_color, grid.has_ids
    layout.name_bytes = len(grid.names) if grid.has_ids else 0
    layout.words = grid.words
    layout.head_bytes = len(_channels_head(grid)) if grid.words else 0
    layout.upper_count, layout.lower_count, layout.leaf_count = uppers, lowers, leaves
    layout.voxel_count = len(grid.positions)
    layout.second_count = len(grid.normal) - 1 - layout.voxel_count
    layout.record_count = len(grid.normal)
    return layout, read_nvdb.lay_out(layout)


def encode(grid):
    """Returns the bytes of a grid as a bytearray."""
    leaves, children, low, high = _encode_leaves(grid.positions)
    leaf_count = len(children)
    lowers, children, low, high = _encode_level(children, low, high, 7, 4, 96,
                                                read_nvdb.LOWER_BYTES)
    lower_count = len(children)
    uppers, children, low, high = _encode_level(children, low, high, 12, 5,
                                                read_nvdb.LOWER_BYTES, read_nvdb.UPPER_BYTES)
    low, high = low.min(axis=0), high.max(axis=0)
    layout, size = _layout(grid, len(children), lower_count, leaf_count)
    body = _encode_grid_data(grid, layout, low, high, size) + _encode_tree(layout) + \
        _encode_root(layout, children, low, high)
    parts = {"head": _encode_file_header(grid, layout, body, size) + body, "upper": uppers,
             "lower": lowers, "leaf": leaves, "blind": _encode_blind(layout),
             "normal": grid.normal.tobytes(), "plane": grid.plane.tobytes(),
             "color": grid.color.tobytes(),
             "second": _encode_second(layout.voxel_count, grid.has_second),
             "id": grid.id.tobytes(), "names": grid.names,
             "channels": _channels_head(grid) + grid.values.tobytes(),
             "bisque": _encode_trailer(grid, layout)}
    data = bytearray(size)
    for name, (offset, length) in layout.sections.items():
        data[offset:offset + length] = parts[name][:length]
    mend(data, layout)
    return data


# ---- odd properties ----

def _odd_transform(random, grid):
    grid.voxel_size = float(random.choice([0, -1, 1e-320, 1e-308, 5e-309, 5.6e-309, 1.7e308, 1e300,
                                           2.0]))


def _odd_translation(random, grid):
    grid.translation[random.integers(0, 3)] = float(random.choice([-0.0, 1.7e308, -1.7e308, 5e-324]))


def _odd_scan_bounds(random, grid):
    at = random.integers(0, 6)
    grid.scan_bounds[at] = random.choice([numpy.inf, numpy.nan, 1e308, -1e308, -0.0])


def _odd_normal(random, grid):
    at = random.integers(0, len(grid.normal))
    grid.normal[at] = random.choice([0, 0x8000, 0x80000000, 0x7FFF7FFF, 0x80018001, 0x12348000])


def _odd_plane(random, grid):
    at = random.integers(0, len(grid.plane))
    if random.random() < 0.5:
        grid.plane[at] ^= numpy.uint32(1 << random.integers(0, 32))
        return
    d = int(random.choice([28377, 28378, 28379, 28500, 28507, 28508, 28509, 32767, 32768]))
    grid.plane[at] = grid.plane[at] & 0xFFFF0000 | random.choice([d, 65536 - d])


def _odd_color(random, grid):
    at = random.integers(0, len(grid.color))
    grid.color[at] = random.choice([0, 1, 0xFF000000, 0xFE000000, 0x00FFFFFF, 0xFFFFFFFF])


def _odd_id(random, grid):
    grid.has_ids = True
    grid.id[random.integers(0, len(grid.id))] = random.choice([0, 0xFE000000, 0xFF000000])


def _odd_names(random, grid):
    names = bytearray(grid.names)
    grid.has_ids = True
    if random.random() < 0.5:
        names[random.integers(0, len(names))] ^= 1 << random.integers(0, 8)
    else:
        names = names[:random.integers(0, len(names) + 1)]
    grid.names = bytes(names)


def _odd_values(random, grid):
    if grid.words:
        at = random.integers(0, len(grid.values))
        grid.values[at, 0] = random.choice([numpy.inf, numpy.nan, -1.0, -0.0, 3e38])


def _odd_list(random, grid):
    if grid.words:
        grid.channels = random.choice(["Rough", "a,,b", "roughness,", "1", "a_1,b", "metallic"])
        grid.words = random.choice([grid.words, read_nvdb.values_of(grid.channels.split(","))])
        grid.values = numpy.zeros((len(grid.normal), grid.words), "<f4")


def _odd_trailer_version(random, grid):
    grid.trailer_version = int(random.integers(1, 6))


def _odd_marks(random, grid):
    at = random.integers(0, len(grid.has_second))
    grid.has_second[at] ^= 1


ODD = [_odd_transform, _odd_translation, _odd_scan_bounds, _odd_normal, _odd_plane, _odd_color,
       _odd_id, _odd_names, _odd_values, _odd_list, _odd_trailer_version, _odd_marks]


def make_odd(random, grid):
    """Gives a grid one odd property, which may make it unsound."""
    ODD[random.integers(0, len(ODD))](random, grid)


# ---- checksums ----

def mend(data, layout):
    """Corrects the checksums of a damaged grid, a bytearray, in sections where `layout` has them."""
    names = ["head", "upper", "lower", "leaf", "blind", "normal", "plane", "color", "second"]
    names += [name for name in ("id", "names") if name in layout.sections]
    head_end = sum(layout.sections["head"])
    if len(data) < head_end + 192:
        return
    struct.pack_into("<I", data, GRID + 8, zlib.crc32(data[GRID + 16:head_end]))
    trailer = len(data) - 192
    for i, name in enumerate(names):
        offset, size = layout.sections.get(name, (0, 0))
        struct.pack_into("<Q", data, trailer + 80 + 8 * i, checksum(data[offset:offset + size]))
    if "channels" in layout.sections:
        offset, size = layout.sections["channels"]
        struct.pack_into("<Q", data, trailer + 176, checksum(data[offset:offset + size]))
    struct.pack_into("<Q", data, trailer + 184, checksum(data[trailer:trailer + 184]))

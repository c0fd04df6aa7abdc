"""Reads .nvdb grids, written from formats/FORMATS.md alone.

read(data, verify) returns the content or raises Refused. With verify=False it makes the checks
that FORMATS.md asks of a reader that opens a grid and follows its offsets, with verify=True also
those of a reader that verifies the whole file.
"""
import re
import struct
import zlib
from dataclasses import dataclass
from fractions import Fraction

import numpy

from refusal import array, checksum, fields, has_minus_32768, is_finite, is_zero, need

VERSION = 32 << 21 | 4 << 10 | 2
TYPE, CLASS = 8, 6
GRID, TREE, ROOT, ROOT_BYTES = 224, 896, 960, 64
UPPER_BYTES, LOWER_BYTES, LEAF_BYTES, TILE_BYTES, BLIND_BYTES = 270400, 33856, 96, 32, 288
TRAILER_BYTES = 192
MAGIC = int.from_bytes(b"NanoVDB0", "little")
NAME = b"surface"


@dataclass
class Level:
    """The nodes of a level that have children, as arrays over all nodes."""
    place: numpy.ndarray  # offset of each node in the file
    low: numpy.ndarray
    high: numpy.ndarray
    flags: numpy.ndarray
    value_mask: numpy.ndarray
    child_mask: numpy.ndarray  # a byte for each bit
    spare: numpy.ndarray
    children: numpy.ndarray


class Grid:
    """A grid: the counts upper_count, lower_count, leaf_count, voxel_count, second_count, and
    offsets of sections in the file."""


# ---- the order of sections ----

def _aligned(offset):
    return (offset + 63) // 64 * 64


def channels_of(grid):
    """Returns name, values, bytes, semantic and type of each channel."""
    n = grid.record_count
    table = [("normal", n, 4, 3, 10), ("plane", n, 4, 0, 10), ("color", n, 4, 2, 12),
             ("second", 2 * (grid.voxel_count // 32 + 1), 4, 0, 10), ("id", n, 4, 0, 10),
             ("names", grid.name_bytes, 1, 0, 0),
             ("channels", (grid.head_bytes // 4 + n * grid.words), 4, 0, 10),
             ("bisque", TRAILER_BYTES, 1, 0, 0)]
    missing = ([] if grid.has_color else ["color"]) + ([] if grid.has_ids else ["id", "names"]) + \
        ([] if grid.words else ["channels"])
    return [row for row in table if row[0] not in missing]


def lay_out(grid):
    """Computes offset and size of each section, and the size of the file."""
    at = 0
    grid.sections = {}
    for name, size in (("head", ROOT + ROOT_BYTES + TILE_BYTES * grid.upper_count),
                       ("upper", UPPER_BYTES * grid.upper_count),
                       ("lower", LOWER_BYTES * grid.lower_count),
                       ("leaf", LEAF_BYTES * grid.leaf_count),
                       ("blind", BLIND_BYTES * len(channels_of(grid)))):
        grid.sections[name] = (at, size)
        at += size
    for name, values, value_bytes, _, _ in channels_of(grid):
        at = _aligned(at)
        grid.sections[name] = (at, values * value_bytes)
        at += values * value_bytes
    return at


# ---- the head of the file ----

def _read_counts(data, grid):
    need(len(data) >= ROOT + 64 + TRAILER_BYTES, "too short for a grid")
    magic, version = fields(data, 0, "QI")
    need(magic == MAGIC, "magic of the file header")
    need(version == VERSION, f"version {version >> 21}.{version >> 10 & 2047}.{version & 1023}")
    need(fields(data, 48, "II") == (TYPE, CLASS), "type of the file header")
    grid.leaf_count, grid.lower_count, grid.upper_count, _ = fields(data, 156, "4I")
    grid.voxel_count, = fields(data, 40, "Q")


def _read_trailer(data, grid):
    trailer = data[-TRAILER_BYTES:]
    magic, version, flags, grid.triangle_count, grid.second_count = fields(trailer, 0, "8sIIQQ")
    need(magic == b"BISQUE\r\n", "no bisque trailer at the end")
    need(version in (2, 3, 4), f"bisque trailer of version {version}")
    need(fields(trailer, 184, "Q")[0] == checksum(trailer[:184]), "checksum of the bisque trailer")
    need(flags < 8 and version == (4 if flags & 4 else 3 if flags & 2 else 2),
         "flags of the bisque trailer")
    grid.has_color, grid.has_ids, grid.has_channels = (bool(flags & bit) for bit in (1, 2, 4))
    grid.words = grid.head_bytes = 0
    grid.scan_bounds = fields(trailer, 32, "6d")
    need(is_finite(grid.scan_bounds), "bounds of the high-poly mesh are not finite")
    need(all(grid.scan_bounds[k] <= grid.scan_bounds[3 + k] for k in range(3)),
         "bounds of the high-poly mesh are inverted")
    grid.checksums = fields(trailer, 80, "11Q")
    grid.name_bytes, = fields(trailer, 168, "Q")
    grid.channels_checksum, = fields(trailer, 176, "Q")
    need(grid.has_channels or grid.channels_checksum == 0, "zeros of the bisque trailer")
    need(grid.has_ids or is_zero(trailer[152:176]), "checksums without ids")
    need(grid.name_bytes <= len(data), "bytes of the names")
    grid.record_count = 1 + grid.voxel_count + grid.second_count


SINGLE = ("roughness", "metallic", "sheen", "clearcoat", "clearcoat_roughness", "anisotropy",
          "anisotropy_rotation", "shininess", "opacity", "occlusion", "displacement")


def values_of(names):
    return sum(1 if name in SINGLE else 3 for name in names)


def _read_list(data, grid):
    """Reads the names of further channels, which begin where the section before them ends."""
    if not grid.has_channels:
        return
    grid.words = 1  # at least; where the section begins does not depend on it
    lay_out(grid)
    at, _ = grid.sections["channels"]
    need(at + 8 <= len(data), "channels are cut off")
    words, size = fields(data, at, "II")
    head = _aligned(8 + size)
    need(at + head <= len(data), "list of channels is cut off")
    text = bytes(data[at + 8:at + 8 + size])
    need(re.fullmatch(rb"[a-z][a-z0-9_]*(,[a-z][a-z0-9_]*)*", text), "list of channels")
    names = text.decode().split(",")
    need(words == values_of(names) <= 65535, "number of values of channels")
    need(is_zero(data[at + 8 + size:at + head]), "zeros after the list of channels")
    grid.words, grid.head_bytes, grid.channel_names = words, head, names


def _check_limits(grid):
    u, l, f, v, s = (grid.upper_count, grid.lower_count, grid.leaf_count, grid.voxel_count,
                     grid.second_count)
    need(1 <= u <= l <= f <= v and v <= 512 * f and s <= v and s < 1 << 32, "limits of the counts")


def name_key(name):
    key = 0
    for c in name:
        key = (67 * key + c + (key >> 56)) % (1 << 64)
    return key


def _check_file_header(data, grid):
    grid_bytes = len(data) - GRID
    need(fields(data, 12, "HH") == (1, 0), "number of grids or codec")
    need(fields(data, 16, "QQ") == (grid_bytes, grid_bytes), "bytes of the grid")
    need(data[192:224] == NAME.ljust(32, b"\0"), "name of the file header")
    need(fields(data, 32, "Q")[0] == name_key(NAME), "key of the name")
    need(fields(data, 152, "I")[0] == 32, "bytes of the name")
    need(fields(data, 168, "4I") == (1, 0, 0, 0), "root count or active tiles of the file header")
    need(fields(data, 184, "HHI") == (0, 0, VERSION), "end of the file header")
    need(data[56:104] == data[GRID + 560:GRID + 608], "world bounds of the file header")
    need(data[104:128] == data[ROOT:ROOT + 24], "index bounds of the file header")
    need(data[128:152] == data[GRID + 608:GRID + 632], "voxel size of the file header")


def _check_grid_data(data, grid):
    blind_offset, _ = grid.sections["blind"]
    need(fields(data, GRID, "Q")[0] == MAGIC, "magic of GridData")
    need(fields(data, GRID + 16, "I")[0] == VERSION, "version of GridData")
    need(fields(data, GRID + 632, "II") == (CLASS, TYPE), "type of GridData")
    need(data[GRID + 40:GRID + 296] == NAME.ljust(256, b"\0"), "name of GridData")
    need(fields(data, GRID + 24, "II") == (0, 1), "index or number of grids")
    need(fields(data, GRID + 32, "Q")[0] == len(data) - GRID, "bytes of GridData")
    need(fields(data, GRID + 640, "qII") == (blind_offset - GRID, len(channels_of(grid)), 0),
         "place or number of blind metadata")
    need(fields(data, GRID + 656, "QQ") == (1 + grid.voxel_count, 0), "values or data2")
    end = sum(grid.sections["head"])
    stored, full = fields(data, GRID + 8, "II")
    need(stored == zlib.crc32(data[GRID + 16:end]), "CRC-32")
    need(full == 0xFFFFFFFF, "checksum of the nodes")
    need(fields(data, GRID + 20, "I")[0] == 34, "flags of GridData")


def _check_tree(data, grid):
    places = [grid.sections[s][0] - TREE for s in ("leaf", "lower", "upper")] + [ROOT - TREE]
    need(list(fields(data, TREE, "4Q")) == places, "places of TreeData")
    counts = (grid.leaf_count, grid.lower_count, grid.upper_count, 0, 0, 0, grid.voxel_count)
    need(fields(data, TREE + 32, "6IQ") == counts, "counts of TreeData")
    need(fields(data, ROOT + 24, "I")[0] == grid.upper_count, "upper nodes of RootData")
    need(is_zero(data[ROOT + 28:ROOT + ROOT_BYTES]), "zeros of RootData")


def _read_transform(data, grid):
    matrix = fields(data, GRID + 384, "9d")
    grid.voxel_size, grid.translation = matrix[0], fields(data, GRID + 528, "3d")
    need(is_finite(matrix + grid.translation), "transform is not finite")
    with numpy.errstate(all="ignore"):
        inverse = numpy.float64(1) / numpy.float64(grid.voxel_size)
    need(grid.voxel_size > 0 and inverse > 0 and is_finite(inverse), "edge of a voxel")
    doubles = _diagonal(grid.voxel_size) + _diagonal(inverse) + grid.translation + (1,)
    with numpy.errstate(all="ignore"):
        singles = numpy.array(doubles).astype("<f4").tobytes()
    need(data[GRID + 384:GRID + 560] == struct.pack("<22d", *doubles), "f64 transform")
    need(data[GRID + 296:GRID + 384] == singles, "f32 transform")
    need(data[GRID + 608:GRID + 632] == struct.pack("<3d", *(grid.voxel_size,) * 3), "voxel size")


def _diagonal(value):
    return (value, 0, 0, 0, value, 0, 0, 0, value)


def world(index, size, translation):
    """Returns index * size + translation, rounded once."""
    exact = Fraction(int(index)) * Fraction(size) + Fraction(translation)
    try:
        return float(exact)
    except OverflowError:
        return float("inf") if exact > 0 else float("-inf")


def _check_world_bounds(data, grid):
    low = tuple(world(grid.low[k], grid.voxel_size, grid.translation[k]) for k in range(3))
    high = tuple(world(int(grid.high[k]) + 1, grid.voxel_size, grid.translation[k])
                 for k in range(3))
    need(data[GRID + 560:GRID + 608] == struct.pack("<6d", *low, *high), "world bounds")


def _check_blind_metadata(data, grid):
    at, _ = grid.sections["blind"]
    for name, values, value_bytes, semantic, kind in channels_of(grid):
        offset = grid.sections[name][0] - at
        need(fields(data, at, "qQIIII") == (offset, values, value_bytes, semantic, 4, kind),
             f"blind metadata of {name}")
        need(data[at + 32:at + BLIND_BYTES] == name.encode().ljust(256, b"\0"),
             f"name of the blind metadata of {name}")
        at += BLIND_BYTES


# ---- nodes ----

def _read_level(data, section, count, node_bytes, child_count):
    offset, _ = section
    layout = numpy.dtype([("low", "<i4", 3), ("high", "<i4", 3), ("flags", "<u8"),
                          ("values", "u1", child_count // 8), ("child", "u1", child_count // 8),
                          ("spare", "u1", 32), ("offsets", "<i8", child_count)])
    nodes = numpy.frombuffer(data, layout, count, offset)
    bits = numpy.unpackbits(nodes["child"], axis=1, bitorder="little")
    place = offset + node_bytes * numpy.arange(count, dtype="i8")
    return Level(place, nodes["low"], nodes["high"], nodes["flags"], nodes["values"], bits,
                 nodes["spare"], nodes["offsets"])


def _check_children(level, child_offset, child_bytes, child_count, what):
    """Checks that the set bits of a level number the nodes of the next, in order."""
    need(not level.value_mask.any(), f"value mask of {what}")
    need(level.child_mask.any(axis=1).all(), f"{what} without children")
    parent, bit = numpy.nonzero(level.child_mask)
    need(len(parent) == child_count, f"number of children of {what}")
    children = child_offset + child_bytes * numpy.arange(child_count, dtype="i8")
    need((level.children[parent, bit] == children - level.place[parent]).all(),
         f"offsets of children of {what}")
    return parent, bit


def _verify_level(level, what):
    """Checks bytes of nodes that no reader has to follow."""
    need((level.flags == 2).all(), f"flags of {what}")
    need(not level.spare.any(), f"zeros of {what}")
    need(not level.children[level.child_mask == 0].any(), f"offsets without a child of {what}")


def _unpack_bit(bit, log2):
    side = (1 << log2) - 1
    return numpy.stack([bit >> 2 * log2, bit >> log2 & side, bit & side], axis=1)


def _check_bounds(level, parent, low, high, what):
    """Checks that the bounds of each node are those of its children."""
    first = numpy.flatnonzero(numpy.r_[True, parent[1:] != parent[:-1]])
    need((numpy.minimum.reduceat(low, first) == level.low).all() and
         (numpy.maximum.reduceat(high, first) == level.high).all(), f"bounds of {what}")


def _read_tiles(data, grid):
    tiles = array(data, ROOT + ROOT_BYTES, "u8", grid.upper_count, 4)
    keys = [int(key) for key in tiles[:, 0]]
    need(all(a < b for a, b in zip(keys, keys[1:])), "tile keys do not ascend")
    grid.origins = []
    for i, key in enumerate(keys):
        parts = [key >> 42, key >> 21 & 0x1FFFFF, key & 0x1FFFFF]
        need(all(p < 1 << 20 for p in parts), "tile key")
        grid.origins.append([(p ^ 1 << 19) - (1 << 19) << 12 for p in parts])
        offset = grid.sections["upper"][0] + UPPER_BYTES * i - ROOT
        need(int(tiles[i, 1]) == offset, "offset of a tile")
    need(not tiles[:, 2:].any(), "zeros of a tile")


def _read_leaves(data, grid, origins):
    layout = numpy.dtype([("low", "<i4", 3), ("extent", "u1", 3), ("flags", "u1"),
                          ("mask", "u1", 64), ("first", "<u8"), ("sums", "<u8")])
    offset, _ = grid.sections["leaf"]
    leaves = numpy.frombuffer(data, layout, grid.leaf_count, offset)
    need((leaves["flags"] == 2).all(), "flags of a leaf")
    bits = numpy.unpackbits(leaves["mask"], axis=1, bitorder="little")
    need(bits.any(axis=1).all(), "leaf without voxels")
    counts = bits.reshape(-1, 8, 64).sum(axis=2, dtype="u8").cumsum(axis=1, dtype="u8")
    sums = sum(counts[:, k] << numpy.uint64(9 * k) for k in range(7))
    need((leaves["sums"] == sums).all(), "prefix sums of a leaf")
    ends = counts[:, 7].cumsum(dtype="u8")
    need(int(ends[-1]) == grid.voxel_count, "number of voxels in leaves")
    need((leaves["first"] == ends - counts[:, 7] + 1).all(), "first value index of a leaf")
    leaf, bit = numpy.nonzero(bits)
    grid.voxels = origins[leaf] + _unpack_bit(bit, 3)
    grid.voxel_leaf = leaf
    first = numpy.flatnonzero(numpy.r_[True, leaf[1:] != leaf[:-1]])
    low = numpy.minimum.reduceat(grid.voxels, first)
    high = numpy.maximum.reduceat(grid.voxels, first)
    need((leaves["low"] == low).all(), "lower bounds of a leaf")
    need((leaves["extent"] == high - low).all(), "extent of a leaf")
    return low, high


def _read_nodes(data, grid):
    _read_tiles(data, grid)
    upper = _read_level(data, grid.sections["upper"], grid.upper_count, UPPER_BYTES, 32768)
    upper_of, bit = _check_children(upper, grid.sections["lower"][0], LOWER_BYTES,
                                    grid.lower_count, "an upper node")
    lower_origins = numpy.array(grid.origins, "i8")[upper_of] + 128 * _unpack_bit(bit, 5)
    lower = _read_level(data, grid.sections["lower"], grid.lower_count, LOWER_BYTES, 4096)
    lower_of, bit = _check_children(lower, grid.sections["leaf"][0], LEAF_BYTES, grid.leaf_count,
                                    "a lower node")
    low, high = _read_leaves(data, grid, lower_origins[lower_of] + 8 * _unpack_bit(bit, 4))
    _check_bounds(lower, lower_of, low, high, "a lower node")
    _check_bounds(upper, upper_of, lower.low, lower.high, "an upper node")
    grid.levels = {"an upper node": upper, "a lower node": lower}
    grid.low, grid.high = array(data, ROOT, "i4", 2, 3)
    need((grid.low == upper.low.min(axis=0)).all() and
         (grid.high == upper.high.max(axis=0)).all(), "bounds of RootData")


# ---- names ----

def _read_names(data, grid):
    grid.ids, grid.names = 0, []
    if not grid.has_ids:
        return
    offset, size = grid.sections["names"]
    part, at = data[offset:offset + size], 8
    need(size >= 8, "names are cut off")
    grid.ids, count = fields(part, 0, "II")
    need(1 <= grid.ids <= 3 and (grid.ids < 3 or count == 0), "unknown ids")
    for _ in range(count):
        need(size - at >= 4, "names are cut off")
        length, = fields(part, at, "I")
        at += 4
        need(size - at >= length, "a name is cut off")
        grid.names.append(bytes(part[at:at + length]))
        need(0 not in grid.names[-1], "zero byte in a name")
        need(len(grid.names) < 2 or grid.names[-2] < grid.names[-1], "order of the names")
        at += length
    need(at == size, "names do not fill their section")


# ---- channels ----

def _read_channels(data, grid):
    grid.channels = {}
    for name, values, value_bytes, _, _ in channels_of(grid):
        if name == "channels":
            offset, size = grid.sections[name]
            grid.channels[name] = array(data, offset + grid.head_bytes, "f4",
                                        grid.record_count, grid.words)
        elif value_bytes == 4:
            grid.channels[name] = array(data, grid.sections[name][0], "u4", values)
    second = grid.channels["second"].reshape(-1, 2)
    bits = numpy.unpackbits(numpy.ascontiguousarray(second[:, :1]).view("u1"), axis=1,
                            bitorder="little")
    ends = bits.sum(axis=1, dtype="u8").cumsum(dtype="u8")
    need(int(ends[-1]) == grid.second_count, "number of bits of second")
    need((second[1:, 1] == ends[:-1]).all() and second[0, 1] == 0, "ranks of second")
    has_second = bits.ravel()
    need(not has_second[0] and not has_second[1 + grid.voxel_count:].any(),
         "bits of second for value indices that do not exist")
    grid.second_of = numpy.flatnonzero(has_second)
    grid.has_second = has_second[:1 + grid.voxel_count].astype(bool)


def _verify_channels(grid):
    normal, plane = grid.channels["normal"], grid.channels["plane"]
    v = grid.voxel_count
    need(normal[0] == 0 and plane[0] == 0, "background is not 0")
    need(not has_minus_32768(normal), "-32768 in a normal")
    need((plane >> 29 == 0).all(), "bits 29-31 of a plane")
    need(((plane[:v + 1] >> 24 & 1) == grid.has_second).all(), "bit 24 of a plane")
    need(not (plane[v + 1:] >> 24 & 1).any(), "bit 24 of a second record")
    need(not (plane >> 26 & 7)[plane >> 25 & 1 == 1].any(), "facet-noise weight with bit 25")
    d = numpy.abs((plane & 0xFFFF).astype("u2").view("i2").astype(int))
    need((d <= 28507).all(), "distance of a plane")
    if grid.has_ids:
        need(grid.channels["id"][0] == 0, "background has an id")
        need((grid.channels["id"][1:] >> 24 == 255).all(), "an id is not opaque")
    if grid.words:
        values = grid.channels["channels"]
        need(not values[0].view("u4").any(), "background has channels")
        need(numpy.isfinite(values).all(), "a channel is not finite")
    if grid.has_color:
        color = grid.channels["color"]
        need(color[0] == 0, "background has a colour")
        need(((color >> 24 == 255) | (color == 0)).all(), "a colour is not opaque")


def _verify_checksums(data, grid):
    names = ("head", "upper", "lower", "leaf", "blind", "normal", "plane", "color", "second",
             "id", "names")
    for name, stored in zip(names if grid.has_ids else names[:9], grid.checksums):
        offset, size = grid.sections.get(name, (0, 0))
        need(stored == checksum(data[offset:offset + size]), f"checksum of {name}")
    if grid.words:
        offset, size = grid.sections["channels"]
        need(grid.channels_checksum == checksum(data[offset:offset + size]),
             "checksum of channels")


def _verify_padding(data, grid):
    end = 0
    for offset, size in grid.sections.values():
        need(is_zero(data[end:offset]), "padding between sections")
        end = offset + size


def read(data, verify):
    """Returns the Grid of a file, or raises Refused."""
    grid = Grid()
    _read_counts(data, grid)
    _read_trailer(data, grid)
    _check_limits(grid)
    _read_list(data, grid)
    need(lay_out(grid) == len(data), "length of the file")
    _check_file_header(data, grid)
    _check_grid_data(data, grid)
    _check_tree(data, grid)
    _read_transform(data, grid)
    _check_blind_metadata(data, grid)
    _read_names(data, grid)
    _read_nodes(data, grid)
    _check_world_bounds(data, grid)
    _read_channels(data, grid)
    if verify:
        _verify_checksums(data, grid)
        _verify_padding(data, grid)
        for what, level in grid.levels.items():
            _verify_level(level, what)
        _verify_channels(grid)
    return grid

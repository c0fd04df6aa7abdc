#!/usr/bin/env python3
"""measure.py FILE [POINTS], measure.py --triangles FILE, measure.py --damage FILE STEP

Reads a .tris or .nvdb file completely and prints what is in it, a value a line: its name and its
numbers. For the points of a text file ("x y z" or "x y z red green blue", colours from 0 to 1),
prints how many are in a voxel of the grid, and how far they are from its plane and colour. With
--triangles, prints the triangles of a chunk file, the least corner first, normals last. With
--damage, changes every STEP-th byte, and the length, and prints where the reader did not notice.

The exit status is 65 if the file is not as formats/FORMATS.md says.
"""
import sys

import numpy
import xxhash

import read_file
from content import second_numbers
from refusal import Refused


def show(name, *values):
    """Prints a line."""
    print(name, *(f"{v:.17g}" if isinstance(v, float) else v for v in values))


def decode_normals(packed):
    """Returns unit vectors of octahedral normals."""
    x, y = (numpy.maximum(numpy.asarray(packed, "<u4")[..., None].view("<i2") / 32767, -1.0)
            .swapaxes(0, -1).reshape(2, -1))
    z = 1 - abs(x) - abs(y)
    below = z < 0
    x, y = (numpy.where(below, (1 - abs(y)) * numpy.where(x < 0, -1, 1), x),
            numpy.where(below, (1 - abs(x)) * numpy.where(y < 0, -1, 1), y))
    n = numpy.stack([x, y, z], axis=1)
    return n / numpy.linalg.norm(n, axis=1, keepdims=True)


# ---- chunk files ----

def _least_first(chunk):
    """Returns the triangles of a chunk, each turned so that its least corner comes first."""
    t = chunk.triangles.astype(int)
    rank = numpy.empty(len(chunk.positions), int)
    rank[numpy.lexsort(chunk.positions.T[::-1])] = numpy.arange(len(rank))
    turn = rank[t].argmin(axis=1)
    return t[numpy.arange(len(t))[:, None], (turn[:, None] + numpy.arange(3)) % 3]


def _print_triangles(content):
    origin = numpy.array(content.header.origin)
    for chunk in content.chunks:
        t = _least_first(chunk)
        columns = [(origin + chunk.positions.astype(float))[t].reshape(len(t), 9)]
        line = "%.6f " * 9
        if chunk.texcoords is not None:
            columns.append(chunk.texcoords.astype(float)[t].reshape(len(t), 6))
            line += "%.6f " * 6
        if chunk.colors is not None:
            columns.append(numpy.stack([chunk.colors[t] >> 8 * k & 255 for k in range(3)], 2)
                           .reshape(len(t), 9))
            line += "%d " * 9
        if chunk.materials is not None:
            columns.append(chunk.materials[:, None])
            line += "m%d "
        line += "|"
        if chunk.normals is not None:
            columns.append(decode_normals(chunk.normals)[t].reshape(len(t), 9))
            line += " %.6f" * 9
        numpy.savetxt(sys.stdout, numpy.concatenate(columns, axis=1), line)


def _raw_triangles(chunk):
    """Returns the bits of each triangle's corners and its material."""
    t = _least_first(chunk)
    streams = [chunk.positions, chunk.texcoords, chunk.normals, chunk.colors]
    rows = [numpy.ascontiguousarray(s).view("<u4").reshape(len(s), -1)[t].reshape(len(t), -1)
            for s in streams if s is not None]
    if chunk.materials is not None:
        rows.append(chunk.materials[:, None])
    return numpy.concatenate(rows, axis=1)


def _print_materials(content):
    for diffuse, path, _, _, _, sources in content.materials:
        show("material", *(f"{c:g}" for c in diffuse), (path or b"none").decode())
        for value, component, _, texture in sources:
            show("source", *(f"{c:g}" for c in value), "component", component,
                 (texture or b"none").decode())


def _measure_tris(content):
    header, area, volume = content.header, 0.0, 0.0
    for chunk in content.chunks:
        a, b, c = chunk.positions.astype(float)[_least_first(chunk)].swapaxes(0, 1)
        n = numpy.cross(b - a, c - a)
        area += numpy.linalg.norm(n, axis=1).sum() / 2
        volume += (a * n).sum() / 6
    rows = numpy.concatenate([_raw_triangles(chunk) for chunk in content.chunks])
    rows = rows[numpy.lexsort(rows.T)]
    for name, value in (("attributes", header.attributes), ("chunks", header.chunk_count),
                        ("source_faces", header.source_faces),
                        ("skipped", header.skipped_triangles), ("triangles", len(rows)),
                        ("vertices", sum(len(c.positions) for c in content.chunks)),
                        ("area", float(area)), ("volume", float(volume)),
                        ("hash", xxhash.xxh3_64_hexdigest(rows.tobytes()))):
        show(name, value)
    show("origin", *header.origin)
    for name, bound in (("min", header.bounds_min), ("max", header.bounds_max)):
        show(name, *(o + b for o, b in zip(header.origin, bound)))
    _print_materials(content)


# ---- grids ----

def _offsets(plane):
    return (plane & 0xFFFF).astype("<u2").view("<i2") / 32767


def _measure_nvdb(grid):
    one = slice(1, 1 + grid.voxel_count)
    plane = grid.channels["plane"][one]
    for name, value in (("color", int(grid.has_color)),
                        ("leaves", grid.leaf_count), ("lowers", grid.lower_count),
                        ("uppers", grid.upper_count), ("voxels", grid.voxel_count),
                        ("second_records", grid.second_count),
                        ("shaded", int((plane >> 25 & 1).sum())),
                        ("triangles", grid.triangle_count), ("voxel_size", grid.voxel_size),
                        ("sum_offset", float(_offsets(plane).sum())),
                        ("sum_coverage", float((plane >> 16 & 255).sum() / 255))):
        show(name, value)
    show("translation", *grid.translation)
    show("scan_min", *grid.scan_bounds[:3])
    show("scan_max", *grid.scan_bounds[3:])
    show("index_min", *grid.low)
    show("index_max", *grid.high)
    show("sum_normal", *map(float, decode_normals(grid.channels["normal"][one]).sum(axis=0)))


def _find(grid, ijk):
    """Returns the value index of each voxel, 0 where there is none."""
    size = (grid.high - grid.low).astype("i8") + 1

    def keys(of):
        of = of - grid.low.astype("i8")
        return (of[:, 0] * size[1] + of[:, 1]) * size[2] + of[:, 2]

    known = keys(grid.voxels)
    order = known.argsort()
    at = numpy.searchsorted(known[order], keys(ijk)).clip(max=len(known) - 1)
    inside = ((ijk >= grid.low) & (ijk <= grid.high)).all(axis=1)
    return numpy.where(inside & (known[order[at]] == keys(ijk)), 1 + order[at], 0)


def _look_up(grid, path):
    with open(path, encoding="ascii") as file:
        points = numpy.array([line.split() for line in file], float)
    x = (points[:, :3] - grid.translation) / grid.voxel_size
    entry, center = numpy.zeros(len(x), int), numpy.zeros((len(x), 3))
    for corner in range(8):  # on a border, rounding decides between voxels; any of them will do
        nudge = numpy.array([1e-4 if corner >> k & 1 else -1e-4 for k in range(3)])
        ijk = numpy.floor(x + 0.5 + nudge).astype("i8")
        found = numpy.where(entry == 0, _find(grid, ijk), 0)
        center[found > 0] = ijk[found > 0]
        entry = numpy.where(found > 0, found, entry)
    inside = entry > 0
    show("points", len(points))
    show("points_found", int(inside.sum()))
    entry, x = entry[inside], (x - center)[inside]

    def distance(of):
        n = decode_normals(grid.channels["normal"][of])
        return abs((n * x).sum(axis=1) - _offsets(grid.channels["plane"][of]))

    second = second_numbers(grid)[entry]
    entry = numpy.where((second > 0) & (distance(second) < distance(entry)), second, entry)
    show("points_from_plane", float(distance(entry).mean()))
    if grid.has_color and points.shape[1] == 6:
        color = grid.channels["color"][entry]
        rgb = numpy.stack([color >> 8 * k & 255 for k in range(3)], axis=1)
        show("points_from_color", float(abs(rgb - 255 * points[inside, 3:]).mean()))


# ---- damage ----

def _is_read(path, data):
    try:
        read_file.parse(path, data)
        return True
    except Refused:
        return False


def _damage(path, step):
    with open(path, "rb") as file:
        data = bytearray(file.read())
    lengths = [0, 7, 8, 100, 223, 224, 1000, len(data) // 2, len(data) - 192, len(data) - 1]
    unseen = [f"length {n}" for n in lengths
              if n < len(data) and _is_read(path, bytes(data[:n]))]
    if _is_read(path, bytes(data) + b"\n"):
        unseen.append("a byte more")
    ends = range(min(len(data), 2200))
    for at in sorted({*ends[::min(step, 11)], *range(0, len(data), step),
                      *(len(data) - 1 - i for i in ends[::min(step, 17)])}):
        data[at] ^= 64
        if _is_read(path, bytes(data)):
            unseen.append(f"byte {at}")
        data[at] ^= 64
    print(*unseen, sep="\n", end="")
    return 1 if unseen or not _is_read(path, bytes(data)) else 0


def main(arguments):
    """Runs the program; returns its exit status."""
    if arguments[0] == "--damage":
        return _damage(arguments[1], int(arguments[2]))
    path = arguments[1] if arguments[0] == "--triangles" else arguments[0]
    try:
        content = read_file.read(path)
    except Refused as reason:
        print(f"{path}: {reason}", file=sys.stderr)
        return 65
    if arguments[0] == "--triangles":
        _print_triangles(content)
    elif path.endswith(".tris"):
        _measure_tris(content)
    else:
        _measure_nvdb(content)
        if arguments[1:]:
            _look_up(content, arguments[1])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

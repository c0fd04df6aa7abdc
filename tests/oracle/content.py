"""Checksums of all that was read from a file, as read_files.c computes them."""
import struct

import numpy
import xxhash

import read_nvdb
import read_tris

INT32_MAX = 2**31 - 1


def _add(total, layout, *numbers):
    total.update(struct.pack("<" + layout, *numbers))


def _tris_checksum(content):
    total, h = xxhash.xxh3_64(), content.header
    _add(total, "IQQQQ3d3f3fI", h.attributes, h.triangle_count, h.chunk_count, h.source_faces,
         h.skipped_triangles, *h.origin, *h.bounds_min, *h.bounds_max, h.material_count)
    _add(total, "III", h.ids, h.made_normals, len(content.channels))
    for name in content.channels:
        total.update(name)
    for diffuse, path, flags, name, moved, sources in content.materials:
        _add(total, "3fI", *diffuse, read_tris.NONE if path is None else len(path))
        total.update(path or b"")
        _add(total, "II", flags, len(name))
        total.update(name)
        _add(total, "4f", *moved)
        for value, component, uv, texture in sources:
            _add(total, "3fI4f", *value, component, *uv)
            total.update(texture or b"none")
    for chunk in content.chunks:
        e = chunk.entry
        _add(total, "QQQII3f3f", e.offset, e.size_bytes, e.first_triangle, e.triangle_count,
             e.vertex_count, *e.bounds_min, *e.bounds_max)
        for values in (chunk.positions, chunk.normals, chunk.texcoords, chunk.colors,
                       chunk.fine_colors, chunk.materials):
            if values is not None:
                total.update(values.tobytes())
        total.update(chunk.triangles.astype("<u4").tobytes())
        if chunk.made_normals is not None:
            total.update(chunk.made_normals.tobytes() + chunk.creases.tobytes())
    return total.intdigest()


def _records(grid, numbers):
    zeros = numpy.zeros(grid.record_count, "<u4")
    names = ("normal", "plane", "color", "id")
    return numpy.stack([grid.channels.get(name, zeros)[numbers] for name in names], axis=1)


def second_numbers(grid):
    """Returns the number of the second record of each value index, or 0."""
    numbers = numpy.zeros(1 + grid.voxel_count, int)
    numbers[grid.second_of] = 1 + grid.voxel_count + numpy.arange(len(grid.second_of))
    return numbers


def _add_voxels(total, grid):
    values = {tuple(ijk): 1 + i for i, ijk in enumerate(grid.voxels.tolist())}
    seconds = second_numbers(grid)
    for (x, y, z), v in values.items():
        beside = values.get((x + (x < INT32_MAX), y, z), 0)
        _add(total, "3iQQ", x, y, z, v, beside)
        total.update(grid.records[v].tobytes())
        _add(total, "Q", seconds[v])
        if seconds[v]:
            total.update(grid.records[seconds[v]].tobytes())


def _nvdb_checksum(grid):
    total = xxhash.xxh3_64()
    _add(total, "I4dQ6d", grid.has_color, grid.voxel_size, *grid.translation,
         grid.triangle_count, *grid.scan_bounds)
    _add(total, "6i5Q", *grid.low, *grid.high, grid.upper_count, grid.lower_count, grid.leaf_count,
         grid.voxel_count, grid.record_count)
    _add(total, "I", grid.ids)
    for name in grid.names:
        _add(total, "I", len(name))
        total.update(name)
    grid.records = _records(grid, numpy.arange(grid.record_count))
    _add_voxels(total, grid)
    return total.intdigest()


def content_checksum(content):
    """Returns the checksum of a chunk file's Content or of a Grid."""
    if isinstance(content, read_tris.Content):
        return _tris_checksum(content)
    return _nvdb_checksum(content)

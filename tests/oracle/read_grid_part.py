#!/usr/bin/env python3
"""read_grid_part.py PLAN PART...: accepts or refuses parts of a grid, with a reason.

This is a second reader of plans and parts, written from formats/FORMATS.md alone. The exit status is
1 if a file is refused.
"""
import sys

import numpy

import read_nvdb
from parts import check_parts, read_json_plan
from refusal import array, checksum, fields, need

HEADER_BYTES, ENTRY_BYTES, LEAF_BYTES = 112, 48, 72
SECOND = 1 << 24


def read_plan(path):
    plan = read_json_plan(path, "Bisque grid plan", 1)
    need(len(plan["cuts"]) == plan["tasks"] - 1, "cuts")
    return plan


def key(origin):
    """The place of a region in the grid: its root tile, then x, y, z inside of it."""
    return [(axis >> 12) & 0x1fffff for axis in origin] + list(origin)


def read_region(data, words, leaves):
    """Returns voxels and second records of a region's bytes, and the bounds of its voxels."""
    at, last, voxels, seconds = 0, -1, 0, 0
    low, high = numpy.full(3, 1 << 30), numpy.full(3, -1)
    for _ in range(leaves):
        number, second = fields(data, at, "II")
        mask = array(data, at + 8, "u1", 64)
        need(last < number < 4096, "order of leaves")
        bits = numpy.unpackbits(mask, bitorder="little")
        count = int(bits.sum())
        need(count > 0, "a leaf without voxels")
        at += LEAF_BYTES
        planes = array(data, at, "u4", count, words)[:, 1]
        need(int(((planes & SECOND) != 0).sum()) == second, "second records")
        at += (count + second) * words * 4
        at_voxel = numpy.flatnonzero(bits)
        where = numpy.stack([at_voxel >> 6, at_voxel >> 3 & 7, at_voxel & 7], axis=1)
        where = where + 8 * numpy.array([number >> 8, number >> 4 & 15, number & 15])
        low, high = numpy.minimum(low, where.min(0)), numpy.maximum(high, where.max(0))
        last, voxels, seconds = number, voxels + count, seconds + second
    need(at == len(data), "bytes of a region")
    return voxels, seconds, low, high


def read(plan, data):
    """Returns the task and the origins of its regions."""
    need(len(data) >= HEADER_BYTES and data[:8] == b"BSQGPRT\n", "not a part")
    version, flags, plan_high, plan_low, task, tasks, count = fields(data, 8, "IIQQIIQ")
    totals = fields(data, 48, "QQQ")
    bounds = fields(data, 72, "iiiiii")
    table_checksum, header_checksum = fields(data, 96, "QQ")
    need(version == 1 and flags < 8, "version or flags")
    need(header_checksum == checksum(data[:104]), "header_checksum")
    need(f"{plan_high:016x}{plan_low:016x}" == plan["id"], "plan_id")
    need(tasks == plan["tasks"] and task < tasks, "not of the plan")
    need(count <= plan["expected"][task]["regions"], "regions")
    table = len(data) - count * ENTRY_BYTES
    need(table >= HEADER_BYTES and table_checksum == checksum(data[table:]), "table_checksum")
    channels = plan["options"]["channels"]
    need(bool(flags & 4) == (channels is not None), "channels")
    words = 2 + (flags & 1) + (flags >> 1 & 1)
    words += read_nvdb.values_of(channels.split(",")) if channels else 0
    at, origins, sums = HEADER_BYTES, [], [0, 0, 0]
    low, high = numpy.full(3, 2**31 - 1), numpy.full(3, -(2**31))
    for i in range(count):
        entry = fields(data, table + i * ENTRY_BYTES, "iiiIQQQQ")
        origin, leaves, size = entry[:3], entry[3], entry[4]
        need(all(axis % 128 == 0 for axis in origin), "origin")
        need(not origins or key(origins[-1]) < key(origin), "order of regions")
        need(at + size <= table and entry[7] == checksum(data[at:at + size]), "checksum")
        voxels, seconds, first, last = read_region(data[at:at + size], words, leaves)
        need((voxels, seconds) == entry[5:7], "voxels")
        low = numpy.minimum(low, first + numpy.array(origin))
        high = numpy.maximum(high, last + numpy.array(origin))
        sums = [a + b for a, b in zip(sums, (leaves, voxels, seconds))]
        at += size
        origins.append(origin)
    need(at == table and tuple(sums) == tuple(totals), "totals")
    need(bounds == tuple(low) + tuple(high), "bounds")
    return task, origins


def main(plan_path, paths):
    seen = set()

    def accept(plan, data):
        task, origins = read(plan, data)
        need(not seen & set(origins), "a region of two tasks")
        seen.update(origins)
        return task

    return check_parts(plan_path, paths, read_plan, accept)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))

#!/usr/bin/env python3
"""read_part.py PLAN PART...: accepts or refuses parts of a bake, with a reason.

This is a second reader of plans and parts, written from formats/FORMATS.md alone. The exit status is
1 if a file is refused.
"""
import sys

import numpy

from parts import check_parts, read_json_plan
from refusal import array, checksum, fields, need

HEADER_BYTES, ENTRY_BYTES = 1768, 16
SIDES = (16, 32, 64, 128, 256)


def read_plan(path):
    """Returns the plan, with the tasks of each tile's blocks as lists in "blocks"."""
    plan = read_json_plan(path, "Bisque bake plan", 7)
    need(plan["block_side"] in SIDES, "side")
    side = plan["block_side"]
    for tile in plan["tiles"]:
        runs = [run.split("*") for run in tile["blocks"].split()]
        tile["blocks"] = [int(task) for count, task in runs for _ in range(int(count))]
        columns, rows = -(-tile["width"] // side), -(-tile["height"] // side)
        need(len(tile["blocks"]) == columns * rows, "blocks")
        need(all(task < plan["tasks"] for task in tile["blocks"]), "task of a block")
    return plan


def read(plan, data):
    """Returns the task and its blocks, (tile, block, texels) each."""
    need(len(data) >= HEADER_BYTES and data[:8] == b"BSQPART\n", "not a part")
    version, channels = fields(data, 8, "II")
    task, tasks, side, reserved, count = fields(data, 48, "IIIIQ")
    table_checksum, header_checksum = fields(data, HEADER_BYTES - 16, "QQ")
    need(version == 7, "version")
    need(header_checksum == checksum(data[:HEADER_BYTES - 8]), "header_checksum")
    need(reserved == 0 and channels >= 1, "reserved or channels")
    need(data[16:48].decode("latin-1") == plan["id"], "plan_id")
    need(tasks == plan["tasks"] and task < tasks and side == plan["block_side"], "not of the plan")
    size = side * side * channels * 4
    need(len(data) == HEADER_BYTES + count * (size + ENTRY_BYTES), "length")
    table = HEADER_BYTES + count * size
    need(table_checksum == checksum(data[table:]), "table_checksum")
    tiles = [tile["blocks"] for tile in plan["tiles"]]
    blocks, last = [], (0, 0)
    for i in range(count):
        number, block, block_checksum = fields(data, table + i * ENTRY_BYTES, "IIQ")
        at = HEADER_BYTES + i * size
        need(i == 0 or (number, block) > last, "order of blocks")
        need(number < len(tiles) and block < len(tiles[number]), "no such block")
        need(tiles[number][block] == task, "a block of another task")
        need(block_checksum == checksum(data[at:at + size]), "checksum of a block")
        texels = array(data, at, "f4", side, side, channels)
        need((texels[:, :, 0] != 0).any(), "a block without covered texels")
        blocks.append((number, block, texels))
        last = (number, block)
    return task, blocks


def accept(plan, data):
    """Checks a part, and the sum in its header. Returns its task."""
    task, blocks = read(plan, data)
    covered = sum(int(numpy.count_nonzero(t[:, :, 0])) for _, _, t in blocks)
    need(covered == fields(data, 72, "Q")[0], "covered_texels")
    return task


if __name__ == "__main__":
    sys.exit(check_parts(sys.argv[1], sys.argv[2:], read_plan, accept))

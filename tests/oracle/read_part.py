#!/usr/bin/env python3
"""read_part.py PART...: accepts or refuses files of parts of a bake, with a reason.

This is a second reader of these files, written from formats/FORMATS.md and OpenEXR's description of its
files alone. The exit status is 1 if a file is refused.
"""
import struct
import sys
import zlib

import numpy
import xxhash

from refusal import Refused, need

TEXTS = ("version", "part", "tile", "inputs", "options", "counts")
DIGITS = 32


def read_header(data):
    """Returns the attributes, as bytes by name, and the offset of the table of tiles."""
    need(data[:4] == b"\x76\x2f\x31\x01", "not an OpenEXR file")
    need(struct.unpack_from("<I", data, 4)[0] & ~(1 << 10) == 2 | 1 << 9, "not a tiled file of version 2")
    at, attributes = 8, {}
    while data[at:at + 1] != b"\0":
        name = data[at:at + 520].split(b"\0", 1)[0]
        kind = data[at + len(name) + 1:at + 520].split(b"\0", 1)[0]
        at += len(name) + len(kind) + 2
        size, = struct.unpack_from("<I", data, at)
        attributes[name.decode()] = data[at + 4:at + 4 + size]
        at += 4 + size
        need(at < len(data), "the header does not end")
    return attributes, at + 1


def channels_of(attributes):
    """Returns the names of the channels, which are all float."""
    names, data = [], attributes["channels"]
    while data != b"\0":
        name, data = data.split(b"\0", 1)
        need(struct.unpack_from("<I4xII", data) == (2, 1, 1), "a channel that is not float")
        names.append(name.decode())
        data = data[16:]
    return names


def unpack(packed, size):
    """Undoes OpenEXR's compression ZIP."""
    if len(packed) == size:
        return packed
    data = numpy.frombuffer(zlib.decompress(packed), "u1")
    need(len(data) == size, "the size of a tile")
    data = (numpy.cumsum(data.astype("i8") - 128) + 128).astype("u1")
    out, half = numpy.empty(size, "u1"), (size + 1) // 2
    out[::2], out[1::2] = data[:half], data[half:]
    return out.tobytes()


def accept(data):
    """Checks a file. Returns its part, and the number of texels that are covered."""
    need(xxhash.xxh3_128_hexdigest(data[:-DIGITS]).encode() == data[-DIGITS:], "checksum")
    attributes, at = read_header(data)
    texts = {name: attributes.get("bisque:" + name) for name in TEXTS}
    need(all(text is not None for text in texts.values()), "not a part of a bake")
    names = channels_of(attributes)
    need(names == sorted(names) and "share" in names, "channels")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    whole = struct.unpack("<4i", attributes["displayWindow"])
    side, other, mode = struct.unpack("<IIB", attributes["tiles"])
    need(side == other and side in (16, 32, 64) and mode == 0, "side of the tiles")
    need(left % side == 0 and top % side == 0, "the box does not begin at a block")
    need(whole[:2] == (0, 0) and 0 <= left <= right <= whole[2] and 0 <= top <= bottom <= whole[3], "windows")
    need(attributes["compression"] == b"\3", "compression")
    covered, width, height = 0, right - left + 1, bottom - top + 1
    columns, rows = -(-width // side), -(-height // side)
    for i, place in enumerate(struct.unpack_from("<%dQ" % (columns * rows), data, at)):
        column, row, levels, size = struct.unpack_from("<IIQI", data, place)
        need((row, column, levels) == (i // columns, i % columns, 0), "the place of a tile")
        across, down = min(side, width - column * side), min(side, height - row * side)
        bytes_a_row = 4 * across * len(names)
        texels = unpack(data[place + 20:place + 20 + size], bytes_a_row * down)
        for y in range(down):
            line = texels[y * bytes_a_row:(y + 1) * bytes_a_row]
            shares = numpy.frombuffer(line, "<f4").reshape(len(names), across)[names.index("share")]
            covered += numpy.count_nonzero(shares)
            need(((shares == -1) | ((shares >= 0) & (shares <= 1))).all(), "share")
    need(covered <= int(texts["counts"].split()[0]), "covered texels")
    return texts["part"].decode(), covered


def main(paths):
    """Prints a line for each file. Returns 1 after a refusal."""
    refused = 0
    for path in paths:
        with open(path, "rb") as file:
            data = file.read()
        try:
            print("%s: part %s, %d texels, ok" % ((path,) + accept(data)))
        except (Refused, ValueError, KeyError, IndexError, struct.error, zlib.error) as reason:
            print(f"{path}: refused: {reason}")
            refused = 1
    return refused


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

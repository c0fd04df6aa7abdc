"""ids.py name NAME...: prints the id of each name, computed from formats/FORMATS.md alone.
ids.py colors FILE.png...: prints the colours of each image with 8 bits, sorted, on one line.
ids.py differ A.png B.png: prints the percentage of texels that differ.
"""
import struct
import sys
import zlib


def id_of(name):
    h = 0xCBF29CE484222325
    for c in name.encode():
        h = (h ^ c) * 0x100000001B3 % 2**64
    for factor in (0xFF51AFD7ED558CCD, 0xC4CEB9FE1A85EC53):
        h = (h ^ h >> 33) * factor % 2**64
    b = (h ^ h >> 33).to_bytes(8, "little")
    high = 160 + 96 * b[0] // 256
    low = 5 * high * b[1] // 2048
    middle = low + (high - low) * b[2] // 256
    channels = ["RGB", "RBG", "GRB", "GBR", "BRG", "BGR"][b[3] * 6 // 256]
    value = dict(zip(channels, (high, low, middle)))
    return "#" + "".join(f"{value[c]:02x}" for c in "RGB")


def paeth(a, b, c):
    p = a + b - c
    return min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]


def texels(path):
    """Returns the texels of an RGB image with 8 bits, as bytes of three."""
    data, at, packed = open(path, "rb").read(), 8, b""
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        chunk = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, bits, color = struct.unpack_from(">IIBB", chunk)
        packed += chunk if kind == b"IDAT" else b""
        at += 12 + length
    assert (bits, color) == (8, 2), path
    raw, out, above = zlib.decompress(packed), [], bytearray(3 * width)
    for y in range(height):
        kind, *line = raw[y * (3 * width + 1):(y + 1) * (3 * width + 1)]
        line = bytearray(line)
        for i in range(3 * width):
            left, corner = (line[i - 3], above[i - 3]) if i >= 3 else (0, 0)
            line[i] = (line[i] + (0, left, above[i], (left + above[i]) // 2,
                                  paeth(left, above[i], corner))[kind]) % 256
        out += [bytes(line[i:i + 3]) for i in range(0, 3 * width, 3)]
        above = line
    return out


def main(what, *names):
    if what == "name":
        print(*(id_of(name) for name in names), sep="\n")
    elif what == "colors":
        for name in names:
            print(*sorted({"#" + texel.hex() for texel in texels(name)}))
    else:
        a, b = map(texels, names)
        print(100 * sum(x != y for x, y in zip(a, b)) / len(a))


main(*sys.argv[1:])

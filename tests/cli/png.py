"""png.py - reads and writes PNG files for tests, from the specification alone: 8 or 16 bits, grey,
RGB or RGBA, not interlaced."""
import struct
import zlib


def paeth(a, b, c):
    p = a + b - c
    return min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]


def read(path):
    """Returns width, height, the largest sample, and rows of texels, which are tuples of samples."""
    data, at, packed = open(path, "rb").read(), 8, b""
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        chunk = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, bits, color = struct.unpack_from(">IIBB", chunk)
        packed += chunk if kind == b"IDAT" else b""
        at += 12 + length
    assert bits in (8, 16) and color in (0, 2, 6), path
    channels, size = {0: 1, 2: 3, 6: 4}[color], bits // 8
    texel, stride = channels * size, channels * size * width
    raw, rows, above = zlib.decompress(packed), [], bytearray(stride)
    for y in range(height):
        kind, *line = raw[y * (stride + 1):(y + 1) * (stride + 1)]
        line = bytearray(line)
        for i in range(stride):
            left, corner = (line[i - texel], above[i - texel]) if i >= texel else (0, 0)
            line[i] = (line[i] + (0, left, above[i], (left + above[i]) // 2,
                                  paeth(left, above[i], corner))[kind]) % 256
        samples = struct.unpack(">%d%s" % (channels * width, "BH"[size - 1]), line)
        rows.append([samples[i:i + channels] for i in range(0, len(samples), channels)])
        above = line
    return width, height, 2**bits - 1, rows


def chunks(path):
    """Returns the kinds of the chunks as a text; each kind once."""
    data, at, kinds = open(path, "rb").read(), 8, []
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        assert zlib.crc32(data[at + 4:at + 8 + length]) == \
            struct.unpack_from(">I", data, at + 8 + length)[0], kind
        kinds += [kind.decode()] if kind.decode() not in kinds else []
        at += 12 + length
    return " ".join(kinds)


def write(path, bits, rows, gamma=None):
    """Writes rows of texels, which are tuples of 1, 3 or 4 samples: grey, RGB or RGBA. gamma: of gAMA."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + \
            struct.pack(">I", zlib.crc32(kind + data))
    raw = b"".join(b"\0" + b"".join(struct.pack(">%d%s" % (len(texel), "BH"[bits // 8 - 1]), *texel)
                                    for texel in row) for row in rows)
    color = {1: 0, 3: 2, 4: 6}[len(rows[0][0])]
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" +
                   chunk(b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), len(rows), bits, color,
                                              0, 0, 0)) +
                   (chunk(b"gAMA", struct.pack(">I", round(100000 * gamma))) if gamma else b"") +
                   chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))

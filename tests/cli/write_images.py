"""Writes the same pictures as PNG, PNM or PFM files and as TIFF and OpenEXR files of many kinds, into
this folder. Prints a line for each of the latter: its name, and the name of the former, or "-" if it
must be refused."""
import random
import struct
import zlib

WIDTH, HEIGHT = 21, 13
random.seed(7)
NUMBERS = range(WIDTH * HEIGHT)


def save(name, data):
    with open(name, "wb") as file:
        file.write(data)


def pack(values, code, order="<"):
    return struct.pack(f"{order}{len(values)}{code}", *values)


def tiff(name, like, texels, samples, code="B", order="<", *, bits=None, photometric=2, kind=1, apart=False,
         tile=0, extra=(), palette=None):
    """Writes values, interleaved, without compression. Strips have 5 rows; a tile has 16 x 16."""
    size = struct.calcsize(code)
    planes = [texels[s::samples] for s in range(samples)] if apart else [texels]
    step = 1 if apart else samples
    parts = []
    for plane in planes:
        rows = [plane[y * WIDTH * step:(y + 1) * WIDTH * step] for y in range(HEIGHT)]
        if tile:
            rows += [[0] * WIDTH * step] * (-HEIGHT % tile)
            rows = [row + [0] * (-WIDTH % tile * step) for row in rows]
            parts += [pack(sum((row[x * step:(x + tile) * step] for row in rows), []), code, order)
                      for x in range(0, len(rows[0]) // step, tile)]
        elif bits:
            data = [int("".join(f"{v:0{bits}b}" for v in row).ljust(-(-WIDTH * bits // 8) * 8, "0"), 2)
                    .to_bytes(-(-WIDTH * bits // 8), "big") for row in rows]
            parts += [b"".join(data[y:y + 5]) for y in range(0, HEIGHT, 5)]
        else:
            parts += [pack(sum(rows[y:y + 5], []), code, order) for y in range(0, HEIGHT, 5)]
    body, offsets = b"", []
    for part in parts:
        offsets.append(8 + len(body))
        body += part
    body += b"\0" * (len(body) % 2)
    sizes = [len(part) for part in parts]
    tags = {256: ("I", [WIDTH]), 257: ("I", [HEIGHT]), 258: ("H", [bits or 8 * size] * samples),
            262: ("H", [photometric]), 277: ("H", [samples]), 284: ("H", [2 if apart else 1]),
            339: ("H", [kind] * samples)}
    tags.update({322: ("I", [tile]), 323: ("I", [tile]), 324: ("I", offsets), 325: ("I", sizes)} if tile
                else {273: ("I", offsets), 278: ("I", [5]), 279: ("I", sizes)})
    if extra:
        tags[338] = ("H", list(extra))
    if palette:
        tags[320] = ("H", palette)
    head, tail = b"", b""
    directory = 8 + len(body)
    for tag, (kind_of, values) in sorted(tags.items()):
        data = pack(values, kind_of, order)
        if len(data) > 4:
            place = directory + 6 + 12 * len(tags) + len(tail)
            tail += data
            data = pack([place], "I", order)
        head += struct.pack(order + "HHI", tag, {"H": 3, "I": 4}[kind_of], len(values)) + data.ljust(4, b"\0")
    mark = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, directory)
    save(name, mark + body + struct.pack(order + "H", len(tags)) + head + bytes(4) + tail)
    print(name, like)


def exr(name, like, channels, kind=2):
    """Writes channels (name: values) without compression; kind: 1 half, 2 float."""
    def attribute(key, type_name, data):
        return key.encode() + b"\0" + type_name.encode() + b"\0" + struct.pack("<I", len(data)) + data

    code = {1: "e", 2: "f"}[kind]
    names = sorted(channels)
    window = struct.pack("<4i", 0, 0, WIDTH - 1, HEIGHT - 1)
    header = b"".join((
        struct.pack("<II", 20000630, 2),
        attribute("channels", "chlist", b"".join(
            c.encode() + b"\0" + struct.pack("<I4x2I", kind, 1, 1) for c in names) + b"\0"),
        attribute("compression", "compression", b"\0"),
        attribute("dataWindow", "box2i", window), attribute("displayWindow", "box2i", window),
        attribute("lineOrder", "lineOrder", b"\0"),
        attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        attribute("screenWindowCenter", "v2f", bytes(8)),
        attribute("screenWindowWidth", "float", struct.pack("<f", 1)), b"\0"))
    lines = [b"".join(pack(channels[c][y * WIDTH:(y + 1) * WIDTH], code) for c in names)
             for y in range(HEIGHT)]
    first = len(header) + 8 * HEIGHT
    save(name, header + b"".join(struct.pack("<Q", first + y * (8 + len(lines[0]))) for y in range(HEIGHT))
         + b"".join(struct.pack("<iI", y, len(line)) + line for y, line in enumerate(lines)))
    print(name, like)


# ---- 8 bits ----
rgb = [random.randrange(256) for _ in NUMBERS for _ in range(3)]
with_alpha = sum((rgb[3 * i:3 * i + 3] + [i % 256] for i in NUMBERS), [])
inks = sum(([255 - v for v in rgb[3 * i:3 * i + 3]] + [0] for i in NUMBERS), [])
save("rgb.ppm", b"P6 %d %d 255\n" % (WIDTH, HEIGHT) + bytes(rgb))
tiff("rgb.tif", "rgb.ppm", rgb, 3)
tiff("rgb_apart.tif", "rgb.ppm", rgb, 3, apart=True)
tiff("rgb_tiles.tif", "rgb.ppm", rgb, 3, tile=16)
tiff("rgb_tiles_apart.tif", "rgb.ppm", rgb, 3, tile=16, apart=True)
tiff("rgb_alpha.tif", "rgb.ppm", with_alpha, 4, extra=[2])
tiff("rgb_alpha_apart.tif", "-", with_alpha, 4, extra=[1], apart=True)
tiff("cmyk.tif", "rgb.ppm", inks, 4, photometric=5)
tiff("cmyk_apart.tif", "rgb.ppm", inks, 4, photometric=5, apart=True)
grey = [random.randrange(256) for _ in NUMBERS]
save("grey.pgm", b"P5 %d %d 255\n" % (WIDTH, HEIGHT) + bytes(grey))
tiff("grey.tif", "grey.pgm", grey, 1, photometric=1)
tiff("grey_tiles.tif", "grey.pgm", grey, 1, photometric=1, tile=16)
tiff("grey_inverse.tif", "grey.pgm", [255 - v for v in grey], 1, photometric=0)
tiff("grey_palette.tif", "grey.pgm", grey, 1, photometric=3, palette=[257 * v for v in range(256)] * 3)
tiff("grey_palette_tiles.tif", "grey.pgm", grey, 1, photometric=3, tile=16,
     palette=[257 * v for v in range(256)] * 3)
for bits in (1, 2, 4):
    few = [v >> (8 - bits) for v in grey]
    save(f"grey{bits}.pgm", b"P5 %d %d 255\n" % (WIDTH, HEIGHT) + bytes(v * 255 // ((1 << bits) - 1) for v in few))
    tiff(f"grey{bits}.tif", f"grey{bits}.pgm", few, 1, photometric=1, bits=bits)

# ---- 16 bits and floats ----
deep = [random.randrange(65536) for _ in NUMBERS for _ in range(3)]
save("deep.png", b"\x89PNG\r\n\x1a\n" + b"".join(
    struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in (
        (b"IHDR", struct.pack(">2I5B", WIDTH, HEIGHT, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"".join(b"\0" + pack(deep[3 * WIDTH * y:3 * WIDTH * (y + 1)], "H", ">")
                                         for y in range(HEIGHT)))),
        (b"IEND", b""))))
tiff("deep.tif", "deep.png", deep, 3, "H")
tiff("deep_big.tif", "deep.png", deep, 3, "H", ">")
tiff("deep_big_apart.tif", "-", deep, 3, "H", ">", apart=True)
light = [random.randrange(1024) / 512 for _ in NUMBERS for _ in range(3)]
save("light.pfm", b"PF\n%d %d\n-1\n" % (WIDTH, HEIGHT) + b"".join(
    pack(light[3 * WIDTH * y:3 * WIDTH * (y + 1)], "f") for y in reversed(range(HEIGHT))))
tiff("light.tif", "light.pfm", light, 3, "f", kind=3)
tiff("light_big_tiles.tif", "light.pfm", light, 3, "f", ">", kind=3, tile=16)
tiff("light_half.tif", "light.pfm", light, 3, "e", kind=3)
red, green, blue = light[0::3], light[1::3], light[2::3]
exr("light.exr", "light.pfm", {"R": red, "G": green, "B": blue})
exr("light_half.exr", "light.pfm", {"R": red, "G": green, "B": blue, "A": blue, "Z": green}, 1)
exr("light_layers.exr", "light.pfm", {"a.A": blue, "a.B": blue, "a.G": green, "a.R": red, "b.R": blue,
                                      "b.G": red, "b.B": red, "x": red})

# ---- refused ----
tiff("signed.tif", "-", [v - 128 for v in grey], 1, "b", photometric=1, kind=2)
tiff("signed_deep.tif", "-", [v - 32768 for v in deep], 3, "h", kind=2)

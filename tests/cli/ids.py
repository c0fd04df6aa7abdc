"""ids.py name NAME...: prints the id of each name, computed from formats/FORMATS.md alone.
ids.py colors FILE.png...: prints the colours of each image with 8 bits, sorted, on one line.
ids.py differ A.png B.png: prints the percentage of texels that differ.
"""
import sys

import png


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


def texels(path):
    """Returns the texels of an RGB image with 8 bits, as bytes of three."""
    _, _, most, rows = png.read(path)
    assert most == 255 and len(rows[0][0]) == 3, path
    return [bytes(texel) for row in rows for texel in row]


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

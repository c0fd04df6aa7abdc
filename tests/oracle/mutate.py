"""Damages .tris and .nvdb files: anywhere, or in one field, with corrected checksums or without."""
import struct

import make_nvdb
import make_tris
import read_nvdb
from read_nvdb import BLIND_BYTES, GRID, LEAF_BYTES, LOWER_BYTES, ROOT, TREE, UPPER_BYTES
from read_tris import ENTRY_BYTES, HEADER_BYTES

BITS = {"B": 8, "H": 16, "I": 32, "Q": 64, "f": 32, "d": 64}
FLOATS = {"f": [0, 0x80000000, 1, 0x7F7FFFFF, 0x7F800000, 0xFF800000, 0x7FC00000, 0x3F800000],
          "d": [0, 1 << 63, 1, 0x7FEFFFFFFFFFFFFF, 0x7FF << 52, 0xFFF << 52, 0x7FF8 << 48,
                0x3FF << 52, 0x8000000000000, 0x0010 << 48]}

TRIS_HEADER = "8s IIQQQQ ddd fff fff QQQQ IIII QQQQ"
TRIS_ENTRY = "QQQII fff fff QQ QQQII"
NVDB_FILE_HEADER = "QIHHQQQQII dddddd IIIIII ddd I IIII III HH I 32s"
NVDB_GRID_DATA = "Q IIIIIIQ 256s " + 22 * "f" + 31 * "d" + " IIQ II QQ"
NVDB_TREE = "QQQQ III III Q"
NVDB_TRAILER = "Q II QQ dddddd QQQQQQQQQ QQQQ Q"


def _fields(layout, offset):
    """Returns type and offset of each number of a structure. Strings count as bytes."""
    fields, digits = [], ""
    for letter in layout.replace(" ", ""):
        if letter.isdigit():
            digits += letter
        elif letter == "s":
            fields += [("B", offset + i) for i in range(int(digits))]
            offset, digits = offset + int(digits), ""
        else:
            fields.append((letter, offset))
            offset += BITS[letter] // 8
    return fields


def _new_value(random, kind, old):
    bits = BITS[kind]
    choice = random.integers(0, 6)
    if choice == 0:
        return old ^ 1 << int(random.integers(0, bits))
    if choice == 1:
        return old + 1
    if choice == 2:
        return old - 1
    if choice == 3 and kind in FLOATS:
        return random.choice([int(v) for v in FLOATS[kind]])
    if choice == 4:
        return old + int(random.integers(-100, 100)) * (1 << int(random.integers(0, bits)))
    return [0, 1, 2, (1 << bits) - 1, 1 << bits - 1, (1 << bits - 1) - 1][random.integers(0, 6)]


def _change_field(random, data, kind, offset):
    size = BITS[kind] // 8
    if offset + size > len(data):
        return
    old = int.from_bytes(data[offset:offset + size], "little")
    new = int(_new_value(random, kind, old)) % (1 << BITS[kind])
    data[offset:offset + size] = new.to_bytes(size, "little")


# ---- fields of a .tris file ----

def _pick_tris_field(random, data):
    materials, table = struct.unpack_from("<QQ", data, 104)
    part = random.integers(0, 4)
    if part == 0 or not HEADER_BYTES <= materials <= table <= len(data):
        fields = _fields(TRIS_HEADER, 0)
    elif part == 1 and table + ENTRY_BYTES <= len(data):
        row = int(random.integers(0, (len(data) - table) // ENTRY_BYTES))
        fields = _fields(TRIS_ENTRY, table + ENTRY_BYTES * row)
    elif part == 2 and table >= materials + 4:
        fields = _fields("I" * min((table - materials) // 4, 100), materials)
    else:
        low, high = HEADER_BYTES, max(materials, HEADER_BYTES + 8)
        kind = random.choice(["B", "H", "I", "f"])
        size = BITS[kind] // 8
        fields = [(kind, int(random.integers(low, high)) // size * size)]
    return fields[random.integers(0, len(fields))]


# ---- fields of a .nvdb file ----

def _node_fields(random, layout):
    """Returns fields of a random node: its start, and some of its masks, sums or offsets."""
    name, size, count, words = [("upper", UPPER_BYTES, layout.upper_count, 33800),
                                ("lower", LOWER_BYTES, layout.lower_count, 4232),
                                ("leaf", LEAF_BYTES, layout.leaf_count, 12)][random.integers(0, 3)]
    offset = layout.sections[name][0] + size * int(random.integers(0, count))
    fields = _fields("BBBBBBBBBBBBBBBB" if name == "leaf" else "IIIIIIQ", offset)
    if name != "leaf":
        fields += [("Q", offset + (8224 if name == "upper" else 1056) + 8 * i) for i in range(4)]
    return fields + [("Q", offset + 8 * int(random.integers(0, words))) for _ in range(6)]


def _used_offset_field(random, data, layout):
    """Returns the field of an offset or mask word that is not zero, in an upper or lower node."""
    name = random.choice(["upper", "lower"])
    start, size = layout.sections[name]
    used = [("Q", at) for at in range(start, start + size, 8) if data[at:at + 8] != bytes(8)]
    return used


def _channel_fields(random, layout):
    names = [name for name in ("normal", "plane", "color", "second", "id") if name in layout.sections]
    offset, size = layout.sections[random.choice(names)]
    return [("I", offset + 4 * int(random.integers(0, size // 4)))]


def _padding_fields(random, layout):
    ends = [sum(section) for section in layout.sections.values()][:-1]
    return [("B", end + int(random.integers(0, 8))) for end in ends]


def _pick_nvdb_field(random, data, layout):
    blind = layout.sections["blind"][0]
    pick = [lambda: _fields(NVDB_FILE_HEADER, 0), lambda: _fields(NVDB_GRID_DATA, GRID),
            lambda: _fields(NVDB_TREE, TREE),
            lambda: _fields("I" * (read_nvdb.ROOT_BYTES // 4) + "QQQQ" * layout.upper_count, ROOT),
            lambda: _fields("QQIIII 256s", blind + BLIND_BYTES * int(random.integers(0, 4))),
            lambda: _node_fields(random, layout), lambda: _node_fields(random, layout),
            lambda: _used_offset_field(random, data, layout),
            lambda: _channel_fields(random, layout), lambda: _channel_fields(random, layout),
            lambda: _padding_fields(random, layout),
            lambda: _fields(NVDB_TRAILER, layout.sections["bisque"][0])]
    fields = pick[random.integers(0, len(pick))]()
    return fields[random.integers(0, len(fields))]


# ---- any file ----

def _damage_bytes(random, data):
    """Cuts, extends, or changes bytes anywhere."""
    choice, at = random.integers(0, 5), int(random.integers(0, len(data)))
    size = int(random.choice([1, 4, 8, 64, 200]))
    if choice == 0:
        del data[at:]
    elif choice == 1:
        data += bytes(random.integers(0, 2, size).astype("u1"))
    elif choice == 2:
        data[at] ^= 1 << int(random.integers(0, 8))
    elif choice == 3:
        data[at:at + size] = bytes(len(data[at:at + size]))
    else:
        start = int(random.integers(0, len(data)))
        piece = data[start:start + size]
        data[at:at + len(piece)] = piece


def mutate_tris(random, data):
    """Returns a damaged copy of a sound chunk file."""
    data = bytearray(data)
    if random.random() < 0.2:
        _damage_bytes(random, data)
    else:
        for _ in range(random.choice([1, 1, 1, 2, 3])):
            _change_field(random, data, *_pick_tris_field(random, data))
    if random.random() < 0.85:
        make_tris.mend(data)
    return bytes(data)


def mutate_nvdb(random, data):
    """Returns a damaged copy of a sound grid."""
    layout = read_nvdb.read(bytes(data), False)
    data = bytearray(data)
    if random.random() < 0.1:
        _damage_bytes(random, data)
    else:
        for _ in range(random.choice([1, 1, 1, 2])):
            _change_field(random, data, *_pick_nvdb_field(random, data, layout))
    if random.random() < 0.9:
        make_nvdb.mend(data, layout)
    return bytes(data)

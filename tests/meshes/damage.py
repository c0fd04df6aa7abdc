#!/usr/bin/env python3
"""damage.py FILE.glb COUNT|large|huge|greedy|fallback: writes damaged copies of a GLB file to the current
directory.

A number writes bad.0.glb, bad.1.glb and so on, with one byte changed in the binary chunk each.
"large" and "huge" write large.glb and huge.glb, whose accessors count thirty thousand or ten million
times more elements. "greedy" writes greedy.glb, whose mesh of 78 bytes, which fuzzing found, makes
Draco 1.5.5 take 16 GB. "fallback" writes fallback.glb, whose fallback buffers are files that do not exist.
"""
import json
import struct
import sys

GREEDY = bytes.fromhex(
    "445241434f0107010100000031480048004a060053535353535353535353535353aa5a55d5a7aa0a"
    "ff011101fe00000100030100000000000323ffffffffffffff29042055350000004003243100")


def main(path, how):
    with open(path, "rb") as file:
        data = bytearray(file.read())
    length = struct.unpack_from("<I", data, 12)[0]
    binary = 28 + length
    if how not in ("large", "huge", "greedy", "fallback"):
        for i in range(int(how)):
            bad = bytearray(data)
            at = binary + i * (len(data) - binary) // int(how)
            bad[at] ^= 1 << i % 8
            with open("bad.%d.glb" % i, "wb") as file:
                file.write(bad)
        return
    document = json.loads(data[20:20 + length])
    for accessor in document["accessors"] if how in ("large", "huge") else []:
        accessor["count"] *= 30000 if how == "large" else 10000000
    for buffer in document["buffers"] if how == "fallback" else []:
        if "extensions" in buffer:
            buffer["uri"] = "none.bin"
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    if how == "greedy":  # in place of the compressed mesh
        at = binary + document["bufferViews"][0].get("byteOffset", 0)
        data[at:at + len(GREEDY)] = GREEDY
    rest = data[20 + length:]
    with open(how + ".glb", "wb") as file:
        file.write(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text),
                               b"JSON") + text + rest)


if __name__ == "__main__":
    main(*sys.argv[1:])

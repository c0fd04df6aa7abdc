"""The PNG files that Python writes itself."""
from __future__ import annotations

import os
import struct
import zlib

import numpy as np


def srgb(linear: np.ndarray) -> np.ndarray:
    """Returns colours in sRGB of those in linear light."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clip(0) ** (1 / 2.4) - 0.055)


def write_png(path: str | os.PathLike, values: np.ndarray) -> None:
    """Writes numbers of 0 to 1 (rows, columns[, channels]) with 16 bits, as grey, grey and alpha, RGB or RGBA."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = np.round(values.clip(0, 1).astype(np.float64) * 65535).astype(">u2")
    kind = (0, 4, 2, 6)[(values.shape[2] if values.ndim == 3 else 1) - 1]
    head = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], 16, kind, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows), 1)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b""))

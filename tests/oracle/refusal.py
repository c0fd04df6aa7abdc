"""What the readers of this folder have in common: refusals, and bytes of fixed layout."""
import struct

import numpy
import xxhash


class Refused(Exception):
    """A file that is not as formats/FORMATS.md says; the text is the reason."""


def need(condition, reason):
    """Refuses the file for this reason unless the condition holds."""
    if not condition:
        raise Refused(reason)


def checksum(data):
    """Returns the checksum of .tris and .nvdb files: XXH3-64 with seed 0."""
    return xxhash.xxh3_64_intdigest(data)


def fields(data, offset, layout):
    """Returns the little-endian numbers at an offset. The caller has checked that they exist."""
    return struct.unpack_from("<" + layout, data, offset)


def array(data, offset, kind, *shape):
    """Returns the little-endian numbers at an offset as an array, without copying them."""
    count = int(numpy.prod(shape, dtype=object))
    return numpy.frombuffer(data, "<" + kind, count, offset).reshape(shape)


def is_zero(data):
    """Checks that all bytes are zero."""
    return not any(data)


def is_finite(numbers):
    """Checks that no number is infinite or NaN."""
    return bool(numpy.isfinite(numpy.asarray(numbers)).all())


def has_minus_32768(normals):
    """Checks if a part of an encoded normal is -32768, which no writer writes."""
    low, high = normals & 0xFFFF, normals >> 16
    return bool(((low == 0x8000) | (high == 0x8000)).any())

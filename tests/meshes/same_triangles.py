#!/usr/bin/env python3
"""same_triangles.py TOLERANCE A.tris B.tris: checks that two chunk files have the same triangles.

Triangles may be in any order and begin at any corner, but must have the same front. Corners may
differ by TOLERANCE. The exit status is 1 if they are not the same.
"""
import os
import sys

import numpy

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "oracle"))
import read_tris  # noqa: E402


def triangles(path):
    """Returns the corners of all triangles as an array of n x 3 x 3 numbers."""
    with open(path, "rb") as file:
        content = read_tris.read(file.read(), True)
    corners = numpy.concatenate([c.positions[c.triangles] for c in content.chunks])
    return corners.astype(float) + numpy.array(content.header.origin)


def main(tolerance, a, b):
    a, b = triangles(a), triangles(b)
    if len(a) != len(b):
        print(f"{len(a)} and {len(b)} triangles")
        return 1
    left = numpy.ones(len(b), bool)
    for triangle in a:
        near = numpy.zeros(len(b), bool)
        for first in range(3):
            turned = numpy.roll(triangle, first, axis=0)
            near |= (abs(b - turned) <= float(tolerance)).all(axis=(1, 2))
        found = numpy.flatnonzero(near & left)
        if len(found) == 0:
            print("no triangle like", triangle.tolist())
            return 1
        left[found[0]] = False
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

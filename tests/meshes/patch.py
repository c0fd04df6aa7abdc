# The mesh of this folder, with which the scripts write its files.
import numpy


def make_mesh():
    """Returns vertices and triangles of a bumpy patch of 6 x 6 cells."""
    side = 7
    points = [(i / 8, j / 8, (i * j % 3) / 8) for j in range(side) for i in range(side)]
    triangles = []
    for j in range(side - 1):
        for i in range(side - 1):
            a = j * side + i
            triangles += [(a, a + 1, a + side + 1), (a, a + side + 1, a + side)]
    return numpy.array(points), numpy.array(triangles)


points, triangles = make_mesh()
colors = numpy.array([(i * 5 % 256, i * 3 % 256, 255 - i) for i in range(len(points))], numpy.uint8)

"""Scans that numpy makes: a sphere with waves, whose surface and normals a formula gives."""
import numpy as np
import pytest

RADIUS, WAVES, HEIGHT = 1.0, 9, 0.01


def radius_at(direction):
    return RADIUS + HEIGHT * np.sin(WAVES * direction[:, 0]) * np.cos(WAVES * direction[:, 1])


def sphere(steps, displaced):
    """Returns vertices and faces of a cube's grid on a sphere, welded, wound outwards."""
    t = np.tan(np.linspace(-np.pi / 4, np.pi / 4, steps + 1))
    u, v = np.meshgrid(t, t, indexing="ij")
    grid = np.stack([u, v, np.ones_like(u)], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(steps), np.arange(steps), indexing="ij")
    a = (i * (steps + 1) + j).ravel()
    quads = np.stack([a, a + steps + 1, a + steps + 2, a + 1], axis=1)
    points, faces = [], []
    for axis in range(3):
        for sign in (1, -1):
            side = grid * [1, 1, sign]
            turned = quads if sign > 0 else quads[:, ::-1]
            faces.append(turned + sum(map(len, points)))
            points.append(np.roll(side, axis, axis=1))
    points = np.concatenate(points)
    points /= np.linalg.norm(points, axis=1)[:, None]
    points, which = np.unique(points.round(12), axis=0, return_inverse=True)
    quads = which.reshape(-1)[np.concatenate(faces)]
    points *= (radius_at(points) if displaced else np.full(len(points), RADIUS))[:, None]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return points, np.ascontiguousarray(faces, np.int32)


@pytest.fixture(scope="session")
def scan():
    return sphere(120, True)


@pytest.fixture(scope="session")
def low(scan):
    import bisque

    return bisque.unwrap(bisque.simplify(scan, triangles=1500), size=256)

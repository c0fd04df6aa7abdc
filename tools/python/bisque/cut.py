"""Tiles that planes cut out of the levels of a mesh, and skirts that hide gaps between tiles of different levels.

Planes divide space from the coarsest level down: a tile of one level is divided until each of its parts has few
enough triangles of the next level. Both sides of a plane get the same points and normals on it. Planes are the same
for all finer levels, so a tile covers what its children cover."""
from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterator

import numpy as np

from .mesh import Error, read_mesh

#: Points closer to a plane than this share of their shortest edge move onto it, unless the surface is close to
#: parallel to the plane: the square of the sine of their angle.
SLIDE_SHARE, SLIDE_STEEP = 0.25, 0.1
#: The column of points that has the width of the skirt. Skirts hide gaps beside tiles up to SKIRT_LEVELS levels away;
#: they are wider than these by a factor, and by a share of the tile's size, for what is drawn between rounded points.
#: Of normals that are almost those of a plane, less than SKIRT_STEEP lies in it, and they are taken as they are.
WIDTH, SKIRT_LEVELS, SKIRT_FACTOR, SKIRT_LEAST, SKIRT_STEEP = 6, 2, 1.25, 1e-4, 0.1
#: Distances that are computed at once.
PAIRS = 1 << 20


@dataclass
class Part:
    """Triangles of a level inside a region: rows of positions, normals and widths of skirts, and triples of their
    numbers."""
    points: np.ndarray  # float32 (n, 7)
    faces: np.ndarray


@dataclass
class Tile:
    """A tile: its region, a box whose sides are planes or at infinity, and what is in it."""
    level: int  # 0: the coarsest
    low: np.ndarray
    high: np.ndarray
    part: Part
    name: str = ""
    error: float = 0.0  # no point of the tile and of the scan in its region is farther from the other one
    distances: dict = field(default_factory=dict)  # of the scan in its region from the level, and of the tile's points
    children: list[Tile] = field(default_factory=list)

    def all(self) -> Iterator[Tile]:
        yield self
        for child in self.children:
            yield from child.all()


# ---- cutting ----

def read_level(path: Path, origin: np.ndarray) -> Part:
    """Reads a mesh of bisque-simplify; positions become relative to an origin."""
    mesh = read_mesh(str(path))
    points = np.zeros((len(mesh.vertices), 7), np.float32)
    points[:, :3] = mesh.vertices - origin
    points[mesh.faces.ravel(), 3:6] = mesh.normals[mesh.normal_faces.ravel()]
    return Part(points, mesh.faces.astype(np.int32))


def _slide(part: Part, axis: int, value: np.float32, low: np.ndarray, high: np.ndarray) -> Part:
    """Moves points that are close to a plane onto it, along the surface: cuts through their edges would leave slivers.
    Points on the region's own planes stay, for the other side has them too."""
    points, faces = part.points, part.faces
    side = np.sign(points[:, axis] - value)[faces]
    near = np.zeros(len(points), bool)
    near[faces[(side.min(axis=1) < 0) & (side.max(axis=1) > 0)]] = True
    near &= ~((points[:, :3] == low) | (points[:, :3] == high)).any(axis=1)
    around = faces[near[faces].any(axis=1)]
    p = points[around, :3].astype(np.float64)
    edges = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2)
    shortest = np.full(len(points), np.inf)
    np.minimum.at(shortest, around, np.minimum(edges, np.roll(edges, 1, axis=1)))
    chosen = np.flatnonzero(near)
    normals = points[chosen, 3:6].astype(np.float64)
    along = -normals[:, axis, None] * normals
    along[:, axis] += 1
    rise = along[:, axis]  # the square of the length, too
    steep = rise > SLIDE_STEEP
    step = np.zeros_like(along)
    step[steep] = along[steep] * ((value - points[chosen[steep], axis].astype(np.float64)) / rise[steep])[:, None]
    moved = steep & (np.linalg.norm(step, axis=1) < SLIDE_SHARE * shortest[chosen])
    points = points.copy()
    points[chosen[moved], :3] += step[moved].astype(np.float32)
    points[chosen[moved], axis] = value
    return Part(points, faces)


def _points_between(points: np.ndarray, edges: np.ndarray, axis: int, value: np.float32) -> np.ndarray:
    """Returns the points of edges on a plane."""
    ends = points[edges].astype(np.float64)
    a, b = ends[:, 0], ends[:, 1]
    share = (np.float64(value) - a[:, axis]) / (b[:, axis] - a[:, axis])
    found = a + share[:, None] * (b - a)
    length = np.linalg.norm(found[:, 3:6], axis=1)[:, None]
    found[:, 3:6] = np.where(length > 0, found[:, 3:6] / np.where(length > 0, length, 1), a[:, 3:6])
    found[:, axis] = value
    return found.astype(np.float32)


def _compact(points: np.ndarray, faces: np.ndarray) -> Part:
    """Keeps the points that triangles have, in their order, and triangles with three positions."""
    p = points[faces, :3]
    same = [(p[:, k] == p[:, (k + 1) % 3]).all(axis=1) for k in range(3)]
    faces = faces[~np.logical_or.reduce(same)]
    used, which = np.unique(faces, return_inverse=True)
    return Part(points[used], which.reshape(-1, 3).astype(np.int32))


def cut(part: Part, axis: int, value: np.float32) -> tuple[Part, Part]:
    """Divides triangles at a plane: those below it, and those above."""
    points, faces = part.points, part.faces
    side = np.sign(points[:, axis] - value).astype(np.int8)
    of = side[faces]
    below, above = (of <= 0).all(axis=1), (of >= 0).all(axis=1)
    whole = below | above
    across, sides = faces[~whole], of[~whole]
    # Corners turn so that the first one is on the plane, or else alone on its side of it.
    product = sides.prod(axis=1)
    first = np.where(product == 0, (sides == 0).argmax(axis=1), (sides == product[:, None]).argmax(axis=1))
    order = (first[:, None] + np.arange(3)) % 3
    across, sides = np.take_along_axis(across, order, 1), np.take_along_axis(sides, order, 1)
    on = sides[:, 0] == 0
    a, b, c = across.T
    edges = np.stack([np.concatenate([b[on], a[~on], a[~on]]), np.concatenate([c[on], b[~on], c[~on]])], axis=1)
    edges.sort(axis=1)
    edges, which = np.unique(edges, axis=0, return_inverse=True)
    new = len(points) + which.reshape(-1)
    halves, alone = int(on.sum()), int((~on).sum())
    middle, first_new, second_new = new[:halves], new[halves:halves + alone], new[halves + alone:]
    pieces = [(a[on], b[on], middle), (a[on], middle, c[on]), (a[~on], first_new, second_new),
              (first_new, b[~on], c[~on]), (first_new, c[~on], second_new)]
    signs = [sides[on, 1], sides[on, 2], sides[~on, 0], -sides[~on, 0], -sides[~on, 0]]
    points = np.concatenate([points, _points_between(points, edges, axis, value)])
    cut_faces = np.concatenate([np.stack(piece, axis=1) for piece in pieces]).astype(np.int32)
    signs = np.concatenate(signs)
    return (_compact(points, np.concatenate([faces[below], cut_faces[signs < 0]])),
            _compact(points, np.concatenate([faces[above & ~below], cut_faces[signs > 0]])))


def _border_edges(part: Part, axis: int, value: np.float32) -> np.ndarray:
    """Returns the edges of a part at a plane, as pairs of corners: numbers of a flat list of all triangles' corners."""
    corners = np.arange(part.faces.size).reshape(-1, 3)
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = part.faces.ravel()[edges].astype(np.int64)
    on = (part.points[ends, axis] == value).all(axis=1)
    edges, ends = edges[on], ends[on]
    # A triangle may lie in the plane: its inner edges run both ways.
    there, back = ends @ [len(part.points), 1], ends @ [1, len(part.points)]
    return edges[~np.isin(there, back)]


def _raise_widths(points: np.ndarray, ends: np.ndarray, other: np.ndarray, other_edges: np.ndarray) -> None:
    """Raises the widths of points on a border, whose numbers are `ends`, and of the ends of the closest edges of
    another border, to their distance."""
    a = other[other_edges[:, 0], :3].astype(np.float64)
    along = other[other_edges[:, 1], :3] - a
    square = np.maximum((along ** 2).sum(axis=1), 1e-300)
    step = max(1, PAIRS // len(a))
    for begin in range(0, len(ends), step):
        some = ends[begin:begin + step]
        to = points[some, None, :3] - a
        share = ((to * along).sum(axis=2) / square).clip(0, 1)
        distances = np.linalg.norm(to - share[:, :, None] * along, axis=2)
        closest = distances.argmin(axis=1)
        least = distances[np.arange(len(some)), closest].astype(np.float32)
        points[some, WIDTH] = np.maximum(points[some, WIDTH], least)
        for k in range(2):
            np.maximum.at(other[:, WIDTH], other_edges[closest, k], least)


def _widen(parts: list[Part], axis: int, value: np.float32) -> None:
    """Sets the widths of points on a plane, by how far the borders of levels near each other are apart."""
    borders = [part.faces.ravel()[_border_edges(part, axis, value)] for part in parts]
    for i, one in enumerate(borders):
        for j in range(i + 1, min(i + 1 + SKIRT_LEVELS, len(parts))):
            if len(one) and len(borders[j]):
                _raise_widths(parts[i].points, np.unique(one), parts[j].points, borders[j])
                _raise_widths(parts[j].points, np.unique(borders[j]), parts[i].points, one)


def _choose_plane(part: Part) -> tuple[int, np.float32]:
    """Returns the axis and the place of a plane with about half of the triangles on either side."""
    middles = part.points[part.faces, :3].astype(np.float64).mean(axis=1)
    low, high = part.points[:, :3].min(axis=0), part.points[:, :3].max(axis=0)
    for axis in np.argsort(low - high, kind="stable"):  # the longest side first
        value = np.float32(np.median(middles[:, axis]))
        if 0.25 < (middles[:, axis] < value).mean() < 0.75:
            return int(axis), value
    raise Error(65, f"{len(part.faces)} triangles at one place cannot be divided: allow more triangles in a tile")


def divide(parts: list[Part], limit: int, level: int = 0, low: Any = -np.inf, high: Any = np.inf) -> Tile:
    """Makes the tree of tiles of all levels in a region, the coarsest level first."""
    low, high = (np.broadcast_to(np.float32(side), 3).copy() for side in (low, high))
    tile = Tile(level, low, high, parts[0])
    waiting = [(parts[1:], tile.low, tile.high)]
    while waiting:
        rest, low, high = waiting.pop()
        skipped = level + 1
        while rest and not len(rest[0].faces):
            rest, skipped = rest[1:], skipped + 1
        if not rest:
            continue
        if len(rest[0].faces) <= limit:
            tile.children.append(divide(rest, limit, skipped, low, high))
            continue
        axis, value = _choose_plane(rest[0])
        halves = [cut(_slide(part, axis, value, low, high), axis, value) for part in rest]
        for side in zip(*halves):
            _widen(list(side), axis, value)
        middle_low, middle_high = low.copy(), high.copy()
        middle_low[axis] = middle_high[axis] = value
        waiting.append(([half[1] for half in halves], middle_low, high))
        waiting.append(([half[0] for half in halves], low, middle_high))
    return tile


# ---- skirts ----

def add_skirt(tile: Tile, rows: np.ndarray, faces: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
    """Adds strips to the vertices and triangles of a tile: from its edges on planes inwards, as wide as the gaps beside
    tiles of other levels, but not wider than `most`. They hide these gaps, and look as the edge. As both sides of a gap
    lie in a plane, strips do: against the normals, but for the part of these that leaves the plane."""
    part = tile.part
    edges = np.concatenate([_border_edges(part, axis, side[axis]) for side in (tile.low, tile.high) for axis in range(3)
                            if np.isfinite(side[axis])] or [np.empty((0, 2), np.int64)])
    size = part.points[:, :3].max(axis=0) - part.points[:, :3].min(axis=0)
    widths = np.empty(len(rows), np.float32)  # vertices at one point have one width
    widths[faces.ravel()] = part.points[part.faces.ravel(), WIDTH]
    widths = np.minimum(SKIRT_FACTOR * widths + SKIRT_LEAST * size.max(), max(most, SKIRT_LEAST * size.max()))
    used, which = np.unique(faces.ravel()[edges], return_inverse=True)
    lower = rows[used].copy()
    on_planes = (lower[:, :3] == tile.low) | (lower[:, :3] == tile.high)
    outwards = np.where(on_planes, 0, lower[:, 3:6])
    length = np.linalg.norm(outwards, axis=1)[:, None]
    outwards = np.where(length > SKIRT_STEEP, outwards / np.maximum(length, SKIRT_STEEP), lower[:, 3:6])
    lower[:, :3] -= widths[used, None] * outwards
    a, b = faces.ravel()[edges].T
    below_a, below_b = len(rows) + which.reshape(-1, 2).T
    strips = np.concatenate([np.stack([b, a, below_a], axis=1), np.stack([b, below_a, below_b], axis=1)])
    return np.concatenate([rows, lower]), np.concatenate([faces, strips]).astype(np.uint32)

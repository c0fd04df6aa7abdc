"""Tiles that planes cut out of the levels of a mesh, and skirts that hide gaps between tiles of different levels.

Planes divide space from the coarsest level down: a tile of one level is divided until each of its parts has few
enough triangles of the next level. Both sides of a plane get the same points and normals on it. Planes are the same
for all finer levels, so a tile covers what its children cover."""
from __future__ import annotations

import mmap
import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterator

import numpy as np

from .mesh import Error, ply_layout

#: Points closer to a plane than this share of their shortest edge move onto it, unless the surface is close to
#: parallel to the plane: the square of the sine of their angle.
SLIDE_SHARE, SLIDE_STEEP = 0.25, 0.1
#: The column of points that has the width of the skirt. Skirts hide gaps beside tiles up to SKIRT_LEVELS levels away;
#: they are wider than these by a factor, and by a share of the tile's size, for what is drawn between rounded points.
#: Of normals that are almost those of a plane, less than SKIRT_STEEP lies in it, and they are taken as they are.
WIDTH, SKIRT_LEVELS, SKIRT_FACTOR, SKIRT_LEAST, SKIRT_STEEP = 6, 2, 1.25, 1e-4, 0.1
#: Distances that are computed at once, and triangles.
PAIRS, ROWS = 1 << 20, 1 << 18
#: Arrays of more bytes are in a file without a name, which need not stay in memory.
LARGE = 1 << 21


@dataclass
class Part:
    """Triangles of a level inside a region: rows of positions, normals and widths of skirts, and triples of their
    numbers."""
    points: np.ndarray  # float32 (n, 7)
    faces: np.ndarray


class Store:
    """Parts of tiles, in a file without a name."""

    def __init__(self, folder: Path | None):
        self.folder, self.file = folder, tempfile.TemporaryFile(dir=folder)

    def add(self, part: Part) -> tuple[int, int, int]:
        """Returns where a part is, and its points and triangles."""
        at = self.file.seek(0, 2)
        self.file.write(np.ascontiguousarray(part.points))
        self.file.write(np.ascontiguousarray(part.faces))
        self.file.flush()
        return at, len(part.points), len(part.faces)

    def get(self, at: int, points: int, faces: int) -> Part:
        data = os.pread(self.file.fileno(), 28 * points + 12 * faces, at)
        return Part(np.frombuffer(data, np.float32, 7 * points).reshape(-1, 7),
                    np.frombuffer(data, np.int32, 3 * faces, 28 * points).reshape(-1, 3))

    def array(self, rows: int, columns: int, kind: Any) -> np.ndarray:
        """Returns an array that is not set."""
        if rows * columns * 4 < LARGE:
            return np.empty((rows, columns), kind)
        with tempfile.TemporaryFile(dir=self.folder) as file:
            file.truncate(rows * columns * 4)
            return np.frombuffer(mmap.mmap(file.fileno(), 0), kind).reshape(rows, columns)


@dataclass
class Tile:
    """A tile: its region, a box whose sides are planes or at infinity, and what is in it."""
    level: int  # 0: the coarsest
    low: np.ndarray
    high: np.ndarray
    store: Store
    place: tuple[int, int, int]  # of its part there
    name: str = ""
    error: float = 0.0  # no point of the tile and of the scan in its region is farther from the other one
    distances: dict = field(default_factory=dict)  # of the scan in its region from the level, and of the tile's points
    children: list[Tile] = field(default_factory=list)

    @property
    def part(self) -> Part:
        """What is in it, read anew."""
        return self.store.get(*self.place)

    @property
    def triangles(self) -> int:
        return self.place[2]

    def all(self) -> Iterator[Tile]:
        yield self
        for child in self.children:
            yield from child.all()


# ---- cutting ----

def _blocks(count: int) -> Iterator[slice]:
    return (slice(begin, min(begin + ROWS, count)) for begin in range(0, count, ROWS))


def _find(faces: np.ndarray, test: Any) -> np.ndarray:
    """Returns for each triangle what a test of many says."""
    found = np.empty(len(faces), bool)
    for rows in _blocks(len(faces)):
        found[rows] = test(faces[rows])
    return found


def read_level(path: Path, origin: np.ndarray, store: Store) -> Part:
    """Reads a PLY file of bisque-simplify; positions become relative to an origin."""
    (at, vertices, kind), (faces_at, faces, row) = ply_layout(path)
    read = np.memmap(path, kind, "r", at, vertices)
    part = Part(store.array(vertices, 7, np.float32), store.array(faces, 3, np.int32))
    for some in _blocks(vertices):
        for k, name in enumerate("xyz"):
            part.points[some, k] = read[name][some] - origin[k]
            part.points[some, 3 + k] = read["n" + name][some]
        part.points[some, 6] = 0
    read = np.memmap(path, row, "r", faces_at, faces)
    for some in _blocks(faces):
        part.faces[some] = read["v"][some]
    return part


def _slide(part: Part, axis: int, value: np.float32, low: np.ndarray, high: np.ndarray) -> None:
    """Moves points that are close to a plane onto it, along the surface: cuts through their edges would leave slivers.
    Points on the region's own planes stay, for the other side has them too."""
    points, faces = part.points, part.faces
    above = np.sign(points[:, axis] - value).astype(np.int8)
    across = _find(faces, lambda some: (above[some].min(axis=1) < 0) & (above[some].max(axis=1) > 0))
    near = np.zeros(len(points), bool)
    near[faces[across]] = True
    chosen = np.flatnonzero(near)
    chosen = chosen[~((points[chosen, :3] == low) | (points[chosen, :3] == high)).any(axis=1)]
    near[:] = False
    near[chosen] = True
    around = faces[_find(faces, lambda some: near[some].any(axis=1))]
    used, around = np.unique(around, return_inverse=True)
    around = around.reshape(-1, 3)
    p = points[used, :3].astype(np.float64)[around]
    edges = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2)
    shortest = np.full(len(used), np.inf)
    np.minimum.at(shortest, around, np.minimum(edges, np.roll(edges, 1, axis=1)))
    shortest = shortest[np.searchsorted(used, chosen)]
    normals = points[chosen, 3:6].astype(np.float64)
    along = -normals[:, axis, None] * normals
    along[:, axis] += 1
    rise = along[:, axis]  # the square of the length, too
    steep = rise > SLIDE_STEEP
    step = np.zeros_like(along)
    step[steep] = along[steep] * ((value - points[chosen[steep], axis].astype(np.float64)) / rise[steep])[:, None]
    moved = steep & (np.linalg.norm(step, axis=1) < SLIDE_SHARE * shortest)
    points[chosen[moved], :3] += step[moved].astype(np.float32)
    points[chosen[moved], axis] = value


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


def _take(part: Part, new: np.ndarray, chosen: np.ndarray, more: np.ndarray, store: Store) -> Part:
    """Returns chosen triangles, and more of them, which may have new points, behind the part's. Keeps the points that
    triangles have, in their order, and triangles with three positions."""
    count = len(part.points)

    def differ(p: np.ndarray) -> np.ndarray:
        return ~np.logical_or.reduce([(p[:, k] == p[:, (k + 1) % 3]).all(axis=1) for k in range(3)])

    chosen = chosen & _find(part.faces, lambda some: differ(part.points[some, :3]))
    p = np.empty((more.size, 3), np.float32)
    old, flat = more.ravel() < count, more.ravel()
    p[old], p[~old] = part.points[flat[old], :3], new[flat[~old] - count, :3]
    more = more[differ(p.reshape(-1, 3, 3))]
    used = np.zeros(count + len(new), bool)
    used[more] = True
    for rows in _blocks(len(chosen)):
        used[part.faces[rows][chosen[rows]]] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    out = Part(store.array(int(used.sum()), 7, np.float32), store.array(int(chosen.sum()) + len(more), 3, np.int32))
    at = 0
    for rows in _blocks(count):
        some = part.points[rows][used[rows]]
        out.points[at:at + len(some)] = some
        at += len(some)
    out.points[at:] = new[used[count:]]
    at = 0
    for rows in _blocks(len(chosen)):
        some = number[part.faces[rows][chosen[rows]]]
        out.faces[at:at + len(some)] = some
        at += len(some)
    out.faces[at:] = number[more]
    return out


def cut(part: Part, axis: int, value: np.float32, store: Store) -> tuple[Part, Part]:
    """Divides triangles at a plane: those below it, and those above."""
    points, faces = part.points, part.faces
    side = np.sign(points[:, axis] - value).astype(np.int8)
    below = _find(faces, lambda some: (side[some] <= 0).all(axis=1))
    above = _find(faces, lambda some: (side[some] >= 0).all(axis=1))
    across = faces[~(below | above)]
    sides = side[across]
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
    found = _points_between(points, edges, axis, value)
    cut_faces = np.concatenate([np.stack(piece, axis=1) for piece in pieces]).astype(np.int32)
    signs = np.concatenate(signs)
    return (_take(part, found, below, cut_faces[signs < 0], store),
            _take(part, found, above & ~below, cut_faces[signs > 0], store))


def _border_edges(part: Part, axis: int, value: np.float32) -> np.ndarray:
    """Returns the edges of a part at a plane, as pairs of corners: numbers of a flat list of all triangles' corners."""
    at = part.points[:, axis] == value
    rows = np.flatnonzero(_find(part.faces, lambda some: at[some].sum(axis=1) > 1))
    corners = 3 * rows[:, None] + np.arange(3)
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = part.faces.ravel()[edges].astype(np.int64)
    on = at[ends].all(axis=1)
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


def divide(parts: list[Part], limit: int, store: Store, level: int = 0, low: Any = -np.inf,
           high: Any = np.inf) -> Tile:
    """Makes the tree of tiles of all levels in a region, the coarsest level first. Takes the parts out of the list, and
    changes them."""
    low, high = (np.broadcast_to(np.float32(side), 3).copy() for side in (low, high))
    tile = Tile(level, low, high, store, store.add(parts[0]))
    waiting = [(parts[1:], tile.low, tile.high)]
    parts.clear()
    while waiting:
        rest, low, high = waiting.pop()
        skipped = level + 1
        while rest and not len(rest[0].faces):
            rest, skipped = rest[1:], skipped + 1
        if not rest:
            continue
        if len(rest[0].faces) <= limit:
            tile.children.append(divide(rest, limit, store, skipped, low, high))
            continue
        axis, value = _choose_plane(rest[0])
        halves = []
        while rest:  # a part goes before the next one is cut
            _slide(rest[0], axis, value, low, high)
            halves.append(cut(rest.pop(0), axis, value, store))
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

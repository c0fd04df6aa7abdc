"""UVs: a library unwraps the mesh, and Bisque's own raster checks the result."""
from __future__ import annotations

import importlib.util
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from bisque_unwrap import LIBRARIES

from . import programs
from .core import Error, Job, Progress, bake, check_stopping, quiet
from .mesh import Mesh, as_mesh, parse_texels
from .repair import connected, edge_pairs, face_normals, seams


class UnwrapError(Error):
    """A mesh that a library could not unwrap, with advice."""

    def __init__(self, message: str):
        super().__init__(65, message)


ADVICE = ("ask for fewer triangles, drop small pieces (min_component=1), or take the other "
          "library (library={other!r})")

#: Charts with fewer texels are small, and get that many if more than a share of all are; neither library
#: takes sizes of charts.
SMALL_TEXELS, WANTED_TEXELS, MOST_SMALL = 16, 24, 0.03
#: A needle is this many times as long as it is wide, in the mean.
SLENDER = 16
#: The library may split charts that got larger.
MOST_RUNS = 3
#: Strips around charts: their width in texels, and how many times farther than the triangle reaches they go at most.
STRIP_TEXELS, MOST_BEYOND = 1.5, 16
#: The library that is taken if none is named: uvunwrap, but for Pythons that it is not made for.
USUAL = next((name for name in LIBRARIES if importlib.util.find_spec(name)), "uvunwrap")


def _wait_for(command: list[str], seconds: float) -> tuple[int, str]:
    """Runs a program. Returns its exit code and what it said. Raises TimeoutExpired."""
    end = time.monotonic() + seconds
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                          text=True, errors="replace", env=programs.environment()) as program:
        try:
            while True:
                left = end - time.monotonic()
                try:
                    said = program.communicate(timeout=max(0, min(left, 0.2)))[1]
                    return program.returncode, said
                except subprocess.TimeoutExpired:
                    if left <= 0:
                        raise
                check_stopping()
        except BaseException:
            program.kill()
            raise


def _run(mesh: Mesh, library: str, size: int, padding: int, seconds: float) -> np.ndarray:
    """Returns the texture coordinates (faces, 3, 2) that a library makes in a process of its own. Raises
    UnwrapError."""
    other = "xatlas" if library == "uvunwrap" else "uvunwrap"
    with Job() as job:
        source, target = Path(job.temporary("mesh.npz")), Path(job.temporary("uvs.npy"))
        # Around its centre, so that 32-bit coordinates keep the detail.
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        np.savez(source, vertices=mesh.vertices - (low + high) / 2, faces=mesh.faces)
        command = [sys.executable, "-m", "bisque_unwrap", str(source), str(target), library, str(size),
                   str(padding)]
        try:
            code, said = _wait_for(command, seconds)
        except subprocess.TimeoutExpired:
            raise UnwrapError(f"{library} did not unwrap {len(mesh.faces)} triangles in {seconds:g}"
                              f" s: {ADVICE.format(other=other)}") from None
        if code != 0 or not target.exists():
            reason = (said.strip() or f"it ended with {code}").splitlines()[-1]
            if code == -signal.SIGKILL or "MemoryError" in reason.partition(":")[0]:
                raise Error(71, f"{library} had too little memory to unwrap {len(mesh.faces)} triangles")
            raise UnwrapError(f"{library} could not unwrap {len(mesh.faces)} triangles ({reason}): "
                              f"{ADVICE.format(other=other)}")
        uvs = np.load(target)
        if not np.isfinite(uvs).all():
            raise UnwrapError(f"{library} made texture coordinates that are no numbers: "
                              f"{ADVICE.format(other=other)}")
        return uvs


# ---- checks ----

def _charts(uvs: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Numbers the chart of each triangle: those that share an edge in texture space and on the
    mesh."""
    corners = np.concatenate([faces[:, :, None].astype(np.float64), uvs], axis=2).reshape(-1, 3)
    _, ids = np.unique(corners, axis=0, return_inverse=True)
    pairs = edge_pairs(ids.reshape(-1, 3))[0] // 3
    return np.unique(connected(len(faces), *pairs.T), return_inverse=True)[1]


def _signed_areas(uvs: np.ndarray) -> np.ndarray:
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def _stretches(mesh: Mesh, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the area of each triangle, and the larger singular value of its map to texture space
    over the smaller one."""
    p = mesh.vertices[mesh.faces].astype(np.float64)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    length = np.maximum(np.linalg.norm(e1, axis=1), 1e-300)
    x2 = (e1 * e2).sum(axis=1) / length
    y2 = np.linalg.norm(np.cross(e1, e2), axis=1) / length
    d1, d2 = (uvs[:, 1] - uvs[:, 0]).astype(np.float64), (uvs[:, 2] - uvs[:, 0]).astype(np.float64)
    along = d1 / length[:, None]
    across = (d2 - along * x2[:, None]) / np.maximum(y2, 1e-300)[:, None]
    a, b = (along ** 2).sum(axis=1), (across ** 2).sum(axis=1)
    c = (along * across).sum(axis=1)
    root = np.sqrt(np.maximum((a - b) ** 2 + 4 * c ** 2, 0))
    return length * y2 / 2, np.sqrt((a + b + root) / np.maximum(a + b - root, 1e-300))


def _percentile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(sums, share * sums[-1]).clip(0, len(values) - 1)])


def check_uvs(low: Any, size: int | str = 1024, **job: Any) -> dict:
    """Measures texture coordinates with the raster that bakes use: overlapping samples, triangles
    that are flipped or without area, the used share of the texels, the 95th percentile of stretch
    by area, the number of charts, of those with under 16 texels, and the texels of the smallest one."""
    mesh, size = as_mesh(low), parse_texels(size)
    if mesh.uvs is None:
        raise ValueError("the mesh has no texture coordinates: unwrap() makes them")
    uvs = mesh.corner_uvs()
    with np.errstate(all="ignore"):
        areas, stretches = _stretches(mesh, uvs)
    signed = _signed_areas(uvs)
    for what, sizes in (("mesh", areas), ("texture coordinates", signed)):
        if not 0 < np.abs(sizes).sum() < np.inf:
            raise Error(65, f"the low-poly mesh: the area of its {what} is 0, or no number")
    charts = _charts(uvs, mesh.faces)
    texels = np.bincount(charts, np.abs(signed)) * size * size
    with quiet():  # the mesh is its own scan: only what the raster counts is wanted
        counted = bake((mesh.vertices, mesh.faces), mesh, ("mask",), size=size, samples=1, padding=0, tiles=(1001,),
                       as_is=True, two_sided=True, device="cpu", format="", arrays=False, **job).report
    real = areas > areas.max() * 1e-12
    return {"charts": len(texels), "smallest_chart_texels": float(texels.min()),
            "small_charts": int((texels < SMALL_TEXELS).sum()),
            "overlapping_samples": counted["overlapping_samples"],
            "outside_triangles": counted["outside_uv_triangles"],
            "degenerate_triangles": counted["degenerate_uv_triangles"],
            "flipped_triangles": int((signed < 0).sum()),
            "used_share": counted["covered_texels"] / size ** 2,
            "uv_share": float(np.abs(signed).sum()),
            "stretch_p95": _percentile(stretches[real], areas[real], 0.95), "size": size}


def _extents(charts: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Returns the longest side of the box of each chart."""
    low, high = (np.full((charts.max() + 1, corners.shape[2]), of) for of in (np.inf, -np.inf))
    np.minimum.at(low, charts, corners.min(axis=1))
    np.maximum.at(high, charts, corners.max(axis=1))
    return (high - low).max(axis=1)


def _enlarge_small(mesh: Mesh, uvs: np.ndarray, size: int) -> Mesh | None:
    """Returns the mesh with a piece of its own for each chart, of which small ones are larger. Each triangle of a
    needle that would still be small becomes an equilateral one. None: few are small."""
    charts = _charts(uvs, mesh.faces)
    texels = np.bincount(charts, np.abs(_signed_areas(uvs))) * size * size
    if (texels < SMALL_TEXELS).mean() <= MOST_SMALL:
        return None
    p = mesh.vertices[mesh.faces].astype(np.float64)
    sizes = face_normals(mesh)[1]
    scale = np.sqrt(texels.sum() / max(sizes.sum(), 1e-300)) / size
    # A needle of no area would grow without end, and so would what the library made a point of.
    sides = np.maximum(_extents(charts, uvs), scale * _extents(charts, p)).clip(1e-9)
    most = 1 / (8 * sides)
    factor = np.sqrt(WANTED_TEXELS / texels.clip(1e-9)).clip(1, most.clip(1))
    real = np.maximum(texels, np.bincount(charts, sizes) * (scale * size) ** 2)
    thin = SLENDER ** 2 * real < (sides * size) ** 2
    needles = np.flatnonzero((thin & (factor ** 2 * real < SMALL_TEXELS))[charts])
    charts[needles] = len(factor) + np.arange(len(needles))
    factor = np.append(factor, np.ones(len(needles)))
    corners, faces = np.unique(charts[:, None] * len(mesh.vertices) + mesh.faces, return_inverse=True)
    chart, vertices = corners // len(mesh.vertices), mesh.vertices[corners % len(mesh.vertices)].astype(np.float64)
    sums, faces = np.stack([np.bincount(chart, vertices[:, k]) for k in range(3)], axis=1), faces.reshape(-1, 3)
    middle = sums / np.bincount(chart).clip(1)[:, None]
    vertices = middle[chart] + (vertices - middle[chart]) * factor[chart, None]
    # Three corners of a unit cube are an equilateral triangle, of area sqrt(3) / 2.
    side = np.sqrt(WANTED_TEXELS / np.sqrt(0.75)) / (scale * size)
    vertices[faces[needles]] = middle[charts[needles], None] + side * np.eye(3)
    return Mesh(vertices, faces)


def _turn_mirrored(mesh: Mesh, uvs: np.ndarray) -> tuple[np.ndarray, int]:
    """Mirrors charts that are mirrored, each within its own box. Returns how many there were."""
    charts = _charts(uvs, mesh.faces)
    signed = np.bincount(charts, _signed_areas(uvs))
    for chart in np.flatnonzero(signed < 0):
        corners = charts == chart
        u = uvs[corners, :, 0]
        uvs[corners, :, 0] = u.min() + u.max() - u
    return uvs, int((signed < 0).sum())


def extend_charts(mesh: Mesh, size: int) -> Mesh:
    """Returns a mesh whose charts have strips around them, which follow all its triangles. They go on as the
    triangles inside of them do, in space too. So a bake gives texels that filters read beyond a chart what the scan has
    there, and both sides of a seam look alike. The mesh has normals, and texture coordinates for maps of `size`."""
    corners = np.arange(mesh.faces.size).reshape(-1, 3)
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    ends, uvs = mesh.uv_faces.ravel()[edges].astype(np.int64), mesh.uvs.astype(np.float64)
    outer = ~np.isin(ends @ [len(uvs), 1], ends @ [1, len(uvs)])
    edges, ends = edges[outer], ends[outer]
    along = uvs[ends[:, 1]] - uvs[ends[:, 0]]
    outwards = along[:, ::-1] * [1, -1] / np.linalg.norm(along, axis=1).clip(1e-30)[:, None]
    sums = np.zeros_like(uvs)
    for k in range(2):
        np.add.at(sums, ends[:, k], outwards)
    mitres = 2 * sums / (sums ** 2).sum(axis=1).clip(1)[:, None]  # up to twice as long as the strip is wide
    tips = (uvs + STRIP_TEXELS / size * mitres).clip(0, 1)[ends]
    triangles = edges[:, 0] // 3
    inside, weights = uvs[mesh.uv_faces[triangles]], np.empty((len(edges), 2, 3))
    with np.errstate(all="ignore"):
        for end, k in np.ndindex(2, 3):
            moved = inside.copy()
            moved[:, k] = tips[:, end]
            weights[:, end, k] = _signed_areas(moved) / _signed_areas(inside)
        good = (np.abs(weights) < MOST_BEYOND).all(axis=(1, 2))
    edges, weights, tips, triangles = edges[good], weights[good], tips[good], triangles[good]

    def add(rows: np.ndarray, faces: np.ndarray, new: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        new = weights @ rows[faces[triangles]] if new is None else new
        (a, b), first = faces.ravel()[edges].T, len(rows) + 2 * np.arange(len(edges))
        strips = [np.stack(of, axis=1) for of in ((b, a, first), (b, first, first + 1))]
        return np.concatenate([rows, new.reshape(-1, rows.shape[1])]), np.concatenate([faces, *strips])

    return Mesh(*add(mesh.vertices, mesh.faces), *add(mesh.uvs, mesh.uv_faces, tips),
                *add(mesh.normals, mesh.normal_faces), report=mesh.report)


def unwrap(low: Any, *, size: int | str = 2048, padding: int = 4, library: str = USUAL,
           seconds: float = 120, memory: Any = None, threads: int = 0,
           progress: Progress | None = None) -> Mesh:
    """Gives a mesh texture coordinates in one square, with `padding` texels around each chart in maps
    of `size` texels, by "uvunwrap" or "xatlas". The mesh's report gets what check_uvs() finds, as
    "uv". Charts that the library mirrors are put right. If many have under 16 texels, they get more, triangles of
    needles get equal sides, and the library runs again. Edges over which normals differ by more than 20 degrees are seams. Raises
    UnwrapError, with advice, if the
    library takes longer than `seconds`, fails, or lays charts over each other. Texels are as dense
    everywhere: neither library takes weights of faces."""
    mesh, size = as_mesh(low), parse_texels(size)
    if library not in LIBRARIES:
        raise ValueError(f"library: {library!r} is none of {', '.join(LIBRARIES)}")
    corners = seams(mesh)
    shape: Mesh | None = mesh
    if corners is not None:
        vertex = np.empty(corners.max() + 1, np.int64)
        vertex[corners] = mesh.faces
        shape = Mesh(mesh.vertices[vertex], corners)
    for _ in range(MOST_RUNS):
        uvs = _run(shape, library, size, padding, seconds)
        shape = _enlarge_small(shape, uvs, size)
        if shape is None:
            break
    uvs, mirrored = _turn_mirrored(mesh, uvs)
    flat, faces = np.unique(uvs.reshape(-1, 2), axis=0, return_inverse=True)
    result = Mesh(mesh.vertices, mesh.faces, flat, faces.reshape(-1, 3), mesh.normals,
                  mesh.normal_faces, mesh.colors, dict(mesh.report))
    report = check_uvs(result, min(size, 2048), memory=memory, threads=threads, progress=progress)
    report.update(library=library, mirrored_charts=mirrored)
    result.report["uv"] = report
    if report["overlapping_samples"] > 0 or report["outside_triangles"] > 0:
        other = "xatlas" if library == "uvunwrap" else "uvunwrap"
        raise UnwrapError(f"{library} made charts that overlap in {report['overlapping_samples']} "
                          f"samples, or lie outside of the square: {ADVICE.format(other=other)}")
    return result

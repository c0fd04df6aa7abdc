"""What a low-poly mesh needs before it is unwrapped: faces that look outwards, holes closed, hard edges.

The scan itself stays as it is, for it may have 10^9 triangles. Rays into it tell which of its faces look away from
the mesh; then it is baked from both sides."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from . import core
from .mesh import Error, Mesh, check_number, check_real, check_triangles, parse_amount
from .place import parse_length

#: Points of the mesh at which rays test the scan; those of each piece, and of all, that test where outside is.
PROBES, PIECE_PROBES, MOST_PIECE_PROBES = 4096, 48, 50_000
#: Of the sky that a piece sees on average: a side that sees less than the first, and less than a quarter of the
#: other side, which sees more than the second, is the inner one. Pieces without such a side, as inner walls, follow
#: the others if these have at least so much of the area.
INNER_SKY, OUTER_SKY, MAJORITY = 0.15, 0.2, 0.9
#: Share of the rays that may miss the scan before it is tested from both sides.
MISSES = 0.0005
#: Hard edges: where the scan is looked at along an edge, and on the way from there to the third corner; and the
#: share of the angle that it must have.
ALONG, BESIDE, KEPT_ANGLE = (0.2, 0.5, 0.8), 0.1, 0.6
#: Edges of a line of hard edges, at least.
SHORTEST_LINE = 8
#: Degrees above which an edge is a fold, which is hard whatever the scan has.
FOLD = 100
#: Degrees between normals at an edge that make it a seam.
SEAM_ANGLE = 20
#: The most edges that are tested, those with the largest angles.
MOST_EDGES = 60_000


def check_options(triangles: Any, error: Any, unit: float, *, min_component: Any, min_triangles: Any, close_holes: Any,
                  hard_angle: Any, winding: Any) -> dict:
    """Refuses values that make no sense, by ValueError. unit: metres of a unit of the scan. Returns the options of
    simplify(), `triangles` or `error` and the others in `simplify`, and those of mended() in `mend`."""
    if triangles is not None and error is not None:
        raise ValueError("triangles and error: only one of them makes a mesh")
    if triangles is not None:
        triangles = check_triangles(triangles, 4)
    if winding not in ("auto", "keep"):
        raise ValueError(f"winding: {winding!r} is none of auto, keep")
    check_real("hard_angle", hard_angle, 0, 180)
    least = {"min_component": parse_amount("min_component", str(min_component).removesuffix("%") + "%")[0],
             "min_triangles": check_number("min_triangles", min_triangles, 0, 2 ** 32 - 1)}
    error = parse_length("error", error, unit)
    return {"triangles": triangles, "error": error, "simplify": least if error is None else {**least, "error": error},
            "mend": {"winding": winding, "hard_angle": hard_angle,
                     "close_holes": parse_length("close_holes", close_holes, unit)}}


# ---- rays ----

def probe(scan: Any, points: np.ndarray, normals: np.ndarray, names: list[str], reach: float, **options: Any) -> dict:
    """Casts a ray both ways along the normal of each point. Returns maps by name, a row for each point; "mask" is 1 if
    the ray hit something. reach: of the rays."""
    count = len(points)
    side = int(np.ceil(count ** 0.5))
    rows = -(-count // side)
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across *= 1e-3 * reach / np.linalg.norm(across, axis=1, keepdims=True)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = points[:, None] + square[:, :1] * across[:, None] + square[:, 1:] * np.cross(normals, across)[:, None]
    cell = np.stack([np.arange(count) % side, rows - 1 - np.arange(count) // side], axis=1)
    uvs = (cell[:, None] + (square + 1) / 2) / [side, rows]
    faces = (4 * np.arange(count)[:, None] + [0, 1, 2, 0, 2, 3]).reshape(-1, 3)
    atlas = Mesh(corners.reshape(-1, 3), faces, uvs.reshape(-1, 2), faces, np.repeat(normals, 4, axis=0), faces)
    with core.quiet():
        try:
            maps = core.bake(scan, atlas, [*names, "mask"], size=(side, rows), samples=1, padding=0, front=reach,
                             back=reach, normal_space="object", sample_type="float", as_is=True, format="",
                             device="cpu", **options)
        except core.Error as error:
            if not error.message.startswith(("no ray hit", "no texel is covered")):
                raise
            return {name: np.zeros(count) for name in [*names, "mask"]}
    return {name: values.reshape(side * rows, -1)[:count].squeeze() for name, values in maps.items()}


def _spread(mesh: Mesh, weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns faces, in proportion to weights, and points in them: the same each time."""
    draw = np.random.default_rng(1)
    sums = np.cumsum(weights)
    which = np.searchsorted(sums, (np.arange(count) + 0.5) / count * sums[-1]).clip(0, len(weights) - 1)
    a, b = draw.random((2, count))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    p = mesh.vertices[mesh.faces[which]].astype(float)
    return which, p[:, 0] + a[:, None] * (p[:, 1] - p[:, 0]) + b[:, None] * (p[:, 2] - p[:, 0])


def face_normals(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Returns the unit normals of the faces, and their areas."""
    p = mesh.vertices[mesh.faces].astype(float)
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    length = np.linalg.norm(n, axis=1)
    return n / length.clip(1e-300)[:, None], length / 2


# ---- topology ----

def edge_pairs(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the half-edges that share an edge with just one other: rows of two, numbered 3 * face + corner; whether
    both run in one direction, as if one of the faces were turned; and the half-edges that have no other."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    key = np.sort(ends, axis=1)
    order = np.lexsort(key.T[::-1])
    key = key[order]
    starts = np.flatnonzero(np.r_[True, (key[1:] != key[:-1]).any(axis=1)])
    counts = np.diff(np.r_[starts, len(key)])
    two = starts[counts == 2]
    pairs = np.stack([order[two], order[two + 1]], axis=1)
    same = ends[pairs[:, 0], 0] == ends[pairs[:, 1], 0]
    return pairs, same, order[starts[counts == 1]]


def connected(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns, for each of `count` things, the least one that it is connected with."""
    label = np.arange(count)
    while True:
        least = np.minimum(label[a], label[b])
        before = label.copy()
        np.minimum.at(label, label[a], least)
        np.minimum.at(label, label[b], least)
        label = label[label]
        if (label == before).all():
            return label


def fans(faces: np.ndarray, joined: np.ndarray) -> np.ndarray:
    """Numbers the corners (faces, 3): those at one vertex are one if edges that are `joined`, pairs of half-edges of
    opposite directions, lie between their faces."""
    following = joined - joined % 3 + (joined + 1) % 3
    a = np.concatenate([joined[:, 0], following[:, 0]])
    b = np.concatenate([following[:, 1], joined[:, 1]])
    return np.unique(connected(faces.size, a, b), return_inverse=True)[1].reshape(-1, 3)


def _smooth_normals(mesh: Mesh, corners: np.ndarray) -> np.ndarray:
    """Returns a normal for each number of `corners`: the faces' normals, weighted by their angles there."""
    p = mesh.vertices[mesh.faces].astype(float)
    along = np.roll(p, -1, axis=1) - p
    along /= np.linalg.norm(along, axis=2, keepdims=True).clip(1e-300)
    angles = np.arccos((-(along * np.roll(along, 1, axis=1)).sum(axis=2)).clip(-1, 1))
    weighted = angles[:, :, None] * face_normals(mesh)[0][:, None]
    sums = np.stack([np.bincount(corners.ravel(), weighted[:, :, k].ravel()) for k in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(length > 1e-12, sums / length.clip(1e-300), [0, 0, 1]).astype(np.float32)


# ---- winding ----

def _make_consistent(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Turns as few faces as it takes for neighbours to have one winding. Returns the turned ones, the piece of each
    face, and whether some could not be made consistent, as on a Moebius strip."""
    pairs, same, _ = edge_pairs(faces)
    a, b = pairs[:, 0] // 3, pairs[:, 1] // 3
    piece = connected(len(faces), a, b)
    if not same.any():
        return np.zeros(len(faces), bool), piece, False
    # A face and its turned twin: neighbours that agree join those of one kind, the others those of unlike kinds.
    n = len(faces)
    label = connected(2 * n, np.r_[a, a + n], np.r_[np.where(same, b + n, b), np.where(same, b, b + n)])
    turned = label[:n] > label[n:]
    for root in np.unique(piece[turned]):
        of = np.flatnonzero(piece == root)
        if 2 * turned[of].sum() > len(of):
            turned[of] = ~turned[of]
    return turned, piece, bool((label[:n] == label[n:]).any())


def _sky(mesh: Mesh, piece: np.ndarray, areas: np.ndarray, job: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the pieces, and how much of the sky their fronts and backs see on average."""
    roots, number = np.unique(piece, return_inverse=True)
    share = areas / np.bincount(number, areas)[number].clip(1e-300)  # pieces have as many points each
    order = np.argsort(number, kind="stable")
    by_piece = Mesh(mesh.vertices, mesh.faces[order])
    count = min(len(roots) * PIECE_PROBES, MOST_PIECE_PROBES)
    which, points = _spread(by_piece, share[order].clip(1e-12), count)
    normals = face_normals(by_piece)[0][which]
    reach = 1e-4 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    both = np.concatenate([normals, -normals])
    found = probe((mesh.vertices.astype(float), mesh.faces), np.concatenate([points, points]), both, ["ao"], reach,
                  ao_rays=32, two_sided=True, **job)
    of = number[order][which]
    counts = np.bincount(of, minlength=len(roots)).clip(1)
    sky = (found["ao"] * found["mask"]).reshape(2, count)
    return roots, *(np.bincount(of, side, len(roots)) / counts for side in sky)


def _is_inner(side: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns which sides, by the sky that they and the other ones see, are inner ones."""
    return (side < INNER_SKY) & (other > OUTER_SKY) & (other > 4 * side)


def _turn(mesh: Mesh, turned: np.ndarray) -> Mesh:
    faces = mesh.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    return Mesh(mesh.vertices, faces, report=mesh.report)


def orient(mesh: Mesh, job: dict) -> tuple[Mesh, dict]:
    """Makes the winding of each connected piece consistent, and turns pieces that are inside out: those that see hardly
    any sky in front of them, and more of it behind (Takayama and others, 2014)."""
    turned, piece, impossible = _make_consistent(mesh.faces)
    result = _turn(mesh, turned) if turned.any() else mesh
    areas = face_normals(result)[1]
    roots, front, back = _sky(result, piece, areas, job)
    inward, outward = (_is_inner(*sides) for sides in ((front, back), (back, front)))
    of_piece = np.bincount(np.searchsorted(roots, piece), areas)
    if of_piece[inward].sum() > MAJORITY * of_piece[inward | outward].sum():
        inward = ~outward
    inside_out = roots[inward]
    if len(inside_out):
        result = _turn(result, np.isin(piece, inside_out))
    share = areas[np.isin(piece, inside_out)].sum() / areas.sum()
    return result, {"pieces": len(roots), "turned_faces": int(turned.sum()), "turned_pieces": len(inside_out),
                    "turned_share": float(share), "double_sided": impossible}


# ---- holes ----

def _loops(faces: np.ndarray) -> list[list[int]]:
    """Returns the closed lines of edges without a second face, each against the direction of its faces. Lines that
    meet themselves at a vertex are left out."""
    border = edge_pairs(faces)[2]
    start, end = faces.ravel()[border], np.roll(faces, -1, axis=1).ravel()[border]
    follows: dict[int, int | None] = {}
    for a, b in zip(end.tolist(), start.tolist()):
        follows[a] = None if a in follows else b
    loops, seen = [], set()
    for first in follows:
        loop, at = [], first
        while at is not None and at not in seen and at in follows:
            seen.add(at)
            loop.append(at)
            at = follows[at]
        if at == first and len(loop) > 2:
            loops.append(loop)
    return loops


def _fill(points: np.ndarray) -> list[tuple[int, int, int]]:
    """Returns the triangles of least area that fill a closed line (Barequet and Sharir, 1995)."""
    n = len(points)
    cost, split = np.zeros((n, n)), np.zeros((n, n), int)
    for span in range(2, n):
        for i in range(n - span):
            k = i + span
            middle = np.arange(i + 1, k)
            areas = np.linalg.norm(np.cross(points[middle] - points[i], points[k] - points[i]), axis=1)
            sums = cost[i, middle] + cost[middle, k] + areas
            least = int(sums.argmin())
            cost[i, k], split[i, k] = sums[least], middle[least]
    found, left = [], [(0, n - 1)]
    while left:
        i, k = left.pop()
        if k - i > 1:
            found.append((i, int(split[i, k]), k))
            left += [(i, int(split[i, k])), (int(split[i, k]), k)]
    return found


def close_holes(mesh: Mesh, size: float) -> tuple[Mesh, int]:
    """Fills holes whose box has a diagonal of at most `size`. Returns how many."""
    faces, closed = [mesh.faces], 0
    for loop in _loops(mesh.faces):
        points = mesh.vertices[loop].astype(float)
        if np.linalg.norm(np.ptp(points, axis=0)) <= size:
            faces.append(np.asarray(loop, mesh.faces.dtype)[np.asarray(_fill(points))])
            closed += 1
    return (Mesh(mesh.vertices, np.concatenate(faces), report=mesh.report) if closed else mesh), closed


# ---- hard edges, and the scan ----

def _edge_probes(mesh: Mesh, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns points beside edges, in the triangles of both sides (edges, 2, points, 3), and the normals of these."""
    face, corner = pairs // 3, pairs % 3
    p = mesh.vertices[mesh.faces[face]].astype(float)
    rows = np.arange(len(pairs))[:, None], np.arange(2)
    a, b, c = (p[(*rows, (corner + k) % 3)][:, :, None] for k in range(3))
    on_edge = a + np.array(ALONG)[:, None] * (b - a)
    at = on_edge + BESIDE * (c - on_edge)
    return at, np.broadcast_to(face_normals(mesh)[0][face][:, :, None], at.shape)


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos((a * b).sum(axis=-1).clip(-1, 1)))


def _in_lines(mesh: Mesh, edges: np.ndarray) -> np.ndarray:
    """Returns which of the half-edges meet, by their ends, at least SHORTEST_LINE of them: a few alone are noise."""
    ends = np.stack([mesh.faces.ravel()[edges], np.roll(mesh.faces, -1, axis=1).ravel()[edges]])
    line = connected(len(mesh.vertices), *ends)[ends[0]]
    return np.bincount(line, minlength=1)[line] >= SHORTEST_LINE


def look(mesh: Mesh, chunks: str, hard_angle: float, reach: float, job: dict) -> tuple[np.ndarray, np.ndarray, dict]:
    """Looks at the scan along the normals of the mesh. Returns pairs of half-edges, those of edges that are hard: where
    the mesh has an angle above `hard_angle`, and the scan one near as large; and a report, with `two_sided`: the scan
    has faces that look the other way. reach: how far the scan may be from the mesh."""
    pairs, same, _ = edge_pairs(mesh.faces)
    pairs = pairs[~same]
    normals, areas = face_normals(mesh)
    angles = _angles(normals[pairs[:, 0] // 3], normals[pairs[:, 1] // 3])
    tested = np.flatnonzero(angles > hard_angle)
    tested = tested[np.argsort(-angles[tested], kind="stable")][:MOST_EDGES]
    which, points = _spread(mesh, areas, PROBES)
    beside, facing = _edge_probes(mesh, pairs[tested])
    at, along = np.concatenate([points, beside.reshape(-1, 3)]), np.concatenate([normals[which], facing.reshape(-1, 3)])
    job = {**job, "scan_normals": "flat"}
    found = probe(chunks, at, along, ["normal"], reach, **job)
    misses = 1 - found["mask"][:PROBES].mean()
    two_sided = False
    if misses > MISSES:
        both = probe(chunks, at, along, ["normal"], reach, two_sided=True, **job)
        two_sided = bool(1 - both["mask"][:PROBES].mean() < misses - MISSES)
        found = both if two_sided else found
    seen, hit = 2 * found["normal"] - 1, found["mask"] > 0
    hits = hit[PROBES:].reshape(len(tested), 2, len(ALONG), 1)
    sides = (seen[PROBES:].reshape(len(tested), 2, len(ALONG), 3) * hits).sum(axis=2)
    sides /= np.linalg.norm(sides, axis=2, keepdims=True).clip(1e-30)
    like = hits.any(axis=(2, 3)).all(axis=1) & (_angles(sides[:, 0], sides[:, 1]) > KEPT_ANGLE * angles[tested])
    like[like] = _in_lines(mesh, pairs[tested[like], 0])
    hard = tested[like | (angles[tested] > FOLD)]
    return pairs, hard, {"two_sided": two_sided, "inward_share": float(misses if two_sided else 0),
                         "hard_edges": len(hard)}


def seams(mesh: Mesh) -> np.ndarray | None:
    """Returns numbers of corners (faces, 3) that are apart at edges over which normals differ, or None: there are no
    such edges. Charts must not cross them."""
    if mesh.normal_faces is None:
        return None
    pairs, same, _ = edge_pairs(mesh.faces)
    pairs = pairs[~same]
    following = pairs - pairs % 3 + (pairs + 1) % 3
    normals = mesh.normals[mesh.normal_faces].reshape(-1, 3).astype(float)
    hard = np.maximum(_angles(normals[pairs[:, 0]], normals[following[:, 1]]),
                      _angles(normals[following[:, 0]], normals[pairs[:, 1]])) > SEAM_ANGLE
    return fans(mesh.faces, pairs[~hard]) if hard.any() else None


# ---- the step ----

def _told(report: dict, normals: bool) -> list[str]:
    """Returns what the user should know of a report. normals: the scan has vertex normals of its own."""
    lines = []
    if report.get("turned_pieces"):
        lines.append(f"{100 * report['turned_share']:.3g} % of the mesh looked inwards, as the scan does there: its "
                     "faces are turned (--winding keep leaves them)")
    if report["two_sided"]:
        # Vertex normals say what a face's front is. The mesh has the winding of the scan.
        against = normals and not (report.get("turned_faces") or report.get("turned_pieces"))
        what = "vertex normals of the scan that look away from the fronts of its faces" if against else (
            "faces of the scan that look the other way")
        lines.append(f"{100 * report['inward_share']:.3g} % of the mesh meets {what}: it is baked from both sides")
    if report.get("double_sided"):
        lines.append("some faces of the mesh cannot be wound alike, as those of a Moebius strip: the GLB file shows "
                     "both sides")
    return lines


def _mend(low: Mesh, how: dict, chunks: str, reach: float, job: dict) -> tuple[Mesh, dict]:
    """Returns a mesh of bisque-simplify as it is unwrapped, and a report."""
    before, report = low, {"closed_holes": 0}
    if how["winding"] == "auto":
        low, report = orient(low, job)
    size, share = parse_amount("close_holes", how["close_holes"])
    if size:
        size *= float(np.linalg.norm(np.ptp(low.vertices, axis=0))) / 100 if share else 1
        low, report["closed_holes"] = close_holes(low, size)
    pairs, hard, found = look(low, chunks, how["hard_angle"], reach, job)
    if len(hard) or low is not before:
        corners = fans(low.faces, np.delete(pairs, hard, axis=0))
        low = Mesh(low.vertices, low.faces, normals=_smooth_normals(low, corners), normal_faces=corners)
    return low, {**report, **found}


def mended(steps: Any, level: dict, chunks: str, low: Mesh, simple: Path | None, distance: float, job: dict) -> dict:
    """Mends a mesh of bisque-simplify in a step, which writes it to level["mended"]; of one that was given (simple:
    None), only looks at the scan. distance: of the mesh from the scan. Returns the report."""
    how = {**level["mend"], "given": level.get("content")}
    diagonal = float(np.linalg.norm(np.ptp(low.vertices, axis=0)))
    reach = diagonal * float(np.clip(2 * distance / max(diagonal, 1e-300), 1e-4, 0.02))

    if not 0 < face_normals(low)[1].sum() < np.inf:
        raise Error(65, "the low-poly mesh: its area is 0, or no number")

    def make() -> dict:
        if simple is None:
            report = look(low, chunks, 180, reach, job)[2]
        else:
            mesh, report = _mend(low, how, chunks, reach, job)
            mesh.save(level["mended"])
        for line in _told(report, level["has_normals"]):
            steps.heard.warn(line)
        return report

    inputs, outputs = ([chunks], []) if simple is None else ([chunks, simple], [level["mended"]])
    return steps.run(f"mend {level['name']}", inputs, how, outputs, make)

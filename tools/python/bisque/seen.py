"""What a viewer shows of an asset, beside the scan: pictures from all around, compared with each other.

The scan is seen through the texels of an atlas of squares, which face it from all sides: a bake. The
GLB file is drawn here as glTF 2.0 says: triangles that face the viewer, normals and MikkTSpace tangents that are
interpolated, and images of 8 bits, filtered bilinearly."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Sequence

import numpy as np

from . import core
from .glb import Glb
from .images import srgb, write_png
from .mesh import Error, Mesh

#: Views in the columns and rows of the atlas, and the pixels of a side of each.
COLUMNS, ROWS, SIDE = 5, 4, 104
#: The textures of materials that show maps, and which component (3: alpha; None: all).
TEXTURES = {"normal": ("normalTexture", None), "color": ("baseColorTexture", None), "opacity": ("baseColorTexture", 3),
            "roughness": ("metallicRoughnessTexture", 1), "metallic": ("metallicRoughnessTexture", 2),
            "occlusion": ("occlusionTexture", 0), "emission": ("emissiveTexture", None)}
#: What a material without the texture shows.
ABSENT = {"color": 1.0, "opacity": 1.0, "roughness": 1.0, "metallic": 0.0, "occlusion": 1.0, "emission": 0.0}
#: Most pixels that triangles may cover at a time.
PIXELS = 1 << 21


def _views() -> np.ndarray:
    """Returns axes (views, 3, 3) to the right, upwards and to the viewer, even on the sphere (Fibonacci's)."""
    i = np.arange(COLUMNS * ROWS) + 0.5
    z, around = 1 - 2 * i / len(i), i * np.pi * (1 + 5 ** 0.5)
    r = np.sqrt(1 - z * z)
    toward = np.stack([r * np.cos(around), r * np.sin(around), z], axis=1)
    right = np.stack([-np.sin(around), np.cos(around), 0 * z], axis=1)
    return np.stack([right, np.cross(toward, right), toward], axis=1)


def _atlas(axes: np.ndarray, centre: np.ndarray, half: float, distance: float) -> Mesh:
    """Returns squares, one for each view, at a distance from the centre. They are so small that textures of the
    scan are not averaged; their normals spread over a ball of radius `half`, and the rays go against them."""
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    across = sides @ axes[:, :2]
    corners = 1e-4 * half * across + distance * axes[:, 2:] + centre
    normals = axes[:, 2:] - across * _slope(half, distance)
    cell = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS), indexing="ij"), axis=2).reshape(-1, 1, 2)
    # Views go down the columns; v points upwards.
    uvs = (cell * [1, -1] + [0, ROWS - 1] + (sides + 1) / 2) / [COLUMNS, ROWS]
    faces = (np.arange(len(axes))[:, None] * 4 + [0, 1, 2, 0, 2, 3]).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), faces, uvs.reshape(-1, 2), faces, normals.reshape(-1, 3), faces)


def _slope(half: float, distance: float) -> float:
    """Returns the tangent of half the angle in which a ball is seen."""
    return half / (distance * distance - half * half) ** 0.5


def _project(p: np.ndarray, axes: np.ndarray, half: float, distance: float) -> np.ndarray:
    """Returns points in pixels from the upper left, and the reciprocals of their depths. p: from the centre."""
    p = p @ axes.T
    near = 1 / (distance - p[..., 2:])
    return np.concatenate([(p[..., :2] * near * [1, -1] / _slope(half, distance) + 1) * (SIDE / 2), near], axis=-1)


def _picture(views: np.ndarray) -> np.ndarray:
    """Puts pixels (views, SIDE * SIDE, channels) into the atlas."""
    cells = views.reshape(COLUMNS, ROWS, SIDE, SIDE, -1)
    return cells.transpose(1, 2, 0, 3, 4).reshape(ROWS * SIDE, COLUMNS * SIDE, -1)


def read_glb(path: Path, folder: Path) -> dict:
    """Reads a mesh of a GLB file of Bisque: p, n, t and uv of the corners of each triangle, and by the names of
    maps what shows them: the file of an image, which is written to the folder, a component of it (3: alpha; None:
    all), and a factor."""
    glb = Glb(path)

    def image(reference: dict) -> str:
        found = Path(folder) / f"{glb.image_number(reference)}.png"
        found.write_bytes(glb.image(reference))
        return str(found)

    primitive, = glb.head["meshes"][0]["primitives"]
    attributes, faces = glb.primitive(primitive)
    corners = {key: attributes[name][faces]
               for key, name in (("p", "POSITION"), ("n", "NORMAL"), ("t", "TANGENT"), ("uv", "TEXCOORD_0"))}
    node = glb.head["nodes"][0]
    corners["p"] = corners["p"] * node.get("scale", 1) + node["translation"]
    material = glb.head["materials"][primitive.get("material", 0)]
    material.update(material["pbrMetallicRoughness"])
    strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
    shows = {name: (image(material[texture]), component, strength if name == "emission" else 1)
             for name, (texture, component) in TEXTURES.items() if texture in material}
    if "alphaMode" not in material:
        shows.pop("opacity", None)
    return {**corners, "shows": shows}


def _draw(p: np.ndarray, backs: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws triangles, whose corners _project() gave. Returns the triangle of each pixel, -1 for none, the
    weights of its corners on the triangle, and the pixels where a triangle turns its back to the viewer, if backs hide
    what is behind them (backs); they show none."""
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = e1[:, 1] * e2[:, 0] - e1[:, 0] * e2[:, 1]  # y points downwards
    front = np.flatnonzero(area if backs else area > 0)
    low = np.ceil(p[front, :, :2].min(axis=1) - 0.5).clip(0, SIDE).astype(int)
    size = np.floor(p[front, :, :2].max(axis=1) + 0.5).clip(0, SIDE).astype(int) - low
    counts = size.clip(0).prod(axis=1)
    ends = np.cumsum(counts)
    shown, weights = np.full(SIDE * SIDE, -1), np.zeros((SIDE * SIDE, 3))
    nearest = np.zeros(SIDE * SIDE)
    first = 0
    while first < len(front):
        begin = ends[first] - counts[first]
        last = max(first + 1, int(np.searchsorted(ends, begin + PIXELS, "right")))
        which = np.repeat(np.arange(first, last), counts[first:last])
        k = np.arange(begin, ends[last - 1]) - (ends - counts)[which]
        at = low[which] + np.stack([k % size[which, 0], k // size[which, 0]], axis=1)
        t = front[which]
        d = at + 0.5 - p[t, 0, :2]
        w1 = (d[:, 1] * e2[t, 0] - d[:, 0] * e2[t, 1]) / area[t]
        w2 = (e1[t, 1] * d[:, 0] - e1[t, 0] * d[:, 1]) / area[t]
        w = np.stack([1 - w1 - w2, w1, w2], axis=1)
        w *= p[t, :, 2]
        near, pixel = w.sum(axis=1), at[:, 1] * SIDE + at[:, 0]
        order = np.flatnonzero((w >= 0).all(axis=1) & (near > nearest[pixel]))
        order = order[np.argsort(near[order], kind="stable")]  # of equal pixels, the last one stays
        pixel = pixel[order]
        nearest[pixel], shown[pixel], weights[pixel] = near[order], t[order], w[order] / near[order, None]
        first = last
    hidden = (shown >= 0) & (area[shown] < 0)
    return np.where(hidden, -1, shown), weights, hidden


def _shade(glb: dict, maps: Sequence[str], t: np.ndarray, w: np.ndarray, job: dict) -> dict:
    """Returns what a glTF viewer has at points of triangles: their unit normals, their colours in sRGB, and other
    values of maps."""
    n, tangent, uv = ((glb[key][t] * w[:, :, None]).sum(axis=1) for key in ("n", "t", "uv"))
    uv[:, 1] = 1 - uv[:, 1]
    shows = glb["shows"]
    if "normal" in shows:
        m = 2 * core.sample_image(shows["normal"][0], uv, data=True, **job) - 1
        across = glb["t"][t, 0, 3:] * np.cross(n, tangent[:, :3])
        n = m[:, :1] * tangent[:, :3] + m[:, 1:2] * across + m[:, 2:] * n
    found = {"normal": n / np.linalg.norm(n, axis=1, keepdims=True).clip(1e-30) / 2 + 0.5}
    for name in (name for name in maps if name in ABSENT):
        image, component, factor = shows.get(name, (None, None, 1))
        found[name] = np.full((len(uv), 3 if TEXTURES[name][1] is None else 1), ABSENT[name])
        if image:
            found[name] = factor * core.sample_image(image, uv, data=component is not None, alpha=component == 3, **job)
            found[name] = found[name][:, slice(3) if component is None else [component % 3]]
    if "color" in maps:
        found["color"] = srgb(found["color"])
    return found


def compare_views(path: Path, chunks: str, reach: float, maps: Sequence[str], *, two_sided: bool = False,
                  progress: core.Progress | None = None, **job: Any) -> dict:
    """Compares a GLB file, as a viewer shows it, with its scan, as its triangles are, in views from all
    around, as if nothing were transparent. reach: the most that the scan is away from the mesh; maps: those of the
    asset; two_sided: the scan's faces may look any way, so pixels where the mesh turns its back to the viewer do not
    count. Returns `normal_error` in degrees, `color_error` (CIEDE2000),
    and the errors of channels such as roughness, if there are such maps, over the pixels that show both, the share
    of those among all that show one, `silhouette`, and of pixels that do not count, `backs`. Temporary files are beside
    the GLB file."""
    folder = path.parent / "views"
    folder.mkdir(exist_ok=True)
    try:
        return _compare_views(path, chunks, reach, [name for name in maps if name in ABSENT], two_sided, folder,
                              progress, job)
    except Error as error:
        if error.message.startswith(("no ray hit", "no texel is covered")):
            return {"silhouette": 0.0}  # no pixel shows both, as of a thread
        raise
    finally:
        core._remove(str(folder))


def _compare_views(path: Path, chunks: str, reach: float, maps: list[str], two_sided: bool, folder: Path,
                   progress: core.Progress | None, job: dict) -> dict:
    with core.quiet():  # the bake has warned
        glb = read_glb(path, folder)
        corners = glb["p"].reshape(-1, 3)
        centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
        half = float(np.linalg.norm(corners - centre, axis=1).max())
        distance, axes = max(3 * half, 1.01 * half + reach), _views()
        names = ["normal", "mask", *(["color"] if "color" in maps else [])]
        channels = [name for name in maps if name != "color"]
        scan = core.bake(
            chunks, _atlas(axes, centre, half, distance), names + channels, size=(COLUMNS * SIDE, ROWS * SIDE),
            samples=1, padding=0, front=0, back=2 * distance, normal_space="object", sample_type="float", as_is=True,
            two_sided=two_sided, output=f"{folder}/scan_<MAP>.exr", progress=progress, **job)
        drawn = [_draw(_project(glb["p"] - centre, view, half, distance), two_sided) for view in axes]
        shown, weights, backs = (np.concatenate(part) for part in zip(*drawn))
        seen = np.flatnonzero(shown >= 0)
        values = _shade(glb, maps, shown[seen], weights[seen], job)
        values["mask"] = np.ones((len(seen), 3))
        pictures = {}
        for name, of_map in values.items():
            pixels = np.zeros((len(shown), of_map.shape[1]))
            pixels[seen] = of_map
            pictures[name] = _picture(pixels)
        for name in names:
            write_png(f"{folder}/asset_{name}.png", pictures[name])
        hit = (scan["mask"] > 0) & ~_picture(backs)[:, :, 0]
        write_png(f"{folder}/scan_mask.png", hit)
        found = {name: core.compare(f"{folder}/asset_{name}.png", f"{folder}/scan_{name}.exr", kind=name, force=True,
                                    mask=[f"{folder}/{of}" for of in ("asset_mask.png", "scan_mask.png")], **job)
                 for name in names if name != "mask"}
        keys = ("unit", "compared", "mean", "median", "p95", "p99", "max")
        both = (pictures["mask"][:, :, 0] > 0) & hit
        found.update({name: _difference(pictures[name][both], scan[name][both]) for name in channels})
        return {"silhouette": found["normal"]["agreement"], "backs": float(backs.mean()),
                **{f"{name}_error": {key: of[key] for key in keys} for name, of in found.items()}}


def _difference(a: np.ndarray, b: np.ndarray) -> dict:
    """Returns the differences of values of pixels, each the mean of its components."""
    error = abs(a - b.reshape(a.shape)).mean(axis=1)
    median, p95, p99 = np.percentile(error, (50, 95, 99))
    return {"unit": "difference", "compared": len(error), "mean": error.mean(), "median": median, "p95": p95,
            "p99": p99, "max": error.max()}

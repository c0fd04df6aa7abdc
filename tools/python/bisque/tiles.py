"""From a scan to 3D Tiles 1.1: levels of a low-poly mesh, tiles that planes cut out of them, maps of each tile.

A level is one mesh of the whole scan with a quarter of the triangles of the next finer one, so no border is locked
in any of them. cut.py divides it; the maps of many tiles are baked in one sweep over the scan."""
from __future__ import annotations

import contextvars
import hashlib
import json
import os
import re
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Callable, Iterator

import numpy as np

from . import core, glb, uv
from .asset import PUBLISHED, check_library, lost_of, older_files, publish, sorted_scan, versions
from .core import Error
from .cut import Store, Tile, add_skirt, divide, read_level
from .glb import Glb, Writer, write_plain
from .mesh import TEXELS_MOST, Mesh, check_real, check_triangles, parse_amount, parse_texels
from .place import check_options, place_glb, unit_of
from .steps import WEIGHTS, Folder, Steps
from .tileset import check_place, make_page, tileset

#: A leaf with as many triangles as a tile may have stands for that many triangles of the scan.
SCAN_OF_LEAF = 1_000_000
#: The certificates of tiles and of levels.
PAPERS = ("tiles.json", "levels.json")
#: Tiles whose maps are baked together. Those of 1024 texels fit into half of 1 GiB then: in temporary files, they cost
#: more time than tracing on disks that discard what is freed.
BATCH = 10
#: Columns of rows of vertices.
COLUMNS = (("POSITION", 0, 3), ("NORMAL", 3, 6), ("TANGENT", 6, 10), ("TEXCOORD_0", 10, 12))
#: How GLB files are packed that are not.
PLAIN = {"images": "png", "geometry": "none"}
#: Triangles of a level to those of the next coarser one.
FACTOR = 4
#: Least memory of a tile that is packed, so that small budgets pack fewer at once: sorting needs as much.
PACK_BYTES = 72 << 20


# ---- steps ----

def level_targets(scan_triangles: int, tile_triangles: int, finest: int | str | None,
                  levels: int | None = None) -> list[int]:
    """Returns the triangles of each level, falling, until one tile holds them, or as many as there are levels.
    finest: those of the first one, or a percentage of the scan's, or None."""
    usual = scan_triangles * tile_triangles // SCAN_OF_LEAF if levels is None else (
        tile_triangles * FACTOR ** (levels - 1))
    count = finest or max(tile_triangles, usual)
    if isinstance(count, str):
        count = max(4, round(parse_amount("triangles", count)[0] / 100 * scan_triangles))
    targets = [min(count, max(scan_triangles, 4))]
    while targets[-1] > tile_triangles if levels is None else len(targets) < levels:
        targets.append(-(-targets[-1] // FACTOR))
    if targets[-1] < 4:
        raise ValueError(f"levels: {targets[0]} triangles are too few for {levels} levels")
    return targets


def _widest_skirts(tile: Tile, above: tuple[float, ...] = ()) -> Iterator[tuple[str, float]]:
    """Yields how wide the skirt of each tile may be: its error and that of the tile two levels above. No gap beside
    a tile of these levels is wider."""
    yield tile.name, tile.error + (above[-2:] or (tile.error,))[0]
    for child in tile.children:
        yield from _widest_skirts(child, (*above, tile.error))


def _left(job: dict) -> dict:
    """Returns a job whose budget leaves out what this process has in memory already, beside mapped files."""
    if not job["memory"]:
        return job
    resident, mapped = map(int, Path("/proc/self/statm").read_text("ascii").split()[1:3])
    own = (resident - mapped) * os.sysconf("SC_PAGE_SIZE")
    return {**job, "memory": max(job["memory"] - own, job["memory"] // 4)}


def _each(steps: Steps, stage: str, work: Callable[[int], Any], count: int, threads: int) -> list:
    """Returns the results of `work` for each number below a count, of several threads. All end with the first
    exception."""
    stop, results = threading.Event(), []
    token = core.stopping.set(stop)
    try:
        with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
            try:
                waiting = [pool.submit(contextvars.copy_context().run, work, i) for i in range(count)]
                for done, future in enumerate(waiting, 1):
                    results.append(future.result())
                    steps.report(stage, done, count, "tiles")
            except BaseException:
                stop.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    finally:
        core.stopping.reset(token)
    return results


def _finish_tile(tile: Tile, baked: Glb, number: int, width: float, path: Path, options: dict, memory: Any) -> dict:
    """Writes the GLB file of a tile, primitive `number` of a baked one. Returns what is known of it."""
    root = baked.head
    primitive = root["meshes"][0]["primitives"][number]
    attributes, faces = baked.primitive(primitive)
    if len(faces) < tile.triangles:
        raise Error(70, f"tile {tile.name}: {len(faces)} triangles of {tile.triangles} were baked")
    used, faces = np.unique(faces[:tile.triangles], return_inverse=True)  # strips around charts follow
    faces, part = faces.reshape(-1, 3), tile.part
    rows = np.concatenate([attributes[name][used] for name, _, _ in COLUMNS], axis=1).astype(np.float32)
    rows[faces.ravel(), :6] = part.points[part.faces.ravel(), :6]  # relative to the origin of all tiles
    rows, faces = add_skirt(tile, rows, faces, width)
    material = root["materials"][primitive["material"]]
    images = []
    for slot in filter(None, (material["pbrMetallicRoughness"].get("baseColorTexture"), material.get("normalTexture"))):
        images.append(baked.image(slot))
        slot["index"] = len(images) - 1
    material["name"] = tile.name
    out = Writer({"asset": {"version": "2.0", "generator": f"Bisque {core.version()}"}, "scene": 0,
                  "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "materials": [material]})
    packing, placed = {key: options[key] for key in PLAIN}, options["placed"]
    if placed:
        out.head["nodes"][0]["translation"] = placed["origin"]
    shape = write_plain(out, {name: rows[:, first:end] for name, first, end in COLUMNS}, faces)
    out.head["meshes"] = [{"primitives": [{**shape, "mode": 4, "material": 0}]}]
    if images:
        out.head.update(samplers=root["samplers"][:1],
                        textures=[{"source": i, "sampler": 0} for i in range(len(images))],
                        images=[{"bufferView": out.add(image), "mimeType": "image/png"} for image in images])
    found = {"skirt_triangles": len(faces) - tile.triangles}
    if packing == PLAIN:
        out.write(path)
    else:
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            out.write(Path(folder) / path.name)
            found["packed"] = glb.pack(Path(folder) / path.name, path, Path(folder), threads=1, memory=memory,
                                       **packing)
    points = glb.surface(Glb(path)).vertices
    if placed and (placed["up"], placed["unit"]) != ("y", 1):
        whole = path.with_suffix(".placed")
        place_glb(path, whole, placed["up"], placed["unit"], False)
        os.replace(whole, path)
    return {**found, "low": points.min(axis=0).tolist(), "high": points.max(axis=0).tolist()}


def _digest(tiles: list[Tile]) -> str:
    digest = hashlib.sha256()
    for tile in tiles:
        part = tile.part
        digest.update(f"{tile.name} {part.points.shape} {part.faces.shape}".encode())
        digest.update(part.points.tobytes() + part.faces.tobytes())
    return digest.hexdigest()


def _make_tree(steps: Steps, chunks: str, targets: list[int], options: dict, origin: np.ndarray, job: dict) -> Tile:
    """Makes the levels, and the tree of tiles with their names. Instead of tiles, each level may be one."""
    divided = options["levels"] is None
    limit = options["tile_triangles"] if divided else targets[-1]
    paths = [steps.folder / f"level_{count}.ply" for count in targets]
    options = {"triangles": targets, **{key: options[key] for key in ("min_component", "min_triangles")}}

    def make() -> dict:
        report = core.simplify_levels(chunks, paths, progress=steps.report, **options, **_left(job))
        least = report["levels"][len(targets) - 1]["triangles"]
        if least > limit:
            steps.heard.warn(f"the coarsest tile has {least} triangles instead of {limit}: each edge that is left "
                             "would close a hole or join pieces")
        return report

    steps.run("simplify", [chunks], options, paths, make)
    store = Store(steps.folder)
    root = divide([read_level(path, origin, store) for path in reversed(paths)], limit if divided else targets[0], store)
    counts: dict[int, int] = {}
    for tile in root.all():
        number = counts[tile.level] = counts.get(tile.level, 0) + 1
        tile.name = f"{tile.level}_{number}" if divided else f"level_{tile.level}"
    return root


def _write_level(path: Path, tiles: list[Tile], origin: np.ndarray) -> None:
    """Writes the triangles of all tiles as one PLY file."""
    points, faces = (sum(tile.place[k] for tile in tiles) for k in (1, 2))
    with open(path, "wb") as file:
        file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\nproperty double x\n"
                   f"property double y\nproperty double z\nelement face {faces}\n"
                   "property list uchar uint vertex_indices\nend_header\n".encode())
        for tile in tiles:
            file.write(tile.part.points[:, :3] + origin)
        start = 0
        for tile in tiles:
            part = tile.part
            rows = np.empty(len(part.faces), [("count", "u1"), ("v", "<u4", 3)])
            rows["count"], rows["v"] = 3, part.faces + start
            file.write(rows)
            start += len(part.points)


def _measure(steps: Steps, chunks: str, tiles: list[Tile], origin: np.ndarray, parts: int, job: dict) -> dict:
    """Sets the errors of all tiles of a level. Returns the distances of the level."""
    boxes = [np.concatenate([tile.low + origin, tile.high + origin]).tolist() for tile in tiles]
    path = steps.folder / "measured.ply"

    def make() -> dict:
        _write_level(path, tiles, origin)
        found = core.measure(path, chunks, boxes=boxes, progress=steps.report, **_left(job))
        path.unlink()
        return found

    found = steps.run(f"check {tiles[0].level}", [chunks], {"content": _digest(tiles), "boxes": boxes}, [], make, parts)
    for tile, distances in zip(tiles, found["boxes"]):
        tile.distances = distances
        tile.error = max(of["max"] for of in distances.values())
    return {key: found[key] for key in ("from_scan", "from_mesh")}


def _raise_errors(tile: Tile, least: float) -> float:
    """Makes the error of each tile larger than those of its children, as viewers want it. Returns the tile's."""
    below = [_raise_errors(child, least) for child in tile.children]
    if below:
        tile.error = max(tile.error, max(below) * (1 + 1e-6) + least)
    return tile.error


def _write_batch(path: Path, meshes: list[Mesh], names: list[str], origin: np.ndarray) -> None:
    """Writes meshes as one OBJ file, each with a material of its name."""
    starts = np.zeros(3, np.int64)
    with open(path.with_suffix(".new"), "w", encoding="ascii") as file:
        for mesh, name in zip(meshes, names):
            arrays = mesh.vertices + origin, mesh.uvs, mesh.normals
            file.write(f"usemtl {name}\n")
            for key, rows in zip(("v", "vt", "vn"), arrays):
                line = key + " %.17g" * rows.shape[1] + "\n"
                file.write(line * len(rows) % tuple(rows.ravel().tolist()))
            corners = np.stack([mesh.faces, mesh.uv_faces, mesh.normal_faces], axis=2) + starts + 1
            file.write("f %d/%d/%d %d/%d/%d %d/%d/%d\n" * len(corners) % tuple(corners.ravel().tolist()))
            starts += [len(rows) for rows in arrays]
    os.replace(path.with_suffix(".new"), path)


def _unwrap(steps: Steps, name: str, tiles: list[Tile], obj: Path, options: dict, seconds: float, origin: np.ndarray,
            parts: int, job: dict) -> list[dict]:
    """Unwraps tiles and writes them as one OBJ file. Returns what was found of their UVs."""
    chosen = {**options, "version": versions(options["library"])}

    def unwrap_one(number: int) -> Mesh:
        tile = tiles[number]
        points, faces = tile.part.points, tile.part.faces
        try:
            return uv.unwrap(Mesh(points[:, :3], faces, normals=points[:, 3:6], normal_faces=faces), seconds=seconds,
                             **options)
        except Error as error:
            raise Error(error.status, f"tile {tile.name}: {error.message}") from None

    def make() -> list[dict]:
        meshes = _each(steps, "unwrapping", unwrap_one, len(tiles), job["threads"])
        extended = [uv.extend_charts(mesh, options["size"]) for mesh in meshes]
        _write_batch(obj, extended, [tile.name for tile in tiles], origin)
        return [mesh.report["uv"] for mesh in meshes]

    return steps.run(f"unwrap {name}", [], {**chosen, "content": _digest(tiles)}, [obj], make, parts)


def _bake(steps: Steps, name: str, chunks: str, tiles: list[Tile], obj: Path, widths: dict[str, float], options: dict,
          parts: int, job: dict) -> list[dict]:
    """Bakes tiles in one sweep over the scan, and writes their GLB files. Returns what is known of them."""
    files = [obj.with_name(f"{tile.name}.glb") for tile in tiles]
    whole = obj.with_suffix(".glb")

    def make() -> list[dict]:
        core.bake(chunks, obj, options["maps"], size=options["size"], samples=options["samples"], glb=whole, format="",
                  arrays=False, as_is=True, output_path=str(obj.with_name("<MATERIAL>_<MAP>.png")),
                  progress=steps.report, **_left(job))
        baked, left, threads = Glb(whole), _left(job)["memory"], job["threads"] or os.cpu_count()
        if left:
            threads = max(1, min(threads, left // PACK_BYTES))
        found = _each(steps, "packing", lambda i: _finish_tile(tiles[i], baked, i, widths[tiles[i].name], files[i],
                                                               options, left and left // threads), len(tiles), threads)
        whole.unlink()
        return found

    chosen = {**options, "widths": [widths[tile.name] for tile in tiles]}
    return steps.run(f"bake {name}", [chunks, obj], chosen, files, make, parts)


def _finite(corners: list[np.ndarray]) -> list[list]:
    """Returns corners as JSON has them: None is no limit."""
    return [[float(x) if np.isfinite(x) else None for x in corner] for corner in corners]


def _make_tiles(steps: Steps, chunks: str, tiles: list[Tile], widths: dict[str, float], level: dict,
                origin: np.ndarray, parts: int, job: dict) -> dict[str, dict]:
    """Makes the GLB files of a batch of tiles. Returns what is known of each, by its name."""
    name = f"{tiles[0].name}-{tiles[-1].name}"
    obj = steps.folder / f"batch_{name}.obj"
    size = level["size"] << tiles[0].level if level["placed"] else level["size"]
    unwrapping = {"size": size, "padding": max(2, size // 512), "library": level["library"]}
    unwrapped = _unwrap(steps, name, tiles, obj, unwrapping, level["seconds"], origin, parts, job)
    baking = {**{key: level[key] for key in ("maps", "samples", "placed", *PLAIN)}, "size": size}
    if level["geometry"] == "draco":
        baking["version"] = metadata.version("DracoPy")
    baked = _bake(steps, name, chunks, tiles, obj, widths, baking, parts, job)
    return {tile.name: {"file": f"{tile.name}.glb", "level": tile.level, "triangles": tile.triangles,
                        **tile.distances, "region": _finite([tile.low + origin, tile.high + origin]),
                        **about, "uv": uvs}
            for tile, about, uvs in zip(tiles, baked, unwrapped)}


# ---- all of it ----

def _check_folder(output: Path, paper: str) -> None:
    """Refuses a folder that has files of others than those of its certificate. Nobody else may publish there meanwhile.
    Raises Error."""
    found = {name for name, _ in older_files(output, output / "x", output / Folder.NAME / PUBLISHED, paper)}
    own = {Folder.NAME} | ({paper, *found} if found else set())
    for name in sorted(os.listdir(output)):
        if name not in own:
            raise Error(73, f"{output}: this folder has {name}, which is of no {paper[:-5]} of bisque-asset: choose a "
                        "new one")


def tiles(scan: Any, output: str | os.PathLike, *, tile_triangles: int = 10_000, triangles: int | str | None = None,
          size: int | str = 1024, maps: Any = ("normal", "color"), samples: int = 2, library: str = uv.USUAL,
          unwrap_seconds: float = 300, min_component: float | str = 0, min_triangles: int = 0, texture: Any = None,
          up: str | None = None, units: str | None = None, scale: float | None = None, place: Any = None,
          images: str = "jpeg", geometry: str = "none", levels: int | None = None, part: str | None = None,
          memory: int | str | None = None, threads: int = 0, progress: core.Progress | None = None) -> dict:
    """Makes 3D Tiles 1.1 of a scan in a folder: tileset.json, a GLB file for each tile, and the certificate,
    tiles.json. The folder must not hold other files.

    tile_triangles: most triangles of a tile, at least 100. triangles: of the finest level, or "10%" of the scan's;
    without it, a tile of it stands for about a million of the scan's. size: texels of a side of each tile's maps. up,
    units, scale: as of asset(). place: longitude and latitude in degrees and height in metres, where zero of the scan's
    coordinates lies; without it, that is zero of the tileset's. images, geometry: of the GLB files, as of pack().
    levels: makes that many levels instead, each one GLB file with all of the scan: level_0.glb with tile_triangles and
    maps of `size`, and each finer one with four times the triangles and texels; the certificate is levels.json.
    part: of a job on several machines: "plan" makes all that comes before tiles, then "1/16" to "16/16" make tiles, and
    a call without it makes what is left and the rest.
    Interrupted jobs go on. Returns the certificate, or of a part what it made. Raises Error, ValueError."""
    output, size = Path(output), parse_texels(size)
    for name, value, least, most in (("tile_triangles", tile_triangles, 100, 2 ** 31), ("samples", samples, 1, 2 ** 16),
                                     ("min_triangles", min_triangles, 0, 2 ** 63),
                                     ("levels", 1 if levels is None else levels, 1, 24)):
        core.check_number(name, value, least, most)
    triangles = None if triangles is None else check_triangles(triangles, 4)
    min_component = parse_amount("min_component", str(min_component).removesuffix("%"))[0]
    check_library(library)
    check_options(up, units, scale)
    packing = {"images": images, "geometry": geometry}
    glb.check_options(**packing)
    check_real("unwrap_seconds", unwrap_seconds, 0, 1e9)
    maps = list(dict.fromkeys(core.own_names(maps)))
    if not set(maps) <= {"normal", "color"} or not maps:
        raise ValueError(f"maps: tiles have normal and color, not {','.join(maps)}")
    place, share = check_place(place), _parse_part(part)
    if place and levels:
        raise ValueError("place: levels have none")
    if levels and size << levels - 1 > TEXELS_MOST:
        raise ValueError(f"size: the finest of {levels} levels would have maps of {size << levels - 1} texels a side, "
                         f"more than {TEXELS_MOST}")
    paths = [] if core._is_memory(scan) else core._paths(scan)
    for path in [*paths, *([os.fsdecode(texture)] if texture else [])]:
        if output.resolve() in Path(path).resolve().parents:
            raise ValueError(f"{path}: the files in {output} are replaced; move it elsewhere")
    core.refuse_tokens(output)
    if output.exists() and not output.is_dir():
        raise Error(73, f"{output}: this is no folder")
    if share and not (output / Folder.NAME / "steps.json").exists():
        raise Error(66, f"{output}: there is no plan: --part plan makes it")
    job = {"memory": core.parse_bytes(memory), "threads": core.check_number("threads", threads, 0, 65536)}
    level = {"size": size, "maps": maps, "samples": samples, "library": library, "seconds": unwrap_seconds, **packing}
    options = {"tile_triangles": tile_triangles, "triangles": triangles, "size": size, "maps": maps,
               "samples": samples, "library": library, "min_component": min_component, "min_triangles": min_triangles,
               "up": up, "units": units, "scale": scale, "place": place, "levels": levels, **packing}
    private, done = Folder(output, share is not None), False
    try:
        paper = PAPERS[levels is not None]
        _check_folder(output, paper)
        steps = Steps(private, progress, 1, share is not None)
        steps.total -= WEIGHTS["voxelize"]
        chunks, about = sorted_scan(steps, scan, paths, texture, job)
        certificate = _run(steps, chunks, about, options, level, part, share, job)
        if part:
            return certificate
        certificate["scan"] = [{"path": path, "bytes": os.path.getsize(path), "sha256": steps.hold(path)}
                               for path in paths] or "arrays in memory"
        publish(certificate, output, output / "x", private.path / PUBLISHED, steps, True, paper)
        done = True
        return certificate
    finally:
        needed = not done and any((private.path / name).exists() for name in ("steps.json", PUBLISHED))
        private.close(not needed)


def _parse_part(part: str | None) -> tuple[int, int] | None:
    """Returns the number of a part, from 1 on, and how many there are; None without, and of the plan. Raises
    ValueError."""
    match = re.fullmatch(r"([1-9]\d{0,5})/([1-9]\d{0,5})", part or "")
    if part in (None, "plan"):
        return None
    if not match or int(match[1]) > int(match[2]):
        raise ValueError(f"part: plan, or a number such as 3/16 is needed, not {part!r}")
    return int(match[1]), int(match[2])


@dataclass
class _Plan:
    """What is known before maps are made."""
    root: Tile
    meshes: list[dict]  # of each level, what the certificate says
    batches: list[list[Tile]]
    least: float  # by which errors of parents are larger

    def set_errors(self, known: dict[str, dict]) -> None:
        """Adds to errors what packing moved, and sets them."""
        for tile in self.root.all():
            tile.error += known[tile.name].get("packed", {}).get("geometry", {}).get("distance", 0)
        _raise_errors(self.root, self.least)
        for tile in self.root.all():
            known[tile.name]["geometric_error"] = tile.error


def _plan(steps: Steps, chunks: str, about: dict, options: dict, origin: np.ndarray, job: dict) -> _Plan:
    """Makes the levels and divides them into tiles, and measures them."""
    targets = level_targets(about["triangles"], options["tile_triangles"], options["triangles"], options["levels"])
    root = _make_tree(steps, chunks, targets, options, origin, job)
    levels = [[tile for tile in root.all() if tile.level == i] for i in range(len(targets))]
    measured = [_measure(steps, chunks, some, origin, len(levels), job) if some else {} for some in levels]
    least = 1e-9 * float(np.linalg.norm(np.subtract(about["box"]["max"], about["box"]["min"])))
    _raise_errors(root, least)
    return _Plan(root, [{"target": target, "triangles": sum(tile.triangles for tile in some), "tiles": len(some),
                         **distances} for target, some, distances in zip(reversed(targets), levels, measured)],
                 [some[i:i + BATCH] for some in levels for i in range(0, len(some), BATCH)], least)


def _run(steps: Steps, chunks: str, about: dict, options: dict, level: dict, part: str | None,
         share: tuple[int, int] | None, job: dict) -> dict:
    """Makes all files in the private folder, or those of a part. Returns the certificate, in which "files" are paths,
    or what the part made."""
    low, high = np.array(about["box"]["min"]), np.array(about["box"]["max"])
    # Far from zero, single precision would lose detail.
    origin = np.round((low + high) / 2) if np.abs([low, high]).max() > 64 * (high - low).max() else np.zeros(3)
    if not about["color"]:
        level = {**level, "maps": [name for name in level["maps"] if name != "color"]}
        if not level["maps"]:
            raise Error(65, "the scan has no colour, and no other map is asked for")
    level["placed"] = None if options["levels"] is None else {
        "up": options["up"] or "y", "unit": unit_of(options["units"], options["scale"]), "origin": origin.tolist()}
    plan = _plan(steps, chunks, about, options, origin, job)
    if part == "plan":
        return {"part": part, "tiles": sum(map(len, plan.batches)), "batches": len(plan.batches)}
    number, count = share or (1, 1)
    batches, widths, known = plan.batches[number - 1::count], dict(_widest_skirts(plan.root)), {}
    steps.fixed = False
    for batch in batches:
        with steps.apart(f"batch_{batch[0].name}"):
            known.update(_make_tiles(steps, chunks, batch, widths, level, origin, len(batches), job))
    if part:
        return {"part": part, "tiles": len(known), "batches": len(batches)}
    plan.set_errors(known)
    files = {tile["file"]: steps.folder / tile["file"] for tile in known.values()}
    if options["levels"] is None:
        files["tileset.json"] = steps.folder / "tileset.json"
        files["tileset.json"].write_text(json.dumps(tileset(plan.root, known, origin, options), indent=1) + "\n")
        if options["geometry"] == "none" and make_page(steps.folder / "index.html"):  # its loader unpacks nothing
            files["index.html"] = steps.folder / "index.html"
    made = steps.folder.parent
    told = [line for lines in steps.warnings.values() for line in lines]
    return {"generator": f"Bisque {core.version()}", "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "scan_triangles": about["triangles"], "lost": lost_of(about), "warnings": list(dict.fromkeys(told)),
            "options": options, "versions": versions(options["library"]), "meshes": plan.meshes, "tiles": known,
            "seconds": steps.seconds,
            "levels": [{"name": "tiles", "files": {made / name: path for name, path in files.items()}}]}

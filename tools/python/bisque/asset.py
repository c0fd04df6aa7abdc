"""From a scan to an asset: sort, simplify, unwrap, voxelize, bake, measure.

Each step writes files into a private folder (steps.py). The asset's own files get their names when
all is done, the certificate last, so that it stands beside the files that it is of, or not at all."""
from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import os
import re
import shutil
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any, Iterable

import numpy as np

from . import core, glb, materials, museum, place, programs, repair, seen, usdz, uv
from .core import Error
from .mesh import Mesh, as_mesh, check_real, is_path, parse_texels, read_mesh
from .steps import FAILED_IO, Folder, Steps, sha256

#: Triangles, texels and maps of each level; rays of a texel for ambient occlusion, of which
#: the filter saves half; images of the GLB file.
PRESETS: dict[str, dict] = {
    "web": {"levels": [(20_000, 2048)], "maps": ("normal", "color", "ao"), "rays": 32, "images": "jpeg"},
    "game": {"levels": [(10_000, 2048)], "maps": ("normal", "color", "ao", "curvature"),
             "rays": 32, "images": "jpeg"},
    "museum": {"levels": [(20_000, 512), (150_000, 4096), (100_000, 2048)],
               "maps": ("normal", "color", "ao"), "rays": 64, "images": "jpeg"},
    "archive": {"levels": [(150_000, 8192)], "maps": ("normal", "color", "ao", "mask"),
                "rays": 64, "images": "png"},
}

#: UVs of this size, whose padding grows with the map, are those of all larger maps.
MOST_UNWRAPPED = 2048
#: A grid with more voxels along a side takes more time than exact rays do.
MOST_RESOLUTION = 8192


def _digest(mesh: Mesh) -> str:
    """Returns a checksum of all arrays of a mesh, and of its texture."""
    digest = hashlib.sha256()
    for name in ("vertices", "faces", "uvs", "uv_faces", "normals", "normal_faces", "colors"):
        array = getattr(mesh, name)
        if array is not None:
            digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    if mesh.texture is not None:
        digest.update(f"{mesh.texture.mode} {mesh.texture.size} {mesh.texture.getpalette()}".encode())
        digest.update(mesh.texture.tobytes())
    return digest.hexdigest()


# ---- decisions ----

def choose_surface(low: Mesh, scan_triangles: int, size: int, maps: Any) -> dict:
    """Chooses between a grid and exact rays by the size of a texel on the surface. A voxel is half
    as large as a texel. If the scan's triangles are not smaller than such voxels, or the grid
    would be larger than MOST_RESOLUTION, rays through triangles are exact, and not slower; but many
    rays from each hit (ao) take several times as long as in a grid."""
    area = float(repair.face_normals(low)[1].sum())
    texel = (area / (low.report["uv"]["uv_share"] * size * size)) ** 0.5
    side = float((low.vertices.max(axis=0) - low.vertices.min(axis=0)).max())
    edge = (2 * area / max(scan_triangles, 1)) ** 0.5
    if not 0 < texel < float("inf") or not side / texel < 2 ** 31:
        raise Error(65, f"the low-poly mesh has no size that maps can be made for: {side:g}")
    resolution = int(np.ceil(2 * side / texel / 64) * 64)
    many_rays = bool({"ao", "bent", "thickness"} & set(maps))
    exact = resolution > MOST_RESOLUTION or (edge >= texel / 2 and not many_rays)
    return {"texel": texel, "scan_edge": edge, "resolution": resolution, "exact": exact}


def write_mtl(path: Path, files: dict) -> None:
    """Writes the material of an OBJ file with its maps."""
    lines = ["newmtl baked", "Kd 1 1 1" if "color" in files else "Kd 0.6 0.6 0.6", "Ks 0 0 0", "illum 1"]
    lines += ["Ke 1 1 1"] * ("emission" in files)
    for name, statement in {"color": "map_Kd", "normal": "norm", "ao": "map_Ka", **materials.CHANNELS}.items():
        if name in files:
            lines.append(f"{statement} {os.path.basename(files[name])}")
    path.write_text("\n".join(lines) + "\n")


# ---- the levels ----

def _simplify(steps: Steps, scan: str, levels: list[dict], job: dict) -> list[dict]:
    """Makes the meshes of all levels, each of the next larger one. Returns the report of each."""
    falling = sorted(levels, key=lambda level: level["triangles"], reverse=True)
    paths, wanted = [level["simple"] for level in falling], [level["triangles"] for level in falling]
    options = {"triangles": wanted, **levels[0]["simplify"]}

    def make() -> list[dict]:
        rest = {**levels[0]["simplify"], "progress": steps.report, **job}
        if len(levels) == 1:
            return [core.simplify(scan, *paths, triangles=wanted[0], **rest).report]
        report = core.simplify_levels(scan, paths, wanted, measured=True, **rest)
        return [{**report, **found} for found in report.pop("levels")[:len(levels)]]

    reports = steps.run("simplify", [scan], options, paths, make)
    return [reports[falling.index(level)] for level in levels]


def _low_of(steps: Steps, scan: str, given: Any, level: dict, report: dict, job: dict) -> Mesh:
    """Returns the low-poly mesh of a level with UVs, and writes it as an OBJ file. report: of _simplify()."""
    simple, unwrapped = level["simple"], level["obj"]
    size = min(level["size"], MOST_UNWRAPPED)
    suffix = f" {level['name']}"
    options = {"size": size, "padding": max(2, size // 512), "library": level["library"]}
    if given is None:
        distance = report["from_mesh"]["max"]
        mended = repair.mended(steps, level, scan, read_mesh(str(simple)), simple, distance, job)
        inputs, low = [level["mended"]], read_mesh(str(level["mended"]))
    else:
        inputs = [given] if is_path(given) else []
        for path in inputs:
            steps.hold(path)
        low = as_mesh(given)
        options["content"] = _digest(low)
        mended = repair.mended(steps, {**level, "content": options["content"]}, scan, low, None, np.inf, job)

    def make() -> dict:
        if low.uvs is not None:
            result, low.report["uv"] = low, uv.check_uvs(low, size)
        else:
            result = uv.unwrap(low, seconds=level["seconds"], progress=steps.report, **options_of_uv)
        result.save(unwrapped, unwrapped.with_suffix(".mtl").name)
        return result.report["uv"]

    options_of_uv = {key: options[key] for key in ("size", "padding", "library")}
    options["version"] = metadata.version(level["library"])
    found = steps.run("unwrap" + suffix, inputs, options, [unwrapped], make)
    mesh = read_mesh(str(unwrapped))
    if mended.get("closed_holes"):  # it was measured without these faces
        report = {key: value for key, value in report.items() if key not in ("from_scan", "from_mesh")}
    mesh.report = {**report, "uv": found, "mended": mended}
    return mesh


def _bake(steps: Steps, scan: str, obj: Path, files: dict, options: dict, job: dict) -> dict:
    """Bakes by the program of this package, which also writes the page. files: by the names of their
    options. Returns the program's report."""
    known = core.map_names()
    maps = ",".join(name if name in known else f"transfer:{name}" for name in options["maps"])
    words = ["-o", obj.with_name("<MAP>.png"), "--maps", maps, "--size", options["size"],
             "--samples", options["samples"]]
    filtered = "ao" in options["maps"] and "bent" not in options["maps"]  # which has no filter
    if {"ao", "bent"} & set(options["maps"]):
        words += ["--rays", f"ao={options['ao_rays'] // 2},filter=surface" if filtered else f"ao={options['ao_rays']}"]
    words += [*options["material"], *(word for name, path in files.items() for word in (f"--{name}", path))]
    words += ["--memory", core.parse_bytes(job["memory"])] if job["memory"] else []
    words += ["--threads", job["threads"]] if job["threads"] else []
    words += ["--two-sided"] if options["two_sided"] else []
    words += ["--view", f"up={options['up']}"] if options["up"] else []
    report = programs.run("bisque-bake", [*words, "--", scan, obj], steps.report, steps.heard.warn, [steps.lock])
    for file in report["files_read"]:
        steps.heard.read(programs.path_of(file["path"]), file["identity"])
    return report


def _finish_page(raw: Path, page: Path, level: dict, lines: list[str]) -> None:
    """Makes a page show the asset's command, files and warnings, not only those of its bake."""
    head, data, tail = re.split(r'(?<= id="data">)(.*)(?=</script>)', raw.read_text("utf-8"), maxsplit=1)
    made, staged = (json.dumps(f"{folder}{os.sep}")[1:-1] for folder in (level["made"], level["obj"].parent))
    shown = json.loads(data.replace(staged, made))
    shown["glb_path"] = str(level["outputs"][0][1])
    shown["warnings"] = list(dict.fromkeys(lines))
    shown["command"] = level["command"] or shown["command"]
    page.write_text(head + json.dumps(shown).replace("<", "\\u003c") + tail, "utf-8")


def _bake_level(steps: Steps, chunks: str, sorted_report: dict, low: Mesh, level: dict,
                job: dict) -> dict:
    """Bakes a level: maps, GLB and preview beside its OBJ file. Returns its part of the certificate,
    in which "files" are paths."""
    suffix, size, obj = f" {level['name']}", level["size"], level["obj"]
    maps = level["maps"]
    surface = choose_surface(low, sorted_report["triangles"], size, maps)
    if level["surface"] != "auto":
        surface["exact"] = level["surface"] == "exact"
    scan, grid = chunks, steps.folder / f"grid_{level['name']}.nvdb"
    if not surface["exact"]:
        scan = str(grid)
        channels = [name for name in maps if name in sorted_report["channels"]]
        options = {"resolution": min(surface["resolution"], MOST_RESOLUTION), "channels": ",".join(channels) or None}
        steps.run("voxelize" + suffix, [chunks], options, [grid], lambda: core.voxelize(
            chunks, grid, progress=steps.report, **options, **job))
    files = {"glb": obj.with_suffix(".glb"), "preview": obj.with_name("preview.png")}
    if level["report"]:
        files["report"] = obj.with_name("raw.html")
    images = {name: obj.with_name(f"{name}.png") for name in maps}
    mtl = obj.with_suffix(".mtl")
    options = {"maps": maps, "size": size, "samples": level["samples"], "ao_rays": level["rays"],
               "material": materials.options_of(maps, sorted_report),
               "two_sided": low.report["mended"]["two_sided"], "up": place.view_up(level["place"])}

    def make() -> dict:
        mtl.unlink(missing_ok=True)
        baked = _bake(steps, scan, obj, files, options, job)
        write_mtl(mtl, images)
        return baked

    report = steps.run("bake" + suffix, [scan, obj], options, [mtl, *files.values(), *images.values()], make)
    if "from_scan" not in low.report:
        bare = Mesh(low.vertices, low.faces)
        low.report.update(steps.run("check distance" + suffix, [chunks, obj], {}, [],
                                    lambda: core.measure(bare, chunks, **job)))
    reach = low.report["from_scan"]["max"]
    shown, packing = glb.packed(steps, level, files["glb"], job)
    first = next(iter(shown.values()))
    looking = {"reach": reach, "maps": maps, "two_sided": options["two_sided"]}
    errors = steps.run("check" + suffix, [chunks, first], looking, [],
                       lambda: seen.compare_views(first, chunks, **looking, progress=steps.report, **job))
    made = {}
    for path, file in shown.items():
        made[path], placement = place.placed(steps, level, file, low, report.get("preview_up"))
        if path.suffix.lower() == usdz.SUFFIX:
            made[path] = usdz.made(steps, level, made[path])
    made.update({level["made"] / path.name: path for path in (obj, mtl, files["preview"], *images.values())})
    if level["report"]:
        made[level["made"] / "report.html"] = obj.with_name("report.html")
        _finish_page(files["report"], obj.with_name("report.html"), level,
                     steps.warnings_of(None) + steps.warnings_of(level["name"]))
    return {"name": level["name"], "triangles": len(low.faces), "size": size,
            "surface": {**surface, "method": "exact" if surface["exact"] else "grid"},
            "distance": {key: low.report[key] for key in ("from_scan", "from_mesh")},
            "uv": low.report["uv"], "materials": materials.certify(maps, sorted_report),
            "mesh": low.report["mended"], "placement": placement,
            "removed": {key: low.report.get(member, 0) for key, member in REMOVED.items()}, **errors,
            "rays": {key: report[key] for key in ("samples", "hits", "misses", "front", "back")},
            "packed": packing, "memory_high": report["cost"]["memory_high_bytes"],
            "warnings": steps.warnings_of(level["name"]), "files": made}


#: Members of a report on a sorted scan that count what it lost.
LOSSES = ("degenerate_triangles", "short_faces", "broken_faces", "lost_corners", "skipped_lines")


#: What simplify() counts of what it left out, by the names in the certificate.
REMOVED = {"pieces": "dropped_pieces", "triangles": "dropped_triangles", "handles": "cut_handles"}


def lost_of(report: dict) -> dict:
    """Returns what of the scan the asset does not have."""
    return {key: report[key] for key in LOSSES if report[key]}


def asset(scan: Any, output: str | os.PathLike, *, low: Any = None, preset: str = "web",
          triangles: int | str | None = None, error: float | str | None = None, size: int | str | None = None,
          maps: Any = None, samples: int = 2, surface: str = "auto", library: str = uv.USUAL,
          unwrap_seconds: float = 300, min_component: float | str = 0, min_triangles: int = 0,
          close_holes: float | str = 0, hard_angle: float = 40, winding: str = "auto", up: str | None = None,
          units: str | None = None, scale: float | None = None, texture: Any = None, images: str | None = None,
          geometry: str = "none", report: bool = False, keep: str | os.PathLike | None = None,
          memory: int | str | None = None, threads: int = 0, progress: core.Progress | None = None,
          command: list[str] | None = None) -> dict:
    """Makes an asset of a scan: OUTPUT.glb or OUTPUT.usdz, and beside it a folder OUTPUT_asset with the mesh and its
    material (low.obj, low.mtl), the maps, a picture (preview.png) and the certificate, asset.json.
    Of several levels (preset "museum", which needs units), each has GLB files of its own and a folder with its
    number, and `scene.svx.json` shows all in Voyager.

    triangles: a number, or "10%" of the scan's; error: instead, the smallest mesh that is nowhere farther from
    the scan, nor the scan from it: a length ("0.2mm", or in the scan's units) or "0.1%" of its diagonal.
    min_component, min_triangles: as of simplify(). close_holes: the size of the largest hole to close, as error.
    hard_angle: edges with a larger angle are hard if the scan has them; 180: none is. winding: "auto" turns what
    is inside out, "keep" does not. up, units, scale: the axis that points upwards in the scan, "-z" also, its unit
    (mm, cm, m or in), and a factor; the GLB file has y upwards and metres.
    low: a low-poly mesh to use instead, which only is unwrapped if it has no UVs. texture: an image for all faces
    with texture coordinates, instead of those that the scan names. surface: "grid", "exact", or
    "auto", by the size of a texel. images, geometry: of the GLB file, as of pack(); images are those of the
    preset. report: also makes a page to look at, report.html. command: the
    command that the page shows; without it, that of the bake. keep: a folder, in whose folder
    `bisque-steps` the files between stay; without it they are in OUTPUT_asset/bisque-steps until the
    asset is complete. Interrupted jobs go on from them.
    Returns the certificate. Raises Error, UnwrapError, ValueError."""
    output = Path(output)
    size = size if size is None else parse_texels(size)
    placing = {"up": up, "units": units, "scale": scale}
    place.check_options(**placing)
    given_low = {"min_component": min_component, "min_triangles": min_triangles, "close_holes": close_holes,
                 "hard_angle": hard_angle, "winding": winding}
    if low is not None:
        for name, value in {"triangles": triangles, "error": error, **given_low}.items():
            if value != asset.__kwdefaults__[name]:
                raise ValueError(f"{name}: not with low, which stays as it is")
    mending = repair.check_options(triangles, error, place.unit_of(units, scale), **given_low)
    chosen = _check_options(output, preset, samples, surface, library, unwrap_seconds)
    packing = {"images": images or PRESETS[preset]["images"], "geometry": geometry}
    glb.check_options(**packing)
    if low is not None or triangles or error is not None or size:
        chosen = [(mending["triangles"] or (None if mending["error"] else chosen[-1][0]), size or chosen[-1][1])]
    made = output.with_name(output.stem + "_asset")
    paths = [] if core._is_memory(scan) else core._paths(scan)
    low = os.fsdecode(low) if is_path(low) else low
    given = [*paths, *([low] if is_path(low) else []), *([os.fsdecode(texture)] if texture else [])]
    names = core.own_names(maps or ())
    core.check_maps(names)
    maps = list(dict.fromkeys(name.removeprefix("transfer:") for name in names))
    _check_inputs(output, made, Path(keep) if keep else made, given)
    if len(chosen) > 1:
        museum.check(output, made, bool(units or scale or not place.name_of(paths)))
    job = {"memory": core.parse_bytes(memory), "threads": core.check_number("threads", threads, 0, 65536)}
    level = {"samples": samples, "rays": PRESETS[preset]["rays"], "surface": surface, "library": library,
             "seconds": unwrap_seconds, "mend": mending["mend"], "simplify": mending["simplify"], **packing,
             "place": {**placing, "name": place.name_of(paths)}, "report": report, "command": command}
    elsewhere = bool(keep) and Path(keep).resolve() != made.resolve()
    private = kept = Folder(made)
    done = False
    try:
        if elsewhere:
            kept = Folder(Path(keep))
        _refuse_early(made, output, private.path / PUBLISHED, chosen)
        steps = Steps(kept, progress, len(chosen))
        if len(chosen) > 1 and not usdz.installed():
            steps.tell("usdz", ["usd-core is not installed, so there is no USDZ file: pip install usd-core"])
        chunks, about = sorted_scan(steps, scan, paths, texture, job)
        level["maps"] = materials.choose_maps(maps, PRESETS[preset]["maps"], about)
        level["has_normals"] = about["normals"]
        wanted = _levels(chosen, level, output, made, steps)
        reports = [{}] if low is not None else _simplify(steps, chunks, wanted, job)
        levels = [_bake_level(steps, chunks, about, _low_of(steps, chunks, low, one, report, job), one, job)
                  for one, report in zip(wanted, reports)]
        if len(chosen) > 1:
            museum.add_scene(steps.folder / museum.SCENE, output, chosen, levels)
        options = {"preset": preset, "levels": chosen, "samples": samples, "surface": surface,
                   "library": library, **placing, **packing, **given_low, "error": error, "memory": memory,
                   "threads": threads}
        certificate = _certificate(steps, paths, about, options, levels)
        publish(certificate, made, output, private.path / PUBLISHED, steps, not keep)
        done = True
        return certificate
    finally:
        if kept is not private:
            kept.close(False)
        needed = not done and any((private.path / name).exists() for name in ("steps.json", PUBLISHED))
        private.close((elsewhere or not keep) and not needed)


def _levels(chosen: list[tuple[int, int]], common: dict, output: Path, made: Path, steps: Steps) -> list[dict]:
    """Returns what makes each level: the common values, its numbers and its paths."""
    levels, several = [], len(chosen) > 1
    for number, (count, side) in enumerate(chosen):
        staged = steps.folder / str(number)
        staged.mkdir(exist_ok=True)
        levels.append({
            **common, "name": str(number), "triangles": count, "size": side, "obj": staged / "low.obj",
            "simple": steps.folder / f"low_{number}.ply", "mended": steps.folder / f"mended_{number}.obj",
            "outputs": museum.outputs(output, number, count, side) if several else [(side, output)],
            "made": made / str(number) if several else made})
    return levels


def _certificate(steps: Steps, paths: list[str], about: dict, options: dict, levels: list[dict]) -> dict:
    return {"generator": f"Bisque {core.version()}",
            "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "scan": [{"path": path, "bytes": os.path.getsize(path), "sha256": steps.hold(path)}
                     for path in paths] or "arrays in memory",
            "scan_triangles": about["triangles"], "lost": lost_of(about), "warnings": steps.warnings_of(None),
            "options": options, "versions": versions(options["library"]), "levels": levels,
            "seconds": steps.seconds}


def sorted_scan(steps: Steps, scan: Any, paths: list[str], texture: Any, job: dict) -> tuple[str, dict]:
    """Returns the chunk file of a scan and what is known of it."""
    for path in paths:
        steps.hold(path)
    if paths and core.is_chunks(paths):
        if texture:
            raise ValueError("texture: a chunk file names its images itself; sort the mesh with this one")
        if len(paths) > 1:
            raise ValueError("several chunk files: sort the meshes together, or give the meshes")
        return paths[0], {**dict.fromkeys(LOSSES, 0), "double_sided": False, **materials.describe(paths[0])}
    chunks = str(steps.folder / "scan.tris")
    options = {} if paths else {"content": _digest(as_mesh(scan))}
    if texture:
        options["texture"] = os.path.abspath(texture)
    return chunks, steps.run("sort", paths, options, [Path(chunks)], lambda: {**core.sort(
        scan, chunks, texture=texture, channels="all", progress=steps.report, **job), **materials.describe(chunks)})


def check_library(library: str) -> None:
    """Refuses a library that is not known, or not installed."""
    if library not in uv.LIBRARIES:
        raise ValueError(f"library: {library!r} is none of {', '.join(uv.LIBRARIES)}")
    if not importlib.util.find_spec(library):
        raise Error(69, f"{library} is not installed: pip install {library}")


def _check_options(output: Path, preset: str, samples: int, surface: str, library: str,
                   seconds: float) -> list[tuple[int, int]]:
    """Refuses values that make no sense, by ValueError. Returns the levels of the preset."""
    for name, value, words in (("preset", preset, PRESETS),
                               ("surface", surface, ("auto", "grid", "exact"))):
        if value not in words:
            raise ValueError(f"{name}: {value!r} is none of {', '.join(words)}")
    check_library(library)
    if output.suffix.lower() not in (".glb", usdz.SUFFIX):
        raise ValueError(f"{output}: its name must end in .glb or .usdz")
    if output.suffix.lower() == usdz.SUFFIX:
        usdz.require()
    core.check_number("samples", samples, 1, 2 ** 16)
    check_real("unwrap_seconds", seconds, 0, 1e9)
    return PRESETS[preset]["levels"]


def _check_inputs(output: Path, made: Path, keep: Path, inputs: list[str]) -> None:
    """Refuses outputs that would replace an input."""
    if output.is_dir():
        raise Error(73, f"{output}: this is a folder")
    for folder in (made, keep):
        core.refuse_tokens(folder)
    for path in inputs:
        if output.exists() and os.path.exists(path) and os.path.samefile(output, path):
            raise ValueError(f"{output}: this is an input, which would be replaced")
        for folder in (made, keep / Folder.NAME):
            if folder.resolve() in Path(path).resolve().parents:
                raise ValueError(f"{path}: the files in {folder} would be replaced; move it elsewhere")


# ---- the asset's files ----

#: In the private folder, while files get their names: all files that may be there, with their checksums.
PUBLISHED = "published.json"


def _copy_of(path: Path) -> Path:
    """Returns the name of a file until it replaces another one; links stay."""
    path = Path(os.path.realpath(path))
    return path.with_name(f".{path.name}.new")


def older_files(made: Path, output: Path, note: Path, paper: str) -> set[tuple[str, str]]:
    """Returns the files of the asset that is there, by its certificate, and those of one that was
    interrupted, whose copies go: names from `made`, and checksums."""
    found = set()
    try:
        found = {(name, checksum) for name, checksum in json.loads(note.read_text())}
        for path in [made / paper, *(made / name for name, _ in found)]:
            _copy_of(path).unlink(missing_ok=True)
    except (OSError, ValueError, TypeError):
        pass  # there is none
    try:
        levels = json.loads((made / paper).read_text())["levels"]
        for level in levels:
            own = made / os.path.basename(level["name"]) if len(levels) > 1 else made
            for name, checksum in level["files"].items():
                folder = output.parent if name.endswith((".glb", usdz.SUFFIX, ".svx.json")) else own
                found.add((os.path.relpath(folder / os.path.basename(name), made), checksum))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass  # there is none
    return found


def refuse_others(targets: Iterable[Path], made: Path, older: set[tuple[str, str]]) -> None:
    """Refuses to replace files that are not those of an older asset: older_files(). Raises Error."""
    for target in targets:
        if target.exists() and not (target.is_file() and (os.path.relpath(target, made), sha256(target)[0]) in older):
            raise Error(73, f"{target}: bisque-asset did not make this, or it was changed: move it elsewhere")


def _refuse_early(made: Path, output: Path, note: Path, chosen: list[tuple[int, int]]) -> None:
    """Refuses to replace files before the work, of those whose names are known. Raises Error."""
    folders, others = [made], []
    if len(chosen) > 1:
        folders = [made / str(number) for number in range(len(chosen))]
        others = [output.with_name(museum.SCENE), *(path for number, one in enumerate(chosen)
                                                    for _, path in museum.outputs(output, number, *one))]
    others += [folder / name for folder in folders for name in ("low.obj", "low.mtl", "preview.png")]
    refuse_others(others, made, older_files(made, output, note, "asset.json"))


def _sync(path: Path) -> None:
    """Makes sure that a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def publish(certificate: dict, made: Path, output: Path, note: Path, steps: Steps, move: bool,
            paper_name: str = "asset.json") -> None:
    """Gives all files of an asset their names: copies first, then the names, the certificate last.
    Files of an older asset that this one has not go, but for what its user named; `note` tells of them if this is
    interrupted. move: the private folder needs its files no more. paper_name: of the certificate."""
    pairs = {target: source for level in certificate["levels"] for target, source in level["files"].items()}
    for target in pairs:
        if target.exists() and any(os.path.exists(p) and os.path.samefile(p, target) for p in steps.seen):
            raise ValueError(f"{target}: this is an input, which would be replaced")
    sums = {target: sha256(source)[0] for target, source in pairs.items()}
    for level in certificate["levels"]:
        level["files"] = {target.name: sums[target] for target in level["files"]}
    older, paper = older_files(made, output, note, paper_name), made / paper_name
    refuse_others((target for target in pairs if target != output), made, older)
    if paper.exists() and not older:
        refuse_others([paper], made, older)
    own = {os.path.relpath(target, made): checksum for target, checksum in sums.items()}
    names = {target: Path(os.path.realpath(target)) for target in [*pairs, paper]}
    copies = {target: _copy_of(target) for target in names}
    refuse_others(copies.values(), made, set())  # those that were ours are gone
    try:
        note.with_suffix(".new").write_text(json.dumps([*older, *own.items()]))
        os.replace(note.with_suffix(".new"), note)
        for target, source in pairs.items():
            target.parent.mkdir(exist_ok=True)
            try:
                if not move:
                    raise OSError
                os.link(source, copies[target])
            except OSError:
                shutil.copy2(source, copies[target])
            if names[target].exists():
                shutil.copymode(names[target], copies[target])
        copies[paper].write_text(json.dumps(certificate, indent=1, default=float) + "\n")
        for copy in copies.values():
            _sync(copy)
        names[paper].unlink(missing_ok=True)
        kept = {os.path.relpath(output.with_suffix(suffix), made) for suffix in (".glb", usdz.SUFFIX)}
        for name, checksum in [file for file in older if file[0] not in own.keys() | kept]:
            if (made / name).is_file() and sha256(made / name)[0] == checksum:
                (made / name).unlink()
            with contextlib.suppress(OSError):  # unless it has other files, as `made` has
                (made / name).parent.rmdir()
        for target, copy in copies.items():
            os.replace(copy, names[target])
        for folder in {name.parent for name in names.values()}:
            _sync(folder)
        note.unlink()
    except OSError as error:
        status = 74 if error.errno in FAILED_IO else 73
        raise Error(status, f"{error.filename2 or error.filename or output}: {error.strerror}") from None
    finally:
        for copy in copies.values():
            copy.unlink(missing_ok=True)


def versions(library: str) -> dict:
    return {"bisque": core.version(), "numpy": np.__version__, library: metadata.version(library),
            "python": sys.version.split()[0]}

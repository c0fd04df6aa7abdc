"""From a scan to an asset: sort, simplify, unwrap, voxelize, bake, measure. The program bisque-asset.

Each step writes a file into a folder and notes in `steps.json` what it was made from. A step whose
note is still true is not repeated, so an interrupted job goes on where it stopped."""
from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from . import core, uv
from .mesh import Mesh, as_mesh, is_path, read_mesh

#: Triangles, texels and maps of each level; rays of a texel for ambient occlusion.
PRESETS: dict[str, dict] = {
    "web": {"levels": [(20_000, 2048)], "maps": ("normal", "color", "ao"), "rays": 32},
    "game": {"levels": [(10_000, 2048)], "maps": ("normal", "color", "ao", "curvature"),
             "rays": 32},
    "museum": {"levels": [(20_000, 512), (100_000, 2048), (150_000, 4096)],
               "maps": ("normal", "color", "ao"), "rays": 64},
    "archive": {"levels": [(150_000, 8192)], "maps": ("normal", "color", "ao", "mask"),
                "rays": 64},
}

#: What each step is of all the work, for the progress bar.
WEIGHTS = {"sort": 20, "simplify": 25, "unwrap": 10, "voxelize": 10, "bake": 25, "check": 10}
#: A grid with more voxels along a side takes more time than exact rays do.
MOST_RESOLUTION = 8192
#: Sides of the maps that are compared with exact ones.
SAMPLE_SIZE = 256


class Steps:
    """Runs steps, or takes what an earlier run left."""

    def __init__(self, folder: Path, progress: core.Progress | None, levels: int):
        self.folder, self.progress = folder, progress
        self.note = folder / "steps.json"
        self.known = json.loads(self.note.read_text()) if self.note.exists() else {}
        self.total = WEIGHTS["sort"] + levels * (sum(WEIGHTS.values()) - WEIGHTS["sort"])
        self.done, self.weight, self.name, self.stage, self.shown = 0.0, 0.0, "", "", 0
        self.seconds: dict[str, float] = {}

    def report(self, stage: str, done: int, total: int, unit: str) -> None:
        """Turns the progress of a stage into that of the whole, in thousandths. The stages of a step
        share its weight, half of what is left each."""
        if stage != self.stage:
            self.done += self.weight if self.stage else 0
            self.weight /= 2
            self.stage = stage
        share = self.done + self.weight * (min(done / total, 1) if total else 0)
        self.shown = max(self.shown, int(1000 * share / self.total))
        if self.progress:
            self.progress(f"{self.name}: {stage}", self.shown, 1000, "steps")

    def run(self, name: str, inputs: list, options: dict, outputs: list[Path], work: Any) -> Any:
        """Returns the result of `work`, or that of an earlier run with the same inputs, options and
        version whose outputs are there unchanged."""
        key = json.dumps([core.version(), [identity(path) for path in inputs], options],
                         sort_keys=True, default=str)
        weight = WEIGHTS[name.split(" ")[0]]
        self.name, self.weight, self.stage = name, weight, ""
        start, before = time.monotonic(), self.done
        known = self.known.get(name)
        if known and known["key"] == key and known["outputs"] == [identity(o) for o in outputs]:
            result = known["result"]
        else:
            self.known.pop(name, None)
            result = work()
            self.known[name] = {"key": key, "outputs": [identity(o) for o in outputs],
                                "result": result}
            temporary = self.note.with_suffix(".new")
            temporary.write_text(json.dumps(self.known, default=float))
            os.replace(temporary, self.note)
        self.seconds[name] = time.monotonic() - start
        self.done = before + weight
        return result


def identity(path: str | os.PathLike) -> list:
    """Returns what tells that a file is the same and was not written to."""
    try:
        info = os.stat(path)
    except OSError:
        return [os.fspath(path), None]
    return [os.fspath(path), info.st_size, info.st_mtime_ns]


def sha256(path: str | os.PathLike) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest(mesh: Mesh) -> str:
    """Returns a checksum of all arrays of a mesh."""
    digest = hashlib.sha256()
    for array in (mesh.vertices, mesh.faces, mesh.uvs, mesh.normals, mesh.colors):
        if array is not None:
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


# ---- decisions ----

def choose_surface(low: Mesh, scan_triangles: int, size: int, maps: Any) -> dict:
    """Chooses between a grid and exact rays by the size of a texel on the surface. A voxel is half
    as large as a texel. If the scan's triangles are not smaller than such voxels, or the grid
    would be larger than MOST_RESOLUTION, rays through triangles are exact, and not slower; but many
    rays from each hit (ao) take several times as long as in a grid."""
    p = low.vertices[low.faces]
    area = float(np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2)
    texel = (area / (low.report["uv"]["uv_share"] * size * size)) ** 0.5
    side = float((low.vertices.max(axis=0) - low.vertices.min(axis=0)).max())
    edge = (2 * area / max(scan_triangles, 1)) ** 0.5
    resolution = int(np.ceil(2 * side / texel / 64) * 64)
    many_rays = bool({"ao", "bent", "thickness"} & set(maps))
    exact = resolution > MOST_RESOLUTION or (edge >= texel / 2 and not many_rays)
    return {"texel": texel, "scan_edge": edge, "resolution": resolution, "exact": exact}


def write_mtl(path: Path, files: dict) -> None:
    """Writes the material of an OBJ file with its maps."""
    lines = ["newmtl baked", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
    for name, statement in (("color", "map_Kd"), ("normal", "norm"), ("ao", "map_Ka")):
        if name in files:
            lines.append(f"{statement} {os.path.basename(files[name])}")
    path.write_text("\n".join(lines) + "\n")


# ---- the levels ----

def _low_of(steps: Steps, scan: str, given: Any, level: dict, job: dict) -> Mesh:
    """Returns the low-poly mesh of a level with UVs, and writes it as an OBJ file."""
    simple, unwrapped = steps.folder / f"low_{level['name']}.ply", level["obj"]
    number, size = level["triangles"], level["size"]
    suffix = f" {level['name']}"
    if given is None:
        options = {"triangles": number, "min_component": level["min_component"]}
        report = steps.run("simplify" + suffix, [scan], options, [simple], lambda: core.simplify(
            scan, simple, progress=steps.report, **options, **job).report)
        low = read_mesh(str(simple))
    else:
        low, report = as_mesh(given), {}
    options = {"size": size, "padding": max(2, size // 512), "library": level["library"]}

    def make() -> dict:
        if low.uvs is not None:
            result, low.report["uv"] = low, uv.check_uvs(low, min(size, 2048))
        else:
            result = uv.unwrap(low, seconds=level["seconds"], progress=steps.report, **options)
        result.save(unwrapped, unwrapped.with_suffix(".mtl").name)
        return result.report["uv"]

    inputs = [simple] if given is None else [given] if is_path(given) else []
    if given is not None and not is_path(given):
        options["content"] = _digest(low)
    found = steps.run("unwrap" + suffix, inputs, options, [unwrapped], make)
    mesh = read_mesh(str(unwrapped))
    mesh.report = {**report, "uv": found}
    return mesh


def _measure_error(grid: str, chunks: str, low: str, job: dict, folder: Path) -> dict:
    """Compares the normals of a grid with exact ones, at points all over the mesh."""
    with_mask = ("normal", "mask")
    names = [str(folder / f"{kind}_<MAP>.exr") for kind in ("grid", "exact")]
    for scan, name in ((grid, names[0]), (chunks, names[1])):
        core.bake(scan, low, with_mask, size=SAMPLE_SIZE, samples=1, padding=0, output=name,
                  arrays=False, **job)
    normal, mask = ([name.replace("<MAP>", kind) for name in names] for kind in with_mask)
    found = core.compare(*normal, mask=mask[1], kind="normal")
    for name in normal + mask:
        os.unlink(name)
    return {key: found[key] for key in ("unit", "compared", "mean", "median", "p95", "p99", "max")}


def _bake(scan: Any, obj: Path, files: dict, options: dict, job: dict, progress: core.Progress) -> dict:
    """Bakes by the program of this package, which also writes the page. files: by the names of their
    options. Returns the program's report."""
    known = core.map_names()
    maps = ",".join(name if name in known else f"transfer:{name}" for name in options["maps"])
    words = [Path(__file__).parent / "bin" / "bisque-bake", scan, obj, "-o", obj.with_name("<MAP>.png"),
             "--json", "--progress", "json", "--maps", maps, "--size", options["size"],
             "--samples", options["samples"]]
    words += ["--rays", f"ao={options['ao_rays']}"] if {"ao", "bent"} & set(options["maps"]) else []
    words += [word for name, path in files.items() for word in (f"--{name}", path)]
    words += ["--memory", core.parse_bytes(job["memory"])] if job["memory"] else []
    words += ["--threads", job["threads"]] if job["threads"] else []
    said = []
    with tempfile.TemporaryFile("w+") as printed, subprocess.Popen(
            [str(word) for word in words], stdout=printed, stderr=subprocess.PIPE, text=True) as program:
        try:
            for line in program.stderr:
                if line.startswith("{"):
                    step = json.loads(line)
                    progress(step["stage"], step["done"], step["total"], step["unit"])
                else:
                    said.append(line.rstrip("\n").removeprefix("bisque-bake: "))
        except BaseException:
            program.terminate()
            raise
        if program.wait():
            raise core.Error(program.returncode, said[-1] if said else "bisque-bake failed")
        printed.seek(0)
        report = json.load(printed)
    for line in said:
        warnings.warn(line.removeprefix("warning: "), stacklevel=2)
    return report


def _set_command(page: Path, command: list[str]) -> None:
    """Makes a page show this command again, not that of its bake, whose files may be gone."""
    head, data, tail = re.split(r'(?<= id="data">)(.*)(?=</script>)', page.read_text("utf-8"), maxsplit=1)
    data = json.dumps({**json.loads(data), "command": command}).replace("<", "\\u003c")
    page.write_text(head + data + tail, "utf-8")


def _bake_level(steps: Steps, chunks: str, sorted_report: dict, low: Mesh, level: dict,
                job: dict) -> dict:
    """Bakes a level: maps, GLB and preview beside its OBJ file. Returns its part of the
    certificate."""
    suffix, size, obj = f" {level['name']}", level["size"], level["obj"]
    surface = choose_surface(low, sorted_report["triangles"], size, level["maps"])
    if level["surface"] != "auto":
        surface["exact"] = level["surface"] == "exact"
    scan, grid = chunks, steps.folder / f"grid_{level['name']}.nvdb"
    if not surface["exact"]:
        scan = str(grid)
        options = {"resolution": min(surface["resolution"], MOST_RESOLUTION)}
        steps.run("voxelize" + suffix, [chunks], options, [grid], lambda: core.voxelize(
            chunks, grid, progress=steps.report, **options, **job))
    has_color = sorted_report["has_colors"] or sorted_report["has_material_colors"] or (
        sorted_report["uses_textures"])
    maps = [name for name in level["maps"] if name != "color" or has_color]
    files = {"glb": level["glb"], "preview": obj.with_name("preview.png")}
    if level["report"]:
        files["report"] = obj.with_name("report.html")
    outputs = {name: str(obj.with_name(f"{name}.png")) for name in maps}
    options = {"maps": maps, "size": size, "samples": level["samples"], "ao_rays": level["rays"]}

    def make() -> dict:
        baked = _bake(scan, obj, files, options, job, steps.report)
        if level["report"] and level["command"]:
            _set_command(files["report"], level["command"])
        write_mtl(obj.with_suffix(".mtl"), outputs)
        return baked

    report = steps.run("bake" + suffix, [scan, obj], options,
                       [*files.values(), *map(Path, outputs.values())], make)
    exact = {"unit": "degrees", "mean": 0.0, "max": 0.0, "exact": True}
    error = exact if surface["exact"] else steps.run(
        "check" + suffix, [scan, chunks, obj], {"size": SAMPLE_SIZE}, [],
        lambda: _measure_error(scan, chunks, str(obj), job, steps.folder))
    if "from_scan" not in low.report:
        bare = Mesh(low.vertices, low.faces)
        low.report.update(steps.run("check distance" + suffix, [chunks, obj], {}, [],
                                    lambda: core.measure(bare, chunks, **job)))
    made = [obj, obj.with_suffix(".mtl"), *files.values(), *map(Path, outputs.values())]
    return {"name": level["name"], "triangles": len(low.faces), "size": size,
            "surface": {**surface, "method": "exact" if surface["exact"] else "grid"},
            "distance": {key: low.report[key] for key in ("from_scan", "from_mesh")},
            "uv": low.report["uv"], "normal_error": error,
            "rays": {key: report[key] for key in ("samples", "hits", "misses", "front", "back")},
            "memory_high": report["cost"]["memory_high_bytes"],
            "files": {file.name: sha256(file) for file in made}}


def _lost(report: dict) -> dict:
    """Returns what of the scan the asset does not have."""
    keys = ("degenerate_triangles", "short_faces", "broken_faces", "lost_corners",
            "unused_vertices", "skipped_lines", "unkept_channels")
    return {key: report[key] for key in keys if report[key]}


def asset(scan: Any, output: str | os.PathLike, *, low: Any = None, preset: str = "web",
          triangles: int | None = None, size: int | None = None, maps: Any = None,
          samples: int = 2, surface: str = "auto", library: str = "uvunwrap",
          unwrap_seconds: float = 300, min_component: float = 0.0, texture: Any = None,
          report: bool = False, keep: str | os.PathLike | None = None, memory: int | str | None = None,
          threads: int = 0, progress: core.Progress | None = None,
          command: list[str] | None = None) -> dict:
    """Makes an asset of a scan: OUTPUT.glb, and beside it a folder OUTPUT_asset with the mesh and its
    material (low.obj, low.mtl), the maps, a picture (preview.png) and the certificate, asset.json.
    Of several levels (preset "museum"), each has a GLB file and a folder with its number.

    low: a low-poly mesh to use; it is unwrapped if it has no UVs. texture: an image for all faces
    with texture coordinates, instead of those that the scan names. surface: "grid", "exact", or
    "auto", by the size of a texel. report: also makes a page to look at, report.html. command: the
    command that the page shows; without it, that of the bake. keep: a folder for the files between,
    which stay there; without it they are in OUTPUT_asset/steps until the asset is complete.
    Interrupted jobs go on from them.
    Returns the certificate. Raises Error, UnwrapError."""
    if preset not in PRESETS:
        raise ValueError(f"preset: {preset!r} is none of {', '.join(PRESETS)}")
    output = Path(output)
    if output.suffix.lower() != ".glb":
        raise ValueError(f"{output}: its name must end in .glb")
    levels = PRESETS[preset]["levels"]
    if triangles or size or low is not None:
        levels = [(triangles or levels[-1][0], size or levels[-1][1])]
    made = output.with_name(output.stem + "_asset")
    folder = Path(keep) if keep else made / "steps"
    in_memory = core._is_memory(scan)
    paths = [] if in_memory else core._paths(scan)
    _check_inputs(output, made, [*paths, *([low] if is_path(low) else [])])
    folder.mkdir(parents=True, exist_ok=True)
    steps = Steps(folder, progress, len(levels))
    job = {"memory": memory, "threads": threads}
    chunks = str(folder / "scan.tris")
    if not in_memory and len(paths) == 1 and paths[0].endswith(".tris"):
        chunks = str(folder / "given.tris")
        Path(chunks).unlink(missing_ok=True)
        os.symlink(os.path.abspath(paths[0]), chunks)
        about = _describe(paths[0])
        sorted_report = {"triangles": about["triangles"], "has_colors": about["color"]}
        sorted_report = {key: sorted_report.get(key, 0) for key in
                         ("triangles", "has_colors", "has_material_colors", "uses_textures",
                          "degenerate_triangles", "short_faces", "broken_faces", "lost_corners",
                          "unused_vertices", "skipped_lines", "unkept_channels")}
    else:
        content = {"texture": identity(texture) if texture else None}
        if in_memory:
            mesh = as_mesh(scan)
            content["content"] = _digest(mesh)
        sorted_report = steps.run("sort", paths, content, [Path(chunks)], lambda: core.sort(
            scan, chunks, texture=texture, progress=steps.report, **job))
    results = []
    for number, (count, side) in enumerate(levels):
        several = len(levels) > 1
        own = made / str(number) if several else made
        own.mkdir(exist_ok=True)
        glb = output.with_name(f"{output.stem}_{number}.glb") if several else output
        level = {"name": str(number), "glb": glb, "triangles": count, "size": side, "samples": samples,
                 "maps": maps or PRESETS[preset]["maps"], "rays": PRESETS[preset]["rays"],
                 "surface": surface, "library": library,
                 "seconds": unwrap_seconds, "min_component": min_component, "report": report,
                 "command": command, "obj": own / "low.obj"}
        mesh = _low_of(steps, chunks, low, level, job)
        results.append(_bake_level(steps, chunks, sorted_report, mesh, level, job))
    certificate = {
        "generator": f"Bisque {core.version()}",
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "scan": [{"path": path, "bytes": os.path.getsize(path), "sha256": sha256(path)}
                 for path in paths] or "arrays in memory",
        "scan_triangles": sorted_report["triangles"], "lost": _lost(sorted_report),
        "options": {"preset": preset, "levels": levels, "samples": samples, "surface": surface,
                    "library": library, "memory": memory, "threads": threads},
        "versions": _versions(library), "levels": results, "seconds": steps.seconds}
    (made / "asset.json").write_text(json.dumps(certificate, indent=1, default=float) + "\n")
    if not keep:
        shutil.rmtree(folder)
    return certificate


def _check_inputs(output: Path, made: Path, inputs: list) -> None:
    """Refuses outputs that would replace an input. Textures of a scan cannot be known here, but no
    output but the GLB file lies outside of the folder `made`."""
    for path in inputs:
        if output.exists() and os.path.exists(path) and os.path.samefile(output, path):
            raise ValueError(f"{output}: this is an input, which would be replaced")
        if made.resolve() in Path(path).resolve().parents:
            raise ValueError(f"{path}: the files in {made} would be replaced; move it elsewhere")


def _describe(path: str) -> dict:
    """Returns what the program of this package says of a chunk file."""
    done = subprocess.run([Path(__file__).parent / "bin" / "bisque-voxelize", "--info", "--json", path],
                          capture_output=True, text=True)
    if done.returncode:
        raise core.Error(done.returncode, done.stderr.strip().removeprefix("bisque-voxelize: "))
    return json.loads(done.stdout)["files"][0]


def _versions(library: str) -> dict:
    from importlib import metadata

    return {"bisque": core.version(), "numpy": np.__version__, library: metadata.version(library),
            "python": sys.version.split()[0]}


# ---- the program ----

def _bar(stage: str, done: int, total: int, _unit: str) -> None:
    width = 30
    filled = width * done // max(total, 1)
    print(f"\r[{'#' * filled}{'.' * (width - filled)}] {100 * done // max(total, 1):3d} % "
          f"{stage[:36]:36s}", end="", file=sys.stderr, flush=True)


def _line(stage: str, done: int, total: int, unit: str) -> None:
    step = {"stage": stage, "unit": unit, "done": done, "total": total}
    print(json.dumps(step), file=sys.stderr, flush=True)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="bisque-asset", description="Makes a GLB file with baked maps of a scan of any size.")
    parser.add_argument("scan", nargs="+", help="mesh files, read as one scan, or a .tris file")
    parser.add_argument("-o", "--output", required=True, metavar="FILE.glb",
                        help="the asset; its other files are beside it")
    parser.add_argument("--preset", choices=PRESETS, default="web")
    parser.add_argument("--low", metavar="FILE.obj", help="a low-poly mesh to use")
    parser.add_argument("--texture", metavar="FILE", help="the scan's image, if it names none")
    parser.add_argument("--triangles", type=int, metavar="N", help="of the low-poly mesh")
    parser.add_argument("--size", type=int, metavar="N", help="texels of a side of the maps")
    parser.add_argument("--maps", metavar="LIST", help="such as normal,color,ao")
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="N x N a texel")
    parser.add_argument("--surface", choices=("auto", "grid", "exact"), default="auto")
    parser.add_argument("--unwrap", choices=uv.LIBRARIES, default="uvunwrap", metavar="LIBRARY",
                        help="uvunwrap or xatlas")
    parser.add_argument("--unwrap-seconds", type=float, default=300, metavar="S")
    parser.add_argument("--min-component", type=float, default=0, metavar="SHARE",
                        help="drop pieces with a smaller share of the scan's diagonal")
    parser.add_argument("--report", action="store_true", help="also write report.html, a page to look at")
    parser.add_argument("--keep", metavar="DIR", help="keep the files between in this folder")
    parser.add_argument("--memory", metavar="SIZE", help="for each step, such as 1G")
    parser.add_argument("-j", "--threads", type=int, default=0, metavar="N")
    parser.add_argument("--progress", choices=("auto", "bar", "json", "none"), default="auto",
                        help="on standard error; auto: a bar on a terminal")
    parser.add_argument("--json", action="store_true", help="print the certificate instead of lines")
    parser.add_argument("--version", action="version", version=f"bisque-asset {core.version()}")
    a = parser.parse_args(arguments)
    if a.progress == "auto":
        a.progress = "bar" if sys.stderr.isatty() else "none"
    show = {"bar": _bar, "json": _line, "none": None}[a.progress]
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    warnings.showwarning = lambda message, *_: print(f"\nbisque-asset: warning: {message}",
                                                     file=sys.stderr)
    try:
        certificate = asset(
            a.scan if len(a.scan) > 1 else a.scan[0], a.output, low=a.low, preset=a.preset,
            triangles=a.triangles, size=a.size, maps=a.maps.split(",") if a.maps else None,
            samples=a.samples, surface=a.surface, library=a.unwrap,
            unwrap_seconds=a.unwrap_seconds, min_component=a.min_component,
            texture=a.texture, report=a.report, keep=a.keep, memory=a.memory, threads=a.threads, progress=show,
            command=["bisque-asset", *(sys.argv[1:] if arguments is None else arguments)])
    except KeyboardInterrupt:
        print("\nbisque-asset: interrupted; the same command goes on from here", file=sys.stderr)
        return 75
    except core.Error as error:
        print(f"\nbisque-asset: {error.message}", file=sys.stderr)
        return error.status
    except (uv.UnwrapError, ValueError, OSError) as error:
        print(f"\nbisque-asset: {error}", file=sys.stderr)
        return 65 if isinstance(error, uv.UnwrapError) else 64
    if show == _bar:
        print(file=sys.stderr)
    if a.json:
        print(json.dumps(certificate, default=float))
        return 0
    for level in certificate["levels"]:
        print(f"{a.output}: {level['triangles']} triangles, {level['size']} x {level['size']} "
              f"texels, {level['surface']['method']}; farthest from the scan "
              f"{level['distance']['from_scan']['max']:.4g}; normals off by "
              f"{level['normal_error']['mean']:.3g} degrees on average")
    return 0


if __name__ == "__main__":
    sys.exit(main())

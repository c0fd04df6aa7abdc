"""The museum recipe, as Smithsonian's Cook has it (si-voyager-scene): which files there are, their names, and the
scene that Voyager opens (dpo-voyager, source/client/schema/json)."""
from __future__ import annotations

import json
import os
from pathlib import Path
from urllib.parse import quote

from . import core
from .mesh import Error
from .steps import Folder
from .usdz import SUFFIX, installed

SCENE = "scene.svx.json"
#: Of the levels of the preset: the qualities of their files, each of half the size of the one before.
QUALITIES = (("Thumb",), ("High", "Medium", "Low"), ("AR",))
#: What viewers take files for augmented reality for: browsers, Android, iPhones.
USES = {("AR", ".glb"): ("Web3D", "App3D"), ("AR", SUFFIX): ("iOSApp3D",)}
MIME_TYPES = {".glb": "model/gltf-binary", SUFFIX: "model/vnd.usdz+zip"}


def outputs(output: Path, number: int, triangles: int, size: int) -> list[tuple[int, Path]]:
    """Returns the sizes and the files of a level, such as vase-150k-4096-high.glb."""
    sizes = [(size >> i, quality) for i, quality in enumerate(QUALITIES[number]) if size % (1 << i) == 0]
    return [(side, output.with_name(f"{output.stem}-{triangles / 1000:g}k-{side}-{quality.lower()}{suffix}"))
            for side, quality in sizes for suffix in (".glb", SUFFIX) if suffix == ".glb" or (
                quality == "AR" and installed())]


def check(output: Path, made: Path, has_units: bool) -> None:
    """Refuses a scan without a unit, by ValueError, and a folder with another scene, by Error."""
    if not has_units:
        raise ValueError("units: the preset museum needs the unit of the scan: mm, cm, m or in")
    try:
        own = SCENE in (made / "asset.json").read_text()
    except OSError:
        own = (made / Folder.NAME).exists()  # a job that was interrupted
    if output.with_name(SCENE).exists() and not own:
        raise Error(73, f"{output.with_name(SCENE)}: is of another asset, whose folder this cannot be")


def add_scene(path: Path, output: Path, chosen: list[tuple[int, int]], levels: list[dict]) -> None:
    """Writes a scene with the files of all levels, and adds it to those of the first one. The camera sees all of the
    model from the front, in metres."""
    far = max(levels[0]["placement"]["size_m"])
    qualities = {quality.lower(): quality for of_level in QUALITIES for quality in of_level}
    derivatives = [{"usage": usage, "quality": quality, "assets": [{
        "uri": quote(os.fsencode(target.name)), "type": "Model", "mimeType": MIME_TYPES[target.suffix],
        "byteSize": level["files"][target].stat().st_size, "numFaces": level["triangles"], "imageSize": side}]}
        for number, (pair, level) in enumerate(zip(chosen, levels))
        for side, target in outputs(output, number, *pair)
        for quality in [qualities[target.stem.rpartition("-")[2]]]
        for usage in USES.get((quality, target.suffix), ("Web3D",))]
    lights = [{"type": "directional", "color": [1, 1, 1], "intensity": 1},
              {"type": "directional", "color": [1, 1, 1], "intensity": 0.5},
              {"type": "ambient", "color": [1, 1, 1], "intensity": 0.3}]
    places = [{"translation": [far, 2 * far, 2 * far]}, {"translation": [-2 * far, far, -far]}, {}]
    scene = {
        "asset": {"type": "application/si-dpo-3d.document+json", "version": "1.0",
                  "generator": f"Bisque {core.version()}"},
        "scene": 0, "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [{"name": "Camera", "translation": [0, 0, 2.5 * far], "camera": 0},
                  {"name": "Lights", "children": [3, 4, 5]}, {"name": output.stem, "model": 0},
                  *({"name": f"Light {i + 1}", "light": i, **place} for i, place in enumerate(places))],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.9, "znear": far / 100, "zfar": 100 * far}}],
        "lights": lights, "models": [{"units": "m", "derivatives": derivatives}]}
    path.write_text(json.dumps(scene, indent=1) + "\n")
    levels[0]["files"][output.with_name(SCENE)] = path

"""Where an asset stands. A scan keeps its axes and units, and so do the mesh and the distances in the certificate;
the GLB file gets a node that turns and scales it to what glTF has: y upwards, metres."""
from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from .glb import Glb, write_glb
from .mesh import Mesh, check_real, parse_amount

UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
_H = 0.5 ** 0.5
#: The axis that points upwards in a scan, and the quaternion (x, y, z, w) that turns it to +y.
UP = {"x": (0, 0, _H, _H), "y": (0, 0, 0, 1), "z": (-_H, 0, 0, _H),
      "-x": (0, 0, -_H, _H), "-y": (1, 0, 0, 0), "-z": (_H, 0, 0, _H)}
#: Files whose readers know both.
PLACED = (".glb", ".gltf")
#: Sizes in metres beyond which a unit is doubted.
LARGEST, SMALLEST = 50, 0.005


def check_options(up: Any, units: Any, scale: Any) -> None:
    """Refuses values that make no sense, by ValueError."""
    for name, value, words in (("up", up, UP), ("units", units, UNITS)):
        if value is not None and value not in words:
            raise ValueError(f"{name}: {value!r} is none of {', '.join(words)}")
    if scale is not None:
        check_real("scale", scale, 1e-12, 1e12)


def unit_of(units: str | None, scale: float | None) -> float:
    """Returns the metres of a unit of the scan."""
    return UNITS[units or "m"] * (1 if scale is None else scale)


def parse_length(name: str, value: Any, unit: float) -> float | str | None:
    """Returns a length in the scan's units of one such as 0.2, "0.2mm", or a percentage, which stays. unit: the
    metres of a unit of the scan. Raises ValueError."""
    match = re.fullmatch(rf"(.*?[\d.])\s*({'|'.join(UNITS)})", value.strip()) if isinstance(value, str) else None
    if match:
        return parse_amount(name, match[1])[0] * UNITS[match[2]] / unit
    if value is None or parse_amount(name, value)[1]:
        return value
    return float(value)


def matrix_of(up: str | None, unit: float) -> np.ndarray:
    """Returns the matrix that turns the axis that points upwards to +y, and multiplies by a unit."""
    return unit * np.stack([turn(UP[up or "y"], axis) for axis in np.eye(3)], axis=1)


# ---- the GLB file ----

def turn(q: tuple, v: Any) -> np.ndarray:
    """Turns a vector by a quaternion."""
    axis = np.asarray(q[:3], float)
    across = 2 * np.cross(axis, v)
    return np.asarray(v, float) + q[3] * across + np.cross(axis, across)


def _product(a: tuple, b: tuple) -> list[float]:
    """Returns the quaternion that turns by b, and then by a."""
    x, y = np.asarray(a[:3], float), np.asarray(b[:3], float)
    return [*(a[3] * y + b[3] * x + np.cross(x, y)).tolist(), float(a[3] * b[3] - x @ y)]


def place_glb(source: Path, target: Path, up: str, scale: float, both_sides: bool) -> None:
    """Writes a GLB file whose nodes are turned and scaled, and whose materials show both sides on request. Raises
    Error."""
    glb = Glb(source)
    for number in glb.head["scenes"][glb.head.get("scene", 0)]["nodes"]:
        node = glb.head["nodes"][number]
        node["translation"] = (scale * turn(UP[up], node.get("translation", (0, 0, 0)))).tolist()
        node["rotation"] = _product(UP[up], node.get("rotation", (0, 0, 0, 1)))
        node["scale"] = [scale * s for s in node.get("scale", (1, 1, 1))]
    for material in glb.head.get("materials", []) if both_sides else []:
        material["doubleSided"] = True
    write_glb(target, glb.head, [glb.data], len(glb.data))


def placed(steps: Any, level: dict, source: Path, low: Mesh, guess: str | None) -> tuple[Path, dict]:
    """Places the GLB file of a level in a step. level["place"]: up, units and scale as they were given, and
    `name` of a scan in a file without axes and units, or None. Returns the file and what the certificate says."""
    both_sides = bool(low.report["mended"].get("double_sided"))
    how = level["place"]
    up, unit = how["up"] or "y", unit_of(how["units"], how["scale"])
    target = source.with_name(f"placed_{source.name}")
    size = unit * np.ptp(low.vertices, axis=0).astype(float)
    turned = np.abs(turn(UP[up], size))
    changes = up != "y" or unit != 1 or both_sides

    def make() -> dict:
        if how["name"] and not (how["units"] or how["scale"]) and not SMALLEST <= size.max() <= LARGEST:
            steps.heard.warn(f"{how['name']}: {size.max():.4g} m in size if its unit is the metre; --units mm, cm or "
                             "in says another one (--units m: it is right)")
        if changes:
            place_glb(source, target, up, unit, both_sides)
        return {"up": up, "metres_per_unit": unit, "size_m": turned.tolist()}

    options = {**how, "both_sides": both_sides}
    report = steps.run(f"place {source.stem} {level['name']}", [source], options, [target] if changes else [], make)
    return target if changes else source, {**report, "preview_up": guess}


def view_up(how: dict) -> str | None:
    """Returns the axis that the preview shall have upwards; None: it guesses."""
    up = how["up"] or (None if how["name"] else "y")
    return up if up in ("y", "z") else None


def name_of(paths: list[str]) -> str | None:
    """Returns the name of the first file of a scan that has no axes and units of its own; None: all have."""
    names = [os.path.basename(path) for path in paths]
    return next((name for name in names if not name.lower().removesuffix(".gz").removesuffix(".zst").endswith(PLACED)),
                None if names else "the scan")

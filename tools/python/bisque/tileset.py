"""The tileset of 3D Tiles, where it lies on the earth, and a page that shows it."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from . import core
from .cut import Tile
from .place import matrix_of, unit_of

#: Where Debian's package libjs-three is installed, and its parts that the page needs.
THREE = Path("/usr/share/javascript/three")
SCRIPTS = ("build/three.min.js", "examples/js/controls/OrbitControls.js", "examples/js/loaders/GLTFLoader.js")
#: Content is y-up, as glTF says; tiles are z-up.
Z_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
#: Of the ellipsoid WGS 84, in metres: half of its long axis, and the square of its eccentricity.
LONG_AXIS, ECCENTRICITY = 6378137.0, 6.69437999014e-3


def check_place(place: Any) -> tuple[float, float, float] | None:
    """Returns longitude, latitude and height as numbers. Raises ValueError."""
    if place is None:
        return None
    try:
        lon, lat, height = (float(value) for value in place)
    except (TypeError, ValueError):
        raise ValueError(f"place: longitude, latitude and height are needed, not {place!r}") from None
    if not (abs(lon) <= 180 and abs(lat) <= 90 and abs(height) < 1e7):
        raise ValueError(f"place: {lon:g},{lat:g},{height:g} is no place on the earth, in degrees and metres")
    return lon, lat, height


def place_matrix(longitude: float, latitude: float, height: float) -> np.ndarray:
    """Returns the matrix from east, north and up, in metres, to the earth's axes (EPSG:4978), for a place in degrees
    and metres above the ellipsoid."""
    lon, lat = np.radians([longitude, latitude])
    east = [-np.sin(lon), np.cos(lon), 0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    radius = LONG_AXIS / np.sqrt(1 - ECCENTRICITY * np.sin(lat) ** 2)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = east, north, up
    matrix[:3, 3] = radius * up * [1, 1, 1 - ECCENTRICITY] + height * up
    return matrix


def _node(tile: Tile, known: dict[str, dict]) -> tuple[dict, np.ndarray, np.ndarray]:
    """Returns a tile as tileset.json describes it, and the corners of its box, in the content's axes."""
    children = [_node(child, known) for child in tile.children]
    low = np.min([known[tile.name]["low"], *(child[1] for child in children)], axis=0)
    high = np.max([known[tile.name]["high"], *(child[2] for child in children)], axis=0)
    middle, half = Z_UP @ ((low + high) / 2), np.abs(Z_UP @ ((high - low) / 2))
    node = {"boundingVolume": {"box": [*middle.tolist(), half[0], 0, 0, 0, half[1], 0, 0, 0, half[2]]},
            "geometricError": tile.error, "content": {"uri": known[tile.name]["file"]}}
    if children:
        node["children"] = [child[0] for child in children]
    return node, low, high


def tileset(root: Tile, known: dict[str, dict], origin: np.ndarray, options: dict) -> dict:
    """Returns tileset.json. Without content, the error is the size of the scan, in metres."""
    node, low, high = _node(root, known)
    node["refine"] = "REPLACE"
    matrix = np.eye(4) if options["place"] is None else place_matrix(*options["place"])
    unit = unit_of(options["units"], options["scale"])
    turn = Z_UP @ matrix_of(options["up"], unit)
    matrix[:3, 3] += matrix[:3, :3] @ turn @ origin
    matrix[:3, :3] = matrix[:3, :3] @ turn @ Z_UP.T
    if not (matrix == np.eye(4)).all():
        node["transform"] = matrix.T.ravel().tolist()
    size = float(np.linalg.norm(np.subtract(high, low)))
    return {"asset": {"version": "1.1", "extras": {"generator": f"Bisque {core.version()}", "options": options}},
            "geometricError": unit * max(size, 2 * root.error), "root": node}


def make_page(path: Path) -> bool:
    """Writes a page that shows the tileset beside it. Returns False if libjs-three is not installed."""
    if not all((THREE / name).is_file() for name in SCRIPTS):
        return False
    scripts = "".join(f"<script>{(THREE / name).read_text('utf-8')}</script>\n" for name in SCRIPTS)
    frame = (Path(__file__).parent / "viewer.html").read_text("utf-8")
    path.write_text(frame.replace("<!--scripts-->\n", scripts), "utf-8")
    return True

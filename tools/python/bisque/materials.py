"""What an asset takes of the materials of its scan: the channels that glTF has, alpha, and sides."""
from __future__ import annotations

from typing import Any, Sequence

from . import core, programs
from .mesh import Error

#: Channels of a scan that a GLB file has a place for, and their textures in MTL files.
CHANNELS = {"roughness": "map_Pr", "metallic": "map_Pm", "occlusion": "map_ao", "emission": "map_Ke",
            "opacity": "map_d"}
#: The channel of a scan's own normal map, which is part of its normals.
NORMAL_MAP = "normal_map"


def describe(chunks: str) -> dict:
    """Returns what is known of a chunk file: triangles, color, channels, alpha ("mask", "blend" or None),
    emits. Raises Error."""
    return programs.run("bisque-voxelize", ["--info", "--", chunks], None, lambda _: None)["files"][0]


def choose_maps(asked: Any, usual: Sequence[str], about: dict) -> list[str]:
    """Returns the maps to bake: those asked for, or the usual ones and what glTF has of the scan's
    materials, whose own occlusion goes before ambient occlusion. Leaves colours out if the scan has none.
    Raises Error for a channel that the scan lacks."""
    found = about["channels"]
    if asked:
        for name in asked:
            if name not in core.map_names() and (name not in found or name == NORMAL_MAP):
                has = ", ".join(sorted({*found} - {NORMAL_MAP})) or "none"
                raise Error(65, f"the scan has no channel {name}; it has: {has}")
        maps = list(asked)
    else:
        dull = {"emission": not about["emits"], "opacity": not about["alpha"]}
        own = [name for name in CHANNELS if name in found and not dull.get(name)]
        maps = [name for name in usual if name != "ao" or "occlusion" not in own] + own
    maps = [name for name in maps if name != "color" or about["color"]]
    if not maps:
        raise Error(65, "the scan has no colour, and no other map is asked for")
    return maps


def options_of(maps: Sequence[str], about: dict) -> list[str]:
    """Returns the options of bisque-bake for the GLB file's material."""
    words = ["sides=two"] * bool(about["double_sided"])
    words += [f"alpha={about['alpha']}"] * (about["alpha"] is not None and "opacity" in maps)
    return ["--material", ",".join(words)] if words else []


def certify(maps: Sequence[str], about: dict) -> dict:
    """Returns what the certificate says of the materials: the channels that the asset has, and those that
    only the scan has."""
    taken = [name for name in about["channels"] if name in maps or (name == NORMAL_MAP and "normal" in maps)]
    return {"taken": taken, "not_taken": [name for name in about["channels"] if name not in taken],
            "alpha": about["alpha"] if "opacity" in maps else None, "double_sided": about["double_sided"]}

"""Bisque bakes huge scans to texture maps and GLB files, in a fixed amount of memory.

    import bisque
    low = bisque.unwrap(bisque.simplify("statue.ply", triangles=20000))
    maps = bisque.bake("statue.ply", low, maps=("normal", "ao"), size=4096, memory="1G")
    maps["normal"]                      # a numpy array, rows from the top
    maps.save("statue_<MAP>.png")
    maps.glb("statue.glb")

A scan (`scan`, `high`) is a path or a list of paths (meshes, .tris, .nvdb), or a mesh in memory:
`(vertices, faces)` arrays, a `Mesh`, a trimesh or an Open3D mesh. All work is done by the C
libraries; `asset()` and the program `bisque-asset` put the steps together.
"""

from .asset import PRESETS, asset
from .core import Error, Maps, bake, compare, measure, simplify, sort, version, voxelize
from .mesh import Mesh
from .tiles import tiles
from .uv import UnwrapError, check_uvs, unwrap

__version__ = version()
__all__ = ["Error", "Maps", "Mesh", "PRESETS", "UnwrapError", "asset", "bake", "check_uvs",
           "compare", "measure", "simplify", "sort", "tiles", "unwrap", "version", "voxelize"]

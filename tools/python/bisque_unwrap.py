"""bisque_unwrap.py - the libraries that unwrap meshes, in a process of their own that can be stopped. It loads nothing
else of the package: 3D Tiles start it for each tile."""
import sys

import numpy as np

import bisque_start


def _uvunwrap(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int) -> np.ndarray:
    import uvunwrap

    mesh = uvunwrap.Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    atlas = uvunwrap.generate([mesh], page_size=size, padding=padding)
    return np.asarray(atlas.meshes[0].corner_uvs, np.float32).reshape(-1, 3, 2)


def _xatlas(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int) -> np.ndarray:
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    charts, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    pack.resolution, pack.padding = size, padding
    # It rotates charts by mirroring them. Charts lie in gaps of others, so none could be turned back later.
    charts.fix_winding, pack.rotate_charts = True, False
    atlas.generate(chart_options=charts, pack_options=pack)
    _, indices, uvs = atlas[0]
    # They fill a rectangle; in a square of maps, that must not stretch them.
    uvs = uvs * np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height)
    return uvs[indices].astype(np.float32)


LIBRARIES = {"uvunwrap": _uvunwrap, "xatlas": _xatlas}


def main() -> None:
    """Unwraps the mesh of a .npz file: its path, that of the result, the library, texels and padding."""
    bisque_start.die_with_parent()
    source, target, library, size, padding = sys.argv[1:]
    with np.load(source) as data:
        uvs = LIBRARIES[library](data["vertices"], data["faces"], int(size), int(padding))
    np.save(target, uvs)


if __name__ == "__main__":
    main()

"""Meshes in memory: what other libraries call a mesh, and small files that hold one."""
from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Mesh:
    """A triangle mesh. `faces` index `vertices`; `uv_faces` and `normal_faces`, of the same shape,
    index `uvs` and `normals`. `report` says how the mesh was made."""
    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    normals: np.ndarray | None = None
    normal_faces: np.ndarray | None = None
    colors: np.ndarray | None = None
    report: dict = field(default_factory=dict)

    def corner_uvs(self) -> np.ndarray:
        """Returns the texture coordinates of each corner: (faces, 3, 2)."""
        return self.uvs[self.uv_faces]

    def save(self, path: str | os.PathLike, material: str | None = None) -> None:
        """Writes the mesh as an OBJ file; `material`: a library beside it, with one material."""
        lines = []
        if material:
            lines.append(f"mtllib {material}\nusemtl baked\n")
        for key, rows in (("v", self.vertices), ("vt", self.uvs), ("vn", self.normals)):
            if rows is not None and len(rows):
                digits = "%.17g" if np.asarray(rows).dtype == np.float64 else "%.9g"
                line = key + (" " + digits) * rows.shape[1] + "\n"
                lines.append(line * len(rows) % tuple(np.asarray(rows).ravel().tolist()))
        columns = [self.faces]
        pattern = "%d"
        if self.uv_faces is not None:
            columns.append(self.uv_faces)
            pattern += "/%d"
        if self.normal_faces is not None:
            columns.append(self.normal_faces)
            pattern += "//%d" if self.uv_faces is None else "/%d"
        corners = np.stack([np.asarray(c, np.int64) + 1 for c in columns], axis=2)
        line = "f " + " ".join([pattern] * 3) + "\n"
        lines.append(line * len(corners) % tuple(corners.ravel().tolist()))
        temporary = f"{os.fspath(path)}.new"
        with open(temporary, "w", encoding="utf-8") as file:
            file.writelines(lines)
        os.replace(temporary, path)


def is_path(thing: Any) -> bool:
    return isinstance(thing, (str, bytes, os.PathLike))


def _rows(array: Any, columns: int, what: str) -> np.ndarray:
    array = np.asarray(array)
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"{what}: an array of {columns} columns is needed, not {array.shape}")
    return array


def _from_open3d(thing: Any) -> Mesh:
    if hasattr(thing, "vertex"):  # open3d.t.geometry.TriangleMesh
        mesh = Mesh(thing.vertex["positions"].numpy(), thing.triangle["indices"].numpy())
        if "colors" in thing.vertex:
            mesh.colors = thing.vertex["colors"].numpy()
        if "texture_uvs" in thing.triangle:
            mesh.uvs = thing.triangle["texture_uvs"].numpy().reshape(-1, 2)
    else:
        mesh = Mesh(np.asarray(thing.vertices), np.asarray(thing.triangles))
        if len(getattr(thing, "vertex_colors", ())):
            mesh.colors = np.asarray(thing.vertex_colors)
        if len(getattr(thing, "triangle_uvs", ())):
            mesh.uvs = np.asarray(thing.triangle_uvs)
    return mesh


def _from_trimesh(thing: Any) -> Mesh:
    mesh = Mesh(np.asarray(thing.vertices), np.asarray(thing.faces))
    visual = getattr(thing, "visual", None)
    if getattr(visual, "uv", None) is not None:
        mesh.uvs = np.asarray(visual.uv)
    elif getattr(visual, "kind", None) == "vertex":
        mesh.colors = np.asarray(visual.vertex_colors)[:, :3]
    return mesh


def as_mesh(thing: Any) -> Mesh:
    """Takes a Mesh, a tuple (vertices, faces[, uvs]), a trimesh or an Open3D mesh, or the path of an
    OBJ file or a PLY file of bisque-simplify. Arrays are not copied."""
    if isinstance(thing, Mesh):
        return thing
    if is_path(thing):
        return read_mesh(os.fspath(thing))
    if isinstance(thing, (tuple, list)) and len(thing) in (2, 3) and not is_path(thing[0]):
        mesh = Mesh(*(np.asarray(array) for array in thing))
    elif hasattr(thing, "vertices") and hasattr(thing, "faces"):  # trimesh has triangles, too
        mesh = _from_trimesh(thing)
    elif hasattr(thing, "triangles") or hasattr(thing, "triangle"):
        mesh = _from_open3d(thing)
    else:
        raise TypeError(f"no mesh, and no path of one: {type(thing).__name__}")
    mesh.vertices = _rows(mesh.vertices, 3, "vertices")
    mesh.faces = _rows(mesh.faces, 3, "faces")
    if mesh.faces.dtype.kind not in "iu":
        raise ValueError(f"faces: integers are needed, not {mesh.faces.dtype}")
    if mesh.uvs is not None:
        mesh.uvs = _rows(np.asarray(mesh.uvs).reshape(-1, 2), 2, "uvs")
        if len(mesh.uvs) == len(mesh.vertices) != 3 * len(mesh.faces):
            mesh.uv_faces = mesh.faces
        elif len(mesh.uvs) == 3 * len(mesh.faces):
            mesh.uv_faces = np.arange(len(mesh.uvs)).reshape(-1, 3)
        else:
            raise ValueError("uvs: one for each vertex or for each corner is needed, not "
                             f"{len(mesh.uvs)}")
    return mesh


def _read_ply(path: str) -> Mesh:
    """Reads what bisque-simplify writes: positions, normals and triangles."""
    types = {"float": "<f4", "double": "<f8", "uchar": "u1", "uint": "<u4", "int": "<i4"}
    with open(path, "rb") as file:
        header = [line.split() for line in iter(file.readline, b"end_header\n")]
        words = [[word.decode() for word in line] for line in header]
        counts = {line[1]: int(line[2]) for line in words if line[0] == "element"}
        columns = [(line[2], types[line[1]]) for line in words
                   if line[0] == "property" and line[1] != "list"]
        if words[1][1] != "binary_little_endian" or ["vertex", "face"] != list(counts):
            raise ValueError(f"{path}: only PLY files of bisque-simplify are read here")
        vertices = np.fromfile(file, np.dtype(columns), counts["vertex"])
        faces = np.fromfile(file, np.dtype([("n", "u1"), ("v", "<u4", 3)]), counts["face"])["v"]
    mesh = Mesh(np.stack([vertices[k] for k in "xyz"], axis=1), faces.astype(np.int64))
    normals = [vertices[k] for k in ("nx", "ny", "nz") if k in vertices.dtype.names]
    # A vertex with several normals is there several times.
    mesh.vertices, which = np.unique(mesh.vertices, axis=0, return_inverse=True)
    mesh.normal_faces = mesh.faces if normals else None
    mesh.faces = which.reshape(-1)[mesh.faces]
    mesh.normals = np.stack(normals, axis=1) if normals else None
    return mesh


def _read_obj(path: str) -> Mesh:
    rows: dict[str, list] = {"v": [], "vt": [], "vn": []}
    corners: list[tuple] = []
    with open(path, encoding="utf-8", errors="replace") as file:
        for line in file:
            words = line.split()
            if words and words[0] in rows:
                rows[words[0]].append([float(word) for word in words[1:4]])
            elif words and words[0] == "f":
                face = [(word + "//").split("/")[:3] for word in words[1:]]
                for k in range(1, len(face) - 1):
                    corners += [face[0], face[k], face[k + 1]]
    sizes = [len(rows[key]) for key in ("v", "vt", "vn")]
    indices = [[int(c[k]) - 1 if int(c[k]) > 0 else sizes[k] + int(c[k]) for c in corners]
               if corners and all(c[k] for c in corners) else None for k in range(3)]
    arrays = [np.asarray(i).reshape(-1, 3) if i is not None else None for i in indices]
    mesh = Mesh(np.asarray(rows["v"], float).reshape(-1, 3), arrays[0])
    if arrays[1] is not None:
        mesh.uvs, mesh.uv_faces = np.asarray([row[:2] for row in rows["vt"]]), arrays[1]
    if arrays[2] is not None:
        mesh.normals, mesh.normal_faces = np.asarray(rows["vn"], np.float32), arrays[2]
    return mesh


def read_mesh(path: str) -> Mesh:
    """Reads a small mesh: OBJ, or PLY as bisque-simplify writes it."""
    mesh = _read_ply(path) if path.lower().endswith(".ply") else _read_obj(path)
    if mesh.faces is None or len(mesh.faces) == 0:
        raise ValueError(f"{path}: no faces")
    return mesh

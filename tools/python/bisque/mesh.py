"""Meshes in memory: what other libraries call a mesh, and small files that hold one."""
from __future__ import annotations

import contextlib
import numbers
import operator
import os
import re
import secrets
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


class Error(RuntimeError):
    """A failure: `status` is the exit code of sysexits(3) that the programs would have."""

    def __init__(self, status: int, message: str):
        super().__init__(message)
        self.status, self.message = status, message


def parse_bytes(size: int | str | None) -> int:
    """Returns the bytes of a size such as 1000000, "512M" or "1.5G"; 0 for None."""
    match = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([KMGT]?)(i?B)?", str(size or 0).strip(), re.IGNORECASE)
    found = float(match[1]) * 1024 ** " KMGT".index(match[2].upper() or " ") if match else -1
    if not 0 <= found < 2 ** 63:
        raise ValueError(f"memory: {size!r} is no size such as 512M or 2G")
    return int(found)


def parse_amount(name: str, value: Any) -> tuple[float, bool]:
    """Returns the number of an amount such as 5, "5" or "5%", and whether it is a percentage. Raises
    ValueError, which names it."""
    text = str(value).strip()
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = -1.0
    percent = text.endswith("%")
    if not 0 <= number < (100.000001 if percent else np.inf):
        raise ValueError(f"{name}: a number such as 5, or a percentage such as 5%, is needed, not {value!r}")
    return number, percent


#: The most texels of a side of a map.
TEXELS_MOST = 65536


def parse_texels(size: int | str) -> int:
    """Returns the texels of a side, such as 4096 or "4k". Raises ValueError."""
    match = re.fullmatch(r"([0-9]+)([kK]?)", size.strip()) if isinstance(size, str) else None
    if isinstance(size, str) and not match:
        raise ValueError(f"size: {size!r} is no number of texels such as 4096 or 4k")
    return check_number("size", int(match[1]) * (1024 if match[2] else 1) if match else size, 1, TEXELS_MOST)


def check_number(name: str, value: Any, least: int, most: int) -> int:
    """Returns a whole number within limits. Raises ValueError, which names it."""
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name}: a whole number is needed, not {value!r}") from None
    if not least <= number <= most:
        raise ValueError(f"{name}: a number from {least} to {most} is needed, not {number}")
    return number


def check_real(name: str, value: Any, least: float, most: float) -> None:
    """Refuses what is no number within limits, by ValueError, which names it."""
    if not isinstance(value, numbers.Real) or not least <= value <= most:  # also NaN
        raise ValueError(f"{name}: a number from {least:g} to {most:g} is needed, not {value!r}")


def check_triangles(value: Any, least: int) -> int | str:
    """Returns a number of triangles, of 20000, "20000" or "10%", which stays. Raises ValueError."""
    number, percent = parse_amount("triangles", value)
    if percent:
        return value
    return check_number("triangles", int(number) if number.is_integer() else value, least, 2 ** 32 - 1)


@dataclass
class Mesh:
    """A triangle mesh. `faces` index `vertices`; `uv_faces` and `normal_faces`, of the same shape,
    index `uvs` and `normals`. `report` says how the mesh was made. `texture`: an image of its colours, as
    Pillow's."""
    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    normals: np.ndarray | None = None
    normal_faces: np.ndarray | None = None
    colors: np.ndarray | None = None
    report: dict = field(default_factory=dict)
    texture: Any = None

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
        temporary = f"{os.fsdecode(path)}.{secrets.token_hex(4)}.new"  # a name that no file has
        try:
            with open(temporary, "w", encoding="utf-8") as file:
                file.writelines(lines)
            os.replace(temporary, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise OSError(error.errno, error.strerror, os.fspath(path)) from None


def is_path(thing: Any) -> bool:
    return isinstance(thing, (str, bytes, os.PathLike))


# ---- arrays of other libraries ----

def _rows(array: Any, columns: tuple[int, ...], what: str, kinds: str = "iuf") -> np.ndarray:
    """Returns an array of rows in the byte order of this machine. kinds: of numpy's types. Raises
    ValueError, which names the array."""
    try:
        array = np.asarray(array)
    except ValueError:
        raise ValueError(f"{what}: the rows are not all of one length") from None
    if array.ndim != 2 or array.shape[1] not in columns:
        raise ValueError(f"{what}: an array of {' or '.join(map(str, columns))} columns is needed, "
                         f"not one of the shape {array.shape}")
    if array.dtype.kind not in kinds:
        needed = "integers are" if kinds == "iu" else "an array of numbers is"
        raise ValueError(f"{what}: {needed} needed, not {array.dtype}")
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def _indices(array: Any, count: int, what: str, of: str) -> np.ndarray:
    """Returns rows of indices below `count`, each of three or four corners."""
    array = _rows(array, (3, 4), what, "iu")
    if array.size and (array.min() < 0 or array.max() >= count):
        row = int(np.flatnonzero(((array < 0) | (array >= count)).any(axis=1))[0])
        wrong = next(int(i) for i in array[row] if not 0 <= i < count)
        raise Error(65, f"{what}: row {row} refers to {of} {wrong}, and there are {count}")
    return array if array.itemsize in (4, 8) else array.astype(np.int64)


def _bytes_of_colors(array: Any, count: int) -> np.ndarray:
    """Returns colours as bytes: of bytes, of 16-bit numbers, or of 0 to 1."""
    array = _rows(array, (3, 4), "colors")
    if len(array) != count:
        raise ValueError(f"colors: one for each vertex is needed: {count}, not {len(array)}")
    if array.dtype == np.uint8 or not array.size:
        return array.astype(np.uint8, copy=False)
    least, most = float(array.min()), float(array.max())
    if array.dtype == np.uint16:
        return np.round(array / 257).astype(np.uint8)
    if array.dtype.kind == "f" and -1e-4 <= least and most <= 1.0001:  # NaN fails
        return np.round(np.clip(array, 0, 1) * 255).astype(np.uint8)
    if array.dtype.kind != "f" and 0 <= least and most <= 255:
        return array.astype(np.uint8)
    raise ValueError(f"colors: bytes, 16-bit numbers, or numbers from 0 to 1 are needed, not {array.dtype} "
                     f"from {least:g} to {most:g}")


def _halves(quads: np.ndarray | None) -> np.ndarray | None:
    """Splits rows of four corners into two triangles each; others stay."""
    if quads is None or quads.shape[1] == 3:
        return quads
    return np.ascontiguousarray(quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def checked(mesh: Mesh) -> Mesh:
    """Returns the mesh with arrays whose types, shapes and numbers fit together; quads become
    triangles. What needs no change is not copied. Raises ValueError or Error, which name the array."""
    vertices = _rows(mesh.vertices, (3,), "vertices")
    faces = _indices(mesh.faces, len(vertices), "faces", "vertex")
    uvs, uv_faces, normals = mesh.uvs, mesh.uv_faces, mesh.normals
    if uvs is not None:
        uvs = np.asarray(uvs)
        uvs = _rows(uvs.reshape(-1, 2) if uvs.ndim == 3 and uvs.shape[2] == 2 else uvs, (2,), "uvs")
        if not np.isfinite(uvs).all():
            raise ValueError("uvs: some numbers are not finite")
        if uv_faces is not None:
            uv_faces = _indices(uv_faces, len(uvs), "uv_faces", "uv")
        elif len(uvs) == len(vertices) != faces.size:
            uv_faces = faces
        elif len(uvs) == faces.size:
            uv_faces = np.arange(len(uvs)).reshape(faces.shape)
        else:
            raise ValueError(f"uvs: one for each vertex ({len(vertices)}) or for each corner "
                             f"({faces.size}) is needed, not {len(uvs)}")
    normal_faces = faces if mesh.normal_faces is mesh.faces else mesh.normal_faces
    if normals is not None:
        normals = _rows(normals, (3,), "normals")
        if normal_faces is not None and normal_faces is not faces:
            normal_faces = _indices(normal_faces, len(normals), "normal_faces", "normal")
        elif len(normals) != len(vertices):
            raise ValueError(f"normals: one for each vertex is needed: {len(vertices)}, not {len(normals)}")
    for what, rows in (("uv_faces", uv_faces), ("normal_faces", normal_faces)):
        if rows is not None and rows.shape != faces.shape:
            raise ValueError(f"{what}: the shape of faces, {faces.shape}, is needed, not {rows.shape}")
    colors = None if mesh.colors is None else _bytes_of_colors(mesh.colors, len(vertices))
    split = _halves(faces)
    return replace(mesh, vertices=vertices, faces=split, uvs=uvs, normals=normals, colors=colors,
                   uv_faces=split if uv_faces is faces else _halves(uv_faces),
                   normal_faces=split if normal_faces is faces else _halves(normal_faces))


def _from_open3d(thing: Any) -> Mesh:
    if hasattr(thing, "vertex"):  # open3d.t.geometry.TriangleMesh
        mesh = Mesh(thing.vertex["positions"].numpy(), thing.triangle["indices"].numpy())
        if "colors" in thing.vertex:
            mesh.colors = thing.vertex["colors"].numpy()
        if "texture_uvs" in thing.triangle:
            mesh.uvs = thing.triangle["texture_uvs"].numpy()
    else:
        mesh = Mesh(thing.vertices, thing.triangles)
        if len(getattr(thing, "vertex_colors", ())):
            mesh.colors = thing.vertex_colors
        if len(getattr(thing, "triangle_uvs", ())):
            mesh.uvs = thing.triangle_uvs
    return mesh


def _from_trimesh(thing: Any) -> Mesh:
    mesh = Mesh(thing.vertices, thing.faces)
    visual = getattr(thing, "visual", None)
    if getattr(visual, "uv", None) is not None:
        mesh.uvs = visual.uv
        material = getattr(visual, "material", None)
        images = (getattr(material, name, None) for name in ("image", "baseColorTexture"))
        mesh.texture = next((image for image in images if hasattr(image, "save")), None)
    elif getattr(visual, "kind", None) == "vertex":
        mesh.colors = visual.vertex_colors
    return mesh


def as_mesh(thing: Any) -> Mesh:
    """Takes a Mesh, a tuple (vertices, faces[, uvs]), a trimesh, a scene of these, or an Open3D mesh, or the path of an
    OBJ file or a PLY file of bisque-simplify. Arrays are copied only where checked() changes them.
    Raises TypeError, ValueError or Error."""
    if is_path(thing):
        return read_mesh(os.fsdecode(thing))
    if hasattr(thing, "geometry") and hasattr(thing, "to_mesh"):  # a trimesh.Scene, as of a GLB file
        thing = thing.to_mesh()
    if isinstance(thing, (tuple, list)) and any(hasattr(part, "vertices") for part in thing):
        raise TypeError("several meshes in memory: join them to one, such as by trimesh.util.concatenate()")
    if isinstance(thing, Mesh):
        mesh = thing
    elif isinstance(thing, (tuple, list)) and len(thing) in (2, 3) and not is_path(thing[0]):
        mesh = Mesh(*thing)
    elif hasattr(thing, "vertices") and hasattr(thing, "faces"):  # trimesh has triangles, too
        mesh = _from_trimesh(thing)
    elif hasattr(thing, "triangle") or (hasattr(thing, "triangles") and hasattr(thing, "vertices")):
        mesh = _from_open3d(thing)
    else:
        raise TypeError(f"no mesh, and no path of one: {type(thing).__name__}")
    return checked(mesh)


# ---- small files ----

#: The most bytes of a PLY file's header.
MOST_HEADER = 1 << 16


def ply_layout(path: str | os.PathLike) -> list[tuple[int, int, np.dtype]]:
    """Returns of the vertices and the triangles of a PLY file as bisque-simplify writes it: the byte at which they
    begin, how many there are, and what a row has. Raises Error, and KeyError for other PLY files."""
    types = {"float": "<f4", "double": "<f8", "uchar": "u1", "uint": "<u4", "int": "<i4"}
    with open(path, "rb") as file:
        header, end, _ = file.read(MOST_HEADER).partition(b"\nend_header\n")
        if not end:
            raise Error(65, f"{path}: its header does not end")
        words = [line.split() for line in header.decode("ascii").split("\n")]
        counts = {line[1]: int(line[2]) for line in words if line[:1] == ["element"]}
        columns = [(line[2], types[line[1]]) for line in words
                   if line[:1] == ["property"] and line[1] != "list"]
        if words[1][1] != "binary_little_endian" or ["vertex", "face"] != list(counts):
            raise KeyError("format")
        at, size, layout = len(header + end), os.fstat(file.fileno()).st_size, []
    for count, kind in ((counts["vertex"], np.dtype(columns)),
                        (counts["face"], np.dtype([("n", "u1"), ("v", "<u4", 3)]))):
        layout.append((at, count, kind))
        at += count * kind.itemsize
        if at > size or count < 0:
            raise Error(65, f"{path}: it ends before the last element")
    return layout


def _read_ply(path: str) -> Mesh:
    """Reads what bisque-simplify writes: positions, normals and triangles."""
    vertices, faces = (np.fromfile(path, kind, count, offset=at) for at, count, kind in ply_layout(path))
    if (faces["n"] != 3).any():
        raise KeyError("polygons")
    mesh = Mesh(np.stack([vertices[k] for k in "xyz"], axis=1), faces["v"].astype(np.int64))
    if set(("nx", "ny", "nz")) <= set(vertices.dtype.names):
        mesh.normals = np.stack([vertices[k] for k in ("nx", "ny", "nz")], axis=1)
        mesh.normal_faces = mesh.faces
    mesh = checked(mesh)
    # A vertex with several normals is there several times.
    mesh.vertices, which = np.unique(mesh.vertices, axis=0, return_inverse=True)
    mesh.faces = which.reshape(-1)[mesh.faces]
    return mesh


def _read_obj(path: str) -> Mesh:
    rows: dict[str, list] = {"v": [], "vt": [], "vn": []}
    needed = {"v": 3, "vt": 2, "vn": 3}
    corners: list[list] = []
    with open(path, encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            words = line.partition("#")[0].replace("_", "?").split()  # numbers of Python may have _
            try:
                if words and words[0] in rows:
                    numbers = [float(word) for word in words[1:1 + needed[words[0]]]]
                    if len(numbers) < needed[words[0]]:
                        raise ValueError
                    rows[words[0]].append(numbers)
                elif words and words[0] == "f":
                    face = [[int(i) - 1 if i and int(i) > 0 else len(of) + int(i) if i else None
                             for i, of in zip((word + "//").split("/"), rows.values())]
                            for word in words[1:]]
                    for k in range(1, len(face) - 1):
                        corners += [face[0], face[k], face[k + 1]]
            except ValueError:
                raise Error(65, f"{path}:{number}: not a line of an OBJ file: "
                                f"{line.strip()[:60]!r}") from None
    indices = [np.asarray([c[k] for c in corners], np.int64).reshape(-1, 3)
               if corners and all(c[k] is not None for c in corners) else None for k in range(3)]
    if indices[0] is None:
        other = "" if path.lower().endswith(".obj") else "; OBJ files are read here, and PLY files of bisque-simplify"
        raise Error(65, f"{path}: a corner has no vertex" if corners else f"{path}: no faces{other}")
    mesh = Mesh(np.asarray(rows["v"], float).reshape(-1, 3), indices[0])
    if indices[1] is not None:
        mesh.uvs, mesh.uv_faces = np.asarray(rows["vt"], float).reshape(-1, 2), indices[1]
    if indices[2] is not None:
        mesh.normals, mesh.normal_faces = np.asarray(rows["vn"], np.float32).reshape(-1, 3), indices[2]
    return checked(mesh)


def read_mesh(path: str) -> Mesh:
    """Reads a small mesh: OBJ, or PLY as bisque-simplify writes it. Raises Error."""
    try:
        mesh = _read_ply(path) if path.lower().endswith(".ply") else _read_obj(path)
    except OSError as error:
        raise Error(66, f"{path}: {error.strerror}") from None
    except (KeyError, IndexError, UnicodeDecodeError):
        raise Error(65, f"{path}: only PLY files of bisque-simplify are read here") from None
    except OverflowError:
        raise Error(65, f"{path}: a face refers to a line that there is not") from None
    except ValueError as error:
        raise Error(65, f"{path}: {error}") from None
    except Error as error:
        raise error if error.message.startswith(path) else Error(65, f"{path}: {error}") from None
    if len(mesh.faces) == 0:
        raise Error(65, f"{path}: no faces")
    if not np.isfinite(mesh.vertices).all():
        raise Error(65, f"{path}: some positions are not finite")
    return mesh

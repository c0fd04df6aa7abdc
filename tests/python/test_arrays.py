"""Arrays are checked at the door: what fits is the same mesh as its plain form, all else is refused by name."""
import errno
import types

import bisque
import numpy as np
import pytest
from conftest import sphere

POINTS, FACES = sphere(6, False)


def chunks(scan, folder):
    bisque.sort(scan, folder / "memory.tris")
    return (folder / "memory.tris").read_bytes()


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return chunks((POINTS, FACES), tmp_path_factory.mktemp("plain"))


def read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


@pytest.mark.parametrize("name, vertices, faces", [
    ("big-endian", POINTS.astype(">f8"), FACES.astype(">i4")),
    ("big-endian 64", POINTS.astype(">f8"), FACES.astype(">u8")),
    ("little-endian", POINTS.astype("<f8"), FACES.astype("<i8")),
    ("16-bit faces", POINTS, FACES.astype(np.int16)), ("big-endian 16-bit", POINTS, FACES.astype(">u2")),
    ("long double", POINTS.astype(np.longdouble), FACES), ("lists", POINTS.tolist(), FACES.tolist()),
    ("read-only", read_only(POINTS), read_only(FACES)),
    ("columns", np.asfortranarray(POINTS), np.asfortranarray(FACES)),
    ("backwards", POINTS[::-1].copy()[::-1], FACES[::-1].copy()[::-1]),
    ("gaps", np.repeat(POINTS, 2, axis=1)[:, ::2], np.repeat(FACES, 3, axis=1)[:, ::3])])
def test_arrays_of_all_layouts_are_one_mesh(name, vertices, faces, plain, tmp_path):
    assert chunks((vertices, faces), tmp_path) == plain


def test_quads_are_split(tmp_path):
    corners = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    quads = np.array([(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)])
    halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    assert chunks((corners, quads), tmp_path) == chunks((corners, halves), tmp_path)
    per_corner = bisque.mesh.as_mesh((corners, quads, np.tile([[0, 0], [1, 0], [1, 1], [0, 1]], (6, 1))))
    assert per_corner.faces.shape == per_corner.uv_faces.shape == (12, 3)
    assert (per_corner.uvs[per_corner.uv_faces[1]] == [[0, 0], [1, 1], [0, 1]]).all()


def test_colors_of_all_types_are_one_mesh(tmp_path):
    bytes_ = np.arange(3 * len(POINTS)).reshape(-1, 3).astype(np.uint8)
    forms = {"uint8": bytes_, "floats": bytes_ / 255, "16 bits": bytes_.astype(np.uint16) * 257,
             "big-endian 16 bits": (bytes_.astype(np.uint16) * 257).astype(">u2"), "int64": bytes_.astype(np.int64),
             "alpha": np.concatenate([bytes_, bytes_[:, :1]], axis=1), "float32": (bytes_ / 255).astype(">f4")}
    made = {name: chunks(bisque.Mesh(POINTS, FACES, colors=array), tmp_path) for name, array in forms.items()}
    assert len(set(made.values())) == 1


def test_normals_of_corners_are_those_of_a_file(tmp_path):
    """Some are given by faces of their own; colours come along."""
    normals = np.cross(*(POINTS[FACES[:, k]] - POINTS[FACES[:, 0]] for k in (1, 2)))
    mesh = bisque.Mesh(POINTS, FACES, normals=normals, normal_faces=np.arange(FACES.size).reshape(-1, 3) // 3)
    mesh.save(tmp_path / "file.obj")
    assert chunks(mesh, tmp_path) == chunks(tmp_path / "file.obj", tmp_path)
    smooth = bisque.Mesh(POINTS, FACES, normals=POINTS, colors=np.arange(POINTS.size).reshape(-1, 3).astype(np.uint8))
    expected = chunks(smooth, tmp_path)
    smooth.normal_faces = FACES.copy()
    assert chunks(smooth, tmp_path) == expected


MESH = bisque.Mesh
UVS = np.zeros((len(POINTS), 2))


@pytest.mark.parametrize("given, error, text", [
    ((POINTS[:, :2], FACES), ValueError, "vertices: .*3 columns"), ((POINTS.ravel(), FACES), ValueError, "vertices"),
    ((POINTS.astype(object), FACES), ValueError, "vertices: .*object"),
    ((POINTS.astype(complex), FACES), ValueError, "vertices"), ((POINTS.astype(str), FACES), ValueError, "vertices"),
    (([[0, 0, 0], [1, 0]], FACES), ValueError, "vertices: the rows"),
    ((POINTS, FACES.astype(float)), ValueError, "faces"),
    ((POINTS, FACES.astype(bool)), ValueError, "faces: integers"), ((POINTS, FACES[:, :2]), ValueError, "faces"),
    ((POINTS, np.concatenate([FACES, FACES[:, :2]], axis=1)), ValueError, "faces: .*5"),
    ((POINTS, FACES.ravel()), ValueError, "faces"), ((POINTS, np.zeros((0, 3), int)), bisque.Error, "faces"),
    ((np.zeros((0, 3)), np.zeros((0, 3), int)), bisque.Error, "faces"),
    ((np.zeros((0, 3)), FACES), bisque.Error, "faces: row 0 refers to vertex"),
    ((POINTS, FACES - 1), bisque.Error, "vertex -1"), ((POINTS, FACES + 1), bisque.Error, f"vertex {len(POINTS)}"),
    ((POINTS, FACES.astype(np.uint64) - np.uint64(1)), bisque.Error, "vertex 18446744073709551615"),
    (MESH(POINTS, FACES, colors=np.zeros((5, 3))), ValueError, "colors: one for each vertex"),
    (MESH(POINTS, FACES, colors=np.full((len(POINTS), 3), 200.0)), ValueError, "colors: .*float64"),
    (MESH(POINTS, FACES, colors=np.full((len(POINTS), 3), np.nan)), ValueError, "colors"),
    (MESH(POINTS, FACES, colors=np.full((len(POINTS), 3), 70000)), ValueError, "colors"),
    (MESH(POINTS, FACES, colors=np.zeros((len(POINTS), 2))), ValueError, "colors"),
    (MESH(POINTS, FACES, normals=POINTS[:-1]), ValueError, "normals: one for each vertex"),
    (MESH(POINTS, FACES, normals=POINTS[:5], normal_faces=FACES.copy()), bisque.Error, "normal_faces: row"),
    (MESH(POINTS, FACES, normals=POINTS[:, :2]), ValueError, "normals"),
    (MESH(POINTS, FACES, UVS, FACES[:5]), ValueError, "uv_faces: the shape"),
    (MESH(POINTS, FACES, UVS[:5], FACES.copy()), bisque.Error, "uv_faces: row"),
    ((POINTS, FACES, UVS[:7]), ValueError, "uvs: one for each"), ((POINTS, FACES, POINTS), ValueError, "uvs"),
    ((POINTS, FACES, UVS * np.nan), ValueError, "uvs: .*finite"), (42, TypeError, "int"), (None, TypeError, "NoneType"),
    ((POINTS,), TypeError, "tuple"),
    (types.SimpleNamespace(vertices=POINTS, triangles=FACES, vertex_colors=POINTS[:4]), ValueError, "colors")])
def test_what_is_wrong_is_refused_by_name(given, error, text, tmp_path):
    with pytest.raises(error, match=text) as caught:
        bisque.sort(given, tmp_path / "out.tris")
    assert error is not bisque.Error or caught.value.status == 65
    assert not (tmp_path / "out.tris").exists()


@pytest.mark.parametrize("how, text", [
    ({"memory": -5}, "memory"), ({"memory": "1.2.3G"}, "memory"), ({"memory": "-1G"}, "memory"),
    ({"memory": "9999999999T"}, "memory"), ({"threads": -1}, "threads"), ({"threads": 2 ** 40}, "threads"),
    ({"threads": 1.5}, "threads"), ({"ids": "nothing"}, "ids"), ({"texture": "a\0b"}, "'a.*b'")])
def test_numbers_out_of_range_are_refused_by_name(how, text, tmp_path):
    with pytest.raises(ValueError, match=f"{text}: "):
        bisque.sort((POINTS, FACES), tmp_path / "out.tris", **how)
    assert not (tmp_path / "out.tris").exists()


@pytest.mark.parametrize("call", [
    lambda: bisque.sort([], "a.tris"), lambda: bisque.voxelize((), "a.nvdb"), lambda: bisque.simplify([], triangles=9),
    lambda: bisque.bake([], "low.obj"), lambda: bisque.measure("low.obj", []), lambda: bisque.asset([], "a.glb"),
    lambda: bisque.tiles([], "tiles")])
def test_a_list_without_a_path_is_no_scan(call):
    with pytest.raises(ValueError, match="scan: a list without a path"):
        call()


def test_numbers_of_numpy_are_numbers(tmp_path):
    bisque.sort((POINTS, FACES), tmp_path / "out.tris", memory=np.int64(1 << 28), threads=np.uint8(1))
    with pytest.raises(ValueError, match="triangles: "):
        bisque.simplify((POINTS, FACES), triangles=-3)


def test_a_texture_in_memory_is_told(tmp_path):
    mesh = types.SimpleNamespace(vertices=POINTS, triangles=FACES, vertex_colors=[], textures=["an image of Open3D"])
    with pytest.warns(UserWarning, match="texture are not read"):
        bisque.sort(mesh, tmp_path / "out.tris")


PLY = (b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
       b"element face 1\nproperty list uchar uint vertex_indices\nend_header\n"
       + np.eye(3, dtype="<f4").tobytes() + b"\3" + np.arange(3, dtype="<u4").tobytes())
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\n"


def test_small_files_are_read_or_refused_at_every_length(tmp_path):
    """Cut after every byte, and damaged at every byte: a mesh, or one line that names the file."""
    for name, data in (("a.ply", PLY), ("a.obj", OBJ)):
        path = tmp_path / name
        path.write_bytes(data)
        whole = bisque.mesh.read_mesh(str(path))
        assert whole.faces.tolist() == [[0, 1, 2]] or name == "a.ply" and whole.faces.shape == (1, 3)
        damaged = [data[:n] for n in range(len(data))]
        damaged += [data[:n] + bytes([byte]) + data[n + 1:] for n in range(len(data)) for byte in (0, 57, 255)]
        damaged += [b"ply\n" + b"comment a\n" * 10 ** 5] * (name == "a.ply")
        refused = 0
        for content in damaged:
            path.write_bytes(content)
            try:
                mesh = bisque.mesh.read_mesh(str(path))
                assert mesh.faces.max() < len(mesh.vertices)
            except bisque.Error as error:
                assert error.status == 65 and str(path) in error.message, error
                refused += 1
        assert refused > len(data) / 2


def test_a_mesh_that_cannot_be_saved_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(bisque.mesh.secrets, "token_hex", lambda _: "0")
    (tmp_path / "a.obj.0.new").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left on device: .*a.obj'") as caught:
        bisque.Mesh(np.eye(3), np.arange(3)[None]).save(tmp_path / "a.obj")
    assert caught.value.errno == errno.ENOSPC and not list(tmp_path.iterdir())


def test_low_meshes_of_other_formats_are_told(tmp_path):
    (tmp_path / "a.glb").write_bytes(b"glTF\2\0\0\0")
    with pytest.raises(bisque.Error, match="a.glb: no faces; OBJ files are read here"):
        bisque.mesh.read_mesh(str(tmp_path / "a.glb"))


def test_a_texture_is_known_by_its_palette():
    from bisque.asset import _digest
    from PIL import Image

    images = [Image.new("P", (4, 4)) for _ in range(2)]
    for image, color in zip(images, ((255, 0, 0), (0, 0, 255))):
        image.putpalette(color)
    assert len({_digest(bisque.Mesh(POINTS, FACES, texture=image)) for image in images}) == 2


def test_numbers_that_only_python_has_are_refused(tmp_path):
    path = tmp_path / "a.obj"
    text = OBJ.decode()
    for word, wrong in (("v 1 0", "v 1_0 0"), ("2/2/1", "0_2/2/1"), ("3/3/1", f"{10 ** 30}/3/1")):
        path.write_text(text.replace(word, wrong))
        with pytest.raises(bisque.Error, match=str(path)) as caught:
            bisque.mesh.read_mesh(str(path))
        assert caught.value.status == 65
    path.write_text(text.replace("v 1 0 0", "v 1 0 0 # a_b"))
    assert len(bisque.mesh.read_mesh(str(path)).vertices) == 3


def test_indices_from_the_end_are_those_of_their_line(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n")
    assert bisque.mesh.read_mesh(str(path)).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_names_that_are_nearly_maps_are_told(scan, low):
    with pytest.raises(ValueError, match="no map 'normals'; the nearest is 'normal'"):
        bisque.bake(scan, low, ("normals",), size=16)
    with pytest.raises(bisque.Error, match="normals"):  # a channel, which the scan has not
        bisque.bake(scan, low, ("transfer:normals",), size=16)


def test_saved_png_files_are_those_of_a_bake(scan, low, tmp_path):
    from PIL import Image

    vertices, faces = scan
    colored = bisque.Mesh(vertices, faces, colors=(vertices - vertices.min()) / np.ptp(vertices))
    names = ("normal", "color", "mask", "ao")
    maps, baked = (bisque.bake(colored, low, names, size=64, format=kind) for kind in ("exr", "png"))
    saved = maps.save(tmp_path / "x_<MAP>.png")
    assert saved == [str(tmp_path / f"x_{name}.png") for name in maps.files]
    baked.save(tmp_path / "y_<MAP>.png")
    for name in names:
        a, b = (Image.open(tmp_path / f"{kind}_{name}.png") for kind in "xy")
        assert a.mode == b.mode and np.abs(np.asarray(a, int) - np.asarray(b, int)).max() <= 1, name
        depth, kind = ((tmp_path / f"{of}_{name}.png").read_bytes()[24:26] for of in "xy")
        assert depth == kind, name
    with pytest.raises(ValueError, match="map height was baked as exr"):
        bisque.bake(scan, low, ("normal", "height"), size=16).save(tmp_path / "z_<MAP>.png")
    assert not list(tmp_path.glob("z_*"))
    with pytest.raises(ValueError, match="was baked as png"):
        baked.save(tmp_path / "y_<MAP>.exr")


def test_a_scene_of_trimesh_is_its_meshes(plain, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene(trimesh.Trimesh(POINTS, FACES, process=False))
    assert chunks(scene, tmp_path) == plain
    with pytest.raises(TypeError, match="join them"):
        bisque.sort(list(scene.geometry.values()), tmp_path / "a.tris")
    mesh = trimesh.Trimesh(POINTS, FACES, process=False, face_colors=np.full((len(FACES), 4), 90, np.uint8))
    with pytest.warns(UserWarning, match="colours of faces are not read"):
        bisque.sort(mesh, tmp_path / "a.tris")


@pytest.mark.parametrize("name, call", [
    ("maps: names", lambda scan, low: bisque.bake(scan, low, 7)),
    ("maps: names", lambda scan, low: bisque.bake(scan, low, ["normal", 7])),
    ("size: texels, or", lambda scan, low: bisque.bake(scan, low, size=(16, 16, 16))),
    ("samples: a whole number", lambda scan, low: bisque.bake(scan, low, samples="x")),
    ("ao_spread: a number", lambda scan, low: bisque.bake(scan, low, ao_spread="x")),
    ("size: 'x'", lambda scan, low: bisque.unwrap(low, size="x")),
    ("size: 'x'", lambda scan, low: bisque.check_uvs(low, "x")),
    ("hard_angle: a number", lambda scan, low: bisque.asset(scan, "a.glb", hard_angle="2")),
    ("hard_angle: a number", lambda scan, low: bisque.simplify(scan, triangles=20, hard_angle=float("nan"))),
    ("resolution: a whole", lambda scan, low: bisque.voxelize(scan, "a.nvdb", resolution="64")),
    ("voxel_size: a number", lambda scan, low: bisque.voxelize(scan, "a.nvdb", voxel_size="1")),
    ("a.glb: its name", lambda scan, low: bisque.simplify(scan, "a.glb", triangles=20)),
    ("scale: a number", lambda scan, low: bisque.asset(scan, "a.glb", scale="2")),
    ("unwrap_seconds: a number", lambda scan, low: bisque.asset(scan, "a.glb", unwrap_seconds=None))])
def test_options_of_other_types_are_refused_by_name(name, call, scan, low):
    with pytest.raises(ValueError, match=name):
        call(scan, low)


def test_a_trimesh_brings_its_texture(scan, low, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    from PIL import Image

    vertices, faces = scan
    image = Image.fromarray(np.random.default_rng(2).integers(0, 255, (8, 8, 3), dtype=np.uint8), "RGB")
    uv = (vertices[:, :2] + 1.1) / 2.2
    for material in (trimesh.visual.material.SimpleMaterial(image=image),
                     trimesh.visual.material.PBRMaterial(baseColorTexture=image)):
        mesh = trimesh.Trimesh(vertices, faces, process=False,
                               visual=trimesh.visual.TextureVisuals(uv=uv, material=material))
        maps = bisque.bake(mesh, low, ("color",), size=64)
        bisque.Mesh(vertices, faces, uv, faces).save(tmp_path / "scan.obj")
        image.save(tmp_path / "scan.png")
        bisque.sort(tmp_path / "scan.obj", tmp_path / "scan.tris", texture=tmp_path / "scan.png")
        expected = bisque.bake(tmp_path / "scan.tris", low, ("color",), size=64)
        assert np.ptp(expected["color"]) > 0.5 and np.array_equal(maps["color"], expected["color"])
        bisque.sort(mesh, tmp_path / "mesh.tris")  # the image is in the file
        assert np.array_equal(bisque.bake(tmp_path / "mesh.tris", low, ("color",), size=64)["color"], maps["color"])
    checksums = set()
    for color in ((10, 20, 30), (30, 20, 10)):  # a repeated asset notices another texture
        mesh.visual.material.baseColorTexture = Image.new("RGB", (4, 4), color)
        bisque.asset(mesh, tmp_path / "a.glb", low=low, size=16, maps="color", keep=tmp_path / "k")
        checksums.add((tmp_path / "a_asset/color.png").read_bytes())
    assert len(checksums) == 2

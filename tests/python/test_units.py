"""What bisque-asset makes of scans as they come: any axes, units and winding, holes, pieces, hard edges."""
import json
import struct

import bisque
import numpy as np
import pytest
from bisque import place, repair
from conftest import certificate_of, judge, run_asset, sphere

SMALL = ("--size", 64, "--maps", "normal")


def glb_head(path):
    data = path.read_bytes()
    length, = struct.unpack("<I", data[12:16])
    assert struct.unpack("<I", data[8:12])[0] == len(data)
    return json.loads(data[20:20 + length])


def positions(path):
    """Returns the vertices of a GLB file where its node puts them, by a matrix of its quaternion."""
    import trimesh

    scene = trimesh.load(path, process=False)
    return np.asarray(scene.to_geometry().vertices)


def cuboid(sides, steps=12, noise=0.0):
    """Returns a box of these sides, from 0 on, as a scan: a grid on each face."""
    t = np.linspace(0, 1, steps + 1)
    u, v = np.meshgrid(t, t, indexing="ij")
    a = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).ravel()
    quads = np.stack([a, a + steps + 1, a + steps + 2, a + 1], axis=1)
    points, faces = [], []
    for axis in range(3):
        for side in (0, 1):
            grid = np.roll(np.stack([np.full_like(u, side), u, v], axis=2).reshape(-1, 3), axis, axis=1)
            faces.append((quads if side else quads[:, ::-1]) + sum(map(len, points)))
            points.append(grid)
    points, which = np.unique(np.concatenate(points).round(9), axis=0, return_inverse=True)
    quads = which.reshape(-1)[np.concatenate(faces)]
    points = points * sides + np.random.default_rng(3).normal(0, 1, points.shape) * noise
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def save(path, vertices, faces):
    bisque.Mesh(vertices, faces).save(path)
    return path


# ---- up and units ----

@pytest.mark.parametrize("up, expected", [
    ("x", lambda p: p[:, [1, 0, 2]] * [-1, 1, 1]), ("y", lambda p: p), ("z", lambda p: p[:, [0, 2, 1]] * [1, 1, -1]),
    ("-x", lambda p: p[:, [1, 0, 2]] * [1, -1, 1]), ("-y", lambda p: p * [1, -1, -1]),
    ("-z", lambda p: p[:, [0, 2, 1]] * [1, -1, 1])])
def test_the_glb_file_has_y_upwards_and_metres(up, expected, tmp_path):
    vertices, faces = cuboid([2000.0, 1000.0, 500.0])
    scan = save(tmp_path / "box.obj", vertices + [100, 200, 300], faces)
    done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 12, *SMALL, "--up", up, "--units", "mm", "--scale",
                     2)
    level = judge(done, tmp_path / "a.glb")["levels"][0]
    low = bisque.mesh.read_mesh(str(tmp_path / "a_asset/low.obj")).vertices  # as the scan is
    assert np.allclose(low.max(axis=0), [2100, 1200, 800], atol=1)
    placed, wanted = positions(tmp_path / "a.glb"), expected(low) * 0.002
    assert np.allclose(placed.min(axis=0), wanted.min(axis=0), atol=1e-5)
    assert np.allclose(placed.max(axis=0), wanted.max(axis=0), atol=1e-5)
    assert level["placement"]["metres_per_unit"] == 0.002 and level["placement"]["up"] == up
    assert level["placement"]["size_m"] == pytest.approx(np.ptp(wanted, axis=0))
    # An axis upwards is not mirrored: the faces still look outwards.
    import trimesh
    assert trimesh.load(tmp_path / "a.glb").to_geometry().volume == pytest.approx(8.0, rel=0.01)


@pytest.mark.parametrize("size, options, warned", [
    (51, (), True), (49, (), False), (0.0049, (), True), (0.0051, (), False), (51, ("--units", "m"), False),
    (51, ("--units", "mm"), False), (51, ("--scale", "1"), False)])
def test_a_size_that_is_doubtful_names_the_option(size, options, warned, tmp_path):
    scan = save(tmp_path / "box.obj", *cuboid([size, size / 2, size / 2]))
    done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 12, *SMALL, *options)
    certificate = judge(done, tmp_path / "a.glb")
    lines = [line for line in certificate["levels"][0]["warnings"] if "--units" in line]
    assert len(lines) == warned and all("box.obj" in line for line in lines)
    assert ("--units" in done.stderr) == warned


def test_files_with_units_are_not_doubted():
    assert place.name_of(["a.glb", "b.GLTF"]) is None
    assert place.name_of(["a.glb", "dir/b.stl.gz"]) == "b.stl.gz" and place.name_of([]) == "the scan"


def test_the_guessed_axis_is_named(tmp_path):
    vertices, faces = cuboid([2.0, 2.0, 3.0])
    vertices[:, :2] = (vertices[:, :2] - 1) * (1 - 0.3 * vertices[:, 2:])  # a pyramid that stands on z = 0
    scan = save(tmp_path / "pyramid.obj", vertices, faces)
    done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 60, *SMALL)
    assert judge(done, tmp_path / "a.glb")["levels"][0]["placement"]["preview_up"] == "z" and "--up z" in done.stdout
    for up in "yz":
        done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 60, *SMALL, "--up", up)
        assert judge(done, tmp_path / "a.glb")["levels"][0]["placement"]["preview_up"] == up
        assert "--up" not in done.stdout


def test_lengths_have_units(tmp_path):
    parse = place.parse_length
    assert parse("error", "0.2mm", 1) == pytest.approx(0.0002) and parse("error", "1 in", 0.001) == pytest.approx(25.4)
    assert parse("error", "2m", 0.01) == 200 and parse("error", "3", 0.001) == 3 and parse("error", "1%", 1) == "1%"
    for wrong in ("x", "mm", "-1mm", "1ft", "nan", "-1", "101%"):
        with pytest.raises(ValueError, match="error: "):
            parse("error", wrong, 1)
    scan = save(tmp_path / "ball.obj", *sphere(40, True))
    most = {}
    for error in ("2mm", "0.5mm"):
        done = run_asset(scan, "-o", tmp_path / "a.glb", "--error", error, *SMALL, "--units", "cm")
        level = judge(done, tmp_path / "a.glb")["levels"][0]
        most[error] = level["triangles"]
        limit = float(error[:-2]) / 10  # in centimetres
        assert max(level["distance"][key]["max"] for key in ("from_scan", "from_mesh")) <= limit
    assert most["2mm"] < most["0.5mm"]


def test_shares_of_the_scan():
    scan = sphere(30, True)
    low = bisque.simplify(scan, triangles="10%")
    assert low.report["target"] == len(scan[1]) // 10
    low = bisque.simplify(scan, error="1%")
    assert max(low.report[key]["max"] for key in ("from_scan", "from_mesh")) <= 0.01 * low.report["diagonal"]
    for wrong in ({"triangles": "x"}, {"triangles": 2}, {"error": "-1"}, {"triangles": 100, "min_component": "101%"},
                  {"triangles": 100, "min_triangles": -1}, {}):
        with pytest.raises(ValueError, match=next(reversed(wrong), "either")):
            bisque.simplify(scan, **wrong)


# ---- winding ----

def turned(faces, which):
    faces = faces.copy()
    faces[which] = faces[which][:, ::-1]
    return faces


@pytest.mark.parametrize("kind", ["all", "a tenth", "half", "a side", "open"])
def test_scans_that_are_wound_wrong(kind, tmp_path):
    vertices, faces = sphere(60, True)
    middle, draw = vertices[faces].mean(axis=1), np.random.default_rng(5).random(len(faces))
    which = {"all": draw < 2, "a tenth": draw < 0.1, "half": draw < 0.5, "a side": middle[:, 0] > 0.2, "open": draw < 2}
    kept = middle[:, 2] < (0.95 if kind == "open" else 9)
    scan = save(tmp_path / "ball.obj", vertices, turned(faces, which[kind])[kept])
    level = judge(run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 1000, *SMALL[:2], "--maps", "normal,ao"),
                  tmp_path / "a.glb")["levels"][0]
    p = bisque.mesh.read_mesh(str(tmp_path / "a_asset/low.obj"))
    corners = p.vertices[p.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = (normals * corners.mean(axis=1)).sum(axis=1)
    assert (outward > 0).mean() > (0.99 if kind == "half" else 0.999)
    assert level["rays"]["misses"] < 0.001 * level["rays"]["samples"]
    assert level["normal_error"]["mean"] < (0.8 if kind == "half" else 0.5)
    assert level["mesh"]["two_sided"] and any("both sides" in line for line in level["warnings"])
    if kind in ("all", "open"):
        assert level["mesh"]["turned_share"] == 1 and any("--winding keep" in line for line in level["warnings"])
        done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 1000, *SMALL, "--winding", "keep")
        assert judge(done, tmp_path / "a.glb")["levels"][0]["mesh"]["two_sided"] is False


def test_scans_that_are_wound_right_stay(tmp_path):
    points, faces = sphere(40, True)
    inner = np.concatenate([points, 0.5 * points])  # a hollow ball, whose inner wall looks inwards
    hollow = np.concatenate([faces, faces[:, ::-1] + len(points)])
    sheet = faces[(points[:, 2] > 0.6)[faces].all(axis=1)]
    scans = {"ball": (points, faces), "hollow": (inner, hollow),
             "bowl": (points, sheet), "dish": (points, sheet[:, ::-1])}
    for name, scan in scans.items():
        low = bisque.simplify(scan, triangles=400)
        mesh, report = repair.orient(low, {})
        assert mesh is low and not report["turned_faces"] and not report["turned_pieces"], name
        assert report["pieces"] == 1 + (name == "hollow")


def test_inner_walls_turn_with_the_others():
    points, faces = sphere(40, True)
    both = np.concatenate([faces, faces[:, ::-1] + len(points)])[:, ::-1]
    low = bisque.simplify((np.concatenate([points, 0.9 * points]), both), triangles=800)
    mesh, report = repair.orient(low, {})
    assert report["turned_pieces"] == 2 and np.array_equal(mesh.faces, low.faces[:, ::-1])
    # One shell inside out beside one that is not: the inner walls stay.
    apart = np.concatenate([points, 0.9 * points, points + [3, 0, 0]])
    low = bisque.simplify((apart, np.concatenate([both, faces + 2 * len(points)])), triangles=800)
    assert repair.orient(low, {})[1]["turned_pieces"] == 1


def test_a_strip_of_moebius_shows_both_sides(tmp_path):
    t = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    w = np.linspace(-0.3, 0.3, 9)
    a, b = np.meshgrid(t, w, indexing="ij")
    r = 1 + b * np.cos(a / 2)
    points = np.stack([r * np.cos(a), r * np.sin(a), b * np.sin(a / 2)], axis=2)
    quads = []
    for i in range(120):
        for j in range(8):
            n, m = (i + 1) % 120, (lambda k, i=i: 8 - k if i == 119 else k)
            quads.append([i * 9 + j, n * 9 + m(j), n * 9 + m(j + 1), i * 9 + j + 1])
    quads = np.array(quads)
    scan = points.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    with pytest.warns(UserWarning, match="Moebius"):
        level = bisque.asset(scan, tmp_path / "a.glb", triangles=400, size=64, maps="normal")["levels"][0]
    assert level["mesh"]["double_sided"] and level["mesh"]["two_sided"]
    assert all(material["doubleSided"] for material in glb_head(tmp_path / "a.glb")["materials"])
    assert level["rays"]["misses"] < 0.001 * level["rays"]["samples"]


def test_normals_against_the_winding_are_named(tmp_path):
    vertices, faces = sphere(40, True)
    mesh = bisque.Mesh(vertices, faces, normals=-vertices.astype(np.float32))
    with pytest.warns(UserWarning, match="vertex normals of the scan that look away"):
        bisque.asset(mesh, tmp_path / "a.glb", triangles=400, size=64, maps="normal")


# ---- hard edges ----

def test_boxes_keep_hard_edges(tmp_path):
    scan = save(tmp_path / "box.obj", *cuboid([2.0, 1.0, 0.5], 30, noise=0.002))
    out = tmp_path / "a.glb"
    level = judge(run_asset(scan, "-o", out, "--triangles", 60, *SMALL), out)["levels"][0]
    low = bisque.mesh.read_mesh(str(tmp_path / "a_asset/low.obj"))
    p = low.vertices[low.faces]
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    lean = np.degrees(np.arccos((low.normals[low.normal_faces] * flat[:, None]).sum(axis=2).clip(-1, 1)))
    assert level["mesh"]["hard_edges"] >= 12 and lean.max() < 8
    # Edges that are hard are seams: their ends have other texture coordinates in each face.
    pairs, same, _ = repair.edge_pairs(low.faces)
    normals = flat[pairs[:, 0] // 3], flat[pairs[:, 1] // 3]
    hard = pairs[(repair._angles(*normals) > 60) & ~same]
    uvs = low.corner_uvs().reshape(-1, 2)
    following = hard - hard % 3 + (hard + 1) % 3
    apart = (uvs[hard[:, 0]] != uvs[following[:, 1]]) | (uvs[following[:, 0]] != uvs[hard[:, 1]])
    assert len(hard) >= 12 and apart.any(axis=1).all()
    smooth = judge(run_asset(scan, "-o", out, "--triangles", 60, *SMALL, "--hard-angle", 180), out)["levels"][0]
    assert smooth["mesh"]["hard_edges"] == 0 and smooth["normal_error"]["mean"] > level["normal_error"]["mean"]


def test_round_scans_have_no_hard_edges():
    """A ball of 60 triangles has edges of up to 45 degrees, which the scan has not."""
    scan = sphere(60, False)
    low = bisque.simplify(scan, triangles=60)
    with bisque.core.Job() as job:
        chunks = job.temporary("scan.tris")
        bisque.sort(scan, chunks)
        pairs, hard, report = repair.look(low, chunks, 20, 0.1, {})
    normals = repair.face_normals(low)[0]
    assert (repair._angles(normals[pairs[:, 0] // 3], normals[pairs[:, 1] // 3]) > 20).sum() > 40
    assert report["hard_edges"] == 0 == len(hard) and not report["two_sided"]


# ---- pieces and holes ----

def test_small_pieces_are_dropped_and_counted(tmp_path):
    points, faces = sphere(20, False)
    few = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]) + 2
    vertices = np.concatenate([points, 0.02 * points + 3, few])
    four = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    faces = np.concatenate([faces, faces + len(points), four + 2 * len(points)])
    scan = save(tmp_path / "ball.obj", vertices, faces)
    for options, pieces in (((), 3), (("--min-component", "2%"), 2), (("--min-triangles", 5), 2),
                            (("--min-component", 2, "--min-triangles", 5), 1)):
        done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 400, *SMALL, *options)
        certificate = judge(done, tmp_path / "a.glb")
        level = certificate["levels"][0]
        assert level["mesh"]["pieces"] == pieces and level["removed"]["pieces"] == 3 - pieces, options
        given = dict(zip(options[::2], options[1::2]))
        assert certificate["options"]["min_triangles"] == given.get("--min-triangles", 0)


def test_holes_are_closed_up_to_a_size(tmp_path):
    vertices, faces = sphere(40, False)
    middle = vertices[faces].mean(axis=1)
    small, large = middle[:, 2] > 0.98, middle[:, 0] > 0.7  # 0.4 and 1.4 across
    low = bisque.simplify((vertices, faces[~(small | large)]), triangles=600)
    for size, closed in ((0.01, 0), (0.8, 1), (9, 2)):
        mesh, count = repair.close_holes(low, size)
        border = repair.edge_pairs(mesh.faces)[2]
        assert count == closed and (len(border) == 0) == (closed == 2)
        assert not repair.edge_pairs(mesh.faces)[1].any()  # wound as their neighbours
    p = mesh.vertices[mesh.faces]
    volume = (p[:, 0] * np.cross(p[:, 1], p[:, 2])).sum() / 6
    caps = 1 - np.array([0.7, 0.98])
    assert volume == pytest.approx(4 / 3 * np.pi - sum(np.pi * h * h * (3 - h) / 3 for h in caps), rel=0.03)
    scan = save(tmp_path / "ball.obj", vertices, faces[~small])
    done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 300, *SMALL, "--close-holes", "80cm")
    level = judge(done, tmp_path / "a.glb")["levels"][0]
    assert level["mesh"]["closed_holes"] == 1 and 0.15 < level["distance"]["from_mesh"]["max"] < 0.25


def test_more_triangles_than_asked_for_are_told(tmp_path):
    frame = np.array([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0], [1, 1, 0], [2, 1, 0], [2, 2, 0], [1, 2, 0.0]])
    quads = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
    with pytest.warns(UserWarning, match="6 triangles instead of 4: "):
        bisque.simplify((frame, quads), triangles=4)


def test_a_scan_without_colours_is_grey(tmp_path):
    certificate = bisque.asset(sphere(20, True), tmp_path / "a.glb", triangles=200, size=64)
    assert certificate_of(tmp_path / "a.glb")["levels"] == json.loads(json.dumps(certificate["levels"], default=float))
    material, = glb_head(tmp_path / "a.glb")["materials"]
    factor = material["pbrMetallicRoughness"]["baseColorFactor"]
    assert factor[0] == factor[1] == factor[2] < 0.7 and factor[3] == 1
    assert f"Kd {factor[0]:g} {factor[0]:g} {factor[0]:g}" in (tmp_path / "a_asset/low.mtl").read_text()

"""3D Tiles of a sphere with waves, whose surface a formula gives: files, errors, borders and pictures."""
import fcntl
import hashlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import types
from collections import Counter
from pathlib import Path

import bisque
import jsonschema
import numpy as np
import pytest
import referencing
import trimesh
from bisque.asset import PUBLISHED
from bisque.steps import Folder
from bisque.uv import extend_charts
from conftest import HEIGHT, RADIUS, command_of, run_asset, sphere
from PIL import Image

SCHEMAS = Path(__file__).parent / "schema-3d-tiles"
LIMIT, SIZE = 300, 128
OPTIONS = {"tile_triangles": LIMIT, "triangles": 4000, "size": SIZE, "samples": 1}
WORDS = ["--tiles", "--tile-triangles", LIMIT, "--triangles", 4000, "--size", SIZE, "--samples", 1]


def color_at(direction):
    """Returns the colour of a direction, as linear functions that no texel can hide a seam in."""
    return np.clip(127 + 100 * direction, 0, 255)


def coloured():
    points, faces = sphere(60, True)
    colors = color_at(points / np.linalg.norm(points, axis=1)[:, None]).round().astype(np.uint8)
    return bisque.Mesh(points, faces, colors=colors)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiles") / "out"
    certificate = bisque.tiles(coloured(), folder, **OPTIONS)
    return folder, certificate, json.loads((folder / "tileset.json").read_text())


def nodes_of(node, parent=None):
    yield node, parent
    for child in node.get("children", ()):
        yield from nodes_of(child, node)


def read_tile(folder, tile):
    """Reads a tile with a reader of its own. Returns positions, normals, tangents, texture coordinates, triangles
    without those of its skirt, all triangles, and its images."""
    data = (folder / tile["file"]).read_bytes()
    length = int.from_bytes(data[12:16], "little")
    head, body = json.loads(data[20:20 + length]), data[28 + length:]

    def view(number):
        where = head["bufferViews"][number]
        return body[where["byteOffset"]:where["byteOffset"] + where["byteLength"]]

    primitive = head["meshes"][0]["primitives"][0]
    where = [head["accessors"][i]["bufferView"] for i in (primitive["attributes"]["POSITION"], primitive["indices"])]
    rows = np.frombuffer(view(where[0]), "<f4").reshape(-1, 12)
    faces = np.frombuffer(view(where[1]), "<u4").reshape(-1, 3).astype(int)
    images = [np.asarray(Image.open(io.BytesIO(view(image["bufferView"]))).convert("RGB"), float)
              for image in head["images"]]
    return {"p": rows[:, :3].astype(float), "n": rows[:, 3:6].astype(float), "t": rows[:, 6:10].astype(float),
            "uv": rows[:, 10:].astype(float), "faces": faces[:tile["triangles"]], "all": faces, "images": images,
            "head": head}


@pytest.fixture(scope="module")
def read(made):
    folder, certificate, _ = made
    return {name: read_tile(folder, tile) for name, tile in certificate["tiles"].items()}


def of_level(certificate, level):
    return [name for name, tile in certificate["tiles"].items() if tile["level"] == level]


# ---- files ----

def test_tileset_is_what_the_schema_says(made):
    _, _, tileset = made

    def retrieve(uri):
        return referencing.Resource.from_contents(json.loads((SCHEMAS / uri.removeprefix("mem:///")).read_text()))

    registry = referencing.Registry(retrieve=retrieve)
    validator = jsonschema.Draft202012Validator({"$ref": "mem:///tileset.schema.json"}, registry=registry)
    assert list(validator.iter_errors(tileset)) == []
    less = {key: value for key, value in tileset["root"].items() if key != "geometricError"}
    assert list(validator.iter_errors({**tileset, "root": less})) != []


def test_files_are_those_of_the_certificate(made):
    folder, certificate, tileset = made
    sums = certificate["levels"][0]["files"]
    assert {path.name for path in folder.iterdir()} == {*sums, "tiles.json"}
    for name, checksum in sums.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == checksum
    assert {node["content"]["uri"] for node, _ in nodes_of(tileset["root"])} == {
        tile["file"] for tile in certificate["tiles"].values()}
    assert len(certificate["tiles"]) > 12 and certificate["tiles"]["0_1"]["file"] == tileset["root"]["content"]["uri"]


def test_page_has_all_that_it_needs(made, monkeypatch, tmp_path):
    module = sys.modules["bisque.tileset"]
    for name in module.SCRIPTS:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"/* {name} */")
    monkeypatch.setattr(module, "THREE", tmp_path)
    assert module.make_page(tmp_path / "index.html")
    page = (tmp_path / "index.html").read_text()
    assert all(f"<script>/* {name} */</script>" in page for name in module.SCRIPTS)
    assert "<!--scripts-->" not in page and "src=" not in page
    (tmp_path / module.SCRIPTS[0]).unlink()
    assert not module.make_page(tmp_path / "none.html") and not (tmp_path / "none.html").exists()


def test_boxes_contain_content_and_errors_fall(made):
    folder, certificate, tileset = made
    count = 0
    for node, parent in nodes_of(tileset["root"]):
        mesh = trimesh.load(folder / node["content"]["uri"], force="mesh", process=False)
        points = mesh.vertices @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # y-up to z-up: (x, -z, y)
        assert parent is None or node["geometricError"] < parent["geometricError"]
        while node is not None:  # also the boxes of all tiles above
            box = np.array(node["boundingVolume"]["box"])
            assert (np.abs(points - box[:3]) - [box[3], box[7], box[11]]).max() < 1e-6
            node = next(p for n, p in nodes_of(tileset["root"]) if n is node)
            count += 1
    assert count > len(certificate["tiles"]) and tileset["geometricError"] > tileset["root"]["geometricError"]
    for tile in certificate["tiles"].values():
        assert 0 < tile["triangles"] <= LIMIT
        assert b"image/jpeg" in (folder / tile["file"]).read_bytes() and "color" in tile["packed"]["images"]


@pytest.mark.parametrize("geometry", ["meshopt", "draco"])
def test_packed_tiles_stay_in_their_boxes_and_errors(made, tmp_path, geometry):
    _, plain, _ = made
    certificate = bisque.tiles(coloured(), tmp_path / "out", geometry=geometry, **OPTIONS)
    tileset = json.loads((tmp_path / "out" / "tileset.json").read_text())
    for node, parent in nodes_of(tileset["root"]):
        tile = certificate["tiles"][node["content"]["uri"].removesuffix(".glb")]
        mesh = sys.modules["bisque.glb"].surface(sys.modules["bisque.glb"].Glb(tmp_path / "out" / tile["file"]))
        points = mesh.vertices @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
        box = np.array(node["boundingVolume"]["box"])
        assert (np.abs(points - box[:3]) - [box[3], box[7], box[11]]).max() < 1e-9
        assert parent is None or node["geometricError"] < parent["geometricError"]
        before = plain["tiles"][tile["file"].removesuffix(".glb")]
        lost = tile["packed"]["geometry"]["distance"]
        assert 0 < lost < 1e-4 and tile["geometric_error"] >= max(
            before[key]["max"] for key in ("from_scan", "from_mesh")) + lost
        assert tile["packed"]["bytes"] < tile["packed"]["bytes_before"]
        assert np.abs(mesh.vertices.min(axis=0) - before["low"]).max() < 1e-4


def tree_of(pid):
    """Yields a process and those that it and its children have started."""
    yield pid
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = path.read_text().split()
        except OSError:  # it has ended
            continue
        for child in children:
            yield from tree_of(child)


def anonymous_bytes(pid):
    """Returns a process's share of anonymous memory, as a child has all of its parent's until it becomes a program."""
    try:
        return 1024 * int(re.search(r"Pss_Anon:\s+(\d+)", Path(f"/proc/{pid}/smaps_rollup").read_text())[1])
    except (OSError, TypeError):  # it has ended
        return 0


def test_all_processes_together_stay_within_memory(tmp_path):
    """Also where one thread for each tile packs it."""
    points, faces = sphere(220, True)
    rows = np.zeros(len(points), [("p", "<f4", 3), ("c", "u1", 3)])
    rows["p"], rows["c"] = points, color_at(points / np.linalg.norm(points, axis=1)[:, None])
    corners = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    corners["n"], corners["v"] = 3, faces
    properties = "".join(f"property float {name}\n" for name in "xyz") + "".join(
        f"property uchar {name}\n" for name in ("red", "green", "blue"))
    (tmp_path / "scan.ply").write_bytes(
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}element face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n".encode() + rows.tobytes() + corners.tobytes())
    process = subprocess.Popen(command_of([
        tmp_path / "scan.ply", "-o", tmp_path / "out", "--tiles", "--tile-triangles", 2000, "--triangles", 30000, "--size",
        256, "--samples", 1, "--geometry", "meshopt", "--memory", "192M", "--threads", 8]), stdout=subprocess.DEVNULL)
    most = 0
    while process.poll() is None:
        most = max(most, sum(map(anonymous_bytes, tree_of(process.pid))))
        time.sleep(0.02)
    assert process.returncode == 0
    assert 32 << 20 < most <= 192 << 20


# ---- errors ----

def distance_to_triangles(points, corners):
    """Returns the distance of each point from the closest of some triangles (Ericson, "Real-Time Collision
    Detection", 2005, 5.1.5), without any tree."""
    a, b, c = (corners[:, k] for k in range(3))
    ab, ac = b - a, c - a
    found = np.empty(len(points))
    for i, p in enumerate(points):
        least = np.full(len(a), np.inf)
        for begin, along in ((a, ab), (a, ac), (b, c - b)):
            share = (((p - begin) * along).sum(1) / np.maximum((along ** 2).sum(1), 1e-300)).clip(0, 1)
            least = np.minimum(least, np.linalg.norm(p - begin - share[:, None] * along, axis=1))
        normal = np.cross(ab, ac)
        square = (normal ** 2).sum(1)
        w1 = (np.cross(p - a, ac) * normal).sum(1) / square
        w2 = (np.cross(ab, p - a) * normal).sum(1) / square
        over = (w1 >= 0) & (w2 >= 0) & (w1 + w2 <= 1)
        height = np.abs(((p - a) * normal).sum(1)) / np.sqrt(square)
        found[i] = min(least.min(), height[over].min(initial=np.inf))
    return found


def spread(rng, corners, count):
    """Returns points in triangles, which are chosen by their areas."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return chosen[:, 0] * (1 - u - v) + chosen[:, 1] * u + chosen[:, 2] * v


def scan_points(rng, count):
    """Returns the corners of the scan's triangles, and points in them."""
    scan = coloured()
    corners = np.asarray(scan.vertices)[scan.faces]
    return corners, spread(rng, corners, count)


def triangles_of(read, names):
    """Returns the corners of all triangles of tiles."""
    return np.concatenate([read[name]["p"][read[name]["faces"]] for name in names])


def region_of(tile):
    low, high = tile["region"]
    return (np.array([-np.inf if x is None else x for x in low]), np.array([np.inf if x is None else x for x in high]))


def test_no_point_is_farther_than_the_errors(made, read):
    _, certificate, _ = made
    rng = np.random.default_rng(5)
    corners, points = scan_points(rng, 150)
    for level in range(len(certificate["meshes"])):
        names = of_level(certificate, level)
        distances = distance_to_triangles(points, triangles_of(read, names))
        found = np.zeros(len(points), int)
        for name in names:
            low, high = region_of(certificate["tiles"][name])
            inside = ((points >= low) & (points <= high)).all(axis=1)
            found += inside
            assert distances[inside].max(initial=0) <= certificate["tiles"][name]["geometric_error"] + 1e-6
            back = distance_to_triangles(spread(rng, triangles_of(read, [name]), 6), corners)
            assert back.max() <= certificate["tiles"][name]["geometric_error"] + 1e-6
        assert (found >= 1).all()  # regions leave no gap
        # The bound is no more than it has to be: a level's error is close to what some point of it shows.
        assert certificate["meshes"][level]["from_scan"]["max"] < 6 * distances.max() + 1e-3


def test_figures_of_a_tile_are_those_of_its_region(made, read):
    _, certificate, _ = made
    rng = np.random.default_rng(11)
    corners, points = scan_points(rng, 2500)
    names = of_level(certificate, 1)
    distances = distance_to_triangles(points, triangles_of(read, names))
    for name in names:
        tile = certificate["tiles"][name]
        low, high = region_of(tile)
        mine = distances[((points >= low) & (points < high)).all(axis=1)]
        assert len(mine) > 300
        back = distance_to_triangles(spread(rng, triangles_of(read, [name]), 200), corners)
        for key, sample, close in (("from_scan", mine, 0.15), ("from_mesh", back, 0.3)):
            figures = tile[key]
            assert abs(figures["mean"] / sample.mean() - 1) < close
            assert abs(figures["rms"] / np.sqrt((sample ** 2).mean()) - 1) < close
            assert np.quantile(sample, 0.95) < figures["p99"] * 1.05 and figures["p99"] <= figures["max"]
            assert figures["max"] <= tile["geometric_error"]


# ---- borders ----

def border_of(tile):
    """Returns the ends of the edges that only one triangle has, by positions."""
    p = tile["p"][tile["faces"]]
    edges = np.stack([p, np.roll(p, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    forward = {(tuple(a), tuple(b)) for a, b in edges}
    assert len(forward) == len(edges)
    return np.array([[a, b] for a, b in forward if (b, a) not in forward])


def test_tiles_of_a_level_share_their_borders(made, read):
    _, certificate, _ = made
    for level in range(1, len(certificate["meshes"])):
        names = of_level(certificate, level)
        borders = {name: border_of(read[name]) for name in names}
        normals, same, total = {}, 0, 0
        for name in names:
            for p, n in zip(read[name]["p"], read[name]["n"]):
                normals.setdefault(tuple(p), []).append((name, n))
        for name in names:
            others = np.concatenate([borders[other] for other in names if other != name])
            points = np.unique(borders[name][:, 0], axis=0)
            along = others[:, 1] - others[:, 0]
            for p in points:  # the sphere has no border of its own
                share = (((p - others[:, 0]) * along).sum(1) / (along ** 2).sum(1)).clip(0, 1)
                assert np.linalg.norm(p - others[:, 0] - share[:, None] * along, axis=1).min() < 1e-6
                shared = [n for other, n in normals[tuple(p)] if other != name]
                own = [n for other, n in normals[tuple(p)] if other == name]
                same += bool(shared)
                total += 1
                for n in shared:
                    assert (n == own[0]).all()
        assert same > 0.9 * total  # others are where a plane ends at another one


def look_up(image, uv):
    """Filters an image bilinearly."""
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[:, None], (y - j)[:, None]

    def texel(j, i):
        return image[j.clip(0, height - 1), i.clip(0, width - 1)]

    return ((texel(j, i) * (1 - fx) + texel(j, i + 1) * fx) * (1 - fy) +
            (texel(j + 1, i) * (1 - fx) + texel(j + 1, i + 1) * fx) * fy)


def test_tiles_of_a_level_look_alike_at_their_borders(made, read):
    _, certificate, _ = made
    seen = {}
    for name in of_level(certificate, len(certificate["meshes"]) - 1):
        tile = read[name]
        used = np.unique(tile["faces"])
        color, normal = (look_up(image, tile["uv"][used]) for image in tile["images"])
        normal = normal / 127.5 - 1
        n, t = tile["n"][used], tile["t"][used]
        b = np.cross(n, t[:, :3]) * t[:, 3:]
        normal = normal[:, :1] * t[:, :3] + normal[:, 1:2] * b + normal[:, 2:] * n
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        for p, c, d in zip(tile["p"][used], color, normal):
            seen.setdefault(tuple(p), {}).setdefault(name, []).append((c, d))
    colors, cosines = [], []
    for tiles in (list(tiles.values()) for tiles in seen.values() if len(tiles) > 1):
        colors.append(np.abs(tiles[0][0][0] - tiles[1][0][0]).mean())
        cosines.append(tiles[0][0][1] @ tiles[1][0][1])
    assert len(colors) > 100
    assert np.mean(colors) < 1  # of 255
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean() < 2


def test_strips_around_charts_go_on_as_their_triangles_do():
    u, v = (side.ravel() for side in np.meshgrid([0.2, 0.4, 0.6, 1.0], [0.0, 0.4, 0.7], indexing="ij"))
    uvs, across = np.stack([u, v], axis=1), np.array([[2.0, 0, 1], [0, 3, -1]])
    corner = np.array([[i * 3 + j, i * 3 + 3 + j, i * 3 + 4 + j, i * 3 + 1 + j] for i in range(3) for j in range(2)])
    faces = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    mesh = bisque.Mesh(uvs @ across, faces, uvs, faces, np.tile([-1 / 2, 1 / 3, 1], (12, 1)), faces)
    found = extend_charts(mesh, 100)
    assert (found.faces[:12] == faces).all() and len(found.faces) == 12 + 2 * 10  # ten edges are at the border
    assert np.abs(found.vertices - found.uvs @ across).max() < 1e-12
    assert np.abs(found.normals - mesh.normals[0]).max() < 1e-12
    # As wide as one and a half texels, but not beyond the map.
    assert np.allclose([found.uvs.min(axis=0), found.uvs.max(axis=0)], [[0.185, 0], [1, 0.715]])
    a, b = (found.uvs[found.uv_faces[:, k]] - found.uvs[found.uv_faces[:, 0]] for k in (1, 2))
    areas = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    # Its area, and that of the rectangle around it that is within the map.
    assert np.allclose([areas[:12].sum() / 2, np.abs(areas).sum() / 2], [0.8 * 0.7, 0.815 * 0.715])


# ---- pictures ----

def covered(meshes, axes, side, skirts):
    """Draws the front sides of tiles along an axis. Returns the pixels that show any, in a square from -1.1 to 1.1."""
    shown = np.zeros((side, side), bool)
    for tile in meshes:
        p = (tile["p"] @ axes)[tile["all" if skirts else "faces"]]
        p[:, :, :2] = (p[:, :, :2] / 1.1 + 1) * side / 2
        e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        area = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
        for q, a, b, twice in zip(p[area > 0], e1[area > 0], e2[area > 0], area[area > 0]):
            low, high = np.ceil(q[:, :2].min(0) - 0.5).astype(int), np.floor(q[:, :2].max(0) - 0.5).astype(int)
            if (high < low).any():
                continue
            x, y = np.meshgrid(np.arange(low[0], high[0] + 1) + 0.5 - q[0, 0],
                               np.arange(low[1], high[1] + 1) + 0.5 - q[0, 1], indexing="ij")
            w1, w2 = (x * b[1] - y * b[0]) / twice, (a[0] * y - a[1] * x) / twice
            shown[low[0]:high[0] + 1, low[1]:high[1] + 1] |= (w1 >= 0) & (w2 >= 0) & (w1 + w2 <= 1)
    return shown


def refined(node, chosen):
    """Returns the tiles that are shown if those that are chosen show their children."""
    if node.get("children") and chosen(node):
        return [name for child in node["children"] for name in refined(child, chosen)]
    return [node["content"]["uri"].removesuffix(".glb")]


def test_no_crack_shows_between_levels(made, read):
    _, _, tileset = made
    rng = np.random.default_rng(7)
    side, bare = 512, 0
    middle = ((np.arange(side) + 0.5) * 2 / side - 1) * 1.1
    inside = middle[:, None] ** 2 + middle ** 2 < (RADIUS - HEIGHT - 2 * tileset["root"]["geometricError"]) ** 2
    assert inside.sum() > 0.5 * side ** 2
    for _ in range(12):
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        axes[:, 2] *= np.linalg.det(axes)
        near = rng.normal(size=3)
        names = refined(tileset["root"], lambda node: near @ node["boundingVolume"]["box"][:3] > -0.1 or
                        node is tileset["root"])
        assert len({name[0] for name in names}) > 1
        assert covered([read[name] for name in names], axes, side, True)[inside].all()
        bare += (~covered([read[name] for name in names], axes, side, False)[inside]).sum()
    assert bare > 0  # without skirts there are cracks


# ---- jobs ----

def contents(folder):
    """Returns the checksums of all files but the certificate."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()
            if path.name not in ("tiles.json", "bisque-steps")}


def test_bytes_do_not_depend_on_threads_or_interruptions(made, tmp_path):
    folder, certificate, _ = made
    bisque.sort(coloured(), tmp_path / "scan.tris")
    words = command_of([tmp_path / "scan.tris", "-o", tmp_path / "out", *WORDS, "-j", 3, "--progress", "json"])
    for stage in ("collapsing", "unwrap 1", "bake 2", "bake 3", None):
        with subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as program:
            for line in program.stderr:
                if stage and stage in line:
                    program.send_signal(signal.SIGTERM)
                    stage = None
                    interrupted = True
            code = program.wait()
        assert code in (0, 75)
        if code == 75:
            assert not (tmp_path / "out" / "tiles.json").exists()
    assert code == 0 and interrupted
    assert contents(tmp_path / "out") == contents(folder)
    assert not (tmp_path / "out" / "bisque-steps").exists()


def test_libraries_that_unwrap_end_with_the_job(tmp_path, monkeypatch):
    """Of each thread. A signal comes when one has begun; it would say so if it went on."""
    begun, late = tmp_path / "begun", tmp_path / "late"
    (tmp_path / "library").write_text(f"#!/bin/sh\n: >'{begun}'\nsleep 20\n: >'{late}'\n")
    (tmp_path / "library").chmod(0o755)
    monkeypatch.setattr(bisque.uv, "sys", types.SimpleNamespace(executable=str(tmp_path / "library")))

    def interrupt():
        while not begun.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        bisque.tiles(sphere(8, False), tmp_path / "out", tile_triangles=100, triangles=200, size=32, threads=2)
    assert not late.exists()


def test_parts_make_the_same_bytes(made, tmp_path, monkeypatch):
    folder, certificate, _ = made
    options = {**OPTIONS, "threads": 1}
    bisque.sort(coloured(), tmp_path / "scan.tris")

    def run(part, **more):
        return bisque.tiles(tmp_path / "scan.tris", tmp_path / "out", part=part, **{**options, **more})

    with pytest.raises(bisque.Error, match="there is no plan") as refused:
        run("1/2")
    assert refused.value.status == 66 and not (tmp_path / "out").exists()
    total = len(certificate["tiles"])
    levels = Counter(tile["level"] for tile in certificate["tiles"].values())
    batches = sum(-(-count // 10) for count in levels.values())
    assert run("plan") == {"part": "plan", "tiles": total, "batches": batches}
    with pytest.raises(bisque.Error, match="there is no plan of this scan with these options"):
        run("1/2", triangles=2000)
    steps = tmp_path / "out" / "bisque-steps"
    assert run("2/2")["batches"] == batches // 2
    lock = open(steps / "batch_0_1.lock", "w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    with pytest.raises(bisque.Error, match="batch_0_1.json: another bisque-asset is at work on it"):
        run("1/2")
    lock.close()
    done = (steps / "1_1.glb").stat().st_mtime_ns
    first = run("1/2")
    assert first["batches"] == batches - batches // 2 and first["tiles"] < total
    times = {path.name: path.stat().st_mtime_ns for path in steps.glob("*.glb")}
    assert len(times) == total and times["1_1.glb"] == done
    assert not (tmp_path / "out" / "tiles.json").exists()
    monkeypatch.setattr(sys.modules["bisque.core"], "bake", None)  # no more of it
    run(None)
    assert contents(tmp_path / "out") == contents(folder) and not steps.exists()


def test_levels_are_whole_meshes(tmp_path):
    points, faces = sphere(60, True)
    far = np.array([5e5, 0, -2e5])
    certificate = bisque.tiles((points + far, faces), tmp_path / "out", tile_triangles=300, size=64, levels=3,
                               maps="normal", up="z", units="cm", geometry="meshopt")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "levels.json", "level_0.glb", "level_1.glb", "level_2.glb"}
    sizes, errors = [], []
    for level in range(3):
        path = tmp_path / "out" / f"level_{level}.glb"
        tile = certificate["tiles"][f"level_{level}"]
        glb = sys.modules["bisque.glb"].Glb(path)
        assert 0.9 * 300 * 4 ** level < tile["triangles"] <= 300 * 4 ** level and tile["skirt_triangles"] == 0
        image = Image.open(io.BytesIO(glb.view(glb.head["images"][0]["bufferView"])))
        assert image.size == (64 << level, 64 << level)
        node, = glb.head["nodes"]
        corners = glb.primitive(glb.head["meshes"][0]["primitives"][0])[0]["POSITION"]
        x, y, z, w = node["rotation"]
        turn = np.array([[1, 0, 0], [0, w * w - x * x, -2 * x * w], [0, 2 * x * w, w * w - x * x]])
        placed = (corners * node["scale"]) @ turn.T + node["translation"]
        # z is up and becomes y; centimetres become metres.
        middle = 0.01 * np.array([far[0], far[2], -far[1]])
        lengths = np.linalg.norm(placed - middle, axis=1) * 100
        assert y == z == 0 and np.abs(lengths - RADIUS).max() < 3 * HEIGHT + tile["geometric_error"]
        sizes.append(path.stat().st_size)
        errors.append(tile["geometric_error"])
    assert sizes == sorted(sizes) and errors == sorted(errors, reverse=True)
    with pytest.raises(bisque.Error, match="which is of no tiles of bisque-asset") as refused:
        bisque.tiles((points, faces), tmp_path / "out")
    assert refused.value.status == 73


def test_a_second_tileset_replaces_the_first(tmp_path):
    scan = sphere(20, True)
    bisque.tiles(scan, tmp_path / "out", tile_triangles=100, triangles=400, size=32)
    before = set(contents(tmp_path / "out"))
    certificate = bisque.tiles(scan, tmp_path / "out", tile_triangles=100, triangles=100, size=32)
    assert {*contents(tmp_path / "out")} - {"index.html"} == {"0_1.glb", "tileset.json"} < before
    assert certificate["options"]["maps"] == ["normal", "color"] and len(certificate["tiles"]) == 1


def test_tiles_lie_where_they_are_placed(tmp_path):
    points, faces = sphere(12, False)
    folder = tmp_path / "out"
    bisque.tiles((points, faces), folder, tile_triangles=200, triangles=200, size=32, maps="normal", place=(90, 0, 500))
    matrix = np.array(json.loads((folder / "tileset.json").read_text())["root"]["transform"]).reshape(4, 4).T
    # At 90 degrees east on the equator, up is y, east is -x, and north is z.
    assert np.allclose(matrix @ [0, 0, 0, 1], [0, 6378137 + 500, 0, 1])
    assert np.allclose(matrix[:3, :3], [[-1, 0, 0], [0, 0, 1], [0, 1, 0]])
    bisque.tiles((points, faces), folder, tile_triangles=200, triangles=200, size=32, maps="normal", up="z", units="mm",
                 place=(0, 0, 0))
    matrix = np.array(json.loads((folder / "tileset.json").read_text())["root"]["transform"]).reshape(4, 4).T
    # At zero, up is x, east is y, and north is z. Content (x, y, z) becomes (x, -z, y) before.
    assert np.allclose(matrix @ [0, 0, 0, 1], [6378137, 0, 0, 1])
    assert np.allclose(matrix[:3, :3] @ [0, -1, 0], [0.001, 0, 0])  # the scan's z
    assert np.allclose(matrix[:3, :3] @ [1, 0, 0], [0, 0.001, 0])
    assert np.allclose(matrix[:3, :3] @ [0, 0, 1], [0, 0, 0.001])  # its y is north
    far = np.array([5e6, 100, -7e6])
    bisque.tiles((points + far, faces), tmp_path / "far", tile_triangles=200, triangles=200, size=32, maps="normal")
    root = json.loads((tmp_path / "far" / "tileset.json").read_text())["root"]
    shift = np.array(root["transform"]).reshape(4, 4).T[:3, 3] + root["boundingVolume"]["box"][:3]
    assert np.abs(shift - [far[0], -far[2], far[1]]).max() < 0.1
    assert max(map(abs, root["boundingVolume"]["box"])) < 2


@pytest.mark.parametrize("words, code, line", [
    (["--place", "200,0,0"], 64, "place: 200,0,0 is no place on the earth"),
    (["--place", "1,2"], 64, "place: longitude, latitude and height are needed"),
    (["--tile-triangles", "99"], 64, "tile_triangles: a number from 100"),
    (["--maps", "ao"], 64, "maps: tiles have normal and color, not ao"),
    (["--up", "w"], 64, "up: 'w' is none of"),
    (["--hard-angle", "30"], 64, "--hard-angle: not with --tiles"),
    (["--preset", "game"], 64, "--preset: not with --tiles"),
    (["--report"], 64, "--report: not with --tiles"),
    (["--levels", "2"], 64, "--levels: not with --tiles"),
    (["--part", "4/3"], 64, "part: plan, or a number such as 3/16 is needed, not '4/3'"),
    (["--part", "0/3"], 64, "part: plan, or a number"),
    (["--part", "1/3"], 66, "out: there is no plan: --part plan makes it"),
])
def test_wrong_options_are_refused(tmp_path, words, code, line):
    bisque.Mesh(*sphere(4, False)).save(tmp_path / "scan.obj")
    done = run_asset(tmp_path / "scan.obj", "-o", tmp_path / "out", "--tiles", *words)
    assert done.returncode == code and line in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_places_in_the_west_and_south_are_values(tmp_path):
    done = run_asset(tmp_path / "none.obj", "-o", tmp_path / "out", "--tiles", "--place", "-71.06,-42.3,10")
    assert done.returncode == 66 and "none.obj" in done.stderr


@pytest.mark.parametrize("words, line", [
    (["--place", "1,2,3"], "--place: only with --tiles\n"),
    (["--part", "plan"], "--part: only with --tiles and --levels"),
    (["--levels", "2", "--place", "1,2,3"], "place: levels have none"),
    (["--levels", "0"], "levels: "),
    (["--levels", "8", "--size", "1024"], "size: the finest of 8 levels would have maps of 131072 texels a side, more than "),
    (["--levels", "9", "--triangles", "1000", "--size", "64"], "levels: 192 triangles are too few for 9 levels"),
    (["--levels", "2", "--preset", "game"], "--preset: not with --tiles and --levels"),
])
def test_options_of_tiles_need_tiles(tmp_path, words, line):
    bisque.Mesh(*sphere(4, False)).save(tmp_path / "scan.obj")
    done = run_asset(tmp_path / "scan.obj", "-o", tmp_path / "out", *words)
    assert done.returncode == 64 and line in done.stderr and done.stderr.count("\n") == 1


def test_a_folder_of_others_is_refused(tmp_path):
    bisque.Mesh(*sphere(4, False)).save(tmp_path / "scan.obj")
    for name in ("notes.txt", "index.html", "tileset.json", "tiles.json"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).write_text("{}")
        done = run_asset(tmp_path / "scan.obj", "-o", tmp_path / name, "--tiles")
        assert done.returncode == 73 and f"{name}, which is of no tiles of bisque-asset" in done.stderr
        assert [path.read_text() for path in (tmp_path / name).iterdir()] == ["{}"]
    done = run_asset(tmp_path / "scan.obj", "-o", tmp_path, "--tiles")
    assert done.returncode == 64 and "move it elsewhere" in done.stderr


def test_a_second_job_leaves_copies_of_the_first(tmp_path):
    """Files that the first one is about to give their names, which its note tells."""
    bisque.Mesh(*sphere(4, False)).save(tmp_path / "scan.obj")
    first = Folder(tmp_path / "out")
    (first.path / PUBLISHED).write_text('[["0_1.glb", "x"]]')
    (tmp_path / "out/.0_1.glb.new").write_text("complete")
    done = run_asset(tmp_path / "scan.obj", "-o", tmp_path / "out", "--tiles")
    assert done.returncode == 73 and "another bisque-asset is at work here" in done.stderr
    assert (tmp_path / "out/.0_1.glb.new").read_text() == "complete"
    first.close(True)


def test_a_scan_without_colours_has_no_colour_map(tmp_path):
    certificate = bisque.tiles(sphere(12, False), tmp_path / "out", tile_triangles=200, triangles=200, size=32)
    head = (tmp_path / "out" / "0_1.glb").read_bytes()
    assert b"normalTexture" in head and b"baseColorTexture" not in head
    assert len(certificate["tiles"]) == 1
    with pytest.raises(bisque.Error, match="the scan has no colour"):
        bisque.tiles(sphere(12, False), tmp_path / "other", maps="color")


def test_a_coarsest_tile_above_the_limit_is_told(tmp_path, monkeypatch):
    # As of a mesh of so many holes that no more edges can collapse.
    monkeypatch.setattr(sys.modules["bisque.tiles"], "level_targets", lambda *_: [400])
    line = "the coarsest tile has 400 triangles instead of 100: "
    with pytest.warns(UserWarning, match=line):
        certificate = bisque.tiles(sphere(12, False), tmp_path / "out", tile_triangles=100, size=32)
    assert certificate["tiles"]["0_1"]["triangles"] == 400
    assert [text.startswith(line) for text in certificate["warnings"]] == [True]

"""3D Tiles of a generated vase as viewers show them, by rays through Embree; and as other programs read them. LONG=1:
60 views of 512 x 512 pixels, and a finer scan."""
import json
import os
import subprocess

import bisque
import numpy as np
import pytest
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from test_tiles import border_of, look_up, nodes_of, read_tile

LONG = os.environ.get("LONG")
VIEWS, SIDE, SCAN, FINEST, LIMIT, SIZE = (60, 512, 800_000, 20_000, 2500, 1024) if LONG else (8, 160, 60_000, 6000, 800,
                                                                                             128)
PIXELS = (1, 4, 16)
FOV = np.radians(45)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Returns the scan, the folder, the certificate and the tileset, and all tiles as read_tile() reads them."""
    folder = tmp_path_factory.mktemp("views")
    subprocess.run([os.environ["GENERATE"], "--triangles", str(SCAN), "--colors", "vase", "-o", folder / "vase.ply"],
                   check=True)
    certificate = bisque.tiles(folder / "vase.ply", folder / "out", tile_triangles=LIMIT, triangles=FINEST, size=SIZE)
    scan = trimesh.load(folder / "vase.ply", process=False)
    tiles = {name: read_tile(folder / "out", tile) for name, tile in certificate["tiles"].items()}
    return scan, folder, certificate, json.loads((folder / "out" / "tileset.json").read_text()), tiles


# ---- rays ----

class View:
    """A camera that looks at the middle of the scan."""

    def __init__(self, scan, number):
        low, high = scan.bounds
        z = 1 - (2 * number + 1) / VIEWS
        angle = number * np.pi * (3 - 5 ** 0.5)
        back = np.array([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])
        size = np.linalg.norm(high - low)
        # Most are near, so that tiles of several levels are shown.
        self.eye = (low + high) / 2 + back * size * (0.36, 0.45, 0.6, 1.5)[number % 4]
        right = np.cross([0, 1, 0], back)
        right /= np.linalg.norm(right)
        grid = (np.arange(SIDE) + 0.5) * 2 / SIDE - 1
        x, y = np.meshgrid(grid, -grid)
        way = np.tan(FOV / 2) * (x[..., None] * right + y[..., None] * np.cross(back, right)) - back
        self.ways = (way / np.linalg.norm(way, axis=2)[..., None]).reshape(-1, 3)

    def look(self, corners):
        """Casts a ray through each pixel at the triangles that face the camera. Returns their numbers, -1 of none,
        the weights of their corners, and the distances."""
        front = np.flatnonzero((np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) *
                                (self.eye - corners[:, 0])).sum(axis=1) > 0)
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, (corners[front] - self.eye).astype(np.float32))
        ways = self.ways.astype(np.float32)
        found = scene.run(np.zeros_like(ways), ways, query="INTERSECT", output=1)
        hit = found["primID"] >= 0
        numbers = np.where(hit, front[np.where(hit, found["primID"], 0)], -1)
        u, v = found["u"].astype(float), found["v"].astype(float)
        return numbers, np.stack([1 - u - v, u, v], axis=1), found["tfar"]

    def depths(self, corners):
        """Returns the distance that each pixel shows, infinity for the background."""
        numbers, _, far = self.look(corners)
        return np.where(numbers >= 0, far, np.inf).reshape(SIDE, SIDE)

    def pixels(self, node, points=None):
        """Returns the error of a tile in pixels, as a viewer computes it: at its box, in which the camera may be. With
        the tile's points, what it is at the closest one. Boxes are z-up."""
        box = np.array(node["boundingVolume"]["box"])
        eye = self.eye @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
        away = np.linalg.norm(np.maximum(np.abs(eye - box[:3]) - [box[3], box[7], box[11]], 0))
        if points is not None:
            away = np.linalg.norm(points - self.eye, axis=1).min()
        return node["geometricError"] * SIDE / (2 * max(away, 1e-9) * np.tan(FOV / 2))


def shown_of(node, refined):
    """Returns the nodes that are shown if those that are refined show their children."""
    if node.get("children") and refined(node):
        return [found for child in node["children"] for found in shown_of(child, refined)]
    return [node]


def name_of(node):
    return node["content"]["uri"].removesuffix(".glb")


def farthest_near(depths, steps):
    """Returns of each pixel the largest depth of those near it; beyond the picture it is not known, and infinite."""
    found = np.pad(depths, 1, constant_values=np.inf)
    for _ in range(steps):
        for axis in (0, 1):
            found = np.maximum(found, np.maximum(np.roll(found, 1, axis), np.roll(found, -1, axis)))
    return found[1:-1, 1:-1]


def test_no_background_shows_inside_the_silhouette(made):
    """Nor does a part of the vase that is farther away than all of it that the scan shows near there."""
    scan, _, _, tileset, tiles = made
    rng = np.random.default_rng(3)
    mixed, looked, bare = 0, 0, 0
    for number in range(VIEWS):
        view = View(scan, number)
        scans = view.depths(scan.triangles)
        for most in (*PIXELS, None):  # None: levels are mixed by chance
            nodes = shown_of(tileset["root"], lambda node: view.pixels(node) > most if most else (
                node is tileset["root"] or rng.random() < 0.7))
            mixed += len({name_of(node).split("_")[0] for node in nodes}) > 1
            errors = max(view.pixels(node, tiles[name_of(node)]["p"]) for node in nodes)
            deepest = farthest_near(scans, int(np.ceil(errors)) + 1) + max(node["geometricError"] for node in nodes)
            looked += np.isfinite(deepest).sum()
            for skirts in (True, False)[:1 if most else 2]:
                corners = np.concatenate([tiles[name_of(node)]["p"][tiles[name_of(node)]["all" if skirts else "faces"]]
                                          for node in nodes])
                holes = view.depths(corners) > deepest
                if skirts:
                    assert not holes.any(), (number, most, np.argwhere(holes)[:3])
                else:
                    bare += holes.sum()
    print(f"{mixed} of {4 * VIEWS} pictures have tiles of several levels; of {looked} pixels none shows what lies "
          f"behind, without skirts {bare} of about a quarter of them")
    assert mixed >= VIEWS and looked > VIEWS * SIDE * SIDE / 4
    assert bare > 0  # skirts are needed, and cracks would be found


def shade(tile, which, weights):
    """Returns the colours (0 to 255) and normals that a viewer shows at points of triangles."""
    corners = tile["all"][which]

    def at(key):
        return (tile[key][corners] * weights[:, :, None]).sum(axis=1)

    color, mapped = (look_up(image, at("uv")) for image in tile["images"])
    n, t = at("n"), at("t")
    b = np.cross(n, t[:, :3]) * np.sign(t[:, 3:])
    mapped = mapped / 127.5 - 1
    normal = mapped[:, :1] * t[:, :3] + mapped[:, 1:2] * b + mapped[:, 2:] * n
    return color, normal / np.linalg.norm(normal, axis=1)[:, None]


def errors_in_views(scan, sets, views):
    """Returns for each set of meshes the mean angle of normals and the mean difference of colours, in 8-bit steps, from
    those of the scan."""
    normals = np.zeros_like(scan.vertices)
    p = scan.triangles
    for k in range(3):
        np.add.at(normals, scan.faces[:, k], np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    paint = np.asarray(scan.visual.vertex_colors)[:, :3].astype(float)
    found = [([], []) for _ in sets]
    for number in range(views):
        view = View(scan, number)
        theirs, w, far = view.look(scan.triangles)
        for meshes, (angles, colors) in zip(sets, found):
            ours, weights, near = view.look(np.concatenate([mesh["p"][mesh["all"]] for mesh in meshes]))
            both = np.flatnonzero((theirs >= 0) & (ours >= 0) & (np.abs(far - near) < 0.01 * scan.scale))
            faces, at = scan.faces[theirs[both]], w[both][:, :, None]
            wanted, color = (normals[faces] * at).sum(axis=1), (paint[faces] * at).sum(axis=1)
            wanted /= np.linalg.norm(wanted, axis=1)[:, None]
            counts = np.cumsum([0] + [len(mesh["all"]) for mesh in meshes])
            owner = np.searchsorted(counts, ours[both], side="right") - 1
            for i in np.unique(owner):
                mine = owner == i
                shown, normal = shade(meshes[i], ours[both][mine] - counts[i], weights[both][mine])
                colors.append(np.abs(shown - color[mine]).mean(axis=1))
                angles.append(np.degrees(np.arccos((normal * wanted[mine]).sum(axis=1).clip(-1, 1))))
    return [[np.concatenate(kind).mean() for kind in kinds] for kinds in found]


def test_leaves_look_as_a_single_asset(made):
    scan, folder, certificate, tileset, tiles = made
    names = [name_of(node) for node, _ in nodes_of(tileset["root"]) if not node.get("children")]
    # All triangles of the leaves, and texels of about as many bytes: one square is filled better than many small ones.
    side = round(1.16 * (len(names) * SIZE ** 2) ** 0.5)
    count = sum(certificate["tiles"][name]["triangles"] for name in names)
    bisque.asset(folder / "vase.ply", folder / "one.glb", triangles=count, size=side, maps=("normal", "color"),
                 surface="exact", hard_angle=180)
    one = read_tile(folder, {"file": "one.glb", "triangles": count})
    one["p"] = one["p"] + one["head"]["nodes"][0]["translation"]
    leaves, single = errors_in_views(scan, ([tiles[name] for name in names], [one]), VIEWS if LONG else 3)
    sizes = [sum((folder / "out" / f"{name}.glb").stat().st_size for name in names),
             (folder / "one.glb").stat().st_size]
    print(f"leaves: {leaves[0]:.2f} degrees, {leaves[1]:.2f} of 255, {sizes[0]} bytes; one asset: {single[0]:.2f}, "
          f"{single[1]:.2f}, {sizes[1]} bytes")
    assert 0.7 < sizes[0] / sizes[1] < 1.4
    assert leaves[0] < 1.5 * single[0] and leaves[1] < 1.5 * single[1]


def test_neighbours_agree_at_their_border(made):
    _, _, certificate, _, tiles = made
    levels = sorted({tile["level"] for tile in certificate["tiles"].values()})
    for level in levels[1:]:
        seen = {}
        for name in (name for name, tile in certificate["tiles"].items() if tile["level"] == level):
            tile = tiles[name]
            border, corners = {tuple(p) for p in border_of(tile).reshape(-1, 3)}, tile["p"][tile["faces"]]
            which, corner = np.nonzero(np.array([[tuple(p) in border for p in row] for row in corners]))
            color, normal = shade(tile, which, np.eye(3)[corner])
            for p, c, n in zip(corners[which, corner], color, normal):
                seen.setdefault(tuple(p), {}).setdefault(name, []).append((c, n))
        pairs = [[[np.mean(each, axis=0) for each in zip(*tile)] for tile in by_tile.values()][:2]
                 for by_tile in seen.values() if len(by_tile) > 1]
        steps = np.abs(np.array([(a[0] - b[0], 127.5 * (a[1] - b[1])) for a, b in pairs])).mean(axis=(0, 2))
        print(f"level {level}, {len(pairs)} points: colours differ by {steps[0]:.2f}, normals by {steps[1]:.2f} steps "
              "of 8 bits")
        assert len(pairs) > 100 and (steps < (1 if LONG else 3)).all()


# ---- other programs ----

BLENDER = """
import json, sys, bpy
found = {}
for path in sys.argv[1:]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path)
    mesh = next(o for o in bpy.context.scene.objects if o.type == 'MESH').data
    mesh.calc_loop_triangles()
    found[path] = [len(mesh.loop_triangles), len(mesh.uv_layers), len(bpy.data.images)]
print('FOUND' + json.dumps(found))
"""


def test_other_programs_read_them(made):
    import al3dtiles
    import assimp_py
    from py3dtiles.tileset.tileset import TileSet

    _, folder, certificate, tileset, _ = made
    files = {tile["file"]: tile["triangles"] + tile["skirt_triangles"] for tile in certificate["tiles"].values()}
    for name, count in files.items():
        scene = assimp_py.import_file(str(folder / "out" / name), assimp_py.Process_Triangulate)
        assert sum(len(mesh.indices) for mesh in scene.meshes) == 3 * count
        mesh = trimesh.load(folder / "out" / name, force="mesh", process=False)
        assert len(mesh.faces) == count and mesh.visual.material.baseColorTexture.size == (SIZE, SIZE)
    theirs = TileSet.from_file(folder / "out" / "tileset.json")
    found = [theirs.root_tile, *theirs.root_tile.get_all_children()]
    assert len(found) == len(files) and theirs.root_tile.geometric_error == tileset["root"]["geometricError"]
    for tile in found:
        content = tile.get_or_fetch_content(folder / "out")
        assert content.__class__.__name__ == "Gltf", content
    opened = al3dtiles.TilesetDataset.open(str(folder / "out" / "tileset.json"))
    assert opened.version == "1.1" and {found.uri for found in opened.iter_contents()} == set(files)


@pytest.mark.skipif(not os.environ.get("BPY"), reason="BPY names no Python with the module bpy")
def test_blender_reads_them(made):
    _, folder, certificate, _, _ = made
    paths = {str(folder / "out" / tile["file"]): tile for tile in certificate["tiles"].values()}
    done = subprocess.run([os.environ["BPY"], "-c", BLENDER, *paths], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.split("FOUND")[1].splitlines()[0])
    for path, tile in paths.items():
        assert found[path] == [tile["triangles"] + tile["skirt_triangles"], 1, 2]

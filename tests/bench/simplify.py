#!/usr/bin/env python3
"""Compares bisque-simplify with simplifiers that hold the scan in memory.

    BIN=DIR TESTS=DIR simplify.py [SCAN.obj...]

Prints a row for each scan, target (1 % and 10 % of its triangles) and program, then geometric means
over all of them. Without scans, makes ten kinds. Distances are found by Embree (Open3D), not by
Bisque: from 120,000 points of either surface, even by area, and all vertices; the larger mean and
the larger maximum of both directions, in % of the diagonal. Folds are edges whose triangles lie back
to back, crowded edges have more than two triangles. PEERS=a,b chooses programs; those whose Python
module is missing are left out. CGAL=PROGRAM runs a build of simplify_cgal.cpp. Exits with 1 if a
scan without edges of three triangles gets any, or more than ten new folds, or misses its target.
"""
import importlib.util
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh
from scipy import ndimage
from skimage import measure as contours

BIN, TESTS = Path(os.environ["BIN"]).resolve(), Path(os.environ["TESTS"]).resolve()
CGAL = os.environ.get("CGAL")
POINTS = 120_000
FOLD_COSINE = -0.9  # of the normals on both sides of a folded edge
NEW_FOLDS = 10


# ---- scans ----

def sheet(side, place):
    """Returns vertices and triangles of a grid of side x side squares."""
    y, x = np.mgrid[0:side + 1, 0:side + 1]
    a = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + side + 2], 1),
                            np.stack([a, a + side + 2, a + side + 1], 1)])
    return np.stack(place(x.ravel() / side, y.ravel() / side), 1), faces


def block(side, half, bend):
    """Returns a closed box with these half sides, whose faces are grids, bent along x."""
    parts = []
    for axis in range(3):
        for sign in (-1, 1):
            v, f = sheet(side, lambda x, y: (2 * x - 1, 2 * y - 1, np.full_like(x, sign)))
            parts.append((np.roll(v, axis, 1) * half, f if sign > 0 else f[:, ::-1]))
    offsets = np.cumsum([0] + [len(v) for v, _ in parts])
    v = np.concatenate([v for v, _ in parts])
    v[:, 2] += bend * np.sin(2 * v[:, 0]) * np.cos(2 * v[:, 1])
    mesh = trimesh.Trimesh(v, np.concatenate([f + o for (_, f), o in zip(parts, offsets)]))
    mesh.merge_vertices(digits_vertex=7)
    return mesh.vertices, mesh.faces


def volume(side):
    """Returns coordinates of a cube of side^3 values, and noise of standard deviation 1 in it."""
    noise = ndimage.gaussian_filter(np.random.default_rng(5).normal(size=(side,) * 3), 1)
    return np.mgrid[-1:1:side * 1j, -1:1:side * 1j, -1:1:side * 1j], noise / noise.std()


def contour(values, level):
    v, f, _, _ = contours.marching_cubes(values, level)
    return v, f


def body(side, noise_share):
    """Returns a body with folds inside, as from magnetic resonance, and specks of noise."""
    x, noise = volume(side)
    r = np.sqrt((x[0] / .8) ** 2 + (x[1] / .7) ** 2 + (x[2] / .85) ** 2)
    inside = .25 * np.sin(9 * x[0]) * np.sin(9 * x[1]) * np.sin(9 * x[2]) * (r < .9)
    return contour(1 / (1 + np.exp(25 * (r - 1))) + inside + noise_share * noise, .5)


def splats(side, count):
    """Returns the surface of the density of random points near a torus knot."""
    rng = np.random.default_rng(4)
    t = rng.uniform(0, 2 * np.pi, count)
    r = 2 + np.cos(3 * t)
    p = np.stack([r * np.cos(2 * t), r * np.sin(2 * t), np.sin(3 * t)], 1)
    p += .35 * rng.normal(size=p.shape) / np.sqrt(3)
    cells = ((p + 4.2) / 8.4 * side).astype(int).clip(0, side - 1)
    density = np.zeros((side,) * 3)
    np.add.at(density, tuple(cells.T), rng.lognormal(0, 1, count))
    return contour(ndimage.gaussian_filter(density, 1.3), .045)


def sponge(side):
    x, _ = volume(side)
    k = 6 * np.pi / 2
    values = sum(np.sin(k * x[i]) * np.cos(k * x[(i + 1) % 3]) for i in range(3))
    return contour(np.where(np.max(np.abs(x), 0) < .95, values, 1), .1)


def tiles(count):
    """Returns overlapping open sheets with a little noise, and small pieces beside them."""
    rng, vertices, faces, first = np.random.default_rng(3), [], [], 0
    for i in range(count):
        side = 60 if i % 3 else 1 + i % 4
        x0, y0 = rng.uniform(0, 3, 2)
        v, f = sheet(side, lambda x, y: (x0 + x * side / 60, y0 + y * side / 60, 0 * x))
        v[:, 2] = .2 * np.sin(2 * v[:, 0]) * np.cos(3 * v[:, 1]) + .004 * rng.normal(size=len(v))
        vertices.append(v)
        faces.append(f + first)
        first += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


def terrain(side):
    k = np.fft.fftfreq(side + 1)
    scale = np.hypot(*np.meshgrid(k, k))
    scale[0, 0] = 1
    z = np.fft.ifft2(np.fft.fft2(np.random.default_rng(2).normal(size=scale.shape)) * scale ** -1.9)
    z = .04 * z.real / z.real.std()
    return sheet(side, lambda x, y: (x, y, z.ravel()))


def part(side):
    """Returns a plate with cylindrical holes and ribs: flat and round faces with sharp edges."""
    y, x = np.mgrid[-1:1:side * 1j, -1:1:side * 1j]
    z = np.where(np.hypot(x % .5 - .25, y % .5 - .25) < .12, 0, .2) + .1 * (np.abs(x) < .06)
    i = np.arange(side * side).reshape(side, side)
    f = np.concatenate([np.stack(c, -1).reshape(-1, 3) for c in
                        ((i[:-1, :-1], i[:-1, 1:], i[1:, 1:]), (i[:-1, :-1], i[1:, 1:], i[1:, :-1]))])
    return np.stack([x, y, z], -1).reshape(-1, 3), f


def make_scans():
    """Yields a name, vertices and triangles of ten kinds."""
    triangles = os.environ.get("TRIANGLES", "400000")
    subprocess.run([TESTS / "generate-scan", "--triangles", triangles, "vase", "-o", "organic.obj"],
                   check=True, stdout=subprocess.DEVNULL)
    organic = trimesh.load("organic.obj", process=False, force="mesh")
    yield "organic", organic.vertices, organic.faces
    yield "mechanical", *block(120, (1, 0.7, 0.4), 0)
    yield "thin", *block(120, (1, 1, 0.004), 0.2)
    yield "part", *part(400)
    yield "smooth volume", *body(110, 0)
    yield "noisy volume", *body(130, .11)
    yield "splats", *splats(150, 9000)
    yield "sponge", *sponge(110)
    yield "pieces", *tiles(60)
    yield "terrain", *terrain(400)


# ---- measurements ----

def weld(v, f):
    """Returns a mesh whose equal positions are one vertex, without triangles that have two equal."""
    v, number = np.unique(np.asarray(v, np.float32) + 0.0, axis=0, return_inverse=True)
    f = number.ravel()[np.asarray(f, np.int64)]
    return v, f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]


def defects(v, f):
    """Returns folds, and edges with more than two triangles."""
    v = v.astype(float)
    n = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    n /= np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
    edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), 1)
    owner = np.tile(np.arange(len(f)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    first = np.flatnonzero(np.r_[True, (edges[1:] != edges[:-1]).any(1)])
    count = np.diff(np.r_[first, len(edges)])
    two = first[count == 2]
    folds = ((n[owner[two]] * n[owner[two + 1]]).sum(1) < FOLD_COSINE).sum()
    return int(folds), int((count > 2).sum())


class Surface:
    """A mesh that distances are measured from and to."""

    def __init__(self, v, f):
        self.vertices, self.faces = weld(v, f)
        self.scene = o3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(o3d.core.Tensor(self.vertices),
                                 o3d.core.Tensor(self.faces.astype(np.uint32)))
        corners = self.vertices.astype(float)[self.faces]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.cumsum(np.linalg.norm(np.cross(a, b), axis=1))
        at = np.searchsorted(area, (np.arange(POINTS) + .5) / POINTS * area[-1])
        u = np.random.default_rng(1).random((POINTS, 2))
        u[u.sum(1) > 1] = 1 - u[u.sum(1) > 1]
        self.points = (corners[at, 0] + a[at] * u[:, :1] + b[at] * u[:, 1:]).astype(np.float32)

    def distances(self, points):
        return self.scene.compute_distance(o3d.core.Tensor(points)).numpy()


def measure(scan, v, f):
    mesh = Surface(v, f)
    diagonal = np.linalg.norm(np.ptp(scan.vertices.astype(float), axis=0))
    ways = [(a.distances(b.points), a.distances(b.vertices)) for a, b in ((mesh, scan), (scan, mesh))]
    folds, crowded = defects(mesh.vertices, mesh.faces)
    return {"triangles": len(mesh.faces), "folds": folds, "crowded": crowded,
            "mean": 100 / diagonal * max(float(p.mean()) for p, _ in ways),
            "max": 100 / diagonal * max(float(d.max()) for way in ways for d in way)}


# ---- programs: vertices, triangles and a target to vertices, triangles and processor seconds ----

def processor_seconds(who=resource.RUSAGE_SELF):
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


def timed(work):
    start = processor_seconds()
    result = work()
    return result, processor_seconds() - start


def run_meshoptimizer(v, f, target):
    import meshoptimizer
    out = np.zeros(3 * len(f), np.uint32)
    count, seconds = timed(lambda: meshoptimizer.simplify(
        out, f.astype(np.uint32).ravel(), v, target_index_count=3 * target, target_error=1e9))
    return v, out[:int(count)].reshape(-1, 3), seconds


def run_meshlib(v, f, target):
    import meshlib.mrmeshnumpy as arrays
    import meshlib.mrmeshpy as mr
    mesh = arrays.meshFromFacesVerts(f.astype(np.int32), v.astype(float))
    settings = mr.DecimateSettings()
    settings.maxDeletedFaces, settings.maxError, settings.packMesh = len(f) - target, 1e9, True
    _, seconds = timed(lambda: mr.decimateMesh(mesh, settings))
    return arrays.getNumpyVerts(mesh), arrays.getNumpyFaces(mesh.topology), seconds


def run_open3d(v, f, target):
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(v.astype(float)),
                                     o3d.utility.Vector3iVector(f.astype(np.int32)))
    mesh, seconds = timed(lambda: mesh.simplify_quadric_decimation(target))
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles), seconds


def run_fast_simplification(v, f, target):
    import fast_simplification
    (v, f), seconds = timed(lambda: fast_simplification.simplify(v, f.astype(np.int32),
                                                                 target_count=target))
    return v, f, seconds


def run_pymeshlab(v, f, target):
    import pymeshlab
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(v.astype(float), f.astype(np.int32)))
    _, seconds = timed(lambda: meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=target, autoclean=False))
    return meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix(), seconds


def run_blender(v, f, target):
    import bpy
    mesh = bpy.data.meshes.new("scan")
    mesh.from_pydata(v.tolist(), [], f.tolist())
    made = bpy.data.objects.new("scan", mesh)
    bpy.context.scene.collection.objects.link(made)
    made.modifiers.new("less", "DECIMATE").ratio = target / len(f)
    low, seconds = timed(lambda: made.evaluated_get(
        bpy.context.evaluated_depsgraph_get()).to_mesh())
    low.calc_loop_triangles()
    v = np.array([p.co[:] for p in low.vertices])
    f = np.array([t.vertices[:] for t in low.loop_triangles])
    bpy.data.objects.remove(made)
    return v, f, seconds


def run_cgal(v, f, target):
    sizes = np.array([len(v), len(f)], np.uint32)
    Path("in.bin").write_bytes(sizes.tobytes() + v.tobytes() + f.astype(np.uint32).tobytes())
    out = subprocess.run([CGAL, "in.bin", "out.bin", str(target)], check=True, capture_output=True)
    data = Path("out.bin").read_bytes()
    count = np.frombuffer(data, np.uint32, 2)
    return (np.frombuffer(data, np.float32, 3 * count[0], 8).reshape(-1, 3),
            np.frombuffer(data, np.uint32, 3 * count[1], 8 + 12 * count[0]).reshape(-1, 3),
            float(out.stdout))


def run_own(_, __, target):
    start = processor_seconds(resource.RUSAGE_CHILDREN)
    subprocess.run([BIN / "bisque-simplify", "scan.tris", "-o", "own.ply", "--triangles",
                    str(target)], check=True, stdout=subprocess.DEVNULL)
    seconds = processor_seconds(resource.RUSAGE_CHILDREN) - start
    own = trimesh.load("own.ply", process=False)
    return np.asarray(own.vertices), np.asarray(own.faces), seconds


PEERS = {"meshoptimizer": run_meshoptimizer, "meshlib": run_meshlib, "open3d": run_open3d,
         "fast_simplification": run_fast_simplification, "pymeshlab": run_pymeshlab,
         "bpy": run_blender, "cgal": run_cgal}


def choose_peers():
    names = os.environ["PEERS"].split(",") if "PEERS" in os.environ else list(PEERS)
    return [n for n in names if (CGAL if n == "cgal" else importlib.util.find_spec(n))]


# ---- the table ----

def compare(name, v, f, peers, ratios):
    """Prints the rows of a scan, and adds its ratios. Returns the goals that it misses."""
    scan = Surface(v, f)
    trimesh.Trimesh(scan.vertices, scan.faces, process=False).export("scan.ply")
    subprocess.run([BIN / "bisque-voxelize", "scan.ply", "-o", "scan.tris"], check=True,
                   stdout=subprocess.DEVNULL)
    folds, crowded = defects(scan.vertices, scan.faces)
    missed = []
    for share in (100, 10):
        target = len(scan.faces) // share
        rows = {}
        for program, run in [(p, PEERS[p]) for p in peers] + [("bisque", run_own)]:
            mesh_v, mesh_f, seconds = run(scan.vertices, scan.faces, target)
            row = rows[program] = measure(scan, mesh_v, mesh_f) | {"seconds": seconds}
            print(f"| {name} | {target:,} | {program} | {row['triangles']:,} | {row['mean']:.5f} | "
                  f"{row['max']:.4f} | {row['folds']} | {row['crowded']} | {seconds:.2f} |",
                  flush=True)
        own = rows.pop("bisque")
        for program, row in rows.items():
            for key in ("mean", "max", "seconds"):
                ratio = max(row[key], 1e-4) / max(own[key], 1e-4)  # less is rounding
                ratios.setdefault((program, share, key), []).append(ratio)
        goals = {"target": own["triangles"] <= target, "folds": own["folds"] <= folds + NEW_FOLDS,
                 "manifold": own["crowded"] <= crowded}
        missed += [f"{name} at {target}: {k}" for k, kept in goals.items() if not kept]
    os.unlink("scan.tris")
    return missed


def load(path):
    mesh = trimesh.load(path, process=False, force="mesh")
    return Path(path).stem, mesh.vertices, mesh.faces


def main():
    scans = [str(Path(p).resolve()) for p in sys.argv[1:]]
    peers, ratios, missed = choose_peers(), {}, []
    print("| scan | target | program | triangles | mean % | max % | folds | crowded | CPU s |")
    print("|:--|--:|:--|--:|--:|--:|--:|--:|--:|", flush=True)
    with tempfile.TemporaryDirectory(dir=os.environ.get("BENCH_DIR")) as work:
        os.chdir(work)
        for scan in map(load, scans) if scans else make_scans():
            missed += compare(*scan, peers, ratios)
        os.chdir("/")
    print("\nGeometric means of a program's figure / Bisque's:\n")
    print("| program | mean, 1 % | mean, 10 % | max, 1 % | max, 10 % | CPU s, 1 % | CPU s, 10 % |")
    print("|:--|--:|--:|--:|--:|--:|--:|")
    for program in peers:
        cells = [np.exp(np.mean(np.log(ratios[program, share, key])))
                 for key in ("mean", "max", "seconds") for share in (100, 10)]
        print(f"| {program} | " + " | ".join(f"{c:.2f}" for c in cells) + " |")
    print("\nmissed: " + (", ".join(missed) or "nothing"))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

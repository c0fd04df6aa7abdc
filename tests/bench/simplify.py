#!/usr/bin/env python3
"""Compares bisque-simplify with simplifiers that hold the scan in memory.

    BIN=DIR TESTS=DIR simplify.py [SCAN.obj...]

Prints a table of each scan: distances as bisque-compare measures them for all programs alike, in %
of the diagonal, the larger one of both directions; folds and edges that are not manifold; processor
time. Without scans, makes some. Exits with 1 if a goal is missed: mean at most MEAN_LIMIT (0.80) and
maximum at most MAX_LIMIT (1.1) of the best peer's, no more folds than the best peer's, no edge with
more than two triangles that the scan lacks, no border where the scan has none.
"""
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import fast_simplification
import numpy as np
import pyfqmr
import trimesh

BIN, TESTS = Path(os.environ["BIN"]).resolve(), Path(os.environ["TESTS"]).resolve()
MEAN_LIMIT = float(os.environ.get("MEAN_LIMIT", 0.80))
MAX_LIMIT = float(os.environ.get("MAX_LIMIT", 1.1))
EXACT = 1e-4  # in % of the diagonal: distances below are rounding
FOLD_COSINE = -0.9  # of the normals on both sides of a folded edge


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
            if sign < 0:
                f = f[:, ::-1]
            parts.append((np.roll(v, axis, 1) * half, f))
    offsets = np.cumsum([0] + [len(v) for v, _ in parts])
    v = np.concatenate([v for v, _ in parts])
    v[:, 2] += bend * np.sin(2 * v[:, 0]) * np.cos(2 * v[:, 1])
    mesh = trimesh.Trimesh(v, np.concatenate([f + o for (_, f), o in zip(parts, offsets)]))
    mesh.merge_vertices(digits_vertex=7)
    return mesh


def make_scans():
    triangles = os.environ.get("TRIANGLES", "1700000")
    subprocess.run([TESTS / "generate-scan", "--triangles", triangles, "vase", "-o", "organic.obj"],
                   check=True, stdout=subprocess.DEVNULL)
    block(120, (1, 0.7, 0.4), 0).export("mechanical.obj")
    block(120, (1, 1, 0.004), 0.2).export("thin.obj")
    return ["organic.obj", "mechanical.obj", "thin.obj"]


def defects(v, f):
    """Returns folds, edges with more than two triangles, and edges with one."""
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
    return int(folds), int((count > 2).sum()), int((count == 1).sum())


def measure(name, v, f, seconds, diagonal):
    trimesh.Trimesh(v, f, process=False).export("peer.ply")
    out = subprocess.run([BIN / "bisque-compare", "peer.ply", "scan.tris", "--json"], check=True,
                         capture_output=True)
    both = [json.loads(out.stdout)[k] for k in ("from_scan", "to_scan")]
    row = {"name": name, "seconds": seconds, "triangles": len(f)}
    row.update({k: max(EXACT, *(100 * d[k] / diagonal for d in both)) for k in ("mean", "max")})
    row.update(zip(("folds", "crowded", "borders"), defects(np.asarray(v, float), np.asarray(f))))
    return row


def processor_seconds(who):
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


def run_peer(name, mesh, target):
    start = processor_seconds(resource.RUSAGE_SELF)
    if name == "pyfqmr":
        peer = pyfqmr.Simplify()
        peer.setMesh(mesh.vertices, mesh.faces)
        peer.simplify_mesh(target_count=target, aggressiveness=7, preserve_border=False, verbose=0)
        v, f, _ = peer.getMesh()
    else:
        v, f = fast_simplification.simplify(mesh.vertices.astype(np.float32),
                                            mesh.faces.astype(np.int32), target_count=target)
    return v, f, processor_seconds(resource.RUSAGE_SELF) - start


def run_own(target):
    start = processor_seconds(resource.RUSAGE_CHILDREN)
    subprocess.run([BIN / "bisque-simplify", "scan.tris", "-o", "own.ply", "--triangles",
                    str(target)], check=True, stdout=subprocess.DEVNULL)
    seconds = processor_seconds(resource.RUSAGE_CHILDREN) - start
    own = trimesh.load("own.ply", process=False)
    own.merge_vertices(merge_norm=True)
    return np.asarray(own.vertices), np.asarray(own.faces), seconds


def compare(path):
    """Prints the table of a scan. Returns the goals that it misses."""
    mesh = trimesh.load(path, process=False, force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    diagonal = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))
    start = processor_seconds(resource.RUSAGE_CHILDREN)
    subprocess.run([BIN / "bisque-voxelize", path, "-o", "scan.tris"], check=True,
                   stdout=subprocess.DEVNULL)
    sorting = processor_seconds(resource.RUSAGE_CHILDREN) - start
    _, crowded, borders = defects(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    print(f"\n### {Path(path).stem}: {len(mesh.faces):,} triangles, sorted in {sorting:.2f} s\n")
    print("| program | triangles | mean % | max % | folds | crowded | borders | CPU s |")
    print("|:--|--:|--:|--:|--:|--:|--:|--:|", flush=True)
    missed = []
    for target in [t for t in (150000, 20000) if 5 * t <= len(mesh.faces)] or [len(mesh.faces) // 10]:
        rows = [measure(name, *run_peer(name, mesh, target), diagonal)
                for name in ("pyfqmr", "fast-simplification")]
        own = measure("bisque-simplify", *run_own(target), diagonal)
        for r in rows + [own]:
            print(f"| {r['name']} | {r['triangles']:,} | {r['mean']:.5f} | {r['max']:.4f} | "
                  f"{r['folds']} | {r['crowded']} | {r['borders']} | {r['seconds']:.1f} |")
        best = {k: min(r[k] for r in rows) for k in ("mean", "max", "folds", "seconds")}
        print(f"| ratio to the best | | {own['mean'] / best['mean']:.2f} | "
              f"{own['max'] / best['max']:.2f} | | | | {own['seconds'] / best['seconds']:.1f} |",
              flush=True)
        goals = {"mean": own["mean"] <= max(EXACT, MEAN_LIMIT * best["mean"]),
                 "maximum": own["max"] <= MAX_LIMIT * best["max"],
                 "folds": own["folds"] <= best["folds"],
                 "manifold": own["crowded"] <= crowded,
                 "cracks": borders > 0 or own["borders"] == 0}
        missed += [f"{Path(path).stem} at {target}: {k}" for k, kept in goals.items() if not kept]
    os.unlink("scan.tris")
    return missed


def main():
    scans = [str(Path(p).resolve()) for p in sys.argv[1:]]
    with tempfile.TemporaryDirectory(dir=os.environ.get("BENCH_DIR")) as work:
        os.chdir(work)
        missed = [m for scan in scans or make_scans() for m in compare(scan)]
        os.chdir("/")
    print("\nmissed: " + (", ".join(missed) or "nothing"))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

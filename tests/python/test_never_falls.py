"""bisque-asset on every mesh of tests/meshes, and with random options: a true certificate, or one line."""
import os
import random
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import bisque
import pytest
from conftest import certificate_of, judge, run_asset, sphere, write_png

# Of each mesh one file of each format: test_mesh_formats.sh shows that all programs' files are the same scan.
MESHES = list({(path.name.split(".")[0], path.suffix): path for path in
               sorted((Path(__file__).parents[1] / "meshes").iterdir()) if path.is_file()}.values())
LONG = os.environ.get("LONG")


def in_parallel(function, items):
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, items))


def test_every_mesh(tmp_path):
    def run(path):
        out = tmp_path / f"{path.name}.glb"
        return judge(run_asset(path, "-o", out, "--triangles", 40, "--size", 64, "--maps", "normal,color,ao"), out)

    made = in_parallel(run, MESHES)
    assert len(MESHES) > 20 and sum(map(bool, made)) > len(MESHES) / 3


def make_scans(folder):
    """Writes scans of many kinds, and files that are none. Returns lists of arguments."""
    points, faces = sphere(8, False)
    mesh = bisque.Mesh(points, faces)
    mesh.save(folder / "ball.obj")
    bisque.Mesh(points, faces[:, ::-1]).save(folder / "flipped.obj")
    bisque.Mesh(points, faces[points[faces[:, 0], 2] < 0.4]).save(folder / "open.obj")
    bisque.Mesh(points + [5, 0, 0], faces).save(folder / "far.obj")
    bisque.sort((points, faces), folder / "ball.tris")
    text = (folder / "ball.obj").read_text()
    (folder / "a.mtl").write_text("newmtl a\nmap_Kd a.png\nPr 0.5\n")
    write_png(folder / "a.png", (200, 100, 50))
    (folder / "material.obj").write_text("mtllib a.mtl\nusemtl a\n" + text)
    (folder / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "point.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n")
    (folder / "huge.obj").write_text(text.replace("v ", "v 1e20"))
    (folder / "tiny.obj").write_text("v 0 0 0\nv 1e-30 0 0\nv 0 1e-30 0\nv 0 0 1e-30\n"
                                     "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    (folder / "cut.tris").write_bytes((folder / "ball.tris").read_bytes()[:-50])
    (folder / "cut.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n")
    (folder / "empty.obj").write_bytes(b"")
    (folder / "odd \n\x1b[31m name.obj").write_text(text)
    (folder / "-o").write_text(text)
    names = ["ball.obj", "flipped.obj", "open.obj", "ball.tris", "material.obj", "flat.obj", "point.obj", "huge.obj",
             "tiny.obj", "cut.tris", "cut.ply", "empty.obj", "missing.obj", "a.mtl", "a.png",
             "odd \n\x1b[31m name.obj", "./-o", "<MAP>.obj"]
    (folder / "<MAP>.obj").write_text(text)
    lows = [str(folder / name) for name in ("ball.obj", "far.obj", "flat.obj", "point.obj", "cut.ply", "a.png", "none")]
    return [[str(folder / name)] for name in names] + [[str(folder / "ball.obj"), str(folder / "far.obj")]], lows


def draw_options(draw, lows, folder):
    """Returns random options, most of which make sense."""
    choices = {
        "--preset": ["web", "game", "archive", "nothing"], "--low": lows,
        "--texture": [str(Path(lows[0]).parent / "a.png")],
        "--triangles": [1, 12, 60, 300, 10 ** 9, 0, -1], "--maps": [
            "normal", "normal,color", "ao", "height,mask", "curvature,position", "thickness", "id", "roughness", "bent",
            "x", ",", "transfer:roughness", "color", "normal,normal"],
        "--samples": [1, 2, 3, 0], "--surface": ["auto", "grid", "exact"], "--unwrap": ["uvunwrap", "xatlas"],
        "--unwrap-seconds": [60, 0.001, -1], "--min-component": [0, "1%", 90, "200%", "nan"], "--report": [None],
        "--min-triangles": [0, 2, 10 ** 6, -1], "--error": ["5%", "40mm", 0.05, 0, "x"], "--up": ["z", "-x", "y", "w"],
        "--units": ["mm", "in", "m", "ft"], "--scale": [1, 0.01, 1e6, 0], "--close-holes": ["50%", 1, "2cm", "y"],
        "--hard-angle": [40, 0, 180, 181], "--winding": ["auto", "keep", "no"],
        "--keep": [str(folder / "k1"), str(folder / "k2")], "--memory": ["64M", "1G", "1K", "4Q"],
        "-j": [1, 2, 3, -1]}
    size = draw.choice([31, 64, 64, 64, 64, 16, 0]) if draw.random() < 0.9 else 100000
    options = ["--size", size]
    of_low = ("--triangles", "--min-component", "--min-triangles", "--error", "--close-holes", "--hard-angle", "--winding")
    for name, values in choices.items():
        if draw.random() < (0.02 if "--low" in options and name in of_low else 0.25):  # they are refused
            # Values that make no sense stand last; most draws are of the others.
            value = draw.choice(values[:max(1, len(values) // 2)] if draw.random() < 0.9 else values)
            options += [name] if value is None else [name, value]
    return options if {"--triangles", "--error", "--low"} & set(options) else [*options, "--triangles", 40]


@pytest.mark.parametrize("seed", range(10 if LONG else 1))
def test_random_options(seed, tmp_path):
    """SEED repeats a run. Ten outputs get two assets each; folders of --keep are shared by all."""
    seed = os.environ.get("SEED", str(seed))
    draw = random.Random(seed)
    scans, lows = make_scans(tmp_path)
    trials = [(draw.choice(scans[:5] if draw.random() < 0.6 else scans), draw_options(draw, lows, tmp_path))
              for _ in range(20)]

    def run(number):
        codes, out = [], tmp_path / f"out{number}" / "a.glb"
        out.parent.mkdir()
        for scan, options in trials[number::10]:
            done = run_asset(*scan, "-o", out, *options)
            try:
                judge(done, out)
                if (out.parent / "a_asset/asset.json").exists():  # of this run, or of the one before
                    certificate_of(out)
            except AssertionError as error:
                raise AssertionError(f"SEED={seed}: {scan} {options}: {error}") from None
            codes.append(done.returncode)
        return codes

    codes = sum(in_parallel(run, range(10)), [])
    assert 2 < codes.count(0) < 20, codes

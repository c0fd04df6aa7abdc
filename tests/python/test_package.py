"""The package from outside: meshes in memory and files give the same, errors, progress, UVs."""
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import bisque
import numpy as np
import pytest
from conftest import PROGRAM, judge, radius_at, run_asset, sphere, write_png

BIN, GENERATE = os.environ["BIN"], os.environ["GENERATE"]


def write_obj(path, vertices, faces):
    bisque.Mesh(vertices, faces).save(path)
    return path


def test_scans_in_memory_and_files_give_the_same_chunks(scan, tmp_path):
    vertices, faces = scan
    write_obj(tmp_path / "scan.obj", vertices, faces)
    subprocess.run([f"{BIN}/bisque-voxelize", tmp_path / "scan.obj", "-o", tmp_path / "file.tris"],
                   check=True, capture_output=True)
    expected = (tmp_path / "file.tris").read_bytes()
    padded = np.zeros((len(vertices), 5))
    padded[:, :3] = vertices
    import trimesh
    scans = {"arrays": (vertices, faces), "int64": (vertices, faces.astype(np.int64)),
             "rows with gaps": (padded[:, :3], faces), "columns": (np.asfortranarray(vertices), faces),
             "trimesh": trimesh.Trimesh(vertices, faces, process=False),
             "open3d": types.SimpleNamespace(vertices=vertices, triangles=faces, vertex_colors=[]),
             "path": tmp_path / "scan.obj"}
    for name, given in scans.items():
        report = bisque.sort(given, tmp_path / "memory.tris")
        assert report["triangles"] == len(faces)
        assert (tmp_path / "memory.tris").read_bytes() == expected, name


def test_several_chunk_files_are_one_scan(scan, tmp_path):
    vertices, faces = scan
    parts = [tmp_path / "a.tris", tmp_path / "b.tris"]
    for part, half in zip(parts, np.array_split(faces, 2)):
        bisque.sort((vertices, half), part)
    subprocess.run([f"{BIN}/bisque-voxelize", *parts, "-o", tmp_path / "all.tris"], check=True, capture_output=True)
    for given in (parts, tmp_path / "all.tris"):
        bisque.voxelize(given, tmp_path / f"{type(given).__name__}.nvdb", resolution=64)
    grids = [path.read_bytes() for path in tmp_path.glob("*.nvdb")]
    assert len(grids) == 2 and grids[0] == grids[1]
    lows = [bisque.simplify(given, triangles=200) for given in (parts[::-1], tmp_path / "all.tris")]
    assert np.array_equal(lows[0].vertices, lows[1].vertices)
    assert bisque.measure(lows[0], parts) == bisque.measure(lows[0], tmp_path / "all.tris")


def test_a_scan_in_memory_is_not_copied(tmp_path):
    """Resident memory grows by less than half of the arrays, within a small budget."""
    code = f"""
import sys; sys.path.insert(0, {os.path.dirname(__file__)!r})
import bisque, numpy as np
from conftest import sphere
def peak(): return int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]) << 10
vertices, faces = sphere(500, True)
vertices = np.ascontiguousarray(np.tile(vertices.astype(np.float32), (4, 1)))
faces = np.concatenate([faces + k * (len(vertices) // 4) for k in range(4)]).astype(np.int32, "C")
open('/proc/self/clear_refs', 'w').write('5')
before = peak()
bisque.sort((vertices, faces), {str(tmp_path / 'big.tris')!r}, memory='64M', threads=2)
print(vertices.nbytes + faces.nbytes, peak() - before)"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    arrays, grown = map(int, done.stdout.split())
    assert arrays > 200 << 20 and grown < 80 << 20, done.stdout


def test_colors_and_normals_come_along(scan, tmp_path):
    vertices, faces = scan
    mesh = bisque.Mesh(vertices, faces, colors=np.full((len(vertices), 3), 0.5),
                       normals=vertices.astype(np.float32))
    report = bisque.sort(mesh, tmp_path / "scan.tris")
    assert report["has_colors"] and report["has_normals"]


def test_files_that_are_no_meshes_are_told(tmp_path):
    points, faces = sphere(4, False)
    scan, chunks, grid = tmp_path / "a.obj", tmp_path / "a.tris", tmp_path / "a.nvdb"
    bisque.Mesh(points, faces).save(scan)
    bisque.sort(scan, chunks)
    bisque.voxelize(chunks, grid, resolution=16)
    for given, text in (([chunks, scan], "a.tris: a chunk file is no mesh"), (grid, "a.nvdb: a grid has no triangles")):
        for call in (bisque.sort, bisque.asset):
            with pytest.raises(bisque.Error, match=text) as caught:
                call(given, tmp_path / "out.glb")
            assert caught.value.status == 65
    assert {path.name for path in tmp_path.iterdir()} == {"a.obj", "a.tris", "a.nvdb"}


@pytest.mark.parametrize("given, error, text", [
    ("missing.obj", bisque.Error, "missing.obj: No such file"),
    ((np.zeros((3, 2)), np.zeros((1, 3), int)), ValueError, "vertices"),
    ((np.zeros((3, 3)), np.zeros((1, 3))), ValueError, "integers"),
    ((np.eye(3), np.array([[0, 1, 7]])), bisque.Error, "refers to vertex 7"),
    ((np.eye(3), np.array([[0, 1, -1]])), bisque.Error, "refers to vertex"),
    (42, TypeError, "int")])
def test_errors_say_what_is_wrong(given, error, text, tmp_path):
    with pytest.raises(error, match=text) as caught:
        bisque.sort(given, tmp_path / "out.tris")
    if error is bisque.Error:
        assert caught.value.status in (65, 66)
    assert not (tmp_path / "out.tris").exists()


def test_progress_its_exceptions_and_other_threads(scan, tmp_path):
    seen, ticks, at_work, over = [], [], False, False

    def tick():
        while not over:
            if at_work:
                ticks.append(None)
            time.sleep(0.001)

    def see(*what):
        nonlocal at_work
        at_work = False
        seen.append(what)
        at_work = True

    thread = threading.Thread(target=tick)
    thread.start()
    for _ in range(100):  # until the other thread ran while the library worked
        if len(ticks) <= 10:
            bisque.voxelize(scan, tmp_path / "grid.nvdb", resolution=700, progress=see)
            at_work = False
    over = True
    thread.join()
    assert {stage for stage, *_ in seen} >= {"reading", "writing"}
    assert all(0 <= done <= total for _, done, total, _ in seen if total)
    assert len(ticks) > 10  # the GIL is free

    def stop(*_):
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        bisque.voxelize(scan, tmp_path / "stopped.nvdb", progress=stop)
    assert not (tmp_path / "stopped.nvdb").exists()


def test_ctrl_c_stops_a_job(scan, tmp_path):
    write_obj(tmp_path / "scan.obj", *scan)
    code = f"""
import _thread, threading
import bisque
from bisque import core

lib, stopped = core.lib, threading.Event()

class Library:
    def __getattr__(self, name):
        return getattr(lib, name)

    def bsq_interrupt(self, ctx):
        lib.bsq_interrupt(ctx)
        stopped.set()

def report(*_):  # the work waits until the main thread has stopped it
    if not stopped.is_set():
        _thread.interrupt_main()
        stopped.wait()

core.lib = Library()
try:
    bisque.voxelize({str(tmp_path / 'scan.obj')!r}, {str(tmp_path / 'g.nvdb')!r}, progress=report)
except KeyboardInterrupt:
    print('interrupted')"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "interrupted\n", done.stderr
    assert not (tmp_path / "g.nvdb").exists()


def test_baked_arrays_are_the_files(scan, low, tmp_path):
    maps = bisque.bake(scan, low, ("normal", "mask"), size=256, sample_type="float", glb=True,
                       normal_space="tangent")
    assert maps["normal"].shape == (256, 256, 3) and maps["mask"].shape == (256, 256)
    inside = maps["mask"] == 1
    lengths = np.linalg.norm(maps["normal"][inside] * 2 - 1, axis=1)
    assert abs(lengths - 1).max() < 1e-5
    saved = maps.save(tmp_path / "sphere_<MAP>.exr")
    low.save(tmp_path / "low.obj")
    bisque.sort(scan, tmp_path / "scan.tris")
    subprocess.run([f"{BIN}/bisque-bake", tmp_path / "scan.tris", tmp_path / "low.obj", "--size",
                    "256", "--maps", "normal,mask", "--type", "float", "-o",
                    tmp_path / "tool_<MAP>.exr"], check=True, capture_output=True)
    for name, path in zip(maps, saved):
        assert bisque.compare(path, tmp_path / f"tool_{name}.exr")["max"] == 0
    assert (tmp_path / "sphere.glb").write_bytes(open(maps.glb(tmp_path / "a.glb"), "rb").read())
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
    with pytest.raises(ValueError, match="format"):
        maps.save(tmp_path / "x_<MAP>.tif")
    only = bisque.bake(scan, low, ("normal",), size=64, format="")
    assert only["normal"].shape == (64, 64, 3) and not only.files


def test_object_space_normals_are_those_of_the_formula(scan, low):
    maps = bisque.bake(scan, low, ("normal", "position", "mask"), size=256, normal_space="object",
                       sample_type="float")
    inside = maps["mask"] == 1
    points = maps["position"][inside].astype(float)
    unit = points / np.linalg.norm(points, axis=1)[:, None]
    step, gradient = 1e-4, np.zeros_like(unit)
    for k in range(3):  # of the level r - radius(direction), by differences
        sides = []
        for sign in (1, -1):
            q = points + sign * step * np.eye(3)[k]
            r = np.linalg.norm(q, axis=1)
            sides.append(r - radius_at(q / r[:, None]))
        gradient[:, k] = (sides[0] - sides[1]) / (2 * step)
    gradient /= np.linalg.norm(gradient, axis=1)[:, None]
    normals = maps["normal"][inside] * 2 - 1
    angles = np.degrees(np.arccos(np.clip((gradient * normals).sum(axis=1), -1, 1)))
    assert angles.mean() < 0.3, angles.mean()


def test_options_follow_the_table(scan, low):
    with pytest.raises(TypeError, match="no option 'sampels'"):
        bisque.bake(scan, low, sampels=2)
    with pytest.raises(ValueError, match="smooth mesh face"):
        bisque.bake(scan, low, rays="sideways")
    with pytest.raises(bisque.Error, match="samples"):
        bisque.bake(scan, low, ("normal",), samples=0)
    with pytest.raises(bisque.Error, match="roughness"):
        bisque.bake(scan, low, ("roughness",))


@pytest.mark.parametrize("library", ["uvunwrap", "xatlas"])
def test_uvs_are_checked(scan, library):
    low = bisque.unwrap(bisque.simplify(scan, triangles=800), size=256, library=library)
    report = low.report["uv"]
    assert report["overlapping_samples"] == report["flipped_triangles"] == 0
    assert 0.3 < report["used_share"] <= 1 and 1 <= report["stretch_p95"] < 3
    # A chart laid over another one, a mirrored triangle, and one outside of the square are found.
    low.uvs = np.concatenate([low.uvs, [[0.2, 0.2], [0.2, 0.8], [0.8, 0.2], [0.5, 1.5]]])
    low.uv_faces[0] = [len(low.uvs) - 4, len(low.uvs) - 3, len(low.uvs) - 2]
    low.uv_faces[1, 0] = len(low.uvs) - 1
    report = bisque.check_uvs(low, 256)
    assert report["overlapping_samples"] > 1000 and report["flipped_triangles"] > 0
    assert report["outside_triangles"] > 0


def test_temporary_files_are_named_without_their_folder(low):
    outside = bisque.Mesh(low.vertices, low.faces, low.uvs + [3, 0], low.uv_faces)
    with pytest.raises(bisque.Error, match="^low.obj: no triangle is in tile 1001"):
        bisque.check_uvs(outside, 64)


def test_a_library_that_does_not_end_is_stopped(scan):
    with pytest.raises(bisque.UnwrapError, match="fewer triangles"):
        bisque.unwrap(scan, seconds=1e-6)


@pytest.mark.parametrize("end, status", [("os.kill(os.getpid(), 9)", 71), ("os._exit(3)", 65), (
    "os.write(2, b'numpy._core._exceptions._ArrayMemoryError: 8 PiB\\n'); os._exit(1)", 71)])
def test_a_library_without_memory_is_told(end, status, tmp_path, monkeypatch):
    """As where the system kills the library's process."""
    (tmp_path / "sitecustomize.py").write_text(f"import os, sys\nif 'bisque_unwrap' in sys.orig_argv:\n    {end}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(bisque.Error) as caught:
        bisque.unwrap(sphere(2, False), size=64)
    assert caught.value.status == status


def test_distances(scan):
    low = bisque.simplify(scan, triangles=1500)
    measured = bisque.measure(low, scan)
    assert measured["from_scan"]["max"] == pytest.approx(low.report["from_scan"]["max"], rel=1e-3)


def test_programs_are_on_the_path():
    for name in ("voxelize", "simplify", "bake", "compare"):
        program = os.path.join(os.path.dirname(sys.executable), f"bisque-{name}")
        done = subprocess.run([program, "--version"], capture_output=True, text=True)
        assert done.stdout.strip() == f"bisque-{name} {bisque.version()}"


def test_textures_give_colors(scan, low, tmp_path):
    mesh = bisque.Mesh(*scan, uvs=np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]))
    mesh.uv_faces = np.tile([0, 1, 2], (len(mesh.faces), 1))
    mesh.save(tmp_path / "scan.obj")
    write_png(tmp_path / "paint.png", (255, 0, 51))
    bisque.sort(tmp_path / "scan.obj", tmp_path / "scan.tris", texture=tmp_path / "paint.png")
    maps = bisque.bake(tmp_path / "scan.tris", low, ("color", "mask"), size=64, format="png")
    # PNG files have sRGB; rows of maps have linear light.
    linear = ((51 / 255 + 0.055) / 1.055) ** 2.4
    assert np.allclose(maps["color"][maps["mask"] == 1], [1, 0, linear], atol=2e-3)


def test_small_charts_get_texels():
    rng = np.random.default_rng(2)
    ball, faces = sphere(2, False)
    places = zip(rng.uniform(0.002, 0.02, 200), rng.uniform(-2, 2, (200, 3)))
    balls = [sphere(24, True)] + [(size * ball + place, faces) for size, place in places]
    first = np.cumsum([0] + [len(v) for v, _ in balls])
    mesh = bisque.Mesh(np.concatenate([v for v, _ in balls]), np.concatenate([f + n for (_, f), n in zip(balls, first)]))
    found = bisque.unwrap(mesh, size=1024).report["uv"]
    assert found["charts"] > 200 and found["small_charts"] <= 0.05 * found["charts"]
    assert found["used_share"] >= 0.59 and found["degenerate_triangles"] == 0
    plain = bisque.uv._run(mesh, "uvunwrap", 1024, 4, 60)  # what the library alone makes
    charts = bisque.uv._charts(plain, mesh.faces)
    assert (np.bincount(charts, abs(bisque.uv._signed_areas(plain))) * 1024 ** 2 < 16).mean() > 0.1


def test_charts_that_the_library_made_points_do_not_outgrow_the_others():
    square, speck = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[2, 0, 0], [2.001, 0, 0], [2, 0.001, 0]]
    mesh = bisque.Mesh(np.array(square + speck, float), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]]))
    uvs = np.array([[[0, 0], [0.9, 0], [0.9, 0.9]], [[0, 0], [0.9, 0.9], [0, 0.9]], [[0.95, 0.95]] * 3])
    grown = bisque.uv._enlarge_small(mesh, uvs, 512)
    corners = grown.vertices[grown.faces[2]]
    assert 0.002 < np.ptp(corners, axis=0).max() < 0.2


@pytest.mark.parametrize("height", [1e-5, 0])
def test_needles_get_texels(height):
    square, needle = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 2, 0], [1, 2, 0], [0.5, 2 + height, 0]]
    mesh = bisque.Mesh(np.array(square + needle, float), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]]))
    found = bisque.unwrap(mesh, size=512).report["uv"]
    assert found["charts"] == 2 and found["small_charts"] == found["degenerate_triangles"] == 0


def asset(*arguments, code=0):
    done = run_asset(*arguments)
    assert done.returncode == code, done.stderr
    return done


def test_asset_of_a_file_goes_on_where_it_stopped(tmp_path):
    scan, out = tmp_path / "vase.obj", tmp_path / "vase.glb"
    subprocess.run([GENERATE, "--triangles", "60000", "--colors", "vase", "-o", scan], check=True)
    content = scan.read_bytes()
    given = (scan, "-o", out, "--triangles", 1500, "--size", 256, "--keep", tmp_path / "steps",
             "--memory", "512M")
    asset(*given)
    certificate = json.loads((tmp_path / "vase_asset/asset.json").read_text())
    level = certificate["levels"][0]
    assert level["triangles"] <= 1500 and level["distance"]["from_scan"]["max"] > 0
    assert level["normal_error"]["mean"] < 5 and not certificate["lost"]
    assert {"low.obj", "low.mtl", "normal.png", "color.png", "preview.png"} <= set(level["files"])
    assert "map_Kd color.png" in (tmp_path / "vase_asset/low.mtl").read_text()
    assert scan.read_bytes() == content
    grid = tmp_path / "steps/bisque-steps/grid_0.nvdb"
    times = {path: path.stat().st_mtime_ns for path in (grid, tmp_path / "steps/bisque-steps/scan.tris", out)}
    asset(*given)
    assert times == {path: path.stat().st_mtime_ns for path in times}
    grid.unlink()  # as if the job had stopped before
    asset(*given)
    assert grid.exists() and grid.stat().st_mtime_ns != times[grid]
    chunks = tmp_path / "steps/bisque-steps/scan.tris"
    assert chunks.stat().st_mtime_ns == times[chunks]


def test_asset_of_a_chunk_file_has_the_maps_that_it_can(tmp_path):
    for name, colors in (("grey", ()), ("painted", ("--colors",))):
        scan, chunks, out = (tmp_path / f"{name}.{end}" for end in ("obj", "tris", "glb"))
        subprocess.run([GENERATE, "--triangles", "20000", *colors, "vase", "-o", scan], check=True)
        bisque.sort(scan, chunks)
        asset(chunks, "-o", out, "--triangles", 500, "--size", 64, "--memory", "512M")
        assert (tmp_path / f"{name}_asset/color.png").exists() == bool(colors)
    shutil.copy(chunks, tmp_path / "-x.tris")
    assert judge(run_asset("-o", out, "--triangles", 500, "--size", 64, "--", "-x.tris", cwd=tmp_path), out)
    chunks.write_bytes(chunks.read_bytes()[:100])
    with pytest.raises(bisque.Error, match="painted.tris"):
        bisque.asset(chunks, out, triangles=500, size=64)


def test_options_of_asset_are_in_its_man_page():
    page = Path(sys.prefix, "share/man/man1/bisque-asset.1").read_text()
    told = set(re.findall(r"Fl \\-([a-z-]+)", page))
    assert told == set(re.findall(r"--([a-z-]+)", re.sub(r"(?s)^.*options:", "", asset("--help").stdout)))


def test_basecolor_is_a_name_of_color(scan, low, tmp_path):
    scan = bisque.Mesh(*scan, colors=np.full((len(scan[0]), 3), 90, np.uint8))
    assert list(bisque.bake(scan, low, "basecolor", size=16)) == ["color"]
    level, = bisque.asset(scan, tmp_path / "a.glb", low=low, size=16, maps="basecolor, color,")["levels"]
    assert "color.png" in level["files"] and "color_error" in level


def test_asset_names_the_option_that_is_meant():
    for given, meant in (("--resolution", "--size"), ("--resolutoin", "--size"), ("--trianglse=4", "--triangles"), ("--memroy", "--memory")):
        done = asset("a.obj", given, 512, code=64)
        assert done.stderr == (f"bisque-asset: unrecognized option '{given.partition('=')[0]}'; "
                               f"the nearest is {meant}\n")
    assert "see bisque-asset --help" in asset("a.obj", "--nonsense", code=64).stderr
    assert "4096 or 4k" in asset("none.obj", "-o", "a.glb", "--size", "4q", code=64).stderr
    assert "none.obj" in asset("none.obj", "-o", "a.glb", "--size", "4K", code=66).stderr
    assert "the nearest is 'normal'" in asset("none.obj", "-o", "a.glb", "--maps", "normals", code=64).stderr


def test_asset_ends_when_told_and_shows_json(tmp_path):
    scan = tmp_path / "vase.obj"
    subprocess.run([GENERATE, "--triangles", "60000", "--colors", "vase", "-o", scan], check=True)
    given = (scan, "-o", tmp_path / "vase.glb", "--triangles", 500, "--size", 64, "--json", "--progress", "json")
    with subprocess.Popen([PROGRAM, *map(str, given)], stderr=subprocess.PIPE, text=True) as job:
        step = json.loads(job.stderr.readline())
        job.terminate()
        assert "goes on from here" in job.stderr.read()
    assert job.returncode == 75 and step["stage"] == "sort: reading" and step["total"] == 1000
    done = asset(*given)
    assert json.loads(done.stdout) == json.loads((tmp_path / "vase_asset/asset.json").read_text())
    steps = [line["done"] for line in map(json.loads, done.stderr.splitlines()) if "warning" not in line]
    assert steps == sorted(steps) and len(steps) > 5


def test_progress_goes_to_a_log_as_a_line_every_30_seconds(tmp_path):
    scan = tmp_path / "vase.obj"
    subprocess.run([GENERATE, "--triangles", "20000", "vase", "-o", scan], check=True)
    code = ("import itertools, sys, types; from bisque import command; clock = itertools.count(0, 7); "
            "command.time = types.SimpleNamespace(monotonic=lambda: next(clock)); command.main(sys.argv[1:]); "
            "print(next(clock) // 7 - 1)")
    done = subprocess.run([sys.executable, "-c", code, scan, "-o", tmp_path / "vase.glb", "--triangles", "500", "--size",
                           "64"], check=True, capture_output=True, text=True)
    lines = [line for line in done.stderr.splitlines() if line.endswith(" % of all")]
    shares = [int(line.split()[-4]) for line in lines]
    assert len(lines) == int(done.stdout.split()[-1]) // 5 > 3, "one line in five reports, which are 7 seconds apart"
    assert all(re.match(r"bisque-asset: [a-z0-9 ]+: [a-z ]+: \d+ % of all$", line) for line in lines), lines
    assert shares == sorted(shares) and shares[-1] > shares[0]


def test_asset_with_a_page_has_the_same_maps(tmp_path):
    scan = tmp_path / "vase.obj"
    subprocess.run([GENERATE, "--triangles", "20000", "--colors", "vase", "-o", scan], check=True)
    given = (scan, "--triangles", 800, "--size", 64, "--memory", "512M", "--keep", tmp_path / "steps")
    levels = []
    for name, more in (("plain", ()), ("shown", ("--report",))):
        asset(*given, "-o", tmp_path / f"{name}.glb", *more)
        levels.append(json.loads((tmp_path / f"{name}_asset/asset.json").read_text())["levels"][0])
    plain, shown = levels
    page = (tmp_path / "shown_asset/report.html").read_text()
    assert page.count('"kind": "map"') == 3
    data = json.loads(re.search(r' id="data">(.*)</script>', page)[1])
    assert data["command"][:2] == ["bisque-asset", str(scan)] and data["command"][-1] == "--report"
    assert data["options"] and page.rstrip().endswith("</script>")
    assert "report.html" in shown["files"] and "report.html" not in plain["files"]
    assert {n: s for n, s in shown["files"].items() if n.endswith(".png")} == \
        {n: s for n, s in plain["files"].items() if n.endswith(".png")}
    assert shown["rays"] == pytest.approx(plain["rays"])


def test_other_sizes_and_maps_start_from_the_uvs(scan, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules["bisque.asset"], "MOST_UNWRAPPED", 32)
    kept = [tmp_path / "bisque-steps" / name for name in ("scan.tris", "low_0.ply", "mended_0.obj", "0/low.obj")]
    found = []
    for size, maps in ((32, "normal"), (64, ["normal", "height"]), (16, "normal")):
        level, = bisque.asset(scan, tmp_path / "a.glb", triangles=300, size=size, maps=maps, keep=tmp_path)["levels"]
        found.append([path.stat().st_ino for path in kept])
        assert level["size"] == size and ("height.png" in level["files"]) == (size == 64)
    assert found[0] == found[1] and found[1][:3] == found[2][:3] and found[1][3] != found[2][3]


def test_scenes_have_addresses_of_any_names(tmp_path):
    output = tmp_path / os.fsdecode(b"a #1\xff.glb")
    (_, target), *_ = bisque.museum.outputs(output, 0, 20_000, 512)
    target.write_bytes(b"x")
    level = {"placement": {"size_m": [1, 1, 1]}, "files": {target: target}, "triangles": 3}
    bisque.museum.add_scene(tmp_path / "scene", output, [(20_000, 512)], [level])
    scene = json.loads((tmp_path / "scene").read_text())
    assert scene["models"][0]["derivatives"][0]["assets"][0]["uri"] == "a%20%231%FF-20k-512-thumb.glb"


def test_levels_of_a_scan_in_memory(scan, tmp_path, monkeypatch):
    monkeypatch.setitem(bisque.PRESETS["museum"], "levels", [(300, 64), (900, 128), (600, 64)])
    monkeypatch.setitem(bisque.PRESETS["museum"], "maps", ("normal", "color"))
    seen = []
    certificate = bisque.asset(scan, tmp_path / "s.glb", preset="museum", units="cm", memory="512M",
                               progress=lambda *what: seen.append(what[1]))
    assert [level["size"] for level in certificate["levels"]] == [64, 128, 64]
    assert [level["triangles"] for level in certificate["levels"]] == [300, 900, 600]
    assert [step for step in certificate["seconds"] if "simplify" in step] == ["simplify"]  # of all levels
    names = ["s-0.3k-64-thumb.glb", "s-0.9k-128-high.glb", "s-0.9k-64-medium.glb", "s-0.9k-32-low.glb",
             *["s-0.6k-64-ar.glb"] * 2, "s-0.6k-64-ar.usdz"]
    scene = json.loads((tmp_path / "scene.svx.json").read_text())
    derivatives = scene["models"][0]["derivatives"]
    files = [derivative["assets"][0] for derivative in derivatives]
    assert [file["uri"] for file in files] == names and [file["imageSize"] for file in files][:4] == [64, 128, 64, 32]
    assert [d["usage"] for d in derivatives if d["quality"] == "AR"] == ["Web3D", "App3D", "iOSApp3D"]
    assert [file["byteSize"] for file in files] == [(tmp_path / name).stat().st_size for name in names]
    assert {path.name for kind in ("*.glb", "*.usdz") for path in tmp_path.glob(kind)} == {*names}
    with pytest.raises(ValueError, match="needs the unit"):
        bisque.asset(scan, tmp_path / "s.glb", preset="museum")
    with pytest.raises(bisque.Error, match="is of another asset"):
        bisque.asset(scan, tmp_path / "t.glb", preset="museum", units="m")
    assert (tmp_path / "s_asset/1/normal.png").exists()
    assert not (tmp_path / "s_asset/bisque-steps").exists() and not (tmp_path / "s.glb").exists()
    assert seen == sorted(seen) and 0 <= seen[0] and 500 < seen[-1] <= 1000
    errors = [level["distance"]["from_scan"]["mean"] for level in certificate["levels"]]
    assert errors[1] < errors[0] / 2


def test_random_assets_have_the_same_bytes(tmp_path):
    """Random options, the library of UVs among them, give the same files with other threads and
    budgets, of a scan in two files that is sorted before or not. SEED repeats a run."""
    seed = os.environ.get("SEED", "1")
    draw = random.Random(seed)
    print("SEED=" + seed)
    top, bottom = tmp_path / "top.obj", tmp_path / "bottom.obj"
    subprocess.run([GENERATE, "--triangles", "4000", "--colors", "vase", "-o", top], check=True)
    subprocess.run([GENERATE, "--triangles", "900", "--colors", "vase", "-o", bottom], check=True)
    for trial in range(3):
        options = ["--triangles", draw.randint(100, 900), "--size", draw.choice([64, 100, 128]),
                   "--maps", ",".join(draw.sample(["normal", "color", "ao", "height", "mask"], 2)),
                   "--samples", draw.randint(1, 3), "--surface", draw.choice(["auto", "grid", "exact"]),
                   "--unwrap", draw.choice(["uvunwrap", "xatlas"]),
                   "--min-component", draw.choice([0, 1])]
        seen = []
        for way, more in enumerate((["-j", 1, "--memory", "400M"], ["-j", 4], ["-j", 2])):
            folder = tmp_path / f"{trial}_{way}"
            folder.mkdir()
            scan = [top, bottom]
            if way == 2:
                scan = [folder / "scan.tris"]
                bisque.sort([str(top), str(bottom)], str(scan[0]))
            done = run_asset(*scan, "-o", folder / "a.glb", *options, *more)
            # Charts of xatlas overlap on some meshes.
            refused = done.returncode == 65 and "take the other library" in done.stderr
            assert refused or done.returncode == 0, (seed, trial, options, done.stderr)
            files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".glb", ".png", ".obj")]
            seen.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files})
        assert seen[0] == seen[1] == seen[2], (seed, trial, options)


def test_asset_says_what_is_wrong(tmp_path):
    done = asset(tmp_path / "missing.obj", "-o", tmp_path / "a.glb", code=66)
    assert "missing.obj: No such file" in done.stderr and "Traceback" not in done.stderr
    (tmp_path / "a.glb").write_bytes(b"a scan")
    done = asset(tmp_path / "a.glb", "-o", tmp_path / "a.glb", code=64)
    assert "would be replaced" in done.stderr and (tmp_path / "a.glb").read_bytes() == b"a scan"
    assert "must end in .glb" in asset("a.obj", "-o", tmp_path / "a.gltf", code=64).stderr

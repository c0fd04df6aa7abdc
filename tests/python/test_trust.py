"""A rerun of bisque-asset equals a fresh run, whatever happened before; and it keeps its hands off other files."""
import errno
import functools
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import bisque
import numpy as np
import pytest
from bisque import asset as asset_function
from bisque.steps import Folder
from conftest import PROGRAM, certificate_of, command_of, judge, run_asset, sphere, write_png

STAGES = ("sort", "simplify", "unwrap", "voxelize", "bake")
LONG = os.environ.get("LONG")
HOW = {"triangles": 60, "size": 32, "memory": "256M"}


def write_scan(folder, radius=1.0, color=(200, 100, 50), image="a.png"):
    """Writes an OBJ file with a library and an image."""
    folder.mkdir(exist_ok=True)
    points, faces = sphere(8, False)
    lines = ["mtllib a.mtl", "usemtl a", *("v %.6f %.6f %.6f" % tuple(p * radius) for p in points),
             "vt 0 0", "vt 1 0", "vt 0 1", *("f %d/1 %d/2 %d/3" % tuple(f + 1) for f in faces)]
    (folder / "scan.obj").write_text("\n".join(lines) + "\n")
    (folder / "a.mtl").write_text(f"newmtl a\nmap_Kd {image}\n")
    write_png(folder / "a.png", color)
    write_png(folder / "b.png", (1, 2, 200))
    return folder / "scan.obj"


def facts(output):
    """Returns all that an asset is, but for times, and the files' bytes."""
    certificate = certificate_of(output)
    for key in ("created", "seconds"):
        del certificate[key]
    for level in certificate["levels"]:
        del level["memory_high"]
    made = output.with_name(output.stem + "_asset")
    names = sorted(p.relative_to(made) for p in made.rglob("*") if "bisque-steps" not in p.parts and p.is_file())
    files = {str(name): (made / name).read_bytes() for name in names if name.name != "asset.json"}
    return certificate, files, output.read_bytes()


class Stop(KeyboardInterrupt):
    pass


def interrupted(scan, output, at, **how):
    """Runs until the first progress of a step, and stops there."""
    def progress(stage, *_):
        if stage.startswith(at):
            raise Stop
    with pytest.raises(Stop):
        bisque.asset(scan, output, progress=progress, **how)


#: What the second run asks for otherwise than the interrupted one.
OTHERS = ({"triangles": 40}, {"maps": ("normal", "color")}, {})


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """Returns the facts of fresh runs with each of OTHERS."""
    found = []
    for more in OTHERS:
        folder = tmp_path_factory.mktemp("fresh")
        bisque.asset(write_scan(folder / "in"), folder / "a.glb", **{**HOW, **more})
        found.append(without_paths(facts(folder / "a.glb"), folder))
    return found


def without_paths(found, folder):
    """Returns facts of which the certificate does not name the folder."""
    return (json.loads(json.dumps(found[0]).replace(str(folder), "")), *found[1:])


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("number, stage", list(enumerate(STAGES)))
def test_a_job_interrupted_at_each_step_goes_on_with_what_is_there_now(number, stage, kept, fresh, tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    keep = {"keep": tmp_path / "k"} if kept else {}
    for choice in range(len(OTHERS)) if LONG else [(number + kept) % len(OTHERS)]:
        interrupted(write_scan(tmp_path / "in", radius=1 + kept), out, stage, **HOW, **keep)
        assert not out.exists() and not (tmp_path / "a_asset/asset.json").exists()
        write_scan(tmp_path / "in")
        bisque.asset(scan, out, **{**HOW, **OTHERS[choice]}, **keep)
        assert without_paths(facts(out), tmp_path) == fresh[choice]
        shutil.rmtree(tmp_path / "a_asset")
        out.unlink()


def changes():
    return {"image": {"color": (9, 200, 30)}, "library": {"image": "b.png"}, "geometry": {"radius": 1.5}}


@pytest.mark.parametrize("what", changes())
def test_inputs_of_the_same_size_and_time_are_others(what, tmp_path):
    folder, out = tmp_path / "in", tmp_path / "a.glb"
    scan = write_scan(folder)
    times = {path.name: path.stat() for path in folder.iterdir()}
    bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
    before = facts(out)
    write_scan(folder, **changes()[what])
    for path in folder.iterdir():
        os.utime(path, ns=(times[path.name].st_atime_ns, times[path.name].st_mtime_ns))
        assert path.stat().st_size == times[path.name].st_size
    bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
    found = facts(out)
    assert found[1] != before[1] and certificate_of(out)["scan"]
    shutil.rmtree(tmp_path / "a_asset")
    bisque.asset(scan, out, **HOW)
    assert facts(out) == found


def test_a_missing_side_file_that_appears_is_read(tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    (tmp_path / "in/a.png").rename(tmp_path / "a.png")
    with pytest.warns(UserWarning, match="a.png"):
        certificate = bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
    assert certificate["warnings"]
    (tmp_path / "a.png").rename(tmp_path / "in/a.png")
    assert not bisque.asset(scan, out, keep=tmp_path / "k", **HOW)["warnings"]
    assert (tmp_path / "a_asset/color.png").exists()


@pytest.mark.parametrize("stage", STAGES[1:] if LONG else ["simplify", "bake"])
@pytest.mark.parametrize("name", ["scan.obj", "a.png"])
def test_an_input_replaced_meanwhile_is_an_error(stage, name, tmp_path):
    """The certificate is of what was read; a file of the same size and time is another one, too."""
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    write_scan(tmp_path / "other", radius=1.5, color=(1, 2, 3))
    path = tmp_path / "in" / name
    before = path.stat()

    def progress(now, *_):
        if now.startswith(stage) and path.stat().st_ino == before.st_ino:
            shutil.copy(tmp_path / "other" / name, tmp_path / "new")
            os.utime(tmp_path / "new", ns=(before.st_atime_ns, before.st_mtime_ns))
            os.replace(tmp_path / "new", path)

    with pytest.raises(bisque.Error, match="was changed while it was read") as caught:
        bisque.asset(scan, out, progress=progress, **HOW)
    assert caught.value.status == 74 and not out.exists()
    assert not (tmp_path / "a_asset/asset.json").exists()
    bisque.asset(scan, out, **HOW)
    certificate_of(out)


def test_damaged_notes_are_a_fresh_start(tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
    found, note = facts(out), tmp_path / "k/bisque-steps/steps.json"
    for damage in (lambda data: b"", lambda data: data[:len(data) // 2], lambda data: b"[]", lambda data: b"\xff\xfe",
                   lambda data: data.replace(b"vertices", b"verticas"), lambda data: b'{"sort": 5}'):
        damaged = damage(note.read_bytes())
        assert damaged != note.read_bytes()
        note.write_bytes(damaged)
        bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
        assert facts(out) == found


def test_a_kept_file_that_was_written_to_is_made_again(tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
    found = facts(out)
    for name in ("scan.tris", "low_0.ply", "0/low.obj", "grid_0.nvdb", "0/normal.png", "0/low.mtl"):
        path = tmp_path / "k/bisque-steps" / name
        info, data = path.stat(), path.read_bytes()
        path.write_bytes(data[:-9] + bytes(9))
        os.utime(path, ns=(info.st_atime_ns, info.st_mtime_ns))
        bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
        assert facts(out) == found and path.read_bytes() == data


def test_files_of_the_user_stay(tmp_path):
    scan, out, keep = write_scan(tmp_path / "in"), tmp_path / "a.glb", tmp_path / "k"
    mine = [keep / "scan.tris", keep / "steps.json", tmp_path / "a_asset/steps/mine", tmp_path / "a_asset/mine"]
    for path in mine:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    for more in ({"keep": keep}, {}):
        bisque.asset(scan, out, **HOW, **more)
        assert {path.read_text() for path in mine} == {"mine"}
    bisque.sort(scan, keep / "given.tris")
    data = (keep / "given.tris").read_bytes()
    bisque.asset(keep / "given.tris", out, **HOW, keep=keep)
    assert (keep / "given.tris").read_bytes() == data and not (keep / "given.tris").is_symlink()
    # A folder of that name which bisque-asset did not make, or a file.
    for make in (lambda path: (path.mkdir(), (path / "mine").write_text("mine")), lambda path: path.write_text("mine")):
        other = tmp_path / "other"
        other.mkdir()
        make(other / "bisque-steps")
        done = run_asset(scan, "-o", out, "--keep", other)
        assert judge(done, out) is None and done.returncode == 73
        assert (other / "bisque-steps/mine").exists() or (other / "bisque-steps").read_text() == "mine"
        shutil.rmtree(other)
    for given in (keep / "bisque-steps/scan.tris", tmp_path / "a_asset/low.obj"):
        shutil.copy(tmp_path / "in/scan.obj", given)
        done = run_asset(given, "-o", out, "--keep", keep)
        assert done.returncode == 64 and "would be replaced" in done.stderr and given.exists()


@pytest.mark.parametrize("name, early", [("low.obj", True), ("normal.png", False), ("asset.json", False)])
def test_files_of_the_user_are_not_replaced(name, early, tmp_path):
    """They have names that the asset would write; or they were its files, and the user changed them."""
    scan, out, mine = write_scan(tmp_path / "in"), tmp_path / "a.glb", tmp_path / "a_asset" / name
    mine.parent.mkdir()
    mine.write_text("mine")

    def refused():
        begun = []
        with pytest.raises(bisque.Error, match=f"{mine}: bisque-asset did not make this") as caught:
            bisque.asset(scan, out, progress=lambda *_: begun.append(1), **HOW)
        assert caught.value.status == 73 and mine.read_text() == "mine" and bool(begun) != early

    refused()
    assert not out.exists()
    mine.unlink()
    bisque.asset(scan, out, **HOW)
    if name != "asset.json":  # which is the note of what was made
        mine.write_text("mine")
        refused()
        mine.unlink()
    bisque.asset(scan, out, **HOW)
    certificate_of(out)


def test_an_image_of_the_scan_is_not_replaced(tmp_path):
    """The scan's own texture has the name of a map that the asset would write."""
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    (tmp_path / "a_asset").mkdir()
    os.rename(tmp_path / "in/a.png", tmp_path / "a_asset/color.png")
    (tmp_path / "in/a.mtl").write_text("newmtl a\nmap_Kd ../a_asset/color.png\n")
    data = (tmp_path / "a_asset/color.png").read_bytes()
    done = run_asset(scan, "-o", out, "--triangles", 60, "--size", 32)
    assert judge(done, out) is None and done.returncode == 64 and "would be replaced" in done.stderr
    assert (tmp_path / "a_asset/color.png").read_bytes() == data and not out.exists()


def test_an_asset_has_no_files_of_an_older_one(tmp_path, monkeypatch):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    bisque.asset(scan, out, maps=("normal", "ao", "height", "color"), report=True, **HOW)
    made = tmp_path / "a_asset"
    (made / "ao.png").write_text("mine now")
    monkeypatch.setitem(bisque.PRESETS["museum"], "levels", [(40, 16), (60, 16)])
    bisque.asset(scan, out, preset="museum", units="m", maps=("normal",))
    assert (tmp_path / "a-0.06k-16-high.glb").exists() and (tmp_path / "scene.svx.json").exists()
    assert (made / "1/low.obj").exists() and not (made / "low.obj").exists()
    bisque.asset(scan, out, maps=("normal",), **HOW)
    assert not list(tmp_path.glob("a-*.glb")) and not (tmp_path / "scene.svx.json").exists() and {path.name for path in made.iterdir()} == {
        "asset.json", "low.obj", "low.mtl", "normal.png", "preview.png", "ao.png"}
    assert (made / "ao.png").read_text() == "mine now"


def test_files_that_cannot_get_their_names_leave_no_certificate(tmp_path, monkeypatch):
    """The n-th rename fails: no certificate stands beside a file that it is not of."""
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    bisque.asset(scan, out, **HOW)
    write_scan(tmp_path / "in", radius=2)
    calls, replace = [], os.replace

    def fail(source, target):
        if Path(source).name.endswith(".new") and Path(source).parent in (tmp_path, tmp_path / "a_asset"):
            calls.append(target)
            if len(calls) == number:
                raise OSError(errno.ENOSPC, "no space", str(source))
        replace(source, target)

    for number in range(1, 99):
        calls.clear()
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", fail)
            try:
                bisque.asset(scan, out, keep=tmp_path / "k", **HOW)
                break
            except bisque.Error as error:
                assert error.status == 74
        assert not (tmp_path / "a_asset/asset.json").exists() and not list(tmp_path.rglob(".*.new"))
        if number % 3 == 0:  # what has its name already goes with the next asset, and so does the older one
            shutil.copytree(tmp_path, copy := tmp_path.with_name("copy"))
            for name in (".normal.png.new", ".asset.json.new"):
                (copy / "a_asset" / name).write_text("of a killed one")
            bisque.asset(copy / "in/scan.obj", copy / "a.glb", maps=("normal",), **HOW)
            assert {path.name for path in (copy / "a_asset").iterdir()} == {
                "asset.json", "low.obj", "low.mtl", "normal.png", "preview.png"}
            shutil.rmtree(copy)
    assert number == 9 and len(certificate_of(out)["levels"][0]["files"]) == number - 2


def test_a_folder_whose_removal_was_interrupted_is_still_known(tmp_path, monkeypatch):
    """The n-th file or folder is not removed, nor any after it."""
    for number in range(99):
        removed = []

        def remove(of, path, **more):
            if "bisque-steps" in os.fspath(path) or "dir_fd" in more:
                removed.append(path)
                if len(removed) > number:
                    raise Stop
            return of(path, **more)

        folder = Folder(tmp_path / "a_asset")
        for name in ("a", "b", "0/c", "1/d"):
            (folder.path / name).parent.mkdir(exist_ok=True)
            (folder.path / name).write_text("x")
        with monkeypatch.context() as patch:
            for name in ("unlink", "rmdir"):
                patch.setattr(os, name, functools.partial(remove, getattr(os, name)))
            try:
                folder.close(True)
                break
            except Stop:
                os.close(folder.lock)
    assert number == 8 and not list((tmp_path / "a_asset").iterdir())


def test_a_second_run_with_the_same_folder_or_output_is_kept_out(tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    for held in (tmp_path / "k", tmp_path / "a_asset"):
        lock = Folder(held)
        done = run_asset(scan, "-o", out, "--keep", tmp_path / "k", "--triangles", 60, "--size", 32)
        assert judge(done, out) is None and done.returncode == 73
        assert "another bisque-asset is at work here" in done.stderr and not out.exists()
        lock.close(False)
    assert judge(run_asset(scan, "-o", out, "--keep", tmp_path / "k", "--triangles", 60, "--size", 32), out)


def children_of(pid):
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += [int(child) for child in task.read_text().split()]
        except OSError:
            pass
    return found


def wait_until(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("kind", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_children_die_with_the_program(kind, tmp_path):
    """A bake that would take long ends when bisque-asset does, and writes nothing later."""
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    given = (scan, "-o", out, "--triangles", 60, "--size", 8192, "--samples", 16, "--surface", "exact", "--progress",
             "json")
    with subprocess.Popen(command_of(given), stderr=subprocess.PIPE, text=True, errors="replace") as job:
        children = []
        for line in job.stderr:
            if '"bake 0: ' in line:
                children = [pid for pid in children_of(job.pid)
                            if b"bisque-bake" in Path(f"/proc/{pid}/cmdline").read_bytes()]
                break
        assert children
        job.send_signal(kind)
        said = [line for line in job.stderr if not line.startswith("{")]
    assert job.returncode == (-kind if kind == signal.SIGKILL else 75)
    assert len(said) == (kind != signal.SIGKILL) and "Traceback" not in "".join(said)
    wait_until(lambda: not any(Path(f"/proc/{pid}/cmdline").exists() and
                               b"bisque-bake" in Path(f"/proc/{pid}/cmdline").read_bytes() for pid in children))
    assert not out.exists() and not list(tmp_path.rglob("low.glb"))
    again = run_asset(scan, "-o", out, "--triangles", 60, "--size", 32)
    assert judge(again, out)


@pytest.mark.parametrize("kind", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("module", ["numpy", "cffi", "_cffi_backend", "json", "subprocess"])
def test_a_signal_while_python_imports(kind, module, tmp_path):
    """A module that sends the signal stands before the real one."""
    (tmp_path / f"{module}.py").write_text(f"import os\nos.kill(os.getpid(), {int(kind)})\n"
                                         "import time\ntime.sleep(9)\n")
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = run_asset("a.obj", "-o", tmp_path / "a.glb", env=env)
    if "cffi" not in module:  # which the library may not need
        assert done.returncode == 75
    assert judge(done, tmp_path / "a.glb") is None and done.returncode in (66, 75)


def test_results_that_cannot_be_printed_are_an_error(tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    command = " ".join(f"'{word}'" for word in command_of((scan, "-o", out, "--triangles", 60, "--size", 32)))
    for more in (">/dev/full", "--json >/dev/full", ">&-", "--help >/dev/full"):
        done = subprocess.run(["sh", "-c", f"{command} {more}"], capture_output=True, text=True)
        assert done.returncode == 74 and done.stderr.startswith("bisque-asset: standard output: "), done.stderr
        assert len(done.stderr.splitlines()) == 1
    assert subprocess.run(["sh", "-c", f"{command} 2>&-"], stdout=subprocess.DEVNULL).returncode == 0


@pytest.mark.parametrize("given, code, text", [
    (("--size", "zz"), 64, "size"), (("--size", "4kk"), 64, "size"),
    (("--nothing",), 64, "--nothing"), (("--triangles", "-5"), 64, "triangles"),
    (("--triangles", "0"), 64, "triangles"), (("--triangles", "99999999999999999999"), 64, "triangles"),
    (("--size", "0"), 64, "size"), (("--samples", "-1"), 64, "samples"), (("-j", "-1"), 64, "threads"),
    (("--memory", "1x"), 64, "memory"), (("--min-component", "nan"), 64, "min_component"),
    (("--min-component", "101%"), 64, "min_component"), (("--min-triangles", "-1"), 64, "min_triangles"),
    (("--triangles", "12.5"), 64, "triangles"), (("--triangles", "101%"), 64, "triangles"),
    (("--error", "1mm"), 64, "only one"), (("--up", "w"), 64, "up: 'w'"), (("--up", "-w"), 64, "--up"),
    (("--units", "ft"), 64, "units: 'ft'"), (("--scale", "0"), 64, "scale"),
    (("--close-holes", "2ft"), 64, "close_holes"),
    (("--hard-angle", "181"), 64, "hard_angle"), (("--winding", "left"), 64, "--winding"),
    (("--unwrap-seconds", "-1"), 64, "unwrap_seconds"), (("--maps", "nothing"), 65, "nothing"),
    (("--memory", "1K"), 71, "memory"), (("--low", "missing.obj"), 66, "missing.obj"), (("--low", "/"), 66, "/"),
    (("--low", "a.obj", "--hard-angle", "20"), 64, "hard_angle: not with low"),
    (("--low", "a.obj", "--triangles", "60"), 64, "triangles: not with low"),
    (("--keep", "/dev/null/k"), 73, "/dev/null"), (("--texture", "missing.png"), 66, "missing.png"),
    (("-o", "/dev/null/a.glb"), 73, "/dev/null"), (("-o", "a.obj"), 64, ".glb"), (("-o", "/proc/a.glb"), 73, "/proc"),
    (("-o", "a<MAP>.glb"), 64, "<MAP>"), (("--keep", "k<UDIM>"), 64, "<UDIM>"),
    (("--unwrap-seconds", "0"), 65, "did not unwrap")])
def test_failures_have_their_codes(given, code, text, tmp_path):
    scan, out = write_scan(tmp_path / "in"), tmp_path / "a.glb"
    done = run_asset(scan, "-o", out, *["--triangles", 60] * ("--low" not in given), "--size", 32, *given)
    assert judge(done, out) is None and done.returncode == code and text in done.stderr, done.stderr
    assert not out.exists()


@pytest.mark.parametrize("name, env", [(b"\xff.glb", {}), ("\xe4.glb".encode(), {"LC_ALL": "C", "PYTHONUTF8": "0"}),
                                       (b"\xff.usdz", {})])
def test_names_of_any_bytes(name, env, tmp_path):
    """Programs print bytes that are not UTF-8 as escapes. Python may take all others for some, too."""
    if name.endswith(b"usdz"):
        pytest.importorskip("pxr")
    folder = Path(os.fsdecode(os.fsencode(tmp_path / "in") + b"\xe4\n\\x41"))
    scan, out = write_scan(folder), folder / os.fsdecode(name)
    done = run_asset(scan, "-o", out, "--triangles", 60, "--size", 32, "--report", env={**os.environ, **env})
    assert judge(done, out)["warnings"] == []


def test_a_folder_for_temporary_maps_has_no_token(tmp_path):
    (tmp_path / "<MAP>").mkdir()
    scan = write_scan(tmp_path / "in")
    env = {**os.environ, "TMPDIR": str(tmp_path / "<MAP>")}
    done = run_asset(scan, "-o", tmp_path / "a.glb", "--triangles", 60, "--size", 32, env=env)
    assert judge(done, tmp_path / "a.glb") is None and done.returncode == 64 and "<MAP> in the name" in done.stderr
    done = run_asset(scan, "-o", tmp_path / "<MAP>/tiles", "--tiles")
    assert done.returncode == 64 and "<MAP> in the name" in done.stderr and not list((tmp_path / "<MAP>").iterdir())


def test_files_of_the_user_have_names_of_copies(tmp_path):
    scan, out, mine = write_scan(tmp_path / "in"), tmp_path / "a.glb", tmp_path / ".a.glb.new"
    mine.write_text("mine")
    done = run_asset(scan, "-o", out, "--triangles", 60, "--size", 32)
    assert judge(done, out) is None and done.returncode == 73 and str(mine) in done.stderr
    assert mine.read_text() == "mine" and not out.exists()


def test_links_stay(tmp_path):
    """Also that of the certificate, by which the next run knows its files."""
    scan, out, made = write_scan(tmp_path / "in"), tmp_path / "a.glb", tmp_path / "a_asset"
    made.mkdir()
    for link in (out, made / "asset.json", made / "low.obj"):
        link.symlink_to(tmp_path / "in" / f"other_{link.name}")
    for _ in range(2):
        bisque.asset(scan, out, **HOW)
        assert certificate_of(out) and all(link.is_symlink() for link in (out, made / "asset.json", made / "low.obj"))


def test_scans_that_are_no_files(tmp_path):
    fifo, out = tmp_path / "fifo.obj", tmp_path / "a.glb"
    os.mkfifo(fifo)
    for scan in (fifo, tmp_path, "/dev/null"):
        done = run_asset(scan, "-o", out)
        assert judge(done, out) is None and done.returncode == 66 and "not a regular file" in done.stderr
    assert not (tmp_path / "a_asset").exists()


def test_a_bug_is_one_line(tmp_path, monkeypatch, capsys):
    from bisque import command

    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    for failure, code in ((KeyError("stage"), 70), (MemoryError(), 71), (RecursionError("deep"), 70),
                          (OSError(errno.EIO, "bad disk", "x"), 74), (OSError(errno.EACCES, "no", "x"), 73),
                          (TypeError("odd"), 64), (KeyboardInterrupt(), 75)):
        monkeypatch.setattr(command, "asset", lambda *_, failure=failure, **__: (_ for _ in ()).throw(failure))
        try:
            assert command.main(["a.obj", "-o", str(tmp_path / "a.glb")]) == (70 if code == 64 else code)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        said = capsys.readouterr().err
        assert said.startswith("bisque-asset: ") and len(said.splitlines()) == 1
    assert callable(asset_function) and PROGRAM

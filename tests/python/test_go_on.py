"""bisque-asset and unwrap(), interrupted at random calls: the next run, of whatever inputs and options, equals a
fresh one, and no temporary file stays."""
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import bisque
from conftest import FAILURES, sphere, without_progress
from test_never_falls import in_parallel
from test_trust import write_scan

FAULTS = os.environ["FAULTS"]
#: Each is a fresh run and INTERRUPTIONS others, each of which is followed by the first command again.
LONG = os.environ.get("LONG")
TRIALS = int(os.environ.get("TRIALS", 400 if LONG else 3))
INTERRUPTIONS = 5
#: The levels of a preset are too large for a test. The picture of a bake, of the same size for any asset, takes half of
#: the time (tests/combine interrupts bakes with pictures), views for the errors a sixth.
ASSET = """
import sys
import bisque_start
from bisque import programs, seen
from bisque.asset import PRESETS

def run(name, words, *others):
    if "--preview" in words:
        at = words.index("--preview")
        words[at + 1].write_bytes(b"a picture")
        words = words[:at] + words[at + 2:]
    return run_whole(name, words, *others)

run_whole, programs.run = programs.run, run
PRESETS["museum"]["levels"], seen.SIDE = [(40, 64), (80, 128)], 48
sys.exit(bisque_start.asset())
"""
UNWRAP = ("import sys, bisque; words = sys.argv[1:]; "
          "bisque.unwrap(words[0], library=words[1], size=64, threads=int(words[2])).save('low.obj')")
CALLS = ("open", "read", "map", "write", "sync", "size", "name", "remove", "close")
CHOICES = {"--maps": ["normal", "normal,color", "ao,height", "color,curvature"], "--samples": ["1", "2"],
           "--surface": ["grid", "exact"], "--unwrap": ["xatlas"], "--min-component": ["1%"], "--up": ["z"],
           "--units": ["mm"], "--close-holes": ["5%"], "--hard-angle": ["5"], "--winding": ["keep"], "--report": [None],
           "--low": ["in/low.obj"], "--texture": ["in/b.png"], "--keep": ["k"], "-j": ["1", "3"], "--memory": ["64M"]}


def draw_inputs(draw):
    return {"radius": draw.choice([1, 1.5]), "color": draw.choice([(200, 100, 50), (9, 200, 30)]),
            "image": draw.choice(["a.png", "b.png"])}


def write_inputs(folder, given):
    """Writes a scan as a mesh and as a chunk file, and a low-poly mesh; all inputs have the same times. They are
    copies, because a chunk file names its images by their places."""
    kept = folder.parents[1] / f"in {given}"
    if not kept.exists():
        scan = write_scan(kept, **given)
        points, faces = sphere(3, False)
        bisque.Mesh(points * given["radius"], faces).save(kept / "low.obj")
        for path in kept.iterdir():
            os.utime(path, (10 ** 9, 10 ** 9))
        bisque.sort(scan, kept / "scan.tris")
        os.utime(kept / "scan.tris", (10 ** 9, 10 ** 9))
    shutil.copytree(kept, folder, dirs_exist_ok=True)


def fitting(words):
    """Returns a command without options that a mesh of the user does not have, if it has one."""
    if "--low" not in words:
        return words
    others = ("--triangles", "--min-component", "--close-holes", "--hard-angle", "--winding")
    return [word for i, word in enumerate(words) if word not in others and words[i - 1] not in others]


def draw_asset(draw):
    words = ["-c", ASSET, draw.choice(["in/scan.obj", "in/scan.obj", "in/scan.tris"]), "-o", "a.glb"]
    words += ["--preset", "museum", "--units", "m"] if draw.random() < 0.2 else [
        "--triangles", draw.choice(["40", "60"]), "--size", draw.choice(["64", "128"])]
    for name, values in CHOICES.items():
        if draw.random() < (0.5 if name == "--keep" else 0.2):
            value = draw.choice(values)
            words += [name] if value is None else [name, value]
    return fitting(words)


def draw_unwrap(draw):
    return ["-c", UNWRAP, "in/low.obj", draw.choice(["uvunwrap", "xatlas"]), draw.choice(["1", "3"])]


def changed(draw, drawn, words):
    """Returns another command like the one of these words, or the same one."""
    return draw.choice([words, drawn(draw), fitting(words + ["--triangles", "50"]) if drawn is draw_asset else words])


def run(folder, words, **faults):
    """Runs a command in a folder. Returns its exit code and its lines."""
    temporary = folder / "temporary"
    temporary.mkdir(exist_ok=True)
    environment = {**os.environ, "TMPDIR": str(temporary)}
    if faults:
        environment |= {"LD_PRELOAD": FAULTS, "FAULT_UNDER": os.path.realpath(folder), **faults}
    done = without_progress(subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True,
                                           text=True, errors="replace"))
    assert done.returncode in (0, *FAILURES, -signal.SIGKILL) or UNWRAP in words, (done.returncode, done.stderr)
    said = [line for line in done.stderr.splitlines() if not line.startswith("bisque-asset: warning: ")]
    assert len(said) == (done.returncode > 0) or UNWRAP in words, done.stderr
    if faults.get("FAULT_STICKY") or done.returncode in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGHUP):
        shutil.rmtree(temporary)  # Python could not
    else:
        # Python tries a folder with a file of letters, which may stay.
        assert not [*temporary.glob("*[-.]*"), *folder.rglob(".*.new")], "a temporary file is left"
    return done.returncode, sorted(done.stderr.splitlines())


def content(path):
    """Returns what a file has, but for times and the memory that was used."""
    if path.suffix == ".html":
        return "a report, which has times"
    if path.name != "asset.json":
        return hashlib.sha256(path.read_bytes()).hexdigest()
    certificate = json.loads(path.read_text())
    for key in ("created", "seconds"):
        del certificate[key]
    for level in certificate["levels"]:
        del level["memory_high"]
        level["files"].pop("report.html", None)
    return certificate


def made_in(folder):
    """Returns the content of all outputs, by their names."""
    names = (path.relative_to(folder) for path in folder.rglob("*"))
    return {str(name): content(folder / name) if (folder / name).is_file() else "a folder" for name in names
            if name.parts[0] not in ("in", "k", "temporary", "calls")}


def differences(a, b, name=""):
    """Returns what differs in two trees of dictionaries, as "name: one, other"."""
    if isinstance(a, dict) and isinstance(b, dict):
        return sum((differences(a.get(key), b.get(key), f"{name}/{key}") for key in {**a, **b}), [])
    return [] if a == b else [f"{name}: {a}, {b}"]


def draw_fault(draw, calls):
    """Returns settings of faults.c that send a signal at a random one of these calls, each "number call path", or of
    those on a random file."""
    paths = [line.split(" ", 2)[2] for line in calls if line.count(" ") > 1]
    # Of names that are random, only the start.
    names = {re.sub(r"^(#|bisque-(?!steps)).*|\w+\.tmp$", r"\1", os.path.basename(path)) for path in paths}
    name = draw.choice(sorted(names)) if draw.random() < 0.7 else ""
    return {"FAULT_CALLS": " ".join(CALLS), "FAULT_PATH": name, "FAULT_DO": draw.choice(["TERM", "INT", "HUP", "KILL"]),
            "FAULT_STICKY": draw.choice(["", "", "1"]),  # and each call after it: a second signal ends a job at once
            "FAULT_AT": str(draw.randint(1, sum(name in path for path in paths)))}


def run_trial(seed, folder):
    """Returns how the interrupted runs ended, and, in a list, the seed of a failure, which is printed."""
    draw, codes = random.Random(seed), []
    drawn = draw_unwrap if draw.random() < 0.1 else draw_asset
    words, inputs = drawn(draw), draw_inputs(draw)
    fresh, again = folder / "fresh", folder / "again"
    for place in (fresh, again):
        place.mkdir(parents=True)
    write_inputs(fresh / "in", inputs)
    expected = run(fresh, words, FAULT_CALLS=" ".join(CALLS), FAULT_LOG=str(fresh / "calls"))
    calls = (fresh / "calls").read_text(errors="replace").splitlines()
    for _ in range(INTERRUPTIONS):
        first, fault = changed(draw, drawn, words), draw_fault(draw, calls)
        write_inputs(again / "in", draw_inputs(draw) if draw.random() < 0.5 else inputs)
        try:
            codes.append(run(again, first, **fault)[0])
            write_inputs(again / "in", inputs)
            assert run(again, words) == expected, "another end"
            wanted, made = made_in(fresh), made_in(again)
            if "a.glb" not in wanted:  # levels have other names, and what a user named before stays
                made.pop("a.glb", None)
            other = differences(wanted, made) if expected[0] == 0 else []
            assert not other, "\n".join(other)
        except AssertionError as error:
            print(f"trial {seed} in {again}: {first[2:]} with {fault}, then {words[2:]}: {error}", flush=True)
            return codes, [seed]
    shutil.rmtree(folder)
    return codes, []


def test_the_next_run_equals_a_fresh_one(tmp_path):
    """SEED, FIRST and TRIALS repeat trials; LONG=1 draws another seed."""
    seed = os.environ.get("SEED", str(time.time_ns()) if LONG else "3")
    first = int(os.environ.get("FIRST", "0"))
    found = in_parallel(lambda n: run_trial(f"{seed}:{n}", tmp_path / str(n)), range(first, first + TRIALS))
    codes, failures = (sum(lists, []) for lists in zip(*found))
    ended = sum(code in (75, -signal.SIGKILL) for code in codes)
    print(f"seed {seed}: {TRIALS} trials, {len(codes)} runs before the last one, {ended} of which were interrupted")
    assert not failures
    assert ended > len(codes) / (4 if LONG else 10)  # few trials may be unlucky

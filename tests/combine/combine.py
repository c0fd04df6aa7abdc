#!/usr/bin/env python3
"""Bakes random scenes with random options in many ways that must give the same bytes.

usage: combine.py [--seed TEXT] [--trials N] [--first I] [--seconds S] [--jobs N] [--keep DIRECTORY]

Each trial makes grids and bakes maps once, and again with other threads and budgets, as tasks in
random order, with shuffled scans and options, without options that have no effect, and on devices.
A failure is reduced to few options and printed as commands; its files are kept. Options come from
the programs (`--list-options`), so new ones take part. BIN and TESTS are the directories of the
programs and of the test programs.
"""

import argparse
import collections
import concurrent.futures
import hashlib
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time

import options
import trial as trials

BIN, TESTS = (os.path.abspath(os.environ[name]) for name in ("BIN", "TESTS"))
DOCUMENTED = {0, 1, 64, 65, 66, 69, 71}
NO_MEMORY, NO_DEVICE = 71, 69


class Failure(Exception):
    """A promise that was broken, and the commands that show it."""


class Runner:
    """Runs the programs of one trial, each way in a directory of its own beside `in`."""

    def __init__(self, top):
        self.top, self.commands = top, []

    def directory(self, way):
        path = os.path.join(self.top, way)
        shutil.rmtree(path, ignore_errors=True)
        os.makedirs(path)
        self.way = way
        self.commands = []
        return path

    def run(self, program, arguments, environment=None):
        """Returns the exit code and standard error; fails if either is not as documented."""
        where = os.path.join(self.top, self.way)
        prefix = "".join("%s=%s " % item for item in (environment or {}).items())
        self.commands.append("(cd %s && %s%s)" % (self.way, prefix, shlex.join([program] + arguments)))
        try:
            done = subprocess.run([os.path.join(BIN, program)] + arguments, cwd=where, stdin=subprocess.DEVNULL,
                                  capture_output=True, timeout=120, env={**os.environ, **(environment or {})})
        except subprocess.TimeoutExpired:
            raise Failure("no end after 120 s")
        err = done.stderr.decode(errors="replace")
        if done.returncode not in DOCUMENTED:
            raise Failure("exit code %d: %s" % (done.returncode, err[-500:]))
        said = [line for line in re.split(r"[\r\n]|\x1b\[K", err)
                if line.startswith(program + ": ") and not line.startswith(program + ": warning: ")]
        if done.returncode >= 64 and len(said) != 1:
            raise Failure("exit code %d with %d lines: %s" % (done.returncode, len(said), err[-500:]))
        for path, _, names in os.walk(where):
            if any(name.endswith(".tmp") for name in names):
                raise Failure("a temporary file is left in %s" % path)
        self.out = done.stdout
        return done.returncode, err

    def maps(self):
        """Returns the checksums of the outputs of a bake."""
        return self.files(lambda name: name.startswith("m_") or name == "look.png")

    def files(self, wanted):
        where = os.path.join(self.top, self.way)
        return {name: digest(os.path.join(where, name)) for name in sorted(os.listdir(where)) if wanted(name)}


def digest(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def expect_same(code, found, base_code, base, may_fail=(), leave_out=()):
    """Compares the exit code and files with those of the first run."""
    if code in may_fail and base_code != code:
        return
    if code != base_code:
        raise Failure("exit code %d, not %d" % (code, base_code))
    for name in leave_out:
        found, base = ({k: v for k, v in files.items() if k != name} for files in (found, base))
    if found != base:
        names = [name for name in {**found, **base} if found.get(name) != base.get(name)]
        raise Failure("other files or bytes: %s" % ", ".join(sorted(names)))


# ---- grids ----


def voxelize(runner, scan, output, more=(), files=None):
    return runner.run("bisque-voxelize", trials.words(scan.given) + list(more) + (files or scan.files) + ["-o", output])


def accepted(runner, scan, rng, files=None):
    """Makes a grid; options that are refused are dropped. Returns the exit code."""
    output = scan.name + ".nvdb"
    code, err = voxelize(runner, scan, output, (), files)
    while code in (64, 65) and (drop := trials.named_in(err, scan.given, rng)):
        scan.given = [(option, value) for option, value in scan.given if option is not drop]
        code, err = voxelize(runner, scan, output, (), files)
    return code


def from_chunks(runner, scan, rng):
    """Makes the grid again from its chunk file, which has what the refused options did."""
    given = scan.given
    if any(option.name == "channels" and "=" in value for option, value in given):
        return
    runner.directory("grid")
    code = accepted(runner, scan, rng, ["../in/%s.tris" % scan.name])
    grid = scan.name + ".nvdb"
    expect_same(code, runner.files(grid.__eq__), 0, {grid: digest(os.path.join(runner.top, "in", grid))})
    scan.given = given


def grid_files(runner, scan):
    return runner.files(lambda name: name.startswith(scan.name) and name.endswith((".nvdb", ".tris")))


def make_grids(runner, trial, rng):
    """Makes all grids. Returns whether all were made; options that are refused are dropped."""
    made = True
    for scan in trial.scans:
        runner.directory("grid")
        runner.way = "in"
        code = accepted(runner, scan, rng)
        base = grid_files(runner, scan)
        runner.directory("grid")
        other, _ = voxelize(runner, scan, scan.name + ".nvdb", ["--threads", "%d" % rng.randint(1, 5),
                                                              "--memory", "%dM" % rng.randint(24, 400)])
        expect_same(other, grid_files(runner, scan), code, base, [NO_MEMORY])
        if code == 0 and rng.random() < 0.3:
            other, _ = voxelize(runner, scan, scan.name + ".nvdb", ["--resume"])
            expect_same(other, grid_files(runner, scan), code, base)
        if code == 0 and rng.random() < 0.5:
            from_chunks(runner, scan, rng)
        made = made and code == 0
    return made


# ---- bakes ----


def bake_words(trial, given=None, scans=None, rng=None, old=False):
    given = trial.bake if given is None else given
    scans = trial.scans if scans is None else scans
    return trials.words(given, rng, old) + [scan.path for scan in scans] + trial.lows + ["-o", trial.name]


def bake(runner, trial, more=(), environment=None, device="cpu", **kept):
    return runner.run("bisque-bake", ["--device", device] + bake_words(trial, **kept) + list(more), environment)


def other_threads(runner, trial, base, rng):
    code, _ = bake(runner, trial, ["--threads", "%d" % rng.choice([1, 2, 3, 5, 8])])
    expect_same(code, runner.maps(), *base[:2])


def other_budget(runner, trial, base, rng):
    code, _ = bake(runner, trial, ["--memory", "%dM" % rng.choice([20, 24, 32, 50, 100, 400])])
    expect_same(code, runner.maps(), *base[:2], [NO_MEMORY], ["look.png"])


def other_order(runner, trial, base, rng):
    scans = list(trial.scans)
    rng.shuffle(scans)
    code, _ = bake(runner, trial, scans=scans, rng=rng, old=rng.random() < 0.5)
    expect_same(code, runner.maps(), *base[:2])


def without_options_without_effect(runner, trial, base, rng):
    idle = set(re.findall(r"warning: --([a-z- ]+) has no effect", base[2]))
    if idle:
        code, _ = bake(runner, trial, given=[(o, v) for o, v in trial.bake if o.id not in idle])
        expect_same(code, runner.maps(), *base[:2])


def as_tasks(runner, trial, base, rng):
    """Divides the bake into tasks, which run in any order, some together and some twice."""
    count, given = rng.choice([1, 2, 3, 5, 40]), list(trial.bake)
    plan = ["--tasks", "%d" % count, "--write-plan", "plan.json"]
    code, err = bake(runner, trial, plan)
    err = "".join(line for line in err.splitlines() if "warning: " not in line)
    unplanned = [option for option, value in given
                 if code == 64 and ("--" + option.name in err or len(value) > 3 and value in err)]
    if unplanned:  # an output that a plan refuses
        given = [(option, value) for option, value in given if option not in unplanned]
        base = base[0], {name: v for name, v in base[1].items() if not name.startswith("m_" + unplanned[0].name)}
        code, _ = bake(runner, trial, plan, given=given)
    order = list(range(count))
    rng.shuffle(order)
    codes = [code]
    if code == 0 and rng.random() < 0.3:
        order = ["0-%d" % (count - 1)] + order[:1]
    for task in order if code == 0 else []:
        code, _ = runner.run("bisque-bake", ["--plan", "plan.json", "--task", str(task), "--threads",
                                             "%d" % rng.randint(1, 4), "--memory", "%dM" % rng.choice([60, 500])])
        if code == NO_MEMORY:
            code, _ = runner.run("bisque-bake", ["--plan", "plan.json", "--task", str(task)])
        codes.append(code)
        if code >= 64:
            break
    tiles = rng.random() < 0.4
    if max(codes) < 64 and tiles:
        code, _ = runner.run("bisque-bake", ["--plan", "plan.json", "--merge-tile", "0"])
        codes.append(code if code >= 64 else 0)
    if max(codes) < 64:
        code, _ = runner.run("bisque-bake", ["--plan", "plan.json", "--merge"])
        codes.append(code)
    if base[0] >= 64:
        if max(codes) < 64 or runner.maps():
            raise Failure("exit codes %s of tasks, %d of the bake" % (codes, base[0]))
        return
    expect_same(max(codes), runner.maps(), *base[:2])


def has_device(trial):
    """Returns whether a device other than the processor can trace the scans."""
    return len(trial.scans) == 1 and trial.scans[0].kind == "nvdb"


def on_fake_cuda(runner, trial, base, rng):
    if not has_device(trial):
        return
    environment = {"LD_LIBRARY_PATH": os.path.join(TESTS, "fake")}
    code, _ = bake(runner, trial, [], environment, "cuda")
    expect_same(code, runner.maps(), *base[:2], [NO_DEVICE])


def on_opencl(runner, trial, base, rng):
    """Only the processor and CUDA promise equal bytes; OpenCL has to give the same files."""
    if not has_device(trial):
        return
    code, _ = bake(runner, trial, [], None, "opencl")
    if code != NO_DEVICE and (code == 0) != (base[0] == 0):
        raise Failure("exit code %d, not %d" % (code, base[0]))
    if code == 0 and set(runner.maps()) != set(base[1]):
        raise Failure("other files")


def compared(runner, trial, base, rng):
    """A map is the same as itself, whatever is compared and by however many threads."""
    names = [name for name in base[1] if name.endswith(".exr")]
    if not names:
        return
    name, seen = "../base/" + rng.choice(names), []
    for threads in "1", "4":
        code, _ = runner.run("bisque-compare", trials.words(trial.compare) + ["--threads", threads, name, name])
        seen.append((code, runner.files(lambda n: n.endswith(".png"))))
    expect_same(*seen[1], *seen[0])


# How often each way runs.
WAYS = [(other_threads, 0.8), (other_budget, 0.5), (other_order, 0.5), (without_options_without_effect, 0.5),
        (as_tasks, 0.6), (on_fake_cuda, 0.3), (on_opencl, 0.05), (compared, 0.3)]


def first_bake(runner, trial, rng, redraw=True):
    """Bakes in the directory `base`; options of wrong usage are dropped. Returns code and maps."""
    while True:
        runner.directory("base")
        code, err = bake(runner, trial)
        drop = trials.named_in(err, trial.bake, rng) if code == 64 and redraw else None
        if not drop:
            return code, runner.maps(), err
        trial.bake = [(option, value) for option, value in trial.bake if option is not drop]


def run_way(runner, trial, base, way, seed):
    """Runs a way with random numbers of its own, so that it can be repeated. Returns a failure or None."""
    try:
        runner.directory(way.__name__)
        way(runner, trial, base, random.Random(seed))
    except Failure as failure:
        return failure
    return None


def shrink(runner, trial, way, seed):
    """Drops options and scans as long as the way fails."""

    def fails():
        try:
            return run_way(runner, trial, first_bake(runner, trial, None, False), way, seed) is not None
        except Failure:
            return False

    for name in ("bake", "scans"):
        kept = list(getattr(trial, name))
        for one in [item for item in kept if name == "scans" or item[0].name not in trials.SIZES]:
            less = [item for item in kept if item is not one]
            setattr(trial, name, less)
            if (less or name == "bake") and fails():
                kept = less
        setattr(trial, name, kept)
    fails()


def run_trial(seed, tables, keep):
    """Runs a trial. Returns how it ended, and a text on its failure or None."""
    rng = random.Random(seed)
    top = tempfile.mkdtemp(prefix="bisque-combine.")
    runner = Runner(top)
    os.makedirs(os.path.join(top, "in"))
    base = way = None
    try:
        trial = trials.Trial(rng, os.path.join(top, "in"), tables)
        if not make_grids(runner, trial, rng):
            return "no grid", None
        base = first_bake(runner, trial, rng)
        made = runner.commands
        for way, share in WAYS:
            if rng.random() > share:
                continue
            way_seed = rng.random()
            failure = run_way(runner, trial, base, way, way_seed)
            if failure:
                shrink(runner, trial, way, way_seed)
                base = first_bake(runner, trial, rng, False)
                made = runner.commands
                raise run_way(runner, trial, base, way, way_seed) or failure
        return "exit code %d" % base[0], None
    except Failure as failure:
        lines = ["%s%s" % (way.__name__ + ": " if way else "", failure)]
        lines += (made if base else []) + runner.commands
        if keep:
            kept = os.path.join(keep, seed.replace(":", "-"))
            shutil.copytree(top, kept, dirs_exist_ok=True)
            lines.append("files: " + kept)
        return "failure", "\n".join(lines)
    finally:
        shutil.rmtree(top, ignore_errors=True)


def main():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--seed", default=time.strftime("%Y%m%d"))
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--keep")
    arguments = parser.parse_args()
    tables = {name: options.read(os.path.join(BIN, name)) for name in trials.OWN}
    ends, lock, stop = collections.Counter(), threading.Lock(), time.monotonic() + arguments.seconds

    def one(number):
        if time.monotonic() > stop:
            return
        seed = "%s:%d" % (arguments.seed, number)
        end, text = run_trial(seed, tables, arguments.keep)
        with lock:
            ends[end] += 1
            if text:
                print("not ok - trial %d of seed %s\n%s" % (number, arguments.seed, text), flush=True)

    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        list(pool.map(one, range(arguments.first, arguments.first + arguments.trials)))
    print("seed %s, %d trials: %s" % (arguments.seed, sum(ends.values()),
                                      ", ".join("%s %d" % item for item in sorted(ends.items()))))
    for name in sorted(trials.UNKNOWN):
        print("not drawn: --%s, which needs a function in trial.py" % name)
    return 1 if ends["failure"] else 0


if __name__ == "__main__":
    sys.exit(main())

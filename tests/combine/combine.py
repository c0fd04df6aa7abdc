#!/usr/bin/env python3
"""Bakes random scenes with random options in many ways that must give the same bytes.

usage: combine.py [--seed TEXT] [--trials N] [--first I] [--seconds S] [--jobs N] [--keep DIRECTORY]

Each trial makes grids, simplifies a scan and bakes maps: each once, and again with other threads,
instructions and budgets, in another order, without options that should not matter, through a pipe, from
chunk files, as tasks in random order, and on devices. A failure is reduced to few options and printed as commands;
its files are kept. A table at the end says how often each way ran. Options come from the programs
(`--list-options`), so new ones take part. BIN and TESTS are the directories of the programs and of
the test programs.
"""

import argparse
import collections
import concurrent.futures
import hashlib
import json
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
FAULTS = {71, 73, 74, 75, -9}  # how a program may end if a call fails or a signal comes
CALLS = "open read map write sync size name remove close"  # of tests/faults/faults.c
DISTANCES = {"from_scan", "to_scan", "diagonal"}  # of the report of bisque-compare


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

    def run(self, program, arguments, environment=None, stdin=os.devnull):
        """Returns the exit code and standard error; fails if either is not as documented. The environment may
        have settings of tests/faults/fault.h."""
        environment = environment or {}
        programs = os.path.join(TESTS, "bin") if environment.get("FAULT_CALLS") == "check" else BIN
        where = os.path.join(self.top, self.way)
        prefix = "".join("%s=%s " % item for item in environment.items())
        source = "" if stdin == os.devnull else " <" + shlex.quote(stdin)
        self.commands.append("(cd %s && %s%s%s)" % (self.way, prefix, shlex.join([program] + arguments), source))
        try:
            with open(os.path.join(where, stdin), "rb") as pipe:
                done = subprocess.run([os.path.join(programs, program)] + arguments, cwd=where, stdin=pipe,
                                      capture_output=True, timeout=3600, env={**os.environ, **environment})
        except subprocess.TimeoutExpired:
            raise Failure("no end after an hour")
        err = done.stderr.decode(errors="replace")
        if done.returncode not in DOCUMENTED | (FAULTS if "FAULT_DO" in environment else set()):
            raise Failure("exit code %d: %s" % (done.returncode, err[-500:]))
        said = [line for line in re.split(r"[\r\n]|\x1b\[K", err)
                if re.match(program + r": (?!warning: |[\d,]+ rays, about |[a-z]+( [a-z]+)?: \d)", line)]
        self.said = "".join(said)
        if done.returncode >= 64 and len(said) != 1:
            raise Failure("exit code %d with %d lines: %s" % (done.returncode, len(said), err[-500:]))
        self.out = done.stdout
        shown = (err + self.out.decode(errors="replace")).replace("\x1b[K", "")
        if re.search(trials.FORGED + "|[\0-\x08\x0b\x0c\x0e-\x1f\x7f]", shown):
            raise Failure("a name controls the terminal: %r" % shown[-500:])
        if "--json" in arguments and done.returncode < 64 and self.out and not is_json(self.out):
            raise Failure("no JSON: %r" % self.out[-500:])
        for path, _, names in os.walk(where):
            if any(name.endswith(".tmp") for name in names):
                raise Failure("a temporary file is left in %s" % path)
        if os.listdir(os.path.join(self.top, "in", trials.TEMPORARY)):
            raise Failure("a temporary file is left in the directory of --tmpdir")
        return done.returncode, err

    def files(self, wanted):
        where = os.path.join(self.top, self.way)
        return {name: digest(os.path.join(where, name)) for name in sorted(os.listdir(where)) if wanted(name)}


def is_json(text):
    try:
        return json.loads(text) is not None
    except ValueError:
        return False


def digest(path):
    if path.endswith(".html"):
        return "a report, which has times"
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def expect_same(code, found, base, may_fail=(), leave_out=()):
    """Compares the exit code and files with those of the first run."""
    if code in may_fail and base.code != code:
        return
    if code != base.code:
        raise Failure("exit code %d, not %d" % (code, base.code))
    found, files = ({k: v for k, v in one.items() if k not in leave_out} for one in (found, base.files))
    if found != files:
        names = [name for name in {**found, **files} if found.get(name) != files.get(name)]
        raise Failure("other files or bytes: %s" % ", ".join(sorted(names)))


# ---- what a trial does ----

First = collections.namedtuple("First", "code files err")  # how the first run ended


class Job:
    """A command of a trial, which must give the same files in whatever way it runs."""

    directory, refused = "first", (64, 65)

    def __init__(self, trial):
        self.trial = trial

    @property
    def given(self):
        return getattr(*self.lists()[0])

    def first(self, runner, seed):
        """Runs it as given. With a seed, options that are refused are dropped."""
        runner.directory("first")
        runner.way = self.directory
        while True:
            code, err = self.run(runner)
            drop = seed and code in self.refused and trials.named_in(err, self.given, random.Random(seed))
            if not drop:
                return First(code, self.files(runner), err)
            setattr(*self.lists()[0], [(option, value) for option, value in self.given if option is not drop])


class Grid(Job):
    directory = "in"

    def __init__(self, trial, scan):
        super().__init__(trial)
        self.scan, self.name = scan, scan.name + ".nvdb"

    def lists(self):
        return [(self.scan, "given")]

    def run(self, runner, more=(), given=None, rng=None, output=None, files=None, stdin=os.devnull,
            environment=None):
        given = self.given if given is None else given
        words = trials.words(given, rng) + list(more) + (files or self.scan.files)
        return runner.run("bisque-voxelize", words + ["-o", output or self.name], environment, stdin)

    def files(self, runner):
        return runner.files(lambda name: name.startswith(self.scan.name) and name.endswith((".nvdb", ".tris")))


class Bake(Job):
    refused = (64,)

    def lists(self):
        return [(self.trial, "bake"), (self.trial, "scans")]

    def run(self, runner, more=(), given=None, rng=None, scans=None, environment=None, device="cpu"):
        trial = self.trial
        given = trial.bake if given is None else given
        files = [scan.path for scan in scans or trial.scans] + trial.lows
        words = ["--device", device] + trials.words(given, rng) + files + ["-o", trial.name] + list(more)
        return runner.run("bisque-bake", words, environment)

    def files(self, runner):
        return runner.files(lambda name: name == "look.png" or (name.startswith("m_") and "part-" not in name))


class Simplification(Job):
    """Makes low-poly meshes of a scan; reports are compared, too."""

    def __init__(self, trial):
        super().__init__(trial)
        self.scan = trial.scans[0]

    def lists(self):
        return [(self.trial, "simplify")]

    def run(self, runner, more=(), given=None, rng=None, files=None, environment=None):
        given = self.given if given is None else given
        words = trials.words(given, rng) + list(more) + (files or self.scan.files)
        return runner.run("bisque-simplify", words + ["-o", self.trial.low_name], environment)

    def files(self, runner):
        return runner.files(lambda name: name.startswith("m_"))


# ---- ways to run any of them; they return False if they do not apply ----


def other_threads(runner, job, base, rng):
    """Other instructions, too, of those that this processor has."""
    level = {"BSQ_SIMD": rng.choice(["sse4.2", "avx2", "avx512"])}
    code, _ = job.run(runner, ["--threads", "%d" % rng.choice([1, 2, 3, 5, 8])], environment=level)
    expect_same(code, job.files(runner), base)


def other_budget(runner, job, base, rng):
    code, _ = job.run(runner, ["--memory", "%dM" % rng.choice([20, 24, 32, 50, 100, 400])])
    expect_same(code, job.files(runner), base, [NO_MEMORY], ["look.png"])


def other_order(runner, job, base, rng):
    kept = {}
    if isinstance(job, Bake):
        kept = {"scans": rng.sample(job.trial.scans, len(job.trial.scans))}
    code, _ = job.run(runner, rng=rng, **kept)
    expect_same(code, job.files(runner), base)


def without_options_without_effect(runner, job, base, rng):
    """Leaves out one option that should not matter, or all of them."""
    told = re.findall(r"warning: --([a-z- ]+) has no effect", base.err)
    idle = [one for one in job.given if one[0].id in told or one[0].name in trials.IDLE]
    if not idle:
        return False
    left_out = idle if rng.random() < 0.3 else [rng.choice(idle)]
    while True:
        code, err = job.run(runner, given=[one for one in job.given if one not in left_out])
        needing = [one for one in idle if one not in left_out and "--%s" % one[0].id in err]
        if code != 64 or base.code == 64 or not needing:
            break
        left_out = left_out + needing[:1]  # it needs one that was left out
    expect_same(code, job.files(runner), base)


def counted(runner, environment, run):
    """Returns how many calls, or looks for an interruption, there are in a run; of several processes, the most."""
    path = os.path.join(runner.top, "count")
    run({**environment, "FAULT_COUNT": path})
    with open(path) as file:
        most = max(int(line.split()[0]) for line in file)
    os.remove(path)
    return most


def after_a_failing_call(runner, job, base, rng):
    """A call of the system fails, or transfers half: a documented end, or the same files; then it runs again."""
    if b"san.so" in subprocess.run(["ldd", os.path.join(BIN, "bisque-voxelize")], capture_output=True).stdout:
        return False  # sanitizers want to be loaded first
    faults = {"LD_PRELOAD": os.path.join(TESTS, "faults.so"), "FAULT_UNDER": os.path.realpath(runner.top),
              "FAULT_CALLS": CALLS, "FAULT_PLAIN": rng.choice(["", "1"]), "FAULT_CLOCK": rng.choice(["0", "86400"])}
    piped = pipe_of(runner, job, rng) if isinstance(job, Grid) and base.code == 0 and rng.random() < 0.4 else {}
    expected = base._replace(files={job.name: base.files[job.name]}) if piped else base

    def run(environment):
        try:
            runner.way = "in" if piped else runner.way
            return job.run(runner, environment=environment, **piped)[0]
        finally:
            runner.way = after_a_failing_call.__name__

    calls = counted(runner, faults, run)
    error = rng.choice(["EIO", "ENOSPC", "EMFILE", "ENOMEM", "EPERM", "EINTR", "short", "TERM"])
    runner.directory(runner.way)  # without older outputs
    code = run({**faults, "FAULT_AT": str(rng.randint(1, calls)), "FAULT_DO": error})
    found = job.files(runner)
    if code == base.code:
        expect_same(code, found, expected)
    elif code not in FAULTS | {66} or not found.items() <= expected.files.items():
        raise Failure("exit code %d, and other or partial files: %s" % (code, ", ".join(found)))
    expect_same(run({}), job.files(runner), expected)


def after_an_interruption(runner, job, base, rng):
    """Runs it after the same command, or one with fewer options or other scans, was stopped at a random look."""
    trial, other = job.trial, {}
    other["given"] = [one for one in job.given if one[0].name in trials.NEEDED or rng.random() < 0.7]
    if rng.random() < 0.5:
        scan = rng.choice(trial.scans)
        other.update({"scans": [scan]} if isinstance(job, Bake) else {"files": scan.files})
    looks = counted(runner, {"FAULT_CALLS": "check"}, lambda faults: job.run(runner, environment=faults, **other))
    if looks == 0:
        return False
    if rng.random() < 0.5:
        runner.directory(runner.way)  # without older outputs
    job.run(runner, environment={"FAULT_CALLS": "check", "FAULT_AT": str(rng.randint(1, looks)),
                                 "FAULT_DO": rng.choice(["TERM", "TERM", "KILL"])}, **other)
    code, _ = job.run(runner)
    found = job.files(runner)
    expect_same(code, {name: found.get(name) for name in base.files}, base)


# ---- ways to make a grid ----


def from_chunks(runner, job, base, rng):
    """Makes the grid again from its chunk file, which has what options did that are then refused."""
    channels = trials.value("channels", job.given) or ""
    if base.code != 0 or job.scan.name + ".tris" not in base.files or "=" in channels:
        return False
    given = job.given
    try:
        while True:
            code, err = job.run(runner, files=["../in/%s.tris" % job.scan.name])
            drop = trials.named_in(err, job.given, rng) if code in (64, 65) else None
            if not drop:
                break
            job.scan.given = [one for one in job.given if one[0] is not drop]
    finally:
        job.scan.given = given
    expect_same(code, {job.name: job.files(runner).get(job.name)}, First(0, {job.name: base.files[job.name]}, ""))


def pipe_of(runner, job, rng):
    """Returns what to run a grid with in the directory `in`, so that it reads one file from standard input."""
    files = list(job.scan.files)
    k = rng.randrange(len(files))
    name, files[k] = os.path.basename(files[k]), "-"
    given = [one for one in job.given if one[0].name not in ("no-tris", "embed-textures", "vdb")]
    return {"more": ["--no-tris"], "given": given, "output": "../%s/%s" % (runner.way, job.name), "files": files,
            "stdin": name}


def through_a_pipe(runner, job, base, rng):
    """Reads a file from standard input, in the directory of the files that it names."""
    if base.code != 0:
        return False
    piped, way = pipe_of(runner, job, rng), runner.way
    runner.way = "in"
    code, _ = job.run(runner, **piped)
    runner.way = way
    expect_same(code, job.files(runner), First(0, {job.name: base.files[job.name]}, ""))


# ---- ways to simplify ----


def of_chunks(runner, job, base, rng):
    """The chunk file of a grid is as good as the meshes, if it has all triangles where they are."""
    names = {"scale", "up", "translate", "origin", "no-tris", "channels", "strict"}
    chunks = "../in/%s.tris" % job.scan.name
    if any(option.name in names for option, _ in job.scan.given) or not os.path.exists(
            os.path.join(runner.top, runner.way, chunks)):
        return False
    code, _ = job.run(runner, files=[chunks])
    expect_same(code, job.files(runner), base)


def measured(runner, job, base, rng):
    """Distances from the scan do not depend on threads, nor on the budget."""
    chunks, seen = "../in/%s.tris" % job.scan.name, []
    if not base.files or not os.path.exists(os.path.join(runner.top, runner.way, chunks)):
        return False
    low = "../first/" + rng.choice(sorted(base.files))
    for more in ["--threads", "1"], ["--threads", "4", "--memory", "100M"]:
        code, _ = runner.run("bisque-compare", ["--json", low, chunks] + more)
        if code != 0:
            raise Failure("exit code %d" % code)
        seen.append(First(code, {k: v for k, v in json.loads(runner.out).items() if k in DISTANCES}, ""))
    expect_same(*seen[1][:2], seen[0])


# ---- ways to bake ----


def in_parts(runner, job, base, rng):
    """Divides the bake into parts, which are baked in any order, and some twice."""
    if any(option.name == "tiles" for option, _ in job.given):
        return False  # parts have all tiles
    count, given, codes = rng.choice([1, 2, 2, 3, 3, 5, 5, 9]), list(job.given), []
    order = list(range(1, count + 1)) + rng.sample(range(1, count + 1), 1)
    rng.shuffle(order)

    def step(more):
        nonlocal base, given
        code, _ = job.run(runner, more, given=given)
        while code == 64 and base.code < 64 and (refused := trials.named_in(runner.said, given, None)):
            given = [one for one in given if one[0] is not refused]  # an option that parts refuse
            base = base._replace(files={name: v for name, v in base.files.items()
                                        if not name.startswith("m_" + refused.name)})
            code, _ = job.run(runner, more, given=given)
        return code

    for part in order:
        part = ["--part", "%d/%d" % (part, count)]
        code = step(part + ["--threads", "%d" % rng.randint(1, 4), "--memory", "%dM" % rng.choice([60, 500])])
        if code == NO_MEMORY:
            code = step(part)
        codes.append(code)
        if code >= 64:
            break
    if max(codes) < 64:
        codes.append(step(["--merge", "%d" % count]))
    if base.code >= 64:
        if max(codes) < 64 or job.files(runner):
            raise Failure("exit codes %s of parts, %d of the bake" % (codes, base.code))
        return
    expect_same(max(codes), job.files(runner), base)


def has_device(trial):
    """Returns whether a device other than the processor can trace the scans."""
    return len(trial.scans) == 1 or all(scan.kind == "tris" for scan in trial.scans)


def on_fake_cuda(runner, job, base, rng):
    environment = {"LD_LIBRARY_PATH": os.path.join(TESTS, "fake")}
    if not has_device(job.trial):
        return False
    small = ["--memory", "%dM" % rng.choice([20, 24, 32, 50, 100])] if rng.random() < 0.5 else []
    code, _ = job.run(runner, small, environment=environment, device="cuda")
    if code == NO_DEVICE and base.code != code:
        return False
    expect_same(code, job.files(runner), base, [NO_MEMORY] if small else [], ["look.png"] if small else [])


def on_opencl(runner, job, base, rng):
    """Only the processor and CUDA promise equal bytes; OpenCL has to give the same files."""
    if not has_device(job.trial):
        return False
    code, _ = job.run(runner, device="opencl")
    if code == NO_DEVICE and base.code != code:
        return False
    if (code == 0) != (base.code == 0):
        raise Failure("exit code %d, not %d" % (code, base.code))
    if code == 0 and set(job.files(runner)) != set(base.files):
        raise Failure("other files")


def compared(runner, job, base, rng):
    """A map is the same as itself, whatever is compared and by however many threads."""
    names = [name for name in base.files if name.endswith(".exr")]
    if not names:
        return False
    name, seen = "../first/" + rng.choice(names), []
    for threads in "1", "4":
        code, _ = runner.run("bisque-compare", trials.words(job.trial.compare) + ["--threads", threads, name, name])
        seen.append(First(code, runner.files(lambda n: n.endswith(".png")), ""))
    expect_same(*seen[1][:2], seen[0])


# How often each way runs.
WAYS = {
    Grid: [(other_threads, 0.4), (other_budget, 0.4), (other_order, 0.2), (without_options_without_effect, 0.3),
           (from_chunks, 0.4), (through_a_pipe, 0.2), (after_a_failing_call, 0.2), (after_an_interruption, 0.1)],
    Simplification: [(other_threads, 0.8), (other_budget, 0.4), (other_order, 0.3),
                     (without_options_without_effect, 0.5), (of_chunks, 0.5), (measured, 0.3),
                     (after_a_failing_call, 1), (after_an_interruption, 1)],
    Bake: [(other_threads, 0.6), (other_budget, 0.4), (other_order, 0.4), (without_options_without_effect, 1),
           (in_parts, 0.5), (on_fake_cuda, 1), (on_opencl, 0.5), (compared, 0.2), (after_a_failing_call, 0.3),
           (after_an_interruption, 0.1)],
}


# ---- trials ----


def run_way(runner, job, base, way, seed):
    """Runs a way with random numbers of its own, so that it can be repeated. Returns a failure or None."""
    try:
        runner.directory(way.__name__)
        return "left out" if way(runner, job, base, random.Random(seed)) is False else None
    except Failure as failure:
        return failure


def failure_of(runner, job, way, seed):
    """Runs a job and a way (None: only the job). Returns the failure or None, and the commands of both."""
    made = []
    try:
        base = job.first(runner, None)
        made = list(runner.commands)
        failure = run_way(runner, job, base, way, seed) if way else None
    except Failure as failed:
        failure = failed
    return failure if isinstance(failure, Failure) else None, made + (runner.commands if runner.commands != made else [])


def shrink(runner, job, way, seed):
    """Drops options and scans as long as the failure stays."""
    for owner, name in job.lists():
        kept = list(getattr(owner, name))
        for one in [item for item in kept if name == "scans" or item[0].name not in trials.NEEDED]:
            less = [item for item in kept if item is not one]
            setattr(owner, name, less)
            if (less or name != "scans") and failure_of(runner, job, way, seed)[0]:
                kept = less
        setattr(owner, name, kept)


def run_job(runner, job, rng, counts):
    """Runs a job in some of its ways. Returns its exit code; raises a Failure that has its commands."""
    way, seed = None, rng.random()
    kind = type(job).__name__.lower()
    try:
        base = job.first(runner, seed)
        counts[kind, "as given", "runs"] += 1
        for way, share in WAYS[type(job)]:
            seed = rng.random()
            if rng.random() > share:
                continue
            found = run_way(runner, job, base, way, seed)
            counts[kind, way.__name__, "runs"] += found != "left out"
            if isinstance(found, Failure):
                raise found
        return base.code
    except Failure as failure:
        counts[kind, way.__name__ if way else "as given", "failures"] += 1
        shrink(runner, job, way, seed)
        found, commands = failure_of(runner, job, way, seed)
        lines = ["%s%s" % (way.__name__ + ": " if way else "", found or failure)]
        raise Failure("\n".join(lines + commands)) from None


def run_trial(seed, tables, keep, counts):
    """Runs a trial. Returns how it ended, and a text on its failure or None."""
    rng = random.Random(seed)
    top = tempfile.mkdtemp(prefix="bisque-combine.")
    runner = Runner(top)
    os.makedirs(os.path.join(top, "in", trials.TEMPORARY))
    try:
        trial = trials.Trial(rng, os.path.join(top, "in"), tables)
        made = [run_job(runner, Grid(trial, scan), rng, counts) for scan in trial.scans]
        if rng.random() < (0.05 if trial.large else 0.15):
            run_job(runner, Simplification(trial), rng, counts)
        if any(made):
            return "no grid", None
        return "exit code %d" % run_job(runner, Bake(trial), rng, counts), None
    except Failure as failure:
        text = str(failure)
        if keep:
            kept = os.path.join(keep, seed.replace(":", "-"))
            shutil.copytree(top, kept, dirs_exist_ok=True)
            text += "\nfiles: " + kept
        return "failure", text
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
    ends, counts, lock = collections.Counter(), collections.Counter(), threading.Lock()
    stop = time.monotonic() + arguments.seconds

    def one(number):
        if time.monotonic() > stop:
            return
        seed = "%s:%d" % (arguments.seed, number)
        own = collections.Counter()
        end, text = run_trial(seed, tables, arguments.keep, own)
        with lock:
            ends[end] += 1
            counts.update(own)
            if text:
                print("not ok - trial %d of seed %s\n%s" % (number, arguments.seed, text), flush=True)

    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        list(pool.map(one, range(arguments.first, arguments.first + arguments.trials)))
    print("seed %s, %d trials: %s" % (arguments.seed, sum(ends.values()),
                                      ", ".join("%s %d" % item for item in sorted(ends.items()))))
    ways = [(kind.__name__.lower(), way.__name__) for kind, all_ways in WAYS.items() for way, _ in all_ways]
    for kind, way in [(kind.__name__.lower(), "as given") for kind in WAYS] + ways:
        print("%-16s %-32s %6d runs, %d failures" % (kind, way, counts[kind, way, "runs"], counts[kind, way, "failures"]))
    for name in sorted(trials.UNKNOWN):
        print("not drawn: --%s, which needs a function in trial.py" % name)
    return 1 if ends["failure"] else 0


if __name__ == "__main__":
    sys.exit(main())

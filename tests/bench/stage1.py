#!/usr/bin/env python3
"""stage1.py small|medium|large: measures bisque-voxelize and Embree on the same scans, and prints
tables in Markdown. tests/bench/RESULTS.md says how to read them.

BIN, TESTS    directories with the programs, and with generate-scan, measure and baseline-embree
BENCH_DIR     directory for scans and outputs, where scans are kept for the next run; default: a
              temporary directory beside BIN, which is removed at the end
BENCH_SCAN    a small OBJ file to amplify instead of the vase
BENCH_ROUNDS  how often each job runs (default: 3; with 109 million triangles: 2)

Each job runs once a round, so that slow drifts of the machine affect all jobs alike. No job may
influence the next one. Before each job, its scan is read into the page cache, what earlier jobs
wrote is flushed to disk, and as much memory as the job needs is prefaulted and freed. The host of a
virtual machine may reclaim freed memory after some seconds; getting it back takes two or three
seconds a gigabyte. Jobs whose ratio to "whole" is measured run directly after it; those that free
most memory run last.
"""
import filecmp
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

BIN, TESTS = Path(os.environ["BIN"]).resolve(), Path(os.environ["TESTS"]).resolve()
KEEP = os.environ.get("BENCH_DIR")
SOURCE = os.environ.get("BENCH_SCAN")
GIB, MIB = 1 << 30, 1 << 20
BUDGETS = {"1G": GIB, "256M": 256 * MIB, "64M": 64 * MIB}
COLUMNS = (("job", -28), ("ratio", 6), ("to", -28), ("triangles", 11), ("wall s", 6),
           ("user s", 6), ("system s", 8), ("GB/s", 5), ("Mtri/s", 6), ("RSS MiB", 7),
           ("written B/tri", 13))


def say(*words):
    """Tells the progress."""
    print("bench:", *words, file=sys.stderr)


class Job:
    """What is known of a job of one scan: the costs of each round."""

    def __init__(self, title, against, path):
        self.title, self.against, self.bytes = title, against, os.path.getsize(path)
        self.rounds, self.facts = {}, {}

    def median(self, key):
        return median(cost[key] for cost in self.rounds.values())

    def ratio(self, other):
        """A ratio is taken within a round, so that a slower machine affects both jobs."""
        both = [n for n in self.rounds if other and n in other.rounds]
        if not both:
            return None
        return median(self.rounds[n]["wall"] / other.rounds[n]["wall"] for n in both)


class Scan:
    """A scan in all its forms, and the jobs that read it."""

    def __init__(self, work, folder, label, triangles, resolution):
        self.work, self.folder, self.label, self.resolution = work, folder, label, resolution
        self.source = SOURCE or work / "low.obj"
        self.name = Path(SOURCE).stem if SOURCE else "vase"
        self.jobs, self.skipped, self.round, self.failed = {}, {}, 0, False
        self.ordered = self._generate("", "obj", triangles)
        self.shuffled = self._generate("-shuffled", "obj", triangles, "--shuffle", "1")
        self.ply = self._generate("", "ply", triangles)
        self.packed = {end: self._pack(end, *command) for end, command in
                       {"gz": ("gzip", "-1"), "zst": ("zstd", "-q", "-1")}.items()
                       if shutil.which(command[0])}
        report = subprocess.run([BIN / "bisque-voxelize", "--parse-only", "--json", self.ordered],
                                check=True, capture_output=True).stdout
        self.triangles = json.loads(report)["scan"]["triangles"]

    def _make(self, path, command, **options):
        if not path.exists():
            say("making", path.name)
            part = self.work / ("part" + path.suffix)
            subprocess.run([part if word is None else word for word in command], check=True,
                           **{key: open(part, "wb") for key in options})
            part.rename(path)
        return path

    def _generate(self, kind, ending, triangles, *options):
        path = self.folder / f"{self.name}-{self.label}{kind}.{ending}"
        return self._make(path, [TESTS / "generate-scan", "--triangles", str(triangles), *options,
                                 self.source, "-o", None])

    def _pack(self, ending, *command):
        return self._make(Path(f"{self.ply}.{ending}"), [*command, "-c", self.ply], stdout=True)

    # ---- measuring ----

    def measure(self, key, title, against, path, at_hand, *command):
        """Runs a command after prefaulting this much memory. Returns if it succeeded."""
        say(f"{self.label}, round {self.round}: {title}")
        subprocess.run(["cat", path], check=True, stdout=subprocess.DEVNULL)
        os.sync()
        report = self.work / "out" if isinstance(command[0], Path) else os.devnull
        with open(report, "wb") as out, open(self.work / "err", "wb") as err:
            subprocess.run([TESTS / "measure", "--at-hand", str(at_hand), self.work / "report",
                            *command], stdout=out, stderr=err, check=False)
        pairs = (pair.split("=") for pair in (self.work / "report").read_text().split())
        cost = {name: float(value) for name, value in pairs}
        if cost["status"]:
            self.skipped[title] = ((self.work / "err").read_text().strip().split("\n")[-1]
                                   or f"exit status {cost['status']:.0f}")
            return False
        self.jobs.setdefault(key, Job(title, against, path)).rounds[self.round] = cost
        return True

    def bisque(self, key, title, against, path, budget, *options):
        """Measures bisque-voxelize; a budget too small for the processors is no failure."""
        at_hand = 0
        if budget:
            # Its files are in the page cache: 12 bytes a triangle of chunks, some more of temporary
            # files, and a grid of 300 MiB.
            at_hand = BUDGETS[budget] + 32 * self.triangles + 512 * MIB
            options += ("--memory", budget)
        done = self.measure(key, title, against, path, at_hand, BIN / "bisque-voxelize", "--json",
                            "--progress", "none", *options, path)
        self.failed |= not done and "is too small" not in self.skipped[title]
        return done

    def grid(self, key, title, against, path, budget, resolution=None, compare=False):
        """Measures making a grid. Notes its size, or compares it with that of `whole`."""
        name = "whole" if key == "whole" else "other"
        outputs = [self.work / f"{name}.{ending}" for ending in ("tris", "nvdb")]
        if self.bisque(key, title, against, path, budget, "--resolution",
                       str(resolution or self.resolution), "-o", outputs[1]):
            if not compare:
                self._note(key)
            for output in outputs if compare and self.round == 1 else []:
                if not filecmp.cmp(output, self.work / f"whole{output.suffix}", shallow=False):
                    say(f"FAILED: {self.label}, {title}: {output.suffix} differs from whole's")
                    self.failed = True
        for output in outputs if key != "whole" else []:
            output.unlink(missing_ok=True)

    def _note(self, key):
        report = json.loads((self.work / "out").read_text())
        facts = self.jobs[key].facts
        facts["voxels"] = report["grid"]["voxels"]
        for name in ("grid_bytes", "tris_bytes", "temp_bytes"):
            facts[name] = next((part[name] for part in (report, *report.values())
                                if isinstance(part, dict) and name in part), None)

    def embree(self):
        """Embree's phases are measured by the baseline itself, without start and freeing."""
        need = 120 * self.triangles
        free = next(int(line.split()[1]) * 1024 for line in open("/proc/meminfo", encoding="ascii")
                    if line.startswith("MemAvailable"))
        if free < need * 5 / 4:
            self.skipped["Embree"] = f"needs {need // MIB} MiB of memory, less is available"
            return
        if not self.measure("embree", "Embree: parse and build", None, self.ordered, need,
                            TESTS / "baseline-embree", self.ordered):
            return
        pairs = (line.split("=") for line in (self.work / "out").read_text().split())
        phases = dict(pairs)
        parse = self.jobs.setdefault("embree-parse", Job("Embree: parse, 1 thread", None,
                                                         self.ordered))
        build = self.jobs["embree"].rounds[self.round]
        parse.rounds[self.round] = dict(build)
        for key in ("wall", "user", "system"):
            parse.rounds[self.round][key] = float(phases[f"parse.{key}"])
            build[key] = float(phases[f"parse.{key}"]) + float(phases[f"build.{key}"])

    # ---- jobs ----

    def run(self, *budgets):
        """Runs all jobs once, with these budgets besides 1 GiB."""
        self.round += 1
        self.measure("cat", "cat", None, self.ordered, 0, "cat", self.ordered)
        self.measure("cat-ply", "cat the PLY", None, self.ply, 0, "cat", self.ply)
        self.bisque("parse-1", "parse only, 1 thread", "embree-parse", self.ordered, None,
                    "--parse-only", "--threads", "1")
        self.bisque("parse", "parse only, all threads", "embree-parse", self.ordered, None,
                    "--parse-only")
        self.bisque("parse-ply", "parse only, PLY, all threads", "cat-ply", self.ply, None,
                    "--parse-only")
        for end, path in self.packed.items():
            program = {"gz": "gzip", "zst": "zstd"}[end]
            self.measure(program, f"{program} -dc", None, path, 0, program, "-dc", path)
            self.bisque(f"parse-{end}", f"parse only, .ply.{end}", program, path, None,
                        "--parse-only")
        self.grid("whole", "whole: OBJ to .tris, .nvdb", "embree", self.ordered, "1G")
        self.grid("whole-ply", "whole, from PLY", "whole", self.ply, "1G", compare=True)
        for end, path in self.packed.items():
            self.grid(f"whole-{end}", f"whole, from .ply.{end}", "whole-ply", path, "1G",
                      compare=True)
        self.revoxelize("revoxelize", self.resolution // 2)
        self.grid("shuffled", "shuffled faces", "whole", self.shuffled, "1G")
        for budget in budgets:
            self.grid(f"whole-{budget}", f"whole, --memory {budget}", "whole", self.ordered,
                      budget, compare=True)
            self.grid(f"shuffled-{budget}", f"shuffled, --memory {budget}", "whole",
                      self.shuffled, budget)
        self.embree()

    def revoxelize(self, key, resolution):
        """Makes another grid from the chunks; its voxels grow with the square of the resolution."""
        whole, title = self.work / "whole.nvdb", f".tris to .nvdb at {resolution}"
        need = 2.2 * (resolution / self.resolution) ** 2 * whole.stat().st_size
        if shutil.disk_usage(self.work).free < need:
            self.skipped[title] = f"needs about {need / GIB:.0f} GiB of disk"
        else:
            self.grid(key, title, "whole", whole.with_suffix(".tris"), "1G", resolution)

    # ---- tables ----

    def print_table(self):
        print(f"\n### {self.label}: {self.triangles:,} triangles,"
              f" {self.ordered.stat().st_size / 1e9:.2f} GB of OBJ,",
              "one run" if self.round == 1 else f"medians of {self.round} runs", end="\n\n")
        print_row(*(name for name, _ in COLUMNS))
        print("|" + "|".join(f"{':' if width < 0 else ''}{'-' * (abs(width) + 1)}"
                             f"{':' if width > 0 else ''}" for _, width in COLUMNS) + "|")
        for job in self.jobs.values():
            other, wall, n = self.jobs.get(job.against), job.median("wall"), self.triangles
            ratio = job.ratio(other)
            rss = max(cost["rss_kib"] for cost in job.rounds.values()) / 1024
            print_row(job.title, "-" if ratio is None else f"{ratio:.2f}",
                      other.title if other else "-", f"{n:,}", f"{wall:.2f}",
                      f"{job.median('user'):.2f}", f"{job.median('system'):.2f}",
                      f"{job.bytes / wall / 1e9:.2f}", f"{n / wall / 1e6:.1f}", f"{rss:.0f}",
                      f"{job.median('written') / n:.1f}")
        print()
        for job in self.jobs.values():
            f = job.facts
            if f:
                print(f"- {job.title}: {f['voxels']:,} voxels, .nvdb {f['grid_bytes'] / MIB:.1f}"
                      f" MiB ({f['grid_bytes'] / f['voxels']:.1f} bytes a voxel)", end="")
                print(f", .tris {f['tris_bytes'] / n:.2f} and temporary files of sorting"
                      f" {f['temp_bytes'] / n:.2f} bytes a triangle" if f["tris_bytes"] else "")
        for title, reason in self.skipped.items():
            print(f"- left out: {title}: {reason}")

    def goal(self, key, text, value, limit, sense=-1):
        """Prints a line of the list of goals: at most the limit, or at least if sense is 1."""
        job = self.jobs.get(key)
        if job and (of := value(job)) is not None:
            print(f"- {'met   ' if sense * (of - limit) >= 0 else 'missed'} {self.label}:"
                  f" {job.title}{text}: {of:.2f} ({'at most' if sense < 0 else 'at least'}"
                  f" {limit:.2f})")

    def print_goals(self):
        for key, limit in (("whole", 0.25), ("parse-ply", 2), ("whole-ply", 0.6), ("parse-gz", 1),
                           ("whole-zst", 1), ("revoxelize", 1 / 3), ("shuffled", 1.5),
                           ("whole-256M", 2.5), ("shuffled-256M", 2.5)):
            other = self.jobs.get(self.jobs[key].against) if key in self.jobs else None
            if other:
                self.goal(key, f" / {other.title}", lambda job, o=other: job.ratio(o), limit)
        if self.label == "10M":
            self.goal("whole", ", seconds", lambda job: job.median("wall"), 2)
        for key, limit in (("parse-1", 1), ("parse", os.cpu_count())):
            self.goal(key, ", GB/s", lambda job: job.bytes / job.median("wall") / 1e9, limit, 1)
        for key, limit in (("parse-1", 64), ("parse", 64), ("whole", 1024)):
            self.goal(key, ", resident MiB", lambda job:
                      max(cost["rss_kib"] for cost in job.rounds.values()) / 1024, limit)
        self.goal("whole", ", .tris, bytes a triangle", lambda job: job.facts["tris_bytes"]
                  and job.facts["tris_bytes"] / self.triangles, 19)


def print_row(*cells):
    print("| " + " | ".join(f"{cell:{'<' if width < 0 else '>'}{abs(width)}}"
                            for cell, (_, width) in zip(cells, COLUMNS)) + " |")


def describe_machine(work):
    """Prints what the figures depend on."""
    def first(path, key):
        with open(path, encoding="utf-8") as file:
            return next((line.split(":" if ":" in line else "=", 1)[1].strip().strip('"')
                         for line in file if line.startswith(key)), "unknown")
    begin = time.monotonic()
    with open(work / "probe", "wb") as file:
        file.write(bytes(128 * MIB))
        os.fsync(file.fileno())
    speed = 128 * MIB / 1e6 / (time.monotonic() - begin)
    (work / "probe").unlink()
    version = subprocess.run([BIN / "bisque-voxelize", "--version"], capture_output=True,
                             text=True, check=True).stdout.split("\n")[0]
    print(f"\n- Date: {time.strftime('%Y-%m-%d')}, {version}")
    print(f"- Processor: {first('/proc/cpuinfo', 'model name')} ({platform.machine()}),"
          f" {os.cpu_count()} processors")
    print(f"- Memory: {int(first('/proc/meminfo', 'MemTotal').split()[0]) / MIB:.1f} GiB")
    print(f"- System: {platform.system()} {platform.release()},"
          f" {first('/etc/os-release', 'PRETTY_NAME')}")
    print(f"- Disk: {speed:.0f} MB/s written and synced")
    print(f"- Load before the run: {' '.join(map('{:.2f}'.format, os.getloadavg()))}")
    print(f"- Scan: {Path(SOURCE).name if SOURCE else 'vase'}, amplified")


def bench(size, work, folder):
    """Runs the benchmark of a size. Returns its scans."""
    if not SOURCE:
        subprocess.run([TESTS / "generate-scan", "vase-low", "-o", work / "low.obj"], check=True)
    plan = {"small": [("2M", 2000000, 1024, ("256M",))],
            "medium": [("10M", 10000000, 2048, ("256M", "64M"))]}
    plan["large"] = plan["medium"] + [("109M", 109000000, 2048, ("256M",))]
    scans = []
    for label, triangles, resolution, budgets in plan[size]:
        scan = Scan(work, folder, label, triangles, resolution)
        scans.append(scan)
        for _ in range(int(os.environ.get("BENCH_ROUNDS", 2 if label == "109M" else 3))):
            scan.run(*budgets)
        if label == "109M":
            if not KEEP:
                scan.shuffled.unlink()
            scan.revoxelize("grid-8192", 8192)
            scan.revoxelize("grid-16384", 16384)
    return scans


def main(size):
    begin = time.monotonic()
    if KEEP:
        Path(KEEP).mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="bench.", dir=KEEP or BIN.parent) as work:
        work = Path(work)
        describe_machine(work)
        scans = bench(size, work, Path(KEEP).resolve() if KEEP else work)
        for scan in scans:
            scan.print_table()
        print("\n### Goals\n")
        for scan in scans:
            scan.print_goals()
        if len(scans) == 2 and all("whole" in scan.jobs for scan in scans):
            times = scans[1].triangles / scans[0].triangles
            of = scans[0].jobs["whole"].median("wall")
            scans[1].goal("whole", f", time for {times:.2f} times the triangles, as a multiple",
                          lambda job: job.median("wall") / of, 11.5 * times / 10.9)
        print(f"\nThe run took {time.monotonic() - begin:.0f} s.")
        return any(scan.failed for scan in scans)


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in ("small", "medium", "large"):
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1]))

"""jobs.py - finds Bisque's programs, and runs them one after the other beside Blender. Knows nothing of Blender."""
import importlib.util
import json
import os
import queue
import shutil
import subprocess
import sys
import threading

from .lines import read_line

SORTED = (".tris", ".nvdb")  # what bisque-bake reads


def find_package():
    """Returns the folder of the Python package that the extension's wheel brought; None: it came without."""
    spec = importlib.util.find_spec("bisque")
    package = os.path.dirname(spec.origin) if spec and spec.origin else ""
    return package if os.path.isdir(os.path.join(package, "bin")) else None


def allow_running(package):
    """Lets the programs of the package run: Blender unpacks wheels without that permission."""
    for folder in ("bin", "lib/bisque"):
        for entry in os.scandir(os.path.join(package, folder)):
            if not os.access(entry.path, os.X_OK):
                os.chmod(entry.path, 0o755)


def find_program(name, folder):
    """Returns the command of a program: in a folder, or else of the wheel, or else on PATH; None: it is nowhere."""
    package = None if folder else find_package()
    if not package:
        path = shutil.which(name, path=folder or None)
        return [path] if path else None
    allow_running(package)
    if name == "bisque-asset":  # Blender makes no console scripts of wheels
        return [sys.executable, "-m", "bisque_start"]
    return [os.path.join(package, "bin", name)]


def environment():
    """Returns the environment of programs: Python finds the modules of the extension's wheels, and the programs end
    when Blender does."""
    package = find_package()
    return {**os.environ, "PYTHONPATH": os.path.dirname(package), "PYTHONSAFEPATH": "1",
            "BSQ_PARENT": str(os.getpid())} if package else None


class Job:
    """Commands that run one after the other. A thread reads what they print, so poll() never waits."""

    def __init__(self, commands):
        self.commands = list(commands)
        self.stage, self.share = "starting", 0.0
        self.messages = []  # of the programs: warnings, and errors of a command that failed
        self.results = []  # the JSON of each command that ended well
        self.code = None  # exit status of the command that failed; 0: all ended well
        self.process = None
        self._lines = queue.Queue()
        self._start()

    def _start(self):
        self.process = subprocess.Popen(self.commands.pop(0), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                        stdin=subprocess.DEVNULL, text=True, errors="replace", env=environment())
        self._output = []
        self._threads = [threading.Thread(target=self._read_errors, args=(self.process,), daemon=True),
                         threading.Thread(target=self._read_output, args=(self.process,), daemon=True)]
        for thread in self._threads:
            thread.start()

    def _read_errors(self, process):
        for line in process.stderr:
            self._lines.put(line.strip())

    def _read_output(self, process):
        self._output.append(process.stdout.read())

    def _take_lines(self):
        while not self._lines.empty():
            kind, said = read_line(self._lines.get())
            if kind == "step":
                self.stage = said["stage"]
                self.share = min(max(said["done"] / said["total"], 0.0), 1.0) if said["total"] else 0.0
            elif said:
                self.messages.append(said)

    def poll(self):
        """Takes what was printed, and starts the next command. Returns whether all is over."""
        self._take_lines()
        if self.code is not None:
            return True
        if self.process.poll() is None:
            return False
        for thread in self._threads:
            thread.join()
        self._take_lines()
        self.code = self.process.returncode
        try:
            if self.code == 0:
                self.results.append(json.loads(self._output[0]))
        except (ValueError, IndexError):
            self.messages.append("a program printed no report")
            self.code = 70
        if self.code == 0 and self.commands:
            try:
                self._start()
                self.code = None
            except OSError as error:
                self.messages.append(str(error))
                self.code = 73
        return self.code is not None

    def cancel(self):
        """Ends the command that runs. It leaves complete files only."""
        self.commands = []
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait()


def sort_scan(program, scan, folder, options):
    """Returns the file that bisque-bake reads of a scan, and the command that makes it; None: it is there."""
    if scan.lower().endswith(SORTED):
        return scan, None
    suffix = ".nvdb" if "--resolution" in options else ".tris"
    made = os.path.join(folder, os.path.splitext(os.path.basename(scan))[0] + suffix)
    if os.path.exists(made) and os.path.getmtime(made) >= os.path.getmtime(scan):
        return made, None
    return made, [*program, scan, "-o", made, "--json", "--progress", "json", *options]


def bake_commands(programs, scans, low, folder, options):
    """Returns the commands that bake scans onto the meshes of an OBJ file. options: of the two programs, by name;
    sorted scans lie in a folder for each choice of them."""
    sort = options["bisque-voxelize"]
    folder = os.path.join(folder, "_".join(["sorted", *(word.strip("-").replace(",", "_") for word in sort)]))
    os.makedirs(folder, exist_ok=True)
    made = [sort_scan(programs["bisque-voxelize"], scan, folder, sort) for scan in scans]
    memory = ["--memory", options["memory"]] if options["memory"] else []
    return [command + memory for _, command in made if command] + [
        [*programs["bisque-bake"], *(path for path, _ in made), low, "--json", "--progress", "json",
         *options["bisque-bake"], *memory]]


def asset_command(program, scans, output, options):
    return [*program, *scans, "-o", output, "--json", "--progress", "json", *options]

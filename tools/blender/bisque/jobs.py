"""jobs.py - runs Bisque's programs one after the other beside Blender. Knows nothing of Blender."""
import json
import os
import queue
import shutil
import signal
import subprocess
import threading

SORTED = (".tris", ".nvdb")  # what bisque-bake reads


def find_program(name, folder):
    """Returns the path of a program, in a folder or on PATH; None: it is nowhere."""
    return shutil.which(name, path=folder or None)


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
                                        stdin=subprocess.DEVNULL, text=True, errors="replace")
        self._output = []
        self._threads = [threading.Thread(target=self._read_errors, args=(self.process,), daemon=True),
                         threading.Thread(target=self._read_output, args=(self.process,), daemon=True)]
        for thread in self._threads:
            thread.start()

    def _read_errors(self, process):
        for line in process.stderr:
            self._lines.put(line.rstrip("\n"))

    def _read_output(self, process):
        self._output.append(process.stdout.read())

    def _take_lines(self):
        while not self._lines.empty():
            line = self._lines.get()
            try:
                step = json.loads(line)
                self.stage, total = step["stage"], step["total"]
                self.share = step["done"] / total if total else 0.0
            except (ValueError, KeyError, TypeError):
                self.messages.append(line)

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
        if self.process.returncode != 0:
            self.code = self.process.returncode
        else:
            self.results.append(json.loads(self._output[0]))
            if self.commands:
                self._start()
                return False
            self.code = 0
        return True

    def cancel(self):
        """Ends the command that runs. It leaves complete files only."""
        self.commands = []
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait()


def bake_commands(programs, scan, low, folder, options, chunks):
    """Returns the commands that bake a scan onto the meshes of an OBJ file. programs: paths by name. options:
    of bisque-bake. chunks: options of bisque-voxelize for a scan that is not sorted yet."""
    commands = []
    if not scan.lower().endswith(SORTED):
        exact = chunks.pop("exact")
        base = os.path.join(folder, os.path.splitext(os.path.basename(scan))[0])
        made = base + (".tris" if exact else ".nvdb")
        if not os.path.exists(made) or os.path.getmtime(made) < os.path.getmtime(scan):
            command = [programs["bisque-voxelize"], scan, "-o", made, "--json", "--progress", "json"]
            for name, value in chunks.items():
                if not (exact and name == "resolution"):
                    command += ["--" + name, str(value)]
            commands.append(command)
        scan = made
    return commands + [[programs["bisque-bake"], scan, low, "--json", "--progress", "json",
                        "-o", os.path.join(folder, "<OBJECT>_<MAP>.exr"), *options]]

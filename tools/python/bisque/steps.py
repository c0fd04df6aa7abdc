"""The steps of a job: each writes files, and notes what it was made of.

A step whose note is still true is not repeated, so an interrupted job goes on where it stopped. The
note names every file that the step read, as the libraries and programs tell it, with a checksum.
Files of the private folder, where nobody else writes, are known by the times that the system keeps."""
from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import shutil
import time
import warnings
from pathlib import Path
from typing import Any, Callable, Iterator

from . import core
from .core import Error

#: Errors of the system that mean that reading or writing failed, and not that a file cannot be made.
FAILED_IO = {errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EPIPE, errno.ESTALE}
#: What each step is of all the work, for the progress bar.
WEIGHTS = {"sort": 20, "simplify": 25, "unwrap": 10, "voxelize": 10, "bake": 25, "pack": 5, "check": 10, "mend": 3,
           "place": 1, "usdz": 1}


# ---- files ----

def _identity_of(info: os.stat_result) -> str:
    """Returns what tells that a file was not written to, as bsq_identity_text() does."""
    times = (f"{ns // 10 ** 9}.{ns % 10 ** 9:09d}" for ns in (info.st_mtime_ns, info.st_ctime_ns))
    return f"{info.st_ino} {info.st_size} {' '.join(times)}"


def identity(path: str | os.PathLike) -> str:
    """Returns the identity of a file, "" if there is none."""
    try:
        return _identity_of(os.stat(path))
    except OSError:
        return ""


def sha256(path: str | os.PathLike) -> tuple[str, str]:
    """Returns the checksum of a file and the identity of what was read. Raises Error."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(descriptor, "rb") as file:
            before = _identity_of(os.fstat(file.fileno()))
            digest = hashlib.sha256()
            for block in iter(lambda: file.read(1 << 20), b""):
                digest.update(block)
            after = _identity_of(os.fstat(file.fileno()))
    except OSError as error:
        raise Error(66, f"{path}: {error.strerror}") from None
    if before != after:
        raise Error(74, f"{path}: was changed while it was read")
    return digest.hexdigest(), before


class Folder:
    """The folder `bisque-steps` in another one. All that is in it was made here, which its marker says,
    and the marker is locked while a process uses the folder."""

    NAME, MARKER = "bisque-steps", "made-by-bisque-asset"

    def __init__(self, parent: Path, shared: bool = False):
        """shared: other processes may use the folder, too, if they share it."""
        self.parent, self.path = parent, Path(os.path.abspath(parent)) / self.NAME
        self.kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        self.new = not parent.exists()
        try:
            parent.mkdir(parents=True, exist_ok=True)
            self.lock = self._open()
        except OSError as error:
            raise Error(73, f"{self.path}: {error.strerror}") from None

    def _open(self) -> int:
        marker = self.path / self.MARKER
        while True:
            self.path.mkdir(exist_ok=True)
            if self.path.is_symlink() or (not marker.exists() and any(os.scandir(self.path))):
                raise Error(73, f"{self.path}: bisque-asset keeps its files in a folder of this name, "
                                "and did not make this one")
            try:
                lock = os.open(marker, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            except FileNotFoundError:
                continue  # another process removed the folder
            try:
                fcntl.flock(lock, self.kind | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                raise Error(73, f"{self.path}: another bisque-asset is at work here") from None
            except OSError:
                pass  # a file system without locks
            if identity(marker) == _identity_of(os.fstat(lock)):
                return lock
            os.close(lock)

    def close(self, remove: bool) -> None:
        """Ends the use of the folder; remove: it goes, and its parent if it was made for it."""
        if remove:
            for entry in [e for e in os.scandir(self.path) if e.name != self.MARKER]:  # which goes last
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    Path(entry.path).unlink(missing_ok=True)
            shutil.rmtree(self.path, ignore_errors=True)
            if self.new and self.parent.is_dir() and not any(os.scandir(self.parent)):
                self.parent.rmdir()
        os.close(self.lock)


# ---- steps ----

class _Heard:
    """Warnings and files of a step. The private folder's path is left out of lines."""

    def __init__(self, folder: Path) -> None:
        self.prefix = f"{folder}{os.sep}"
        self.lines: list[str] = []
        self.files: dict[str, str] = {}

    def warn(self, line: str) -> None:
        line = line.replace(self.prefix, "")
        if line not in self.lines:
            self.lines.append(line)

    def read(self, path: str, found: str) -> None:
        path = os.path.abspath(path)
        self.files[path] = found or self.files.get(path, "")


class Steps:
    """Runs steps, or takes what an earlier run left."""

    def __init__(self, folder: Folder, progress: core.Progress | None, levels: int, fixed: bool = False):
        """fixed: steps must be known, until that is changed."""
        self.fixed = fixed
        self.folder, self.lock, self.progress = folder.path, folder.lock, progress
        self.note = self.folder / "steps.json"
        self.known = self._read_note()
        self.total = levels * sum(WEIGHTS.values()) - (levels - 1) * (WEIGHTS["sort"] + WEIGHTS["simplify"])
        self.done, self.weight, self.name, self.stage, self.shown = 0.0, 0.0, "", "", 0
        self.seconds: dict[str, float] = {}
        self.warnings: dict[str, list[str]] = {}  # of each step
        self.seen: dict[str, tuple[str, str]] = {}  # identity and checksum of each file that was read
        self.began = time.time_ns()

    def _read_note(self) -> dict:
        """Returns the notes of an earlier run; a file that is damaged has none."""
        try:
            checksum, text = self.note.read_text("utf-8").split("\n", 1)
            return json.loads(text) if checksum == hashlib.sha256(text.encode()).hexdigest() else {}
        except (OSError, ValueError):
            return {}

    def _write_note(self) -> None:
        text = json.dumps(self.known)
        temporary = self.note.with_suffix(".new")
        temporary.write_text(hashlib.sha256(text.encode()).hexdigest() + "\n" + text)
        os.replace(temporary, self.note)

    @contextlib.contextmanager
    def apart(self, name: str) -> Iterator[None]:
        """Keeps what is noted meanwhile in a file of its own, which only one process has at a time. Raises Error."""
        before = self.note, self.known
        self.note = self.folder / f"{name}.json"
        lock = os.open(self.note.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            with contextlib.suppress(OSError):  # a file system without locks
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise Error(73, f"{self.note}: another bisque-asset is at work on it") from None
            self.known = self._read_note()
            yield
        finally:
            self.note, self.known = before
            os.close(lock)

    def report(self, stage: str, done: int, total: int, unit: str) -> None:
        """Turns the progress of a stage into that of the whole, in thousandths. The stages of a step
        share its weight, half of what is left each."""
        if stage != self.stage:
            self.done += self.weight if self.stage else 0
            self.weight /= 2
            self.stage = stage
        share = self.done + self.weight * (min(done / total, 1) if total else 0)
        self.shown = max(self.shown, int(1000 * share / self.total))
        if self.progress:
            self.progress(f"{self.name}: {stage}", self.shown, 1000, "steps")

    def content(self, path: str | os.PathLike, found: str = "") -> str:
        """Returns a checksum of a file, of one in the private folder its identity, "" if there is
        none. found: the identity of the file when it was opened. Raises Error if the file is not
        the one that this job read before."""
        path = os.path.abspath(path)
        now = identity(path)
        if self.folder in Path(path).parents:
            return now
        before, checksum = self.seen.get(path, ("", ""))
        if path in self.seen and now == before and found in ("", now):
            return checksum
        content = now  # of what is no file that can be read
        if os.path.isfile(path) and os.access(path, os.R_OK):
            content = sha256(path)[0]
        if path in self.seen:
            changed = content != checksum or found not in ("", before, now)
        else:  # a file that another program opened has no identity
            changed = found != now if found else bool(now) and os.stat(path).st_ctime_ns > self.began
        if changed or identity(path) != now:
            raise Error(74, f"{path}: was changed while it was read")
        self.seen[path] = now, content
        return content

    def hold(self, path: str | os.PathLike) -> str:
        """Returns the checksum of an input before it is read; later it must be the same. Raises Error."""
        full = os.path.abspath(path)
        if os.path.exists(path) and not os.path.isfile(path):
            raise Error(66, f"{path}: not a regular file")
        if full not in self.seen and self.folder not in Path(full).parents:
            self.seen[full] = sha256(path)[::-1]
        return self.content(path)

    def run(self, name: str, inputs: list, options: dict, outputs: list[Path],
            work: Callable[[], Any], parts: int = 1) -> Any:
        """Returns the result of `work`, or that of an earlier run with the same version, options and
        contents of all files read, if its outputs are there unchanged. parts: of how many steps of its
        kind this is one."""
        for path in inputs:
            self.hold(path)
        paths = [os.path.abspath(path) for path in inputs]
        key = json.dumps([core.version(), paths, options], sort_keys=True, default=str)
        weight = WEIGHTS[name.split(" ")[0]] / parts
        self.name, self.weight, self.stage = name, weight, ""
        start, before = time.monotonic(), self.done
        known = self.known.get(name)
        if not (known and known["key"] == key and known["outputs"] == [identity(o) for o in outputs] and
                all(self.content(path) == content for path, content in known["read"].items())):
            if self.fixed:
                raise Error(66, f"{self.folder.parent}: there is no plan of this scan with these options: --part plan "
                            "makes it")
            known = self.known[name] = {"key": key, **self._work(name, paths, outputs, work)}
            self._write_note()
        else:
            self.tell(name, known["warnings"])
        self.seconds[name] = time.monotonic() - start
        self.done = before + weight
        return known["result"]

    def _work(self, name: str, paths: list[str], outputs: list[Path], work: Callable[[], Any]) -> dict:
        """Does the work of a step. Returns what is noted of it."""
        self.known.pop(name, None)
        self.heard = heard = _Heard(self.folder)
        token = core.listener.set(heard)
        try:
            result = json.loads(json.dumps(work(), default=float))  # as a later run reads it
        finally:
            core.listener.reset(token)
            self.tell(name, heard.lines)
        read = {path: self.content(path, heard.files.get(path, ""))
                for path in sorted({*paths, *heard.files} - {os.path.abspath(o) for o in outputs})}
        return {"outputs": [identity(o) for o in outputs], "read": read, "result": result,
                "warnings": heard.lines}

    def tell(self, name: str, lines: list[str]) -> None:
        """Passes warnings on, each once."""
        told = [line for others in self.warnings.values() for line in others]
        self.warnings[name] = lines
        for line in lines:
            if line not in told:
                warnings.warn(line, stacklevel=2)

    def warnings_of(self, level: str | None) -> list[str]:
        """Returns the warnings of the steps of a level; None: of those of all levels."""
        found = [line for name, lines in self.warnings.items()
                 if name.partition(" ")[2].split(" ")[-1] == (level or "") for line in lines]
        return list(dict.fromkeys(found))

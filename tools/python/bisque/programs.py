"""Runs the programs of this package, which die with this process."""
from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Callable, Sequence

from .lines import read_line
from .mesh import Error

PACKAGE = Path(__file__).resolve().parent
BIN = PACKAGE / "bin"


def environment() -> dict[str, str]:
    """Returns the environment of a child, which finds this package whatever the working directory has."""
    paths = [str(PACKAGE.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "BSQ_PARENT": str(os.getpid()), "PYTHONSAFEPATH": "1",
            "PYTHONPATH": os.pathsep.join(paths)}


def path_of(printed: str) -> str:
    """Returns the path that a program printed. Bytes that are not UTF-8 are there as \\xHH."""
    printed = os.fsdecode(printed.encode())  # whatever names are in here
    if os.path.lexists(printed):
        return printed
    return re.sub(r"\\x([89a-f][0-9a-f])", lambda found: os.fsdecode(bytes.fromhex(found[1])), printed)


def _fail(name: str, code: int, lines: list[str]) -> None:
    """Raises the Error of a program that ended with a code, or by a signal if it is negative."""
    if code > 0:
        raise Error(code, lines[-1] if lines else f"{name} failed with status {code}")
    status = {signal.SIGTERM: 75, signal.SIGINT: 75, signal.SIGHUP: 75, signal.SIGKILL: 71}.get(-code, 70)
    raise Error(status, f"{name} was ended by signal {-code} ({signal.strsignal(-code)})")


def run(name: str, words: Sequence[Any], progress: Callable | None, warn: Callable[[str], Any],
        keep_open: Sequence[int] = ()) -> dict:
    """Runs a program and returns its report. warn: gets its warnings, and lines of a kind that is not
    known. keep_open: descriptors that it holds, such as that of a lock. Raises Error."""
    command = [BIN / name, "--json", "--progress", "json", *words]
    lines: list[str] = []
    with tempfile.TemporaryFile("w+", encoding="utf-8") as printed, subprocess.Popen(
            [os.fspath(w) if isinstance(w, os.PathLike) else str(w) for w in command], encoding="utf-8",
            errors="replace", stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.PIPE,
            env=environment(), pass_fds=keep_open) as program:
        try:
            for line in program.stderr:
                kind, said = read_line(line)
                if kind == "step":
                    if progress:
                        progress(said["stage"], said["done"], said["total"], said["unit"])
                elif kind == "warning":
                    warn(said)
                elif said:
                    lines.append(said.removeprefix(name + ": "))
            code = program.wait()
        except BaseException:
            program.terminate()
            try:
                program.wait(10)
            except subprocess.TimeoutExpired:
                program.kill()
            raise
        if code:
            _fail(name, code, lines)
        for line in lines:
            warn(line.removeprefix("warning: "))
        printed.seek(0)
        try:
            return json.load(printed)
        except ValueError:
            raise Error(70, f"{name} printed no report") from None

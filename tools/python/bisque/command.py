"""The program bisque-asset: options, progress, exit codes."""
from __future__ import annotations

import argparse
import difflib
import errno
import json
import os
import re
import signal
import sys
import tempfile
import time
import traceback
import warnings
from typing import Any, Callable, NoReturn

import bisque_start

from . import core, uv
from .asset import PRESETS, asset
from .core import Error
from .glb import GEOMETRIES, IMAGES
from .steps import FAILED_IO
from .tiles import tiles


def _printable(text: Any) -> str:
    """Returns a text in which nothing controls a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii")
                   for c in str(text))


#: Where standard error is no terminal, a line tells progress so often, as those of the programs in C do.
LOG_SECONDS = 30


class _Screen:
    """Prints progress and lines to standard error."""

    def __init__(self, kind: str):
        self.kind, self.drawn, self.logged = kind, False, time.monotonic()

    def progress(self, stage: str, done: int, total: int, unit: str) -> None:
        now = time.monotonic()
        if self.kind == "json":
            self._write(json.dumps({"stage": stage, "unit": unit, "done": done, "total": total}) + "\n")
        elif self.kind == "bar":
            width, share = 30, done / max(total, 1)
            filled = int(width * share)
            self._write(f"\r[{'#' * filled}{'.' * (width - filled)}] {int(100 * share):3d} % {stage[:36]:36s}")
            self.drawn = True
        elif self.kind == "log" and now - self.logged >= LOG_SECONDS:
            self.logged = now
            self.say(f"{stage}: {100 * done // max(total, 1)} % of all")

    def warn(self, message: Any, *_: Any) -> None:
        if self.kind == "json":
            self._write(json.dumps({"warning": str(message)}) + "\n")
        else:
            self.say(f"warning: {message}")

    def say(self, text: Any) -> None:
        self.end_bar()
        self._write(f"bisque-asset: {_printable(text)}\n")

    def end_bar(self) -> None:
        if self.drawn:
            self._write("\n")
        self.drawn = False

    @staticmethod
    def _write(text: str) -> None:
        try:
            if sys.stderr:
                sys.stderr.write(text)
                sys.stderr.flush()
        except OSError:
            pass  # nobody reads it


#: What others call options.
OTHER_NAMES = {"--resolution": "--size", "--texture-size": "--size", "--faces": "--triangles"}


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message} (see bisque-asset --help)")

    def refuse_unknown(self, words: list[str]) -> None:
        """Refuses an option that there is not, with the nearest one, whatever else is wrong."""
        known = self._option_string_actions
        for word in words[:words.index("--")] if "--" in words else words:
            name = word.partition("=")[0]
            if name.startswith("--") and name not in known:
                for near in difflib.get_close_matches(name, [*known, *OTHER_NAMES], 1, 0.7):
                    raise ValueError(f"unrecognized option '{name}'; the nearest is {OTHER_NAMES.get(near, near)}")
                self.error(f"unrecognized option '{name}'")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="bisque-asset", allow_abbrev=False,
                     description="Makes a GLB file with baked maps of a scan of any size.")
    parser.add_argument("scan", nargs="+", help="mesh files, read as one scan, or a .tris file")
    parser.add_argument("-o", "--output", required=True, metavar="FILE.glb",
                        help="the asset, or a .usdz file; its other files are beside it; with --tiles a folder")
    parser.add_argument("--tiles", action="store_true", help="make 3D Tiles: the whole scan, to be streamed")
    parser.add_argument("--levels", type=int, metavar="N", help="make N levels of detail, a GLB file each, in a folder")
    parser.add_argument("--tile-triangles", type=int, default=10_000, metavar="N", help="most triangles of a tile, or "
                        "those of the coarsest level")
    parser.add_argument("--part", metavar="K/N", help="of a job on several machines; see bisque-asset(1)")
    parser.add_argument("--place", type=lambda text: text.split(","), metavar="LON,LAT,HEIGHT",
                        help="where tiles lie on the earth: degrees, and metres")
    parser.add_argument("--preset", choices=PRESETS, default="web")
    parser.add_argument("--low", metavar="FILE.obj", help="a low-poly mesh to use")
    parser.add_argument("--texture", metavar="FILE", help="the scan's image, if it names none")
    parser.add_argument("--triangles", metavar="N", help="of the low-poly mesh (or of all finest tiles), or 10%% of "
                        "the scan's")
    parser.add_argument("--error", metavar="D", help="instead: the smallest mesh that is nowhere farther from the "
                        "scan; 0.2mm, 0.1%% of the scan's diagonal, or in its units")
    parser.add_argument("--size", metavar="N", help="texels of a side of the maps, such as 2048 or 4k")
    parser.add_argument("--up", metavar="AXIS", help="that points upwards in the scan: x, y, z, -x, -y or -z")
    parser.add_argument("--units", metavar="UNIT", help="of the scan: mm, cm, m or in")
    parser.add_argument("--scale", type=float, metavar="X", help="multiply the asset by X")
    parser.add_argument("--maps", type=core.own_names, metavar="LIST", help="such as normal,color,ao")
    parser.add_argument("--images", choices=IMAGES, help="of the GLB file; jpeg: but for normals")
    parser.add_argument("--geometry", choices=GEOMETRIES, default="none", help="how it is packed in the GLB file")
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="N x N a texel")
    parser.add_argument("--surface", choices=("auto", "grid", "exact"), default="auto")
    parser.add_argument("--unwrap", dest="library", choices=uv.LIBRARIES, default=uv.USUAL, metavar="LIBRARY",
                        help="uvunwrap or xatlas")
    parser.add_argument("--unwrap-seconds", type=float, default=300, metavar="S")
    parser.add_argument("--min-component", default=0, metavar="P",
                        help="drop pieces that are smaller than P %% of the scan, by diagonals: 5%%")
    parser.add_argument("--min-triangles", type=int, default=0, metavar="N",
                        help="drop pieces of fewer triangles of the scan")
    parser.add_argument("--close-holes", default=0, metavar="SIZE",
                        help="close holes of the low-poly mesh up to a size, such as 5cm or 2%%")
    parser.add_argument("--hard-angle", type=float, default=40, metavar="DEG",
                        help="edges with a larger angle are hard where the scan has them; 180: none is")
    parser.add_argument("--winding", choices=("auto", "keep"), default="auto",
                        help="auto turns pieces that are inside out")
    parser.add_argument("--report", action="store_true", help="also write report.html, a page to look at")
    parser.add_argument("--keep", metavar="DIR", help="keep the files between in DIR/bisque-steps")
    parser.add_argument("--memory", metavar="SIZE", help="for each step, such as 1G")
    parser.add_argument("-j", "--threads", type=int, default=0, metavar="N")
    parser.add_argument("--progress", choices=("auto", "bar", "json", "none"), default="auto",
                        help="on standard error; auto: a bar on a terminal, else a line every 30 s")
    parser.add_argument("--json", action="store_true", help="print the certificate instead of lines")
    parser.add_argument("--version", action="version", version=f"bisque-asset {core.version()}")
    return parser


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _lines_of(a: argparse.Namespace, certificate: dict) -> list[str]:
    """Returns what was made in words."""
    if a.part:
        return [f"{_printable(a.output)}: part {a.part}: {_counted(certificate['tiles'], 'tile')}"]
    if _has_levels(a):
        return [f"{_printable(a.output)}: {_counted(len(certificate['tiles']), 'tile')}"] + [
            f"level {i}: {mesh['triangles']} triangles in {_counted(mesh['tiles'], 'tile')}; farthest from the scan "
            f"{mesh['from_scan']['max']:.4g}" for i, mesh in enumerate(certificate["meshes"])]
    lines = [
        f"{_printable(a.output)}: {level['triangles']} triangles, {level['size']} x {level['size']} texels, "
        f"{level['surface']['method']}; farthest from the scan {level['distance']['from_scan']['max']:.4g}" +
        (f"; normals off by {level['normal_error']['mean']:.3g} degrees on average" if "normal_error" in level else "")
        for level in certificate["levels"]]
    if not a.up and certificate["levels"][0]["placement"]["preview_up"] == "z":
        lines.append("the preview takes z for upwards, the GLB file y: --up z turns it, and --up y the preview")
    return lines


def _print(a: argparse.Namespace, certificate: dict) -> None:
    """Prints what was made. Raises OSError."""
    _write("\n".join([json.dumps(certificate, default=float)] if a.json else _lines_of(a, certificate)) + "\n")


def _write(text: str) -> None:
    """Writes a text, and what was printed before, to standard output. Raises OSError."""
    if not sys.stdout:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF), "standard output")
    try:
        sys.stdout.reconfigure(errors="backslashreplace")
        sys.stdout.write(text)
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left must not fail again at the end
        raise OSError(error.errno, error.strerror, "standard output") from None


def _has_levels(a: argparse.Namespace) -> bool:
    return a.tiles or a.levels is not None


def _options_of(a: argparse.Namespace, parser: argparse.ArgumentParser) -> tuple[Callable[..., dict], dict]:
    """Returns the function that makes what is wanted, and its options. Refuses those that only the other one has."""
    if a.tiles and a.levels is not None:
        raise ValueError("--levels: not with --tiles")
    make, other = (tiles, asset) if _has_levels(a) else (asset, tiles)
    for name, value in vars(a).items():
        if name in {*other.__kwdefaults__} - {*make.__kwdefaults__} and value != parser.get_default(name):
            raise ValueError(f"--{name.replace('_', '-')}: {'not' if _has_levels(a) else 'only'} with --tiles"
                             f"{' and --levels' * (name != 'place')}")
    return make, {name: value for name, value in vars(a).items() if name in make.__kwdefaults__ and value is not None}


def _make(arguments: list[str], screen: _Screen) -> None:
    # -z after --up is no option, nor is -71.1,42.4,9 after --place.
    joined = re.sub(r"(?<=\0--up)\0(?=-[xyz]\0)|(?<=\0--place)\0(?=-[\d.])", "=",
                    "\0".join(["", *arguments, ""])).split("\0")[1:-1]
    parser = _parser()
    parser.refuse_unknown(joined)
    try:
        a = parser.parse_args(joined)
    except SystemExit:
        _write("")  # --help and --version
        raise
    make, options = _options_of(a, parser)
    screen.kind = a.progress
    if a.progress == "auto":
        screen.kind = "bar" if sys.stderr and sys.stderr.isatty() else "log"
    options |= {"progress": screen.progress} | ({} if _has_levels(a) else {"command": ["bisque-asset", *arguments]})
    certificate = make(a.scan if len(a.scan) > 1 else a.scan[0], a.output, **options)
    screen.end_bar()
    _print(a, certificate)


def _explain(error: BaseException) -> tuple[int, str]:
    """Returns the exit code and the line of a failure."""
    if isinstance(error, Error):
        return error.status, error.message
    if isinstance(error, MemoryError) or getattr(error, "errno", 0) == errno.ENOMEM:
        return 71, str(error) or "out of memory"
    if isinstance(error, OSError):
        status = 74 if error.errno in {*FAILED_IO, errno.EBADF} else 73
        place = error.filename or f"a file in {tempfile.gettempdir()} or beside the output"
        return status, f"{place}: {error.strerror or error}"
    if isinstance(error, (ValueError, TypeError)) and traceback.extract_tb(error.__traceback__)[-1].line.startswith(
            "raise "):
        return 64, str(error)  # of our own checks
    last = traceback.extract_tb(error.__traceback__)[-1]
    return 70, (f"a bug: {type(error).__name__}: {error} ({os.path.basename(last.filename)}:{last.lineno}); "
                "please report it")


def main(arguments: list[str] | None = None) -> int:
    """Runs the program; returns its exit code. The first signal ends the job in order, a second one at once."""
    screen = _Screen("none")

    def interrupt(*_: Any) -> NoReturn:
        bisque_start.catch(bisque_start.end_at_once)
        raise KeyboardInterrupt

    sys.unraisablehook = lambda what: what.exc_type is KeyboardInterrupt and bisque_start.end_at_once()
    warnings.simplefilter("always", UserWarning)
    warnings.showwarning = screen.warn
    try:
        bisque_start.catch(interrupt)
        _make(sys.argv[1:] if arguments is None else arguments, screen)
        status = 0
    except KeyboardInterrupt:
        screen.end_bar()
        status = 75
    except SystemExit as end:  # of --help and --version
        status = end.code or 0
    except BaseException as error:
        status, line = _explain(error)
        if status == 75:
            screen.end_bar()
        else:
            screen.say(line)
    bisque_start.catch(signal.SIG_IGN)
    if status == 75:
        screen.say("interrupted; the same command goes on from here")
    return status

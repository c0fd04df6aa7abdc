"""Scans that numpy makes: a sphere with waves, whose surface and normals a formula gives. And how
bisque-asset may end."""
import hashlib
import json
import os
import re
import signal
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

# A shell that starts tests in the background lets them ignore this signal, and so what they run.
signal.signal(signal.SIGINT, signal.default_int_handler)

RADIUS, WAVES, HEIGHT = 1.0, 9, 0.01


def radius_at(direction):
    return RADIUS + HEIGHT * np.sin(WAVES * direction[:, 0]) * np.cos(WAVES * direction[:, 1])


def sphere(steps, displaced):
    """Returns vertices and faces of a cube's grid on a sphere, welded, wound outwards."""
    t = np.tan(np.linspace(-np.pi / 4, np.pi / 4, steps + 1))
    u, v = np.meshgrid(t, t, indexing="ij")
    grid = np.stack([u, v, np.ones_like(u)], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(steps), np.arange(steps), indexing="ij")
    a = (i * (steps + 1) + j).ravel()
    quads = np.stack([a, a + steps + 1, a + steps + 2, a + 1], axis=1)
    points, faces = [], []
    for axis in range(3):
        for sign in (1, -1):
            side = grid * [1, 1, sign]
            turned = quads if sign > 0 else quads[:, ::-1]
            faces.append(turned + sum(map(len, points)))
            points.append(np.roll(side, axis, axis=1))
    points = np.concatenate(points)
    points /= np.linalg.norm(points, axis=1)[:, None]
    points, which = np.unique(points.round(12), axis=0, return_inverse=True)
    quads = which.reshape(-1)[np.concatenate(faces)]
    points *= (radius_at(points) if displaced else np.full(len(points), RADIUS))[:, None]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return points, np.ascontiguousarray(faces, np.int32)


@pytest.fixture(scope="session")
def scan():
    return sphere(120, True)


@pytest.fixture(scope="session")
def low(scan):
    import bisque

    return bisque.unwrap(bisque.simplify(scan, triangles=1500), size=256)


def write_png(path, color):
    """Writes an image of 4 x 4 texels of one colour."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(
            ">I", zlib.crc32(kind + data))
    rows = (b"\0" + bytes(color) * 4) * 4
    Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0))
                           + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


#: Exit codes of bisque-asset but 0, and 70, which is a bug.
FAILURES = (64, 65, 66, 69, 71, 73, 74, 75)
PROGRAM = os.path.join(os.path.dirname(sys.executable), "bisque-asset")


def command_of(arguments):
    return [PROGRAM, *map(str, arguments)]


def without_progress(done):
    """Takes lines of progress, which come by the clock, from what a run of bisque-asset said."""
    done.stderr = re.sub(r"^bisque-asset: .* % of all\n", "", done.stderr, flags=re.MULTILINE)
    return done


def run_asset(*arguments, **how):
    return without_progress(
        subprocess.run(command_of(arguments), capture_output=True, text=True, errors="replace", **how))


def certificate_of(output):
    """Returns the certificate of an asset after all its checksums were compared with its files."""
    output = Path(output)
    made = output.with_name(output.stem + "_asset")
    paper = made / "asset.json"
    certificate = json.loads(paper.read_text())
    levels = certificate["levels"]
    for level in levels:
        for name, checksum in level["files"].items():
            folder = output.parent if name.endswith((".glb", ".usdz")) else made / level["name"] if len(levels) > 1 else made
            assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == checksum, name
        assert any(name.endswith((".glb", ".usdz")) for name in level["files"])
    return certificate


def judge(done, output):
    """Checks that a run of bisque-asset ended with a certificate that is true, or with a documented
    exit code and one line. Returns the certificate, or None."""
    lines = [line for line in done.stderr.splitlines() if not line.startswith("bisque-asset: warning: ")]
    assert "Traceback" not in done.stderr, done.stderr
    if done.returncode == 0:
        assert not lines, done.stderr
        return certificate_of(output)
    assert done.returncode in FAILURES, (done.returncode, done.stderr)
    assert len(lines) == 1 and lines[0].startswith("bisque-asset: "), done.stderr
    return None

#!/usr/bin/env python3
"""baseline_reader.py open3d|trimesh SCAN.ply: reads a mesh with a library of Python.

Prints the cost of reading as baseline_assimp.cc does, without starting Python. The exit status is
69 if the library is not installed.
"""
import importlib
import resource
import sys
import time


def cost():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return time.monotonic(), usage.ru_utime, usage.ru_stime


def read(name, library, path):
    """Returns the number of triangles."""
    if name == "open3d":
        return len(library.io.read_triangle_mesh(path).triangles)
    return len(library.load(path, process=False).faces)


name, path = sys.argv[1:]
try:
    library = importlib.import_module(name)
except ImportError:
    print(f"{name} is not installed for {sys.executable}", file=sys.stderr)
    sys.exit(69)
begin = cost()
triangles = read(name, library, path)
for key, a, b in zip(("wall", "user", "system"), begin, cost()):
    print(f"parse.{key}={b - a:.4f}")
print(f"parse.rss_kib={resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}")
print(f"triangles={triangles}")

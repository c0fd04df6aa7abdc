"""Makes the extension bisque.lib._core: the part of the public headers that the package uses.

The compiler fills in the layout of structures ("...") from the headers and checks the members."""
import os
import shlex
import subprocess
from pathlib import Path

from cffi import FFI

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
BUILD = os.environ.get("BISQUE_BUILD", "build/release")  # as in setup.py

LIBS = subprocess.run(["make", "-s", "--no-print-directory", "print-libs"], cwd=ROOT, check=True,
                      capture_output=True, text=True).stdout
ARCHIVES = [str(ROOT / BUILD / f"lib/libbisque-{name}.a")
            for name in ("voxel", "bake", "formats", "base")]
INCLUDES = '\n'.join(f'#include "{name}"' for name in (
    "base/context.h", "base/job_files.h", "formats/file_kind.h", "formats/material/channels.h", "libvoxel/voxel.h", "libbake/bake.h",
    "libbake/compare.h"))

ffi = FFI()
ffi.cdef((HERE / "bisque.cdef").read_text())
ffi.set_source("bisque.lib._core", INCLUDES + f'\n#include "{HERE}/images.c"\n'
               "#include <meshoptimizer.h>",
               include_dirs=[str(ROOT)], extra_objects=ARCHIVES, py_limited_api=True,
               define_macros=[("_GNU_SOURCE", None)], extra_compile_args=["-std=gnu11", "-g0"],
               extra_link_args=["-Wl,--as-needed", "-Wl,--exclude-libs,ALL", "-pthread",
                                *shlex.split(LIBS), "-lmeshoptimizer"])

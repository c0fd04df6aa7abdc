"""Builds Bisque with make, links its libraries into the extension and puts its programs beside it.

bisque/bin has the programs, bisque/lib the extension, and bisque/lib/bisque the helpers, which both
find there. OpenImageIO and OpenVDB stay outside: their libraries are hundreds of megabytes.
"""
import os
import re
import shutil
import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
BUILD = os.environ.get("BISQUE_BUILD", "build/release")
PROGRAMS = [f"bin/bisque-{name}" for name in ("voxelize", "simplify", "bake", "compare")]
HELPERS = ["lib/bisque/bisque-gltf", "lib/bisque/bisque-devices", "lib/bisque/bisque-tiff"]
PAGE = ["share/bisque/report.html", "share/bisque/report.js"]


def version():
    text = (ROOT / "base/version.h").read_text()
    return ".".join(re.findall(r"define BSQ_VERSION_[MP]\w+ (\d+)", text))


def make():
    """Builds what the wheel carries, with as many jobs as there are processors."""
    archives = [f"{BUILD}/lib/libbisque-{name}.a" for name in ("voxel", "bake", "formats", "base")]
    targets = archives + [f"{BUILD}/{name}" for name in PROGRAMS + HELPERS + PAGE]
    subprocess.run(["make", "-s", f"-j{os.cpu_count()}", f"BUILD={BUILD}", *targets], cwd=ROOT,
                   check=True)


class Build(build_py):
    def run(self):
        super().run()
        for name in PROGRAMS + HELPERS + PAGE:
            target = Path(self.build_lib) / "bisque" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / BUILD / name, target)
            if name not in PAGE:
                subprocess.run(["strip", "--strip-unneeded", str(target)], check=True)


os.chdir(HERE)
make()
pages = [f"../../man/bisque-{name}.1" for name in ("asset", "bake", "compare", "simplify", "voxelize")]
setup(version=version(), cmdclass={"build_py": Build}, cffi_modules=["ffi_build.py:ffi"],
      data_files=[("share/man/man1", pages)])

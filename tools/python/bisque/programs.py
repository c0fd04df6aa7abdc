"""Runs a program of the wheel under its own name: the entry points bisque-bake and others."""
import os
import sys
from pathlib import Path


def main():
    name = Path(sys.argv[0]).name
    program = Path(__file__).parent / "bin" / name
    os.execv(program, [str(program), *sys.argv[1:]])

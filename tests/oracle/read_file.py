#!/usr/bin/env python3
"""read_file.py FILE...: accepts or refuses .tris and .nvdb files, with a reason.

This is a second reader of Bisque's files, written from formats/FORMATS.md alone. The exit status is
1 if a file is refused.
"""
import sys

import read_nvdb
import read_tris
from refusal import Refused


def parse(path, data):
    """Returns the content of a file of this name with these bytes, or raises Refused."""
    return (read_tris if path.endswith(".tris") else read_nvdb).read(data, True)


def read(path):
    """Returns the content of a file, or raises Refused."""
    with open(path, "rb") as file:
        return parse(path, file.read())


def main(paths):
    refused = 0
    for path in paths:
        try:
            read(path)
            print(f"{path}: ok")
        except Refused as reason:
            print(f"{path}: refused: {reason}")
            refused = 1
    return refused


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

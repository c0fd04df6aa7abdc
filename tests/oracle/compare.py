#!/usr/bin/env python3
"""compare.py [--count N] [--seed S] [--keep FOLDER] READ_FILES FILE...: compares
the readers of this folder with Bisque's.

READ_FILES is the program of read_files.c, the files are .tris and .nvdb files; files of a corpus
have no suffix and are taken for .tris files. Judges these and N more files of each kind: sound ones
of its own, ones with one odd property, and damaged ones. Both readers must
accept a file or both refuse it, and must read the same content, when the file is used and when it
is verified. Prints TAP lines. Keeps files on which they disagree in the folder.
"""
import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter

import numpy

import make_nvdb
import make_tris
import mutate
import read_nvdb
import read_tris
from content import content_checksum
from refusal import Refused

BSQ_EDATA = "-65"
ENDED = "the program ended"


class Kind:
    """A kind of file: its reader, and where files to test come from."""

    def __init__(self, name, reader, maker, damage):
        self.name, self.reader, self.maker, self.damage = name, reader, maker, damage
        self.sound = []

    def takes(self, path):
        """Checks if a path is one of this kind."""
        return path.endswith("." + self.name) or (self.name == "tris" and "." not in
                                                  os.path.basename(path))

    def next_file(self, random):
        """Returns a file and if it is sound (True), or may be either (None)."""
        choice = random.random()
        if choice < 0.7 and self.sound:
            data = self.sound[random.integers(0, len(self.sound))]
            return self.damage(random, data), None
        content = self.maker.make(random)
        sound = choice < 0.8 or None
        if not sound:
            self.maker.make_odd(random, content)
        data = bytes(self.maker.encode(content))
        if sound and len(self.sound) < 100:
            self.sound.append(data)
        return data, sound


KINDS = [Kind("tris", read_tris, make_tris, mutate.mutate_tris),
         Kind("nvdb", read_nvdb, make_nvdb, mutate.mutate_nvdb)]


def judge(reader, data):
    """Returns what a reader of this folder says of a file, as Verdict of the other one."""
    reasons, total = [], None
    for verify in (False, True):
        try:
            content = reader.read(data, verify)
            reasons.append(None)
            total = content_checksum(content) if not verify else total
        except Refused as reason:
            reasons.append(str(reason))
    return reasons[0], reasons[1], total


class OtherReader:
    """Bisque's readers, in a process that answers a line for each path."""

    def __init__(self, program, folder):
        self.folder = folder
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def judge(self, data, suffix):
        """Returns what Bisque says of a file: two reasons or None, and the content's checksum."""
        path = os.path.join(self.folder, "x." + suffix)
        with open(path, "wb") as file:
            file.write(data)
        self.process.stdin.write(path.encode() + b"\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline().decode()
        if not line.endswith("\n"):
            return ENDED, ENDED, None
        used, verified, total, message = line.rstrip("\n").split(" ", 3)
        if not {used, verified} <= {"0", BSQ_EDATA}:
            return f"{message} (status {used}, {verified})", None, None
        reasons = [None if status == "0" else message for status in (used, verified)]
        return reasons[0], reasons[1], int(total, 16) if used == "0" else None

    def close(self):
        """Ends the process and returns its exit status."""
        self.process.stdin.close()
        return self.process.wait()


def disagreement(ours, theirs, sound):
    """Returns in one line where the verdicts differ, or None."""
    for name, mine, other in (("used", ours[0], theirs[0]), ("verified", ours[1], theirs[1])):
        if (mine is None) != (other is None):
            return f"{name}: read_files says {other or 'ok'}, this reader says {mine or 'ok'}"
    if ours[2] != theirs[2]:
        return "the content that was read differs"
    if sound and ours[1]:
        return f"a sound file is refused: {ours[1]}"
    return None


def files_of(kind, paths, random, count):
    """Yields name, bytes and soundness of each file to judge. Sound ones are damaged later."""
    for path in paths:
        with open(path, "rb") as file:
            data = file.read()
        if judge(kind.reader, data)[1] is None:
            kind.sound.append(data)
        yield os.path.basename(path), data, None
    for i in range(count):
        yield str(i), *kind.next_file(random)


def compare(kind, other, paths, options):
    """Compares the readers over many files; returns how many they agree and disagree on."""
    random = numpy.random.default_rng(options.seed)
    counts, bad = Counter(), 0
    for name, data, sound in files_of(kind, paths, random, options.count):
        ours, theirs = judge(kind.reader, data), other.judge(data, kind.name)
        counts["refused" if ours[0] else "used" if ours[1] else "verified"] += 1
        why = disagreement(ours, theirs, sound)
        if why:
            bad += 1
            keep(options, f"{options.seed}-{name}.{kind.name}", data, why)
        if theirs[0] == ENDED:
            break
    print(f"# {kind.name}, seed {options.seed}: {counts['verified']} files verified, "
          f"{counts['used']} fit for use only, {counts['refused']} refused")
    return counts.total() - bad, bad


def keep(options, name, data, why):
    """Reports a disagreement and keeps the file."""
    print(f"# {name}: {why}")
    if options.keep:
        os.makedirs(options.keep, exist_ok=True)
        with open(os.path.join(options.keep, name), "wb") as file:
            file.write(data)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep")
    parser.add_argument("program")
    parser.add_argument("files", nargs="*")
    options = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        other = OtherReader(options.program, folder)
        for number, kind in enumerate(KINDS, 1):
            paths = [p for p in options.files if kind.takes(p)]
            good, bad = compare(kind, other, paths, options)
            print(f"{'not ok' if bad else 'ok'} {number} - {kind.name}: both readers agree on "
                  f"{good} files, and disagree on {bad}")
            failed += bad
        if other.close() != 0:
            print("not ok 3 - read_files ends well")
            failed += 1
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

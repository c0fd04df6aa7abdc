"""Every warning that the programs can give reaches the asset's certificate and page.

The list is taken from the sources: a warning that is neither in RECIPES nor in FED fails the test."""
import json
import re
import struct
import sys
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import bisque
import numpy as np
import pytest
from conftest import certificate_of, judge, run_asset, sphere, write_png

TOP = Path(__file__).resolve().parents[2]
CORNERS = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
QUADS = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]


def formats():
    """Returns the formats of all calls that warn, with conversions as C has them."""
    found = set()
    for folder in ("base", "formats", "libvoxel", "libbake", "tools"):
        for path in sorted((TOP / folder).rglob("*.c*")):
            if path.suffix in (".c", ".cc"):
                for call in re.finditer(r'\bbsq_warn(?:_loss)?\(\s*[^,"]+?,\s*((?:"(?:[^"\\]|\\.)*"|PRIu64|\s)+)',
                                        path.read_text()):
                    parts = re.findall(r'"((?:[^"\\]|\\.)*)"|(PRIu64)', call[1])
                    found.add("".join(text.replace('\\"', '"') or "llu" * bool(number) for text, number in parts))
    return found - {""}


CONVERSION = re.compile(r"%[-+ #0]*\d*(?:\.\d+)?(?:ll)?([duxsgfc%])")


def pattern_of(text):
    """Returns an expression for the lines that a format makes."""
    at, result = 0, ""
    for found in CONVERSION.finditer(text):
        result += re.escape(text[at:found.start()]) + ("%" if found[1] == "%" else ".*")
        at = found.end()
    return re.compile(result + re.escape(text[at:]), re.DOTALL)


def example_of(text):
    """Returns a line that a format makes."""
    return CONVERSION.sub(lambda found: {"%": "%", "s": "a \"name\" with <tags> & \u00e9"}.get(found[1], "7"), text)


# ---- meshes that provoke warnings ----

def cube(path, head="", faces=None, vertices=None, texcoords=False, tail=""):
    """Writes a cube as an OBJ file; faces: lines by which the usual ones are replaced."""
    lines = [f"v {' '.join(map(str, v))}" for v in vertices or CORNERS]
    lines += ["vt 0.1 0.1", "vt 0.9 0.1", "vt 0.9 0.9", "vt 0.1 0.9"]
    usual = ["f " + " ".join(f"{c}/{k}" if texcoords else str(c) for k, c in enumerate(quad, 1)) for quad in QUADS]
    Path(path).write_text("\n".join([head, *lines, *(faces or usual), tail]) + "\n")
    return path


def with_library(folder, library, texcoords=False, **how):
    (folder / "a.mtl").write_bytes(library if isinstance(library, bytes) else library.encode())
    how.setdefault("head", "mtllib a.mtl\nusemtl a")
    return [cube(folder / "scan.obj", texcoords=texcoords, **how)]


def ply(path, vertex="", face="", more="", comment="", colors=False, tail=b""):
    """Writes a cube as a PLY file with more properties, a list of them: "uchar quality"."""
    def declared(properties):
        return "".join(f"property {name}\n" for name in properties.split(",") if name)
    header = f"ply\nformat binary_little_endian 1.0\n{comment}element vertex 8\n" + declared(
        "float x,float y,float z," + vertex) + "element face 6\nproperty list uchar int vertex_indices\n" + declared(
            face) + more + "end_header\n"
    rows = b"".join(struct.pack("<3f", *v) + bytes([50] * len([n for n in vertex.split(",") if n])) for v in CORNERS)
    rows += b"".join(struct.pack("<B4i", 4, *(c - 1 for c in quad)) + bytes([50] * len(
        [n for n in face.split(",") if n])) for quad in QUADS)
    Path(path).write_bytes(header.encode() + rows + tail)
    return [path]


def stl(path, tail=b"", head=b"cube"):
    triangles = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *(x for c in t for x in CORNERS[c - 1]), 0) for t in triangles)
    Path(path).write_bytes(head.ljust(80, b"\0") + struct.pack("<I", len(triangles)) + body + tail)
    return [path]


def stl_text(path):
    lines = ["solid cube"]
    for a, b, c, d in QUADS:
        for t in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop", *("vertex %d %d %d" % CORNERS[i - 1] for i in t),
                      "endloop", "endfacet"]
    Path(path).write_text("\n".join(lines) + "\n")
    return [path]


def two_files(folder, first, second):
    lines = [[f"v {' '.join(map(str, v))}{colour}" for v in CORNERS] for colour in (first, second)]
    for name, rows, x in (("one", lines[0], 0), ("two", lines[1], 3)):
        moved = [re.sub(r"^v (\d)", lambda m: f"v {int(m[1]) + x}", row) for row in rows]
        (folder / f"{name}.obj").write_text("\n".join(moved + ["f " + " ".join(map(str, q)) for q in QUADS]) + "\n")
    return [folder / "one.obj", folder / "two.obj"]


def textured(folder, statement, image="t.png", texcoords=True, **how):
    if image:
        write_png(folder / image, (200, 100, 50))
    return with_library(folder, f"newmtl a\nKd 1 1 1\n{statement}\n", texcoords, **how)


def ball(folder, keep=lambda points: points[:, 2] < 2, copies=((1, 1),), low=None, more=""):
    """Writes spheres with radii and winding 1 or -1, of the triangles that are kept; low: a factor of the
    radius of a low-poly mesh with UVs."""
    points, faces = sphere(24, False)
    faces = faces[keep(points[faces].mean(axis=1))]
    rows = [points * radius for radius, _ in copies]
    parts = [faces[:, ::way] + k * len(points) for k, (_, way) in enumerate(copies)]
    given = [folder / "scan.obj"]
    bisque.Mesh(np.concatenate(rows), np.concatenate(parts)).save(given[0])
    given[0].write_text(given[0].read_text() + more)
    if low:
        points, faces = sphere(6, False)
        mesh = bisque.unwrap((points * low, faces), size=64)
        mesh.save(folder / "low.obj")
        given += ["--low", folder / "low.obj"]
    return given


#: Arguments of bisque-asset, and parts of the formats of the warnings that it gives then.
RECIPES = {
    "a damaged library": (lambda d: with_library(d, b"newmtl a\nKd red\nwhat is this\n\0\0"), [
        '%s:%llu: %s: "%.60s"', "lines with statements that are not of the format", "not a text file (zero byte)"]),
    "a missing library": (lambda d: [cube(d / "scan.obj", head="mtllib none.mtl\nusemtl a")], [
        "%s: %s: %s: its materials are missing"]),
    "no library": (lambda d: [cube(d / "scan.obj", head="usemtl a")], ["no material library is named"]),
    "a library of others": (lambda d: with_library(d, "newmtl b\nKd 1 0 0\n", faces=[
        "usemtl a", "f 1 3 4 2", "usemtl b", "f 5 6 8 7", "f 1 2 6 5"]), ["no material library describes"]),
    "faces without material": (lambda d: with_library(d, "newmtl b\nKd 1 0 0\n", head="mtllib a.mtl", faces=[
        "f 1 3 4 2", "usemtl b", "f 5 6 8 7", "f 1 2 6 5"]), ["faces without a material"]),
    "no face with material": (lambda d: textured(d, "map_Kd t.png", head="mtllib a.mtl"), [
        "no face has a material, so textures such as"]),
    "a missing texture": (lambda d: textured(d, "map_Kd none.png", image=None), ['material "%s" goes without it']),
    "missing textures": (lambda d: textured(d, "map_Kd none.png\nnewmtl b\nmap_Kd none.png", image=None, faces=[
        "usemtl a", "f 1/1 3/2 4/3 2/4", "usemtl b", "f 5/1 6/2 8/3 7/4"]), ["materials that go without it"]),
    "faces without texcoords": (lambda d: textured(d, "map_Kd t.png", faces=[
        "f 1/1 3/2 4/3 2/4", "f 5 6 8 7", "f 1 2 6 5"]), ["faces without texture coordinates"]),
    "a texture for nothing": (lambda d: ["--texture", textured(d, "") and d / "t.png", *ball(d)], [
        "no texture coordinates, %s is not used"]),
    "missing tiles": (lambda d: textured(d, "map_Kd t.<UDIM>.png", image="t.1001.png", tail="vt 1.5 0.5\n"
                                         "vt 1.6 0.5\nvt 1.6 0.6\nvt -2.5 0.5\nvt -2.6 0.5\nvt -2.6 0.6\n"
                                         "f 1/5 2/6 3/7\nf 1/8 2/9 4/10"),
                      ["no file that can be read", "outside of all tiles"]),
    "a PLY file's unknown": (lambda d: ply(d / "s.ply", vertex="uchar quality",
                                           more="element camera 1\nproperty uchar a\n", tail=b"1234"), [
        "%s: %u %s of", "elements", "bytes after the last element not read"]),
    "a PLY file's texture": (lambda d: ply(d / "s.ply", comment="comment TextureFile t.png\n"), [
        "so the texture %s is not used"]),
    "a PLY file's colours": (lambda d: ply(d / "s.ply", vertex="uchar red,uchar green,uchar blue",
                                           face="uchar red,uchar green,uchar blue"), ["colours of faces are not used"]),
    "an STL file's end": (lambda d: stl(d / "s.stl", b"1234"), ["bytes after the last triangle not read"]),
    "an STL file's colours": (lambda d: stl(d / "s.stl", head=b"COLOR=1234"), ["colours of STL files"]),
    "a cut STL file": (lambda d: stl_text(d / "s.stl"), ['"endsolid" is missing']),
    "corners for nothing": (lambda d: [cube(d / "scan.obj", faces=["f 1/1 3/2 4/99 2/4", "f 5/1 6/2 8/3 7/4"])], [
        "corners that refer to a %s"]),
    "a face without a position": (lambda d: ball(d, more="v nan 0 0\nf 1 2 -1\n"), ["faces left out"]),
    "odd lines": (lambda d: [cube(d / "scan.obj", tail="f 1 2\nwhat is this\n")], ["%s:%s%llu: %s: %llu"]),
    "paint for a vertex of eight": (lambda d: [cube(d / "scan.obj", tail="#MRGB ff112233")], ["%s: %s"]),
    "bright colours": (lambda d: [cube(d / "scan.obj", vertices=[(*v, 0.5, 0.5, 7) for v in CORNERS])], [
        "colours out of range were clamped"]),
    "files with and without colours": (lambda d: two_files(d, " 0.5 0.5 0.5", ""), ["files like this"]),
    "an open border": (lambda d: [*ball(d, lambda p: p[:, 2] < 0.5), "--maps", "normal,thickness"], [
        "map thickness: %.0f"]),
    "two layers": (lambda d: [*ball(d, copies=((1, 1), (1.02, 1)), low=1.0), "--surface", "exact"], [
        "has another layer within"]),
    "misses": (lambda d: [*ball(d, lambda p: p[:, 2] < 0.2, low=1.0)], ["of the samples found no surface"]),
    "another mesh": (lambda d: [*ball(d, low=9.0)], ["does not fit"]),
    "a mesh without normals": (lambda d: [*ball(d, low=1.0)], ["has no normals%s"]),
    "too many threads": (lambda d: [*ball(d), "-j", 1 << 16], ["threads are more than this machine can use"]),
}

#: Scans and meshes that are refused after the warning.
REFUSED = {"another mesh"}

#: Parts of the formats of warnings that bisque-asset's steps do not provoke.
FED = [
    "BSQ_SIMD=%s", "parts like this", "%s: %llu %s", "%s: %s: its materials are missing", "not used; the first",
    "texels that are not finite", "%s is not used: %s", "going on with", "lies more than a tenth",
    "is it the mesh of this scan", "coarse for the edges", "fell together", "no map color is baked",
    "no map id is baked", "map curvature: no surface", "tangents are not used",
    "scales that differ by axis", "samples too large for 16 bits", "has no effect: it needs",
    "do not all have the channel", "coarse for voxels", "vertices without a colour", "no faces with %s",
    "no material has a value", 'material "%s": %s: %s%s', "its value is not used",
    "the grid will have about", "voxels have colours below 0", "--preset: the scan has no", "charts overlap",
    "triangles instead of", "in a grid of %lld", "the processor bakes it",
    "temporary file cannot be removed", "do not have the same kind", "is not kept, because %s has none",
    "textures of materials are not kept",
]


def matching(part):
    return [text for text in formats() if part in text]


def test_each_warning_has_a_case():
    known = [part for _, parts in RECIPES.values() for part in parts] + FED
    missing = [text for text in formats() if text != "%s" and not any(part in text for part in known)]
    assert len(formats()) > 40 and not missing


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Runs all recipes, each a second time with what the first run kept. Returns output and ends by names."""
    given = {}
    for name, (make, _) in RECIPES.items():
        folder = tmp_path_factory.mktemp("recipe")
        given[name] = [*make(folder), "-o", folder / "a.glb", "--size", 32, "--keep", folder / "k"]
        given[name] += ["--triangles", 40] * ("--low" not in given[name])

    def run(name):
        folder = given[name][given[name].index("-o") + 1]
        first = run_asset(*given[name])
        return name, (folder, first, judge(first, folder), run_asset(*given[name]))

    with ThreadPoolExecutor(2) as pool:
        return dict(pool.map(run, RECIPES))


@pytest.mark.parametrize("name", RECIPES)
def test_a_mesh_provokes_its_warnings(name, runs):
    out, done, certificate, again = runs[name]
    parts = RECIPES[name][1]
    lines = [line.removeprefix("bisque-asset: warning: ") for line in done.stderr.splitlines()]
    for part in parts:
        patterns = [pattern_of(text) for text in matching(part)]
        assert any(p.fullmatch(line) for p in patterns for line in lines), (part, lines)
    if not certificate:
        assert name in REFUSED, lines
        return
    assert set(lines) == set(certificate["warnings"] + certificate["levels"][0]["warnings"])
    assert judge(again, out)["levels"][0]["warnings"] == certificate["levels"][0]["warnings"]
    assert certificate_of(out)["warnings"] == certificate["warnings"]
    assert again.stderr.count("warning: ") == len(set(lines))


#: Lines of kinds that nobody knows.
STRANGE = ['{"note": "new in the next version"}', "[1, 2]", "5", "null", '{"stage": 5}', '{"warning": null}',
           '{"stage": "a", "unit": "b", "done": "c", "total": 1}', '{"broken', "{", "[" * 5000, "plain words"]


def test_lines_of_all_kinds_are_passed_on(tmp_path, monkeypatch):
    from bisque import programs

    fed = [example_of(text) for text in sorted(formats())]
    said = tmp_path / "said"
    said.write_bytes(b"".join(json.dumps({"warning": line}).encode() + b"\n" for line in fed) +
                     "\n".join(STRANGE).encode() + b"\n\xff\xfe\n")
    (tmp_path / "bin").mkdir()
    fake = tmp_path / "bin/bisque-bake"
    fake.write_text(f"#!/bin/sh\ncat '{said}' >&2\nexec '{programs.BIN}/bisque-bake' \"$@\"\n")
    fake.chmod(0o755)
    (tmp_path / "bin/bisque-voxelize").symlink_to(programs.BIN / "bisque-voxelize")
    monkeypatch.setattr(programs, "BIN", tmp_path / "bin")
    with pytest.warns(UserWarning):
        certificate = bisque.asset(ball(tmp_path)[0], tmp_path / "a.glb", triangles=40, size=32, report=True)
    lines = certificate["levels"][0]["warnings"]
    assert set(fed) <= set(lines) and set(STRANGE) <= set(lines)
    page = (tmp_path / "a_asset/report.html").read_text()
    shown = json.loads(re.search(r' id="data">(.*)</script>', page)[1])["warnings"]
    assert set(fed) | set(STRANGE) <= set(shown)
    assert certificate_of(tmp_path / "a.glb")["levels"][0]["warnings"] == lines


def test_blender_passes_lines_on(tmp_path):
    """The extension's jobs, without Blender."""
    import importlib.util

    folder = TOP / "tools/blender/bisque"
    package = types.ModuleType("extension")
    package.__path__ = [str(folder)]
    sys.modules["extension"] = package
    spec = importlib.util.spec_from_file_location("extension.jobs", folder / "jobs.py")
    jobs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(jobs)
    fed = [example_of(text) for text in sorted(formats())]
    said = tmp_path / "said"
    said.write_text("\n".join([*(json.dumps({"warning": line}) for line in fed), *STRANGE,
                               '{"stage": "tracing", "unit": "rays", "done": 1, "total": 4}']) + "\n")
    for printed, code in (("{}", 0), ("nothing", 70), ("", 70)):
        job = jobs.Job([["sh", "-c", f"cat '{said}' >&2; echo '{printed}'"]])
        job.process.wait()
        while not job.poll():
            pass
        assert job.code == code and job.stage == "tracing" and job.share == 0.25
        assert job.messages[:len(fed) + len(STRANGE)] == fed + STRANGE
    assert jobs.Job([["sh", "-c", "exit 3"], ["never"]]).process.wait() == 3


if __name__ == "__main__":
    print(*sorted(formats()), sep="\n")

"""unusual.py DIRECTORY: writes files that hold one mesh in unusual ways, and the list cases.

Each line of cases has the name of a file and, after a tab, the warning that it gets, if any. A file
huge.gltf is not among them. The mesh has the vertices (0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.5) and the faces 0 1 2 and 1 3 2.
"""
import base64
import json
import os
import struct
import sys

POINTS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.5))
FACES = ((0, 1, 2), (1, 3, 2))
cases = {}


def case(name, data, warning=""):
    assert name not in cases
    cases[name] = warning
    with open(name, "wb") as file:
        file.write(data if isinstance(data, bytes) else data.encode())


# ---- PLY ----

XYZ = "property float x\nproperty float y\nproperty float z\n"
VERTEX = "element vertex 4\n" + XYZ
FACE = "element face 2\nproperty list uchar int vertex_indices\n"
LINES = "".join("%g %g %g\n" % p for p in POINTS)
INDICES = "3 0 1 2\n3 1 3 2\n"


def header(vertex=VERTEX, face=FACE, encoding="ascii"):
    return f"ply\nformat {encoding} 1.0\n{vertex}{face}end_header\n"


def ply():
    text = header() + LINES + INDICES
    little = header(encoding="binary_little_endian")
    data = b"".join(struct.pack("<3f", *p) for p in POINTS) + \
        b"".join(struct.pack("<B3i", 3, *f) for f in FACES)
    case("crlf.ply", text.replace("\n", "\r\n"))
    case("cr.ply", text.replace("\n", "\r"))
    case("crlf_binary.ply", little.replace("\n", "\r\n").encode() + data)
    case("cr_binary.ply", little.replace("\n", "\r").encode() + data)
    case("mixed_ends.ply", little.replace("\n", "\r\n", 3).encode() + data)
    case("mark.ply", "\ufeff" + text)
    case("mark_binary.ply", b"\xef\xbb\xbf" + little.encode() + data)
    case("tabs.ply", text.replace(" ", " \t "))
    case("blank_lines.ply", header() + "\n" + LINES.replace("\n", "\n\n") + INDICES)
    case("no_end.ply", text.rstrip())
    case("obj_info.ply", text.replace("element", "obj_info num_cols 3\nobj_info\ncomment\nelement")
         .replace("end_header", "comment last\nend_header"))
    case("comment_first.ply", text.replace("ply\n", "ply\ncomment before the format\n"))
    case("long_comment.ply", text.replace("element face", "comment " + "y" * 70000 + "\nelement face"))
    case("list_first.ply", header(vertex="element vertex 4\nproperty list uchar int odd\n" + XYZ) +
         "".join(f"{i} {'7 ' * i}" + "%g %g %g\n" % p for i, p in enumerate(POINTS)) + INDICES,
         '1 property of "vertex" not read: odd')
    case("list_first_binary.ply",
         header(vertex="element vertex 4\nproperty list uchar int odd\n" + XYZ,
                encoding="binary_big_endian").encode() +
         b"".join(struct.pack(">B%di3f" % i, i, *[7] * i, *p) for i, p in enumerate(POINTS)) +
         b"".join(struct.pack(">B3i", 3, *f) for f in FACES), '1 property of "vertex" not read: odd')
    case("doubles.ply", header(VERTEX.replace("float", "double"), FACE.replace("uchar int", "uint ushort"),
                               "binary_little_endian").encode() +
         b"".join(struct.pack("<3d", *p) for p in POINTS) +
         b"".join(struct.pack("<I3H", 3, *f) for f in FACES))
    case("wide.ply", header(face=FACE.replace("uchar int", "uint64 int64"),
                            encoding="binary_little_endian").encode() +
         data[:48] + b"".join(struct.pack("<4q", 3, *f) for f in FACES))
    case("edges.ply", header(face=FACE + "element edge 1\nproperty int vertex1\n") + LINES + INDICES + "0\n",
         '1 elements "edge" not read')
    case("rest.ply", text + "3 0 1 2\n", "8 bytes after the last element not read")


# ---- STL ----

def binary_stl(title, rest=b""):
    return title.ljust(80).encode() + struct.pack("<I", 2) + b"".join(
        struct.pack("<12fH", 0, 0, 1, *(c for i in f for c in POINTS[i]), 0) for f in FACES) + rest


def stl():
    facets = "".join("facet normal 0 0 1\n outer loop\n" +
                     "".join("  vertex %g %g %g\n" % POINTS[i] for i in f) + " endloop\nendfacet\n"
                     for f in FACES)
    text = "solid a b c\n" + facets + "endsolid a b c\n"
    case("rest.stl", binary_stl("x", b"14 bytes more."), "14 bytes after the last triangle not read")
    case("solid.stl", binary_stl("solid in binary"))
    case("upper.stl", text.upper())
    case("crlf.stl", text.replace("\n", "\r\n"))
    case("mark.stl", "\ufeff" + text)
    case("blank.stl", "\n\n" + text)
    case("nan_normal.stl", text.replace("0 0 1", "nan nan -nan(ind)", 1))
    case("empty_solid.stl", "solid none\nendsolid none\n" + text)
    case("no_end.stl", text.replace("endsolid a b c\n", ""), '"endsolid" is missing: the file may be incomplete')


# ---- OBJ ----

def obj():
    v = "".join("v %g %g %g\n" % p for p in POINTS)
    f = "f 1 2 3\nf 2 4 3\n"
    case("plain.obj", v + f)
    case("continued.obj", "v 0 0 \\\n0\n" + v[8:] + "f 1 \\\n 2 \\\r\n 3\nf 2 4 \\\n3")
    case("continued_end.obj", v + f + "# C:\\\\\nl 1 2 \\")
    case("negative.obj", v + "f -4 -3 -2\nf -3 -1 -2")
    case("blanks.obj", "\n\n  " + v.replace("\n", " \t\n  ") + "f 1 2 3   \t \nf   2\t4   3 \r\n")
    case("lines_points.obj", v + "l 1 2 3\np 1 2 3\nvp 0.1 0.2\n" + f)
    case("curves.obj", v + "cstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\nparm u 0 1\nend\ncurv2 1 2\n" + f)
    case("surface.obj", v + "cstype bspline\nsurf 0 1 0 1 1 2 3 4\nparm u 0 1\nend\n" + f + "bsp 1 2\n",
         "6: free-form surfaces, which are not read: 2; this is the first")
    case("slashes.obj", v + "f 1/ 2/ 3/\nf 2// 4// 3//\n")
    case("comments.obj", v + "f 1 2 3 # first\nf 2 4 3#second\n")
    case("comment_glued.obj", v + "vt 0 0\nf 1/1 2/1 3/1#first\nf 2 4 3#second\n")
    case("long_lines.obj", v + "# " + "x" * 600000 + "\ng " + "x" * 600000 + "\n" + f)
    case("fo.obj", v + f.replace("f", "fo"))
    case("cr.obj", (v + f).replace("\n", "\r"))
    case("plus.obj", v.replace("0.5", "+0.5") + f.replace("4", "+4"))
    case("old.obj", "csh -ls\n" + v + "mg off\ns off\nlod 3\nbevel on\nusemap off\nmaplib y\n" + f)
    case("latin1.obj", b"# caf\xe9\no caf\xe9\n" + (v + f).encode())


# ---- glTF ----

def gltf(name, warning="", points=POINTS, faces=FACES, indices=True, mode=4, **members):
    data = b"".join(struct.pack("<3f", *p) for p in points) + struct.pack("<6B", *faces[0], *faces[1])
    primitive = {"attributes": {"POSITION": 0}, "mode": mode, **({"indices": 1} if indices else {})}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
                      {"bufferView": 1, "componentType": 5121, "count": 6, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": 12 * len(points)},
                        {"buffer": 0, "byteOffset": 12 * len(points), "byteLength": 6}],
        "buffers": [{"byteLength": len(data),
                     "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}]}
    for key in ("targets", "attributes", "material"):
        primitive.update({key: members.pop(key)} if key in members else {})
    document["meshes"][0].update({"weights": members.pop("weights")} if "weights" in members else {})
    document.update(members)
    case(name, json.dumps(document), warning)
    return json.dumps(document).encode()


def glb(name, text, chunks=b"", rest=b""):
    text += b" " * (-len(text) % 4)
    case(name, b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(chunks)) +
         struct.pack("<I", len(text)) + b"JSON" + text + chunks + rest)


def all_gltf():
    text = gltf("plain.gltf")
    a, b, c, d = POINTS
    gltf("list.gltf", points=(a, b, c, b, d, c), indices=False)
    gltf("strip.gltf", indices=False, mode=5)
    gltf("fan.gltf", points=(b, d, c, a), indices=False, mode=6)
    gltf("rest.gltf", "2 indices of incomplete triangles are not read", points=(a, b, c, b, d, c, a, a),
         indices=False)
    gltf("mirrored.gltf", points=[(-x, y, z) for x, y, z in POINTS], faces=[f[::-1] for f in FACES],
         nodes=[{"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}])
    gltf("turned.gltf", points=[(-x, -y, z) for x, y, z in POINTS],
         nodes=[{"mesh": 0, "rotation": [0, 0, 1, 0]}])
    gltf("scenes.gltf", "1 nodes with meshes are not in the scene and are not read", scene=1,
         scenes=[{"nodes": [1]}, {"nodes": [0]}], nodes=[{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}])
    morphed = "1 meshes have weights of morph targets, which are not applied"
    target = [{"POSITION": 0}]
    gltf("morph.gltf", targets=target)
    gltf("zero.gltf", targets=target, nodes=[{"mesh": 0, "weights": [0.0]}])
    gltf("weights.gltf", morphed, targets=target, nodes=[{"mesh": 0, "weights": [0.5]}])
    gltf("mesh_weights.gltf", morphed, targets=target, weights=[1])
    gltf("skin.gltf", "1 meshes have skins, which are not applied: they are in bind pose", nodes=[{"mesh": 0, "skin": 0}, {}],
         skins=[{"joints": [1]}])
    gltf("unlit.gltf", extensionsUsed=["KHR_materials_unlit"], extensionsRequired=["KHR_materials_unlit"],
         materials=[{"extensions": {"KHR_materials_unlit": {}}}])
    gltf("unknown.gltf", extensionsUsed=["XX_unknown", "KHR_lights_punctual"], extras={"a": [1]})
    gltf("camera.gltf", nodes=[{"mesh": 0, "children": [1]}, {"camera": 0}],
         cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}])
    gltf("newer.gltf", asset={"version": "2.1", "minVersion": "2.0"})
    gltf("custom.gltf", attributes={"POSITION": 0, "_FEATURE": 0})
    case("mark.gltf", b"\xef\xbb\xbf" + text)
    glb("chunk.glb", text, struct.pack("<I", 8) + b"XTRA12345678")
    glb("rest.glb", text, rest=b"trailing")


def huge():
    """Factors beyond all colours."""
    gltf("huge.gltf", material=0, materials=[{
        "alphaMode": "BLEND", "emissiveFactor": [1e300, 0, 0],
        "pbrMetallicRoughness": {"baseColorFactor": [1e300, -1e300, 0, 1e300], "roughnessFactor": 1e300}}])
    del cases["huge.gltf"]


os.chdir(sys.argv[1])
ply()
stl()
obj()
all_gltf()
huge()
with open("cases", "w") as out:
    out.writelines(f"{name}\t{warning}\n" for name, warning in cases.items())

"""Random scans and low-poly meshes of one shape, and writers of meshes and images."""

import gzip
import math
import shutil
import struct
import subprocess
import zlib


class Shape:
    """A surface over (u, v) in the unit square: a sheet, a ball or a tube, at a random place."""

    def __init__(self, random):
        self.kind = random.choice(["sheet", "ball", "tube"])
        self.size = random.choice([1, 1, 1, 0.01, 300])
        self.at = [random.choice([0, 0, random.uniform(-9, 9), 5e5]) * self.size for _ in range(3)]
        self.depth = random.choice([0, 0.01, 0.05]) * self.size
        self.waves = random.randint(1, 9)

    def point(self, u, v, rough, shift=0):
        """Returns a point; `rough` adds the detail of the scan. shift: moves it along x."""
        bump = self.depth * math.sin(self.waves * 6 * u) * math.cos(self.waves * 5 * v) if rough else 0
        if self.kind == "sheet":
            x, y, z = self.size * u, self.size * v, bump
        else:
            polar = math.pi * (0.1 + 0.8 * v)
            wide = math.sin(polar) if self.kind == "ball" else 1
            r = 0.4 * self.size + bump
            x, y = r * wide * math.cos(2 * math.pi * u), r * wide * math.sin(2 * math.pi * u)
            z = -r * math.cos(polar) if self.kind == "ball" else self.size * v
        return x + shift * 1.5 * self.size + self.at[0], y + self.at[1], z + self.at[2]


class Mesh:
    """Vertices with optional attributes, and parts: (object, material, faces)."""

    def __init__(self):
        self.points, self.uvs, self.normals, self.colors, self.parts = [], [], [], [], []
        self.library = None


def normal_of(shape, u, v, rough):
    a, b = shape.point(u - 1e-4, v, rough), shape.point(u + 1e-4, v, rough)
    c, d = shape.point(u, v - 1e-4, rough), shape.point(u, v + 1e-4, rough)
    e, f = [q - p for p, q in zip(a, b)], [q - p for p, q in zip(c, d)]
    n = [e[(k + 1) % 3] * f[(k + 2) % 3] - e[(k + 2) % 3] * f[(k + 1) % 3] for k in range(3)]
    length = math.sqrt(sum(x * x for x in n)) or 1
    return [x / length for x in n]


def patch(mesh, random, shape, columns, rows, rough, name, material, place, shift=0, quads=True):
    """Adds a grid of faces. place: maps (u, v) to texture coordinates, or None."""
    first = len(mesh.points)
    for j in range(rows + 1):
        for i in range(columns + 1):
            u, v = i / columns, j / rows
            mesh.points.append(shape.point(u, v, rough, shift))
            mesh.normals.append(normal_of(shape, u, v, rough))
            mesh.colors.append([random.randint(0, 255) for _ in range(3)])
            mesh.uvs.append(place(u, v) if place else (u, v))
    faces = []
    for j in range(rows):
        for i in range(columns):
            a = first + j * (columns + 1) + i
            b, c, d = a + 1, a + columns + 2, a + columns + 1
            faces += [(a, b, c, d)] if quads else [(a, b, c), (a, c, d)]
    mesh.parts.append((name, material, faces))


def write_obj(mesh, path, uvs, normals, colors):
    with open(path, "w") as out:
        if mesh.library:
            out.write("mtllib %s\n" % mesh.library)
        for p, c in zip(mesh.points, mesh.colors):
            out.write("v %.9g %.9g %.9g" % tuple(p) + (" %g %g %g" % tuple(x / 255 for x in c) if colors else ""))
            out.write("\n")
        for t in mesh.uvs if uvs else []:
            out.write("vt %.9g %.9g\n" % tuple(t))
        for n in mesh.normals if normals else []:
            out.write("vn %.6f %.6f %.6f\n" % tuple(n))
        for name, material, faces in mesh.parts:
            out.write("o %s\n" % name if name else "")
            out.write("usemtl %s\n" % material if material else "")
            for face in faces:
                corners = ("%d/%s/%s" % (i + 1, i + 1 if uvs else "", i + 1 if normals else "") for i in face)
                out.write("f " + " ".join(c.rstrip("/") for c in corners) + "\n")


def write_ply(mesh, path, uvs, normals, colors, text):
    faces = [face for part in mesh.parts for face in part[2]]
    kinds = ["float %s" % n for n in ["x", "y", "z"] + ["nx", "ny", "nz"] * normals + ["s", "t"] * uvs]
    kinds += ["uchar %s" % n for n in ("red", "green", "blue")] * colors
    with open(path, "wb") as out:
        out.write(b"ply\nformat %s 1.0\n" % (b"ascii" if text else b"binary_little_endian"))
        out.write(("element vertex %d\n" % len(mesh.points)).encode())
        out.write("".join("property %s\n" % kind for kind in kinds).encode())
        out.write(("element face %d\nproperty list uchar int vertex_indices\nend_header\n" % len(faces)).encode())
        for p, n, t, c in zip(mesh.points, mesh.normals, mesh.uvs, mesh.colors):
            floats = [*p, *(n if normals else []), *(t if uvs else [])]
            bytes_ = c if colors else []
            if text:
                out.write((" ".join(["%.9g" % x for x in floats] + ["%d" % x for x in bytes_]) + "\n").encode())
            else:
                out.write(struct.pack("<%df%dB" % (len(floats), len(bytes_)), *floats, *bytes_))
        for face in faces:
            if text:
                out.write(("%d %s\n" % (len(face), " ".join(map(str, face)))).encode())
            else:
                out.write(struct.pack("<B%di" % len(face), len(face), *face))


def triangles_of(mesh):
    return [(f[0], f[k], f[k + 1]) for part in mesh.parts for f in part[2] for k in range(1, len(f) - 1)]


def write_stl(mesh, path):
    triangles = triangles_of(mesh)
    with open(path, "wb") as out:
        out.write(b"random".ljust(80) + struct.pack("<I", len(triangles)))
        for t in triangles:
            out.write(struct.pack("<3f", 0, 0, 0))
            for i in t:
                out.write(struct.pack("<3f", *mesh.points[i]))
            out.write(b"\0\0")


def write_gltf(mesh, path, uvs, normals, colors):
    """Writes one file of JSON and base64, whose primitives share their vertices."""
    import base64
    import json

    views, accessors, content = [], [], b""

    def add(values, kind, component, form):
        nonlocal content
        data = b"".join(struct.pack("<" + form, *v) for v in values)
        views.append({"buffer": 0, "byteOffset": len(content), "byteLength": len(data)})
        content += data + b"\0" * (-len(data) % 4)
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind})
        if form == "3f":
            accessors[-1]["min"] = [min(v[k] for v in values) for k in range(3)]
            accessors[-1]["max"] = [max(v[k] for v in values) for k in range(3)]
        return len(accessors) - 1

    attributes = {"POSITION": add(mesh.points, "VEC3", 5126, "3f")}
    if normals:
        attributes["NORMAL"] = add(mesh.normals, "VEC3", 5126, "3f")
    if uvs:
        attributes["TEXCOORD_0"] = add([(u, 1 - v) for u, v in mesh.uvs], "VEC2", 5126, "2f")
    if colors:
        attributes["COLOR_0"] = add([[x / 255 for x in c] for c in mesh.colors], "VEC3", 5126, "3f")
    meshes, names = [], sorted({part[1] for part in mesh.parts if part[1]})
    for part in mesh.parts:
        one = Mesh()
        one.parts = [part]
        indices = add([(i,) for t in triangles_of(one) for i in t], "SCALAR", 5125, "I")
        primitive = {"attributes": attributes, "indices": indices}
        if part[1]:
            primitive["material"] = names.index(part[1])
        meshes.append({"primitives": [primitive]})
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": i, "name": mesh.parts[i][0] or "part%d" % i} for i in range(len(meshes))],
        "meshes": meshes, "bufferViews": views, "accessors": accessors,
        "buffers": [{"byteLength": len(content),
                     "uri": "data:application/octet-stream;base64," + base64.b64encode(content).decode()}],
    }
    if names:
        document["materials"] = [{"name": name} for name in names]
    with open(path, "w") as out:
        json.dump(document, out)


def write(mesh, path, kind, uvs, normals, colors):
    """Writes a mesh in a format: obj, text.ply, ply, stl or gltf."""
    if kind == "obj":
        write_obj(mesh, path, uvs, normals, colors)
    elif kind == "stl":
        write_stl(mesh, path)
    elif kind == "gltf":
        write_gltf(mesh, path, uvs, normals, colors)
    else:
        write_ply(mesh, path, uvs, normals, colors, kind == "text.ply")


def write_image(path, side, channels, texels):
    """Writes a square image of 8 bits for each sample: .png or .ppm."""
    rows = [texels[k:k + side * channels] for k in range(0, len(texels), side * channels)]
    with open(path, "wb") as out:
        if path.endswith(".ppm"):
            out.write(b"P%d %d %d 255\n%s" % (5 if channels == 1 else 6, side, side, texels))
            return
        out.write(b"\x89PNG\r\n\x1a\n")
        for name, content in ((b"IHDR", struct.pack(">IIBBBBB", side, side, 8, channels - 1, 0, 0, 0)),
                              (b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows))), (b"IEND", b"")):
            out.write(struct.pack(">I", len(content)) + name + content)
            out.write(struct.pack(">I", zlib.crc32(name + content)))


def pack(path, random):
    """Packs a file, which gets another name; returns it."""
    if shutil.which("zstd") and random.random() < 0.5:
        subprocess.run(["zstd", "-q", "--rm", path], check=True)
        return path + ".zst"
    with open(path, "rb") as source, gzip.GzipFile(path + ".gz", "wb", mtime=0) as out:
        shutil.copyfileobj(source, out)
    return path + ".gz"

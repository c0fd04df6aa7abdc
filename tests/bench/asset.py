#!/usr/bin/env python3
"""Compares the assets of bisque-asset with those of pipelines that are put together from other programs.

    asset.py ASSET TRIANGLES TEXELS SCAN.obj[:TEXTURE]...

ASSET: the program. The peers decimate by Blender, or by CGAL (Lindstrom and Turk) if CGAL=PROGRAM is a
build of simplify_cgal.cpp, unwrap by xatlas and bake by Cycles, with as many triangles and texels, and
PNG files of 8 bits. All get the scan with its normals, else with those of Blender's smooth shading, and
a pattern if it has no texture. Renders the assets and the scan from 12 views by rays (Embree) and a
glTF shader that are written here. Prints for each the mean, 95th and 99th percentile of the angle between
normals in degrees, mean and 95th percentile of the colour difference (CIEDE2000), the pixels that
only one of both covers, in % of the scan's, and what the asset's certificate says."""
import io
import json
import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh
import xatlas
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from PIL import Image

SIDE = 512  # pixels of a view
PADDING = 4
GOLDEN = (1 + 5 ** .5) / 2
VIEWS = np.array([np.roll((0, s, t * GOLDEN), k) for k in range(3) for s in (-1, 1) for t in (-1, 1)])


def unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)


# ---- scans and assets: corners of triangles ----

def smooth_normals(v, f):
    """Returns normals of vertices, weighted by the angles of the triangles, as Blender's."""
    e = unit(np.roll(v[f], -1, 1) - v[f])
    flat = unit(np.cross(e[:, 0], e[:, 1]))
    angle = np.arccos(np.clip(-(e * np.roll(e, 1, 1)).sum(2), -1, 1))
    sums = np.zeros_like(v)
    for k in range(3):
        np.add.at(sums, f[:, k], flat * angle[:, k:k + 1])
    return unit(sums)


def pattern(v):
    """Returns colours of vertices as bytes: rings and spots of several sizes."""
    p = (v - v.min(0)) / np.ptp(v, axis=0).max()
    waves = [np.sin(k * p @ d) for k, d in ((40, (1, .4, .2)), (90, (-.3, 1, .5)), (25, (.2, -.6, 1)))]
    return np.round(127.5 + 100 * np.stack(waves, 1)).astype(np.uint8)


def load_scan(path, texture):
    """Returns a scan as a dict: v, f, n (of vertices), and uv (of corners) with image, or color (of vertices)."""
    rows = {"v": [], "vt": [], "f": []}
    for line in open(path, encoding="utf-8"):
        words = line.split()
        if words and words[0] in rows:
            rows[words[0]].append(words[1:])
    corners = [[[int(i or 0) - 1 for i in (c + "/").split("/")[:2]] for c in (face[0], face[k], face[k + 1])]
               for face in rows["f"] for k in range(1, len(face) - 1)]
    corners = np.array(corners)
    scan = {"v": np.array(rows["v"], float)[:, :3], "f": corners[:, :, 0]}
    scan["n"] = smooth_normals(scan["v"], scan["f"])
    if texture:
        scan["uv"] = np.array(rows["vt"], float)[:, :2][corners[:, :, 1]]
        scan["image"] = os.path.abspath(texture)
    else:
        scan["color"] = pattern(scan["v"])
    return scan


def write_scan(scan, folder):
    """Writes a scan for bisque-asset, and returns its path."""
    out = folder / "scan.obj"
    lines = ["mtllib scan.mtl\nusemtl m\n"] if "image" in scan else []
    rows = np.hstack([scan["v"], scan["color"] / 255]) if "color" in scan else scan["v"]
    lines += ["v " + " ".join("%.9g" % x for x in row) + "\n" for row in rows.tolist()]
    lines += ["vn %.9g %.9g %.9g\n" % tuple(row) for row in scan["n"].tolist()]
    if "uv" in scan:
        lines += ["vt %.9g %.9g\n" % tuple(row) for row in scan["uv"].reshape(-1, 2).tolist()]
        uv = np.arange(1, scan["f"].size + 1).reshape(-1, 3)
        (folder / "scan.mtl").write_text(f"newmtl m\nmap_Kd {scan['image']}\n")
    for i, face in enumerate((scan["f"] + 1).tolist()):
        lines.append("f " + " ".join(f"{c}/{uv[i, k] if 'uv' in scan else ''}/{c}"
                                     for k, c in enumerate(face)) + "\n")
    out.write_text("".join(lines))
    return out


def read_glb(path):
    """Returns what a viewer draws of a GLB file with one primitive."""
    data = Path(path).read_bytes()
    length, = struct.unpack_from("<I", data, 12)
    head, body = json.loads(data[20:20 + length]), data[28 + length:]
    kinds = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

    def array(number):
        a = head["accessors"][number]
        view, columns = head["bufferViews"][a["bufferView"]], {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
        kind = np.dtype(kinds[a["componentType"]])
        at, step = view.get("byteOffset", 0) + a.get("byteOffset", 0), view.get("byteStride", kind.itemsize * columns)
        return np.ndarray((a["count"], columns), kind, body, at, (step, kind.itemsize)).astype(float)

    def image(info):
        view = head["bufferViews"][head["images"][head["textures"][info["index"]]["source"]]["bufferView"]]
        at = view.get("byteOffset", 0)
        return np.asarray(Image.open(io.BytesIO(body[at:at + view["byteLength"]])).convert("RGB"))

    primitive, = head["meshes"][0]["primitives"]
    material = head["materials"][primitive["material"]]
    f = array(primitive["indices"]).astype(int).reshape(-1, 3)
    p, n, t, uv = (array(primitive["attributes"][k])[f] for k in ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0"))
    return {"p": p + np.array(head["nodes"][0].get("translation", (0, 0, 0))), "n": n, "t": t, "uv": uv, "normal": image(material["normalTexture"]),
            "color": image(material["pbrMetallicRoughness"]["baseColorTexture"])}


# ---- the shader ----

def linear(srgb):
    return np.where(srgb <= .04045, srgb / 12.92, ((srgb + .055) / 1.055) ** 2.4)


def sample(image, uv, decode):
    """Filters an image bilinearly, at coordinates from its upper left corner."""
    height, width = image.shape[:2]
    at = uv * (width, height) - .5
    low = np.floor(at).astype(int)
    part = at - low
    total = 0
    for j in (0, 1):
        for i in (0, 1):
            texel = image[(low[:, 1] + j) % height, (low[:, 0] + i) % width] / 255
            weight = (part[:, 0] if i else 1 - part[:, 0]) * (part[:, 1] if j else 1 - part[:, 1])
            total = total + weight[:, None] * decode(texel)
    return total


def shade_asset(asset, t, w):
    """Returns normals and linear colours at points of triangles, as a glTF viewer does."""
    at = {k: (asset[k][t] * w[:, :, None]).sum(1) for k in ("n", "t", "uv")}
    m = 2 * sample(asset["normal"], at["uv"], lambda x: x) - 1
    side = asset["t"][t, 0, 3:]
    n = m[:, :1] * at["t"][:, :3] + m[:, 1:2] * side * np.cross(at["n"], at["t"][:, :3]) + m[:, 2:] * at["n"]
    return unit(n), sample(asset["color"], at["uv"], linear)


def shade_scan(scan, t, w):
    n = unit((scan["n"][scan["f"][t]] * w[:, :, None]).sum(1))
    if "color" in scan:
        return n, (linear(scan["color"][scan["f"][t]] / 255) * w[:, :, None]).sum(1)
    uv = (scan["uv"][t] * w[:, :, None]).sum(1)
    return n, sample(scan["pixels"], np.stack([uv[:, 0], 1 - uv[:, 1]], 1), linear)


def lab(color):
    """CIELAB of linear Rec. 709 under D65."""
    m = np.array([[.4124564, .3575761, .1804375], [.2126729, .7151522, .0721750], [.0193339, .1191920, .9503041]])
    x = np.clip(color, 0, None) @ m.T / (.95047, 1, 1.08883)
    x = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.stack([116 * x[:, 1] - 16, 500 * (x[:, 0] - x[:, 1]), 200 * (x[:, 1] - x[:, 2])], 1)


def ciede2000(x, y):
    """Returns the differences of CIELAB colours (Sharma, Wu & Dalal 2005)."""
    c = (np.hypot(x[:, 1], x[:, 2]) + np.hypot(y[:, 1], y[:, 2])) / 2
    g = 1.5 - .5 * np.sqrt(c ** 7 / (c ** 7 + 25.0 ** 7))
    c1, c2 = (np.hypot(g * z[:, 1], z[:, 2]) for z in (x, y))
    h1, h2 = (np.degrees(np.arctan2(z[:, 2], g * z[:, 1])) % 360 for z in (x, y))
    gap = (h2 - h1 + 180) % 360 - 180
    dl, dc, dh = y[:, 0] - x[:, 0], c2 - c1, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(gap / 2))
    ml, mc, mh = (x[:, 0] + y[:, 0]) / 2, (c1 + c2) / 2, h1 + np.where(c1 * c2 == 0, 0, gap / 2)
    t = 1 - .17 * np.cos(np.radians(mh - 30)) + .24 * np.cos(np.radians(2 * mh)) + (
        .32 * np.cos(np.radians(3 * mh + 6)) - .2 * np.cos(np.radians(4 * mh - 63)))
    sl = 1 + .015 * (ml - 50) ** 2 / np.sqrt(20 + (ml - 50) ** 2)
    sc, sh = 1 + .045 * mc, 1 + .015 * mc * t
    turn = -np.sin(np.radians(60 * np.exp(-(((mh % 360) - 275) / 25) ** 2))) * 2 * np.sqrt(mc ** 7 / (mc ** 7 + 25.0 ** 7))
    return np.sqrt((dl / sl) ** 2 + (dc / sc) ** 2 + (dh / sh) ** 2 + turn * dc / sc * dh / sh)


# ---- views ----

def cast(points, origins, directions):
    """Returns the triangle that each ray hits first, or -1, and the weights of its corners."""
    scene = rtcore_scene.EmbreeScene()
    soup = points.reshape(-1, 3).astype(np.float32)
    TriangleMesh(scene, soup, np.arange(len(soup), dtype=np.int32).reshape(-1, 3))
    found = scene.run(origins.astype(np.float32), directions.astype(np.float32), output=True)
    u, v = found["u"][:, None].astype(float), found["v"][:, None].astype(float)
    return found["primID"], np.hstack([1 - u - v, u, v])


def compare(scan, asset):
    """Returns the figures of an asset, over the pixels of all views."""
    points = scan["v"][scan["f"]]
    centre, radius = (scan["v"].max(0) + scan["v"].min(0)) / 2, np.linalg.norm(np.ptp(scan["v"], axis=0)) / 2
    angles, colors, only, own = [], [], 0, 0
    y, x = (np.mgrid[:SIDE, :SIDE].reshape(2, -1) + .5) / SIDE * 2 - 1
    for toward in unit(VIEWS):
        right = unit(np.cross(toward, (.3, .5, .8)))
        origins = (x[:, None] * right + y[:, None] * np.cross(toward, right) + toward) * radius
        rays = np.tile(-toward, (len(origins), 1))
        (a, wa), (b, wb) = (cast((p - centre) / radius, origins / radius, rays) for p in (points, asset["p"]))
        both = (a >= 0) & (b >= 0)
        only, own = only + int(((a >= 0) != (b >= 0)).sum()), own + int((a >= 0).sum())
        (n1, c1), (n2, c2) = shade_scan(scan, a[both], wa[both]), shade_asset(asset, b[both], wb[both])
        angles.append(np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(n1 - n2, axis=1) / 2, 0, 1))))
        colors.append(ciede2000(lab(c1), lab(c2)))
    angles, colors = np.concatenate(angles), np.concatenate(colors)
    return [angles.mean(), *np.percentile(angles, (95, 99)), colors.mean(), np.percentile(colors, 95),
            100 * only / own]


# ---- the peers ----

def decimate_cgal(scan, target, folder):
    v = scan["v"].astype(np.float32)
    (folder / "in.bin").write_bytes(np.array([len(v), len(scan["f"])], np.uint32).tobytes() + v.tobytes() +
                                    scan["f"].astype(np.uint32).tobytes())
    subprocess.run([os.environ["CGAL"], folder / "in.bin", folder / "out.bin", str(target)], check=True,
                   stdout=subprocess.DEVNULL)
    data = (folder / "out.bin").read_bytes()
    count = np.frombuffer(data, np.uint32, 2)
    return (np.frombuffer(data, np.float32, 3 * count[0], 8).reshape(-1, 3),
            np.frombuffer(data, np.uint32, 3 * count[1], 8 + 12 * count[0]).reshape(-1, 3))


def blender_object(bpy, v, f):
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata(np.asarray(v).tolist(), [], np.asarray(f).tolist())
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    made = bpy.data.objects.new("mesh", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def decimate_blender(scan, target, folder):
    import bpy
    made = blender_object(bpy, scan["v"], scan["f"])
    made.modifiers.new("less", "DECIMATE").ratio = target / len(scan["f"])
    low = made.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    low.calc_loop_triangles()
    return np.array([p.co[:] for p in low.vertices]), np.array([t.vertices[:] for t in low.loop_triangles])


def material_of(bpy, thing, image=None, attribute=None):
    """Gives an object a material that shines in a colour. Returns the nodes, and the one of the colour."""
    material = bpy.data.materials.new("m")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    color = nodes.new("ShaderNodeAttribute" if attribute else "ShaderNodeTexImage")
    if attribute:
        color.attribute_name = attribute
    else:
        color.image = image
    emit, out = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(color.outputs["Color"], emit.inputs["Color"])
    material.node_tree.links.new(emit.outputs[0], out.inputs["Surface"])
    thing.data.materials.append(material)
    return nodes, color


def bake_cycles(scan, v, f, size, folder):
    """Unwraps a low-poly mesh by xatlas, and bakes it by Cycles. Returns the asset."""
    import bpy
    v = np.asarray(v, np.float32)
    atlas = xatlas.Atlas()
    atlas.add_mesh(v, np.asarray(f, np.uint32))
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding = size, PADDING
    atlas.generate(pack_options=pack)
    _, corners, uvs = atlas[0]
    corner_uvs = (uvs * (atlas.width, atlas.height) / max(atlas.width, atlas.height))[corners]
    low = blender_object(bpy, v, f)
    low.data.uv_layers.new(name="uv").data.foreach_set("uv", corner_uvs.ravel().astype(np.float32))
    high = blender_object(bpy, scan["v"], scan["f"])
    high.data.normals_split_custom_set_from_vertices(scan["n"].tolist())
    if "image" in scan:
        high.data.uv_layers.new(name="uv").data.foreach_set("uv", scan["uv"].ravel().astype(np.float32))
        image = bpy.data.images.load(scan["image"])
        image.alpha_mode = "NONE"
        material_of(bpy, high, image=image)
    else:
        colors = high.data.color_attributes.new("c", "BYTE_COLOR", "POINT")
        rgba = np.hstack([scan["color"] / 255, np.ones((len(scan["v"]), 1))])
        colors.data.foreach_set("color_srgb", rgba.ravel().astype(np.float32))
        material_of(bpy, high, attribute="c")
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.view_settings.view_transform = "Standard"
    diagonal = np.linalg.norm(np.ptp(scan["v"], axis=0))
    asset = {}
    for kind, key, space in (("NORMAL", "normal", "Non-Color"), ("EMIT", "color", "sRGB")):
        image = bpy.data.images.new(key, size, size, alpha=False)
        image.colorspace_settings.name = space
        low.data.materials.clear()
        nodes, node = material_of(bpy, low, image=image)
        nodes.active = node
        bpy.ops.object.select_all(action="DESELECT")
        high.select_set(True)
        low.select_set(True)
        bpy.context.view_layer.objects.active = low
        bpy.ops.object.bake(type=kind, use_selected_to_active=True, cage_extrusion=.01 * diagonal,
                            max_ray_distance=.03 * diagonal, margin=16, normal_space="TANGENT")
        image.filepath_raw, image.file_format = str(folder / f"{key}.png"), "PNG"
        image.save()
        asset[key] = np.asarray(Image.open(folder / f"{key}.png").convert("RGB"))
    mesh = low.data
    mesh.calc_tangents()
    count = len(mesh.loops)
    t, n, s = np.empty(3 * count, np.float32), np.empty(3 * count, np.float32), np.empty(count, np.float32)
    mesh.loops.foreach_get("tangent", t)
    mesh.loops.foreach_get("normal", n)
    mesh.loops.foreach_get("bitangent_sign", s)
    t = np.hstack([t.reshape(-1, 3), s[:, None]])
    asset.update(p=v.astype(float)[f], n=n.reshape(-1, 3, 3).astype(float), t=t.reshape(-1, 3, 4).astype(float),
                 uv=np.stack([corner_uvs[..., 0], 1 - corner_uvs[..., 1]], 2).astype(float))
    return asset


def make_own(program, scan, target, size, folder):
    path = write_scan(scan, folder)
    out = subprocess.run([program, path, "-o", folder / "own.glb", "--triangles", str(target), "--size", str(size),
                          "--maps", "normal,color", "--images", "png", "--json", "--progress", "none",
                          *os.environ.get("OPTIONS", "").split()],
                         check=True, capture_output=True, text=True)
    return read_glb(folder / "own.glb"), json.loads(out.stdout)["levels"][0]


def main():
    program, target, size = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    peers = {"blender": decimate_blender, **({"cgal": decimate_cgal} if os.environ.get("CGAL") else {})}
    print("| scan | asset | triangles | normals | p95 | p99 | colours | p95 | silhouette |\n|--|--|--|--|--|--|--|--|--|")
    for word in sys.argv[4:]:
        path, _, texture = word.partition(":")
        scan = load_scan(path, texture)
        scan["pixels"] = np.asarray(Image.open(texture).convert("RGB")) if texture else None
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            asset, level = make_own(program, scan, target, size, folder)
            assets = [("bisque", asset)]
            assets += [(name, bake_cycles(scan, *run(scan, target, folder), size, folder)) for name, run in peers.items()]
            for name, asset in assets:
                print(f"| {Path(path).stem} | {name} | {len(asset['p'])} | " +
                      " | ".join(f"{x:.3f}" for x in compare(scan, asset)) + " |", flush=True)
            print("certificate:", {k: level.get(k) for k in ("normal_error", "color_error")}, "\nuv:", level["uv"], flush=True)


if __name__ == "__main__":
    main()

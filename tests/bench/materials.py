#!/usr/bin/env python3
"""Compares the materials of assets with those of their scans, as Blender shows both.

    materials.py ASSET [OPTION]... -- SCAN.gltf...     (Python with bpy and numpy)

ASSET: the program bisque-asset, which gets the options. Blender reads scan and asset, and Cycles renders each
quantity of their materials as light, from 12 views. Prints for each scan the mean difference over the pixels
that show both: CIEDE2000 of the base colour, degrees of the normal, and the others in % of their range. Exit
status 1 if a base colour differs by 1 or more on average, or another quantity but the normal by 1 %. Occlusion counts
only if the scan has some, because assets of others get ambient occlusion. PICTURES=DIR keeps pictures of scan and
asset beside each other."""
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

SIDE, SAMPLES = 320, 8
GOLDEN = (1 + 5 ** .5) / 2
VIEWS = np.array([np.roll((0, s, t * GOLDEN), k) for k in range(3) for s in (-1, 1) for t in (-1, 1)])
#: Quantities that are rendered together, by the names of Principled BSDF's inputs; Occlusion is one of the
#: importer's own group.
PASSES = (("Base Color",), ("Normal",), ("Roughness", "Metallic", "Occlusion"), ("Emission",), ("Alpha",))
QUANTITIES = [name for names in PASSES for name in names]


def open_mesh(path):
    """Loads a file into an empty scene. Returns the centre and the radius of its vertices."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", SAMPLES
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type, scene.cycles.max_bounces = "BOX", 0
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.view_settings.view_transform = "Raw"
    bpy.context.view_layer.update()
    points = [o.matrix_world @ v.co for o in scene.objects if o.type == "MESH" for v in o.data.vertices]
    points = np.array([tuple(p) for p in points])
    centre = (points.min(0) + points.max(0)) / 2
    return centre, np.linalg.norm(points - centre, axis=1).max()


def find_socket(tree, name):
    """Returns what gives a quantity: an output, or a value."""
    bsdf = next((n for n in tree.nodes if n.type == "BSDF_PRINCIPLED"), None)
    if name == "Occlusion":
        group = next((n for n in tree.nodes if n.type == "GROUP" and "Occlusion" in n.inputs), None)
        return group.inputs[name].links[0].from_socket if group and group.inputs[name].links else 1.0
    if name == "Normal" and not (bsdf and bsdf.inputs[name].links):
        return tree.nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
    if bsdf is None:  # KHR_materials_unlit
        return {"Base Color": (1, 1, 1), "Roughness": 1.0, "Alpha": 1.0}.get(name, 0.0)
    socket = bsdf.inputs["Emission Color" if name == "Emission" else name]
    value = socket.links[0].from_socket if socket.links else socket.default_value
    if name != "Emission":
        return value
    scale = tree.nodes.new("ShaderNodeVectorMath")
    scale.operation = "SCALE"
    set_input(tree, scale.inputs["Vector"], value if socket.links else tuple(value)[:3])
    scale.inputs["Scale"].default_value = bsdf.inputs["Emission Strength"].default_value
    return scale.outputs["Vector"]


def set_input(tree, socket, value):
    if isinstance(value, bpy.types.NodeSocket):
        tree.links.new(value, socket)
    elif isinstance(value, float):
        socket.default_value = (value,) * 3 + (1,) * (len(socket.default_value) - 3)
    else:
        socket.default_value = (*tuple(value)[:3], 1)[:len(socket.default_value)]


def show(names):
    """Makes all materials give a quantity as light, or three in red, green and blue: normals as n / 2 + 1 / 2."""
    for material in bpy.data.materials:
        tree = material.node_tree
        value, *others = (find_socket(tree, name) for name in names)
        light = tree.nodes.new("ShaderNodeEmission")
        if others:
            both = tree.nodes.new("ShaderNodeCombineColor")
            for socket, one in zip(both.inputs, (value, *others)):
                if isinstance(one, float):
                    socket.default_value = one
                else:
                    tree.links.new(one, socket)
            value = both.outputs[0]
        if names == ("Normal",):
            half = tree.nodes.new("ShaderNodeVectorMath")
            half.operation = "MULTIPLY_ADD"
            half.inputs[1].default_value = half.inputs[2].default_value = (.5, .5, .5)
            set_input(tree, half.inputs[0], value)
            value = half.outputs[0]
        set_input(tree, light.inputs["Color"], value)
        output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
        tree.links.new(light.outputs[0], output.inputs["Surface"])


def render(centre, radius, folder):
    """Returns the pictures of all views: (views, rows, columns, RGBA)."""
    from mathutils import Vector

    scene, pictures = bpy.context.scene, []
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.angle = math.radians(30)
    camera.data.clip_start, camera.data.clip_end = radius / 100, radius * 100
    scene.collection.objects.link(camera)
    scene.camera = camera
    for view in VIEWS:
        toward = Vector(view / np.linalg.norm(view))
        camera.location = Vector(centre) + toward * (radius / math.sin(math.radians(15)))
        camera.rotation_euler = toward.to_track_quat("Z", "Y").to_euler()
        scene.render.filepath = str(folder / "view.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = "Non-Color"
        pictures.append(np.array(image.pixels[:], np.float32).reshape(SIDE, SIDE, 4)[::-1])
        bpy.data.images.remove(image)
    return np.array(pictures)


def pictures_of(path, folder, frame=None):
    """Returns the pictures of all quantities, and the centre and the radius of what they show."""
    found = {}
    for names in PASSES:
        own = open_mesh(path)
        frame = frame or own
        show(names)
        views = render(*frame, folder)
        for k, name in enumerate(names):
            found[name] = views[..., [k, k, k, 3]] if len(names) > 1 else views
    return found, frame


# ---- differences ----

def lab(c):
    m = np.array([[.4124564, .3575761, .1804375], [.2126729, .7151522, .0721750], [.0193339, .1191920, .9503041]])
    x = c @ (m / m.sum(1, keepdims=True)).T
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], 1)


def ciede2000(p, q):
    """Sharma, Wu & Dalal 2005, of CIELAB."""
    mean = (np.hypot(p[:, 1], p[:, 2]) + np.hypot(q[:, 1], q[:, 2])) / 2
    g = 1.5 - .5 * np.sqrt(mean ** 7 / (mean ** 7 + 25 ** 7))
    c1, c2 = np.hypot(g * p[:, 1], p[:, 2]), np.hypot(g * q[:, 1], q[:, 2])
    h1, h2 = (np.degrees(np.arctan2(x[:, 2], g * x[:, 1])) % 360 for x in (p, q))
    grey = c1 * c2 == 0
    turn = np.where(grey, 0, (h2 - h1 + 180) % 360 - 180)
    dl, dc, dh = q[:, 0] - p[:, 0], c2 - c1, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2))
    lm, cm, hm = (p[:, 0] + q[:, 0]) / 2, (c1 + c2) / 2, np.where(grey, h1 + h2, h1 + turn / 2)
    cos = [np.cos(np.radians(k * hm + d)) for k, d in ((1, -30), (2, 0), (3, 6), (4, -63))]
    t = 1 - .17 * cos[0] + .24 * cos[1] + .32 * cos[2] - .2 * cos[3]
    rt = -2 * np.sqrt(cm ** 7 / (cm ** 7 + 25 ** 7)) * np.sin(np.radians(60 * np.exp(-(((hm % 360) - 275) / 25) ** 2)))
    l50 = (lm - 50) ** 2
    l, c, h = dl / (1 + .015 * l50 / np.sqrt(20 + l50)), dc / (1 + .045 * cm), dh / (1 + .015 * cm * t)
    return np.sqrt(np.maximum(l * l + c * c + h * h + rt * c * h, 0))


def difference(name, a, b):
    """Returns the mean difference of pixels, which are RGBA."""
    both = (a[..., 3] > .999) & (b[..., 3] > .999)
    a, b = a[both][:, :3].astype(float), b[both][:, :3].astype(float)
    if name == "Occlusion" and a.min(initial=1) == 1:
        return math.nan
    if name == "Base Color":
        return ciede2000(lab(a.clip(0, 1)), lab(b.clip(0, 1))).mean()
    if name == "Normal":
        a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (2 * a - 1, 2 * b - 1))
        return np.degrees(np.arccos((a * b).sum(1).clip(-1, 1))).mean()
    return 100 * abs(a - b).mean() / max(a.max(), 1)


def keep_pictures(scan, asset, path):
    """Writes a sheet: for each quantity a row with six views of the scan, and of the asset below."""
    rows = [np.concatenate(of[name][::2], axis=1) for name in QUANTITIES for of in (scan, asset)]
    sheet = np.concatenate(rows)[::-2, ::2]
    sheet = np.concatenate([sheet[..., :3].clip(0, 1) ** (1 / 2.2), np.ones_like(sheet[..., :1])], axis=2)
    image = bpy.data.images.new("sheet", sheet.shape[1], sheet.shape[0])
    image.pixels = sheet.ravel()
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()


def main(program, *rest):
    options, scans = rest[:rest.index("--")], rest[rest.index("--") + 1:]
    print(f"{'scan':24s}" + "".join(f"{name:>12s}" for name in QUANTITIES), flush=True)
    good = True
    for path in scans:
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            asset = folder / "asset.glb"
            subprocess.run([program, path, "-o", asset, *options], check=True, stdout=subprocess.DEVNULL)
            scan, frame = pictures_of(path, folder)
            made, _ = pictures_of(asset, folder, frame)
        found = {name: difference(name, scan[name], made[name]) for name in QUANTITIES}
        good &= not any(value >= 1 for name, value in found.items() if name != "Normal")
        print(f"{Path(path).stem:24.24s}" + "".join(f"{value:12.3f}" for value in found.values()), flush=True)
        if "PICTURES" in os.environ:
            keep_pictures(scan, made, Path(os.environ["PICTURES"]) / f"{Path(path).stem}.png")
    return not good


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

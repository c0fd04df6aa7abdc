"""gltf_blender.py - renders glTF files with Blender's Cycles, to hold maps against.

    gltf_blender.py SCAN.gltf NAME WIDTH HEIGHT   writes NAME.<map>.png, for the scan's x and y
    gltf_blender.py models FOLDER OUT             compares each glTF file in FOLDER with Bisque's maps

The maps are color, roughness, metallic and normal: what reaches the sockets of the Principled shader
that Blender's reader of glTF files makes. Of models, six views along the axes are rendered, and
$BIN/bisque-bake bakes the model onto a cube around it. Prints the share of the texels that differ
by more than 2/255 in each map, or by a degree in normals, and how far the worst one in a thousand is off.
Writes OUT/MODEL.<map>.png: Bisque's views, Blender's and the difference, 1 for ten times that. Exit status 1
if a map but the normals of a model without warnings differs in over MOST percent. Needs the module bpy."""
import glob
import os
import subprocess
import sys

import bpy
import mathutils
import numpy as np

SOCKETS = {"color": "Base Color", "roughness": "Roughness", "metallic": "Metallic",
           "emission": "Emission Color", "normal": "Normal"}
SIDE = int(os.environ.get("SIDE", 512))  # texels of a view of a model
SPARSE = 256                             # views have samples of a texel's width, divided by this
MARGIN = 1.02                            # half the cube's edge, of half the model's longest side
# Views of a model: axes of the file that point right, up and to the camera.
VIEWS = [("x", "y", "z"), ("-x", "y", "-z"), ("-z", "y", "x"), ("z", "y", "-x"), ("x", "-z", "y"),
         ("x", "z", "-y")]
MOST = 0.5       # percent of texels that may differ
NOT_SHADED = 1e4  # stands for a value that a material does not have


def axis(name):
    out = np.zeros(3)
    out["xyz".index(name[-1])] = -1 if name[0] == "-" else 1
    return out


def to_blender(v):
    """Blender's reader turns y of the file to z, and z to -y."""
    return np.array([v[0], -v[2], v[1]])


# ---- reading ----

def read(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    leave_poses()
    bpy.ops.import_scene.gltf(filepath=path)
    filter_light()
    scale_normals()
    bpy.context.view_layer.update()
    corners = [o.matrix_world @ v.co for o in bpy.context.scene.objects if o.type == "MESH"
               for v in o.data.vertices]
    low, high = ([pick(p[k] for p in corners) for k in range(3)] for pick in (min, max))
    return (low[0], low[2], -high[1]), (high[0], high[2], -low[1])


def leave_poses():
    """Lets Blender's reader leave out animations, skins and morph targets, as Bisque does."""
    from io_scene_gltf2.io.imp.gltf2_io_gltf import glTFImporter
    whole = leave_poses.__dict__.setdefault("whole", glTFImporter.read)

    def read_still(self):
        whole(self)
        self.data.animations = None
        for node in self.data.nodes or []:
            node.skin = node.weights = None
        for mesh in self.data.meshes or []:
            mesh.weights = None
    glTFImporter.read = read_still


def filter_light():
    """Lets Cycles filter the light of images, as the format wants, and not their sRGB values."""
    for image in list(bpy.data.images):
        if image.colorspace_settings.name != "sRGB" or image.is_float or not image.has_data:
            continue
        values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
        image.pixels.foreach_get(values)
        values = values.reshape(-1, image.channels)
        colors = slice(3 if image.channels > 2 else 1)
        values[:, colors] = np.where(values[:, colors] <= 0.04045, values[:, colors] / 12.92,
                                     ((values[:, colors] + 0.055) / 1.055) ** 2.4)
        linear = bpy.data.images.new("linear", *image.size, alpha=True, float_buffer=True)
        linear.colorspace_settings.name = "Non-Color"
        linear.alpha_mode = "CHANNEL_PACKED"
        linear.pixels.foreach_set(values.ravel())
        linear.update()
        image.user_remap(linear)


def scale_normals():
    """Scales x and y of normal maps, as the format wants; Blender blends with the surface's normal."""
    for material in bpy.data.materials:
        tree = material.node_tree
        for node in [n for n in tree.nodes if n.type == "NORMAL_MAP"] if tree else ():
            scale, color = node.inputs["Strength"].default_value, node.inputs["Color"]
            if color.links:
                scaled = tree.nodes.new("ShaderNodeVectorMath")
                scaled.operation = "MULTIPLY_ADD"
                tree.links.new(color.links[0].from_socket, scaled.inputs[0])
                scaled.inputs[1].default_value = (scale, scale, 1)
                scaled.inputs[2].default_value = ((1 - scale) / 2, (1 - scale) / 2, 0)
                tree.links.new(scaled.outputs[0], color)
            node.inputs["Strength"].default_value = 1


# ---- rendering ----

def place_camera(view, center, half, width, height):
    """Looks along an axis of the file at a square, of which `half` is half the longer side."""
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2 * half
    camera.clip_start, camera.clip_end = 0.01 * half, 4 * half
    scene.camera = bpy.data.objects.new("camera", camera)
    axes = [to_blender(axis(name)) for name in view]
    place = to_blender(center) + 1.1 * half * axes[2]
    scene.camera.matrix_world = mathutils.Matrix([*zip(*axes, place), (0, 0, 0, 1)])
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.render.filter_size = scene.cycles.filter_width = 0.01
    scene.render.resolution_x, scene.render.resolution_y = width, height


def source_of(material, map_name):
    """Returns the socket that feeds a map, or the value of its socket. Normals are those of the surface."""
    tree = material.node_tree
    shaders = {n.type: n for n in reversed(tree.nodes)}
    if "BSDF_PRINCIPLED" not in shaders:  # it is not lit
        return shaders["EMISSION"].inputs["Color"] if map_name == "color" else NOT_SHADED
    socket = shaders["BSDF_PRINCIPLED"].inputs[SOCKETS[map_name]]
    if map_name == "emission":
        return scale_emission(tree, socket, shaders["BSDF_PRINCIPLED"].inputs["Emission Strength"])
    return socket


def scale_emission(tree, color, strength):
    scaled = tree.nodes.new("ShaderNodeVectorMath")
    scaled.operation = "SCALE"
    scaled.inputs[0].default_value = color.default_value[:3]
    if color.links:
        tree.links.new(color.links[0].from_socket, scaled.inputs[0])
    scaled.inputs["Scale"].default_value = strength.default_value
    return scaled.outputs[0]


def encode_normal(tree, source):
    """Makes n / 2 + 1/2 of a normal, on the axes of the file: y is Blender's z, z is its -y."""
    scaled = tree.nodes.new("ShaderNodeVectorMath")
    scaled.operation = "MULTIPLY_ADD"
    tree.links.new(source, scaled.inputs[0])
    scaled.inputs[1].default_value, scaled.inputs[2].default_value = (.5, -.5, .5), (.5, .5, .5)
    parts, whole = tree.nodes.new("ShaderNodeSeparateXYZ"), tree.nodes.new("ShaderNodeCombineXYZ")
    tree.links.new(scaled.outputs[0], parts.inputs[0])
    for to, out in enumerate((0, 2, 1)):
        tree.links.new(parts.outputs[out], whole.inputs[to])
    return whole.outputs[0]


def show(material, map_name):
    """Makes the material emit a map, or what its geometry node calls so."""
    tree = material.node_tree
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    source = source_of(material, map_name) if map_name in SOCKETS else geometry.outputs[map_name]
    if getattr(source, "links", None) and not source.is_output:
        source = source.links[0].from_socket
    elif hasattr(source, "default_value") and not source.is_output:
        source = geometry.outputs["Normal"] if map_name == "normal" else source.default_value
    if map_name == "normal" and hasattr(source, "links"):
        source = encode_normal(tree, source)
    emission = tree.nodes.new("ShaderNodeEmission")
    if hasattr(source, "links"):
        tree.links.new(source, emission.inputs["Color"])
    else:
        emission.inputs["Color"].default_value = \
            tuple(source) if hasattr(source, "__len__") else (source, source, source, 1)
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    for end in output.inputs:
        for link in end.links:
            tree.links.remove(link)
    tree.links.new(emission.outputs[0], output.inputs["Surface"])


def show_all(map_name):
    """Shows a map of all objects. Those without a material get the default one of the format."""
    for scene_object in bpy.context.scene.objects:
        if scene_object.type == "MESH" and not any(scene_object.data.materials):
            plain = bpy.data.materials.get("plain") or bpy.data.materials.new("plain")
            inputs = next(n for n in plain.node_tree.nodes if n.type == "BSDF_PRINCIPLED").inputs
            for name, value in (("Base Color", (1, 1, 1, 1)), ("Roughness", 1), ("Metallic", 1)):
                inputs[name].default_value = value
            scene_object.data.materials.clear()
            scene_object.data.materials.append(plain)
    for material in bpy.data.materials:
        if material.node_tree:
            show(material, map_name)


def render(path, file_format, mode, depth):
    scene = bpy.context.scene
    scene.render.image_settings.file_format = file_format
    scene.render.image_settings.color_mode = mode
    scene.render.image_settings.color_depth = depth
    scene.render.filepath = os.path.abspath(path)
    bpy.ops.render.render(write_still=True)


def render_one(path, name, width, height):
    low, high = np.array(read(path))
    half = max(high[0] - low[0], high[1] - low[1]) / 2
    place_camera(VIEWS[0], [*(low + high)[:2] / 2, high[2]], half, int(width), int(height))
    for map_name in SOCKETS:
        show_all(map_name)
        view = "Standard" if map_name in ("color", "emission") else "Raw"
        bpy.context.scene.view_settings.view_transform = view
        render(f"{name}.{map_name}.png", "PNG", "RGB", "16")


# ---- models ----

def pixels(path):
    """Returns the numbers of an image, three or four a pixel; row 0 is the lowest."""
    image = bpy.data.images.load(os.path.abspath(path))
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(image.size[1], image.size[0], image.channels)
    bpy.data.images.remove(image)
    return values


def write_picture(path, values):
    image = bpy.data.images.new("picture", values.shape[1], values.shape[0])
    rgba = np.ones((*values.shape[:2], 4), np.float32)
    rgba[:, :, :3] = values
    image.pixels.foreach_set(rgba.ravel())
    image.filepath_raw, image.file_format = os.path.abspath(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def write_cube(path, center, half):
    """Writes the mesh that Bisque bakes onto, with a small square around the middle of each texel of the
    views: its rays go where Blender's go, but textures are hardly filtered, as in Blender."""
    right, up, out = (np.array([axis(view[k]) for view in VIEWS]) for k in range(3))
    number, y, x, corner = np.indices((len(VIEWS), SIDE, SIDE, 4))
    corners = np.stack([(0, 1, 1, 0), (0, 0, 1, 1)], -1)[corner]  # of a square
    middle = 2 * (np.stack([x, y], -1) + 0.5) / SIDE - 1
    at = middle + (2 * corners - 1) / (SPARSE * SIDE)
    vertices = np.empty((*number.shape, 5), "<f4")
    vertices[..., :3] = center + half * (out[number] + at[..., :1] * right[number] + at[..., 1:] * up[number])
    vertices[..., 3] = (number % 3 * SIDE + x + corners[..., 0]) / (3 * SIDE)
    vertices[..., 4] = (number // 3 * SIDE + y + corners[..., 1]) / (2 * SIDE)
    faces = np.empty((number.size // 4, 2), [("count", "u1"), ("corners", "<u4", 3)])
    faces["count"] = 3
    faces["corners"] = np.arange(number.size).reshape(-1, 4)[:, [[0, 1, 2], [0, 2, 3]]]
    with open(path, "wb") as file:
        file.write(("ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % number.size +
                    "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t")) +
                    "element face %d\nproperty list uchar uint vertex_indices\nend_header\n" %
                    faces.size).encode())
        file.write(vertices.tobytes() + faces.tobytes())


def bisque(program, *arguments):
    run = subprocess.run([os.path.join(os.environ["BIN"], "bisque-" + program), *arguments],
                         stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return run.returncode, run.stdout


def bake(path, out, half):
    """Returns Bisque's maps by name, and what it says is lost."""
    _, text = bisque("voxelize", path, "--channels", "all", "-o", out + ".tris")
    maps = ["normal", "position", "mask"]
    kept = [line for line in text.splitlines() if line.startswith("kept:")]
    _, about = bisque("voxelize", "--info", out + ".tris")
    maps += ["color"] if "  color: yes" in about else []
    maps += ["transfer:" + m for m in ("roughness", "metallic", "emission") if kept and m in kept[0]]
    code, error = bisque(
        "bake", out + ".tris", out + ".ply", "--as-is", "--maps", ",".join(maps), "--normal", "space=object",
        "--size", f"{3 * SIDE}x{2 * SIDE}", "--front", str(1e-4 * half), "--back", str(2.1 * half),
        "--ray-directions", "face", "--scan", "normals=flat", "--samples", "1", "--padding", "0",
        "--type", "float", "-o", out + "_<MAP>.exr")
    if code:
        raise RuntimeError(text + error)
    lost = [line.split(": ", 1)[-1] for line in text.splitlines()
            if line.startswith("bisque-voxelize: warning")]
    names = [m.split(":")[-1] for m in maps]
    return {m: pixels(f"{out}_{m}.exr") for m in names}, lost


def render_views(out, center, half):
    """Returns Blender's maps, by name, as Bisque's are laid out."""
    scene = bpy.context.scene
    scene.render.film_transparent = scene.render.use_persistent_data = True
    maps = {}
    for map_name in ("Position", "Backfacing", *SOCKETS):
        show_all(map_name)
        maps[map_name] = np.empty((2 * SIDE, 3 * SIDE, 4), np.float32)
        for number, view in enumerate(VIEWS):
            place_camera(view, center, half, SIDE, SIDE)
            render(out + ".view.exr", "OPEN_EXR", "RGBA", "32")
            y, x = number // 3 * SIDE, number % 3 * SIDE
            maps[map_name][y:y + SIDE, x:x + SIDE] = pixels(out + ".view.exr")
    return maps


def to_srgb(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def difference(map_name, ours, theirs):
    """Returns how far each texel is off: degrees of normals, or values from 0 to 1."""
    if map_name == "normal":
        a, b = 2 * ours[..., :3] - 1, 2 * theirs[..., :3] - 1
        cosine = (a * b).sum(-1) / np.maximum(1e-9, np.linalg.norm(a, axis=-1)
                                              * np.linalg.norm(b, axis=-1))
        return np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    if map_name in ("color", "emission"):
        ours, theirs = to_srgb(ours), to_srgb(theirs)
    return abs(ours[..., :3] - theirs[..., :3]).max(-1)


def compare_map(map_name, ours, theirs, same, path):
    """Returns the share of the texels that differ, and the greatest difference but for one in 1,000."""
    most = 1 if map_name == "normal" else 2 / 255
    ours, theirs = ours[..., :3], theirs[..., :3]
    same = same & (theirs[..., 0] < NOT_SHADED / 2)
    off = difference(map_name, ours, theirs)
    shown = [to_srgb(m) if map_name in ("color", "emission") else m for m in (ours, theirs)]
    off[~same] = 0
    shown.append(np.broadcast_to(off[..., None] / (10 * most), ours.shape))
    write_picture(path, np.concatenate(shown[::-1]))
    off = off[same] if same.any() else np.zeros(1)
    return 100 * (off > most).mean(), np.percentile(off, 99.9)


def compare(path, out):
    """Compares a model where both see the same place of its front. Returns a line of the table, what is
    lost, and the largest share of a map but the normals."""
    low, high = np.array(read(path))
    center, half = (low + high) / 2, MARGIN * (high - low).max() / 2
    write_cube(out + ".ply", center, half)
    ours, lost = bake(path, out, half)
    theirs = render_views(out, center, half)
    where = theirs["Position"]
    place = np.stack([where[..., 0], where[..., 2], -where[..., 1]], -1)
    both = (where[..., 3] > 0.5) & (ours["mask"][..., 0] > 0.5) & (theirs["Backfacing"][..., 0] < 0.5)
    same = both & (abs(place - ours["position"][..., :3]).max(-1) < 2e-3 * half)
    cells = [f"{same.sum():8d}{100 - 100 * same.sum() / max(1, both.sum()):7.2f}"]
    most = 0
    for m in SOCKETS:
        if m not in ours:
            cells.append("     -      -")
            continue
        share, worst = compare_map(m, ours[m], theirs[m], same, f"{out}.{m}.png")
        cells.append(f"{share:6.2f} {worst:6.3f}")
        most = max(most, share if m != "normal" else 0)
    return " ".join(cells), lost, most


def compare_all(folder, out):
    os.makedirs(out, exist_ok=True)
    table = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what Blender says
    print(f"{'model':40}   texels elsewh", *(f"{m:13}" for m in SOCKETS), file=table, flush=True)
    failed = False
    for path in sorted(glob.glob(folder + "/**/*.gl[tb]*", recursive=True)):
        name = os.path.splitext(os.path.basename(path))[0]
        try:
            line, lost, most = compare(path, os.path.join(out, name.replace(" ", "_")))
        except Exception as error:  # of a file that one of the two does not read
            line, lost, most = f"not compared: {str(error).strip().splitlines()[-1]}", [], 0
        failed |= most > MOST and not lost
        print(f"{name:40} {line}", *(f"    {text}" for text in lost), sep="\n", file=table, flush=True)
    sys.exit(failed)


if sys.argv[1] == "models":
    compare_all(*sys.argv[2:])
else:
    render_one(*sys.argv[1:])

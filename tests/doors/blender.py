"""blender.py - bakes from inside Blender (the Python module bpy), with the extension in tools/blender.

    blender.py BIN PICTURES    in a folder with vase.obj, vase_low.obj; prints "ok" and "not ok" lines

Renders the result beside the scan: baked.png and scan.png in PICTURES."""
import os
import resource
import shutil
import sys
import time

os.environ["BLENDER_USER_RESOURCES"] = os.path.abspath("user")  # before bpy is loaded
import bpy
import mathutils
import numpy

top = os.path.abspath(os.path.join(os.path.dirname(__file__), "../.."))
programs, pictures = (os.path.abspath(a) for a in sys.argv[1:3])
count = 0


def holds(name, condition):
    global count
    count += 1
    print("ok" if condition else "not ok", count, "-", name, flush=True)


def install():
    """Installs the extension from a package, as people do. Returns its module."""
    package = shutil.make_archive(os.path.abspath("bisque"), "zip", os.path.join(top, "tools/blender/bisque"))
    try:
        bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
        module = sys.modules["bl_ext.user_default.bisque"]
        holds("the package installs as an extension", hasattr(bpy.types.Scene, "bisque"))
    except (RuntimeError, KeyError, AttributeError) as error:
        print("skipped: installing as an extension:", error)
        sys.path.insert(0, os.path.join(top, "tools/blender"))
        import bisque as module
        module.register()
    return module


def clear():
    """Empties the scene. Factory settings would switch the extension off."""
    for kind in ("objects", "meshes", "materials", "images", "lights", "cameras"):
        bpy.data.batch_remove(list(getattr(bpy.data, kind)))


def select_low():
    clear()
    bpy.ops.wm.obj_import(filepath=os.path.abspath("vase_low.obj"))
    item = bpy.context.selected_objects[0]
    bpy.context.view_layer.objects.active = item
    return item


def settings(**values):
    for name, value in {"scan": os.path.abspath("vase.obj"), "folder": os.path.abspath("maps"), "size": "512",
                        "resolution": 500, "quality": "draft",
                        "z_up": False, "extra": "--rays ao=4 --view count=1,from=0", **values}.items():
        setattr(bpy.context.scene.bisque, name, value)


def refusal(**values):
    """Returns what Blender reports of a bake that fails."""
    select_low()
    settings(**values)
    try:
        bpy.ops.object.bisque_bake()
    except RuntimeError as error:
        return str(error)
    return ""


def feeds(socket):
    """Returns the image that a socket gets, through whatever nodes."""
    node = socket.links[0].from_node if socket.links else None
    while node and node.type != "TEX_IMAGE":
        node = node.inputs["Color"].links[0].from_node
    return node and node.image


def check_bake():
    item = select_low()
    settings(maps="normal,color,ao")
    holds("a bake ends well", bpy.ops.object.bisque_bake() == {"FINISHED"})
    shader = next(n for n in item.active_material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    normal, color = feeds(shader.inputs["Normal"]), feeds(shader.inputs["Base Color"])
    holds("maps are linked", normal and color and normal.size[0] == color.size[0] == 512)
    holds("data are no colours", normal.colorspace_settings.is_data and not color.colorspace_settings.is_data)
    nodes = len(item.active_material.node_tree.nodes)
    holds("the preview is loaded", bpy.data.images["Bisque preview"].size[0] > 1000)
    holds("misses are told", "no surface" in bpy.context.scene.bisque.result)
    holds("a second bake ends well", bpy.ops.object.bisque_bake() == {"FINISHED"})
    holds("it links nothing twice", len(item.active_material.node_tree.nodes) == nodes)
    return item


def check_orm(module):
    item = select_low()
    folder = os.path.abspath("maps")
    module.material.link_maps(item, {"orm": os.path.join(folder, next(f for f in os.listdir(folder) if f.endswith("_ao.exr")))})
    shader = next(n for n in item.active_material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    holds("orm is split", [shader.inputs[s].links[0].from_socket.name for s in ("Roughness", "Metallic")] ==
          ["Green", "Blue"] and feeds(shader.inputs["Roughness"]).colorspace_settings.is_data)


def check_cancel(module):
    folder = os.path.abspath("cancelled")
    os.mkdir(folder)
    paths = {name: os.path.join(programs, name) for name in module.PROGRAMS}
    job = module.jobs.Job(module.jobs.bake_commands(
        paths, os.path.abspath("vase.obj"), "none.obj", folder, [], {"exact": False, "resolution": 8000}))
    begin = time.time()
    over = job.poll()
    holds("polling does not wait", not over and time.time() - begin < 0.2)
    time.sleep(0.2)
    job.cancel()
    print("cancelled:", job.process.returncode, os.listdir(folder), job.messages)
    holds("a cancelled job ends, without a grid", job.process.returncode == 75 and
          "vase.nvdb" not in os.listdir(folder))


def render(path):
    """Renders what the scene has, in the same light and from the same place each time."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 16, "CPU"
    scene.render.resolution_x = scene.render.resolution_y = 320
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "SUN"))
    light.data.energy, light.rotation_euler = 4, (0.9, 0.3, 0.4)
    scene.world = bpy.data.worlds.new("world")
    for item in (camera, light):
        scene.collection.objects.link(item)
    camera.rotation_euler, scene.camera = (1.3, 0, 0.4), camera
    bpy.context.view_layer.update()
    frame(camera)
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    return numpy.array(image.pixels).reshape(320, 320, 4)[:, :, :3]


def frame(camera):
    points = [c for o in bpy.context.scene.objects if o.type == "MESH" for v in o.bound_box
              for c in o.matrix_world @ mathutils.Vector(v)]
    place, _ = camera.camera_fit_coords(bpy.context.evaluated_depsgraph_get(), points)
    camera.location = place


def check_picture():
    """Renders the low-poly mesh with its maps, without them, and the scan."""
    item = bpy.context.active_object
    baked = render(os.path.join(pictures, "baked.png"))
    item.data.materials.clear()
    plain = render(os.path.join(pictures, "plain.png"))
    clear()
    bpy.ops.wm.obj_import(filepath=os.path.abspath("vase.obj"))
    scan = bpy.context.selected_objects[0]
    bpy.context.view_layer.objects.active = scan
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("scan")
    material.use_nodes = True
    tree = material.node_tree
    color = tree.nodes.new("ShaderNodeVertexColor")
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    tree.links.new(color.outputs["Color"], shader.inputs["Base Color"])
    scan.data.materials.clear()
    scan.data.materials.append(material)
    shown = render(os.path.join(pictures, "scan.png"))
    near, far = (float(numpy.abs(p - shown).mean()) for p in (baked, plain))
    print(f"mean difference from the scan's picture: {near:.4f} baked, {far:.4f} plain")
    holds("the baked mesh looks as the scan does", near < 0.015 and near < far / 4)


def main():
    module = install()
    holds("a missing scan is an error", "There is no scan" in refusal(scan="/none.obj"))
    holds("errors of programs are reported", "is not normal, color" in refusal(maps="nothing"))
    path, os.environ["PATH"] = os.environ["PATH"], "/nowhere"
    holds("missing programs are an error", "bisque-voxelize is not in PATH" in refusal())
    os.environ["PATH"] = path
    check_cancel(module)
    check_bake()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"Blender's own memory so far: {memory:.0f} MiB")
    check_picture()
    check_orm(module)


main()

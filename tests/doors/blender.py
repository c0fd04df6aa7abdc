"""blender.py - bakes from inside Blender (the Python module bpy), with the extension of `make extension`.

    blender.py PACKAGE PICTURES [SCAN LOW]

In a folder with vase.obj, vase_low.obj; prints "ok" and "not ok" lines. Renders results beside the scan: baked.png,
asset.png, scan.png in PICTURES. SCAN, of any size, is baked onto LOW alone, and Blender's memory is told."""
import os
import re
import shutil
import sys
import time
from types import SimpleNamespace

os.environ["BLENDER_USER_RESOURCES"] = os.path.abspath("user")  # before bpy is loaded
import bpy
import mathutils
import numpy

package, pictures = (os.path.abspath(a) for a in sys.argv[1:3])
EXTENSION = "bl_ext.user_default.bisque"
count = 0


def holds(name, condition):
    global count
    count += 1
    print("ok" if condition else "not ok", count, "-", name, flush=True)


def install():
    """Installs the extension from its package, as people do. Returns its module."""
    bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
    holds("the package installs as an extension", hasattr(bpy.types.Scene, "bisque"))
    module = sys.modules[EXTENSION]
    holds("the wheel brings the programs", str(module.jobs.find_package()).startswith(os.path.abspath("user")))
    return module


def memory():
    """Returns the largest resident memory that this process has had, in MiB: Blender's alone."""
    with open("/proc/self/status") as file:
        return int(re.search(r"VmHWM:\s+(\d+) kB", file.read())[1]) / 1024


def clear():
    """Empties the scene. Factory settings would switch the extension off."""
    for kind in ("objects", "meshes", "materials", "images", "lights", "cameras"):
        bpy.data.batch_remove(list(getattr(bpy.data, kind)))


def select_low(*places):
    """Returns copies of the low-poly mesh at these x, or the one that there is without."""
    clear()
    for x in places or [0]:
        bpy.ops.wm.obj_import(filepath=os.path.abspath("vase_low.obj"))
        bpy.context.active_object.location.x = x
    for item in bpy.context.scene.objects:
        item.select_set(True)
    bpy.context.view_layer.update()
    return list(bpy.context.scene.objects) if places else bpy.context.active_object


def settings(**values):
    scene = bpy.context.scene.bisque
    for name in list(scene.keys()):
        scene.property_unset(name)
    for name, value in {"scan": os.path.abspath("vase.obj"), "folder": os.path.abspath("maps"), "size": "512",
                        "resolution": 500, "quality": "draft", "memory": "512M",
                        "z_up": False, "extra": "--rays ao=4 --view count=1,from=0", **values}.items():
        setattr(scene, name, value)


def refusal(operator=bpy.ops.object.bisque_bake, **values):
    """Returns what Blender reports of a job that fails."""
    select_low()
    settings(**values)
    try:
        operator()
    except RuntimeError as error:
        return str(error)
    return ""


def shader_of(item):
    return next(n for n in item.active_material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")


def feeds(socket):
    """Returns the image that a socket gets, through whatever nodes."""
    node = socket.links[0].from_node if socket.links else None
    while node and node.type != "TEX_IMAGE":
        node = next(i for i in node.inputs if i.links).links[0].from_node
    return node and node.image


def pixels(image):
    return numpy.array(image.pixels).reshape(-1, image.channels)


def check_refusals():
    asset = bpy.ops.object.bisque_asset
    holds("a missing scan is an error", "There is no scan" in refusal(scan="/none.obj"))
    holds("errors of programs are reported", "is not normal, color" in refusal(maps="nothing"))
    holds("so are those of bisque-asset", "bisque-asset: memory: 'much' is no size" in refusal(asset, memory="much"))
    preferences = bpy.context.preferences.addons[EXTENSION].preferences
    preferences.programs = "/nowhere"
    holds("missing programs are an error", "bisque-voxelize is not in /nowhere" in refusal() and
          "bisque-asset is not in /nowhere" in refusal(asset))
    preferences.programs = ""


def check_modal(module, operator, **values):
    """Runs an operator as a window does, which there is not here, until a program shows progress; then cancels."""
    name = operator.bl_idname
    said = []
    manager = SimpleNamespace(event_timer_add=lambda *_, **__: "timer", event_timer_remove=said.append,
                              modal_handler_add=lambda _: None)
    context = SimpleNamespace(scene=bpy.context.scene, preferences=bpy.context.preferences, window_manager=manager,
                              selected_objects=[select_low()], window=None, screen=SimpleNamespace(areas=[]))
    runner = type("Plain", (module.Runner,), {"start": operator.start, "finish": operator.finish,
                                              "report": lambda _, kind, text: said.append(text)})()
    folder = os.path.abspath(name)
    settings(folder=folder, **values)
    state = runner.begin(context, True)
    holds(f"{name} begins without waiting", state == {"RUNNING_MODAL"} and runner.job.process.poll() is None)
    state, stages = {"PASS_THROUGH"}, set()
    while state == {"PASS_THROUGH"} and len(stages) < 3:
        state = runner.modal(context, SimpleNamespace(type="TIMER"))
        stages.add(context.scene.bisque.stage)
        time.sleep(0.01)
    print("stages:", sorted(stages))
    holds(f"{name} lets Blender work meanwhile, and shows progress",
          state == {"PASS_THROUGH"} and len(stages) == 3)
    state = runner.modal(context, SimpleNamespace(type="ESC"))
    made = [n for _, _, names in os.walk(folder) for n in names if n.endswith((".nvdb", ".glb", ".exr"))]
    holds(f"{name} is cancelled, with nothing half made", state == {"CANCELLED"} and not made and
          runner.job.process.returncode == 75 and said == ["timer", "The job was cancelled"])


def check_bake():
    item = select_low()
    settings(maps="normal,color,ao")
    holds("a bake ends well", bpy.ops.object.bisque_bake() == {"FINISHED"})
    shader = shader_of(item)
    normal, color = feeds(shader.inputs["Normal"]), feeds(shader.inputs["Base Color"])
    holds("maps are linked", normal and color and normal.size[0] == color.size[0] == 512)
    holds("data are no colours", normal.colorspace_settings.is_data and not color.colorspace_settings.is_data)
    nodes = len(item.active_material.node_tree.nodes)
    holds("the preview is loaded", bpy.data.images["Bisque preview"].size[0] > 1000)
    holds("misses are told", re.match(r"0\.\d\d % of the samples found no", bpy.context.scene.bisque.result))
    holds("a second bake ends well", bpy.ops.object.bisque_bake() == {"FINISHED"})
    holds("it links nothing twice", len(item.active_material.node_tree.nodes) == nodes)


def check_misses():
    """Half of the samples are of a mesh that is far from the scan."""
    select_low(0, 5)
    settings(extra="--as-is --view count=1,from=0")
    bpy.ops.object.bisque_bake()
    holds("misses are counted", bpy.context.scene.bisque.result.startswith("50."))


def check_orm():
    """The material of the scan has a roughness of 0.25 and is metallic by 0.75."""
    item = select_low()
    settings(scan=os.path.abspath("metal.obj"), maps="normal", orm=True)
    bpy.ops.object.bisque_bake()
    shader = shader_of(item)
    links = [shader.inputs[s].links[0].from_socket.name for s in ("Roughness", "Metallic")]
    image = feeds(shader.inputs["Roughness"])
    holds("orm is split", links == ["Green", "Blue"] and image.colorspace_settings.is_data)
    holds("it has the scan's values", numpy.abs(pixels(image)[:, 1:3] - (0.25, 0.75)).max() < 0.005)


def check_match():
    """body_low sees only body_high, which is where it is, and belt_low only belt_high, which is farther away."""
    scans = os.path.abspath("*_high.obj")
    body, belt = select_low(0, 2)
    body.name, belt.name = "body_low", "belt_low"
    settings(scan=scans, match=True, maps="normal")
    holds("scans match objects by name", bpy.ops.object.bisque_bake() == {"FINISHED"} and
          bpy.context.scene.bisque.result.startswith("0.") and
          [feeds(shader_of(i).inputs["Normal"]).name for i in (body, belt)] == ["body_low normal", "belt_low normal"])
    body.name, belt.name = "belt_low", "body_low"
    try:
        bpy.ops.object.bisque_bake()
        holds("objects see no other scan", not bpy.context.scene.bisque.result.startswith("0."))
    except RuntimeError as error:
        holds("objects see no other scan", "bisque-bake: " in str(error))


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


def bounds(item):
    corners = numpy.array([item.matrix_world @ v.co for v in item.data.vertices])
    return numpy.array([corners.min(axis=0), corners.max(axis=0)])


def check_asset(module, scan_picture):
    """Makes an asset of the scan, whose axes it keeps, and compares its picture."""
    clear()
    settings(asset_triangles=1500)
    holds("an asset ends well", bpy.ops.object.bisque_asset() == {"FINISHED"})
    item = bpy.context.selected_objects[0]
    images = [feeds(shader_of(item).inputs[name]) for name in ("Normal", "Base Color")]
    holds("its object is in the scene", item.name == "vase" and 1000 < len(item.data.polygons) <= 1500 and
          [image.colorspace_settings.is_data for image in images] == [True, False])
    holds("its misses are told", "% of the samples" in bpy.context.scene.bisque.result)
    near = float(numpy.abs(render(os.path.join(pictures, "asset.png")) - scan_picture).mean())
    print(f"mean difference from the scan's picture: {near:.4f} asset")
    holds("the asset looks as the scan does", near < 0.02)
    raw = numpy.array([[float(x) for x in line.split()[1:4]] for line in open("vase.obj") if line.startswith("v ")])
    y_up, box = bounds(item), numpy.array([raw.min(axis=0), raw.max(axis=0)])
    holds("y of the scan is up", numpy.abs(y_up[:, 2] - box[:, 1]).max() < 0.02)
    shutil.copy("maps/vase.glb", "maps/vase_1.glb")
    level = {"rays": {"misses": 0, "samples": 1}}
    maker = SimpleNamespace(output=os.path.abspath("maps/vase.glb"))
    os.makedirs("maps/vase_asset/1")
    shutil.copy("maps/vase_asset/preview.png", "maps/vase_asset/1")
    module.AssetOperator.finish(maker, bpy.context, {"levels": [{**level, "name": "0", "files": ["vase.glb"]},
                                                               {**level, "name": "1", "files": ["vase_1.glb"]}]})
    fine, coarse = bpy.data.objects["vase_1"], bpy.data.objects["vase.001"]
    holds("the finest level is shown", fine.visible_get() and not coarse.visible_get())
    settings(asset_triangles=1500, z_up=True, units="cm")
    bpy.ops.object.bisque_asset()
    bpy.context.view_layer.update()
    placed = bounds(bpy.context.selected_objects[0])
    holds("z of the scan is up if it says so, and its unit is", numpy.abs(100 * placed - box).max() < 0.02)
    select_low().scale = (0.01, 0.01, 0.01)
    bpy.context.view_layer.update()
    settings(maps="normal", units="cm")
    holds("meshes in metres fit a scan in centimetres", bpy.ops.object.bisque_bake() == {"FINISHED"})


def check_picture():
    """Renders the low-poly mesh with its maps, without them, and the scan. Returns the picture of the scan."""
    item = select_low()
    settings(maps="normal,color", preset="unreal")
    bpy.ops.object.bisque_bake()
    down = render(os.path.join(pictures, "unreal.png"))
    item = select_low()
    settings(maps="normal,color")
    bpy.ops.object.bisque_bake()
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
    near, far, turned = (float(numpy.abs(p - shown).mean()) for p in (baked, plain, down))
    print(f"mean difference from the scan's picture: {near:.4f} baked, {far:.4f} plain, {turned:.4f} unreal")
    holds("the baked mesh looks as the scan does", near < 0.015 and near < far / 4)
    holds("so it does with green down", turned < 0.015)
    return shown


def bake_large(scan, low):
    clear()
    bpy.ops.wm.obj_import(filepath=os.path.abspath(low))
    item = bpy.context.selected_objects[0]
    begin, before = time.time(), memory()
    settings(scan=os.path.abspath(scan), maps="normal", size="2048", resolution=2048, memory="1G",
             quality="normal")
    holds("a large scan is baked", bpy.ops.object.bisque_bake() == {"FINISHED"})
    holds("its map is linked", feeds(shader_of(item).inputs["Normal"]).size[0] == 2048)
    print(f"Blender's own memory: {memory():.0f} MiB, {before:.0f} before the bake of {time.time() - begin:.0f} s")
    holds("Blender's memory stays below 1.5 GB", memory() < 1.5e9 / 2**20)
    render(os.path.join(pictures, "large.png"))
    shutil.copy("maps/bisque_preview.png", os.path.join(pictures, "large_preview.png"))


def main():
    module = install()
    if len(sys.argv) > 3:
        bake_large(*sys.argv[3:])
        return
    check_refusals()
    check_modal(module, module.BakeOperator, resolution=8000)
    check_modal(module, module.AssetOperator, asset_preset="archive")
    check_bake()
    check_misses()
    check_orm()
    check_match()
    print(f"Blender's own memory so far: {memory():.0f} MiB")
    check_asset(module, check_picture())


main()

"""Bisque - bakes maps of a scan onto the selected objects, or makes an asset of it. The scan is a file that
Blender never reads: Bisque's programs do, beside Blender."""
import glob
import os
import shlex
import time

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, PointerProperty, StringProperty

from . import jobs, material


UNITS = {"m": 1, "cm": 100, "mm": 1000, "in": 1 / 0.0254}  # in a metre


def words(*names):
    return [(name, name.capitalize(), "") for name in names]


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__
    programs: StringProperty(name="Programs", subtype="DIR_PATH",
                             description="Folder of bisque-bake and the others; empty: those of the extension")

    def draw(self, _context):
        self.layout.prop(self, "programs")


class Settings(bpy.types.PropertyGroup):
    scan: StringProperty(name="Scan", subtype="FILE_PATH",
                         description="A mesh file of any size, or a .nvdb or .tris of an earlier bake. "
                                     "Several files are one scan, such as //*_high.obj")
    folder: StringProperty(name="Folder", subtype="DIR_PATH", default="//bisque/",
                           description="Where maps, assets, sorted scans and the exported mesh go")
    memory: StringProperty(name="Memory", description="Of each program, such as 4G; empty: half of the machine's")
    z_up: BoolProperty(name="Scan has z up", default=True,
                       description="Axes of the scan; off: y is up, as in most OBJ and glTF files")
    units: EnumProperty(name="Unit", items=[(name, name, "") for name in UNITS], default="m",
                        description="Of the scan. Assets and selected meshes are in metres")
    size: EnumProperty(name="Size", items=words("512", "1024", "2048", "4096", "8192"), default="2048")
    maps: StringProperty(name="Maps", default="normal,color",
                         description="Names with commas between them, such as normal,color,ao; or all")
    orm: BoolProperty(name="Roughness and metallic",
                      description="Bake the scan's own as one image: orm=ao,roughness,metallic")
    preset: EnumProperty(name="Preset", items=words("blender", "gltf", "unity", "unreal"), default="blender",
                         description="Green of normals, bits, and packed maps that a program expects")
    quality: EnumProperty(name="Quality", items=words("draft", "normal", "final"), default="normal")
    exact: BoolProperty(name="Exact", description="Trace the scan's triangles instead of a grid of voxels")
    resolution: IntProperty(name="Voxels", default=2048, min=16, max=65536,
                            description="Voxels along the longest side of the scan")
    match: BoolProperty(name="Match by name", description="body_low sees only the scan body_high")
    preview: BoolProperty(name="Preview", default=True,
                          description="Also make a picture of mesh, bake and scan; red: nothing was found there")
    extra: StringProperty(name="Options", description="Further options of bisque-bake")
    asset_preset: EnumProperty(name="Preset", items=words("web", "game", "museum", "archive"), default="web",
                               description="Triangles, size and maps of the asset")
    asset_triangles: IntProperty(name="Triangles", default=0, min=0,
                                 description="Of the asset, with maps of the size above; 0: as the preset says")
    stage: StringProperty()
    share: IntProperty(subtype="PERCENTAGE", min=0, max=100)
    result: StringProperty()


def find_programs(context, *names):
    """Returns the commands of programs. Raises FileNotFoundError with the name of one that is missing."""
    entry = context.preferences.addons.get(__package__)
    folder = bpy.path.abspath(entry.preferences.programs) if entry and entry.preferences else ""
    commands = {name: jobs.find_program(name, folder) for name in names}
    for name, command in commands.items():
        if not command:
            raise FileNotFoundError(f"{name} is not in {folder or 'PATH'}: set its folder in the preferences")
    return commands


def find_scans(settings):
    path = bpy.path.abspath(settings.scan)
    scans = [path] if os.path.isfile(path) else sorted(glob.glob(path))
    if not scans:
        raise FileNotFoundError(f"There is no scan {path!r}")
    return scans


def make_folder(settings):
    folder = bpy.path.abspath(settings.folder)
    if folder.startswith("//"):
        raise ValueError("Save the file first, or choose another folder")
    os.makedirs(folder, exist_ok=True)
    return folder


def export_low(path, z_up):
    """Writes the selected meshes as they are shown: with modifiers, in the world, as triangles."""
    bpy.ops.wm.obj_export(filepath=path, export_selected_objects=True, export_materials=False, export_uv=True,
                          export_normals=True, export_triangulated_mesh=True, apply_modifiers=True,
                          forward_axis="Y" if z_up else "NEGATIVE_Z", up_axis="Z" if z_up else "Y")


def bake_options(settings, folder):
    """Returns the options of the two programs of a bake, by name, and their memory."""
    sort = [] if settings.exact else ["--resolution", str(settings.resolution)]
    bake = ["--preset", settings.preset, "--maps", settings.maps, "--size", settings.size,
            "--quality", settings.quality, "-o",
            os.path.join(folder, "<OBJECT>_<MAP>." + ("exr" if settings.preset == "blender" else "png"))]
    if settings.orm:
        sort += ["--channels", "roughness,metallic"]
        bake += ["--pack", "orm=ao,roughness,metallic"]
    if settings.preview:
        bake += ["--preview", os.path.join(folder, "bisque_preview.png")]
    if settings.match:
        bake += ["--match", "name"]
    if settings.units != "m":
        bake += ["--low", f"scale={UNITS[settings.units]:.9g}"]
    return {"bisque-voxelize": sort, "bisque-bake": bake + shlex.split(settings.extra), "memory": settings.memory}


def object_named(names, name):
    """Returns the object that a name in the report means; None: it is gone. names: of the objects that were baked.
    Exporters and file names replace some characters."""
    name = next((n for n in names if name in (n, n.replace(" ", "_"))), names[0] if len(names) == 1 else name)
    return bpy.data.objects.get(name)


def add_asset(path):
    """Adds the object of a GLB file."""
    bpy.ops.import_scene.gltf(filepath=path)
    item = bpy.context.selected_objects[0]
    item.name = os.path.splitext(os.path.basename(path))[0]
    return item


class Runner:
    """What both operators share: they start a job, and add what it made when it has ended."""

    def invoke(self, context, _event):
        return self.begin(context, not bpy.app.background)

    def execute(self, context):
        return self.begin(context, False)

    def begin(self, context, modal):
        try:
            self.job = self.start(context)
        except (OSError, ValueError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if modal:
            self.timer = context.window_manager.event_timer_add(0.2, window=context.window)
            context.window_manager.modal_handler_add(self)
            return {"RUNNING_MODAL"}
        while not self.job.poll():
            time.sleep(0.05)
        return self.end(context)

    def modal(self, context, event):
        if event.type == "ESC":
            self.job.cancel()
            self.stop(context)
            self.report({"WARNING"}, "The job was cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        over = self.job.poll()
        settings = context.scene.bisque
        settings.stage, settings.share = self.job.stage, int(100 * self.job.share)
        for area in context.screen.areas:
            area.tag_redraw()
        if not over:
            return {"PASS_THROUGH"}
        self.stop(context)
        return self.end(context)

    def cancel(self, _context):
        """Blender is closing, or loads another file."""
        self.job.cancel()

    def stop(self, context):
        context.window_manager.event_timer_remove(self.timer)
        context.scene.bisque.stage = ""

    def end(self, context):
        """Adds the results, and reports what the programs said."""
        if self.job.code != 0:
            lines = self.job.messages or [f"a program ended with {self.job.code}"]
            self.report({"ERROR"}, "\n".join(lines[-3:]))
            return {"CANCELLED"}
        for line in self.job.messages:
            self.report({"WARNING"}, line)
        rays = self.finish(context, self.job.results[-1])
        missed = 100 * sum(r["misses"] for r in rays) / max(sum(r["samples"] for r in rays), 1)
        context.scene.bisque.result = f"{missed:.2f} % of the samples found no surface"
        self.report({"WARNING" if missed > 1 else "INFO"}, context.scene.bisque.result)
        return {"FINISHED"}


class BakeOperator(Runner, bpy.types.Operator):
    """Bake maps of the scan file onto the selected meshes. Esc cancels"""
    bl_idname = "object.bisque_bake"
    bl_label = "Bake Scan"

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and any(o.type == "MESH" for o in context.selected_objects)

    def start(self, context):
        """Exports the selected meshes and starts the programs. Errors: OSError, ValueError, RuntimeError."""
        settings = context.scene.bisque
        meshes = [o for o in context.selected_objects if o.type == "MESH"]
        self.names = [o.name for o in meshes]  # undo makes other objects
        self.green_down = settings.preset == "unreal"
        without = [o.name for o in meshes if not o.data.uv_layers]
        if without:
            raise ValueError(f"{without[0]} has no UV map")
        programs = find_programs(context, "bisque-voxelize", "bisque-bake")
        scans, folder = find_scans(settings), make_folder(settings)
        low = os.path.join(folder, "bisque_low.obj")
        export_low(low, settings.z_up)
        return jobs.Job(jobs.bake_commands(programs, scans, low, folder, bake_options(settings, folder)))

    def finish(self, _context, result):
        """Links the maps."""
        by_object = {}
        for tile in result["tiles"]:
            item = object_named(self.names, tile["object"])
            if not item:
                self.report({"WARNING"}, f"{tile['object']} is gone; its maps are in the folder")
            else:
                by_object.setdefault(item, {}).update(tile["maps"])
        for item, maps in by_object.items():
            material.link_maps(item, maps, self.green_down)
        if result["preview_path"]:
            material.show_preview(result["preview_path"])
        return [result]


class AssetOperator(Runner, bpy.types.Operator):
    """Make a low-poly mesh with maps of the scan file, and add it to the scene. Esc cancels"""
    bl_idname = "object.bisque_asset"
    bl_label = "Asset from Scan"

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT"

    def start(self, context):
        settings = context.scene.bisque
        program = find_programs(context, "bisque-asset")["bisque-asset"]
        scans = find_scans(settings)
        name = os.path.basename(scans[0]).split(".")[0]
        self.output = os.path.join(make_folder(settings), name + ".glb")
        options = ["--preset", settings.asset_preset, "--up", "z" if settings.z_up else "y", "--units", settings.units]
        if settings.asset_triangles:
            options += ["--triangles", str(settings.asset_triangles), "--size", settings.size]
        if settings.memory:
            options += ["--memory", settings.memory]
        return jobs.Job([jobs.asset_command(program, scans, self.output, options)])

    def finish(self, _context, result):
        """Adds an object for each level, of which the finest one is shown."""
        items, pictures = [], []
        finest = max(result["levels"], key=lambda level: level["triangles"])
        for level in result["levels"]:
            folder = os.path.splitext(self.output)[0] + "_asset"
            glb = next(name for name in level["files"] if name.endswith(".glb"))
            items.append(add_asset(os.path.join(os.path.dirname(self.output), glb)))
            items[-1].hide_set(level is not finest)
            pictures.append(os.path.join(folder, level["name"] if len(result["levels"]) > 1 else "", "preview.png"))
        material.show_preview(pictures[result["levels"].index(finest)])
        return [level["rays"] for level in result["levels"]]


class Panel(bpy.types.Panel):
    bl_idname, bl_label = "VIEW3D_PT_bisque", "Bisque"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Bisque"

    def draw(self, context):
        layout, settings = self.layout, context.scene.bisque
        layout.use_property_split = True
        for name in ("scan", "folder", "memory", "z_up", "units", "size"):
            layout.prop(settings, name)
        if settings.stage:
            layout.progress(factor=settings.share / 100, text=f"{settings.stage} (Esc cancels)")
        else:
            self.draw_jobs(layout, settings)
        if settings.result:
            layout.label(text=settings.result)

    def draw_jobs(self, layout, settings):
        box = layout.box()
        for name in ("maps", "orm", "preset", "quality", "exact", "resolution", "match", "preview", "extra"):
            row = box.row()
            row.enabled = not (name == "resolution" and settings.exact)
            row.prop(settings, name)
        box.operator(BakeOperator.bl_idname, icon="RENDER_STILL")
        box = layout.box()
        box.prop(settings, "asset_preset")
        box.prop(settings, "asset_triangles")
        box.operator(AssetOperator.bl_idname, icon="MESH_MONKEY")


CLASSES = (Preferences, Settings, BakeOperator, AssetOperator, Panel)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.bisque = PointerProperty(type=Settings)


def unregister():
    del bpy.types.Scene.bisque
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)

"""Bisque - bakes maps of a scan onto the selected objects. The scan is a file that Blender never reads:
the programs bisque-voxelize and bisque-bake do, beside Blender."""
import os
import shlex
import time

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, PointerProperty, StringProperty

from . import jobs, material

PROGRAMS = ("bisque-voxelize", "bisque-bake")


def words(*names):
    return [(name, name.capitalize(), "") for name in names]


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__
    programs: StringProperty(name="Programs", subtype="DIR_PATH",
                             description="Folder of bisque-bake and bisque-voxelize; empty: they are on PATH")

    def draw(self, _context):
        self.layout.prop(self, "programs")


class Settings(bpy.types.PropertyGroup):
    scan: StringProperty(name="Scan", subtype="FILE_PATH",
                         description="A mesh file of any size, or a .nvdb or .tris of an earlier bake")
    folder: StringProperty(name="Folder", subtype="DIR_PATH", default="//bisque/",
                           description="Where maps, sorted scans and the exported mesh go")
    maps: StringProperty(name="Maps", default="normal,color",
                         description="Names with commas between them, such as normal,color,ao; or all")
    orm: BoolProperty(name="Roughness and metallic",
                      description="Bake the scan's own as one image: orm=ao,roughness,metallic")
    size: EnumProperty(name="Size", items=words("512", "1024", "2048", "4096", "8192"), default="2048")
    quality: EnumProperty(name="Quality", items=words("draft", "normal", "final"), default="normal")
    exact: BoolProperty(name="Exact", description="Trace the scan's triangles instead of a grid of voxels")
    resolution: IntProperty(name="Voxels", default=2048, min=16, max=65536,
                            description="Voxels along the longest side of the scan")
    z_up: BoolProperty(name="Scan has z up", default=True,
                       description="Axes of the scan; off: y is up, as in most OBJ and glTF files")
    match: BoolProperty(name="Match by name", description="body_low sees only the scan's body_high")
    preview: BoolProperty(name="Preview", default=True,
                          description="Also make a picture of mesh, bake and scan; red: nothing was found there")
    extra: StringProperty(name="Options", description="Further options of bisque-bake")
    stage: StringProperty()
    share: IntProperty(subtype="PERCENTAGE", min=0, max=100)
    result: StringProperty()


def find_programs(context):
    """Returns the paths of the programs. Raises FileNotFoundError with the name of one that is missing."""
    entry = context.preferences.addons.get(__package__)
    folder = bpy.path.abspath(entry.preferences.programs) if entry and entry.preferences else ""
    paths = {name: jobs.find_program(name, folder) for name in PROGRAMS}
    for name, path in paths.items():
        if not path:
            raise FileNotFoundError(f"{name} is not in {folder or 'PATH'}: set its folder in the preferences")
    return paths


def export_low(path, z_up):
    """Writes the selected meshes as they are shown: with modifiers, in the world, as triangles."""
    bpy.ops.wm.obj_export(filepath=path, export_selected_objects=True, export_materials=False, export_uv=True,
                          export_normals=True, export_triangulated_mesh=True, apply_modifiers=True,
                          forward_axis="Y" if z_up else "NEGATIVE_Z", up_axis="Z" if z_up else "Y")


def bake_options(settings, folder):
    options = ["--preset", "blender", "--maps", settings.maps, "--size", settings.size,
               "--quality", settings.quality]
    if settings.orm:
        options += ["--pack", "orm=ao,roughness,metallic"]
    if settings.preview:
        options += ["--preview", os.path.join(folder, "bisque_preview.png")]
    if settings.match:
        options += ["--match", "name"]
    return options + shlex.split(settings.extra)


def make_job(context):
    """Exports the selected meshes and starts the programs. Errors: OSError, ValueError, RuntimeError."""
    settings = context.scene.bisque
    programs = find_programs(context)
    scan, folder = bpy.path.abspath(settings.scan), bpy.path.abspath(settings.folder)
    if not os.path.isfile(scan):
        raise FileNotFoundError(f"There is no scan {scan!r}")
    if folder.startswith("//"):
        raise ValueError("Save the file first, or choose another folder")
    os.makedirs(folder, exist_ok=True)
    low = os.path.join(folder, "bisque_low.obj")
    export_low(low, settings.z_up)
    chunks = {"exact": settings.exact, "resolution": settings.resolution}
    if settings.orm:
        chunks["channels"] = "roughness,metallic"
    return jobs.Job(jobs.bake_commands(programs, scan, low, folder, bake_options(settings, folder), chunks))


def object_named(meshes, name):
    """Returns the mesh that a name in the report means. Exporters and file names replace some characters."""
    return next((m for m in meshes if m.name == name), None) or \
        next((m for m in meshes if m.name.replace(" ", "_") == name), None) or \
        (meshes[0] if len(meshes) == 1 else None)


class BakeOperator(bpy.types.Operator):
    """Bake maps of the scan file onto the selected meshes. Esc cancels"""
    bl_idname = "object.bisque_bake"
    bl_label = "Bake Scan"

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and any(o.type == "MESH" for o in context.selected_objects)

    def invoke(self, context, _event):
        return self.begin(context, True)

    def execute(self, context):
        return self.begin(context, False)

    def begin(self, context, modal):
        self.meshes = [o for o in context.selected_objects if o.type == "MESH"]
        without = [o.name for o in self.meshes if not o.data.uv_layers]
        if without:
            self.report({"ERROR"}, f"{without[0]} has no UV map")
            return {"CANCELLED"}
        try:
            self.job = make_job(context)
        except (OSError, ValueError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if modal and not bpy.app.background:
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
            self.report({"WARNING"}, "The bake was cancelled")
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
        """Links the maps, and reports what the programs said."""
        if self.job.code != 0:
            lines = self.job.messages or [f"a program ended with {self.job.code}"]
            self.report({"ERROR"}, "\n".join(lines[-3:]))
            return {"CANCELLED"}
        for line in self.job.messages:
            self.report({"WARNING"}, line)
        result = self.job.results[-1]
        by_object = {}
        for tile in result["tiles"]:
            item = object_named(self.meshes, tile["object"])
            if item:
                by_object.setdefault(item, {}).update(tile["maps"])
        for item, maps in by_object.items():
            material.link_maps(item, maps)
        if result["preview_path"]:
            material.load_image(result["preview_path"], "Bisque preview", None)
        missed = 100 * result["misses"] / max(result["samples"], 1)
        context.scene.bisque.result = f"{missed:.2f} % of the samples found no surface"
        self.report({"WARNING" if missed > 1 else "INFO"}, context.scene.bisque.result)
        return {"FINISHED"}


class Panel(bpy.types.Panel):
    bl_idname, bl_label = "VIEW3D_PT_bisque", "Bisque"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Bisque"

    def draw(self, context):
        layout, settings = self.layout, context.scene.bisque
        layout.use_property_split = True
        for name in ("scan", "folder", "maps", "orm", "size", "quality", "exact", "resolution", "z_up", "match",
                     "preview", "extra"):
            row = layout.row()
            row.enabled = not (name == "resolution" and settings.exact)
            row.prop(settings, name)
        if settings.stage:
            layout.progress(factor=settings.share / 100, text=f"{settings.stage} (Esc cancels)")
        else:
            layout.operator(BakeOperator.bl_idname, icon="RENDER_STILL")
        if settings.result:
            layout.label(text=settings.result)


CLASSES = (Preferences, Settings, BakeOperator, Panel)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.bisque = PointerProperty(type=Settings)


def unregister():
    del bpy.types.Scene.bisque
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)

# Writes the glTF files of this folder, linear.obj, and further files by Blender. Needs Python 3.11,
# trimesh 5.2.0 and bpy 5.0.1 (Blender) from PyPI, and gltfpack 0.18 of Debian 12.
import subprocess

import bpy
import numpy
import trimesh

from patch import colors, points, triangles

# Colours of glTF are linear, those of OBJ are sRGB.
linear = colors / 255
srgb = numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
with open("linear.obj", "w") as out:
    for p, c in zip(points, srgb):
        out.write("v %g %g %g %.9g %.9g %.9g\n" % (*p, *c))
    for t in triangles:
        out.write("f %d %d %d\n" % tuple(t + 1))

mesh = trimesh.Trimesh(points, triangles, process=False)
mesh.export("plain.trimesh.glb")
files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh), merge_buffers=True)
with open("trimesh.bin", "wb") as out:
    out.write(files["gltf_buffer.bin"])
with open("plain.trimesh.gltf", "wb") as out:
    out.write(files["model.gltf"].replace(b"gltf_buffer.bin", b"trimesh.bin"))
mesh.visual.vertex_colors = colors
mesh.export("linear.trimesh.glb")


def pack(name, *options):
    subprocess.run(["gltfpack", "-i", "plain.trimesh.glb", "-o", name, *options], check=True)


pack("packed.gltfpack.glb", "-noq")
pack("packed.gltfpack.quantized.glb", "-vp", "16")
pack("packed.gltfpack.meshopt.glb", "-cc", "-vp", "16")


def blend(name, **options):
    """Exports the mesh with Blender, in an object that is moved and in an instance that mirrors."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    data = bpy.data.meshes.new("patch")
    data.from_pydata(points.tolist(), [], triangles.tolist())
    for i, location in enumerate(((0.0, 0.0, 0.0), (2.0, 0.0, 0.0))):
        item = bpy.data.objects.new("object %d" % i, data)
        item.location = location
        item.scale = (1 - 2 * i, 1, 1)
        bpy.context.scene.collection.objects.link(item)
    bpy.ops.export_scene.gltf(filepath=name, export_yup=False, export_normals=False, **options)


blend("twice.blender.glb", export_format="GLB")
blend("draco.blender.glb", export_format="GLB", export_draco_mesh_compression_enable=True,
      export_draco_position_quantization=16)
with open("twice.obj", "w") as out:
    for sign, x in ((1, 0), (-1, 2)):
        for p in points:
            out.write("v %g %g %g\n" % (x + sign * p[0], p[1], p[2]))
    for t in triangles:
        out.write("f %d %d %d\n" % tuple(t + 1))
    for t in triangles:
        out.write("f %d %d %d\n" % (t[0] + 50, t[2] + 50, t[1] + 50))


def export(color, *names):
    """Exports the mesh with Blender as OBJ, PLY or STL, with colours of vertices or without."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    data = bpy.data.meshes.new("patch")
    data.from_pydata(points.tolist(), [], triangles.tolist())
    if color:
        layer = data.color_attributes.new("color", "BYTE_COLOR", "POINT")
        for item, value in zip(layer.data, colors / 255):
            item.color_srgb = (*value, 1)
    item = bpy.data.objects.new("patch", data)
    bpy.context.scene.collection.objects.link(item)
    axes = {"forward_axis": "Y", "up_axis": "Z"}
    for name in names:
        if name.endswith(".obj"):
            bpy.ops.wm.obj_export(filepath=name, export_normals=False, export_uv=False,
                                  export_materials=False, export_colors=color, **axes)
        elif name.endswith(".ply"):
            bpy.ops.wm.ply_export(filepath=name, export_colors="NONE", export_uv=False,
                                  ascii_format=".text." in name, **axes)
        else:
            bpy.ops.wm.stl_export(filepath=name, **axes)


# No PLY file has colours, because Blender rounds most of them down.
export(False, "plain.blender.obj", "plain.blender.ply", "plain.blender.text.ply", "plain.blender.stl")
export(True, "colors.blender.obj")

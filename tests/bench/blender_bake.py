"""blender_bake.py - bakes maps with Blender, and compares them with other maps.

Runs in Blender (blender -b --python blender_bake.py -- ARGUMENTS) or in Python with the module bpy.

    bake ao|normal SCAN.obj LOW.obj OUT.exr SIZE SAMPLES FRONT BACK
    compare value|angle A.exr B.exr MASK.exr
    write-normals SCAN.obj OUT.obj
    decimate SCAN.obj OUT.obj SHARE

bake: rays start FRONT outside of the low-poly mesh and end BACK inside; normals are in object space.
Prints the processor time of the bake, without reading meshes. compare: prints the difference of the
first channel, or the angle between normals in degrees, over texels that the mask covers whole.
write-normals: adds Blender's own vertex normals, of smooth shading. decimate: keeps a SHARE of the
triangles, by Blender's modifier.
"""
import math
import os
import resource
import sys

import bpy
import numpy


def processor_seconds():
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def read_mesh(path):
    bpy.ops.wm.obj_import(filepath=path, forward_axis='Y', up_axis='Z')
    mesh = bpy.context.selected_objects[0]
    mesh.data.polygons.foreach_set('use_smooth', [True] * len(mesh.data.polygons))
    return mesh


def write_mesh(mesh, path, normals):
    bpy.ops.object.select_all(action='DESELECT')
    mesh.select_set(True)
    bpy.context.view_layer.objects.active = mesh
    bpy.ops.wm.obj_export(filepath=path, export_selected_objects=True, export_materials=False,
                          export_uv=False, export_normals=normals, forward_axis='Y', up_axis='Z')


def make_image(low, size):
    image = bpy.data.images.new('map', size, size, alpha=False, float_buffer=True)
    image.colorspace_settings.name = 'Non-Color'
    material = bpy.data.materials.new('map')
    material.use_nodes = True
    node = material.node_tree.nodes.new('ShaderNodeTexImage')
    node.image = image
    material.node_tree.nodes.active = node
    low.data.materials.clear()
    low.data.materials.append(material)
    return image


def save_image(image, path):
    image.filepath_raw = os.path.abspath(path)
    image.file_format = 'OPEN_EXR'
    image.save()


def bake(kind, scan_path, low_path, out, size, samples, front, back):
    empty_scene()
    scene = bpy.context.scene
    scene.render.engine = 'CYCLES'
    scene.cycles.samples = int(samples)
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.world = bpy.data.worlds.new('world')
    scene.world.light_settings.distance = 1e6  # of occlusion: no limit
    scan, low = read_mesh(scan_path), read_mesh(low_path)
    image = make_image(low, int(size))
    bpy.ops.object.select_all(action='DESELECT')
    scan.select_set(True)
    low.select_set(True)
    bpy.context.view_layer.objects.active = low
    before = processor_seconds()
    bpy.ops.object.bake(type=kind.upper(), use_selected_to_active=True,
                        cage_extrusion=float(front), max_ray_distance=float(front) + float(back),
                        normal_space='OBJECT', margin=0)
    print('processor seconds: %.1f' % (processor_seconds() - before))
    save_image(image, out)


def pixels(path):
    image = bpy.data.images.load(os.path.abspath(path))
    image.colorspace_settings.name = 'Non-Color'
    values = numpy.empty(len(image.pixels), dtype=numpy.float32)
    image.pixels.foreach_get(values)
    return values.reshape(-1, image.channels).astype(numpy.float64)


def compare(kind, a_path, b_path, mask_path):
    a, b, mask = pixels(a_path), pixels(b_path), pixels(mask_path)
    # Blender covers texels whose centres are in a chart.
    used = (mask[:, 0] == 1) & (b[:, :3].sum(axis=1) > 0)
    a, b = a[used], b[used]
    if kind == 'value':
        error = numpy.abs(a[:, 0] - b[:, 0])
        print('means: %.5f and %.5f' % (a[:, 0].mean(), b[:, 0].mean()))
    else:
        a, b = 2 * a[:, :3] - 1, 2 * b[:, :3] - 1
        across = numpy.linalg.norm(numpy.cross(a, b), axis=1)
        error = numpy.degrees(numpy.arctan2(across, (a * b).sum(axis=1)))
    print('texels: %d, mean: %.5f, median: %.5f, 95th percentile: %.5f, RMS: %.5f'
          % (len(error), error.mean(), numpy.median(error), numpy.percentile(error, 95),
             math.sqrt((error ** 2).mean())))


def write_normals(scan_path, out):
    empty_scene()
    write_mesh(read_mesh(scan_path), out, True)


def decimate(scan_path, out, share):
    empty_scene()
    mesh = read_mesh(scan_path)
    modifier = mesh.modifiers.new('decimate', 'DECIMATE')
    modifier.ratio = float(share)
    modifier.use_collapse_triangulate = True
    write_mesh(mesh, out, False)


if __name__ == '__main__':
    arguments = sys.argv[sys.argv.index('--') + 1:] if '--' in sys.argv else sys.argv[1:]
    tasks = {'bake': bake, 'compare': compare, 'write-normals': write_normals,
             'decimate': decimate}
    if not arguments or arguments[0] not in tasks:
        sys.exit(__doc__)
    tasks[arguments[0]](*arguments[1:])

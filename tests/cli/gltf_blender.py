"""gltf_blender.py - renders a glTF file from above with Blender's Cycles, to hold maps against.

    gltf_blender.py SCAN.gltf NAME WIDTH HEIGHT   writes NAME.<map>.png, for the scan's x and y

The maps are color, roughness, metallic and normal: what reaches the sockets of the Principled shader
that Blender's reader of glTF files makes. Needs the Python module bpy."""
import os
import sys

import bpy

SOCKETS = {"color": "Base Color", "roughness": "Roughness", "metallic": "Metallic", "normal": "Normal"}


def read(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path)
    corners = [o.matrix_world @ v.co for o in bpy.context.scene.objects if o.type == "MESH"
               for v in o.data.vertices]
    low, high = ([pick(p[k] for p in corners) for k in range(3)] for pick in (min, max))
    return low, high


def place_camera(low, high, width, height):
    """Looks along the axis that is z in the file, which Blender's reader turns to -y."""
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", max(high[0] - low[0], high[2] - low[2])
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = ((low[0] + high[0]) / 2, low[1] - 1, (low[2] + high[2]) / 2)
    scene.camera.rotation_euler = (1.5707963267948966, 0, 0)
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.render.filter_size = scene.cycles.filter_width = 0.01
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode, scene.render.image_settings.color_depth = "RGB", "16"


def source_of(material, map_name):
    """Returns the socket that feeds a map, or the value of its socket. Normals are those of the surface."""
    tree = material.node_tree
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    socket = shader.inputs[SOCKETS[map_name]]
    return socket.links[0].from_socket if socket.links else socket.default_value


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
    """Makes the material emit a map."""
    tree = material.node_tree
    source = source_of(material, map_name)
    if map_name == "normal":
        if not hasattr(source, "links"):
            source = tree.nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
        source = encode_normal(tree, source)
    emission = tree.nodes.new("ShaderNodeEmission")
    if hasattr(source, "links"):
        tree.links.new(source, emission.inputs["Color"])
    else:
        emission.inputs["Color"].default_value = \
            tuple(source) if hasattr(source, "__len__") else (source, source, source, 1)
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(emission.outputs[0], output.inputs["Surface"])


def main(path, name, width, height):
    for map_name in SOCKETS:
        place_camera(*read(path), int(width), int(height))
        for material in bpy.data.materials:
            if material.node_tree:
                show(material, map_name)
        scene = bpy.context.scene
        scene.view_settings.view_transform = "Standard" if map_name == "color" else "Raw"
        scene.render.filepath = os.path.abspath(f"{name}.{map_name}.png")
        bpy.ops.render.render(write_still=True)


main(*sys.argv[1:])

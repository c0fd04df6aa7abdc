"""material.py - links baked maps into the material of an object."""
import bpy

# Map, and the input of the Principled shader that it feeds.
INPUTS = {"color": "Base Color", "roughness": "Roughness", "transfer:roughness": "Roughness",
          "metallic": "Metallic", "transfer:metallic": "Metallic"}


def load_image(path, name, space):
    """Loads a map, or reads it again if the image is there already."""
    image = bpy.data.images.get(name)
    if image and bpy.path.abspath(image.filepath) == path:
        image.reload()
    else:
        image = bpy.data.images.load(path)
        image.name = name
    image.colorspace_settings.name = space
    return image


def space_of(name, path):
    """Colours are linear light in OpenEXR files, else sRGB. All other maps are numbers."""
    if name != "color":
        return "Non-Color"
    return "Linear Rec.709" if path.endswith(".exr") else "sRGB"


def show_preview(path):
    """Loads the picture of mesh, bake and scan, and shows it in image editors that show no other image."""
    image = load_image(path, "Bisque preview", "sRGB")
    for screen in bpy.data.screens:
        for area in screen.areas:
            space = area.spaces.active
            if area.type == "IMAGE_EDITOR" and not space.image:
                space.image = image


def material_of(item):
    """Returns the material of an object that maps are linked into, with a Principled shader."""
    material = item.active_material
    if not material:
        material = bpy.data.materials.new(item.name)
        if item.data.materials:
            item.data.materials[item.active_material_index] = material
        else:
            item.data.materials.append(material)
    material.use_nodes = True
    return material


def shader_of(tree):
    shader = next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None)
    if not shader:
        shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
        output = next((node for node in tree.nodes if node.type == "OUTPUT_MATERIAL"), None) or \
            tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return shader


def node_of(tree, kind, name, row, column):
    """Returns a node of ours by its name, so that a second bake links nothing twice."""
    node = tree.nodes.get(name) or tree.nodes.new(kind)
    node.name = node.label = name
    node.location = (-900 + 300 * column, 300 - 280 * row)
    return node


def turn_green(tree, color, row):
    """Returns a colour with green the other way round, for normals of Direct3D."""
    node = node_of(tree, "ShaderNodeRGBCurve", "Bisque green up", row, 1)
    green = node.mapping.curves[1]
    green.points[0].location, green.points[-1].location = (0, 1), (1, 0)
    node.mapping.update()
    tree.links.new(color, node.inputs["Color"])
    return node.outputs["Color"]


def link_map(tree, shader, name, image, row, green_down):
    texture = node_of(tree, "ShaderNodeTexImage", "Bisque " + name, row, 0)
    texture.image = image
    color = texture.outputs["Color"]
    if name == "normal":
        color = turn_green(tree, color, row) if green_down else color
        normal = node_of(tree, "ShaderNodeNormalMap", "Bisque normal map", row, 2)
        tree.links.new(color, normal.inputs["Color"])
        tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    elif name == "orm":
        parts = node_of(tree, "ShaderNodeSeparateColor", "Bisque orm parts", row, 1)
        tree.links.new(color, parts.inputs["Color"])
        tree.links.new(parts.outputs["Green"], shader.inputs["Roughness"])
        tree.links.new(parts.outputs["Blue"], shader.inputs["Metallic"])
    elif name in INPUTS:
        tree.links.new(color, shader.inputs[INPUTS[name]])


def link_maps(item, maps, green_down=False):
    """Links maps into the material of an object. maps: paths by the name of the map. Maps that no input takes,
    such as height, become nodes without links."""
    material = material_of(item)
    shader = shader_of(material.node_tree)
    for row, (name, path) in enumerate(sorted(maps.items())):
        image = load_image(path, f"{item.name} {name}", space_of(name, path))
        link_map(material.node_tree, shader, name, image, row, green_down)

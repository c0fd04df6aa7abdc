"""material.py - links baked maps into the material of an object."""
import bpy

# Map, and the input of the Principled shader that it feeds.
INPUTS = {"color": "Base Color", "roughness": "Roughness", "transfer:roughness": "Roughness",
          "metallic": "Metallic", "transfer:metallic": "Metallic"}


def load_image(path, name, is_color):
    """Loads a map, or reads it again if the image is there already."""
    image = bpy.data.images.get(name)
    if image and bpy.path.abspath(image.filepath) == path:
        image.reload()
    else:
        image = bpy.data.images.load(path)
        image.name = name
    # OpenEXR files hold linear light. All other maps are numbers. The preview, None, names its own space.
    if is_color is not None:
        image.colorspace_settings.name = "Linear Rec.709" if is_color else "Non-Color"
    return image


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


def link_map(tree, shader, name, image, row):
    texture = node_of(tree, "ShaderNodeTexImage", "Bisque " + name, row, 0)
    texture.image = image
    color = texture.outputs["Color"]
    if name == "normal":
        normal = node_of(tree, "ShaderNodeNormalMap", "Bisque normal map", row, 1)
        tree.links.new(color, normal.inputs["Color"])
        tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    elif name == "orm":
        parts = node_of(tree, "ShaderNodeSeparateColor", "Bisque orm parts", row, 1)
        tree.links.new(color, parts.inputs["Color"])
        tree.links.new(parts.outputs["Green"], shader.inputs["Roughness"])
        tree.links.new(parts.outputs["Blue"], shader.inputs["Metallic"])
    elif name in INPUTS:
        tree.links.new(color, shader.inputs[INPUTS[name]])


def link_maps(item, maps):
    """Links maps into the material of an object. maps: paths by the name of the map. Maps that no input takes,
    such as height, become nodes without links."""
    material = material_of(item)
    shader = shader_of(material.node_tree)
    for row, (name, path) in enumerate(sorted(maps.items())):
        image = load_image(path, f"{item.name} {name}", name == "color")
        link_map(material.node_tree, shader, name, image, row)

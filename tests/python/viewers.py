"""Measures how far the normals that viewers show of a GLB file are from those of the scan.

    viewers.py [--blender PYTHON-WITH-BPY] FOLDER

The low-poly mesh is a cube with rounded sides, hard edges and mirrored charts. Its map of normals in
object space is what the viewers should show. trimesh and Assimp give arrays, which are put together
as glTF 2.0 says; three.js draws the mesh unfolded, with its own shader; Blender bakes its material.
Prints the mean angle for each; exit status 1 if one is above 1 degree."""
import base64
import json
import os
import subprocess
import sys

import bisque
import numpy as np

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from conftest import sphere  # noqa: E402

SIZE = 512


def cube(steps, waves):
    """Returns vertices, faces, and the side of the cube of each face, which bulges."""
    vertices, faces = sphere(steps, False)
    side = vertices / abs(vertices).max(axis=1)[:, None]
    vertices = 0.8 * side + 0.35 * vertices
    middle = vertices[faces].mean(axis=1)
    axis = abs(side[faces].mean(axis=1)).argmax(axis=1)
    sign = np.take_along_axis(middle, axis[:, None], 1)[:, 0] > 0
    if waves:
        vertices = vertices + 0.01 * np.sin(14 * vertices[:, [1, 2, 0]]) * vertices
    return vertices, faces, axis * 2 + sign


def make_low():
    """Returns the low-poly mesh: a chart and smooth normals for each side, every second mirrored."""
    vertices, faces, sides = cube(6, False)
    mesh = bisque.Mesh(vertices, faces)
    uvs, normals = np.empty((len(faces), 3, 2)), np.empty((len(faces), 3, 3))
    p = vertices[faces]
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    for side in range(6):
        own = np.flatnonzero(sides == side)
        total = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(total, faces[own, k], flat[own])
        normals[own] = total[faces[own]]
        axis, sign = divmod(side, 2)
        local = p[own][:, :, [(axis + 1) % 3, (axis + 2) % 3]] / 2.6 + 0.5
        if (sign == 0) != (side % 3 == 0):  # some are mirrored, of both signs
            local[:, :, 0] = 1 - local[:, :, 0]
        uvs[own] = (local * 0.9 + 0.05 + [side % 3, side // 3]) / 3
    normals /= np.linalg.norm(normals, axis=2)[:, :, None]
    mesh.uvs, mesh.normals = uvs.reshape(-1, 2), normals.reshape(-1, 3)
    mesh.uv_faces = mesh.normal_faces = np.arange(3 * len(faces)).reshape(-1, 3)
    return mesh


def angles(normals, expected, mask):
    a, b = normals[mask].astype(float), expected[mask].astype(float)
    a, b = (v / np.linalg.norm(v, axis=1)[:, None] for v in (a, b))
    return float(np.degrees(np.arccos(np.clip((a * b).sum(axis=1), -1, 1))).mean())


# ---- arrays of a loader, shaded as glTF says ----

def shade(indices, uvs, normals, tangents, texture):
    """Returns the normals of a map's texels, by barycentric coordinates of their centres."""
    out = np.zeros((SIZE, SIZE, 3))
    bitangents = np.cross(normals, tangents[:, :3]) * tangents[:, 3:4]
    for face in np.asarray(indices).reshape(-1, 3):
        t = uvs[face] * SIZE - 0.5
        low, high = np.floor(t.min(axis=0)).astype(int), np.ceil(t.max(axis=0)).astype(int) + 1
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        m = np.array([[t[1, 0] - t[0, 0], t[2, 0] - t[0, 0]], [t[1, 1] - t[0, 1], t[2, 1] - t[0, 1]]])
        b = np.linalg.solve(m, np.stack([x.ravel() - t[0, 0], y.ravel() - t[0, 1]]))
        weights = np.stack([1 - b.sum(axis=0), b[0], b[1]], axis=1)
        inside = (weights >= 0).all(axis=1)
        weights, at = weights[inside], (y.ravel()[inside], x.ravel()[inside])
        n = texture[at] * 2 - 1
        out[at] = sum(n[:, k:k + 1] * (weights @ array[face])
                      for k, array in enumerate((tangents[:, :3], bitangents, normals)))
    return out


def parse(path):
    data = open(path, "rb").read()
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20:20 + length]), data[28 + length:]


def accessor(document, blob, number):
    a = document["accessors"][number]
    view = document["bufferViews"][a["bufferView"]]
    kind = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}[a["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
    start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
    item = np.dtype(kind).itemsize
    step = view.get("byteStride", width * item)
    return np.ndarray((a["count"], width), kind, blob, start, (step, item))


def texture_of(folder):
    from PIL import Image

    return np.asarray(Image.open(f"{folder}/normal.png"), float) / 255


def by_trimesh(path, folder):
    """Takes positions, normals and UVs from trimesh, which reads no tangents: those of the file."""
    import trimesh

    mesh, = trimesh.load_scene(path, process=False).geometry.values()
    uvs = np.asarray(mesh.visual.uv) * [1, -1] + [0, 1]  # trimesh has v upwards
    document, blob = parse(path)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    tangents = accessor(document, blob, attributes["TANGENT"])
    texture = np.asarray(mesh.visual.material.normalTexture.convert("RGB"), float) / 255
    return shade(mesh.faces, uvs, np.asarray(mesh.vertex_normals), tangents, texture)


def by_assimp(path, folder):
    import assimp_py

    scene = assimp_py.import_file(path, assimp_py.Process_Triangulate)
    mesh = scene.meshes[0]
    arrays = [np.asarray(a, float).reshape(-1, 3)
              for a in (mesh.normals, mesh.tangents, mesh.bitangents)]
    uvs = np.asarray(mesh.texcoords[0], float).reshape(len(arrays[0]), -1)[:, :2] * [1, -1] + [0, 1]
    sign = np.sign((np.cross(arrays[0], arrays[1]) * arrays[2]).sum(axis=1))
    tangents = np.concatenate([arrays[1], sign[:, None]], axis=1)
    return shade(np.asarray(mesh.indices), uvs, arrays[0], tangents, texture_of(folder))


# ---- programs ----

THREE = "/usr/share/javascript/three"
PAGE = """<body><script src="file://%(three)s/three.js"></script>
<script src="file://%(three)s/examples/js/loaders/GLTFLoader.js"></script><script>
for (const name in THREE.ShaderChunk)  // both sides of the unfolded mesh are its front
    THREE.ShaderChunk[name] = THREE.ShaderChunk[name].replace(/gl_FrontFacing/g, 'true');
const bytes = Uint8Array.from(atob('%(glb)s'), c => c.charCodeAt(0)).buffer;
new THREE.GLTFLoader().parse(bytes, '', gltf => {
    const renderer = new THREE.WebGLRenderer({preserveDrawingBuffer: true});
    renderer.setSize(%(size)d, %(size)d);
    const camera = new THREE.OrthographicCamera(-9, 9, 9, -9, 0, 99);
    gltf.scene.traverse(object => {
        object.frustumCulled = false;
        if (!object.isMesh) return;
        object.material.side = THREE.DoubleSide;
        object.material.onBeforeCompile = shader => {
            shader.vertexShader = shader.vertexShader.replace('#include <project_vertex>',
                '#include <project_vertex>\\ngl_Position = vec4(uv.x * 2. - 1., 1. - uv.y * 2., 0., 1.);');
            shader.fragmentShader = shader.fragmentShader.replace(/}\\s*$/,
                'gl_FragColor = vec4(normal * 0.5 + 0.5, 1.);}');
        };
    });
    setTimeout(() => {  // after the images are decoded
        renderer.render(gltf.scene, camera);
        window.pixels = renderer.domElement.toDataURL();
        document.body.dataset.ready = 'yes';
    }, 1500);
}, error => { document.body.dataset.ready = 'failed: ' + error; });
</script></body>"""


def by_three(path, folder):
    sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../doors"))
    from browser import Browser

    from PIL import Image

    page = f"{folder}/three.html"
    with open(page, "w") as file:
        file.write(PAGE % {"three": THREE, "size": SIZE,
                           "glb": base64.b64encode(open(path, "rb").read()).decode()})
    browser = Browser()
    try:
        ready = browser.open(page)
        if ready != "yes":
            raise RuntimeError(ready)
        pixels = base64.b64decode(browser.js("window.pixels").split(",")[1])
    finally:
        browser.close()
    with open(f"{folder}/three.png", "wb") as file:
        file.write(pixels)
    return np.asarray(Image.open(f"{folder}/three.png").convert("RGB"), float) / 127.5 - 1


BLENDER = """
import sys, bpy
path, out, size = sys.argv[1], sys.argv[2], int(sys.argv[3])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=path)
thing = next(o for o in bpy.context.scene.objects if o.type == 'MESH')
bpy.context.view_layer.objects.active = thing
thing.select_set(True)
image = bpy.data.images.new('out', size, size, float_buffer=True)
image.colorspace_settings.name = 'Non-Color'
for slot in thing.material_slots:
    node = slot.material.node_tree.nodes.new('ShaderNodeTexImage')
    node.image = image
    slot.material.node_tree.nodes.active = node
scene = bpy.context.scene
scene.render.engine, scene.cycles.samples = 'CYCLES', 1
scene.cycles.device = 'CPU'
bpy.ops.object.bake(type='NORMAL', normal_space='OBJECT', margin=0)
import numpy
pixels = numpy.empty(size * size * 4, numpy.float32)
image.pixels.foreach_get(pixels)
numpy.save(out, pixels.reshape(size, size, 4)[::-1, :, :3])
"""


def by_blender(path, folder, python):
    out = f"{folder}/blender.npy"
    subprocess.run([python, "-c", BLENDER, path, out, str(SIZE)], check=True, capture_output=True)
    n = np.load(out) * 2 - 1
    return np.stack([n[:, :, 0], n[:, :, 2], -n[:, :, 1]], axis=2)  # Blender has z upwards


def main(arguments):
    python = arguments[1] if arguments[0] == "--blender" else None
    folder = arguments[-1]
    os.makedirs(folder, exist_ok=True)
    scan, low = cube(150, True)[:2], make_low()
    path = f"{folder}/cube.glb"
    maps = bisque.bake(scan, low, ("normal", "mask"), size=SIZE, output=f"{folder}/<MAP>.png", glb=path,
                       sample_type="8")
    true = bisque.bake(scan, low, ("normal",), size=SIZE, normal_space="object", format="")
    mask = maps["mask"] == 1
    for axis in (0, 1):  # programs may sample texels on the edges of charts elsewhere
        mask = mask & np.roll(mask, 1, axis) & np.roll(mask, -1, axis)
    expected = true["normal"] * 2 - 1
    viewers = {"trimesh": by_trimesh, "Assimp": by_assimp, "three.js": by_three}
    if python:
        viewers["Blender"] = lambda *given: by_blender(*given, python)
    failed = False
    for name, viewer in viewers.items():
        try:
            mean = angles(viewer(path, folder), expected, mask)
        except ImportError as error:
            print(f"{name}: skipped, {error}")
            continue
        failed |= not mean <= 1
        print(f"{name}: {mean:.3f} degrees on average, of {mask.sum()} texels")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

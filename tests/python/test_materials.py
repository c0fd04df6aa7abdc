"""An asset has the materials of its scan. The scan is a box whose textures are formulas of their coordinates, so the
value of each texel of the asset is known; the low-poly mesh is the same box, with a chart for each side."""
import io
import json
import struct
from pathlib import Path

import bisque
import numpy as np
import pytest
from conftest import run_asset
from PIL import Image

SIZE, CUTOFF, STRENGTH, SCALE, OCCLUSION = 192, 0.4, 3.0, 0.8, 0.5
PLAIN = {"color": (0.2, 0.5, 0.8), "roughness": 0.3, "metallic": 0.6, "emission": (0.5, 0.25, 1.0)}


def srgb(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0), 1 / 2.4) - 0.055)


def linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def normal_of(u, v):
    """Returns a unit normal in tangent space, green upwards."""
    n = np.stack([0.5 * (u - 0.5), 0.4 * (v - 0.5) + 0.1, np.ones_like(u)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


#: By the names of textures: red, green, blue and alpha in linear light or as data, by coordinates with v downwards.
FORMULAS = {
    "base": lambda u, v: (0.2 + 0.5 * u, 0.6 - 0.4 * v, 0.3 + 0 * u, u),
    "orm": lambda u, v: (0.9 - 0.5 * u, 0.2 + 0.6 * v, 0.1 + 0.8 * u, 1 + 0 * u),
    "light": lambda u, v: (0.8 * u, 0.3 * v, 0.05 + 0 * u, 1 + 0 * u),
    "normal": lambda u, v: (*np.moveaxis(normal_of(u, 1 - v) / 2 + 0.5, -1, 0), 1 + 0 * u),
}


def write_image(path, name):
    at = (np.arange(256) + 0.5) / 256
    u, v = np.meshgrid(at, at)
    values = np.stack(FORMULAS[name](u, v), axis=2)
    if name in ("base", "light"):
        values[:, :, :3] = srgb(values[:, :, :3])
    Image.fromarray(np.round(255 * values).astype(np.uint8)).save(path)


def sides():
    """Yields the sides of a box: number, outward axis and sign, and the axes of u and v upwards, right-handed."""
    for side in range(6):
        axis, sign = side // 2, 1 - 2 * (side % 2)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        yield side, axis, sign, *((a, b) if sign > 0 else (b, a))


def write_scan(folder, mode, more=None):
    """Writes a glTF file: sides across x have no texture, the others have all."""
    positions, normals, uvs, indices = [], [], [], {0: [], 1: []}
    for side, axis, sign, a, b in sides():
        first = len(positions)
        for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
            p = np.zeros(3)
            p[axis], p[a], p[b] = sign, 2 * u - 1, 2 * v - 1
            positions.append(p)
            normals.append(sign * np.eye(3)[axis])
            uvs.append((0.1 + 0.8 * u, 0.9 - 0.8 * v))
        indices[int(axis == 0)] += [first + k for k in (0, 1, 2, 0, 2, 3)]
    blobs = [np.array(x, kind).tobytes() for x, kind in (
        (positions, "<f4"), (normals, "<f4"), (uvs, "<f4"), (indices[0], "<u4"), (indices[1], "<u4"))]
    starts = np.cumsum([0, *map(len, blobs)])
    (folder / "box.bin").write_bytes(b"".join(blobs))
    for name in FORMULAS:
        write_image(folder / f"{name}.png", name)
    half = {"KHR_texture_transform": {"scale": [0.5, 0.5], "offset": [0.25, 0.25]}}
    textured = {
        "name": "textured", "alphaMode": mode, "alphaCutoff": CUTOFF, "doubleSided": True,
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "roughnessFactor": 0.5,
                                 "metallicRoughnessTexture": {"index": 1, "extensions": half}},
        "occlusionTexture": {"index": 1, "strength": OCCLUSION}, "normalTexture": {"index": 3, "scale": SCALE},
        "emissiveTexture": {"index": 2}, "emissiveFactor": [1, 1, 1],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": STRENGTH}, **(more or {})}}
    plain = {"name": "plain", "emissiveFactor": PLAIN["emission"], "pbrMetallicRoughness": {
        "baseColorFactor": [*PLAIN["color"], 1], "roughnessFactor": PLAIN["roughness"],
        "metallicFactor": PLAIN["metallic"]}}
    root = {
        "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3 + k,
                                    "material": k} for k in (0, 1)]}],
        "materials": [textured, plain], "samplers": [{"wrapS": 33071, "wrapT": 33071}],
        "images": [{"uri": f"{name}.png"} for name in FORMULAS],
        "textures": [{"source": k, "sampler": 0} for k in range(4)],
        "buffers": [{"uri": "box.bin", "byteLength": int(starts[-1])}],
        "bufferViews": [{"buffer": 0, "byteOffset": int(starts[k]), "byteLength": len(blobs[k])} for k in range(5)],
        "accessors": [{"bufferView": k, "componentType": 5125 if k > 2 else 5126,
                       "type": ("VEC3", "VEC3", "VEC2", "SCALAR", "SCALAR")[k],
                       "count": len(indices[k - 3]) if k > 2 else 24,
                       **({"min": [-1, -1, -1], "max": [1, 1, 1]} if k == 0 else {})} for k in range(5)]}
    (folder / "box.gltf").write_text(json.dumps(root))
    return folder / "box.gltf"


def write_low(path):
    """Writes the box with a square chart of each side: its middle 80 %, in a grid of 3 x 3."""
    lines = []
    for side, axis, sign, a, b in sides():
        for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
            p = np.zeros(3)
            p[axis], p[a], p[b] = sign, 2 * u - 1, 2 * v - 1
            lines.append("v %g %g %g" % tuple(p))
            lines.append(f"vt {(side % 3 + 0.1 + 0.8 * u) / 3} {(side // 3 + 0.1 + 0.8 * v) / 3}")
        lines.append("vn %g %g %g" % tuple(sign * np.eye(3)[axis]))
        for triangle in ((1, 2, 3), (1, 3, 4)):
            lines.append("f " + " ".join(f"{4 * side + k}/{4 * side + k}/{side + 1}" for k in triangle))
    path.write_text("\n".join(lines) + "\n")
    return path


def read_material(path):
    """Returns the material of a GLB file, and its images by the names of their textures."""
    data = Path(path).read_bytes()
    length, = struct.unpack_from("<I", data, 12)
    head, body = json.loads(data[20:20 + length]), data[28 + length:]
    material, = head["materials"]
    images = {}
    for name, reference in [*material.items(), *material["pbrMetallicRoughness"].items()]:
        if name.endswith("Texture"):
            view = head["bufferViews"][head["images"][head["textures"][reference["index"]]["source"]]["bufferView"]]
            image = Image.open(io.BytesIO(body[view["byteOffset"]:view["byteOffset"] + view["byteLength"]]))
            images[name] = np.asarray(image) / 255
    return head, material, images


def texels(textured):
    """Returns rows and columns of texels inside the charts, and their texture coordinates in the scan, v downwards."""
    at = (np.arange(SIZE) + 0.5) / SIZE * 3
    x, y = np.meshgrid(at, at[::-1])
    side = x.astype(int) + 3 * y.astype(int)
    u, v = ((c % 1 - 0.1) / 0.8 for c in (x, y))
    inside = (np.minimum(u, v) > 0.04) & (np.maximum(u, v) < 0.96) & ((side < 2) != textured) & (side < 6)
    rows = np.nonzero(inside)
    return rows, 0.1 + 0.8 * u[rows], 0.9 - 0.8 * v[rows]


def close(found, expected, tolerance):
    assert np.abs(found - expected).max() < tolerance, np.abs(found - expected).max()


@pytest.mark.parametrize("surface", ["exact", "grid"])
def test_asset_has_the_materials_of_its_scan(tmp_path, surface):
    scan = write_scan(tmp_path, "MASK", {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5}})
    low = write_low(tmp_path / "low.obj")
    level, = bisque.asset(scan, tmp_path / "a.glb", low=low, size=SIZE, surface=surface, images="png")["levels"]
    assert set(level["materials"].pop("taken")) == {"normal_map", "emission", "metallic", "occlusion", "opacity",
                                                    "roughness"}
    assert level["materials"] == {"not_taken": ["clearcoat"], "alpha": "mask", "double_sided": True}
    head, material, images = read_material(tmp_path / "a.glb")
    strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    assert material["alphaMode"] == "MASK" and material.get("alphaCutoff", 0.5) == 0.5 and material["doubleSided"]
    assert head["extensionsUsed"] == ["KHR_materials_emissive_strength"]
    assert material["emissiveFactor"] == [1, 1, 1] and 1 < strength <= STRENGTH
    assert images["occlusionTexture"] is not None and np.array_equal(
        images["occlusionTexture"], images["metallicRoughnessTexture"])
    base, orm, light, normal = (images[k] for k in (
        "baseColorTexture", "metallicRoughnessTexture", "emissiveTexture", "normalTexture"))
    step = 1.5 / 255 + (0.01 if surface == "grid" else 0)  # of a voxel, on slopes of one over a side

    at, u, v = texels(True)
    shown, data = np.stack(FORMULAS["base"](u, v), axis=1), np.stack(FORMULAS["orm"](u, v), axis=1)
    close(base[at][:, :3], srgb(shown[:, :3]), step)
    sure = abs(u - CUTOFF) > 0.02
    close(base[at][sure, 3], (u >= CUTOFF)[sure], step)
    close(orm[at][:, 0], 1 + OCCLUSION * (data[:, 0] - 1), step)
    moved = np.stack(FORMULAS["orm"](0.5 * u + 0.25, 0.5 * v + 0.25), axis=1)
    close(orm[at][:, 1], 0.5 * moved[:, 1], step)
    close(orm[at][:, 2], moved[:, 2], step)
    given = STRENGTH * np.stack(FORMULAS["light"](u, v), axis=1)[:, :3]
    close(strength * linear(light[at]), given, STRENGTH * 2.5 * step)
    n = normal_of(u, 1 - v) * [SCALE, SCALE, 1]
    close(normal[at], n / np.linalg.norm(n, axis=1, keepdims=True) / 2 + 0.5, step)

    at, u, v = texels(False)
    close(base[at], np.append(srgb(np.array(PLAIN["color"])), 1), step)
    close(orm[at], [1, PLAIN["roughness"], PLAIN["metallic"]], step)
    close(strength * linear(light[at]), np.array(PLAIN["emission"]), STRENGTH * step)
    close(normal[at], [0.5, 0.5, 1], step)
    for name in ("roughness", "metallic", "occlusion", "opacity", "emission"):
        assert level[f"{name}_error"]["compared"] > 10_000 and level[f"{name}_error"]["mean"] < 0.03, name
        assert Path(tmp_path / "a_asset" / f"{name}.png").exists()


def test_opacity_blends(tmp_path):
    scan = write_scan(tmp_path, "BLEND")
    bisque.asset(scan, tmp_path / "a.glb", low=write_low(tmp_path / "low.obj"), size=SIZE)
    _, material, images = read_material(tmp_path / "a.glb")
    assert material["alphaMode"] == "BLEND"
    at, u, _ = texels(True)
    close(images["baseColorTexture"][at][:, 3], u, 1.5 / 255)


def test_masks_that_cut_nothing_are_opaque(tmp_path):
    scan, low = write_scan(tmp_path, "MASK"), write_low(tmp_path / "low.obj")
    root = json.loads(scan.read_text())
    for material in root["materials"]:
        material["alphaCutoff"] = 0
    scan.write_text(json.dumps(root))
    level, = bisque.asset(scan, tmp_path / "a.glb", low=low, size=64)["levels"]
    assert level["opacity_error"]["max"] == 0 and "alphaMode" not in read_material(tmp_path / "a.glb")[1]


def test_maps_choose_what_is_taken(tmp_path):
    scan, low = write_scan(tmp_path, "OPAQUE"), write_low(tmp_path / "low.obj")
    level, = bisque.asset(scan, tmp_path / "a.glb", low=low, size=64, maps=["normal", "roughness"])["levels"]
    assert level["materials"] == {"taken": ["roughness", "normal_map"], "alpha": None, "double_sided": True,
                                  "not_taken": ["metallic", "occlusion", "emission"]}
    _, material, images = read_material(tmp_path / "a.glb")
    assert set(images) == {"metallicRoughnessTexture", "normalTexture"} and "alphaMode" not in material
    # What a chunk file keeps, an asset of it has too.
    bisque.sort(scan, tmp_path / "box.tris", channels="all")
    level, = bisque.asset(tmp_path / "box.tris", tmp_path / "b.glb", low=low, size=64)["levels"]
    assert level["materials"]["not_taken"] == [] and level["materials"]["double_sided"] is False
    assert "roughness_error" in level
    done = run_asset(tmp_path / "box.tris", "-o", tmp_path / "c.glb", "--low", low, "--maps", "color,sheen")
    assert done.returncode == 65 and done.stderr == (
        "bisque-asset: the scan has no channel sheen; it has: emission, metallic, occlusion, roughness\n")


def test_materials_that_say_nothing_take_no_maps(tmp_path):
    scan, low = write_scan(tmp_path, "BLEND"), write_low(tmp_path / "low.obj")
    root = json.loads(scan.read_text())
    dull = {"emissiveFactor": [0, 0, 0], "alphaMode": "OPAQUE",
            "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}
    root["materials"] = [dull, dull]
    scan.write_text(json.dumps(root))
    level, = bisque.asset(scan, tmp_path / "a.glb", low=low, size=64)["levels"]
    _, material, images = read_material(tmp_path / "a.glb")
    assert "emissiveTexture" not in images and "alphaMode" not in material and "doubleSided" not in material
    assert not {"emission", "opacity"} & {*level["materials"]["taken"]}
    close(images["metallicRoughnessTexture"][32, 32, 1:], [1, 1], 1.5 / 255)  # what glTF says without a word
    dull["extensions"] = {"KHR_materials_unlit": {}}
    scan.write_text(json.dumps(root))
    bisque.asset(scan, tmp_path / "a.glb", low=low, size=64)
    _, material, images = read_material(tmp_path / "a.glb")
    assert "metallicRoughnessTexture" not in images and material["pbrMetallicRoughness"]["metallicFactor"] == 0

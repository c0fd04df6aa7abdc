"""USDZ files, which iPhones show in augmented reality: those of Bisque's GLB files, by usd-core (Pixar).

Materials become UsdPreviewSurface; images stay as they are. The package's files lie uncompressed at multiples of 64
bytes, as its specification says, and have no times."""
from __future__ import annotations

import importlib.util
import os
import struct
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from .glb import Glb
from .mesh import Error
from .place import turn

#: Inputs of UsdPreviewSurface and the components of an image, by glTF's textures.
INPUTS = {"baseColorTexture": {"diffuseColor": "rgb", "opacity": "a"}, "normalTexture": {"normal": "rgb"},
          "metallicRoughnessTexture": {"roughness": "g", "metallic": "b"}, "occlusionTexture": {"occlusion": "r"},
          "emissiveTexture": {"emissiveColor": "rgb"}}
SUFFIX, ALIGNMENT, JPEG = ".usdz", 64, b"\xff\xd8"


def installed() -> bool:
    """Returns whether usd-core is."""
    return importlib.util.find_spec("pxr") is not None


def require() -> None:
    """Raises Error if usd-core is not installed."""
    if not installed():
        raise Error(69, "usd-core is not installed: pip install usd-core")


def _define_material(stage: Any, path: str, glb: Glb, material: dict) -> tuple[Any, dict[str, Any]]:
    """Defines a material of glTF. Returns it, and its images by their names in the package."""
    from pxr import Sdf, UsdShade

    kinds, images = Sdf.ValueTypeNames, {}

    def shader(name: str, kind: str, **inputs: tuple[Any, Any]) -> Any:
        made = UsdShade.Shader.Define(stage, f"{path}/{name}")
        made.CreateIdAttr(kind)
        for key, (of, value) in inputs.items():
            made.CreateInput(key, of).Set(value)
        return made

    material = {**material, **material["pbrMetallicRoughness"]}
    alpha = material.get("alphaMode")
    light = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    numbers = {"roughness": material.get("roughnessFactor", 1.0), "metallic": material.get("metallicFactor", 1.0),
               "opacityThreshold": material.get("alphaCutoff", 0.5) if alpha == "MASK" else 0.0}
    surface = shader("Surface", "UsdPreviewSurface", **{name: (kinds.Float, value) for name, value in numbers.items()},
                     diffuseColor=(kinds.Color3f, tuple(material.get("baseColorFactor", (1, 1, 1))[:3])))
    reader = shader("Coordinates", "UsdPrimvarReader_float2", varname=(kinds.String, "st"))
    at = reader.CreateOutput("result", kinds.Float2)
    for texture, inputs in INPUTS.items():
        if texture not in material:
            continue
        data = bytes(glb.image(material[texture]))
        file = f"{glb.image_number(material[texture])}{'.jpg' if data.startswith(JPEG) else '.png'}"
        images[file] = data
        factor, offset = {"normalTexture": (2.0, -1.0), "emissiveTexture": (light, 0.0)}.get(texture, (1.0, 0.0))
        image = shader(
            texture, "UsdUVTexture", file=(kinds.Asset, file),
            wrapS=(kinds.Token, "clamp"), wrapT=(kinds.Token, "clamp"),
            sourceColorSpace=(kinds.Token, "sRGB" if texture in ("baseColorTexture", "emissiveTexture") else "raw"),
            scale=(kinds.Float4, (factor, factor, factor, 1)), bias=(kinds.Float4, (offset, offset, offset, 0)))
        image.CreateInput("st", kinds.Float2).ConnectToSource(at)
        for name, component in inputs.items():
            if name != "opacity" or alpha:
                of = kinds.Float if component != "rgb" else kinds.Normal3f if name == "normal" else kinds.Color3f
                output = image.CreateOutput(component, kinds.Float if component != "rgb" else kinds.Float3)
                surface.CreateInput(name, of).ConnectToSource(output)
    made = UsdShade.Material.Define(stage, path)
    made.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", kinds.Token))
    return made, images


def _define_mesh(stage: Any, path: str, glb: Glb, node: dict, primitive: dict) -> Any:
    """Defines a mesh of a node of glTF, where that has it."""
    from pxr import Gf, Sdf, UsdGeom, Vt

    attributes, faces = glb.primitive(primitive)
    rotation = node.get("rotation", (0, 0, 0, 1))
    points = turn(rotation, attributes["POSITION"] * node.get("scale", 1)) + node.get("translation", 0)
    made = UsdGeom.Mesh.Define(stage, path)
    made.CreateSubdivisionSchemeAttr("none")
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    made.CreateExtentAttr([Gf.Vec3f(*map(float, of)) for of in (points.min(axis=0), points.max(axis=0))])
    made.CreateFaceVertexCountsAttr(Vt.IntArray(len(faces), 3))
    made.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    made.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(turn(rotation, attributes["NORMAL"]).astype(np.float32)))
    made.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    uvs = (attributes["TEXCOORD_0"] * (1, -1) + (0, 1)).astype(np.float32)  # v upwards
    UsdGeom.PrimvarsAPI(made).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex).Set(
        Vt.Vec2fArray.FromNumpy(uvs))
    return made


def write_usdz(source: Path, target: Path) -> None:
    """Writes the GLB file of an asset as a USDZ file, with y upwards and in metres."""
    from pxr import Usd, UsdGeom, UsdShade

    glb = Glb(source)
    node, = glb.head["nodes"]
    primitive, = glb.head["meshes"][0]["primitives"]
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Asset").GetPrim())
    mesh = _define_mesh(stage, "/Asset/Mesh", glb, node, primitive)
    material = glb.head["materials"][primitive["material"]]
    made, images = _define_material(stage, "/Asset/Material", glb, material)
    mesh.CreateDoubleSidedAttr(material.get("doubleSided", False))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(made)
    folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:  # the library takes no names that are not UTF-8
        stage.GetRootLayer().Export(f"/proc/self/fd/{folder}/asset.usdc")
    finally:
        os.close(folder)
    layer = target.with_name("asset.usdc")
    with zipfile.ZipFile(target, "w") as package:
        for name, data in {"asset.usdc": layer.read_bytes(), **images}.items():
            info = zipfile.ZipInfo(name)
            # A field of 4 bytes and what is missing.
            begin = package.fp.tell() + zipfile.sizeFileHeader + len(name) + 4
            info.extra = struct.pack("<2H", 0x1986, -begin % ALIGNMENT) + bytes(-begin % ALIGNMENT)
            package.writestr(info, data)
    layer.unlink()


def made(steps: Any, level: dict, source: Path) -> Path:
    """Makes the USDZ file of a placed GLB file of a level in a step."""
    target = source.with_suffix(".usdz")
    steps.run(f"usdz {source.stem} {level['name']}", [source], {"version": metadata.version("usd-core")}, [target],
              lambda: write_usdz(source, target))
    return target

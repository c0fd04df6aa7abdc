"""USDZ files: what Pixar's library reads of them, and its validators."""
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from conftest import certificate_of
from pxr import Usd, UsdGeom, UsdShade, UsdValidation

import bisque
from bisque.glb import Glb


def faults_of(stage):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    return [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


@pytest.fixture(scope="module")
def colored(scan):
    return bisque.Mesh(*scan, colors=np.random.default_rng(1).integers(0, 255, (len(scan[0]), 3)).astype(np.uint8))


def test_a_package_has_what_its_glb_file_has(colored, low, tmp_path):
    given = {"low": low, "size": 64, "up": "z", "units": "cm"}
    bisque.asset(colored, tmp_path / "a.glb", **given)
    bisque.asset(colored, tmp_path / "b.usdz", **given, geometry="meshopt")
    assert not (tmp_path / "b.glb").exists()
    certificate_of(tmp_path / "b.usdz")
    stage = Usd.Stage.Open(str(tmp_path / "b.usdz"))
    assert faults_of(stage) == []
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Asset/Mesh"))
    points, found = low.vertices[:, [0, 2, 1]] * [0.01, 0.01, -0.01], np.array(mesh.GetPointsAttr().Get())
    assert np.allclose(found.min(axis=0), points.min(axis=0), atol=1e-6)
    assert np.allclose(found.max(axis=0), points.max(axis=0), atol=1e-6)
    glb = Glb(tmp_path / "a.glb")
    image, = (prim for prim in stage.Traverse() if prim.GetName() == "baseColorTexture")
    name = UsdShade.Shader(image).GetInput("file").Get().path.rpartition("/")[2]
    with zipfile.ZipFile(tmp_path / "b.usdz") as package:
        reference = glb.head["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
        assert package.read(name) == bytes(glb.image(reference))
        assert all(info.compress_type == zipfile.ZIP_STORED for info in package.infolist())


def test_bytes_are_always_the_same(colored, low, tmp_path):
    for name in "ab":
        bisque.asset(colored, tmp_path / f"{name}.usdz", low=low, size=32)
    assert (tmp_path / "a.usdz").read_bytes() == (tmp_path / "b.usdz").read_bytes()


def test_an_older_file_of_the_other_kind_stays(colored, low, tmp_path):
    for name in ("a.glb", "a.usdz", "a.glb"):
        bisque.asset(colored, tmp_path / name, low=low, size=32)
    assert {path.name for path in tmp_path.iterdir()} == {"a.glb", "a.usdz", "a_asset"}


def test_faults_are_found():
    """The validators are no empty list: a stage without its upward axis fails."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.Mesh.Define(stage, "/Mesh")
    assert faults_of(stage)


def test_without_the_library(tmp_path):
    code = ("import sys, importlib.util as u; find = u.find_spec; "
            "u.find_spec = lambda n: None if n == 'pxr' else find(n); import bisque_start; sys.exit(bisque_start.asset())")
    done = subprocess.run([sys.executable, "-c", code, "scan.obj", "-o", "a.usdz"], cwd=tmp_path, capture_output=True,
                          text=True)
    assert done.returncode == 69
    assert done.stderr == "bisque-asset: usd-core is not installed: pip install usd-core\n"

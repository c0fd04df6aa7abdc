"""Packed GLB files: other readers see the same surface, and what packing lost is as the certificate says."""
import io
import json
import os
import subprocess

import bisque
import numpy as np
import pytest
import trimesh
from bisque import glb
from bisque.lib._core import lib
from conftest import run_asset
from PIL import Image


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An asset for each way of packing, of one scan."""
    folder = tmp_path_factory.mktemp("packed")
    subprocess.run([os.environ["GENERATE"], "--triangles", "20000", "--colors", "vase", "-o", folder / "scan.obj"],
                   check=True)
    found = {}
    for geometry, images in (("none", "png"), ("none", "jpeg"), ("meshopt", "all-jpeg"), ("draco", "jpeg")):
        out = folder / f"{geometry}_{images}.glb"
        done = run_asset(folder / "scan.obj", "-o", out, "--triangles", 1000, "--size", 256, "--images", images,
                         "--geometry", geometry, "--keep", folder / "keep", "--json")
        assert done.returncode == 0, done.stderr
        found[geometry, images] = out, json.loads(done.stdout)["levels"][0]
    return found


def image_of(path, texture):
    file = glb.Glb(path)
    material, = file.head["materials"]
    return Image.open(io.BytesIO(bytes(file.image(material[texture]))))


def test_files_become_smaller_and_say_how(made):
    sizes = [path.stat().st_size for path, _ in made.values()]
    assert sizes[0] > sizes[1] > sizes[2] and sizes[1] > sizes[3]
    assert made["none", "png"][1]["packed"] == {}
    for (geometry, images), (path, level) in list(made.items())[1:]:
        told = level["packed"][path.name]
        assert told["bytes"] == path.stat().st_size < told["bytes_before"]
        assert set(told["images"]) == {"ao", "color", *(["normal"] if images == "all-jpeg" else [])}
        assert image_of(path, "normalTexture").format == ("JPEG" if images == "all-jpeg" else "PNG")
        assert image_of(path, "occlusionTexture").format == "JPEG"
        assert image_of(path, "occlusionTexture").mode == "L"


def test_certificate_tells_what_jpeg_lost(made):
    before = np.asarray(image_of(made["none", "png"][0], "occlusionTexture").convert("RGB"), float)[:, :, 0]
    path, level = made["none", "jpeg"]
    after = np.asarray(image_of(path, "occlusionTexture"), float)
    lost = level["packed"][path.name]["images"]["ao"]
    assert lost["mean"] == pytest.approx(np.abs(after - before).mean() / 255, rel=1e-3) and 0 < lost["mean"] < 0.03
    before, after = (np.asarray(image_of(made[key][0], "normalTexture"), float)[:, :, :3] / 127.5 - 1
                     for key in (("none", "png"), ("meshopt", "all-jpeg")))
    cosines = (before * after).sum(axis=2) / np.linalg.norm(before, axis=2) / np.linalg.norm(after, axis=2)
    path, level = made["meshopt", "all-jpeg"]
    lost = level["packed"][path.name]["images"]["normal"]
    assert lost["mean"] == pytest.approx(np.degrees(np.arccos(cosines.clip(-1, 1))).mean(), rel=0.02)


def test_other_readers_see_the_surface(made, tmp_path):
    plain = trimesh.load(made["none", "png"][0], force="mesh")
    size = np.ptp(plain.vertices, axis=0).max()
    for geometry in ("meshopt", "draco"):
        path, level = made[geometry, "all-jpeg" if geometry == "meshopt" else "jpeg"]
        # bisque-voxelize reads it in C, and trimesh draws from Draco's library.
        apart = bisque.measure(str(path), plain)
        worst = max(of["max"] for of in apart.values())
        assert worst < size / 65535
        assert level["packed"][path.name]["geometry"]["distance"] == pytest.approx(worst, rel=0.2)
    # Draco's file is the last one. Its normals are as before.
    assert level["normal_error"]["mean"] == pytest.approx(made["none", "png"][1]["normal_error"]["mean"], rel=0.2)
    seen = trimesh.load(path, force="mesh")
    assert len(seen.faces) == len(plain.faces) and seen.area == pytest.approx(plain.area, rel=1e-4)


def test_smaller_copies_are_means(tmp_path):
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(8, 8, 3)) + [0, 0, 3]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    Image.fromarray(np.round(normals * 127.5 + 127.5).astype(np.uint8)).save(tmp_path / "n.png")
    glb.copy_image(tmp_path / "n.png", tmp_path / "n2.png", lib.IMAGE_NORMAL, factor=4)
    found = np.asarray(Image.open(tmp_path / "n2.png"), float) / 127.5 - 1
    mean = normals.reshape(2, 4, 2, 4, 3).mean(axis=(1, 3))
    mean /= np.linalg.norm(mean, axis=2, keepdims=True)
    assert np.abs(found - mean).max() < 2.1 / 255
    # Black and white are grey in linear light.
    Image.fromarray(np.tile(np.uint8([[0, 255], [255, 0]])[:, :, None], (2, 2, 3))).save(tmp_path / "c.png")
    glb.copy_image(tmp_path / "c.png", tmp_path / "c2.png", lib.IMAGE_COLOR, factor=2)
    assert np.abs(np.asarray(Image.open(tmp_path / "c2.png"), float) - 188).max() <= 1
    with pytest.raises(bisque.Error, match="cannot be divided by 3"):
        glb.copy_image(tmp_path / "c.png", tmp_path / "c3.png", lib.IMAGE_COLOR, factor=3)
    with pytest.raises(bisque.Error) as error:
        glb.copy_image(tmp_path / "c.png", tmp_path / "none/c.jpg", lib.IMAGE_COLOR, quality=90)
    assert error.value.status == 73


def test_colours_with_alpha_stay_png():
    head = {"textures": [{"source": 0}], "materials": [{"alphaMode": "BLEND", "pbrMetallicRoughness": {
        "baseColorTexture": {"index": 0}}}]}
    assert glb._uses(head)[0] == ("color", lib.IMAGE_COLOR, 3, False)
    head["materials"][0]["alphaMode"] = "OPAQUE"
    assert glb._uses(head)[0] == ("color", lib.IMAGE_COLOR, 3, True)


def test_bad_words_are_refused():
    for option in ("--images", "--geometry"):
        assert run_asset("a.obj", "-o", "a.glb", option, "zip").returncode == 64

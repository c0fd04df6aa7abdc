"""The certificate's errors are those of the picture that a viewer draws. The scan is a formula: its normals and
colours are known without triangles. The viewer is written here, from glTF 2.0."""
import io
import json
import struct

import bisque
import numpy as np
import pytest
from conftest import HEIGHT, RADIUS, WAVES, radius_at, sphere
from PIL import Image

RAYS = 10_000


def grey_at(direction):
    return 0.5 + 0.3 * np.sin(20 * direction[:, 0]) * np.sin(17 * direction[:, 1] + 1)


def normal_at(p):
    """Returns the gradient of |p| - radius_at(p / |p|)."""
    def level(q):
        r = np.linalg.norm(q, axis=1)
        return r - radius_at(q / r[:, None])
    steps = np.eye(3) * 1e-5
    g = np.stack([level(p + s) - level(p - s) for s in steps], axis=1)
    return g / np.linalg.norm(g, axis=1, keepdims=True)


def read_asset(path):
    data = path.read_bytes()
    length, = struct.unpack_from("<I", data, 12)
    head, body = json.loads(data[20:20 + length]), data[28 + length:]

    def view(number):
        v = head["bufferViews"][number]
        return body[v["byteOffset"]:v["byteOffset"] + v["byteLength"]]

    def image(reference):
        source = head["images"][head["textures"][reference["index"]]["source"]]
        return np.asarray(Image.open(io.BytesIO(view(source["bufferView"]))).convert("RGB")) / 255

    primitive = head["meshes"][0]["primitives"][0]
    indices = np.frombuffer(view(head["accessors"][primitive["indices"]]["bufferView"]), "<u4").reshape(-1, 3)
    position = head["accessors"][primitive["attributes"]["POSITION"]]
    rows = np.frombuffer(view(position["bufferView"]), "<f4").reshape(-1, 12)[indices].astype(float)
    rows[:, :, :3] += head["nodes"][0]["translation"]
    material = head["materials"][0]
    return rows, image(material["normalTexture"]), image(material["pbrMetallicRoughness"]["baseColorTexture"])


def lookup(image, uv, decode):
    at = uv * image.shape[1::-1] - 0.5
    low = np.floor(at).astype(int)
    part, total = at - low, 0
    for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = abs(1 - i - part[:, 0]) * abs(1 - j - part[:, 1])
        texel = image[(low[:, 1] + j).clip(0, image.shape[0] - 1), (low[:, 0] + i).clip(0, image.shape[1] - 1)]
        total = total + weight[:, None] * decode(texel)
    return total


def linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def lab(color):
    """Returns CIELAB under D65 of linear Rec. 709."""
    to_xyz = np.array([[.4124564, .3575761, .1804375], [.2126729, .7151522, .0721750], [.0193339, .1191920, .9503041]])
    x = color @ (to_xyz / to_xyz.sum(axis=1, keepdims=True)).T
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def hit_triangles(rows, origin, direction):
    """Returns the triangle that a ray hits first from the front, or -1, and its weights (Möller & Trumbore 1997)."""
    p = rows[:, :, :3]
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    h = np.cross(direction, e2)
    det = (e1 * h).sum(axis=1)
    s = origin - p[:, 0]
    u = (s * h).sum(axis=1) / det
    q = np.cross(s, e1)
    v = q @ direction / det
    t = np.where((det > 0) & (u >= 0) & (v >= 0) & (u + v <= 1), (e2 * q).sum(axis=1) / det, np.inf)
    first = int(t.argmin())
    return (first if np.isfinite(t[first]) else -1), [1 - u[first] - v[first], u[first], v[first]]


def hit_formula(origin, direction):
    """Returns where rays first meet the scan, and whether they do: by steps, then bisection."""
    def outside(t):
        p = origin + t[:, None] * direction
        r = np.linalg.norm(p, axis=1)
        return r > radius_at(p / r[:, None])
    near = np.zeros(len(origin))
    hit = np.zeros(len(origin), bool)
    for _ in range(500):
        hit |= ~outside(near + 0.006)
        near = np.where(hit, near, near + 0.006)
    low, high = near, near + 0.006
    for _ in range(40):
        middle = (low + high) / 2
        low, high = np.where(outside(middle), middle, low), np.where(outside(middle), high, middle)
    return origin + low[:, None] * direction, hit


@pytest.mark.parametrize("surface", ["exact", "grid"])
def test_certificate_tells_what_a_viewer_sees(tmp_path, surface):
    vertices, faces = sphere(320, True)  # as good as the formula
    directions = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    colors = np.round(255 * np.tile(grey_at(directions)[:, None], 3)).astype(np.uint8)
    shift = np.array([500.0, -20, 3])  # the GLB file moves it by its node
    mesh = bisque.Mesh(vertices + shift, faces, normals=normal_at(vertices), colors=colors)
    level = bisque.asset(mesh, tmp_path / "ball.glb", triangles=1200, size=256, surface=surface)["levels"][0]
    rows, normals, base = read_asset(tmp_path / "ball.glb")
    rows[:, :, :3] -= shift

    rng = np.random.default_rng(7)
    toward = rng.normal(size=(RAYS, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    right = np.cross(toward, rng.normal(size=(RAYS, 3)))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    x, y = 1.02 * rng.uniform(-1, 1, (2, RAYS, 1))
    origins = x * right + y * np.cross(toward, right) + 1.5 * toward
    found = [hit_triangles(rows, *ray) for ray in zip(origins, -toward)]
    t, w = np.array([of for of, _ in found]), np.array([weights for _, weights in found])
    p, met = hit_formula(origins, -toward)
    both = met & (t >= 0)
    t, w, p = t[both], w[both], p[both]

    corner = (rows[t] * w[:, :, None]).sum(axis=1)
    n, tangent = corner[:, 3:6], corner[:, 6:9]
    m = 2 * lookup(normals, corner[:, 10:12], lambda texel: texel) - 1
    n = m[:, :1] * tangent + m[:, 1:2] * rows[t, 0, 9:10] * np.cross(n, tangent) + m[:, 2:] * n
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    true = np.degrees(2 * np.arcsin(np.linalg.norm(n - normal_at(p), axis=1) / 2))
    for key, value, within in (("mean", true.mean(), 0.05), ("median", np.median(true), 0.05),
                               ("p95", np.percentile(true, 95), 0.1)):
        assert level["normal_error"][key] == pytest.approx(value, rel=within), key
    # Of colours that are nearly grey, CIEDE2000 weighs lightness by S_L, and a* by 1.5.
    direction = p / np.linalg.norm(p, axis=1, keepdims=True)
    seen = lab(lookup(base, corner[:, 10:12], linear))
    there = lab(np.tile(linear(grey_at(direction))[:, None], 3))
    away = ((seen + there)[:, 0] / 2 - 50) ** 2
    weights = np.stack([1 / (1 + 0.015 * away / np.sqrt(20 + away)), 1.5 + 0 * away, 1 + 0 * away], axis=1)
    true = np.linalg.norm((seen - there) * weights, axis=1)
    assert level["color_error"]["mean"] == pytest.approx(true.mean(), rel=0.06)
    assert level["silhouette"] == pytest.approx(both.sum() / (met | (np.array([of for of, _ in found]) >= 0)).sum(),
                                                abs=0.003)


@pytest.mark.parametrize("winding", ["one", "any"])
def test_flat_surfaces_do_not_lean(tmp_path, winding):
    corners = np.array([[x, y, 0.0] for y in np.linspace(0, 1, 41) for x in np.linspace(0, 1, 41)])
    a = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 42], axis=1), np.stack([a, a + 42, a + 41], axis=1)])
    if winding == "any":
        faces[::2] = faces[::2, ::-1]
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    low = bisque.Mesh(np.hstack([square, np.zeros((4, 1))]), np.array([[0, 1, 2], [0, 2, 3]]), square * 0.9 + 0.05)
    level = bisque.asset((corners, faces), tmp_path / "sheet.glb", low=low, size=64, maps="normal")["levels"][0]
    # All of it rounded to 128 would be 0.318 degrees.
    assert level["normal_error"]["mean"] < 0.15 and "color_error" not in level
    # Of such a scan both sides are hit; half of the views see the back of the mesh, which does not count.
    assert level["silhouette"] > 0.99 and (level["backs"] > 0.02) is (winding == "any")


def test_a_thread_shows_no_pixel(tmp_path):
    thread = np.array([[0, 0, 0], [1, 0, 0], [1, 1e-7, 0], [0, 1e-7, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    low = bisque.Mesh(*thread, np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]))
    level = bisque.asset(thread, tmp_path / "thread.glb", low=low, size=64, maps="normal")["levels"][0]
    assert level["silhouette"] == 0 and "normal_error" not in level

"""Looks at the page of a tileset in a headless Chromium, and at a tileset of another maker with it. Leaves pictures.

Usage: tiles_page.py FOLDER"""
import base64
import functools
import http.server
import io
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import bisque
import numpy as np
from conftest import sphere
from PIL import Image

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../doors"))
from browser import Browser  # noqa: E402

SECONDS = 120


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def settle(browser):
    """Waits until nothing is loading. Returns what the page tells."""
    for _ in range(10 * SECONDS):
        if browser.js("document.body && document.body.dataset.state") in ("ready", "failed"):
            return browser.js("document.getElementById('told').textContent")
        time.sleep(0.1)
    raise SystemExit("the page does not get ready")


def picture(browser, path):
    data = base64.b64decode(browser.call("Page.captureScreenshot")["data"])
    path.write_bytes(data)
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), int)


def other_tileset(folder, glb):
    """Writes a tileset as other makers have it: spheres, `url`, a tileset inside, and a place on the globe."""
    (folder / "inner.json").write_text(json.dumps({"asset": {"version": "1.0"}, "geometricError": 1, "root": {
        "boundingVolume": {"sphere": [0, 0, 0, 1.1]}, "geometricError": 0, "content": {"url": glb}}}))
    (folder / "outer.json").write_text(json.dumps({"asset": {"version": "1.0"}, "geometricError": 10, "root": {
        "transform": [0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 6378137, 0, 0, 1],
        "boundingVolume": {"box": [0, 0, 0, 1.1, 0, 0, 0, 1.1, 0, 0, 0, 1.1]}, "geometricError": 10,
        "children": [{"boundingVolume": {"sphere": [0, 0, 0, 1.1]}, "geometricError": 5,
                      "content": {"uri": "inner.json"}}]}}))


def main(pictures):
    pictures.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp())
    points, faces = sphere(60, True)
    colors = np.tile(np.uint8([250, 60, 40]), (len(points), 1))
    certificate = bisque.tiles(bisque.Mesh(points, faces, colors=colors), work / "out", tile_triangles=300,
                               triangles=4000, size=128)
    other_tileset(work / "out", "0_1.glb")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=work / "out"))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    page = f"http://127.0.0.1:{server.server_port}/index.html"
    browser = Browser()
    try:
        browser.call("Page.navigate", url=page)
        coarse = settle(browser)
        red = picture(browser, pictures / "tiles_coarse.png")
        assert red[500, 640, 0] > 2 * red[500, 640, 2] and np.ptp(red[5, 640]) < 30, red[500, 640]
        browser.js("document.getElementById('error').value = 0; draw()")
        fine = settle(browser)
        finest = sum(tile["level"] == 2 for tile in certificate["tiles"].values())
        shown = int(fine.split()[0])
        assert int(coarse.split()[0]) < shown and finest / 2 < shown <= finest, (coarse, fine, finest)
        leaves = picture(browser, pictures / "tiles_fine.png")
        inside = np.hypot(*np.mgrid[-150:150, -150:150]) < 140
        seen = leaves[350:650, 490:790][inside]
        assert (seen[:, 0] > 1.5 * seen[:, 2]).all()  # no crack shows the grey behind
        browser.js("document.getElementById('levels').checked = true; draw()")
        levels = picture(browser, pictures / "tiles_levels.png")[500, 640]
        assert levels[1] > levels[0], levels  # the third level is green
        browser.call("Page.navigate", url=page + "?tileset=outer.json")
        other = settle(browser)
        assert other.startswith("1 tile,") and picture(browser, pictures / "tiles_other.png")[500, 640, 0] > 100, other
        assert not browser.problems, browser.problems
        browser.call("Page.navigate", url=page + "?tileset=none.json")
        assert settle(browser).endswith("none.json: 404")
        browser.call("Page.navigate", url=f"file://{work}/out/index.html")
        assert "http.server" in settle(browser)
        print(f"{coarse}; {fine}; the other one: {other}")
    finally:
        browser.close()
        server.shutdown()
        shutil.rmtree(work)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""looks.py - makes the pictures of docs/looks.md from the programs themselves, in docs/looks/.

    looks.py BIN GENERATOR FOLDER    BIN: the folder of the programs; GENERATOR: generate-scan

Each mistake is made on purpose. A picture shows, from left to right, what comes out wrong, what the
option makes of it, and the scan."""
import math
import os
import subprocess
import sys
import tempfile

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../tests/cli"))
import png

SIDE, STEP = 96, 4  # of a picture's panels; pixels of the preview for each of theirs
VASE = ["vase.nvdb", "vase_low.obj"]
# Name, scan and low-poly mesh, options of the wrong bake, options of the right one.
LOOKS = [
    ("turned", VASE, ["--low", "turn=z-up", "--as-is"], []),
    ("units", VASE, ["--low", "scale=0.5", "--as-is"], []),
    ("shifted", VASE, ["--low", "x=0.06", "--as-is"], []),
    ("layers", ["coat.tris", "ball_low.obj"], ["--front", "0.01", "--back", "0.2"], ["--extrude", "0.06"]),
    ("short", VASE, ["--front", "0.002", "--back", "0.002"], []),
    ("facets", ["ball.tris", "ball_low.obj"], ["--scan", "normals=flat"], []),
    ("coarse", ["coarse.nvdb", "vase_low.obj"], [], VASE),
    ("padding", VASE, ["--padding", "0", "--size", "64"], ["--size", "64"]),
    ("colors", VASE, ["--maps", "normal"], []),
]


def ball(path, radius, slices, stacks, uvs, waves=0):
    """Writes a sphere; the scan's radius waves."""
    with open(path, "w") as file:
        for j in range(stacks + 1):
            for i in range(slices + 1):
                a, b = 2 * math.pi * i / slices, math.pi * j / stacks
                n = (math.sin(b) * math.sin(a), -math.cos(b), math.sin(b) * math.cos(a))
                r = radius * (1 + waves * math.sin(9 * a) * math.sin(b) ** 2 * math.sin(8 * b))
                file.write("v %.6f %.6f %.6f\n" % tuple(r * c for c in n))
                if uvs:
                    file.write("vt %.6f %.6f\nvn %.6f %.6f %.6f\n" % (i / slices, j / stacks, *n))
        for j in range(stacks):
            for i in range(slices):
                a = j * (slices + 1) + i + 1
                for c in ((a, a + 1, a + slices + 2), (a, a + slices + 2, a + slices + 1)):
                    file.write("f " + " ".join(f"{k}/{k}/{k}" if uvs else str(k) for k in c) + "\n")


def make_meshes(run, generator):
    subprocess.run([generator, "--triangles", "200000", "--colors", "vase", "-o", "vase.obj"], check=True)
    subprocess.run([generator, "vase-low", "-o", "vase_low.obj"], check=True)
    ball("ball_low.obj", 1, 16, 8, True)
    ball("ball.obj", 1, 60, 30, False, 0.01)
    ball("inner.obj", 0.97, 200, 100, False, 0.01)
    ball("outer.obj", 1.0, 200, 100, False)
    run("bisque-voxelize", "vase.obj", "--resolution", "500", "-o", "vase.nvdb")
    run("bisque-voxelize", "vase.tris", "--resolution", "60", "-o", "coarse.nvdb")
    run("bisque-voxelize", "ball.obj", "-o", "ball.tris", "--scan-normals", "angle")
    run("bisque-voxelize", "inner.obj", "outer.obj", "-o", "coat.tris")


def panels(run, inputs, options):
    """Returns the panels of a preview: the mesh, the mesh with its maps, the scan; small."""
    run("bisque-bake", *inputs, "-o", "<MAP>.png", "--preview", "preview.png", "--view", "count=2,from=30",
        "--size", "256", *options)
    _, _, _, rows = png.read("preview.png")
    return [[[[sum(rows[STEP * y + j][388 * panel + STEP * x + i][k] for j in range(STEP) for i in range(STEP))
               // STEP ** 2 // 4 * 4
               for k in range(3)] for x in range(SIDE)] for y in range(SIDE)] for panel in range(3)]


def write(path, parts):
    png.write(path, 8, [[tuple(c) for part in parts for c in part[y]] for y in range(SIDE)])


def main(programs, generator, folder):
    programs, generator, folder = map(os.path.abspath, (programs, generator, folder))
    os.makedirs(folder, exist_ok=True)

    def run(program, *arguments):
        subprocess.run([os.path.join(programs, program), *arguments], check=True, stdout=subprocess.DEVNULL,
                       stderr=subprocess.DEVNULL)

    with tempfile.TemporaryDirectory() as work:
        os.chdir(work)
        make_meshes(run, generator)
        for name, inputs, wrong, right in LOOKS:
            bad = panels(run, inputs, ["--samples", "1", *wrong])
            good = panels(run, VASE, []) if right == VASE else panels(run, inputs, right)
            write(os.path.join(folder, name + ".png"), [bad[1], good[1], good[2]])
        for green in ("up", "down"):
            run("bisque-bake", *VASE, "-o", f"{green}.png", "--maps", "normal", "--size", "96", "--normal", f"green={green}",
                "--type", "8")
        write(os.path.join(folder, "green.png"),
              [png.read(f"{green}.png")[3] for green in ("up", "down")])


main(*sys.argv[1:])

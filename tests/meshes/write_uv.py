# Writes the files uv.* of this folder: a patch of 6 x 6 squares with texture coordinates. Needs assimp 5.2.5 of Debian 12.
import subprocess

side = 7
points = [(i / 8, (i * j % 3) / 8, -j / 8) for j in range(side) for i in range(side)]
quads = [(j * side + i, j * side + i + 1, (j + 1) * side + i + 1, (j + 1) * side + i)
         for j in range(side - 1) for i in range(side - 1)]
with open("uv.mtl", "w") as out:
    out.write("newmtl stone\nKd 1 1 1\n")
with open("uv.obj", "w") as out:
    out.write("mtllib uv.mtl\no patch\nusemtl stone\n")
    for p in points:
        out.write("v %g %g %g\n" % p)
    for p in points:
        out.write("vt %.9g %.9g\n" % (p[0] / 0.75, -p[2] / 0.75))
    for q in quads:
        out.write("f %s\n" % " ".join("%d/%d" % (v + 1, v + 1) for v in q))
subprocess.run(["assimp", "export", "uv.obj", "uv.assimp.glb"], check=True)

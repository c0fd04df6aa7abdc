# Writes the meshes of this folder. Needs Python 3.11, numpy 2.4.6, trimesh 5.2.0, meshio 5.3.5,
# plyfile 1.1.5, numpy-stl 4.1.1, pymeshlab 2025.7.post1 and open3d 0.20.0 from PyPI.
import meshio
import numpy
import open3d
import plyfile
import pymeshlab
import stl
import trimesh

from patch import colors, points, triangles

with open("plain.obj", "w") as out:
    for p in points:
        out.write("v %g %g %g\n" % tuple(p))
    for t in triangles:
        out.write("f %d %d %d\n" % tuple(t + 1))
with open("colors.obj", "w") as out:
    for p, c in zip(points, colors):
        out.write("v %g %g %g %d %d %d\n" % (*p, *c))
    for t in triangles:
        out.write("f %d %d %d\n" % tuple(t + 1))

mesh = trimesh.Trimesh(points, triangles, process=False)
mesh.export("plain.trimesh.ply", encoding="binary", vertex_normal=False)
mesh.export("plain.trimesh.text.ply", encoding="ascii", vertex_normal=False)
mesh.export("plain.trimesh.stl")
mesh.export("plain.trimesh.text.stl", file_type="stl_ascii")
mesh.visual.vertex_colors = colors
mesh.export("colors.trimesh.ply", encoding="binary", vertex_normal=False)

cells = [("triangle", triangles)]
data = {name: colors[:, i] for i, name in enumerate(("red", "green", "blue"))}
meshio.Mesh(points, cells).write("plain.meshio.ply", binary=True)
meshio.Mesh(points, cells).write("plain.meshio.text.ply", binary=False)
meshio.Mesh(points, cells).write("plain.meshio.stl", binary=True)
meshio.Mesh(points, cells, point_data=data).write("colors.meshio.ply", binary=True)

vertex = numpy.array(
    [(*p, *c) for p, c in zip(points, colors)],
    dtype=[(n, "f8") for n in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")],
)
face = numpy.empty(len(triangles), dtype=[("vertex_indices", "u2", (3,)), ("flag", "i2")])
face["vertex_indices"] = triangles
face["flag"] = 7
elements = [
    plyfile.PlyElement.describe(face, "face"),
    plyfile.PlyElement.describe(vertex, "vertex", comments=["faces come first"]),
]
plyfile.PlyData(elements, byte_order=">").write("colors.plyfile.ply")
plyfile.PlyData(elements, text=True).write("colors.plyfile.text.ply")

solid = stl.mesh.Mesh(numpy.zeros(len(triangles), dtype=stl.mesh.Mesh.dtype))
solid.vectors = points[triangles].astype(numpy.float32)
solid.save("plain.numpy.stl", mode=stl.Mode.BINARY)

# MeshLab gives each vertex a quality. Faces are blue and red by turns.
faces = numpy.array([(i % 2, 0, 1 - i % 2, 1) for i in range(len(triangles))], float)
with open("faces.mtl", "w") as out:
    out.write("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
with open("faces.obj", "w") as out:
    out.write("mtllib faces.mtl\n")
    for p in points:
        out.write("v %g %g %g\n" % tuple(p))
    for t, color in zip(triangles, faces):
        out.write("usemtl %s\n" % ("red" if color[0] else "blue"))
        out.write("f %d %d %d\n" % tuple(t + 1))
rgba = numpy.hstack([colors / 255, numpy.ones((len(colors), 1))])
scene = pymeshlab.MeshSet()
scene.add_mesh(pymeshlab.Mesh(points, triangles, v_color_matrix=rgba))
scene.save_current_mesh("colors.meshlab.ply", save_face_color=False)
scene.save_current_mesh("colors.meshlab.text.ply", binary=False, save_face_color=False)
corners = points[triangles][:, :, :2].reshape(-1, 2)
scene = pymeshlab.MeshSet()
scene.add_mesh(pymeshlab.Mesh(points, triangles, f_color_matrix=faces, w_tex_coords_matrix=corners))
scene.save_current_mesh("faces.meshlab.ply", save_vertex_color=False)
scene.save_current_mesh("plain.meshlab.stl", colormode=True)
scene.save_current_mesh("plain.meshlab.viscam.stl", colormode=False)
scene.save_current_mesh("plain.meshlab.text.stl", binary=False)

# Open3D writes STL files with normals only, and normals of vertices into PLY files if it has them.
solid = open3d.geometry.TriangleMesh(
    open3d.utility.Vector3dVector(points), open3d.utility.Vector3iVector(triangles)
)
open3d.io.write_triangle_mesh("plain.open3d.ply", solid)
open3d.io.write_triangle_mesh("plain.open3d.text.ply", solid, write_ascii=True)
open3d.io.write_triangle_mesh("plain.open3d.glb", solid)
solid.vertex_colors = open3d.utility.Vector3dVector(colors / 255)
open3d.io.write_triangle_mesh("colors.open3d.ply", solid)
open3d.io.write_triangle_mesh("colors.open3d.obj", solid)
solid.compute_triangle_normals()
open3d.io.write_triangle_mesh("plain.open3d.stl", solid)

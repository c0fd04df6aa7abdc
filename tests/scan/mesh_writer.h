/* mesh_writer.h - writes generated meshes as OBJ, PLY (text and binary) or STL (binary).
 *
 * The suffix of the output says which: .obj, .ply, .stl; .big.ply is binary big endian, .text.ply
 * is text. Numbers are rounded to six decimals first, so that all formats have the same values;
 * STL files, and PLY files unless `far` is set, hold them as float32. */
#ifndef SCAN_MESH_WRITER_H
#define SCAN_MESH_WRITER_H

#include "tests/scan/text_writer.h"

enum mesh_output { MESH_OBJ, MESH_PLY_TEXT, MESH_PLY_LITTLE, MESH_PLY_BIG, MESH_STL };

/* What the mesh will have. */
struct mesh_facts {
    uint64_t vertices, faces;
    int colors, normals, texcoords;
    int far; /* positions as doubles: for low-poly meshes and geo-referenced scans */
};

struct mesh_writer {
    struct text_writer text;
    enum mesh_output output;
    struct mesh_facts facts;
    float (*positions)[3]; /* of all vertices, for STL */
    uint64_t vertices;
};

/* A corner of a face. Indices count from 0. */
struct mesh_corner {
    uint64_t vertex, texcoord;
    double uv[2];
};

/* Returns the output of a path's suffix. */
enum mesh_output mesh_output_of(const char *path);

void mesh_open(struct mesh_writer *writer, const char *path, const struct mesh_facts *facts);
/* Appends a vertex. Colour and normal are NULL if the mesh has none. OBJ files get normals later,
 * in a second pass: mesh_normal(). */
void mesh_vertex(struct mesh_writer *writer, const double position[3], const double *color,
                 const double *normal);
/* Do nothing unless the format has lists of texture coordinates and normals of their own. */
void mesh_texcoord(struct mesh_writer *writer, double u, double v);
void mesh_normal(struct mesh_writer *writer, const double normal[3]);
/* Returns whether normals must be given to mesh_normal(), not mesh_vertex(). */
int mesh_normals_apart(const struct mesh_writer *writer);
/* Appends a face. The normal of a corner is that of its vertex. */
void mesh_face(struct mesh_writer *writer, const struct mesh_corner *corners, unsigned count);
void mesh_close(struct mesh_writer *writer);

#endif

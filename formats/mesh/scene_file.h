/* scene_file.h - private to formats/mesh: the file that the program bisque-scene writes, with all
 * meshes that Assimp found in a file. */
#ifndef FMT_MESH_SCENE_FILE_H
#define FMT_MESH_SCENE_FILE_H

#include "base/channels.h"
#include "formats/program/program.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Exit statuses of the program. If it is BSQ_EDATA, its output is a text: what is wrong. */

/* A mesh at a node. */
struct fmt_scene_mesh {
    uint64_t first_vertex, first_face, first_corner;
    uint64_t object; /* place of the node's name, which may be "" */
    uint32_t material;
    uint32_t has_normals, has_texcoords;
    uint32_t padding;
};

struct fmt_scene_material {
    uint64_t name;
    uint64_t texture; /* of the diffuse colour: the file's name as written; UINT64_MAX: none that is
                         in another file */
    float diffuse[3]; /* as written, finite; 0.8 if there is none */
    bool has_diffuse;
    struct bsq_uv uv; /* of the texture */
};

/* The start of the file. The arrays of struct fmt_scene follow in their order. */
struct fmt_scene_head {
    char stamp[48];        /* fmt_program_stamp of the program */
    uint64_t memory_bytes; /* that reading took */
    uint64_t vertex_count, face_count, corner_count, mesh_count, material_count, text_bytes;
    uint64_t short_faces;     /* points and lines, left out */
    uint64_t inner_textures;  /* inside of the file, not read */
    uint64_t turned_textures; /* rotated, or for further texture coordinates, which is ignored */
    uint64_t hidden_colors;   /* meshes with vertex colours beside a texture, which hides them */
    uint32_t has_tangents, has_colors;
};

/* All meshes of a file, at the places of their nodes. Normals and texture coordinates have the
 * numbers of their vertices; they are 0 if a mesh has none. Values are as in the file, finite or
 * not. */
struct fmt_scene {
    const struct fmt_scene_head *head;
    const struct fmt_scene_mesh
        *meshes; /* in the order of the arrays; and one more, at their ends */
    const struct fmt_scene_material *materials;
    const double (*positions)[3];
    const double (*texcoords)[2]; /* the first set; v upwards */
    const uint64_t *corners;
    const float (*normals)[3];
    const float (*colors)[3]; /* not if has_colors is 0. A mesh without has that of its material. */
    const uint32_t *face_sizes;
    const char *texts; /* the names; the last byte is 0 */
};

/* Finds the arrays in the file. Returns false if it is damaged; then *out has no meaning. */
bool fmt_scene_view(const void *file, uint64_t size, struct fmt_scene *out);

/* Sets the matrix of normals of a node's matrix: its inverse transpose, times a positive number.
 * Returns whether the node mirrors. */
bool fmt_invert_for_normals(const double m[3][4], double out[3][3]);

#ifdef __cplusplus
}
#endif
#endif

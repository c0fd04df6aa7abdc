/* scene_module.h - the table of the module bisque-scene.so, which reads meshes of many formats by
 * Assimp. */
#ifndef FMT_MESH_SCENE_MODULE_H
#define FMT_MESH_SCENE_MODULE_H

#include "base/uv.h"
#include "formats/module/module.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A mesh at a node. */
struct fmt_scene_part {
    uint64_t first_vertex, first_face, first_corner;
    uint32_t material;
    bool has_normals, has_texcoords;
    char *object; /* name of the node, which may be ""; NULL only after the last part */
};

struct fmt_scene_material {
    char *name;
    bool has_diffuse;
    float diffuse[3]; /* as written, finite; 0.8 if there is none */
    char *texture;    /* of the diffuse colour: the file's name as written; NULL: none that is in
                         another file */
    struct bsq_uv uv; /* of the texture */
};

/* All meshes of a file, at the places of their nodes. Arrays are from the context's budget; the
 * caller frees them, also after a failure. Normals and texture coordinates have the numbers of
 * their vertices; they are 0 if a mesh has none. Values are as in the file, finite or not. */
struct fmt_scene {
    double (*positions)[3];
    double (*texcoords)[2]; /* the first set; v upwards */
    float (*normals)[3];
    float (*colors)[3]; /* NULL: no mesh has any. A mesh without has the colour of its material. */
    uint32_t *face_sizes;
    uint64_t *corners;
    struct fmt_scene_part *parts; /* in the order of the arrays; and one more, at their ends */
    struct fmt_scene_material *materials;
    uint64_t vertex_count, face_count, corner_count, part_count, material_count;
    uint64_t short_faces;     /* points and lines, left out */
    uint64_t inner_textures;  /* inside of the file, not read */
    uint64_t turned_textures; /* rotated, or for further texture coordinates, which is ignored */
    uint64_t hidden_colors;   /* meshes with vertex colours beside a texture, which hides them */
    bool has_tangents;
};

struct fmt_scene_module {
    struct fmt_module module;
    /* Reads a file. Its name's suffix chooses the format. No other file is opened. Errors:
     * BSQ_EDATA, BSQ_ENOMEM, BSQ_EINTR. */
    int (*read)(const struct fmt_host *host, struct bsq_ctx *ctx, const struct bsq_file *file,
                const char *name, struct fmt_scene *out);
};

#ifdef __cplusplus
}
#endif
#endif

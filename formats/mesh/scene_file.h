/* scene_file.h - private to formats/mesh: what the program bisque-scene writes: struct
 * fmt_scene_head, the materials that Assimp found in a file as MTL text, and its meshes as OBJ
 * text, at the places of their nodes. A usemtl statement has the number of a material, from 0. */
#ifndef FMT_MESH_SCENE_FILE_H
#define FMT_MESH_SCENE_FILE_H

#include "formats/program/program.h"

#ifdef __cplusplus
extern "C" {
#endif

/* If the program's exit status is BSQ_EDATA, its output is a text: what is wrong. */
struct fmt_scene_head {
    char stamp[48];           /* fmt_program_stamp of the program */
    uint64_t memory_bytes;    /* that reading took */
    uint64_t material_bytes;  /* of the MTL text */
    uint64_t inner_textures;  /* inside of the file, not read */
    uint64_t turned_textures; /* rotated, or for further texture coordinates, which is ignored */
    uint64_t hidden_colors;   /* meshes with vertex colours beside a texture, which hides them */
    uint64_t clamped_colors;  /* meshes whose diffuse colour was out of range */
    uint64_t has_tangents;
};

/* Sets the matrix of normals of a node's matrix: its inverse transpose, times a positive number.
 * Returns whether the node mirrors. */
bool fmt_invert_for_normals(const double m[3][4], double out[3][3]);

#ifdef __cplusplus
}
#endif
#endif

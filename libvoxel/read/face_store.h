/* face_store.h - private to the sorter: the scan's faces as compact bytes.
 *
 * Faces are stored in groups of at most FACE_GROUP_FACES faces and FACE_GROUP_CORNERS corners (a
 * larger polygon is a group of its own), each of which can be decoded alone. Triangles take about
 * two bytes (corner_delta_code.h). Corner indices of other faces are differences to the corner
 * before, in 1, 2, 4 or 8 bytes; scans refer to vertices that are near in the file, so that a
 * corner takes about a byte and a half. Encoding is cheap enough to run in the reader's serial
 * step. */
#ifndef VOX_READ_FACE_STORE_H
#define VOX_READ_FACE_STORE_H

#include "formats/mesh/mesh_reader.h"
#include "libvoxel/read/spill_buffer.h"

#define FACE_GROUP_FACES   16384u
#define FACE_GROUP_CORNERS 65536u

enum face_kind { FACE_VERTEX, FACE_TEXCOORD, FACE_NORMAL, FACE_KIND_COUNT };

struct face_group_info {
    uint64_t offset, first_face;
    uint32_t bytes;
    uint32_t face_count, corner_count;
    uint32_t change_count;           /* of the material inside of the group */
    uint32_t first_material;         /* FMT_MESH_NO_MATERIAL: none */
    bool triangles;                  /* all faces have three corners */
    bool has_kind[FACE_KIND_COUNT];  /* stored */
    bool has_index[FACE_KIND_COUNT]; /* and not "none" for all corners */
    uint64_t max[FACE_KIND_COUNT];   /* largest index, where has_index */
};

struct face_store {
    struct bsq_ctx *ctx;
    struct spool bytes;
    struct face_group_info *groups;
    uint64_t group_count, group_capacity;
    uint8_t *scratch; /* encoded group */
    uint64_t scratch_capacity;
    uint64_t face_count, corner_count;
    uint32_t max_faces, max_corners, max_triangles, max_changes, max_bytes; /* of a group */
    uint32_t max_size;                                                      /* of a face */
    bool lacks_texcoord;                                                    /* a corner has none */
};

struct face_change {
    uint32_t face; /* of the group, from which on this material holds */
    uint32_t material;
};

/* A decoded group. Absent kinds are NULL; sizes are NULL where all faces are triangles. */
struct face_group {
    uint64_t first_face;
    uint32_t face_count, corner_count, change_count, first_material;
    const uint32_t *sizes;
    const uint64_t *indices[FACE_KIND_COUNT]; /* FMT_MESH_NONE: the corner has none */
    const struct face_change *changes;
};

void vox_face_store_init(struct face_store *store, struct bsq_ctx *ctx, const char *beside);
void vox_face_store_free(struct face_store *store);

/* Most bytes of memory that vox_face_store_append() may add to the spool for this block. */
uint64_t vox_face_store_append_cost(const struct face_store *store,
                                    const struct fmt_mesh_block *block);
int vox_face_store_append(struct face_store *store, const struct fmt_mesh_block *block);
/* Call once after the last append. */
int vox_face_store_finish(struct face_store *store);

/* Bytes that decoding of any group needs. */
uint64_t vox_face_store_decode_bytes(const struct face_store *store);
/* Decodes group `index`; `room` has vox_face_store_decode_bytes() bytes, 8-byte aligned, and is
 * what *out points into. Thread-safe for distinct rooms. */
int vox_face_store_decode(const struct face_store *store, uint64_t index, void *room,
                          struct face_group *out);

#endif

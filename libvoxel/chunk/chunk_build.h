/* chunk_build.h - encodes sorted tuples as a chunk. */
#ifndef VOX_CHUNK_CHUNK_BUILD_H
#define VOX_CHUNK_CHUNK_BUILD_H

#include "libvoxel/chunk/sort_batch.h"

/* An entry of the cache of recent corners: the corner's bytes, at most 16, and its vertex. */
struct corner_tag {
    uint64_t low, high;
};
struct corner_cache {
    struct corner_tag tag;
    uint32_t number;
};

/* Buffers and result of building one chunk after the other. */
struct chunk_builder {
    struct bsq_ctx *ctx;
    const struct scan *scan;
    const struct tuple_layout *layout;
    float (*positions)[3];
    uint32_t *normals;
    float (*texcoords)[2];
    uint32_t *colors, *fine_colors;
    uint32_t (*triangles)[3];
    uint32_t *materials;
    uint32_t vertex_count;
    uint32_t *table; /* hash table of vertices */
    uint32_t table_bits;
    struct corner_cache *cache; /* direct-mapped; for tuples that are not plain */
    uint64_t *plain;            /* the same for plain tuples: number << 32 | index */
    /* Result. */
    void *encoded;
    uint64_t encoded_bytes;
    struct fmt_tris_chunk_info info;
};

/* Returns the memory of one builder in bytes. */
uint64_t vox_chunk_builder_bytes(uint32_t attributes);
/* Initialises a builder. Free it with vox_chunk_builder_free(), also after failure. */
int vox_chunk_builder_init(struct chunk_builder *builder, const struct scan *scan,
                           const struct tuple_layout *layout);
void vox_chunk_builder_free(struct chunk_builder *builder);

/* Builds and encodes a chunk of entries[0 .. count). Vertices are numbered in the order of first
 * use. */
int vox_chunk_builder_run(struct chunk_builder *builder, const uint8_t *tuples,
                          const struct entry *entries, uint32_t count);

#endif

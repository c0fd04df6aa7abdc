/* normals_run.h - the making of one section of normals, for the sources of this folder. */
#ifndef VOX_NORMALS_NORMALS_RUN_H
#define VOX_NORMALS_NORMALS_RUN_H

#include <pthread.h>

#include "base/spill.h"
#include "libvoxel/normals/normals.h"
#include "libvoxel/normals/rings.h"

/* A corner at a vertex whose triangles are not all in its chunk, with its triangle. The records of
 * a position are in one bucket, in the order of the file. */
struct open_corner {
    float triangle[3][3];
    uint32_t chunk;
    uint32_t vertex; /* of the chunk; and the bits below */
};
enum { OPEN_CORNER_SHIFT = 28, OPEN_VERTEX_MASK = (1 << OPEN_CORNER_SHIFT) - 1 };
#define OPEN_ASKS                                                                                  \
    (1u << 30) /* the first record of the vertex; bits 28 and 29: which corner it is */

/* The normal of a vertex that was found after its chunk was gone through; or a crease. */
struct normals_answer {
    uint32_t chunk, vertex; /* ANSWER_CREASE is set if there is a second side */
    uint64_t first, second;
};
#define ANSWER_CREASE (1u << 31)

enum { NORMALS_RINGS = 65536 };

struct normals_run {
    struct bsq_ctx *ctx;
    struct fmt_tris_writer *writer;
    const struct fmt_tris_file *file;
    const struct fmt_tris_chunk_info *infos;
    enum bsq_scan_normals weights;
    uint64_t chunk_count;
    uint32_t vertices, triangles; /* of the largest chunks */
    struct bsq_spill corners;     /* of struct open_corner, by position */
    struct bsq_spill answers;     /* of struct normals_answer, by chunk */
    uint32_t answer_chunks;       /* chunks of a bucket of answers */
    pthread_mutex_t lock;         /* of the answers */
    /* For one-rings up to the number of vertices, and up to NORMALS_RINGS: 0, 1, 2, ...; and random
     * numbers. */
    uint32_t *own_rings;
    uint64_t *numbers;
};

/* normals_chunk.c: goes through all chunks: writes the normals of their closed vertices, and fills
 * both buckets. */
int vox_normals_visit_chunks(struct normals_run *run);
/* normals_open.c: sums what open corners say, and adds the answers. */
int vox_normals_join_corners(struct normals_run *run);

/* Produces the chunks of a pipeline, which are its sequence numbers. */
int vox_normals_produce(void *run, void *slot, uint64_t chunk);
/* Adds answers of one chunk. */
int vox_normals_answer(struct normals_run *run, const struct normals_answer *answer);

/* Gives an array of `count` items its place in a block of memory, and adds its bytes to *at. With
 * NULL as memory it returns NULL: then *at is the size of the block that all arrays need. */
static inline void *normals_place(uint8_t *memory, uint64_t *at, uint64_t count, uint64_t size)
{
    void *to = memory ? memory + *at : NULL;
    *at += bsq_align_up(count * size, BSQ_ALIGNMENT);
    return to;
}

/* Does the same for the arrays of one-rings. */
static inline void normals_place_rings(uint8_t *memory, uint64_t *at, uint64_t rings,
                                       uint64_t creases, struct vox_rings *out)
{
    out->sums = normals_place(memory, at, rings * BSQ_RING_ROWS, sizeof *out->sums);
    out->units = normals_place(memory, at, rings, sizeof *out->units);
    out->crease_of = normals_place(memory, at, rings, sizeof *out->crease_of);
    out->crease_rings = normals_place(memory, at, creases, sizeof *out->crease_rings);
    out->creases = normals_place(memory, at, creases, sizeof *out->creases);
    out->firsts = normals_place(memory, at, creases * BSQ_RING_ROWS, sizeof *out->firsts);
    out->seconds = normals_place(memory, at, creases * BSQ_RING_ROWS, sizeof *out->seconds);
    out->spreads = normals_place(memory, at, creases * BSQ_RING_ROWS, sizeof *out->spreads);
}

/* Returns the bucket of a position among `count`. */
static inline uint32_t normals_bucket(uint32_t hash, uint32_t count)
{
    return (uint32_t)((uint64_t)hash * count >> 32);
}

#endif

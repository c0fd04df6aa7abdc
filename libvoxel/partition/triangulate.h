/* triangulate.h - turns the faces of a batch into triangles, delta coded and grouped by bucket.
 *
 * Works on one batch of faces at a time. It needs the positions of first corners and of polygons,
 * or the buckets of their vertices, so batches can be triangulated on all threads. */
#ifndef VOX_PARTITION_TRIANGULATE_H
#define VOX_PARTITION_TRIANGULATE_H

#include "libvoxel/partition/morton.h"
#include "libvoxel/partition/tuple_runs.h"
#include "libvoxel/partition/vertex_buckets.h"

/* ---- batches ---- */

/* What all batches of a scan have in common. */
struct triangulation {
    const struct scan *scan;
    struct morton_cube cube;
    uint32_t levels; /* the first 3 * levels bits of a key name a bucket */
    const struct vertex_buckets *vertex_buckets; /* set if positions are in a file */
};

/* The runs that one batch adds to one bucket. */
struct bucket_runs {
    uint32_t bucket, triangles;
    uint64_t offset, bytes; /* in `bytes` of the triangulator */
};

/* Buffers and result of triangulating one batch after the other. */
struct triangulator {
    struct bsq_ctx *ctx;
    const struct triangulation *rules;
    /* Result. */
    struct bucket_runs *runs;
    uint32_t run_count;
    uint8_t *bytes;
    uint64_t triangles;
    /* Buffers; capacities in elements. */
    uint64_t run_capacity, bytes_capacity, corner_capacity, bucket_capacity, material_capacity,
        order_capacity;
    uint32_t (*corners)[3]; /* of triangles: numbers in the batch; if there are polygons */
    uint16_t *buckets;      /* of triangles */
    uint32_t *materials;    /* of triangles, if they may have different ones */
    uint32_t *order;        /* triangles, sorted by bucket */
    uint32_t *counts;       /* of triangles in each bucket; zero between batches */
    uint32_t skipped_plain; /* batches to come for which the plain path is not tried */
    /* For the largest polygon. */
    double (*polygon)[3];
    uint32_t *polygon_triangles;
    uint8_t *polygon_scratch;
    uint64_t polygon_capacity[3];
    struct position_pages *pages; /* if positions are in a file and there are polygons */
};

/* Initialises a triangulator. Free it with vox_triangulator_free(), also after failure. */
int vox_triangulator_init(struct triangulator *t, struct bsq_ctx *ctx,
                          const struct triangulation *rules);
void vox_triangulator_free(struct triangulator *t);

/* Triangulates a batch whose indices are in range. max_size: corners of its largest face. Errors:
 * BSQ_ENOMEM, BSQ_EIO, BSQ_EINTR. */
int vox_triangulate_batch(struct triangulator *t, const struct fmt_mesh_batch *batch,
                          uint32_t max_size);

#endif

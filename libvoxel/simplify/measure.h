/* measure.h - the steps of measuring a low-poly mesh, which measure.c puts together. */
#ifndef VOX_SIMPLIFY_MEASURE_H
#define VOX_SIMPLIFY_MEASURE_H

#include <stdatomic.h>

#include "formats/chunks/tris.h"
#include "libvoxel/simplify/bound.h"
#include "libvoxel/simplify/cover.h"
#include "libvoxel/simplify/mesh.h"
#include "libvoxel/voxel.h"

/* Of the histogram: sixteen steps in each octave of squares of distances, for all doubles that
 * squares of floats may be. */
enum { VOX_BINS_FIRST = (1023 - 300) * 16, VOX_BINS = 600 * 16 };

struct vox_sums {
    double weight, distance, square; /* weighted sums */
    double bins[VOX_BINS];           /* weights by square */
};

/* What is known of the vertices of a chunk. */
struct vox_chunk_vertices {
    double *squares, *weights;
    uint32_t *closest; /* triangles of the mesh */
    uint64_t *blocks;
};

/* Boxes of space with distances of their own. */
struct vox_boxes {
    struct vox_measured_box *list; /* the caller's */
    uint32_t count;
    const double *origin;   /* of the scan */
    double slack;           /* for rounded coordinates */
    _Atomic uint64_t *most; /* bits of the largest distance of the scan in each box */
};

struct vox_measuring {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    const struct vox_mesh *mesh;
    uint64_t chunk_bytes; /* most that a chunk takes in memory, with what is known of it */
    double diagonal;
    double limit;            /* of distances, if triangles are marked */
    _Atomic uint8_t *marks;  /* NULL, or of triangles of the mesh: see vox_measure() */
    double reach;            /* square root of a mesh's triangle's area, in the mean */
    double guess;            /* distance of a vertex of the scan that is farther than most */
    struct vox_closest tree; /* of the mesh */
    struct vox_cover cover;
    double *bounds; /* of triangles of the mesh; INFINITY: not known */
    struct vox_sums *from_scan, *from_mesh;
    struct vox_bound scan, low; /* of the scan's points, and the mesh's */
    struct vox_boxes boxes;
};

/* Loads a chunk. The caller frees *scratch, on failure too. */
int vox_load_chunk(const struct vox_measuring *m, uint64_t index, void **scratch,
                   struct fmt_tris_chunk *chunk);
/* Calls `fn` for each chunk, on as many threads as memory has space for chunks. */
int vox_visit_chunks(const struct vox_measuring *m,
                     int (*fn)(void *arg, uint64_t index, unsigned worker), void *arg);

static inline double vox_longest_edge(const float *const corners[3])
{
    double longest = 0;
    for (int k = 0; k < 3; k++) {
        const double square = vox_square_between(corners[k], corners[(k + 1) % 3]);
        longest = square > longest ? square : longest;
    }
    return sqrt(longest);
}

/* Begins the bound of something whose distances are only compared with the limit. */
static inline struct vox_bound vox_limit_bound(const struct vox_measuring *m)
{
    return (struct vox_bound){.low = fmin(m->limit / 1.0100001, m->limit - m->low.slack),
                              .slack = m->low.slack,
                              .enough = m->limit};
}

/* Adds a distance to sums. */
static inline void vox_add_distance(struct vox_sums *sums, double square, double weight)
{
    union {
        double value;
        uint64_t bits;
    } key = {square};
    const int64_t bin = (int64_t)(key.bits >> 48) - VOX_BINS_FIRST;
    sums->weight += weight;
    sums->distance += weight * sqrt(square);
    sums->square += weight * square;
    sums->bins[bin < 0 ? 0 : bin >= VOX_BINS ? VOX_BINS - 1 : bin] += weight;
}

/* Bounds a triangle of a chunk by the triangles that are closest to its corners; what is not above
 * `allowed` is not refined. */
double vox_bound_by_corners(const struct vox_measuring *m, const float *const corners[3],
                            const uint32_t *triangle, const struct vox_chunk_vertices *of,
                            double allowed);

/* boxes.c: prepares the distances of boxes, which stay the caller's; the caller frees
 * m->boxes.most. Errors: BSQ_ENOMEM. */
int vox_boxes_begin(struct vox_measuring *m, struct vox_measured_box *list, uint32_t count);
/* Raises the distances of boxes by the triangles of a chunk that touch them. Thread-safe; the order
 * of chunks does not matter. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_boxes_add_chunk(const struct vox_measuring *m, uint64_t index,
                        const struct fmt_tris_chunk *chunk, const struct vox_chunk_vertices *of);
/* Sets the distances of all boxes, those of the mesh by m->bounds. */
void vox_boxes_end(struct vox_measuring *m);

/* samples.c: measures the distances of points spread over the mesh, and of its vertices, from the
 * scan. Sets m->from_mesh, and m->low to the largest one; lowers m->bounds by them. */
int vox_measure_samples(struct vox_measuring *m);

/* resolve.c: bounds the triangles of the mesh whose m->bounds are higher than m->low allows, by the
 * scan around them. Sets m->low.high. */
int vox_resolve_bounds(struct vox_measuring *m);

#endif

/* measure.h - the steps of measuring a low-poly mesh, which measure.c puts together. */
#ifndef VOX_SIMPLIFY_MEASURE_H
#define VOX_SIMPLIFY_MEASURE_H

#include <stdatomic.h>

#include "formats/chunks/tris.h"
#include "libvoxel/simplify/bound.h"
#include "libvoxel/simplify/cover.h"
#include "libvoxel/simplify/groups.h"
#include "libvoxel/voxel.h"

/* Of the histogram: sixteen steps in each octave of squares of distances. Below the last octaves,
 * distances are smaller than rounded coordinates tell. */
enum { VOX_BINS = 64 * 16 };

/* How far away triangles of other regions matter, in `reach`. */
enum { VOX_NEAR_REACHES = 16 };

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

/* What is known of the triangles that touch a box, and of the points in it. */
struct vox_box_sums {
    uint32_t number; /* of the box */
    struct vox_bound bound;
    struct vox_sums sums;
};

/* Boxes of space with distances of their own. */
struct vox_boxes {
    struct vox_measured_box *list; /* the caller's */
    uint32_t count;
    const double *origin;                       /* of the scan */
    double slack;                               /* for rounded coordinates */
    struct vox_box_sums *from_scan, *from_mesh; /* of all boxes */
};

struct vox_measuring {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    const struct vox_mesh *mesh; /* all of it, or what is near a region */
    const struct vox_region *region;
    float near_low[3], near_high[3]; /* around the triangles of the region, and farther */
    double area;                     /* of the whole mesh */
    uint64_t chunk_bytes; /* most that a chunk takes in memory, with what is known of it */
    double diagonal;
    double limit;            /* of distances, if triangles are marked */
    _Atomic uint8_t *marks;  /* NULL, or of triangles of the mesh: see vox_measure() */
    double reach;            /* square root of a mesh's triangle's area, in the mean */
    double guess;            /* distance of a vertex of the scan that is farther than most */
    struct vox_closest tree; /* of the mesh */
    struct vox_cover cover;
    double *bounds;    /* of triangles of the mesh; INFINITY: not known */
    int64_t first_bin; /* of histograms: the first bits of its squares */
    struct vox_sums *from_scan, *from_mesh;
    struct vox_bound scan, low; /* of the scan's points, and the mesh's */
    struct vox_boxes boxes;
};

/* Returns whether the middle of a chunk is in the region. */
static inline bool vox_has_chunk(const struct vox_measuring *m, uint64_t index)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    float middle[3];
    for (int k = 0; k < 3; k++)
        middle[k] = 0.5F * (info->bounds_min[k] + info->bounds_max[k]);
    return vox_region_has(m->region, middle);
}

/* Sets the box around three corners. */
static inline void vox_bound_corners(const float *const corners[3], float low[3], float high[3])
{
    for (int k = 0; k < 3; k++) {
        low[k] = fminf(corners[0][k], fminf(corners[1][k], corners[2][k]));
        high[k] = fmaxf(corners[0][k], fmaxf(corners[1][k], corners[2][k]));
    }
}

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
static inline void vox_add_distance(const struct vox_measuring *m, struct vox_sums *sums,
                                    double square, double weight)
{
    union {
        double value;
        uint64_t bits;
    } key = {square};
    const int64_t bin = (int64_t)(key.bits >> 48) - m->first_bin;
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

/* Returns the square root of a triangle's area, in the mean. */
double vox_mean_reach(const struct vox_mesh *mesh);
/* Measures the chunks of a region, and the triangles of the mesh that it has: owned, of each; NULL:
 * all. Errors: those of loading chunks, BSQ_ENOMEM, BSQ_EINTR. */
int vox_measure_region(struct vox_measuring *m, const bool *owned);

/* measure_parts.c: leaves of a chunk, in its scratch, the triangles that the region has, and their
 * vertices. Errors: BSQ_ENOMEM. */
int vox_keep_own(const struct vox_measuring *m, uint64_t index, struct fmt_tris_chunk *chunk);
/* Sets the box of what is near the region: what it has, and what is around it by this much. Errors:
 * those of loading chunks, BSQ_ENOMEM. */
int vox_surround_region(struct vox_measuring *m, double farther);
/* Measures in regions of about `at_once` triangles of the mesh. Errors: those of
 * vox_measure_region(). */
int vox_measure_parts(struct vox_measuring *m, uint32_t at_once);

/* boxes.c: prepares the distances of boxes, which stay the caller's; the caller frees
 * m->boxes.from_scan and from_mesh. Errors: BSQ_ENOMEM. */
int vox_boxes_begin(struct vox_measuring *m, struct vox_measured_box *list, uint32_t count);
/* Sets *list to the boxes that a chunk touches, NULL if there is none. The caller frees it. Errors:
 * BSQ_ENOMEM. */
int vox_boxes_touched(const struct vox_measuring *m, uint64_t index, struct vox_box_sums **list,
                      uint32_t *count);
/* Adds the distance of a point to boxes of a list, if it is in them. */
void vox_boxes_add_point(const struct vox_measuring *m, const double point[3], double square,
                         double weight, struct vox_box_sums *list, uint32_t count);
/* Bounds the triangles of a chunk for the boxes of a list that they touch. Errors: BSQ_EINTR. */
int vox_boxes_add_triangles(const struct vox_measuring *m, const struct fmt_tris_chunk *chunk,
                            const struct vox_chunk_vertices *of, struct vox_box_sums *list,
                            uint32_t count);
/* Adds what is known of boxes by a chunk. */
void vox_boxes_add(struct vox_measuring *m, const struct vox_box_sums *list, uint32_t count);
/* Bounds the triangles of the mesh for all boxes by m->bounds. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_boxes_add_mesh(struct vox_measuring *m);
/* Sets the boxes' distances. */
void vox_boxes_end(const struct vox_measuring *m);

/* Adds sums to others. */
void vox_sums_add(struct vox_sums *sums, const struct vox_sums *other);
/* Turns sums and a bound into figures. */
void vox_summarize(const struct vox_measuring *m, const struct vox_sums *sums,
                   const struct vox_bound *bound, struct vox_distances *out);

/* samples.c: measures the distances of points spread over the mesh, and of its vertices, from the
 * scan. Adds those in the region to m->from_mesh, and raises m->low to the largest one; lowers
 * m->bounds by them. */
int vox_measure_samples(struct vox_measuring *m);

/* resolve.c: bounds the triangles of the mesh whose m->bounds are higher than m->low allows, by the
 * scan around them. Raises m->low.high. */
int vox_resolve_bounds(struct vox_measuring *m);

#endif

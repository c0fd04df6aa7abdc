/* triangulate.h - private to the sorter: faces become triangles, coded and collected by cell.
 *
 * Works on one group of faces at a time and needs nothing but the positions of its triangles' first
 * corners and of all corners of polygons, or the cells of these, so that groups can be split on all
 * threads. */
#ifndef VOX_PARTITION_TRIANGULATE_H
#define VOX_PARTITION_TRIANGULATE_H

#include "libvoxel/partition/morton.h"
#include "libvoxel/partition/record_runs.h"
#include "libvoxel/partition/used_vertices.h"
#include "libvoxel/partition/vertex_buckets.h"

/* What all groups of a scan have in common. */
struct split_plan {
    const struct scan *scan;
    struct morton_cube cube;
    uint32_t levels; /* cells are named by the first 3 * levels bits of the key */
    const struct record_layout *values;      /* corners are coded by value; NULL: by index */
    const struct vertex_cells *vertex_cells; /* where positions are neither in memory nor values:
                                                polygons become fans then */
    uint64_t fan_bytes; /* what a group with fans may take in a splitter where it is not usual */
    used_word *used;    /* of vertices that faces refer to; NULL where records will tell */
};

/* The runs of one cell from one group. */
struct split_piece {
    uint32_t cell, triangles;
    uint32_t first_link, links; /* in the splitter's sorted links; of plain groups 0 */
    uint64_t offset, bytes;     /* in the splitter's bytes */
};

/* The triangle belongs to the fan of the one before. */
#define SPLIT_CONTINUES (1u << 31)

/* Some triangles of the group one behind the other in one cell. */
struct split_link {
    uint32_t cell, first, count, material;
};

struct splitter {
    struct bsq_ctx *ctx;
    const struct split_plan *plan;
    /* Results. */
    struct split_piece *pieces;
    uint32_t piece_count;
    uint8_t *bytes;
    uint64_t triangles; /* in the pieces: fans are in several */
    bool gave_up; /* a group failed without an error, as its polygons are in too many cells for fans
                   */
    /* Buffers; capacities in elements. */
    uint64_t piece_capacity, bytes_capacity, corners_capacity, link_capacity, sorted_capacity;
    uint32_t (
        *corners)[3];    /* of the triangles, numbers in the group; SPLIT_CONTINUES in the first */
    uint32_t *fan_cells; /* of the largest polygon */
    uint64_t fan_capacity;
    struct split_link *links;
    uint32_t link_count;
    uint32_t groups_without_order; /* the next ones are taken for such */
    struct split_link *sorted;     /* the links by cell */
    uint32_t *cell_pieces;         /* for each cell its piece; UINT32_MAX between groups */
    /* Of the largest polygon. */
    double (*polygon)[3];
    uint32_t *polygon_triangles, *polygon_scratch;
    uint64_t polygon_capacity[3];
};

/* Bytes that splitting groups of at most this size takes, as a rule. */
uint64_t vox_triangulator_bytes(const struct split_plan *plan, uint64_t triangles,
                                uint32_t max_size);
int vox_triangulator_init(struct splitter *splitter, struct bsq_ctx *ctx,
                          const struct split_plan *plan);
void vox_triangulator_free(struct splitter *splitter);

/* Polygons of the group can become fans: they are not too large, and their corners have texture
 * coordinates, or lack them, all alike. lacks_texcoord: some corner of the group may lack what
 * others have. */
bool vox_triangulate_makes_fans(uint32_t max_size, bool lacks_texcoord);

/* Splits a group; `values` are its corners', NULL where these are coded by index. max_size: of its
 * largest face. */
int vox_triangulate_group(struct splitter *splitter, const struct face_group *group,
                          const struct corner_values *values, uint32_t max_size);

#endif

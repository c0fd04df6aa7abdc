/* nvdb.h - the voxel grid: a NanoVDB file (version 32.4.2) with Bisque's channels as blind data.
 * FORMATS.md has the bytes. The writer streams; the reader maps the file and uses it in place. */
#ifndef FMT_GRID_NVDB_H
#define FMT_GRID_NVDB_H

#include "base/output.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One surface record. A voxel has one, or two where sheets of opposite orientation (a thin wall)
 * share it. All packed as in the file. */
struct fmt_nvdb_record {
    uint32_t normal; /* octahedral 2 x 16, mean of area-weighted normals */
    uint32_t plane;  /* bits 0-15: signed offset d of the plane n.(x - centre) = d in voxels, d *
                        32767;  16-23: coverage |sum area n'| / sum area * 255, with n' = n |n .
                        facet's normal|; 24: has a second record;  25: shaded, the normal does not go
                        with the plane: it is interpolated over a facet;  26-28: grain, how much of
                        what planes say is of single triangles */
    uint32_t color;  /* RGBA8 sRGB, R in the low byte; 0 where the scan has no colour */
};
#define FMT_NVDB_PLANE_SECOND (1u << 24)
#define FMT_NVDB_PLANE_SHADED (1u << 25)
enum { FMT_NVDB_GRAIN_SHIFT = 26, FMT_NVDB_GRAIN_MAX = 7 };

enum fmt_nvdb_type { FMT_NVDB_MASK = 8, FMT_NVDB_ONINDEX = 20 }; /* NanoVDB's GridType numbers */

struct fmt_nvdb_info {
    enum fmt_nvdb_type type;
    double voxel_size;     /* world units */
    double translation[3]; /* world position of index (0, 0, 0), the centre of that voxel */
    bool has_color;
    uint64_t source_triangles;       /* of the scan */
    double scan_min[3], scan_max[3]; /* world bounds of the scan's triangles */
};

/* ---- writing ---- */
struct fmt_nvdb_writer;

/* Starts a grid file. Node and channel sections go to temporary files beside the output, and are
 * joined at the end. */
int fmt_nvdb_create(struct bsq_ctx *ctx, const char *path, const struct fmt_nvdb_info *info,
                    struct fmt_nvdb_writer **out);

/* One 128^3 region (a lower node) with its leaves, or a part of one: calls with the same origin,
 * one after the other, add to the same region, leaf numbers ascending across them. Regions must
 * come in NanoVDB's order: by root tile (4096^3) in the order of its key (x, then y, then z of
 * origin / 4096 as 21-bit unsigned numbers), inside it by x, y, z of the region. origin: index of
 * the region's first voxel, a multiple of 128. leaf_ids: ascending, (x << 8 | y << 4 | z) of each
 * leaf in the region, each with at least one voxel. masks: eight 64-bit words a leaf; bit (x << 6 |
 * y << 3 | z) of a voxel in word x. records: one per voxel in the order of leaves and bits. second:
 * the second records of those voxels whose plane has FMT_NVDB_PLANE_SECOND, in the same order. Not
 * thread-safe. */
struct fmt_nvdb_region {
    int32_t origin[3];
    uint32_t leaf_count;
    const uint16_t *leaf_ids;
    const uint64_t (*masks)[8];
    uint64_t record_count, second_count;
    const struct fmt_nvdb_record *records;
    const struct fmt_nvdb_record *second;
};
int fmt_nvdb_append(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region);

struct fmt_nvdb_totals {
    uint64_t voxels, second_records, leaves, lowers, uppers, file_bytes;
};
/* Joins the sections, writes the headers and checksums, syncs, renames; frees the writer. Works on
 * the context's threads. A grid without voxels is BSQ_EDATA. */
int fmt_nvdb_commit(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals);
void fmt_nvdb_discard(struct fmt_nvdb_writer *writer); /* NULL is allowed */

/* ---- reading ---- */

/* Byte sizes of NanoVDB 32.4.2 nodes of a Mask or OnIndex grid. */
enum {
    FMT_NVDB_GRID_OFFSET = 224, /* of the grid in the file */
    FMT_NVDB_LEAF_BYTES = 96
};

/* A mapped grid. All pointers are into the map, valid until fmt_nvdb_close(). Arrays of nodes are
 * contiguous; node offsets inside were checked on opening. */
struct fmt_nvdb_grid {
    struct bsq_map map;
    struct fmt_nvdb_info info;
    const uint8_t *grid; /* GridData; offsets below are from here */
    uint64_t grid_bytes;
    const uint8_t *root;  /* RootData */
    const uint8_t *tiles; /* 32 bytes each, sorted by key, as many as uppers: u64 key, i64 offset of
                             the child from root */
    uint32_t tile_count;
    const uint8_t *uppers, *lowers, *leaves;
    uint32_t upper_count, lower_count, leaf_count;
    uint32_t upper_bytes, lower_bytes;  /* size of one node */
    int32_t index_min[3], index_max[3]; /* of active voxels, inclusive */
    uint64_t voxel_count;    /* active voxels; value index 0 is the background, 1.. the voxels */
    uint64_t record_count;   /* 1 + voxel_count + second records: length of the channels */
    const uint32_t *normals; /* channels: see struct fmt_nvdb_record */
    const uint32_t *planes;
    const uint32_t *colors; /* NULL when the grid has none */
    /* Where second records are: word i of value indices 32 i .. 32 i + 31 holds {bits, rank}; the
     * second record of value index v is 1 + voxel_count + rank + popcount(bits below v & 31). */
    const uint32_t (*seconds)[2];
};

/* Maps and checks a grid: magic, version, type, sizes, every node offset, mask and prefix sum that
 * a traversal follows, so that no later access can leave the map. Reads all nodes once, on all
 * threads; channels are not touched. Errors: BSQ_ENOINPUT, BSQ_EDATA naming what is wrong. */
int fmt_nvdb_open(struct bsq_ctx *ctx, const char *path, struct fmt_nvdb_grid *out);
void fmt_nvdb_close(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid);
/* Verifies the whole file: the checksums of its sections, that padding is zero, and that every
 * record is one that a writer may write (FORMATS.md, "Channels"). Errors: BSQ_EDATA naming the
 * section or the record. */
int fmt_nvdb_verify(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

/* Value index of the voxel at index coordinates, 0 where it is not active. */
uint64_t fmt_nvdb_find(const struct fmt_nvdb_grid *grid, const int32_t ijk[3]);
/* The record with this number (1 .. record_count - 1). */
struct fmt_nvdb_record fmt_nvdb_get(const struct fmt_nvdb_grid *grid, uint64_t index);
/* Number of the second record of the voxel with value index v, 0 where it has none. */
uint64_t fmt_nvdb_second(const struct fmt_nvdb_grid *grid, uint64_t v);

#ifdef __cplusplus
}
#endif
#endif

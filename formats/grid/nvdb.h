/* nvdb.h - the grid file: a NanoVDB file with Bisque's channels as blind data.
 *
 * The writer takes regions of voxels in the file's order and streams them. The reader maps a file
 * and gives its nodes and channels in place; a grid can also be exported as an OpenVDB file. The
 * bytes are in FORMATS.md. */
#ifndef FMT_GRID_NVDB_H
#define FMT_GRID_NVDB_H

#include "formats/material/channels.h"
#include "base/output.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A surface record, packed as in the file. A voxel has one, or two if surfaces of opposite
 * orientation (the sides of a thin wall) share it. Bits of `plane`:
 *
 *    0-15  d * 32767, signed; the plane is n . (x - voxel centre) = d, with d in voxels, at most
 *          0.87, which is half a voxel's diagonal
 *   16-23  coverage: 255 |sum of area * n'| / sum of area, with n' = n |n . normal of the facet|
 *      24  the voxel has a second record
 *      25  the normal is inconsistent with the plane: it is interpolated over a facet
 *   26-28  facet-noise weight: how much of the planes' differences is due to single triangles */
struct fmt_nvdb_record {
    uint32_t normal; /* octahedral 2 x 16 bits: mean of area-weighted normals */
    uint32_t plane;
    uint32_t color; /* RGBA8 sRGB, R in the low byte; 0 if the high-poly mesh has no colour */
    uint32_t id;    /* RGBA8, see formats/material/channels.h; 0 if the grid has no ids */
};
#define FMT_NVDB_PLANE_SECOND       (1u << 24)
#define FMT_NVDB_PLANE_INCONSISTENT (1u << 25)
enum { FMT_NVDB_FACET_NOISE_SHIFT = 26, FMT_NVDB_FACET_NOISE_MAX = 7 };
enum { FMT_NVDB_PLANE_MAX = 28507 }; /* greatest |d| * 32767 */

struct fmt_nvdb_info {
    double voxel_size;     /* world units */
    double translation[3]; /* world position of the centre of voxel (0, 0, 0) */
    bool has_color;
    enum fmt_ids ids;
    const char *channels; /* further channels: a list of names (formats/material/channels.h); NULL:
                             none. Only for writing; a grid that was read has `channel_list` */
    uint64_t source_triangles;       /* of the high-poly mesh */
    double scan_min[3], scan_max[3]; /* world bounds of the high-poly mesh */
};

/* Recognise a file by its first 8 bytes: as NanoVDB (of either byte order), as OpenVDB. */
bool fmt_nvdb_recognise(const char first[8]);
bool fmt_vdb_recognise(const char first[8]);

/* Version of the trailer. */
enum {
    FMT_NVDB_TRAILER_VERSION = 2,
    FMT_NVDB_TRAILER_VERSION_IDS = 3,     /* of grids with ids */
    FMT_NVDB_TRAILER_VERSION_CHANNELS = 4 /* of grids with further channels */
};

/* ---- writing ---- */
struct fmt_nvdb_writer;

/* Starts a grid file. Nodes and channels go to a temporary file beside the output until the commit.
 * Errors: BSQ_EUSAGE for a voxel size that is not positive; BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int fmt_nvdb_create(struct bsq_ctx *ctx, const char *path, const struct fmt_nvdb_info *info,
                    struct fmt_nvdb_writer **out);

/* Sets the names that ids by name stand for: ascending, each once. Without this call there are
 * none. Errors: BSQ_EUSAGE for names of 4 GiB together; BSQ_ENOMEM. */
int fmt_nvdb_set_names(struct fmt_nvdb_writer *writer, const char *const *names, uint64_t count);

struct fmt_nvdb_totals {
    uint64_t voxels, second_records, leaves, lowers, uppers, file_bytes;
    int32_t index_min[3], index_max[3]; /* of voxels, inclusive */
};

/* A region of 128^3 voxels (a lower node), or some of its leaves. Leaves ascend by number;
 * successive calls with the same origin add to one region, and leaf numbers ascend across them. */
struct fmt_nvdb_region {
    int32_t origin[3]; /* index of the first voxel, each a multiple of 128 */
    uint32_t leaf_count;
    const uint16_t *leaf_ids;   /* x << 8 | y << 4 | z of each leaf in the region */
    const uint64_t (*masks)[8]; /* of each leaf, not all zero; voxel (x, y, z) is bit y << 3 | z of
                                   word x */
    uint64_t record_count, second_count;
    const struct fmt_nvdb_record *records; /* one a voxel, in the order of leaves and bits */
    const struct fmt_nvdb_record *second;  /* of the voxels that have FMT_NVDB_PLANE_SECOND */
    /* Values of further channels, as many a record as the list of the grid has; NULL: none. */
    const float *channels, *second_channels;
};

/* Appends a region. Regions must come in NanoVDB's order: by root tile (4096^3 voxels), tiles
 * ascending by x, then y, then z of origin / 4096 as 21-bit unsigned numbers; inside a tile by x,
 * y, z. Not thread-safe. A failure is final: later calls and the commit return it again. Errors:
 * BSQ_EUSAGE if the grid has more nodes than the format can count; BSQ_EIO, BSQ_EINTR. */
int fmt_nvdb_append(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region);

/* Writes the whole file from the temporary ones and syncs it; frees the writer in any case. *out:
 * the output, for the caller to commit. Uses the context's threads. Errors: BSQ_EDATA if the grid
 * has no voxels; BSQ_EIO, BSQ_EINTR. */
int fmt_nvdb_finish(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals,
                    struct bsq_output **out);
void fmt_nvdb_discard(struct fmt_nvdb_writer *writer); /* NULL is allowed */

/* ---- reading ---- */

enum {
    FMT_NVDB_GRID_OFFSET = 224, /* of GridData in the file */
    FMT_NVDB_LEAF_BYTES = 96    /* of a leaf node */
};

/* Sections of the file, of which nvdb_layout_internal.h has the numbers. */
enum { FMT_NVDB_SECTION_COUNT = 13 };
struct fmt_nvdb_range {
    uint64_t offset, size; /* in the file */
};
struct fmt_nvdb_layout {
    struct fmt_nvdb_range section[FMT_NVDB_SECTION_COUNT];
    uint64_t record_count, file_bytes;
};

/* A mapped grid. All pointers are into the map and valid until fmt_nvdb_close(). The nodes of a
 * level are contiguous, and fmt_nvdb_open() has checked the offsets that they contain. But another
 * process may change the file later: who follows an offset, a value index or a rank bounds it by
 * the counts here, which are copies. */
struct fmt_nvdb_grid {
    struct bsq_map map;
    struct fmt_nvdb_info info;
    const uint8_t *grid;       /* GridData; offsets below are from here */
    const uint8_t *root;       /* RootData */
    const uint8_t *root_tiles; /* 32 bytes each, sorted by key: u64 key, i64 offset of its upper
                             node from root */
    uint32_t root_tile_count;  /* equal to upper_count */
    const uint8_t *uppers, *lowers, *leaves;
    uint32_t upper_count, lower_count, leaf_count;
    uint32_t upper_bytes, lower_bytes;  /* size of one node */
    int32_t index_min[3], index_max[3]; /* of active voxels, inclusive */
    uint64_t voxel_count;    /* active voxels; their value indices are 1 ... voxel_count */
    uint64_t record_count;   /* of each channel: the background, voxels, second records */
    const uint32_t *normals; /* channels of struct fmt_nvdb_record */
    const uint32_t *planes;
    const uint32_t *colors;   /* NULL when the grid has none */
    const uint32_t *ids;      /* likewise */
    const uint8_t *names;     /* that ids stand for, see fmt_nvdb_read_names() */
    uint64_t name_bytes;      /* 0 when the grid has no ids */
    const float *channels;    /* of each record channel_words values; NULL when the grid has none */
    uint32_t channel_words;   /* values of all channels of the list; 0 when the grid has none */
    const char *channel_list; /* names, see formats/material/channels.h; not terminated */
    uint32_t channel_list_bytes;
    /* One word for each of transfer_count maps of channels: index of the map's first value in a
     * record, times 4, plus its number of values. The user owns it. NULL after opening. */
    const uint32_t *transfers;
    uint32_t transfer_count;
    /* Which voxels have second records: entry i = {bits, rank} is for value indices 32 i ... 32 i +
     * 31. The second record of v is number 1 + voxel_count + rank + popcount(bits below v & 31). */
    const uint32_t (*seconds)[2];
    struct fmt_nvdb_layout layout; /* of the file, private to this folder, as is the next one */
    uint32_t flags;                /* of the trailer */
};

/* Maps a grid. Checks magic, version, type, sizes, and every node offset, mask and prefix sum that
 * a traversal follows. Reads all nodes once, on all threads, but no channels. Errors: BSQ_ENOINPUT;
 * BSQ_EDATA naming what is wrong; BSQ_EIO, also if the file changes meanwhile. */
int fmt_nvdb_open(struct bsq_ctx *ctx, const char *path, struct fmt_nvdb_grid *out);
/* Does the same with an open file, which it takes over. */
int fmt_nvdb_open_file(struct bsq_ctx *ctx, struct bsq_file *file, struct fmt_nvdb_grid *out);
void fmt_nvdb_close(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid);
/* Checks what fmt_nvdb_open() does not: the checksums of all sections, that padding is zero, and
 * that each record is valid (FORMATS.md, "Channels"). Returns pages of the map to the system as it
 * goes. Errors: BSQ_EDATA naming the section or the record. */
int fmt_nvdb_verify(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

/* Calls fn with each name that ids stand for, in ascending order. Returns the first result of fn
 * that is not 0. Errors: BSQ_ENOMEM, BSQ_EIO if the file has changed. */
int fmt_nvdb_read_names(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                        int (*fn)(void *arg, const char *name), void *arg);

/* Returns the version of a grid's trailer. */
int fmt_nvdb_trailer_version(const struct fmt_nvdb_grid *grid);
/* Returns the number of the second record of the voxel with value index v, 0 if it has none. */
uint64_t fmt_nvdb_second(const struct fmt_nvdb_grid *grid, uint64_t v);

/* ---- OpenVDB ---- */

/* Exports a grid as an OpenVDB file for Blender, Houdini and others: a mask grid "surface", a Vec3f
 * grid "N" (unit normals) and, if the grid has colour, a Vec3f grid "Cd" (linear RGB). Values are
 * those of each voxel's first record. Equal grids give equal bytes. OpenVDB holds all grids in
 * memory, about 13 KiB for each leaf, half of that without colour. That is reserved from the
 * budget; BSQ_ENOMEM names the size needed. *out: the complete output, for the caller to commit. */
int fmt_vdb_export(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, const char *path,
                   struct bsq_output **out);

/* Returns 0 if the program bisque-vdb is installed, else its error. */
int fmt_vdb_check(struct bsq_ctx *ctx);

#ifdef __cplusplus
}
#endif
#endif

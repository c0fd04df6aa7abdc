/* parts.h - the files of parts; private to this folder. */
#ifndef BAKE_JOB_PARTS_H
#define BAKE_JOB_PARTS_H

#include "base/file.h"
#include "base/output.h"
#include "formats/fingerprint.h"
#include "libbake/job/job.h"

struct fmt_exr_rows;

enum { BAKE_MOST_BLOCK_SIDE = 64 };

/* A block and the work in it. */
struct bake_share_block {
    uint64_t index;       /* on a curve through the scan */
    uint32_t tile, block; /* indices */
    uint32_t samples;     /* in triangles, one a texel */
};

/* Cuts all tiles into blocks, squares of at most BAKE_MOST_BLOCK_SIDE texels a side: smaller ones
 * if many parts share few texels. Errors: BSQ_ENOMEM. */
int bake_cut_blocks(struct bake_job *job);

/* Gives each block to a part, so that all have about as many samples. `blocks` lists those with
 * samples and is sorted. */
void bake_share_out(struct bake_job *job, struct bake_share_block *blocks, uint64_t count);

/* A part of a map in texels; the ends are not in it. */
struct bake_box {
    uint32_t x, y, x_end, y_end;
};

/* A file of a part. */
struct bake_part_file {
    uint32_t tile, part; /* index; from 1 on */
    struct bake_box box;
};

/* What a part counted in all of its tiles, for the report of the merge. */
struct bake_part_counts {
    uint64_t covered_texels, samples, hits, overlapping_samples;
    struct bake_curvature_counts curvature;
};

/* The names of an image's channels. */
struct bake_channels {
    uint32_t count;
    char **names;
};

/* A file of a part, open for reading. */
struct bake_part {
    const struct bake_job *job;
    const struct bake_channels *channels;
    struct bake_part_file of;
    char *path;
    struct bsq_file file;
    struct fmt_exr_rows *rows;
    struct bake_part_texts texts; /* as they must be */
    struct bake_part_counts counts;
};

/* Returns the path of a part's file; NULL if there is no memory. The caller frees it. */
char *bake_part_path(const struct bake_job *job, const struct bake_part_file *file);

/* Names the channels of the files. Free them with bake_free_channels(), also after a failure.
 * Errors: BSQ_ENOMEM. */
int bake_name_channels(const struct bake_job *job, struct bake_channels *out);
void bake_free_channels(struct bake_channels *channels);

/* Writes a file of the job's part, from the image of its tile, which holds the part's blocks. *out:
 * complete, without its name. Errors: BSQ_EIO, BSQ_ECANTCREAT, BSQ_ENOMEM, BSQ_EINTR. */
int bake_part_write(const struct bake_job *job, const struct bake_channels *channels,
                    const struct bake_part_file *file, const struct bake_part_counts *counts,
                    struct bsq_output **out);

/* Opens a file and checks its header. Close it also after a failure. Errors: BSQ_ENOINPUT
 * if it is missing; BSQ_EDATA, which names it, if it is damaged or no such part of this bake. */
int bake_part_open(const struct bake_job *job, const struct bake_channels *channels,
                   const struct bake_part_file *file, struct bake_part *part);
/* Checks all bytes, and copies the part's blocks to the image of the tile; NULL: only checks.
 * Errors: BSQ_EDATA, those of bake_image_write(). */
int bake_part_read(const struct bake_part *part, struct bake_image *image);
void bake_part_close(struct bake_part *part);

#endif

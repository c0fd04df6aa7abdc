/* image_writer.h - writes images of float samples to files. fmt_image_formats[] has a row for
 * each format.
 *
 * In: rows of interleaved float samples from top to bottom, on one thread. Out: a file that appears
 * whole or not at all. All threads compress. The bytes depend neither on their number nor on how
 * many rows are written at a time.
 *
 * A new format is a source file that defines a struct fmt_image_format, and an entry of
 * fmt_image_formats[] in image_writer.c. */
#ifndef FMT_IMAGE_IMAGE_WRITER_H
#define FMT_IMAGE_IMAGE_WRITER_H

#include "base/output.h"

/* How a file stores a sample. Integers hold 0 to 1; FMT_UINT8 is dithered, unless it is rounded. */
enum fmt_sample_type { FMT_UINT8, FMT_UINT16, FMT_HALF, FMT_FLOAT };
#define FMT_SAMPLE_BIT(type) (1u << (type))

/* A tile takes at most 1 GiB of floats in four channels. */
enum { FMT_MAX_TILE_SIDE = 8192 };

struct fmt_image_attribute { /* a text for the file's header */
    const char *name, *value;
};

struct fmt_image_options {
    uint32_t width, height; /* texels */
    uint32_t channel_count; /* 1 grey, 3 RGB, 4 RGBA, or any number of named ones */
    /* For OpenEXR files: the names of the channels, which must be different; NULL: the usual ones.
     */
    const char *const *channels;
    /* Likewise, where the image lies in a larger one of full_width x full_height texels; zeros: it
     * is whole. */
    uint32_t x, y, full_width, full_height;
    enum fmt_sample_type type;
    /* Samples are linear Rec. 709 light, which integer formats encode as sRGB. Otherwise the file
     * says that they are no colour, so that readers do not transform them. */
    bool color;
    /* Side of the tiles that the file is made of, to FMT_MAX_TILE_SIDE; 0: it is made of rows. */
    uint32_t exr_tile_side;
    bool rounded; /* 8-bit samples are rounded to nearest, and not dithered */
    /* The file is a temporary one beside the path, for fmt_image_hand_over() and
     * bsq_output_keep_temp(). */
    bool temporary;
    /* Names have at most 79 characters. See also fmt_image_describe(). */
    const struct fmt_image_attribute *attributes;
    uint32_t attribute_count;
};

struct fmt_image_writer;

/* A part of an image that is encoded alone: some rows, or a tile. */
struct fmt_image_block {
    const float *samples; /* of the first texel; lines have the samples of a row of the image */
    const float *above;   /* samples of the row above `samples`, if the format keeps it; or NULL */
    uint32_t first_row, rows;
    uint32_t column; /* of tiles */
};

struct fmt_image_format {
    const char *name;      /* for messages: "PNG" */
    const char *suffix;    /* of its files, with the dot; case does not matter */
    uint32_t sample_types; /* that it can store: FMT_SAMPLE_BIT() or-ed */
    enum fmt_sample_type usual_type;
    bool tiles;             /* files may be made of tiles */
    uint64_t writer_bytes;  /* of the format's own structure, which begins with the writer */
    uint64_t encoder_bytes; /* of what encodes a block, zeros at first */

    /* The functions below return 0 or a failure that they have recorded. create() gets a zeroed
     * structure with an open output; it sets block_rows and, if blocks need the row above, `above`.
     * A failure is followed by free(). */
    int (*create)(struct fmt_image_writer *writer, const struct fmt_image_options *options);
    int (*create_encoder)(struct fmt_image_writer *writer, void *encoder);
    void (*free_encoder)(struct fmt_image_writer *writer, void *encoder); /* or of zeros */
    /* Adds attributes to the header, which start() writes before the first row. */
    int (*describe)(struct fmt_image_writer *writer, const struct fmt_image_attribute *attributes,
                    uint32_t count);
    int (*start)(struct fmt_image_writer *writer);
    /* Encodes a block; several at the same time, with an encoder each. */
    int (*encode)(struct fmt_image_writer *writer, void *encoder,
                  const struct fmt_image_block *block);
    /* Writes what was encoded, one block after the other. */
    int (*emit)(struct fmt_image_writer *writer, void *encoder,
                const struct fmt_image_block *block);
    /* Completes the output after the last row, when the encoders are freed. */
    int (*finish)(struct fmt_image_writer *writer);
    /* Frees what create() made, also for a file that is not complete; records nothing. NULL: it
     * made nothing. */
    void (*free)(struct fmt_image_writer *writer);
};

/* What all formats' writers have; for formats only. */
struct fmt_image_writer {
    struct bsq_ctx *ctx;
    const struct fmt_image_format *format;
    struct bsq_output *output;
    char *path; /* the final name, for messages */
    uint32_t width, height, channel_count;
    uint32_t exr_tile_side; /* 0: blocks are rows */
    uint32_t block_rows;    /* rows that the format compresses together */
    uint32_t rows_taken, rows_encoded;
    uint32_t pending_rows;
    float *pending; /* rows that do not fill a block yet */
    float *above;   /* the last row that was encoded; NULL: the format needs none */
    void *slots;    /* a block and its encoder each */
    uint64_t slot_bytes;
    unsigned slot_count;
    bool started, finished, freed; /* freed: what coding needs, see free() of the format */
};

extern const struct fmt_image_format fmt_exr_format, fmt_png_format;
/* All formats; ends with NULL. */
extern const struct fmt_image_format *const fmt_image_formats[];

/* Returns the format that a file's suffix names, or NULL. */
const struct fmt_image_format *fmt_image_format_of(const char *path);

/* Checks that a format can store samples of this type. Errors: BSQ_EUSAGE. */
int fmt_image_check_type(struct bsq_ctx *ctx, const struct fmt_image_format *format,
                         const char *path, enum fmt_sample_type type);

/* Checks that a format can store tiles of this side, or rows if it is 0. Errors: BSQ_EUSAGE. */
int fmt_image_check_tiles(struct bsq_ctx *ctx, const struct fmt_image_format *format,
                          const char *path, uint32_t exr_tile_side);

/* Starts the file `path`. Errors: BSQ_EUSAGE for a size, channels, a sample type or tiles that the
 * format cannot store, BSQ_ECANTCREAT, BSQ_ENOMEM. */
int fmt_image_create(struct bsq_ctx *ctx, const struct fmt_image_format *format, const char *path,
                     const struct fmt_image_options *options, struct fmt_image_writer **out);
/* Adds attributes, such as those that become known late. Call it before the first row. */
int fmt_image_describe(struct fmt_image_writer *writer,
                       const struct fmt_image_attribute *attributes, uint32_t count);
/* Writes the next `rows` rows, any number: rows x width x channel_count samples. */
int fmt_image_write_rows(struct fmt_image_writer *writer, const float *samples, uint32_t rows);
/* Optional: completes the file, syncs it and frees what coding needed. */
int fmt_image_finish(struct fmt_image_writer *writer);
/* Completes the file; frees the writer in any case. *out: the output, for the caller to commit
 * together with others. */
int fmt_image_hand_over(struct fmt_image_writer *writer, struct bsq_output **out);
void fmt_image_discard(struct fmt_image_writer *writer); /* NULL is allowed */

#endif

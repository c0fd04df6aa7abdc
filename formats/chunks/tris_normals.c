/* tris_normals.c - writes and reads the section of vertex normals that were made from triangles.
 *
 * The normals of all vertices come first, chunk by chunk, so that their places are known before any
 * is made, in any order. The creases of all chunks follow. */
#include "formats/chunks/tris_internal.h"

#include <xxhash.h>

struct fmt_tris_normals_writer {
    struct bsq_ctx *ctx;
    struct fmt_tris_writer *writer; /* NULL: `own` is the output */
    struct bsq_output *output, *own;
    struct fmt_tris_file *file;        /* whose chunks need normals; a writer's is owned */
    struct fmt_tris_chunk_info *infos; /* the entries of its table; owned */
    struct bsq_file normals;           /* the output, for reading */
};

/* ---- writing ---- */

/* Reserves the places of all normals after what was written. */
static int reserve_places(struct fmt_tris_normals_writer *w)
{
    const uint64_t count = w->file->header.chunk_count;
    int status = BSQ_ALLOC(w->ctx, "chunk table", count + 1, &w->infos);
    for (uint64_t i = 0; i < count && status == 0; i++) {
        struct fmt_tris_chunk_info *info = &w->infos[i];
        *info = w->file->chunks[i];
        info->normals_offset = bsq_output_tell(w->output);
        info->crease_count = info->reserved = 0;
        bsq_output_skip(w->output, fmt_tris_normals_size(info));
    }
    return status;
}

int fmt_tris_normals_begin(struct fmt_tris_writer *writer, struct fmt_tris_normals_writer **out)
{
    struct fmt_tris_file *file = NULL;
    struct fmt_tris_normals_writer *w = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(fmt_tris_open_written(writer, &file));
    BSQ_TRY(BSQ_CALLOC(file->ctx, "normals", 1, &w));
    *w = (struct fmt_tris_normals_writer){.ctx = file->ctx,
                                          .writer = writer,
                                          .output = fmt_tris_writer_output(writer),
                                          .file = file,
                                          .normals = BSQ_FILE_CLOSED};
    file = NULL;
    BSQ_TRY(bsq_output_read(w->output, &w->normals));
    BSQ_TRY(reserve_places(w));
    *out = w;
    return 0;
done:
    fmt_tris_close(file);
    fmt_tris_normals_free(w);
    return status;
}

int fmt_tris_normals_begin_temp(struct fmt_tris_file *file, const char *beside,
                                struct fmt_tris_normals_writer **out)
{
    struct fmt_tris_normals_writer *w = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(file->ctx, "normals", 1, &w));
    *w = (struct fmt_tris_normals_writer){
        .ctx = file->ctx, .file = file, .normals = BSQ_FILE_CLOSED};
    BSQ_TRY(bsq_output_open_temp(file->ctx, beside, "normals", &w->own));
    w->output = w->own;
    BSQ_TRY(bsq_output_read(w->output, &w->normals));
    BSQ_TRY(reserve_places(w));
    *out = w;
    return 0;
done:
    fmt_tris_normals_free(w);
    return status;
}

const struct fmt_tris_file *fmt_tris_normals_file(const struct fmt_tris_normals_writer *writer)
{
    return writer->file;
}

int fmt_tris_normals_put(struct fmt_tris_normals_writer *writer, uint64_t chunk,
                         const uint64_t *normals)
{
    const struct fmt_tris_chunk_info *info = &writer->infos[chunk];
    return bsq_output_write_at(writer->output, normals, info->vertex_count * sizeof *normals,
                               info->normals_offset);
}

int fmt_tris_normals_get(struct fmt_tris_normals_writer *writer, uint64_t chunk, uint64_t *normals)
{
    const struct fmt_tris_chunk_info *info = &writer->infos[chunk];
    return bsq_file_read(writer->ctx, &writer->normals, normals,
                         info->vertex_count * sizeof *normals, info->normals_offset);
}

uint64_t fmt_tris_normals_checksum(const uint64_t *normals, uint32_t vertex_count,
                                   uint32_t crease_count)
{
    return XXH3_64bits(normals, vertex_count * sizeof *normals +
                                    crease_count * sizeof(struct fmt_tris_crease));
}

int fmt_tris_normals_finish(struct fmt_tris_normals_writer *writer, uint64_t chunk,
                            const struct fmt_tris_crease *creases, uint32_t crease_count,
                            uint64_t checksum)
{
    struct fmt_tris_chunk_info *info = &writer->infos[chunk];
    info->creases_offset = bsq_output_tell(writer->output);
    info->crease_count = crease_count;
    info->normals_checksum = checksum;
    return crease_count > 0
               ? bsq_output_write(writer->output, creases, crease_count * sizeof *creases)
               : 0;
}

/* Makes a temporary section that of its file. */
static int take_section(struct fmt_tris_normals_writer *w)
{
    struct bsq_output *own = w->own;
    w->own = NULL;
    bsq_file_close(w->ctx, &w->file->normals);
    return bsq_output_keep_temp(own, &w->file->normals);
}

int fmt_tris_normals_end(struct fmt_tris_normals_writer *w, enum bsq_scan_normals weights)
{
    struct fmt_tris_file *file = w->file;
    if (w->writer) {
        fmt_tris_writer_add_normals(w->writer, weights, w->infos);
        return 0;
    }
    file->header.made_normals = weights;
    file->normals_size_max = 0;
    for (uint64_t i = 0; i < file->header.chunk_count; i++) {
        file->chunks[i] = w->infos[i];
        if (fmt_tris_normals_size(&w->infos[i]) > file->normals_size_max)
            file->normals_size_max = fmt_tris_normals_size(&w->infos[i]);
    }
    return take_section(w);
}

void fmt_tris_normals_free(struct fmt_tris_normals_writer *w)
{
    if (!w)
        return;
    if (w->writer)
        fmt_tris_close(w->file);
    bsq_file_close(w->ctx, &w->normals);
    bsq_output_discard(w->own);
    BSQ_FREE(w->ctx, w->infos, w);
}

/* ---- reading ---- */

uint64_t fmt_tris_normals_size_max(const struct fmt_tris_file *file)
{
    return file->normals_size_max;
}

/* Returns whether creases are in the order of vertices that exist. */
static bool creases_valid(const struct fmt_tris_normals *normals, uint32_t vertex_count)
{
    uint64_t next = 0;
    bool valid = true;
    for (uint32_t i = 0; i < normals->crease_count; i++) {
        const struct fmt_tris_crease *crease = &normals->creases[i];
        valid &= crease->vertex >= next && crease->vertex < vertex_count && crease->reserved == 0;
        next = crease->vertex + UINT64_C(1);
    }
    return valid;
}

int fmt_tris_load_normals(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                          struct fmt_tris_normals *out)
{
    const struct fmt_tris_chunk_info *info = &file->chunks[index];
    const struct bsq_file *from = file->normals.fd >= 0 ? &file->normals : &file->file;
    const uint64_t bytes = info->vertex_count * sizeof *out->vertices,
                   crease_bytes = info->crease_count * sizeof *out->creases;
    *out = (struct fmt_tris_normals){
        .vertices = scratch,
        .creases = (const struct fmt_tris_crease *)(const void *)((char *)scratch + bytes),
        .crease_count = info->crease_count};
    BSQ_PASS(bsq_file_read(file->ctx, from, scratch, bytes, info->normals_offset));
    if (crease_bytes > 0)
        BSQ_PASS(bsq_file_read(file->ctx, from, (char *)scratch + bytes, crease_bytes,
                               info->creases_offset));
    BSQ_PASS(bsq_file_check(file->ctx, from));
    if (XXH3_64bits(scratch, bytes + crease_bytes) != info->normals_checksum)
        return fmt_tris_damaged_chunk(file, index, "the checksum of its normals does not match");
    if (!creases_valid(out, info->vertex_count))
        return fmt_tris_damaged_chunk(file, index, "its creases are not in order");
    return 0;
}

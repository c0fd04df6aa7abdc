/* tris_normals.c - writes and reads the section of vertex normals that were made from triangles.
 *
 * The normals of all vertices come first, chunk by chunk, so that their places are known before any
 * is made, in any order. The creases of all chunks follow. */
#include "formats/chunks/tris_internal.h"

#include <xxhash.h>

/* ---- writing ---- */

int fmt_tris_normals_begin(struct fmt_tris_writer *writer, enum bsq_scan_normals weights,
                           struct fmt_tris_file **out)
{
    const struct tris_file_header *h = &writer->header;
    struct fmt_tris_file *file;
    int status;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(writer->ctx, "chunk file", 1, &file));
    file->ctx = writer->ctx;
    file->own = true;
    file->file = (struct bsq_file)BSQ_FILE_CLOSED;
    file->header.attributes = h->attributes;
    file->header.chunk_count = h->chunk_count;
    file->header.triangle_count = h->triangle_count;
    file->header.material_count = h->material_count;
    BSQ_TRY(BSQ_ALLOC(file->ctx, "chunk table", h->chunk_count + 1, &file->chunks));
    for (uint64_t i = 0; i < h->chunk_count; i++) {
        struct fmt_tris_chunk_info *info = &writer->table[i];
        info->normals_offset = bsq_output_tell(writer->output);
        bsq_output_skip(writer->output, fmt_tris_normals_size(info));
        file->chunks[i] = *info;
        const uint64_t bytes = tris_load_size(h->attributes, info);
        file->load_size_max = bytes > file->load_size_max ? bytes : file->load_size_max;
    }
    BSQ_TRY(bsq_output_read(writer->output, &file->file));
    writer->header.made_normals = weights;
    *out = file;
    file = NULL;
done:
    fmt_tris_close(file);
    return status;
}

int fmt_tris_normals_put(struct fmt_tris_writer *writer, uint64_t chunk, const uint64_t *normals)
{
    const struct fmt_tris_chunk_info *info = &writer->table[chunk];
    return bsq_output_write_at(writer->output, normals, info->vertex_count * sizeof *normals,
                               info->normals_offset);
}

int fmt_tris_normals_get(const struct fmt_tris_file *file, uint64_t chunk, uint64_t *normals)
{
    const struct fmt_tris_chunk_info *info = &file->chunks[chunk];
    return bsq_file_read(file->ctx, &file->file, normals, info->vertex_count * sizeof *normals,
                         info->normals_offset);
}

uint64_t fmt_tris_normals_checksum(const uint64_t *normals, uint32_t vertex_count,
                                   uint32_t crease_count)
{
    return XXH3_64bits(normals, vertex_count * sizeof *normals +
                                    crease_count * sizeof(struct fmt_tris_crease));
}

int fmt_tris_normals_finish(struct fmt_tris_writer *writer, uint64_t chunk,
                            const struct fmt_tris_crease *creases, uint32_t crease_count,
                            uint64_t checksum)
{
    struct fmt_tris_chunk_info *info = &writer->table[chunk];
    info->creases_offset = bsq_output_tell(writer->output);
    info->crease_count = crease_count;
    info->normals_checksum = checksum;
    return crease_count > 0
               ? bsq_output_write(writer->output, creases, crease_count * sizeof *creases)
               : 0;
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
    const uint64_t bytes = info->vertex_count * sizeof *out->vertices,
                   crease_bytes = info->crease_count * sizeof *out->creases;
    *out = (struct fmt_tris_normals){
        .vertices = scratch,
        .creases = (const struct fmt_tris_crease *)(const void *)((char *)scratch + bytes),
        .crease_count = info->crease_count};
    BSQ_PASS(bsq_file_read(file->ctx, &file->file, scratch, bytes, info->normals_offset));
    BSQ_PASS(
        fmt_tris_read_unchanged(file, (char *)scratch + bytes, crease_bytes, info->creases_offset));
    if (XXH3_64bits(scratch, bytes + crease_bytes) != info->normals_checksum)
        return fmt_tris_damaged_chunk(file, index, "the checksum of its normals does not match");
    if (!creases_valid(out, info->vertex_count))
        return fmt_tris_damaged_chunk(file, index, "its creases are not in order");
    return 0;
}

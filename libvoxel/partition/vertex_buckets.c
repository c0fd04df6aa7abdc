/* vertex_buckets.c - see vertex_buckets.h. */
#include "libvoxel/partition/vertex_buckets.h"

#define BLOCK_VERTICES 8192u

/* Vertices have an order if fewer than one in eight changes the bucket. */
#define VERTICES_BY_CHANGE 8

static int allocate(const struct scan *scan, uint64_t vertices, uint32_t levels,
                    struct vertex_buckets *out)
{
    const char *what = "buckets of vertices";
    if (levels > VERTEX_BUCKET_NARROW_LEVELS)
        return bsq_alloc(scan->ctx, what, vertices, sizeof *out->wide, &out->wide);
    return bsq_alloc(scan->ctx, what, vertices, sizeof *out->narrow, &out->narrow);
}

int vox_vertex_buckets_make(const struct scan *scan, const struct morton_cube *cube,
                            uint32_t levels, struct vertex_buckets *out)
{
    const struct attribute_stream *stream = &scan->streams[SCAN_POSITIONS];
    const uint64_t vertices = stream_count(stream);
    uint64_t changes = 0;
    uint32_t before = 0;
    float(*positions)[3] = NULL;
    *out = (struct vertex_buckets){0};
    int status = allocate(scan, vertices, levels, out);
    if (status == 0)
        status = bsq_alloc(scan->ctx, "buckets of vertices", BLOCK_VERTICES, sizeof *positions,
                           &positions);
    for (uint64_t done = 0, count; status == 0 && done < vertices; done += count) {
        count = vertices - done < BLOCK_VERTICES ? vertices - done : BLOCK_VERTICES;
        if ((status = bsq_check(scan->ctx)) == 0)
            status = vox_spill_read(&stream->spill, sizeof *positions * done,
                                    sizeof *positions * count, positions);
        for (uint64_t i = 0; status == 0 && i < count; i++) {
            uint32_t bucket = morton_cell(cube, levels, positions[i]);
            changes += bucket != before;
            before = bucket;
            if (out->wide)
                out->wide[done + i] = (uint16_t)bucket;
            else
                out->narrow[done + i] = (uint8_t)bucket;
        }
    }
    out->have_order = changes < vertices / VERTICES_BY_CHANGE;
    bsq_free(scan->ctx, positions);
    return status;
}

void vox_vertex_buckets_free(const struct scan *scan, struct vertex_buckets *buckets)
{
    bsq_free(scan->ctx, buckets->wide);
    bsq_free(scan->ctx, buckets->narrow);
    *buckets = (struct vertex_buckets){0};
}

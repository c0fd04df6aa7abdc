/* triangulate_plain.c - the fast path for most scans: triangles with positions alone and one
 * material.
 *
 * Triangles are coded while their buckets are found, so each change of the bucket ends a run. That
 * pays as long as neighbours in the file are neighbours in space. */
#include "libvoxel/partition/run_writer.h"
#include "libvoxel/partition/triangulate_internal.h"

/* After a block without order the next ones are likely to have none. A trial that fails takes a
 * sixteenth of a block's time. */
#define BLOCKS_WITHOUT_TRIAL 16

static bool is_plain(const struct faces *faces)
{
    return !faces->sizes && faces->block->material_change_count == 0 &&
           !faces->indices[FMT_MESH_TEXCOORD] && !faces->indices[FMT_MESH_NORMAL];
}

/* Returns how many changes of the bucket are tolerated. */
static uint32_t most_runs(uint64_t triangles)
{
    return 64 + (uint32_t)triangles / 16;
}

static int reserve(struct triangulator *t, uint64_t triangles)
{
    uint64_t runs = most_runs(triangles), headers = runs + triangles / RUN_TRIANGLES + 1;
    uint64_t bytes = triangles * coded_triangle_bytes(t->plan, 1) +
                     headers * sizeof(struct run_header) + CORNER_CODE_SLACK;
    int status = bsq_grow(t->ctx, "faces", bytes, 1, &t->bytes, &t->bytes_capacity);
    if (status == 0)
        status = bsq_grow(t->ctx, "faces", runs, sizeof *t->runs, &t->runs, &t->run_capacity);
    return status;
}

/* Ends the runs of the current bucket. */
static void end_bucket(struct triangulator *t, struct run_writer *w)
{
    run_writer_end(w);
    if (t->run_count == 0)
        return;
    struct bucket_runs *runs = &t->runs[t->run_count - 1];
    runs->bytes = (uint64_t)(w->to - t->bytes) - runs->offset;
    t->triangles += runs->triangles;
}

/* Returns false if the bucket changes too often. */
static bool code_triangles(struct triangulator *t, const struct faces *faces)
{
    /* Copies tell the compiler that nothing written here changes them. */
    const struct attribute_stream positions = t->plan->scan->streams[SCAN_POSITIONS];
    const struct morton_cube cube = t->plan->cube;
    const uint32_t levels = t->plan->levels;
    const bool known = t->plan->vertex_buckets != NULL;
    const struct vertex_buckets buckets =
        known ? *t->plan->vertex_buckets : (struct vertex_buckets){0};
    const uint32_t material = run_material(faces->block->material_at_start, true);
    const uint64_t *v = faces->indices[FMT_MESH_VERTEX];
    const uint64_t triangles = faces->block->face_count;
    const uint32_t most = most_runs(triangles);
    struct run_writer w = {.to = t->bytes};
    uint32_t bucket = UINT32_MAX;
    t->triangles = 0;
    t->run_count = 0;
    for (uint64_t i = 0; i < triangles; i++, v += 3) {
        uint32_t number = known ? vertex_bucket(&buckets, v[0])
                                : morton_cell(&cube, levels, stream_at(&positions, v[0], 12));
        bool first = number != bucket || w.run.triangles == RUN_TRIANGLES;
        if (number != bucket) {
            end_bucket(t, &w);
            if (t->run_count == most)
                return false;
            t->runs[t->run_count++] =
                (struct bucket_runs){.bucket = number, .offset = (uint64_t)(w.to - t->bytes)};
            bucket = number;
        }
        if (first)
            run_writer_begin(&w, 1u << FMT_MESH_VERTEX, material);
        w.to = corner_code_put(&w.codes[FMT_MESH_VERTEX], v, w.to);
        w.run.triangles++;
        t->runs[t->run_count - 1].triangles++;
    }
    end_bucket(t, &w);
    return true;
}

int vox_triangulate_plain(struct triangulator *t, const struct faces *faces, bool *done)
{
    *done = false;
    if (t->skipped_plain > 0)
        t->skipped_plain--;
    else if (is_plain(faces)) {
        int status = reserve(t, faces->block->face_count);
        if (status < 0)
            return status;
        *done = code_triangles(t, faces);
        t->skipped_plain = *done ? 0 : BLOCKS_WITHOUT_TRIAL;
    }
    return 0;
}

#include "sort_fixture.h"
#include "tests/unit/fixture.h"

/* ---- fixture ---- */

static void keep_warning(void *user, const char *line)
{
    struct sort_fixture *f = user;
    memcpy(f->warning_before, f->warning, sizeof f->warning);
    snprintf(f->warning, sizeof f->warning, "%s", line);
    f->warnings++;
}

static void keep_progress(void *user, const struct bsq_progress *progress)
{
    struct sort_fixture *f = user;
    f->beyond_total |= progress->done > progress->total;
    if (progress->finished)
        f->progress = *progress;
}

void sort_open_context(struct sort_fixture *f, uint64_t memory, unsigned threads)
{
    struct bsq_ctx_options options = {.memory_bytes = memory,
                                      .threads = threads,
                                      .tmpdir = ".",
                                      .on_progress = keep_progress,
                                      .on_warning = keep_warning,
                                      .user = f};
    if (f->ctx) {
        assert_int_equal(bsq_memory_used(f->ctx), 0);
        assert_true(bsq_memory_high(f->ctx) <= bsq_memory_limit(f->ctx));
        bsq_ctx_destroy(f->ctx);
    }
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
}

int sort_set_up(void **state)
{
    struct sort_fixture *f = calloc(1, sizeof *f);
    f->report.size = sizeof f->report;
    sort_open_context(f, 256 * MIB, 2);
    *state = f;
    return 0;
}

int sort_tear_down(void **state)
{
    struct sort_fixture *f = *state;
    sort_open_context(f, MIB, 1);
    bsq_ctx_destroy(f->ctx);
    unlink("scan.obj");
    unlink("more.obj");
    unlink("scan.tris");
    free(f);
    return 0;
}

int sort_files(struct sort_fixture *f, const char *const *paths, uint32_t count)
{
    struct vox_sort_options options = {.size = sizeof(struct vox_sort_options),
                                       .scan_paths = paths,
                                       .scan_count = count,
                                       .tris_path = "scan.tris"};
    bsq_clear_error(f->ctx);
    bsq_forget_files(f->ctx);
    return vox_sort(f->ctx, &options, &f->report);
}

struct vox_sort_options sort_scan_obj(void)
{
    static const char *const path = "scan.obj";
    return (struct vox_sort_options){.size = sizeof(struct vox_sort_options),
                                     .scan_paths = &path,
                                     .scan_count = 1,
                                     .tris_path = "scan.tris"};
}

int sort_scan(struct sort_fixture *f)
{
    return sort_files(f, sort_scan_obj().scan_paths, 1);
}

int sort_text(struct sort_fixture *f, const char *text)
{
    test_text("scan.obj", text);
    return sort_scan(f);
}

void expect_sorted(struct sort_fixture *f, int status)
{
    if (status < 0)
        fail_msg("status %d: %s", status, bsq_error(f->ctx));
}

const char *sort_write_image(void)
{
    static const char png[] = "\x89PNG\r\n\x1a\n"
                              "\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x08\0\0\0\0\x3a\x7e\x9b\x55"
                              "\0\0\0\nIDAT\x78\xda\x63\x68\0\0\0\x82\0\x81\xda\x45\x08\x3b"
                              "\0\0\0\0IEND\xae\x42\x60\x82";
    return test_bytes("wall.png", png, sizeof png - 1);
}

/* ---- triangles as a multiset ---- */

void sorted_add(struct sorted_triangles *t, const struct sorted_triangle *one)
{
    if (t->count == t->capacity) {
        t->capacity = t->capacity ? 2 * t->capacity : 1024;
        t->list = realloc(t->list, t->capacity * sizeof *t->list);
        assert_non_null(t->list);
    }
    /* Rotates the least corner to the front, which keeps the winding. */
    int least = 0;
    for (int k = 1; k < 3; k++)
        if (memcmp(&one->corners[k], &one->corners[least], sizeof one->corners[k]) < 0)
            least = k;
    struct sorted_triangle *to = &t->list[t->count++];
    for (int k = 0; k < 3; k++)
        to->corners[k] = one->corners[(least + k) % 3];
    to->material = one->material;
}

static int compare_triangles(const void *a, const void *b)
{
    return memcmp(a, b, sizeof(struct sorted_triangle));
}

void expect_same_triangles(struct sorted_triangles *got, struct sorted_triangles *expected)
{
    assert_int_equal(got->count, expected->count);
    qsort(got->list, got->count, sizeof *got->list, compare_triangles);
    qsort(expected->list, expected->count, sizeof *expected->list, compare_triangles);
    assert_memory_equal(got->list, expected->list, got->count * sizeof *got->list);
    free(got->list);
    free(expected->list);
    *got = *expected = (struct sorted_triangles){0};
}

/* ---- reading the result ---- */

static void take_chunk(const struct fmt_tris_chunk *chunk, struct sorted_triangles *out)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        struct sorted_triangle one;
        memset(&one, 0, sizeof one);
        for (int k = 0; k < 3; k++) {
            uint32_t v = chunk->triangles[t][k];
            memcpy(one.corners[k].position, chunk->positions[v], 12);
            if (chunk->texcoords)
                memcpy(one.corners[k].texcoord, chunk->texcoords[v], 8);
            if (chunk->colors)
                one.corners[k].color = chunk->colors[v];
            if (chunk->normals)
                one.corners[k].normal = chunk->normals[v];
        }
        one.material = chunk->materials ? chunk->materials[t] : UINT32_MAX;
        sorted_add(out, &one);
    }
}

/* Checks that the bounds are exactly those of the chunk's triangles. */
static void expect_bounds(const struct fmt_tris_chunk *chunk,
                          const struct fmt_tris_chunk_info *info)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            for (int axis = 0; axis < 3; axis++) {
                float p = chunk->positions[chunk->triangles[t][k]][axis];
                low[axis] = fminf(low[axis], p);
                high[axis] = fmaxf(high[axis], p);
            }
    assert_memory_equal(low, info->bounds_min, sizeof low);
    assert_memory_equal(high, info->bounds_max, sizeof high);
}

void read_sorted(struct sort_fixture *f, struct sorted_triangles *out,
                 struct fmt_tris_header *header)
{
    struct fmt_tris_file *file;
    void *scratch;
    if (fmt_tris_open(f->ctx, "scan.tris", &file) < 0)
        fail_msg("%s", bsq_error(f->ctx));
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    assert_int_equal(bsq_alloc(f->ctx, "test", fmt_tris_load_size_max(file) + 1, 1, &scratch), 0);
    for (uint64_t i = 0; i < h->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        if (fmt_tris_load(file, i, scratch, &chunk) < 0)
            fail_msg("%s", bsq_error(f->ctx));
        expect_bounds(&chunk, &infos[i]);
        if (i + 1 < h->chunk_count)
            assert_true(chunk.triangle_count >= FMT_TRIS_CHUNK_TRIANGLES / 2);
        if (out)
            take_chunk(&chunk, out);
    }
    assert_int_equal(h->triangle_count, f->report.triangles);
    assert_int_equal(h->chunk_count, f->report.chunks);
    assert_int_equal(h->source_faces, f->report.faces);
    assert_int_equal(h->skipped_triangles, f->report.degenerate_triangles);
    if (header) {
        *header = *h;
        header->materials = NULL;
    }
    bsq_free(f->ctx, scratch);
    fmt_tris_close(file);
}

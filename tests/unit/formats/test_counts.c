/* test_counts.c - counts and offsets near and far above 2^32. Writing billions of triangles takes
 * too long for a test, so counts are set in the state of writers. The chunk writer's state is
 * private, so its source is included here. */
#include "formats/grid/nvdb_writer_internal.h"
#include "formats/chunks/tris_write.c"
#include "tests/unit/test.h"

#define START (UINT64_C(0x100000000) - 10)

static struct bsq_ctx *ctx;

static int set_up(void **state)
{
    struct bsq_ctx_options options = {.threads = 2, .memory_bytes = 64 << 20};
    (void)state;
    return bsq_ctx_create(&options, &ctx);
}

static int tear_down(void **state)
{
    (void)state;
    bsq_ctx_destroy(ctx);
    return 0;
}

/* ---- .tris ---- */

/* Encodes a chunk: a strip of 20 triangles. */
static uint64_t encode_strip(uint8_t *buffer, struct fmt_tris_chunk_info *info)
{
    float positions[22][3];
    uint32_t triangles[20][3];
    uint64_t size = 0;
    for (uint32_t v = 0; v < 22; v++)
        memcpy(positions[v], (float[3]){(float)(v / 2), (float)(v % 2), 0}, sizeof positions[v]);
    for (uint32_t t = 0; t < 20; t++)
        memcpy(triangles[t], (uint32_t[3]){t, t + 1, t + 2}, sizeof triangles[t]);
    struct fmt_tris_chunk chunk = {.triangle_count = 20,
                                   .vertex_count = 22,
                                   .positions = (const float(*)[3])positions,
                                   .triangles = (const uint32_t(*)[3])triangles};
    assert_int_equal(fmt_tris_encode(ctx, 0, &chunk, buffer, &size, info), 0);
    return size;
}

TEST(triangles_are_numbered_past_2_32)
{
    struct fmt_tris_header header = {.source_faces = UINT64_C(5) << 32};
    struct fmt_tris_writer *writer;
    struct fmt_tris_chunk_info info;
    uint8_t buffer[4096];
    uint64_t size = encode_strip(buffer, &info);
    assert_true(size <= sizeof buffer);
    assert_int_equal(fmt_tris_create(ctx, "a.tris", &header, &writer), 0);
    writer->header.triangle_count = START;
    fmt_tris_skip(writer, UINT64_C(1) << 32);
    fmt_tris_skip(writer, 1);
    for (int i = 0; i < 3; i++)
        assert_int_equal(fmt_tris_append(writer, buffer, size, &info), 0);
    assert_int_equal(writer->table[0].first_triangle, START);
    assert_int_equal(writer->table[1].first_triangle, START + 20);
    assert_int_equal(writer->table[2].first_triangle, START + 40);
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
    struct tris_file_header written;
    FILE *file = fopen("a.tris", "rb");
    assert_non_null(file);
    assert_int_equal(fread(&written, sizeof written, 1, file), 1);
    fclose(file);
    assert_int_equal(written.triangle_count, START + 60);
    assert_int_equal(written.source_faces, UINT64_C(0x500000000));
    assert_int_equal(written.skipped_triangles, UINT64_C(0x100000001));
}

/* Array lengths as in FORMATS.md, for counts larger than any chunk has. */
TEST(sizes_of_chunks_do_not_wrap)
{
    uint64_t nt = UINT32_MAX, nv = UINT32_MAX;
    uint64_t bytes = nv * (12 + 4 + 8 + 4) + nt * 4 + nt * 12;
    assert_int_equal(tris_chunk_layout(15, UINT32_MAX, UINT32_MAX).bytes, (bytes + 7) / 8 * 8);
}

/* ---- .nvdb ---- */

/* Appends a region with one leaf of 40 voxels, which all have second records. */
static int append_leaf(struct fmt_nvdb_writer *writer, int32_t x)
{
    static const uint16_t id = 0;
    static const uint64_t mask[1][8] = {{UINT64_C(0xffffffffff)}};
    struct fmt_nvdb_record records[40], second[40] = {0};
    for (int i = 0; i < 40; i++)
        records[i] = (struct fmt_nvdb_record){.plane = FMT_NVDB_PLANE_SECOND};
    struct fmt_nvdb_region region = {.origin = {x, 0, 0},
                                     .leaf_count = 1,
                                     .leaf_ids = &id,
                                     .masks = mask,
                                     .record_count = 40,
                                     .second_count = 40,
                                     .records = records,
                                     .second = second};
    return fmt_nvdb_append(writer, &region);
}

static struct fmt_nvdb_writer *new_grid(void)
{
    struct fmt_nvdb_info info = {.voxel_size = 1};
    struct fmt_nvdb_writer *writer;
    assert_int_equal(fmt_nvdb_create(ctx, "a.nvdb", &info, &writer), 0);
    return writer;
}

TEST(voxels_are_numbered_past_2_32)
{
    struct fmt_nvdb_writer *writer = new_grid();
    writer->counts.voxels = START;
    for (int i = 0; i < 3; i++)
        assert_int_equal(append_leaf(writer, 128 * i), 0);
    const struct bsq_spill_stream *stream =
        &writer->spill.list[writer->stream[NVDB_LEAVES][0].number];
    assert_int_equal(stream->fill, 3 * sizeof(struct nvdb_leaf));
    const struct nvdb_leaf *leaves = (const void *)stream->buffer;
    for (uint64_t i = 0; i < 3; i++)
        assert_int_equal(leaves[i].offset,
                         1 + START + 40 * i); /* value index 0 is the background */
    assert_int_equal(writer->counts.voxels, START + 120);
    fmt_nvdb_discard(writer);
}

static void expect_full(struct fmt_nvdb_writer *writer, const char *what)
{
    assert_int_equal(append_leaf(writer, 0), BSQ_EUSAGE);
    char line[160];
    snprintf(line, sizeof line,
             "a.nvdb: the grid has more than 4294967295 %s; choose larger voxels", what);
    assert_string_equal(bsq_error(ctx), line);
    bsq_clear_error(ctx);
    fmt_nvdb_discard(writer);
}

TEST(counts_that_the_format_cannot_hold_are_refused)
{
    struct fmt_nvdb_writer *writer = new_grid();
    writer->counts.leaves = UINT32_MAX;
    expect_full(writer, "leaves of 8x8x8 voxels");
    writer = new_grid();
    writer->counts.lowers = UINT32_MAX;
    expect_full(writer, "nodes of 128x128x128 voxels");
    writer = new_grid();
    writer->counts.seconds = UINT32_MAX - 39;
    expect_full(writer, "voxels with two surfaces");
    writer = new_grid();
    writer->counts.seconds = UINT32_MAX - 40;
    writer->counts.leaves = UINT32_MAX - 1;
    assert_int_equal(append_leaf(writer, 0), 0);
    assert_int_equal(writer->counts.seconds, UINT32_MAX);
    assert_int_equal(writer->counts.leaves, UINT32_MAX);
    fmt_nvdb_discard(writer);
}

/* Checks each section of the largest grid that FORMATS.md allows. */
TEST(sections_of_the_largest_grid_do_not_wrap)
{
    uint64_t u = UINT32_MAX, l = UINT32_MAX, f = UINT32_MAX, v = 512 * f, s = UINT32_MAX,
             n = 1 + v + s, names = (UINT64_C(1) << 61) - 1, words = 65535;
    struct nvdb_counts counts = {.flags = nvdb_flags(true, FMT_IDS_MATERIAL, true),
                                 .uppers = UINT32_MAX,
                                 .lowers = UINT32_MAX,
                                 .leaves = UINT32_MAX,
                                 .voxels = v,
                                 .seconds = s,
                                 .name_bytes = names,
                                 .channel_words = (uint32_t)words,
                                 .channel_list_bytes = UINT32_MAX};
    struct fmt_nvdb_layout layout;
    fmt_nvdb_layout_compute(&counts, &layout);
    const uint64_t sizes[NVDB_SECTION_COUNT] = {960 + 64 + 32 * u,
                                                270400 * u,
                                                33856 * l,
                                                96 * f,
                                                8 * 288,
                                                4 * n,
                                                4 * n,
                                                4 * n,
                                                8 * (v / 32 + 1),
                                                4 * n,
                                                names,
                                                (UINT64_C(1) << 32) + 64 + 4 * n * words,
                                                192};
    uint64_t at = 0;
    for (int i = 0; i < NVDB_SECTION_COUNT; i++) {
        at = i >= NVDB_NORMALS ? (at + 63) / 64 * 64 : at;
        assert_int_equal(layout.section[i].offset, at);
        assert_int_equal(layout.section[i].size, sizes[i]);
        at += sizes[i];
    }
    assert_int_equal(layout.file_bytes, at);
    assert_true(at > UINT64_C(1) << 50 && at < INT64_MAX);
}

RUN_TESTS(set_up, tear_down)

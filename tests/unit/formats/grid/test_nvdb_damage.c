/* test_nvdb_damage.c - grid files that are truncated, changed, forged or of another kind. */
#include <xxhash.h>

#include "formats/grid/nvdb_writer_internal.h"
#include "tests/unit/test.h"
#include "tests/unit/formats/grid/nvdb_files.h"
#include "tests/unit/formats/grid/nvdb_scene.h"
#include "tests/unit/sanitized.h"
#include "tests/grid_lookup.h"

/* ---- damaged files ---- */

/* Opens `size` bytes in memory of that size, so that the sanitizer sees an access beyond the end.
 */
static int open_bytes(struct bsq_ctx *ctx, const uint8_t *bytes, uint64_t size,
                      struct fmt_nvdb_grid *grid)
{
    bsq_clear_error(ctx);
    memset(grid, 0, sizeof(*grid));
    grid->map = (struct bsq_map){.data = bytes, .size = size, .path = (char *)"x.nvdb"};
    int status = fmt_nvdb_check_header(ctx, grid);
    if (status == 0)
        status = fmt_nvdb_check_nodes(ctx, grid);
    if (status) {
        assert_int_equal(status, BSQ_EDATA);
        assert_int_equal(strncmp(bsq_error(ctx), "x.nvdb: ", 8), 0);
    }
    return status;
}

/* Looks up all voxels of the scene; if `right`, the results must be those of the scene. */
static void look_up(const struct fmt_nvdb_grid *grid, const struct scene *scene, bool right)
{
    for (uint64_t i = 0; i < scene->count; i++) {
        uint64_t index = grid_find(grid, scene->voxels[i].ijk);
        if (right)
            assert_int_equal(index, i + 1);
        assert_true(index < grid->record_count);
        if (index > 0) {
            struct fmt_nvdb_record record = grid_get(grid, index);
            (void)record;
        }
        assert_true(fmt_nvdb_second(grid, index) < grid->record_count);
    }
}

/* Corrects the checksums that fmt_nvdb_open() checks, as a forger would. */
static void forge(uint8_t *bytes, uint64_t size, const struct nvdb_layout *layout)
{
    uint32_t crc = fmt_nvdb_head_crc(bytes, layout);
    memcpy(bytes + FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, checksum), &crc, 4);
    struct nvdb_trailer trailer;
    memcpy(&trailer, bytes + size - sizeof(trailer), sizeof(trailer));
    trailer.trailer_checksum = fmt_nvdb_trailer_checksum(&trailer);
    memcpy(bytes + size - sizeof(trailer), &trailer, sizeof(trailer));
}

struct small_file {
    struct bsq_ctx *ctx;
    struct scene scene;
    uint8_t *bytes;
    uint64_t size;
    struct nvdb_layout layout;
};

static void small_file_open(struct small_file *file, enum fmt_nvdb_type type)
{
    file->ctx = test_context(1, 0);
    scene_random(&file->scene, 7, 12, false);
    /* One root tile is enough; each of its bytes is changed. */
    uint64_t kept = 0;
    for (uint64_t i = 0; i < file->scene.count; i++) {
        struct scene_voxel *v = &file->scene.voxels[i];
        if (v->ijk[0] >= 0 && v->ijk[1] >= 0 && v->ijk[2] >= 0 && v->ijk[0] < 300 &&
            v->ijk[1] < 300 && v->ijk[2] < 300)
            file->scene.voxels[kept++] = *v;
    }
    file->scene.count = kept;
    file->scene.info.type = type;
    struct fmt_nvdb_totals totals;
    assert_ok(file->ctx, scene_write(file->ctx, nvdb_path, &file->scene, &totals));
    assert_int_equal(totals.uppers, 1);
    assert_true(totals.lowers > 1);
    file->bytes = test_read(nvdb_path, &file->size);
    struct fmt_nvdb_grid grid;
    assert_ok(file->ctx, open_bytes(file->ctx, file->bytes, file->size, &grid));
    fmt_nvdb_layout_of(&grid, &file->layout);
}

static void small_file_close(struct small_file *file)
{
    free(file->bytes);
    scene_free(&file->scene);
    bsq_ctx_destroy(file->ctx);
}

TEST(test_truncated)
{
    struct small_file file;
    small_file_open(&file, FMT_NVDB_MASK);
    for (int claimed = 0; claimed < 2; claimed++) {
        for (uint64_t size = 0; size < file.size;
             size += size < 1200 || size + 600 > file.size ? 1 : 89) {
            uint8_t *bytes = malloc(size ? size : 1);
            memcpy(bytes, file.bytes, size);
            uint64_t grid_bytes = size - FMT_NVDB_GRID_OFFSET;
            if (claimed && size >= FMT_NVDB_GRID_OFFSET + 40)
                memcpy(bytes + FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, grid_bytes),
                       &grid_bytes, sizeof(grid_bytes));
            struct fmt_nvdb_grid grid;
            assert_int_equal(open_bytes(file.ctx, bytes, size, &grid), BSQ_EDATA);
            free(bytes);
        }
    }
    small_file_close(&file);
}

/* Changes each byte of a file in turn. In the table of the upper node, 256 KiB of similar entries,
 * changes only every `stride`-th byte. */
static void flip_bytes(enum fmt_nvdb_type type, bool forged, uint64_t stride)
{
    struct small_file file;
    small_file_open(&file, type);
    uint64_t accepted = 0, random = 77;
    uint8_t *bytes = malloc(file.size);
    memcpy(bytes, file.bytes, file.size);
    uint64_t table = file.layout.section[NVDB_UPPERS].offset + offsetof(struct nvdb_upper, table);
    for (uint64_t at = 0; at < file.size; at++) {
        if (at > table && at % stride != 0 && at < file.layout.section[NVDB_LOWERS].offset)
            continue;
        uint8_t flip = (uint8_t)(scene_next(&random) % 255 + 1);
        bytes[at] ^= flip;
        if (forged)
            forge(bytes, file.size, &file.layout);
        struct fmt_nvdb_grid grid;
        if (open_bytes(file.ctx, bytes, file.size, &grid) == 0) {
            accepted++;
            look_up(&grid, &file.scene, true);
            /* Tables are mostly entries without a child, so a sample of them is enough. */
            if ((accepted < 2000 || accepted % 64 == 0) && !forged)
                assert_int_equal(fmt_nvdb_verify(file.ctx, &grid), BSQ_EDATA);
        } else if (at >= file.layout.section[NVDB_NORMALS].offset &&
                   at < file.layout.section[NVDB_SECONDS].offset) {
            fail_msg("channels are not read on opening, but byte %llu matters: %s",
                     (unsigned long long)at, bsq_error(file.ctx));
        }
        memcpy(bytes + at, file.bytes + at, 1);
        if (forged)
            forge(bytes, file.size, &file.layout);
    }
    assert_memory_equal(bytes, file.bytes, file.size);
    free(bytes);
    small_file_close(&file);
}

TEST(test_flipped)
{
    flip_bytes(FMT_NVDB_MASK, false, TEST_SANITIZED ? 61 : 1);
}

/* Changes several words at a time in any section, and corrects the checksums. */
TEST(test_forged)
{
    static const uint64_t values[] = {0, 1, UINT64_MAX, INT64_MAX, UINT32_MAX, 96, 33856, 270400};
    struct small_file file;
    small_file_open(&file, FMT_NVDB_ONINDEX);
    uint64_t seed = 4711, random = seed, accepted = 0;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (int round = 0; round < 6000; round++) {
        uint8_t *bytes = malloc(file.size);
        memcpy(bytes, file.bytes, file.size);
        uint64_t hits = 1 + scene_next(&random) % 3;
        for (uint64_t i = 0; i < hits; i++) {
            const struct nvdb_range *range =
                &file.layout.section[scene_next(&random) % NVDB_SECTION_COUNT];
            if (range->size == 0) /* the grid has no ids */
                continue;
            uint64_t at = range->offset + scene_next(&random) % (range->size / 4) * 4;
            uint64_t value = scene_next(&random) % 2
                                 ? values[scene_next(&random) % 8]
                                 : scene_next(&random) >> scene_next(&random) % 64;
            uint64_t size = file.size - at < 8 || scene_next(&random) % 2 ? 4 : 8;
            memcpy(bytes + at, &value, size);
        }
        forge(bytes, file.size, &file.layout);
        struct fmt_nvdb_grid grid;
        if (open_bytes(file.ctx, bytes, file.size, &grid) == 0) {
            look_up(&grid, &file.scene, false);
            accepted++;
        }
        free(bytes);
    }
    assert_true(accepted > 0); /* e.g. channels and empty table entries */
    small_file_close(&file);
    flip_bytes(FMT_NVDB_ONINDEX, true, 13);
}

/* ---- bytes that Bisque does not use ---- */

/* Corrects all checksums. */
static void forge_all(uint8_t *bytes, uint64_t size, const struct nvdb_layout *layout)
{
    struct nvdb_trailer *trailer = (void *)(bytes + size - sizeof(*trailer));
    forge(bytes, size, layout);
    for (int i = 0; i < NVDB_IDS; i++)
        trailer->checksum[i] =
            XXH3_64bits(bytes + layout->section[i].offset, layout->section[i].size);
    forge(bytes, size, layout);
}

/* Sets four bytes, and checks that opening or else verifying the file fails with this message. */
static void assert_refused(const struct small_file *file, uint64_t at, uint32_t value,
                           const char *message)
{
    uint8_t *bytes = malloc(file->size);
    struct fmt_nvdb_grid grid;
    memcpy(bytes, file->bytes, file->size);
    memcpy(bytes + at, &value, sizeof(value));
    forge_all(bytes, file->size, &file->layout);
    int status = open_bytes(file->ctx, bytes, file->size, &grid);
    if (status == 0)
        status = fmt_nvdb_verify(file->ctx, &grid);
    assert_int_equal(status, BSQ_EDATA);
    if (!strstr(bsq_error(file->ctx), message))
        fail_msg("\"%s\" does not say \"%s\"", bsq_error(file->ctx), message);
    free(bytes);
}

/* Other programs may use them, so they are as FORMATS.md says. */
TEST(test_unused_bytes)
{
    struct small_file file;
    small_file_open(&file, FMT_NVDB_ONINDEX);
    const uint64_t grid = FMT_NVDB_GRID_OFFSET, root = file.layout.root;
    const uint64_t map = grid + offsetof(struct nvdb_grid_data, map);
    assert_refused(&file, grid + offsetof(struct nvdb_grid_data, grid_index), 1, "GridData");
    assert_refused(&file, grid + offsetof(struct nvdb_grid_data, name) + 20, 1, "GridData");
    assert_refused(&file, map + offsetof(struct nvdb_map, inverse_f), 1, "GridData");
    assert_refused(&file, map + offsetof(struct nvdb_map, inverse), 1, "GridData");
    assert_refused(&file, map + offsetof(struct nvdb_map, matrix) + 12, 1u << 31, "GridData");
    /* An edge whose inverse is not finite. */
    assert_refused(&file, map + offsetof(struct nvdb_map, matrix) + 4, 0x00001000, "voxel size");
    assert_refused(&file, root + sizeof(struct nvdb_root), 1, "RootData");

    const uint64_t trailer = file.size - sizeof(struct nvdb_trailer);
    assert_refused(&file, trailer + offsetof(struct nvdb_trailer, channels_checksum), 1,
                   "\"bisque\" trailer");
    const uint64_t upper = file.layout.section[NVDB_UPPERS].offset;
    assert_refused(&file, upper + offsetof(struct nvdb_upper, flags), 3, "flag");
    assert_refused(&file, upper + offsetof(struct nvdb_upper, statistics), 1, "statistic");
    assert_refused(&file, upper + sizeof(struct nvdb_upper) - 8, 1, "offset without a child");
    const uint64_t lower = file.layout.section[NVDB_LOWERS].offset;
    assert_refused(&file, lower + offsetof(struct nvdb_lower, flags), 0, "flag");
    assert_refused(&file, lower + offsetof(struct nvdb_lower, statistics), 1, "statistic");
    assert_refused(&file, lower + sizeof(struct nvdb_lower) - 8, 1, "offset without a child");
    const uint64_t planes = file.layout.section[NVDB_PLANES].offset;
    assert_refused(&file, planes + 4, FMT_NVDB_PLANE_MAX + 1, "plane");
    assert_refused(&file, planes + 4, 65536 - FMT_NVDB_PLANE_MAX - 1, "plane");
    small_file_close(&file);
}

static void assert_open_fails(const uint8_t *bytes, uint64_t size, const char *expected)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    FILE *file = fopen(nvdb_path, "wb");
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    fclose(file);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(ctx, nvdb_path, &grid), BSQ_EDATA);
    if (!strstr(bsq_error(ctx), expected))
        fail_msg("\"%s\" does not say \"%s\"", bsq_error(ctx), expected);
    bsq_ctx_destroy(ctx);
}

TEST(test_messages)
{
    struct small_file file;
    small_file_open(&file, FMT_NVDB_MASK);
    uint8_t *bytes = file.bytes;
    assert_open_fails(bytes, 0, "not a NanoVDB file");
    assert_open_fails((const uint8_t *)"v 1 2 3\nv 4 5 6\n", 16, "not a NanoVDB file");
    assert_open_fails(bytes, 999, "truncated");
    assert_open_fails(bytes, file.size - 1, "truncated");
    uint32_t version = NVDB_VERSION(33, 1, 2);
    memcpy(bytes + 8, &version, 4);
    assert_open_fails(bytes, file.size, "version 33.1.2");
    version = NVDB_VERSION(32, 7, 0);
    memcpy(bytes + 8, &version, 4);
    assert_open_fails(bytes, file.size, "version 32.7.0");
    version = NVDB_VERSION_MASK;
    memcpy(bytes + 8, &version, 4);
    struct nvdb_trailer *trailer = (void *)(bytes + file.size - sizeof(*trailer));
    trailer->version = 9;
    assert_open_fails(bytes, file.size, "version 9");
    trailer->version = FMT_NVDB_TRAILER_VERSION;
    struct bsq_ctx *ctx = test_context(1, 0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(ctx, "/nowhere/a.nvdb", &grid), BSQ_ENOINPUT);
    bsq_ctx_destroy(ctx);
    small_file_close(&file);
}

RUN_TESTS(NULL, NULL)

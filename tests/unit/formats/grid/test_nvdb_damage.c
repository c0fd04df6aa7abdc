/* test_nvdb_damage.c - grid files that are truncated, and each byte of which is changed.
 * tests/cli/test_oracle.sh judges files whose checksums are right. */
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

/* Looks up all voxels of the scene. */
static void look_up(const struct fmt_nvdb_grid *grid, const struct scene *scene)
{
    for (uint64_t i = 0; i < scene->count; i++) {
        uint64_t index = grid_find(grid, scene->voxels[i].ijk);
        assert_int_equal(index, i + 1);
        assert_true(fmt_nvdb_second(grid, index) < grid->record_count);
    }
}

struct small_file {
    struct bsq_ctx *ctx;
    struct scene scene;
    uint8_t *bytes;
    uint64_t size;
    struct fmt_nvdb_layout layout;
};

static void small_file_open(struct small_file *file)
{
    file->ctx = test_context(1, 0);
    scene_random(&file->scene, 7, 12);
    /* One root tile is enough; each of its bytes is changed. */
    uint64_t kept = 0;
    for (uint64_t i = 0; i < file->scene.count; i++) {
        struct scene_voxel *v = &file->scene.voxels[i];
        if (v->ijk[0] >= 0 && v->ijk[1] >= 0 && v->ijk[2] >= 0 && v->ijk[0] < 300 &&
            v->ijk[1] < 300 && v->ijk[2] < 300)
            file->scene.voxels[kept++] = *v;
    }
    file->scene.count = kept;
    struct fmt_nvdb_totals totals;
    assert_ok(file->ctx, scene_write(file->ctx, nvdb_path, &file->scene, &totals));
    assert_int_equal(totals.uppers, 1);
    assert_true(totals.lowers > 1);
    file->bytes = test_read(nvdb_path, &file->size);
    struct fmt_nvdb_grid grid;
    assert_ok(file->ctx, open_bytes(file->ctx, file->bytes, file->size, &grid));
    file->layout = grid.layout;
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
    small_file_open(&file);
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
TEST(test_flipped)
{
    const uint64_t stride = TEST_SANITIZED ? 61 : 1;
    struct small_file file;
    small_file_open(&file);
    uint64_t accepted = 0, random = 77;
    uint8_t *bytes = malloc(file.size);
    memcpy(bytes, file.bytes, file.size);
    uint64_t table = file.layout.section[NVDB_UPPERS].offset + offsetof(struct nvdb_upper, table);
    for (uint64_t at = 0; at < file.size; at++) {
        if (at > table && at % stride != 0 && at < file.layout.section[NVDB_LOWERS].offset)
            continue;
        uint8_t flip = (uint8_t)(scene_next(&random) % 255 + 1);
        bytes[at] ^= flip;
        struct fmt_nvdb_grid grid;
        if (open_bytes(file.ctx, bytes, file.size, &grid) == 0) {
            accepted++;
            look_up(&grid, &file.scene);
            /* Tables are mostly entries without a child, so a sample of them is enough. */
            if (accepted < 2000 || accepted % 64 == 0)
                assert_int_equal(fmt_nvdb_verify(file.ctx, &grid), BSQ_EDATA);
        } else if (at >= file.layout.section[NVDB_NORMALS].offset &&
                   at < file.layout.section[NVDB_SECONDS].offset) {
            fail_msg("channels are not read on opening, but byte %llu matters: %s",
                     (unsigned long long)at, bsq_error(file.ctx));
        }
        memcpy(bytes + at, file.bytes + at, 1);
    }
    assert_memory_equal(bytes, file.bytes, file.size);
    free(bytes);
    small_file_close(&file);
}

RUN_TESTS(NULL, NULL)

/* test_nvdb.c - .nvdb files: written grids against a plain list of voxels, bad use, damaged files.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "formats/nvdb_writer_internal.h"
#include "tests/unit/formats/nvdb_scene.h"
#include "tests/unit/sanitized.h"

static char directory[] = "/tmp/bsq-test-nvdb-XXXXXX";
static char path[64], other_path[64];

static int make_directory(void **state)
{
    (void)state;
    if (!mkdtemp(directory))
        return -1;
    snprintf(path, sizeof(path), "%s/a.nvdb", directory);
    snprintf(other_path, sizeof(other_path), "%s/b.nvdb", directory);
    return 0;
}

static int remove_directory(void **state)
{
    (void)state;
    unlink(path);
    unlink(other_path);
    return rmdir(directory);
}

static struct bsq_ctx *new_context(unsigned threads, uint64_t memory)
{
    struct bsq_ctx_options options = {.threads = threads, .memory_bytes = memory};
    struct bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

#define assert_ok(ctx, call)                                                                       \
    do {                                                                                           \
        int assert_ok_status = (call);                                                             \
        if (assert_ok_status)                                                                      \
            fail_msg("%s: %d, %s", #call, assert_ok_status, bsq_error(ctx));                       \
    } while (0)

static uint8_t *read_file(const char *name, uint64_t *size)
{
    FILE *file = fopen(name, "rb");
    assert_non_null(file);
    struct stat info;
    assert_int_equal(fstat(fileno(file), &info), 0);
    *size = (uint64_t)info.st_size;
    uint8_t *bytes = malloc(*size);
    assert_int_equal(fread(bytes, 1, *size, file), *size);
    fclose(file);
    return bytes;
}

/* ---- what was written is found again ---- */

static void assert_record(const struct fmt_nvdb_grid *grid, uint64_t index,
                          const struct fmt_nvdb_record *expected)
{
    struct fmt_nvdb_record record = fmt_nvdb_get(grid, index);
    assert_int_equal(record.normal, expected->normal);
    assert_int_equal(record.plane, expected->plane);
    assert_int_equal(record.color, grid->info.has_color ? expected->color : 0);
}

static void compare_with_scene(const struct fmt_nvdb_grid *grid, const struct scene *scene,
                               uint64_t seed)
{
    uint64_t seconds = 0;
    for (uint64_t i = 0; i < scene->count; i++) {
        const struct scene_voxel *v = &scene->voxels[i];
        uint64_t index = fmt_nvdb_find(grid, v->ijk);
        assert_int_equal(index, i + 1);
        assert_record(grid, index, &v->first);
        uint64_t second = fmt_nvdb_second(grid, index);
        if (v->first.plane & FMT_NVDB_PLANE_SECOND) {
            assert_int_equal(second, 1 + scene->count + seconds);
            assert_record(grid, second, &v->second);
            seconds++;
        } else {
            assert_int_equal(second, 0);
        }
    }
    for (uint64_t i = 0; i < 20000; i++) {
        const int32_t *near = scene->voxels[scene_next(&seed) % scene->count].ijk;
        int32_t ijk[3];
        for (int axis = 0; axis < 3; axis++)
            ijk[axis] = (int32_t)((uint32_t)near[axis] + (uint32_t)(scene_next(&seed) % 9) - 4);
        uint64_t expected = scene_find(scene, ijk);
        assert_int_equal(fmt_nvdb_find(grid, ijk), expected == UINT64_MAX ? 0 : expected + 1);
    }
}

static void compare_totals(const struct fmt_nvdb_grid *grid, const struct scene *scene,
                           const struct fmt_nvdb_totals *totals)
{
    assert_int_equal(totals->voxels, scene->count);
    assert_int_equal(totals->second_records, scene->second_count);
    assert_int_equal(totals->leaves, scene_nodes(scene, 8));
    assert_int_equal(totals->lowers, scene_nodes(scene, 128));
    assert_int_equal(totals->uppers, scene_nodes(scene, 4096));
    assert_int_equal(totals->file_bytes, grid->map.size);
    assert_int_equal(grid->voxel_count, scene->count);
    assert_int_equal(grid->record_count, 1 + scene->count + scene->second_count);
    assert_int_equal(grid->leaf_count, totals->leaves);
    assert_int_equal(grid->lower_count, totals->lowers);
    assert_int_equal(grid->upper_count, totals->uppers);
    assert_int_equal(grid->tile_count, totals->uppers);
    for (int axis = 0; axis < 3; axis++) {
        int32_t low = INT32_MAX, high = INT32_MIN;
        for (uint64_t i = 0; i < scene->count; i++) {
            int32_t at = scene->voxels[i].ijk[axis];
            low = at < low ? at : low;
            high = at > high ? at : high;
        }
        assert_int_equal(grid->index_min[axis], low);
        assert_int_equal(grid->index_max[axis], high);
    }
}

static void compare_info(const struct fmt_nvdb_info *info, const struct fmt_nvdb_info *expected)
{
    assert_int_equal(info->type, expected->type);
    assert_int_equal(info->has_color, expected->has_color);
    assert_int_equal(info->source_triangles, expected->source_triangles);
    assert_memory_equal(&info->voxel_size, &expected->voxel_size, sizeof(double));
    assert_memory_equal(info->translation, expected->translation, sizeof(info->translation));
    assert_memory_equal(info->scan_min, expected->scan_min, sizeof(info->scan_min));
    assert_memory_equal(info->scan_max, expected->scan_max, sizeof(info->scan_max));
}

static void round_trip(uint64_t seed, unsigned per_cluster, enum fmt_nvdb_type type, bool color)
{
    print_message("seed %llu\n", (unsigned long long)seed);
    struct bsq_ctx *ctx = new_context(2, 0);
    struct scene scene;
    scene_random(&scene, seed, per_cluster, true);
    scene.info.type = type;
    scene.info.has_color = color;
    struct fmt_nvdb_totals totals;
    assert_ok(ctx, scene_write(ctx, path, &scene, &totals));
    struct fmt_nvdb_grid grid;
    assert_ok(ctx, fmt_nvdb_open(ctx, path, &grid));
    compare_info(&grid.info, &scene.info);
    compare_totals(&grid, &scene, &totals);
    compare_with_scene(&grid, &scene, seed * 2 + 1);
    assert_int_equal(grid.colors != NULL, color);
    assert_int_equal(grid.normals[0] | grid.planes[0], 0); /* the background */
    assert_int_equal((uintptr_t)grid.normals % 64, 0);
    assert_int_equal((uintptr_t)grid.planes % 64, 0);
    assert_int_equal((uintptr_t)grid.colors % 64, 0);
    assert_int_equal((uintptr_t)grid.seconds % 64, 0);
    assert_ok(ctx, fmt_nvdb_verify(ctx, &grid));
    fmt_nvdb_close(ctx, &grid);
    scene_free(&scene);
    assert_int_equal(bsq_memory_used(ctx), 0);
    bsq_ctx_destroy(ctx);
}

static void test_round_trip(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 4; seed++)
        for (int variant = 0; variant < 4; variant++)
            round_trip(seed, seed == 1 ? 1 : 3000, variant & 1 ? FMT_NVDB_ONINDEX : FMT_NVDB_MASK,
                       variant & 2);
}

/* Every voxel of two regions set: full masks, words of second records at their limits. */
static void test_full_leaves(void **state)
{
    (void)state;
    struct bsq_ctx *ctx = new_context(2, 0);
    struct scene scene;
    scene_random(&scene, 9, 1, false);
    free(scene.voxels);
    scene.count = 1024;
    scene.voxels = calloc(scene.count, sizeof(*scene.voxels));
    for (uint64_t i = 0; i < scene.count; i++) {
        int32_t *ijk = scene.voxels[i].ijk;
        ijk[0] = (int32_t)(i / 64 % 8);
        ijk[1] = (int32_t)(i / 8 % 8);
        ijk[2] = (int32_t)(i % 8) + 120 + (int32_t)(i / 512) * 8; /* 120..127, then 128..135 */
        scene.voxels[i].first.plane = FMT_NVDB_PLANE_SECOND;
        scene.voxels[i].first.normal = (uint32_t)i;
        scene.voxels[i].second.normal = (uint32_t)(i + 5000);
    }
    scene.second_count = scene.count;
    struct fmt_nvdb_totals totals;
    assert_ok(ctx, scene_write(ctx, path, &scene, &totals));
    struct fmt_nvdb_grid grid;
    assert_ok(ctx, fmt_nvdb_open(ctx, path, &grid));
    assert_int_equal(totals.lowers, 2);
    compare_with_scene(&grid, &scene, 3);
    assert_ok(ctx, fmt_nvdb_verify(ctx, &grid));
    fmt_nvdb_close(ctx, &grid);
    scene_free(&scene);
    bsq_ctx_destroy(ctx);
}

static void test_same_bytes(void **state)
{
    (void)state;
    struct scene scene;
    scene_random(&scene, 5, 20000, true);
    const char *names[2] = {path, other_path};
    uint8_t *bytes[2];
    uint64_t size[2];
    for (int i = 0; i < 2; i++) {
        struct bsq_ctx *ctx = new_context(i ? 3 : 1, i ? 0 : UINT64_C(8) << 20);
        struct fmt_nvdb_totals totals;
        assert_ok(ctx, scene_write(ctx, names[i], &scene, &totals));
        assert_true(bsq_memory_high(ctx) < UINT64_C(4) << 20);
        bsq_ctx_destroy(ctx);
        bytes[i] = read_file(names[i], &size[i]);
    }
    assert_int_equal(size[0], size[1]);
    assert_int_equal(memcmp(bytes[0], bytes[1], size[0]), 0);
    free(bytes[0]);
    free(bytes[1]);
    scene_free(&scene);
}

/* ---- NanoVDB's own tools ---- */

/* Runs a command; false where it is not installed. */
static bool run(const char *command, char *output, size_t size, int *status)
{
    char line[256];
    snprintf(line, sizeof(line), "%s 2>&1", command);
    FILE *pipe = popen(line, "r");
    assert_non_null(pipe);
    size_t got = fread(output, 1, size - 1, pipe);
    output[got] = 0;
    *status = WEXITSTATUS(pclose(pipe));
    return *status != 127;
}

static void test_nanovdb_tools(void **state)
{
    (void)state;
    struct bsq_ctx *ctx = new_context(1, 0);
    struct scene scene;
    scene_random(&scene, 6, 2000, false);
    struct fmt_nvdb_totals totals;
    assert_ok(ctx, scene_write(ctx, path, &scene, &totals));
    char command[128], output[4096], voxels[32];
    int status;
    snprintf(command, sizeof(command), "nanovdb_validate -v %s", path);
    bool installed = run(command, output, sizeof(output), &status);
    if (installed) {
        print_message("%s", output);
        assert_int_equal(status, 0);
        assert_non_null(strstr(output, "passed"));
        snprintf(command, sizeof(command), "nanovdb_print -l %s", path);
        assert_true(run(command, output, sizeof(output), &status));
        print_message("%s", output);
        assert_int_equal(status, 0);
        assert_non_null(strstr(output, "surface"));
        assert_non_null(strstr(output, "Mask"));
        assert_non_null(strstr(output, "TOPO"));
        assert_non_null(strstr(output, "32.4.2"));
        snprintf(voxels, sizeof(voxels), " %llu ", (unsigned long long)scene.count);
        assert_non_null(strstr(output, voxels));
    }
    scene_free(&scene);
    bsq_ctx_destroy(ctx);
    if (!installed)
        skip();
}

/* ---- wrong use of the writer ---- */

static const uint16_t two_ids[2] = {7, 9};
static const uint64_t two_masks[2][8] = {{1, 0, 0, 0, 0, 0, 0, 0}, {0, 0, 0, 0, 2, 0, 0, 0}};
static const struct fmt_nvdb_record two_records[2] = {{1, 2, 3}, {4, 5, 6}};

static struct fmt_nvdb_region small_region(int32_t x, int32_t y, int32_t z)
{
    return (struct fmt_nvdb_region){.origin = {x, y, z},
                                    .leaf_count = 2,
                                    .leaf_ids = two_ids,
                                    .masks = two_masks,
                                    .record_count = 2,
                                    .records = two_records};
}

static struct fmt_nvdb_writer *new_writer(struct bsq_ctx *ctx)
{
    struct fmt_nvdb_info info = {.type = FMT_NVDB_MASK, .voxel_size = 1};
    struct fmt_nvdb_writer *writer;
    assert_ok(ctx, fmt_nvdb_create(ctx, path, &info, &writer));
    return writer;
}

/* Appends `first` (which is right) and `second`, which has to be refused as `expected`. */
static void assert_refused(const struct fmt_nvdb_region *first,
                           const struct fmt_nvdb_region *second, const char *expected)
{
    unlink(path);
    struct bsq_ctx *ctx = new_context(1, 0);
    struct fmt_nvdb_writer *writer = new_writer(ctx);
    if (first)
        assert_ok(ctx, fmt_nvdb_append(writer, first));
    assert_int_equal(fmt_nvdb_append(writer, second), BSQ_EBUG);
    assert_non_null(strstr(bsq_error(ctx), expected));
    struct fmt_nvdb_totals totals;
    assert_int_equal(fmt_nvdb_commit(writer, &totals), BSQ_EBUG);
    assert_int_equal(access(path, F_OK), -1);
    assert_int_equal(bsq_memory_used(ctx), 0);
    bsq_ctx_destroy(ctx);
}

/* A region in one call and in two: the same file. */
static void test_region_in_parts(void **state)
{
    (void)state;
    uint64_t masks[3][8] = {{1, 0, 0, 0, 0, 0, 0, 5}, {0, 2}, {UINT64_MAX, 3}};
    uint16_t ids[3] = {7, 8, 4095};
    struct fmt_nvdb_record records[70], second = {5, 6, 0};
    for (uint32_t i = 0; i < 70; i++)
        records[i] = (struct fmt_nvdb_record){i, 2 * i, 0};
    records[3].plane |= FMT_NVDB_PLANE_SECOND;
    struct fmt_nvdb_region whole = {.origin = {128, 0, 0},
                                    .leaf_count = 3,
                                    .leaf_ids = ids,
                                    .masks = (const uint64_t(*)[8])masks,
                                    .record_count = 70,
                                    .second_count = 1,
                                    .records = records,
                                    .second = &second};
    struct fmt_nvdb_region first = whole, rest = whole, after = small_region(128, 0, 128);
    first.leaf_count = 1;
    first.record_count = 3;
    first.second_count = 0;
    rest.leaf_count = 2;
    rest.leaf_ids++;
    rest.masks++;
    rest.record_count -= 3;
    rest.records += 3;
    struct fmt_nvdb_totals totals;
    struct bsq_map map[2];
    struct bsq_ctx *ctx = new_context(1, 0);
    char copy[sizeof path + 8];
    snprintf(copy, sizeof copy, "%s.whole", path);
    for (int parts = 0; parts < 2; parts++) {
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        assert_ok(ctx, fmt_nvdb_append(writer, parts ? &first : &whole));
        if (parts)
            assert_ok(ctx, fmt_nvdb_append(writer, &rest));
        assert_ok(ctx, fmt_nvdb_append(writer, &after));
        assert_ok(ctx, fmt_nvdb_commit(writer, &totals));
        assert_int_equal(totals.lowers, 2);
        assert_int_equal(totals.leaves, 3 + after.leaf_count);
        if (!parts)
            assert_int_equal(rename(path, copy), 0);
    }
    assert_ok(ctx, bsq_map_open(ctx, copy, &map[0]));
    assert_ok(ctx, bsq_map_open(ctx, path, &map[1]));
    assert_int_equal(map[0].size, map[1].size);
    assert_memory_equal(map[0].data, map[1].data, map[0].size);
    bsq_map_close(ctx, &map[0]);
    bsq_map_close(ctx, &map[1]);
    unlink(copy);
    unlink(path);
    bsq_ctx_destroy(ctx);
    assert_refused(&rest, &first, "out of order");
}

static void test_order_of_regions(void **state)
{
    (void)state;
    /* Left comes before right; negative root tiles come after positive ones. */
    static const int32_t ordered[][2][3] = {
        {{0, 0, 0}, {0, 0, 128}},       {{0, 0, 128}, {0, 128, 0}},
        {{0, 128, 0}, {128, 0, 0}},     {{3968, 0, 0}, {0, 0, 4096}},
        {{0, 0, 4096}, {0, 0, -128}},   {{0, 0, -128}, {-128, 0, 0}},
        {{-4096, 0, 0}, {-128, 0, 0}},  {{-8192, 0, 0}, {-4096, 0, 0}},
        {{128, 0, 0}, {4096, -128, 0}},
    };
    for (size_t i = 0; i < sizeof(ordered) / sizeof(*ordered); i++) {
        const int32_t *a = ordered[i][0], *b = ordered[i][1];
        struct fmt_nvdb_region left = small_region(a[0], a[1], a[2]);
        struct fmt_nvdb_region right = small_region(b[0], b[1], b[2]);
        assert_refused(&right, &left, "out of order");
        assert_refused(&left, &left, "out of order");
        struct bsq_ctx *ctx = new_context(1, 0);
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        assert_ok(ctx, fmt_nvdb_append(writer, &left));
        assert_ok(ctx, fmt_nvdb_append(writer, &right));
        fmt_nvdb_discard(writer);
        bsq_ctx_destroy(ctx);
    }
}

static void test_wrong_regions(void **state)
{
    (void)state;
    static const uint16_t descending[2] = {9, 7}, large[2] = {7, 4096};
    static const uint64_t empty[2][8] = {{1, 0, 0, 0, 0, 0, 0, 0}, {0}};
    static const struct fmt_nvdb_record flagged[2] = {{1, FMT_NVDB_PLANE_SECOND, 3}, {4, 5, 6}};
    struct fmt_nvdb_region region = small_region(0, 0, 64);
    assert_refused(NULL, &region, "multiple of 128");
    region = small_region(0, 0, 0);
    region.leaf_ids = descending;
    assert_refused(NULL, &region, "ascending");
    region.leaf_ids = large;
    assert_refused(NULL, &region, "ascending");
    region = small_region(0, 0, 0);
    region.masks = empty;
    assert_refused(NULL, &region, "without voxels");
    region = small_region(0, 0, 0);
    region.record_count = 1;
    assert_refused(NULL, &region, "records");
    region = small_region(0, 0, 0);
    region.records = flagged;
    assert_refused(NULL, &region, "second");
}

static void test_nothing_to_write(void **state)
{
    (void)state;
    unlink(path);
    struct bsq_ctx *ctx = new_context(1, 0);
    struct fmt_nvdb_writer *writer = new_writer(ctx);
    struct fmt_nvdb_region nothing = {.origin = {0, 0, 0}};
    assert_ok(ctx, fmt_nvdb_append(writer, &nothing));
    struct fmt_nvdb_totals totals;
    assert_int_equal(fmt_nvdb_commit(writer, &totals), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(ctx), "no voxels"));
    assert_int_equal(access(path, F_OK), -1);
    bsq_ctx_destroy(ctx);
}

static void test_limits(void **state)
{
    (void)state;
    static const struct fmt_nvdb_record flagged[2] = {{1, FMT_NVDB_PLANE_SECOND, 3}, {4, 5, 6}};
    for (int i = 0; i < 3; i++) {
        struct bsq_ctx *ctx = new_context(1, 0);
        struct fmt_nvdb_writer *writer = new_writer(ctx);
        struct fmt_nvdb_region region = small_region(0, 0, 0);
        region.records = region.second = flagged;
        region.second_count = 1;
        if (i == 0)
            writer->counts.leaves = UINT32_MAX - 1;
        else if (i == 1)
            writer->counts.lowers = UINT32_MAX;
        else
            writer->counts.seconds = UINT32_MAX;
        assert_int_equal(fmt_nvdb_append(writer, &region), BSQ_EUSAGE);
        assert_non_null(strstr(bsq_error(ctx), "4294967295"));
        fmt_nvdb_discard(writer);
        bsq_ctx_destroy(ctx);
    }
}

static void test_unwritable(void **state)
{
    (void)state;
    struct bsq_ctx *ctx = new_context(1, 0);
    struct fmt_nvdb_info info = {.type = FMT_NVDB_MASK, .voxel_size = 1};
    struct fmt_nvdb_writer *writer;
    assert_int_equal(fmt_nvdb_create(ctx, "/nowhere/a.nvdb", &info, &writer), BSQ_ECANTCREAT);
    assert_null(writer);
    bsq_clear_error(ctx);
    info.voxel_size = 0;
    assert_int_equal(fmt_nvdb_create(ctx, path, &info, &writer), BSQ_EUSAGE);
    assert_int_equal(bsq_memory_used(ctx), 0);
    bsq_ctx_destroy(ctx);
}

/* ---- damaged files ---- */

/* Opens a copy of `size` bytes that ends where it ends, so that the sanitizer sees any access
 * behind it. */
static int open_bytes(struct bsq_ctx *ctx, const uint8_t *bytes, uint64_t size,
                      struct fmt_nvdb_grid *grid)
{
    bsq_clear_error(ctx);
    memset(grid, 0, sizeof(*grid));
    grid->map = (struct bsq_map){.data = bytes, .size = size, .path = (char *)"x.nvdb"};
    int status = nvdb_check_head(ctx, grid);
    if (status == 0)
        status = nvdb_check_nodes(ctx, grid);
    if (status) {
        assert_int_equal(status, BSQ_EDATA);
        assert_int_equal(strncmp(bsq_error(ctx), "x.nvdb: ", 8), 0);
    }
    return status;
}

/* Looks up everything; where `right`, the answers have to be those of the scene. */
static void look_up(const struct fmt_nvdb_grid *grid, const struct scene *scene, bool right)
{
    for (uint64_t i = 0; i < scene->count; i++) {
        uint64_t index = fmt_nvdb_find(grid, scene->voxels[i].ijk);
        if (right)
            assert_int_equal(index, i + 1);
        assert_true(index < grid->record_count);
        if (index > 0) {
            struct fmt_nvdb_record record = fmt_nvdb_get(grid, index);
            (void)record;
        }
        assert_true(fmt_nvdb_second(grid, index) < grid->record_count);
    }
}

/* Makes the checksums that fmt_nvdb_open() looks at fit the bytes, as a forger would. */
static void forge(uint8_t *bytes, uint64_t size, const struct nvdb_layout *layout)
{
    uint32_t crc = nvdb_head_crc(bytes, layout);
    memcpy(bytes + FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, checksum), &crc, 4);
    struct nvdb_record record;
    memcpy(&record, bytes + size - sizeof(record), sizeof(record));
    record.record_checksum = nvdb_record_checksum(&record);
    memcpy(bytes + size - sizeof(record), &record, sizeof(record));
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
    file->ctx = new_context(1, 0);
    scene_random(&file->scene, 7, 12, false);
    /* One root tile is enough, and every byte of it is tried. */
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
    assert_ok(file->ctx, scene_write(file->ctx, path, &file->scene, &totals));
    assert_int_equal(totals.uppers, 1);
    assert_true(totals.lowers > 1);
    file->bytes = read_file(path, &file->size);
    struct fmt_nvdb_grid grid;
    assert_ok(file->ctx, open_bytes(file->ctx, file->bytes, file->size, &grid));
    nvdb_layout_of(&grid, &file->layout);
}

static void small_file_close(struct small_file *file)
{
    free(file->bytes);
    scene_free(&file->scene);
    bsq_ctx_destroy(file->ctx);
}

static void test_truncated(void **state)
{
    (void)state;
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

/* With `stride`, only each of so many bytes is tried in the table of the upper node, which is
 * 256 KiB of entries that are alike. */
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

static void test_flipped(void **state)
{
    (void)state;
    flip_bytes(FMT_NVDB_MASK, false, TEST_SANITIZED ? 61 : 1);
}

/* The head, where forging has an effect, and many words at a time anywhere. */
static void test_forged(void **state)
{
    (void)state;
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

static void assert_open_fails(const uint8_t *bytes, uint64_t size, const char *expected)
{
    struct bsq_ctx *ctx = new_context(1, 0);
    FILE *file = fopen(path, "wb");
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    fclose(file);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(ctx, path, &grid), BSQ_EDATA);
    if (!strstr(bsq_error(ctx), expected))
        fail_msg("\"%s\" does not say \"%s\"", bsq_error(ctx), expected);
    bsq_ctx_destroy(ctx);
}

static void test_messages(void **state)
{
    (void)state;
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
    struct nvdb_record *record = (void *)(bytes + file.size - sizeof(*record));
    record->version = 9;
    assert_open_fails(bytes, file.size, "version 9");
    record->version = NVDB_RECORD_VERSION;
    struct bsq_ctx *ctx = new_context(1, 0);
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(ctx, "/nowhere/a.nvdb", &grid), BSQ_ENOINPUT);
    bsq_ctx_destroy(ctx);
    small_file_close(&file);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip),       cmocka_unit_test(test_full_leaves),
        cmocka_unit_test(test_same_bytes),       cmocka_unit_test(test_nanovdb_tools),
        cmocka_unit_test(test_region_in_parts),
        cmocka_unit_test(test_order_of_regions), cmocka_unit_test(test_wrong_regions),
        cmocka_unit_test(test_nothing_to_write), cmocka_unit_test(test_limits),
        cmocka_unit_test(test_unwritable),       cmocka_unit_test(test_truncated),
        cmocka_unit_test(test_flipped),          cmocka_unit_test(test_forged),
        cmocka_unit_test(test_messages),
    };
    return cmocka_run_group_tests(tests, make_directory, remove_directory);
}

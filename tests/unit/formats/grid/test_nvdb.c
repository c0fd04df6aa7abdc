/* test_nvdb.c - compares written grids with a plain list of voxels, and runs NanoVDB's tools on
 * them.
 */
#include "formats/grid/nvdb_writer_internal.h"
#include "tests/unit/test.h"
#include "tests/unit/formats/grid/nvdb_files.h"
#include "tests/unit/formats/grid/nvdb_scene.h"
#include "tests/grid_lookup.h"

/* ---- round trips ---- */

static void assert_record(const struct fmt_nvdb_grid *grid, uint64_t index,
                          const struct fmt_nvdb_record *expected)
{
    struct fmt_nvdb_record record = grid_get(grid, index);
    assert_int_equal(record.normal, expected->normal);
    assert_int_equal(record.plane, expected->plane);
    assert_int_equal(record.color, grid->info.has_color ? expected->color : 0);
}

/* Checks the channels of a record, if the scene has any. */
static void assert_channels(const struct fmt_nvdb_grid *grid, uint64_t index, const int32_t ijk[3],
                            bool second)
{
    for (uint32_t k = 0; k < grid->channel_words; k++) {
        const float value = grid->channels[index * grid->channel_words + k];
        assert_float_equal(value, scene_channel(ijk, k, second), 0);
    }
}

static void compare_with_scene(const struct fmt_nvdb_grid *grid, const struct scene *scene,
                               uint64_t seed)
{
    uint64_t seconds = 0;
    for (uint64_t i = 0; i < scene->count; i++) {
        const struct scene_voxel *v = &scene->voxels[i];
        uint64_t index = grid_find(grid, v->ijk);
        assert_int_equal(index, i + 1);
        assert_record(grid, index, &v->first);
        assert_channels(grid, index, v->ijk, false);
        uint64_t second = fmt_nvdb_second(grid, index);
        if (v->first.plane & FMT_NVDB_PLANE_SECOND) {
            assert_int_equal(second, 1 + scene->count + seconds);
            assert_record(grid, second, &v->second);
            assert_channels(grid, second, v->ijk, true);
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
        assert_int_equal(grid_find(grid, ijk), expected == UINT64_MAX ? 0 : expected + 1);
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
    assert_int_equal(grid->root_tile_count, totals->uppers);
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
    struct bsq_ctx *ctx = test_context(2, 0);
    struct scene scene;
    scene_random(&scene, seed, per_cluster, true);
    scene.info.type = type;
    scene.info.has_color = color;
    const char *list = seed == 2 ? "coat,metallic" : seed == 3 ? "roughness" : NULL;
    scene.info.channels = list;
    struct fmt_nvdb_totals totals;
    assert_ok(ctx, scene_write(ctx, nvdb_path, &scene, &totals));
    struct fmt_nvdb_grid grid;
    assert_ok(ctx, fmt_nvdb_open(ctx, nvdb_path, &grid));
    compare_info(&grid.info, &scene.info);
    compare_totals(&grid, &scene, &totals);
    compare_with_scene(&grid, &scene, seed * 2 + 1);
    assert_int_equal(grid.colors != NULL, color);
    assert_int_equal(grid.channel_words, seed == 2 ? 4 : seed == 3 ? 1 : 0);
    assert_int_equal(fmt_nvdb_trailer_version(&grid), list ? 4 : 2);
    if (list) {
        assert_int_equal(grid.channel_list_bytes, strlen(list));
        assert_memory_equal(grid.channel_list, list, strlen(list));
        assert_int_equal((uintptr_t)grid.channels % 64, 0);
    }
    assert_int_equal(grid.normals[0] | grid.planes[0], 0); /* the background */
    assert_int_equal((uintptr_t)grid.normals % 64, 0);
    assert_int_equal((uintptr_t)grid.planes % 64, 0);
    assert_int_equal((uintptr_t)grid.colors % 64, 0);
    assert_int_equal((uintptr_t)grid.seconds % 64, 0);
    assert_ok(ctx, fmt_nvdb_verify(ctx, &grid));
    fmt_nvdb_close(ctx, &grid);
    scene_free(&scene);
    test_context_end(ctx);
}

TEST(test_round_trip)
{
    for (uint64_t seed = 1; seed <= 4; seed++)
        for (int variant = 0; variant < 4; variant++)
            round_trip(seed, seed == 1 ? 1 : 3000, variant & 1 ? FMT_NVDB_ONINDEX : FMT_NVDB_MASK,
                       variant & 2);
}

/* All voxels of two regions are set: full masks, entries of second records with all bits. */
CONTEXT_TEST(test_full_leaves, 2, 0)
{
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
    assert_ok(ctx, scene_write(ctx, nvdb_path, &scene, &totals));
    struct fmt_nvdb_grid grid;
    assert_ok(ctx, fmt_nvdb_open(ctx, nvdb_path, &grid));
    assert_int_equal(totals.lowers, 2);
    compare_with_scene(&grid, &scene, 3);
    assert_ok(ctx, fmt_nvdb_verify(ctx, &grid));
    fmt_nvdb_close(ctx, &grid);
    scene_free(&scene);
}

/* ---- NanoVDB's own tools ---- */

/* Runs a command; returns false if it is not installed. */
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

TEST(test_nanovdb_tools)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct scene scene;
    scene_random(&scene, 6, 2000, false);
    struct fmt_nvdb_totals totals;
    assert_ok(ctx, scene_write(ctx, nvdb_path, &scene, &totals));
    char command[128], output[4096], voxels[32];
    int status;
    snprintf(command, sizeof(command), "nanovdb_validate -v %s", nvdb_path);
    bool installed = run(command, output, sizeof(output), &status);
    if (installed) {
        print_message("%s", output);
        assert_int_equal(status, 0);
        assert_non_null(strstr(output, "passed"));
        snprintf(command, sizeof(command), "nanovdb_print -l %s", nvdb_path);
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
        test_lacks("nanovdb_validate");
}

RUN_TESTS(NULL, NULL)

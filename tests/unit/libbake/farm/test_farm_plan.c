/* test_farm_plan.c - the division of blocks among tasks, and plan files: what is written is read
 * back, and what is cut or changed is refused. */
#include "tests/unit/test.h"

#include "libbake/farm/farm.h"

enum { TASKS = 7, TILES = 2 };
static const struct bake_baked_tile sizes[TILES] = {{.tile = 1001, .width = 200, .height = 90},
                                                    {.tile = 1012, .width = 64, .height = 300}};
static const char *const more_scans[] = {"/scans/t.tris", "/else/u.nvdb"};
static const char *const more_meshes[] = {"/scans/m.ply"};
static const struct bake_tile_size size_option = {1012, 64, 300};
static const struct bake_tile_range range_option = {1001, 1012};

static struct bake_options some_options(void)
{
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = "/scans/s.nvdb";
    options.more_scan_paths = more_scans;
    options.more_scan_count = 2;
    options.match_names = true;
    options.high_suffix = "_hi";
    options.mesh_path = "/scans/l.obj";
    options.more_mesh_paths = more_meshes;
    options.more_mesh_count = 1;
    options.output_path = "/maps/<MAP>.<UDIM>.exr";
    options.maps = BAKE_MAP_NORMAL;
    options.front = 0.1 + 0.2; /* needs all of its digits */
    options.back = 1e-300;
    options.padding = UINT32_MAX;
    options.gpu_memory_bytes = UINT64_C(1) << 40;
    options.green_down = true;
    options.tile_sizes = &size_option;
    options.tile_ranges = &range_option;
    options.tile_size_count = options.tile_range_count = 1;
    return options;
}

/* Makes a plan of blocks with one sample each. */
static struct bake_farm_plan *make_plan(struct bsq_ctx *ctx, const struct bake_options *options,
                                        uint32_t tasks)
{
    struct bake_farm_plan *plan;
    assert_int_equal(bake_farm_plan_create(ctx, "plan.json", options, tasks, &plan), 0);
    plan->block_side = 16;
    assert_int_equal(bake_farm_add_tiles(plan, sizes, TILES), 0);
    static struct bake_farm_block blocks[512];
    uint64_t count = 0;
    for (uint32_t t = 0; t < TILES; t++)
        for (uint32_t b = 0; b < plan->tiles[t].columns * plan->tiles[t].rows; b++)
            if (b % 5 != 4) /* the others have no samples */
                blocks[count++] = (struct bake_farm_block){
                    .index = (b * 37u) % 64, .tile = t, .block = b, .samples = 100 + b};
    assert_int_equal(bake_farm_divide(plan, blocks, count), 0);
    return plan;
}

/* Tasks have about as many samples, and each block has one task. */
CONTEXT_TEST(test_tasks_are_balanced, 2, 0)
{
    const struct bake_options options = some_options();
    struct bake_farm_plan *plan = make_plan(ctx, &options, TASKS);
    uint64_t all = 0, most = 0, blocks = 0, listed = 0;
    assert_int_equal(plan->tiles[0].columns, 13);
    assert_int_equal(plan->tiles[0].rows, 6);
    for (uint32_t i = 0; i < TASKS; i++) {
        all += plan->expected[i].texels;
        most = plan->expected[i].texels > most ? plan->expected[i].texels : most;
    }
    assert_true(most * TASKS < all + all / 4);
    for (uint32_t t = 0; t < TILES; t++)
        for (uint32_t i = 0; i < TASKS; i++) {
            struct bake_blocks list;
            uint32_t next = 0;
            assert_int_equal(bake_farm_task_blocks(plan, t, i, &list), 0);
            blocks = (uint64_t)list.columns * list.rows;
            for (uint64_t b = 0; b < blocks; b++)
                if (list.slots[b] != BAKE_NO_SLOT)
                    assert_int_equal(list.slots[b], next++);
            assert_int_equal(next, list.count);
            listed += list.count;
            bsq_free(ctx, (void *)(uintptr_t)list.slots);
        }
    assert_int_equal(listed, 13 * 6 + 4 * 19);
    bake_close_plan(plan);
}

TEST(test_sides_suit_the_tasks)
{
    const struct bake_baked_tile large = {.tile = 1001, .width = 16384, .height = 16384};
    const struct bake_baked_tile small = {.tile = 1001, .width = 20, .height = 20};
    assert_int_equal(bake_farm_block_side(&large, 1, 16), 256);
    assert_int_equal(bake_farm_block_side(&large, 1, 1024), 64);
    assert_int_equal(bake_farm_block_side(&small, 1, 1000), 16);
}

/* Writes a plan with one input, and returns it and the bytes of its file. */
static struct bake_farm_plan *write_plan(struct bsq_ctx *ctx, const struct bake_options *options,
                                         char *bytes, size_t most, size_t *size)
{
    struct bake_farm_plan *plan = make_plan(ctx, options, TASKS);
    struct bsq_file input;
    bool kept = true;
    unlink("plan.json");
    test_bytes("input", "some bytes", 10);
    assert_int_equal(bsq_file_open(ctx, "input", &input), 0);
    bsq_file_close(ctx, &input);
    assert_int_equal(bake_farm_add_inputs(plan), 0);
    assert_int_equal(plan->input_count, 1);
    assert_int_equal(bake_farm_plan_write(plan, &kept), 0);
    assert_false(kept);
    FILE *file = fopen("plan.json", "rb");
    assert_non_null(file);
    *size = fread(bytes, 1, most, file);
    assert_true(*size < most);
    fclose(file);
    return plan;
}

static char bytes[1 << 16];

CONTEXT_TEST(test_a_plan_is_read_back, 2, 0)
{
    const struct bake_options options = some_options();
    size_t size;
    bool kept = false;
    struct bake_farm_plan *plan = write_plan(ctx, &options, bytes, sizeof bytes, &size), *read;
    assert_int_equal(bake_farm_plan_write(plan, &kept), 0);
    assert_true(kept);
    /* The id of what was read is that of the file. */
    assert_int_equal(bake_farm_plan_read(ctx, "plan.json", &read), 0);
    kept = false;
    assert_int_equal(bake_farm_plan_write(read, &kept), 0);
    assert_true(kept);
    assert_int_equal(bake_farm_check_inputs(read), 0);
    bake_close_plan(read);
    bake_close_plan(plan);
}

CONTEXT_TEST(test_an_interruption_is_not_lost_among_missing_parts, 2, 0)
{
    const struct bake_options options = some_options();
    struct bake_farm_plan *plan = make_plan(ctx, &options, TASKS);
    struct bake_farm_found found;
    assert_int_equal(bake_farm_parts_check(plan, &found), BSQ_ENOINPUT);
    assert_non_null(strstr(bsq_error(ctx), "7 of 7 parts are missing"));
    bsq_clear_error(ctx);
    bsq_interrupt(ctx);
    assert_int_equal(bake_farm_parts_check(plan, &found), BSQ_EINTR);
    assert_string_equal(bsq_error(ctx), "interrupted");
    bake_close_plan(plan);
    bsq_clear_interruption(ctx);
    bsq_clear_error(ctx);
}

static void assert_refused(struct bsq_ctx *ctx)
{
    struct bake_farm_plan *plan;
    bsq_clear_error(ctx);
    assert_int_equal(bake_farm_plan_read(ctx, "plan.json", &plan), BSQ_EDATA);
    assert_null(plan);
    assert_non_null(strstr(bsq_error(ctx), "plan.json"));
}

/* Returns whether byte i is a digit after the point of a number: two spellings may be one value. */
static bool is_fraction(size_t i)
{
    const size_t start = i;
    while (bytes[i] >= '0' && bytes[i] <= '9')
        i--;
    return i < start && bytes[i] == '.';
}

CONTEXT_TEST(test_cut_and_changed_plans_are_refused, 2, 0)
{
    const struct bake_options options = some_options();
    size_t size;
    bake_close_plan(write_plan(ctx, &options, bytes, sizeof bytes, &size));
    while (bytes[size - 1] != '}')
        size--;
    for (size_t length = 0; length < size; length += 1 + length / 64) {
        test_bytes("plan.json", bytes, length);
        assert_refused(ctx);
    }
    for (size_t i = 0; i < size; i += 1 + i / 512) {
        const char was = bytes[i];
        if (was == ' ' || was == '\n' || is_fraction(i))
            continue;
        bytes[i] = was == '7' ? '3' : '7';
        test_bytes("plan.json", bytes, size);
        assert_refused(ctx);
        bytes[i] = was;
    }
    bsq_clear_error(ctx);
}

/* Such plans have a right id: only their options are wrong. */
CONTEXT_TEST(test_impossible_options_are_refused, 2, 0)
{
    for (int i = 0; i < 11; i++) {
        struct bake_options options = some_options();
        struct bake_farm_plan *read;
        size_t size;
        options.scan_path = i == 0 ? NULL : options.scan_path;
        options.mesh_path = i == 1 ? NULL : options.mesh_path;
        options.output_path = i == 2 ? NULL : options.output_path;
        options.sample_type = i == 3 ? BAKE_FLOAT + 1 : BAKE_HALF;
        options.rays = i == 4 ? UINT32_MAX : BAKE_RAYS_FACE;
        options.normal_space = i == 5 ? 2 : BAKE_TANGENT_SPACE;
        options.sampling = i == 6 ? 2 : BAKE_NEAREST;
        options.scan_normals = i == 7 ? 99 : BSQ_SCAN_NORMALS_SMOOTH;
        options.position_in = i == 8 ? 2 : BAKE_IN_BOX;
        options.preview_up = i == 9 ? 3 : BAKE_UP_Z;
        options.samples = i == 10 ? BAKE_MAX_SAMPLES + 1 : options.samples;
        bake_close_plan(write_plan(ctx, &options, bytes, sizeof bytes, &size));
        assert_int_equal(bake_check_options(ctx, &options), BSQ_EUSAGE);
        bsq_clear_error(ctx);
        assert_int_equal(bake_open_plan(ctx, "plan.json", &read), BSQ_EUSAGE);
        assert_null(read);
        bsq_clear_error(ctx);
        bsq_forget_files(ctx);
    }
}

RUN_TESTS(NULL, NULL)

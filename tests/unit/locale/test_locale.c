/* test_locale.c - a program whose locale has a decimal comma gets the same bytes from the libraries
 * as any other program: from each text that they read, and in each file, message and warning. */
#include <dirent.h>
#include <jansson.h>
#include <sys/stat.h>

#include "libbake/bake.h"
#include "libbake/compare.h"
#include "libvoxel/voxel.h"
#include "tests/unit/comma_locale.h"
#include "tests/unit/test.h"

/* ---- inputs ---- */

static void write_inputs(void)
{
    enum { SIDE = 12 };
    FILE *obj = fopen("scan.obj", "w"), *ply = fopen("scan.ply", "w");
    const int across = SIDE + 1;
    assert_true(obj && ply);
    fprintf(obj, "mtllib scan.mtl\nusemtl clay\n");
    fprintf(ply,
            "ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
            "property float z\nelement face %d\nproperty list uchar int vertex_indices\n"
            "end_header\n",
            across * across, SIDE * SIDE);
    for (int y = 0; y <= SIDE; y++)
        for (int x = 0; x <= SIDE; x++) {
            const double z = 0.05 + 0.02 * sin(x) * cos(y);
            fprintf(obj, "v %.6f %.6f %.6e\nvt %.4f %.4f\n", x / 12.0, y / 12.0, z, x / 12.0,
                    y / 12.0);
            fprintf(ply, "%.6f %.6f %.6e\n", x / 12.0, y / 12.0, z);
        }
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            const int v = y * across + x, next = v + across;
            fprintf(obj, "f %d/%d %d/%d %d/%d %d/%d\n", v + 1, v + 1, v + 2, v + 2, next + 2,
                    next + 2, next + 1, next + 1);
            fprintf(ply, "4 %d %d %d %d\n", v, v + 1, next + 1, next);
        }
    fclose(obj);
    fclose(ply);
    test_text("dots.ppm", "P3 2 2 255 250 0 0 0 250 0 0 0 250 90 90 90\n");
    test_text("scan.mtl", "newmtl clay\nKd 0.5 0.25 0.125\nPr 0.75\n"
                          "map_Kd -s 2.5 1.5 1 -o 0.25 0.5 0 dots.ppm\n");
    test_text("scan.stl",
              "solid\nfacet normal 0 0 1\nouter loop\nvertex 0.25 0.5 0\n"
              "vertex 1.5 0 0.125\nvertex 0 1.75 2.5e-1\nendloop\nendfacet\nendsolid\n");
    test_text("low.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.1 0.1\nvt 0.9 0.1\n"
                         "vt 0.9 0.9\nvt 0.1 0.9\nf 1/1 2/2 3/3 4/4\n");
    test_text("double.obj", "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0.1 0.1\nvt 0.9 0.1\n"
                            "vt 0.9 0.9\nvt 0.1 0.9\nf 1/1 2/2 3/3 4/4\n");
}

/* ---- jobs ---- */

static FILE *lines; /* gets all messages */

static void note_line(__attribute__((unused)) void *user, const char *line)
{
    fprintf(lines, "%s\n", line);
}

static void expect(struct bsq_ctx *ctx, int status, int expected)
{
    if (status != expected)
        print_message("%d: %s\n", status, bsq_error(ctx));
    assert_int_equal(status, expected);
    note_line(NULL, bsq_error(ctx));
    bsq_clear_error(ctx);
    bsq_forget_files(ctx);
}

static void sort(struct bsq_ctx *ctx, const char *scan, const char *tris)
{
    static const struct bsq_placement placement = {
        .scale = 1.25, .up = BSQ_UP_KEEP, .translate = {100.5, 0.25, 0}};
    static const struct vox_channel roughness = {.name = "roughness", .optional = true};
    struct vox_sort_report report = {.size = sizeof report};
    struct vox_sort_options options;
    vox_sort_defaults(&options);
    options.scan_paths = &scan;
    options.scan_count = 1;
    options.tris_path = tris;
    options.channels = &roughness;
    options.channel_count = 1;
    if (strcmp(tris, "moved.tris") == 0)
        options.placements = &placement;
    expect(ctx, vox_sort(ctx, &options, &report), 0);
}

static void voxelize(struct bsq_ctx *ctx, double voxel_size, int expected)
{
    struct vox_voxelize_report report = {.size = sizeof report};
    struct vox_voxelize_options options;
    vox_voxelize_defaults(&options);
    options.tris_path = "scan.tris";
    options.grid_path = "scan.nvdb";
    options.resolution = 0;
    options.voxel_size = voxel_size;
    expect(ctx, vox_voxelize(ctx, &options, &report), expected);
}

static void simplify(struct bsq_ctx *ctx, const char *tris, const char *path, double error,
                     int expected)
{
    static const uint64_t target = 60;
    struct vox_simplify_report report = {.size = sizeof report};
    struct vox_simplify_options options;
    vox_simplify_defaults(&options);
    options.tris_path = tris;
    options.output_paths = &path;
    options.targets = &target;
    options.target_count = error > 0 ? 0 : 1;
    options.error = error;
    expect(ctx, vox_simplify(ctx, &options, &report), expected);
}

static struct bake_options options_for(const char *scan, const char *low, const char *output)
{
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = scan;
    options.mesh_path = low;
    options.output_path = output;
    options.maps = BAKE_MAPS_ALL;
    options.width = options.height = 24;
    options.padding = 3;
    options.device = "cpu";
    return options;
}

static void bake(struct bsq_ctx *ctx, const struct bake_options *options, int expected)
{
    struct bake_report report = {.size = sizeof report};
    expect(ctx, bake_run(ctx, options, &report), expected);
    bake_report_free(&report);
}

static void bake_with_page(struct bsq_ctx *ctx)
{
    struct bake_options options = options_for("scan.tris", "../low.obj", "exact_<MAP>.png");
    options.glb_path = "exact.glb";
    options.preview_path = "exact_preview.png";
    options.height_range = 0.125;
    options.page_path = "exact.html";
    expect(ctx, bake_page_open(ctx, options.page_path, &options.page), 0);
    options.on_rows = bake_page_take;
    options.rows_user = options.page;
    bake(ctx, &options, 0);
    expect(ctx, bake_page_finish(options.page, "{\"share\": 0.5}"), 0);
    bake_page_close(options.page);
}

static void bake_in_parts(struct bsq_ctx *ctx)
{
    struct bake_options options = options_for("scan.nvdb", "../low.obj", "farm_<MAP>.exr");
    options.height_range = 0.125;
    options.parts = 2;
    for (options.part = 1; options.part <= 2; options.part++)
        bake(ctx, &options, 0);
    options.part = 0;
    bake(ctx, &options, 0);
}

static void compare(struct bsq_ctx *ctx, const char *a, const char *b, const char *heatmap)
{
    struct bake_compare_report report = {.size = sizeof report};
    struct bake_compare_options options;
    bake_compare_defaults(&options);
    options.a_path = a;
    options.b_path = b;
    options.heatmap_path = heatmap;
    expect(ctx, bake_compare(ctx, &options, &report), 0);
}

/* Runs jobs whose messages have numbers. */
static void tell_numbers(struct bsq_ctx *ctx)
{
    struct bake_options large = options_for("scan.tris", "../double.obj", "double_<MAP>.exr");
    struct bake_options near = options_for("scan.tris", "../low.obj", "near_<MAP>.exr");
    near.front = near.back = 0.0001;
    voxelize(ctx, -0.5, BSQ_EUSAGE);
    bake(ctx, &large, 0);
    bake(ctx, &near, BSQ_EDATA);
}

/* Runs all jobs in a new directory. */
static void run_jobs(const char *directory, bool comma)
{
    struct bsq_ctx_options options = {
        .threads = 3, .memory_bytes = UINT64_C(256) << 20, .on_warning = note_line};
    struct bsq_ctx *ctx;
    assert_int_equal(mkdir("run", 0700), 0);
    assert_int_equal(chdir("run"), 0);
    lines = fopen("lines.txt", "w");
    assert_non_null(lines);
    if (comma)
        assert_non_null(setlocale(LC_ALL, "de_DE.UTF-8"));
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    sort(ctx, "../scan.obj", "scan.tris");
    sort(ctx, "../scan.obj", "moved.tris");
    sort(ctx, "../scan.ply", "ply.tris");
    sort(ctx, "../scan.stl", "stl.tris");
    voxelize(ctx, 0.0125, 0);
    simplify(ctx, "scan.tris", "simple.obj", 0, 0);
    simplify(ctx, "moved.tris", "moved.obj", 0, 0);
    simplify(ctx, "moved.tris", "simple.ply", 0, 0);
    simplify(ctx, "moved.tris", "simple.glb", 0, 0);
    sort(ctx, "simple.glb", "glb.tris");
    sort(ctx, "moved.obj", "obj.tris");
    bake_with_page(ctx);
    bake_in_parts(ctx);
    compare(ctx, "exact_height.png", "farm_height.exr", "heat.png");
    tell_numbers(ctx);
    bsq_ctx_destroy(ctx);
    setlocale(LC_ALL, "C");
    fclose(lines);
    assert_int_equal(chdir(".."), 0);
    assert_int_equal(rename("run", directory), 0);
}

/* ---- the comparison ---- */

static void expect_same_file(const char *name)
{
    char a[300], b[300];
    size_t a_size, b_size;
    snprintf(a, sizeof a, "plain/%s", name);
    snprintf(b, sizeof b, "comma/%s", name);
    uint8_t *a_bytes = test_read(a, &a_size), *b_bytes = test_read(b, &b_size);
    if (a_size != b_size || memcmp(a_bytes, b_bytes, a_size) != 0)
        fail_msg("%s is another file with a decimal comma", name);
    free(a_bytes);
    free(b_bytes);
}

TEST(test_a_decimal_comma_changes_no_file)
{
    unsigned files = 0;
    test_set_comma_locale();
    setlocale(LC_ALL, "C");
    write_inputs();
    run_jobs("plain", false);
    run_jobs("comma", true);
    DIR *list = opendir("plain");
    assert_non_null(list);
    for (struct dirent *entry; (entry = readdir(list));) {
        if (entry->d_name[0] == '.')
            continue;
        expect_same_file(entry->d_name);
        files++;
    }
    closedir(list);
    assert_true(files > 40);
}

RUN_TESTS(NULL, NULL)

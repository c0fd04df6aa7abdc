/* test_exhaustion.c - repeats each job with every allocation failing in turn, alone and with all
 * later ones, and with every start of a thread failing. A job then either returns BSQ_ENOMEM with a
 * message, or gives the right result. It never crashes, leaks, or leaves a file open or on disk.
 *
 * If later allocations fail too, the job mostly ends at the first. So only every fourth allocation
 * is tried in this way, unless LONG is set. */
#include <dirent.h>
#include <zlib.h>
#include <zstd.h>

#include "formats/mesh/mesh_reader.h"
#include "formats/file_kind.h"
#include "libbake/bake.h"
#include "libbake/compare.h"
#include "libvoxel/voxel.h"
#include "tests/unit/exhaustion/failing.h"
#include "tests/unit/sanitized.h"
#include "tests/unit/test.h"

enum { SIDE = 12, THREADS = 2 };

/* ---- files, in a directory of their own ---- */

static FILE *create(const char *name)
{
    FILE *file = fopen(name, "w");
    assert_non_null(file);
    return file;
}

/* Writes a hilly sheet twice, with vertex colours and with materials, and a square below it. */
static void write_inputs(void)
{
    FILE *file = create("scan.obj");
    fprintf(file, "mtllib scan.mtl\nusemtl clay\n");
    for (int y = 0; y <= SIDE; y++)
        for (int x = 0; x <= SIDE; x++)
            fprintf(file, "v %g %g %g %g 0.5 0.25\n", x / (double)SIDE, y / (double)SIDE,
                    0.05 + 0.02 * sin(x) * cos(y), x / (double)SIDE);
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            int v = y * (SIDE + 1) + x + 1;
            fprintf(file, "f %d %d %d %d\n", v, v + 1, v + SIDE + 2, v + SIDE + 1);
        }
    fclose(file);
    file = create("scan.mtl");
    fprintf(file, "newmtl clay\nKd 0.5 0.4 0.3\n");
    fclose(file);
    file = create("scan.ply");
    fprintf(file, "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\n"
                  "property float x\nproperty float y\nproperty float z\nproperty float nx\n"
                  "property float ny\nproperty float nz\nproperty uchar red\n"
                  "property uchar green\nproperty uchar blue\nelement face 1\n"
                  "property list uchar int vertex_indices\nproperty list uchar float texcoord\n"
                  "end_header\n"
                  "0 0 0 0 0 1 1 2 3\n1 0 0 0 0 1 1 2 3\n0 1 0 0 0 1 1 2 3\n"
                  "3 0 1 2 6 0 0 1 0 0 1\n");
    fclose(file);
    file = create("faces.ply");
    fprintf(file, "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n"
                  "property float y\nproperty float z\nelement face 1\n"
                  "property list uchar int vertex_indices\nproperty uchar red\n"
                  "property uchar green\nproperty uchar blue\nend_header\n"
                  "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 1 2 3\n");
    fclose(file);
    file = create("scan.stl");
    fprintf(file, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
                  "vertex 0 1 0\nendloop\nendfacet\nendsolid\n");
    fclose(file);
    file = create("low.obj");
    fprintf(file,
            "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.1 0.1\nvt 0.9 0.1\nvt 0.9 0.9\nvt 0.1 0.9\n"
            "f 1/1 2/2 3/3 4/4\n");
    fclose(file);
}

/* Packs scan.obj by gzip and scan.ply by Zstandard. */
static void pack_inputs(void)
{
    static char text[1 << 16], packed[1 << 16];
    FILE *file = fopen("scan.obj", "r");
    assert_non_null(file);
    size_t size = fread(text, 1, sizeof text, file);
    fclose(file);
    gzFile gzip = gzopen("scan.obj.gz", "wb");
    assert_int_equal(gzwrite(gzip, text, (unsigned)size), size);
    gzclose(gzip);
    file = fopen("scan.ply", "r");
    assert_non_null(file);
    size = fread(text, 1, sizeof text, file);
    fclose(file);
    size = ZSTD_compress(packed, sizeof packed, text, size, 3);
    file = create("scan.ply.zst");
    assert_int_equal(fwrite(packed, 1, size, file), size);
    fclose(file);
}

static bool expected_name(const char *name)
{
    static const char *const names[] = {
        ".",         "..",           "scan.obj",    "scan.mtl",   "low.obj",      "scan.tris",
        "scan.nvdb", "g_normal.exr", "g_color.exr", "g_mask.exr", "a_normal.exr", "heat.png",
        "hist.png",  "preview.png",  "out.tris",    "out.nvdb",   "scan.ply",     "faces.ply",
        "scan.stl",  "scan.obj.gz",  "scan.ply.zst"};
    for (unsigned i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(names[i], name) == 0)
            return true;
    return strncmp(name, "e_", 2) == 0; /* the maps of bake_exact(), which bakes all */
}

/* Returns the number of open descriptors. Fails the test if a job left a file behind. */
static int count_open(void)
{
    int count = 0;
    DIR *list = opendir("/proc/self/fd");
    assert_non_null(list);
    while (readdir(list))
        count++;
    closedir(list);
    list = opendir(".");
    assert_non_null(list);
    for (struct dirent *entry; (entry = readdir(list));)
        if (!expected_name(entry->d_name))
            fail_msg("a job left the file %s", entry->d_name);
    closedir(list);
    return count;
}

/* ---- jobs ---- */

static int parse(struct bsq_ctx *ctx)
{
    const char *path = "scan.obj";
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_totals totals;
    int status = fmt_mesh_open(ctx, &path, 1, &reader);
    if (status < 0)
        return status;
    status = fmt_mesh_read(reader, NULL, NULL, &totals);
    if (status == 0)
        assert_int_equal(totals.faces, SIDE * SIDE);
    fmt_mesh_close(reader);
    return status;
}

/* Reads a mesh and its materials. */
static int parse_file(struct bsq_ctx *ctx, const char *path, uint64_t faces)
{
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_totals totals;
    struct fmt_materials materials;
    int status = fmt_mesh_open(ctx, &path, 1, &reader);
    if (status < 0)
        return status;
    status = fmt_mesh_read(reader, NULL, NULL, &totals);
    if (status == 0)
        assert_int_equal(totals.faces, faces);
    if (status == 0)
        status = fmt_mesh_read_materials(reader, &materials);
    if (status == 0)
        fmt_materials_free(ctx, &materials);
    fmt_mesh_close(reader);
    return status;
}

static int parse_others(struct bsq_ctx *ctx)
{
    int status = parse_file(ctx, "scan.ply", 1);
    if (status == 0)
        status = parse_file(ctx, "faces.ply", 1);
    return status == 0 ? parse_file(ctx, "scan.stl", 1) : status;
}

/* Unpacking needs a thread. */
static int parse_packed(struct bsq_ctx *ctx)
{
    int status = parse_file(ctx, "scan.obj.gz", SIDE * SIDE);
    return status == 0 ? parse_file(ctx, "scan.ply.zst", 1) : status;
}

static int load_mesh(struct bsq_ctx *ctx)
{
    struct fmt_mesh mesh;
    int status = fmt_mesh_load(ctx, "scan.obj", false, &mesh);
    if (status == 0) {
        assert_int_equal(mesh.triangle_count, 2 * SIDE * SIDE);
        fmt_mesh_free(ctx, &mesh);
    }
    return status;
}

static int sort_to(struct bsq_ctx *ctx, const char *tris_path)
{
    const char *path = "scan.obj";
    struct vox_sort_report report = {.size = sizeof report};
    struct vox_sort_options options = {.size = sizeof(struct vox_sort_options),
                                       .scan_paths = &path,
                                       .scan_count = 1,
                                       .tris_path = tris_path};
    int status = vox_sort(ctx, &options, &report);
    if (status == 0)
        assert_int_equal(report.triangles, 2 * SIDE * SIDE);
    return status;
}

static int sort(struct bsq_ctx *ctx)
{
    return sort_to(ctx, "out.tris");
}

static int voxelize_to(struct bsq_ctx *ctx, const char *grid_path)
{
    struct vox_voxelize_report report = {.size = sizeof report};
    struct vox_voxelize_options options = {.size = sizeof(struct vox_voxelize_options),
                                           .tris_path = "scan.tris",
                                           .grid_path = grid_path,
                                           .resolution = 40};
    return vox_voxelize(ctx, &options, &report);
}

static int voxelize(struct bsq_ctx *ctx)
{
    return voxelize_to(ctx, "out.nvdb");
}

static int join(struct bsq_ctx *ctx)
{
    static const char *const paths[] = {"scan.tris", "scan.tris"};
    struct vox_sort_report report = {.size = sizeof report};
    const struct vox_join_options options = {.size = sizeof options,
                                             .tris_paths = paths,
                                             .tris_count = 2,
                                             .output_path = "out.tris",
                                             .scan_normals = BSQ_SCAN_NORMALS_AREA};
    const int status = vox_join(ctx, &options, &report);
    if (status == 0)
        assert_int_equal(report.triangles, 4 * SIDE * SIDE);
    return status;
}

static int verify_tris(struct bsq_ctx *ctx)
{
    struct fmt_verify_report report = {.size = sizeof report};
    int status = fmt_verify(ctx, "scan.tris", &report);
    if (status == 0)
        assert_int_equal(report.triangles, 2 * SIDE * SIDE);
    return status;
}

static int verify_nvdb(struct bsq_ctx *ctx)
{
    struct fmt_verify_report report = {.size = sizeof report};
    return fmt_verify(ctx, "scan.nvdb", &report);
}

static int bake(struct bsq_ctx *ctx, const char *scan, const char *output, uint32_t maps,
                const char *preview)
{
    struct bake_options options;
    struct bake_report report = {.size = sizeof report};
    bake_defaults(&options);
    options.scan_path = scan;
    options.mesh_path = "low.obj";
    options.output_path = output;
    options.maps = maps;
    options.width = options.height = 20;
    options.padding = 3;
    options.device = "cpu";
    options.preview_path = preview;
    int status = bake_run(ctx, &options, &report);
    if (status == 0)
        assert_int_equal(report.misses, 0);
    bake_report_free(&report);
    return status;
}

static int bake_grid(struct bsq_ctx *ctx)
{
    return bake(ctx, "scan.nvdb", "g_<MAP>.exr", BAKE_MAP_NORMAL | BAKE_MAP_COLOR | BAKE_MAP_MASK,
                NULL);
}

static int bake_preview(struct bsq_ctx *ctx)
{
    return bake(ctx, "scan.nvdb", "a_<MAP>.exr", BAKE_MAP_NORMAL, "preview.png");
}

static int bake_exact(struct bsq_ctx *ctx)
{
    return bake(ctx, "scan.tris", "e_<MAP>.png", BAKE_MAPS_ALL, NULL);
}

static int compare(struct bsq_ctx *ctx)
{
    struct bake_compare_report report = {.size = sizeof report};
    struct bake_compare_options options = {.size = sizeof(struct bake_compare_options),
                                           .a_path = "g_normal.exr",
                                           .b_path = "g_normal.exr",
                                           .a_mask_path = "g_mask.exr",
                                           .b_mask_path = "g_mask.exr",
                                           .heatmap_path = "heat.png"};
    int status = bake_compare(ctx, &options, &report);
    if (status == 0)
        assert_true(report.max == 0);
    return status;
}

/* ---- runs ---- */

/* Runs a job in its own context. */
static int run(int (*job)(struct bsq_ctx *))
{
    struct bsq_ctx_options options = {.memory_bytes = UINT64_C(256) << 20, .threads = THREADS};
    struct bsq_ctx *ctx;
    int status = bsq_ctx_create(&options, &ctx);
    if (status < 0)
        return status;
    status = job(ctx);
    if (status < 0 && !*bsq_error(ctx))
        status = BSQ_EBUG;
    if (status < 0 && status != BSQ_ENOMEM)
        fprintf(stderr, "# %d: %s\n", status, bsq_error(ctx));
    if (bsq_memory_used(ctx) != 0)
        fprintf(stderr, "# %llu bytes are still in use\n",
                (unsigned long long)bsq_memory_used(ctx));
    bsq_ctx_destroy(ctx);
    return status;
}

/* Runs a job in which call number `first` fails. Returns false if the job has fewer calls. */
static bool run_failing(int (*job)(struct bsq_ctx *), enum failing what, uint64_t first,
                        bool all_after)
{
    int open_before = count_open();
    failing_begin(what, first, all_after);
    int status = run(job);
    struct failing_result result = failing_end();
    if (status != 0 && (status != BSQ_ENOMEM || what != FAILING_MEMORY || result.failed == 0))
        fail_msg("call %llu failed: status %d", (unsigned long long)first, status);
    if (result.leaked != 0)
        fail_msg("call %llu failed: %lld blocks were not freed", (unsigned long long)first,
                 (long long)result.leaked);
    if (count_open() != open_before)
        fail_msg("call %llu failed: a file stayed open", (unsigned long long)first);
    return result.failed > 0;
}

/* Runs a job once for each `stride`-th call, which fails. With sanitizers, which slow all down, it
 * is each third of these, unless LONG is set. */
static void exhaust(int (*job)(struct bsq_ctx *), uint64_t stride)
{
    /* Libraries keep blocks after their first use; these are not leaks. */
    for (int i = 0; i < 2; i++)
        assert_int_equal(run(job), 0);
    const bool is_long = getenv("LONG") != NULL;
    const uint64_t first = TEST_SANITIZED && !is_long ? 3 * stride : stride;
    const uint64_t strides[] = {first, is_long ? first : 4 * first};
    uint64_t calls = 0;
    for (int all_after = 0; all_after < 2; all_after++)
        for (calls = 0; run_failing(job, FAILING_MEMORY, calls, all_after);
             calls += strides[all_after])
            ;
    assert_true(calls > 0);
    uint64_t threads = 0;
    while (run_failing(job, FAILING_THREADS, threads, false))
        assert_true(++threads < 8);
    assert_int_equal(run_failing(job, FAILING_THREADS, 0, true), threads > 0);
    assert_int_equal(run(job), 0);
}

#define EXHAUST(job, stride)                                                                       \
    TEST(test_##job)                                                                               \
    {                                                                                              \
        exhaust(job, stride);                                                                      \
    }
EXHAUST(parse, 1)
EXHAUST(load_mesh, 1)
EXHAUST(sort, 1)
EXHAUST(voxelize, 1)
EXHAUST(join, 1)
EXHAUST(verify_tris, 1)
EXHAUST(verify_nvdb, 1)
EXHAUST(bake_grid, 1)
EXHAUST(bake_preview, 41) /* a large picture; most of its calls are those of bake_grid */
EXHAUST(bake_exact, 1)
EXHAUST(compare, 1)
EXHAUST(parse_others, 1)
EXHAUST(parse_packed, 1)

static int prepare(struct bsq_ctx *ctx)
{
    int status = sort_to(ctx, "scan.tris");
    return status ? status : voxelize_to(ctx, "scan.nvdb");
}

static int set_up(void **state)
{
    (void)state;
    write_inputs();
    pack_inputs();
    return run(prepare);
}

RUN_TESTS(set_up, NULL)

/* fuzz_scan.c - fuzz target for both stages. A scan, a chunk file or OBJ text, is sorted,
 * voxelized, and baked from the grid and from its triangles. Each stage must accept what the stage
 * before wrote. Sorting must write the same bytes if vertices do not fit in memory. */
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/tris_mend.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "formats/chunks/tris.h"
#include "libbake/bake.h"
#include "libbake/device/device.h"
#include "libvoxel/sort_limits.h"
#include "libvoxel/voxel.h"

enum { MAGIC_BYTES = 8, RESOLUTION = 7 };

/* Two triangles on a diagonal plane of the unit cube, one for each side; one UV chart is mirrored.
 */
static const char low_mesh[] = "v 0 0 0\nv 1 0 .5\nv 1 1 1\nv 0 1 .5\n"
                               "vt .1 .1\nvt .9 .1\nvt .9 .9\nvt .1 .9\n"
                               "f 1/1 2/2 3/3\nf 4/4 3/3 1/1\n";

/* Files of a run, in one folder for all runs. */
static struct {
    char folder[64], obj[96], tris[96], other[96], grid[96], low[96], map[96];
} files;

static void write_file(const char *path, const void *data, size_t size)
{
    FILE *file = fopen(path, "wb");
    require(file && fwrite(data, 1, size, file) == size && !fclose(file), "cannot write a file");
}

static void remove_files(void)
{
    char path[160];
    static const char *const maps[] = {"normal", "color", "mask"};
    for (int i = 0; i < 3; i++) {
        snprintf(path, sizeof path, "%s/%s.exr", files.folder, maps[i]);
        unlink(path);
    }
    unlink(files.obj);
    unlink(files.tris);
    unlink(files.other);
    unlink(files.grid);
}

static void end(void)
{
    remove_files();
    unlink(files.low);
    rmdir(files.folder);
}

static void begin(void)
{
    if (files.folder[0]) {
        remove_files();
        return;
    }
    strcpy(files.folder,
           access("/dev/shm", W_OK) ? "/tmp/bisque-fuzz.XXXXXX" : "/dev/shm/bisque-fuzz.XXXXXX");
    require(mkdtemp(files.folder) != NULL, "no folder");
    snprintf(files.obj, sizeof files.obj, "%s/scan.obj", files.folder);
    snprintf(files.tris, sizeof files.tris, "%s/scan.tris", files.folder);
    snprintf(files.other, sizeof files.other, "%s/other.tris", files.folder);
    snprintf(files.grid, sizeof files.grid, "%s/scan.nvdb", files.folder);
    snprintf(files.low, sizeof files.low, "%s/low.obj", files.folder);
    snprintf(files.map, sizeof files.map, "%s/<MAP>.exr", files.folder);
    write_file(files.low, low_mesh, sizeof low_mesh - 1);
    atexit(end);
}

static int sort(struct bsq_ctx *ctx)
{
    const char *paths[] = {files.obj};
    const struct vox_sort_options options = {.size = sizeof(struct vox_sort_options),
                                             .scan_paths = paths,
                                             .scan_count = 1,
                                             .tris_path = files.tris};
    struct vox_sort_report report = {.size = sizeof report};
    return vox_sort(ctx, &options, &report);
}

/* How to sort with vertices in a file. One pass is used if the scan allows it. */
enum way { ONE_PASS, TWO_PASSES, WAY_COUNT };
static enum way way;

static int sort_otherwise(struct bsq_ctx *ctx)
{
    const char *paths[] = {files.obj};
    const struct vox_sort_options options = {.size = sizeof(struct vox_sort_options),
                                             .scan_paths = paths,
                                             .scan_count = 1,
                                             .tris_path = files.other};
    struct vox_sort_report report = {.size = sizeof report};
    struct sort_limits limits;
    vox_sort_limits_for(bsq_memory_limit(ctx), bsq_threads(ctx), &limits);
    limits.stream_bytes = 0;
    limits.two_passes = way == TWO_PASSES;
    int status = vox_sort_with_limits(ctx, &options, &limits, &report);
    return status == BSQ_ENOMEM ? BSQ_EDATA : status; /* polygons may need vertices in memory */
}

static void require_same_chunks(void)
{
    FILE *a = fopen(files.tris, "rb"), *b = fopen(files.other, "rb");
    require(a && b, "chunks that are not there");
    for (int x = 0; x != EOF;) {
        x = fgetc(a);
        require(fgetc(b) == x, "other chunks where vertices are in a file");
    }
    fclose(a);
    fclose(b);
}

static int voxelize(struct bsq_ctx *ctx)
{
    const struct vox_voxelize_options options = {.size = sizeof(struct vox_voxelize_options),
                                                 .tris_path = files.tris,
                                                 .grid_path = files.grid,
                                                 .resolution = RESOLUTION};
    struct vox_voxelize_report report = {.size = sizeof report};
    int status = vox_voxelize(ctx, &options, &report);
    if (!status)
        require(report.voxels > 0, "a grid without voxels");
    return status;
}

/* Bakes no colours: they may need textures, which are other files. */
static int bake(struct bsq_ctx *ctx, const char *scan)
{
    struct bake_options options;
    struct bake_report report = {.size = sizeof report};
    bake_defaults(&options);
    options.scan_path = scan;
    options.mesh_path = files.low;
    options.output_path = files.map;
    options.maps = BAKE_MAP_NORMAL | BAKE_MAP_MASK;
    options.width = options.height = 6;
    options.samples = 1;
    options.front = options.back = 4;
    options.padding = 1;
    options.device = "cpu";
    options.two_sided = true;
    int status = bake_run(ctx, &options, &report);
    bake_report_free(&report);
    return status;
}

static int bake_grid(struct bsq_ctx *ctx)
{
    return bake(ctx, files.grid);
}

static int bake_triangles(struct bsq_ctx *ctx)
{
    return bake(ctx, files.tris);
}

/* Check that the files that a stage wrote are valid. */
static int check_tris(struct bsq_ctx *ctx)
{
    struct fmt_tris_file *file;
    void *scratch = NULL;
    require(fmt_tris_open(ctx, files.tris, &file) == 0, "chunks that do not open");
    int status = bsq_alloc(ctx, "chunk", fmt_tris_load_size_max(file), 1, &scratch);
    for (uint64_t i = 0; !status && i < fmt_tris_get_header(file)->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        require(fmt_tris_load(file, i, scratch, &chunk) == 0, "a chunk that cannot be loaded");
    }
    bsq_free(ctx, scratch);
    fmt_tris_close(file);
    return status;
}

static int check_grid(struct bsq_ctx *ctx)
{
    struct fmt_nvdb_grid grid;
    require(fmt_nvdb_open(ctx, files.grid, &grid) == 0, "a grid that does not open");
    require(fmt_nvdb_verify(ctx, &grid) == 0, "a grid with wrong checksums");
    require(bake_check_grid(ctx, &grid) == 0, "a grid out of reach");
    fmt_nvdb_close(ctx, &grid);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    begin();
    int status = 0;
    if (size >= MAGIC_BYTES && memcmp(data, "BSQTRIS\n", MAGIC_BYTES) == 0) {
        write_file(files.tris, data, size);
    } else {
        write_file(files.obj, data, size);
        status = fuzz_in_context(sort);
        if (!status)
            fuzz_in_context(check_tris);
        way = (enum way)(size % WAY_COUNT);
        if (!status && fuzz_in_context(sort_otherwise) == 0)
            require_same_chunks();
    }
    if (!status)
        fuzz_in_context(bake_triangles);
    if (!status)
        status = fuzz_in_context(voxelize);
    if (!status)
        fuzz_in_context(check_grid);
    if (!status)
        fuzz_in_context(bake_grid);
    return 0;
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed)
{
    size = LLVMFuzzerMutate(data, size, max_size);
    if (seed % 32 && size >= MAGIC_BYTES && memcmp(data, "BSQTRIS\n", MAGIC_BYTES) == 0)
        tris_mend(data, size);
    return size;
}

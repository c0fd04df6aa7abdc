#include "voxelize_fixture.h"
#include "base/file.h"
#include "tests/unit/fixture.h"

int vox_set_up(void **state)
{
    struct vox_fixture *f = calloc(1, sizeof *f);
    assert_non_null(f);
    f->ctx = test_context(2, 512 << 20);
    *state = f;
    return 0;
}

int vox_tear_down(void **state)
{
    struct vox_fixture *f = *state;
    bsq_ctx_destroy(f->ctx);
    unlink("scan.tris");
    unlink("scan.nvdb");
    unlink("other.nvdb");
    unlink("texture.png");
    free(f);
    return 0;
}

static int voxelize(const struct vox_fixture *f, uint32_t resolution, double voxel_size,
                    struct vox_voxelize_report *report)
{
    struct vox_voxelize_options options = {
        .size = sizeof(struct vox_voxelize_options),
        .tris_path = "scan.tris",
        .grid_path = "scan.nvdb",
        .resolution = resolution,
        .voxel_size = voxel_size,
    };
    bsq_forget_files(f->ctx);
    return vox_voxelize(f->ctx, &options, report);
}

struct vox_voxelize_report vox_make(const struct vox_fixture *f, uint32_t resolution,
                                    double voxel_size)
{
    struct vox_voxelize_report report = {.size = sizeof report};
    int status = voxelize(f, resolution, voxel_size, &report);
    if (status != 0)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(status, 0);
    return report;
}

void vox_expect_failure(struct vox_fixture *f, uint32_t resolution, double voxel_size, int status,
                        const char *text)
{
    struct vox_voxelize_report report = {.size = sizeof report};
    assert_int_equal(voxelize(f, resolution, voxel_size, &report), status);
    if (!strstr(bsq_error(f->ctx), text))
        print_message("%s\n", bsq_error(f->ctx));
    assert_non_null(strstr(bsq_error(f->ctx), text));
    assert_int_equal(access("scan.nvdb", F_OK), -1);
    bsq_clear_error(f->ctx);
}

void vox_write_scan(const struct vox_fixture *f, const struct scan_mesh *mesh)
{
    scan_write(f->ctx, "scan.tris", mesh, NULL, NULL, 0, 4000);
}

void vox_take_scan(const struct vox_fixture *f, struct scan_mesh *mesh)
{
    vox_write_scan(f, mesh);
    scan_mesh_free(mesh);
}

struct fmt_nvdb_grid vox_open(const struct vox_fixture *f)
{
    struct fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(f->ctx, "scan.nvdb", &grid), 0);
    return grid;
}

double record_plane(struct fmt_nvdb_record record)
{
    return (double)(int16_t)(record.plane & 0xffff) / 32767.0;
}

double record_coverage(struct fmt_nvdb_record record)
{
    return (double)(record.plane >> 16 & 0xff) / 255.0;
}

void expect_same_bytes(const char *a, const char *b)
{
    struct bsq_ctx *ctx = test_context(1, 16 << 20);
    struct bsq_map x, y;
    assert_int_equal(bsq_map_open(ctx, a, &x), 0);
    assert_int_equal(bsq_map_open(ctx, b, &y), 0);
    assert_int_equal(x.size, y.size);
    assert_memory_equal(x.data, y.data, x.size);
    bsq_map_close(ctx, &x);
    bsq_map_close(ctx, &y);
    bsq_ctx_destroy(ctx);
}

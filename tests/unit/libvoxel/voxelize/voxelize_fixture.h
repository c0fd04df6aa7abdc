/* voxelize_fixture.h - for tests of the voxelizer: their context, and the
 * contents of records. */
#ifndef TEST_VOXELIZE_FIXTURE_H
#define TEST_VOXELIZE_FIXTURE_H

#include "formats/grid/nvdb.h"
#include "libvoxel/voxel.h"
#include "tests/unit/libvoxel/scan_fixture.h"

struct vox_fixture {
    struct bsq_ctx *ctx;
};

/* For cmocka. Tearing down fails if files other than the fixture's are left. */
int vox_set_up(void **state);
int vox_tear_down(void **state);

/* Writes a chunk file with 4000 triangles in a chunk. */
void vox_write_scan(const struct vox_fixture *f, const struct scan_mesh *mesh);
/* The same, and frees the mesh. */
void vox_take_scan(const struct vox_fixture *f, struct scan_mesh *mesh);
/* Opens the grid; close it with fmt_nvdb_close(). */
struct fmt_nvdb_grid vox_open(const struct vox_fixture *f);
/* Voxelizes tris to grid. */
struct vox_voxelize_report vox_make(const struct vox_fixture *f, uint32_t resolution,
                                    double voxel_size);
/* Voxelizes tris to grid, which must fail with this text in the error. */
void vox_expect_failure(struct vox_fixture *f, uint32_t resolution, double voxel_size, int status,
                        const char *text);
void expect_same_bytes(const char *a, const char *b);

double record_plane(struct fmt_nvdb_record record);
double record_coverage(struct fmt_nvdb_record record);

#endif

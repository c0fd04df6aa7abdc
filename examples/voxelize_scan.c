/* voxelize_scan.c - turns a mesh file (OBJ, PLY, STL or glTF) into chunks and a voxel grid.
 *
 *   voxelize_scan SCAN.obj CHUNKS.tris GRID.nvdb RESOLUTION [TEXTURE [EXPORT.vdb]] */
#include <libvoxel/voxel.h>
#include <stdio.h>
#include <stdlib.h>

static void print_warning(void *user, const char *line)
{
    (void)user;
    fprintf(stderr, "warning: %s\n", line);
}

static int voxelize(struct bsq_ctx *ctx, int argc, char **argv)
{
    const char *scan = argv[1];
    struct vox_sort_options sort;
    vox_sort_defaults(&sort);
    sort.scan_paths = &scan;
    sort.scan_count = 1;
    sort.tris_path = argv[2];
    if (argc > 5 && *argv[5])
        sort.texture_path = argv[5];

    struct vox_voxelize_options grid;
    vox_voxelize_defaults(&grid);
    grid.tris_path = argv[2];
    grid.grid_path = argv[3];
    grid.resolution = (uint32_t)strtoul(argv[4], NULL, 10);
    if (argc > 6)
        grid.vdb_path = argv[6];

    struct vox_sort_report sorted = {.size = sizeof sorted};
    struct vox_voxelize_report voxelized = {.size = sizeof voxelized};
    int status = vox_sort(ctx, &sort, &sorted);
    if (status == 0)
        status = vox_voxelize(ctx, &grid, &voxelized);
    if (status == 0)
        printf("%llu triangles, %llu voxels, %s\n", (unsigned long long)sorted.triangles,
               (unsigned long long)voxelized.voxels, voxelized.has_color ? "color" : "no color");
    return status;
}

int main(int argc, char **argv)
{
    if (argc < 5) {
        fprintf(stderr, "usage: voxelize_scan SCAN.obj CHUNKS.tris GRID.nvdb RESOLUTION "
                        "[TEXTURE [EXPORT.vdb]]\n");
        return -BSQ_EUSAGE;
    }
    struct bsq_ctx_options options = {.memory_bytes = (uint64_t)1 << 30,
                                      .on_warning = print_warning};
    struct bsq_ctx *ctx;
    int status = bsq_ctx_create(&options, &ctx);
    if (status < 0)
        return -status;
    status = voxelize(ctx, argc, argv);
    if (status < 0)
        fprintf(stderr, "%s\n", bsq_error(ctx));
    bsq_ctx_destroy(ctx);
    return -status;
}

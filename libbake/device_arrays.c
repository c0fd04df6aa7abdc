/* device_arrays.c - what of a job goes to a device. */
#include "libbake/device_backend_internal.h"

void bake_job_arrays(const struct bake_job *job, struct bake_array arrays[BAKE_ARRAYS])
{
    const struct fmt_nvdb_grid *g = job->grid;
    uint64_t channel = g->record_count * sizeof(uint32_t);

    arrays[BAKE_TILES] = (struct bake_array){"root tiles", g->tiles, g->tile_count * UINT64_C(32)};
    arrays[BAKE_UPPERS] =
        (struct bake_array){"upper nodes", g->uppers, (uint64_t)g->upper_count * g->upper_bytes};
    arrays[BAKE_LOWERS] =
        (struct bake_array){"lower nodes", g->lowers, (uint64_t)g->lower_count * g->lower_bytes};
    arrays[BAKE_LEAVES] =
        (struct bake_array){"leaves", g->leaves, (uint64_t)g->leaf_count * FMT_NVDB_LEAF_BYTES};
    arrays[BAKE_NORMALS] = (struct bake_array){"normals", g->normals, channel};
    arrays[BAKE_PLANES] = (struct bake_array){"planes", g->planes, channel};
    arrays[BAKE_COLORS] = (struct bake_array){"colors", g->colors, g->colors ? channel : 0};
    arrays[BAKE_SECONDS] =
        (struct bake_array){"second records", g->seconds, (g->voxel_count / 32 + 1) * 8};
    arrays[BAKE_TRIANGLES] = (struct bake_array){
        "triangles", job->triangles, job->triangle_count * (uint64_t)sizeof *job->triangles};
}

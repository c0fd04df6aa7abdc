/* scan_rays.h - rays from the nearest hits of several scans; private to libbake/. */
#ifndef BAKE_SCAN_RAYS_H
#define BAKE_SCAN_RAYS_H

#include "libbake/tile_bake.h"

/* The samples of a tile, after the nearest hits of all scans are known. */
struct bake_scan_samples {
    const struct bake_tile_scene *scene;
    const struct bake_tile *tile;
    struct bake_image *image; /* `floats` a sample: those of `maps`, then the number of the scan */
    uint32_t maps;            /* with BK_PLACE, whose positions are in the scan's index space */
    uint32_t floats;
    uint32_t width, height; /* samples; those of a texel of the tile's raster are 1 */
};

/* Sends the rays of ao, bent and thickness from all hits, through all scans that the object of the
 * sample sees, and writes what they found to the samples. Counts the report's chunk_loads. Errors:
 * those of bake_surface_look() and of images. */
int bake_trace_scan_rays(const struct bake_scan_samples *samples, struct bake_report *report);

/* Returns the hit of a sample. */
bk_map_hit bake_sample_hit(uint32_t maps, const float *sample);

#endif

/* preview_view.h - the preview's camera and light, and its three renderers. */
#ifndef BAKE_PREVIEW_PREVIEW_VIEW_H
#define BAKE_PREVIEW_PREVIEW_VIEW_H

#include "base/vec.h"
#include "libbake/preview/preview.h"

enum {
    PREVIEW_SIDE = 768, /* of a panel, in pixels */
    PREVIEW_GRID = 2,   /* samples along a pixel's side */
    PREVIEW_BAND = 8,   /* rows of pixels that are rendered together */
    PREVIEW_SAMPLES = PREVIEW_SIDE * PREVIEW_GRID
};

/* A parallel projection. A point's place on the panel, in samples from the top left, is
 * (half + scale * right . (p - centre), half - scale * up . (p - centre)). */
struct preview_view {
    double centre[3];                  /* world */
    double right[3], up[3], toward[3]; /* unit; toward: to the camera */
    double scale;                      /* samples a world unit */
    struct bsq_vec3 key, fill;         /* unit, to the lights */
    double scan_depth;                 /* beyond the scan, from the centre towards the camera */
    double scan_span;                  /* from there through the scan */
};

/* Frames the low mesh. */
void bake_preview_view_set(const struct bake_preview *preview, struct preview_view *view);

/* Light that a matt surface sends to the camera. */
struct bsq_vec3 bake_preview_shade(const struct preview_view *view, struct bsq_vec3 normal,
                                   struct bsq_vec3 albedo);

struct bsq_vec3 bake_preview_grey(void);
struct bsq_vec3 bake_preview_background(uint32_t row); /* of pixels */

/* What one worker needs for a band of the low mesh. */
struct preview_band {
    float *depth;       /* PREVIEW_BAND * PREVIEW_GRID rows of PREVIEW_SAMPLES; larger is nearer */
    uint32_t *triangle; /* UINT32_MAX: none */
};

/* Rows of samples that a triangle reaches over. */
struct preview_extent {
    float top, bottom;
};

void bake_preview_mesh_extents(const struct bake_preview *preview, const struct preview_view *view,
                               uint64_t first, uint64_t count, struct preview_extent *extents);

/* Fills a band's depth and triangles. first_row: of samples. */
void bake_preview_mesh_band(const struct bake_preview *preview, const struct preview_view *view,
                            const struct preview_extent *extents, uint32_t first_row,
                            struct preview_band *band);

/* Colour of a sample that lies in `triangle`; with the maps or plain. */
struct bsq_vec3 bake_preview_mesh_sample(const struct bake_preview *preview,
                                         const struct preview_view *view, uint32_t triangle,
                                         double x, double y, bool with_maps);

/* Renders the scan's panel on all threads: PREVIEW_SIDE rows of RGB, `stride` floats apart. Adds
 * its rows to the progress. Not from parallel work. */
int bake_preview_scan_panel(const struct bake_preview *preview, const struct preview_view *view,
                            float *pixels, size_t stride);

#endif

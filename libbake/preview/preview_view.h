/* preview_view.h - camera, light and renderers of the preview; private to this folder. */
#ifndef BAKE_PREVIEW_PREVIEW_VIEW_H
#define BAKE_PREVIEW_PREVIEW_VIEW_H

#include "base/geometry/vec.h"
#include "libbake/preview/preview.h"

enum {
    PREVIEW_GRID = 2, /* samples along a pixel's side */
    PREVIEW_BAND = 32 /* pixel rows that a worker renders at a time; divides a panel's side */
};

/* A parallel projection. With half = samples / 2, a point p is on the panel at
 * (half + scale * right . (p - centre), half - scale * up . (p - centre)), in samples from the top
 * left. */
struct preview_view {
    uint32_t side;                     /* width and height of a panel in pixels */
    uint32_t samples;                  /* side * PREVIEW_GRID */
    double centre[3];                  /* world */
    double right[3], up[3], toward[3]; /* unit; `toward` points to the camera */
    double scale;                      /* samples per world unit */
    struct bsq_vec3 key, fill;         /* unit, towards the lights */
    struct bsq_vec3 half;              /* unit, between `key` and `toward` */
    double scan_depth;                 /* where camera rays begin: `toward` from the centre */
    double scan_span;                  /* length of a camera ray that crosses all of the scan */
};

/* Chooses the views of the options. up: the vertical axis, 1 or 2. */
void bake_preview_place_views(const struct bake_preview *preview, int up,
                              struct bake_preview_views *out);

/* Frames the low-poly mesh. from, above: degrees around, 0 at the front, and down. up: the vertical
 * axis, 1 or 2. side: of a panel, in pixels. */
void bake_preview_view_set(const struct bake_preview *preview, double from, double above, int up,
                           uint32_t side, struct preview_view *view);

/* Turns the normal of a surface that is seen from behind to the camera, if it is not there yet. */
struct bsq_vec3 bake_preview_turn_normal(const struct preview_view *view, struct bsq_vec3 normal);

/* Returns the linear light that a matt surface sends to the camera. */
struct bsq_vec3 bake_preview_shade(const struct preview_view *view, struct bsq_vec3 normal,
                                   struct bsq_vec3 albedo);

/* Return linear light: the albedo without a colour map, and the background of a row of pixels of a
 * panel with this side. */
struct bsq_vec3 bake_preview_grey(void);
struct bsq_vec3 bake_preview_background(uint32_t row, uint32_t side);

/* The z-buffer of a band: PREVIEW_BAND * PREVIEW_GRID rows of view.samples. One per worker. */
struct preview_band {
    float *depth;       /* larger is nearer; only set where there is a triangle */
    uint32_t *triangle; /* UINT32_MAX: none */
};

/* Rasterises the mesh into a band. first_row: in samples. */
void bake_preview_mesh_band(const struct bake_preview *preview, const struct preview_view *view,
                            uint32_t first_row, struct preview_band *band);

/* Computes the colours of a sample of `triangle`, without and with maps. x, y: in samples. */
void bake_preview_mesh_sample(const struct bake_preview *preview, const struct preview_view *view,
                              uint32_t triangle, double x, double y, struct bsq_vec3 *plain,
                              struct bsq_vec3 *mapped);

#endif

/* traced_sheet.h - a wavy sheet of colours in a grid and a square below it as low mesh, ready to be
 * traced by any device. */
#ifndef TEST_TRACED_SHEET_H
#define TEST_TRACED_SHEET_H

#include "libbake/device/device.h"

/* Width and height differ and are no multiples of a work group; N = 2. */
enum { WIDTH = 93, HEIGHT = 71, SAMPLES = 2, TEXELS = WIDTH * HEIGHT };

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_nvdb_grid grid;
    struct bk_triangle triangles[2];
    uint32_t *samples;
    struct bake_job job;
};

/* Linear colour of the sheet at (u, v) of its frame. */
void traced_sheet_color(double u, double v, float color[3]);

/* For cmocka: *state is a struct fixture; teardown also checks that all memory was given back. */
int traced_sheet_setup(void **state);
int traced_sheet_teardown(void **state);

/* Traces the whole map on a device; NULL where there is none, with the message printed and kept. To
 * be freed with free(). */
struct bk_texel *traced_sheet_trace(struct fixture *f, const char *device, unsigned worker);

/* The same of a few texels in the middle of the map, with n x n samples each. *launches: kernel
 * calls. */
enum { DENSE_WIDTH = 5, DENSE_HEIGHT = 3, DENSE_TEXELS = DENSE_WIDTH * DENSE_HEIGHT };
struct bk_texel *traced_sheet_trace_dense(struct fixture *f, const char *device, uint32_t n,
                                          uint64_t *launches);

#endif

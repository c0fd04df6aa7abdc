/* traced_sheet.h - a fixture for tests of devices: a grid of a wavy coloured sheet, and a square
 * below it as the low-poly mesh. */
#ifndef TEST_TRACED_SHEET_H
#define TEST_TRACED_SHEET_H

#include "libbake/device/device.h"

/* Width and height differ and are not multiples of a work group's. */
enum { WIDTH = 93, HEIGHT = 71, SAMPLES = 2, TEXELS = WIDTH * HEIGHT };

/* A texel of the maps that the fixture selects: normal and color. */
struct sheet_texel {
    float covered, hits, normal[3], color[3];
};

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_nvdb_grid grid;
    struct bk_triangle triangles[2];
    uint32_t *samples;
    struct bake_scene job;
};

/* Set up and tear down a struct fixture in *state for cmocka. Tearing down checks that all memory
 * is freed. */
int traced_sheet_setup(void **state);
int traced_sheet_teardown(void **state);

/* Traces the whole map on a device and returns its texels; free() them. Without such a device,
 * returns NULL and prints the message, which the context keeps. */
struct sheet_texel *traced_sheet_trace(struct fixture *f, const char *device, unsigned worker);

/* Does the same for a few texels in the middle of the map, with n x n samples each. *launches:
 * number of kernel calls. */
enum { DENSE_WIDTH = 5, DENSE_HEIGHT = 3, DENSE_TEXELS = DENSE_WIDTH * DENSE_HEIGHT };
struct sheet_texel *traced_sheet_trace_dense(struct fixture *f, const char *device, uint32_t n,
                                             uint64_t *launches);

#endif

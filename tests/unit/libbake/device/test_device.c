/* test_device.c - devices are found by name, and all trace the same maps. */
#include "tests/unit/libbake/device/traced_sheet.h"
#include "tests/unit/test.h"

/* OpenCL's division and square root may be off by 3 ulp, and so may positions. A ray that grazes a
 * voxel's edge may then hit its neighbour's plane. So nearly all texels must agree closely, the
 * others roughly. */
#define CLOSE          1e-3f
#define ROUGH          0.1f
#define ROUGH_FRACTION 0.001

TEST(test_native_map)
{
    struct fixture *f = *state;
    struct sheet_texel *texels = traced_sheet_trace(f, "cpu", 0);
    uint64_t covered = 0, hits = 0;
    double color_error = 0;

    for (int i = 0; i < TEXELS; i++) {
        const struct sheet_texel *t = &texels[i];
        /* The texel's centre on the square, and the sheet's colour there. */
        double u = -32 + 64 * (i % WIDTH + 0.5) / WIDTH, v = -32 + 64 * (i / WIDTH + 0.5) / HEIGHT;
        float color[3];
        covered += (uint64_t)t->covered;
        hits += (uint64_t)t->hits;
        assert_true(t->hits <= t->covered);
        if (fabs(u) > 28 || fabs(v) > 28)
            continue;
        assert_int_equal(t->hits, SAMPLES * SAMPLES);
        assert_true(t->normal[2] > 0.85 * t->hits); /* slopes are up to 20 degrees: cos = 0.94 */
        traced_sheet_color(u, v, color);
        for (int k = 0; k < 3; k++)
            color_error = fmax(color_error, fabsf(t->color[k] / t->hits - color[k]));
    }
    /* The first three columns of samples are outside the chart. */
    assert_int_equal(covered, (WIDTH * SAMPLES - 3) * HEIGHT * SAMPLES);
    /* The sheet covers (30 / 32)^2 of the square, and up to a voxel more: planes fill voxels. */
    assert_true(hits > 0.875 * TEXELS * 4 && hits < (31 / 32.) * (31 / 32.) * TEXELS * 4);
    print_message("largest error of linear colour: %.4f\n", color_error);
    assert_true(color_error < 0.06); /* the colour changes by at most 0.1 a voxel */
    free(texels);
}

TEST(test_object_space)
{
    struct fixture *f = *state;
    struct sheet_texel *tangent = traced_sheet_trace(f, "cpu", 0), *object;

    f->job.params.flags |= BK_OBJECT_SPACE;
    object = traced_sheet_trace(f, "cpu", 0);
    f->job.params.flags &= ~(uint32_t)BK_OBJECT_SPACE;
    for (int i = 0; i < TEXELS; i++) {
        const struct bk_triangle *a = &f->triangles[0];
        const float *t = a->tangent[0], *n = a->normal[0], *m = tangent[i].normal;
        for (int k = 0; k < 3; k++) {
            int p = (k + 1) % 3, q = (k + 2) % 3;
            float b = -(n[p] * t[q] - n[q] * t[p]);
            assert_true(fabsf(m[0] * t[k] + m[1] * b + m[2] * n[k] - object[i].normal[k]) < 1e-5f);
        }
    }
    free(tangent);
    free(object);
}

static double difference(const struct sheet_texel *a, const struct sheet_texel *b)
{
    double worst = 0;
    for (int k = 0; k < 3; k++) {
        worst = fmax(worst, fabsf(a->normal[k] - b->normal[k]));
        worst = fmax(worst, fabsf(a->color[k] - b->color[k]));
    }
    return worst / fmax(1, a->hits);
}

TEST(test_opencl_agrees)
{
    struct fixture *f = *state;
    struct sheet_texel *native = traced_sheet_trace(f, "cpu", 0),
                       *opencl = traced_sheet_trace(f, "opencl", 1);
    uint64_t rough = 0, differing_hits = 0;

    if (!opencl) {
        free(native);
        bsq_clear_error(f->ctx);
        skip();
    }
    for (int i = 0; i < TEXELS; i++) {
        double d = difference(&native[i], &opencl[i]);
        assert_int_equal(native[i].covered, opencl[i].covered);
        if (native[i].hits != opencl[i].hits) {
            differing_hits++;
            continue;
        }
        assert_true(d < ROUGH);
        rough += d >= CLOSE;
    }
    print_message("differ in hits: %d, by more than %g: %d of %d texels\n", (int)differing_hits,
                  (double)CLOSE, (int)rough, TEXELS);
    assert_true((double)(rough + differing_hits) <= ROUGH_FRACTION * TEXELS);
    free(native);
    free(opencl);
}

/* Workers trace with their own buffers, and tiles may be smaller than the largest. */
TEST(test_opencl_small_tile)
{
    struct fixture *f = *state;
    const struct bk_tile tile = {.x = 10, .y = 20, .width = 7, .height = 3};
    struct sheet_texel a[21], b[21];
    uint32_t samples[21 * 4];
    struct bake_device *native, *opencl;

    for (int i = 0; i < 21 * 4; i++)
        samples[i] = 0;
    if (bake_device_open(f->ctx, "opencl", &f->job, &opencl) < 0) {
        bsq_clear_error(f->ctx);
        skip();
    }
    assert_int_equal(bake_device_open(f->ctx, "cpu", &f->job, &native), 0);
    assert_int_equal(bake_device_trace(native, &tile, samples, (float *)a, 0), 0);
    for (unsigned worker = 0; worker < 2; worker++) {
        memset(b, 0xff, sizeof b);
        assert_int_equal(bake_device_trace(opencl, &tile, samples, (float *)b, worker), 0);
        for (int i = 0; i < 21; i++) {
            assert_int_equal(a[i].hits, b[i].hits);
            assert_true(difference(&a[i], &b[i]) < ROUGH);
        }
    }
    bake_device_close(opencl);
    bake_device_close(native);
}

/* Several launches trace a texel that has many samples. */
TEST(test_opencl_batches_of_texels)
{
    struct fixture *f = *state;
    uint64_t none, launches;
    struct sheet_texel *native = traced_sheet_trace_dense(f, "cpu", 33, &none);
    struct sheet_texel *opencl = traced_sheet_trace_dense(f, "opencl", 33, &launches);

    if (!opencl) {
        free(native);
        bsq_clear_error(f->ctx);
        skip();
    }
    assert_true(launches > 1);
    for (int i = 0; i < DENSE_TEXELS; i++) {
        assert_int_equal(native[i].covered, opencl[i].covered);
        assert_true(fabs((double)native[i].hits - opencl[i].hits) <= 1);
        assert_true(difference(&native[i], &opencl[i]) < ROUGH);
    }
    free(native);
    free(opencl);
}

TEST(test_names)
{
    static const char *const bad[] = {"gpu",       "",          "opencl:",           "opencl:x",
                                      "opencl:0x", "opencl:-1", "opencl:4000000000", "cpu:0"};
    static const char *const good[] = {"auto", "cpu", "cuda", "cuda:0", "opencl", "opencl:999"};
    struct fixture *f = *state;
    struct bake_device *device;

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_false(bake_is_device_name(bad[i]));
        assert_int_equal(bake_device_open(f->ctx, bad[i], &f->job, &device), BSQ_EUSAGE);
        assert_null(device);
        assert_non_null(strstr(bsq_error(f->ctx), bad[i]));
        bsq_clear_error(f->ctx);
    }
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        assert_true(bake_is_device_name(good[i]));
    assert_int_equal(bake_device_open(f->ctx, "opencl:999", &f->job, &device), BSQ_ENODEVICE);
    assert_null(device);
    assert_true(strlen(bsq_error(f->ctx)) > 10);
    bsq_clear_error(f->ctx);
    bake_device_close(NULL);
}

struct listing {
    int count, gpus, cpus;
};

static void on_device(void *arg, const struct bake_device_info *info)
{
    struct listing *listing = arg;
    listing->count++;
    listing->gpus += info->is_gpu;
    listing->cpus += strcmp(info->id, "cpu") == 0;
    assert_true(info->name[0] && info->memory_bytes > 0);
}

TEST(test_list_and_auto)
{
    struct fixture *f = *state;
    struct listing listing = {0};
    struct bake_device *device;

    assert_int_equal(bake_list_devices(f->ctx, on_device, &listing), 0);
    assert_int_equal(listing.cpus, 1);
    assert_int_equal(bake_device_open(f->ctx, "auto", &f->job, &device), 0);
    /* "auto" never chooses OpenCL on the processor. */
    if (listing.gpus == 0)
        assert_true(strncmp(bake_device_name(device), "cpu", 3) == 0);
    bake_device_close(device);
}

RUN_TESTS(traced_sheet_setup, traced_sheet_teardown)

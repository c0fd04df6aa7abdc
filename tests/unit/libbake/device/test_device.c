/* test_device.c - what OpenCL devices launch, and which device is chosen. tests/cli/test_devices.sh
 * compares the maps of all devices. */
#include "tests/unit/libbake/device/traced_sheet.h"
#include "tests/unit/test.h"

static double difference(const struct sheet_texel *a, const struct sheet_texel *b)
{
    double worst = 0;
    for (int k = 0; k < 3; k++) {
        worst = fmax(worst, fabsf(a->normal[k] - b->normal[k]));
        worst = fmax(worst, fabsf(a->color[k] - b->color[k]));
    }
    return worst / fmax(1, a->hits);
}

/* Several launches trace a texel that has many samples. OpenCL's division and square root may be
 * off by 3 ulp, so a ray that grazes a voxel's edge may hit its neighbour's plane. */
TEST(test_opencl_batches_of_texels)
{
    struct fixture *f = *state;
    uint64_t none, launches;
    struct sheet_texel *native = traced_sheet_trace_dense(f, "cpu", 33, &none);
    struct sheet_texel *opencl = traced_sheet_trace_dense(f, "opencl", 33, &launches);

    if (!opencl) {
        free(native);
        bsq_clear_error(f->ctx);
        test_lacks("an OpenCL device");
    }
    assert_true(launches > 1);
    for (int i = 0; i < DENSE_TEXELS; i++) {
        assert_int_equal(native[i].covered, opencl[i].covered);
        assert_true(fabs((double)native[i].hits - opencl[i].hits) <= 1);
        assert_true(difference(&native[i], &opencl[i]) < 0.1);
    }
    free(native);
    free(opencl);
}

TEST(test_names)
{
    static const char *const bad[] = {"gpu",       "",          "opencl:",           "opencl:x",
                                      "opencl:0x", "opencl:-1", "opencl:4000000000", "cpu:0"};
    struct fixture *f = *state;
    struct bake_device *device;

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_false(bake_is_device_name(bad[i]));
        assert_int_equal(bake_device_open(f->ctx, bad[i], &f->job, &device), BSQ_EUSAGE);
        assert_null(device);
        assert_non_null(strstr(bsq_error(f->ctx), bad[i]));
        bsq_clear_error(f->ctx);
    }
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

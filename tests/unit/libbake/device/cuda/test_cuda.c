/* test_cuda.c - the CUDA device, with a driver that needs no GPU (tests/fake/fake_cuda.c): it gives
 * the processor's bits, and failures have messages. */
#include <dlfcn.h>
#include <inttypes.h>
#include <link.h>
#include <sys/wait.h>

#include "libbake/device/cuda/cuda.h"
#include "libbake/device/cuda/cuda_api.h"
#include "libbake/device/driver/driver.h"
#include "libbake/device/gpu/gpu.h"
#include "tests/unit/libbake/device/traced_sheet.h"
#include "tests/unit/test.h"

/* Opens the fake driver. A later dlopen() of "libcuda.so.1" finds it among the open libraries, and
 * bisque-devices finds it in LD_LIBRARY_PATH, beside an OpenCL library that starts CUDA. */
static int open_fake(void)
{
    char path[4096], directories[8300];
    ssize_t length = readlink("/proc/self/exe", path, sizeof path - 64);

    assert_true(length > 0);
    path[length] = '\0';
    *strrchr(path, '/') = '\0';
    strcat(path, "/../fake");
    snprintf(directories, sizeof directories, "%s:%s/nvidia", path, path);
    setenv("LD_LIBRARY_PATH", directories, 1);
    strcat(path, "/libcuda.so.1");
    if (dlopen(path, RTLD_NOW | RTLD_LOCAL))
        return 0;
    fprintf(stderr, "%s\n", dlerror());
    return -1;
}

static void restore(void)
{
    static const char *const names[] = {"DEVICES", "MEMORY", "CAPABILITY", "FAIL",
                                        "NS",      "HOURS",  "VERSION"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        char name[64];
        snprintf(name, sizeof name, "FAKE_CUDA_%s", names[i]);
        unsetenv(name);
    }
}

static char warnings[4096];

static void on_warning(void *user, const char *line)
{
    (void)user;
    strncat(warnings, line, sizeof warnings - strlen(warnings) - 2);
    strcat(warnings, "\n");
}

/* Creates a context with a memory limit that keeps warnings. */
static struct bsq_ctx *create_context(uint64_t memory_bytes)
{
    struct bsq_ctx *ctx;
    struct bsq_ctx_options options = {
        .threads = 2, .memory_bytes = memory_bytes, .on_warning = on_warning};

    warnings[0] = '\0';
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

static int each_setup(void **state)
{
    (void)state;
    restore();
    return 0;
}
#define FIXTURE_TEST(name) TEST_EACH(name, each_setup, NULL)

static void assert_same(const struct sheet_texel *a, const struct sheet_texel *b, size_t count)
{
    assert_memory_equal(a, b, count * sizeof *a);
}

/* Returns the times of a GPU that traces the whole map `patches` times on one worker. */
static struct bake_device_times times_of(struct fixture *f, int patches, struct sheet_texel *texels)
{
    const struct bk_patch patch = {.width = WIDTH, .height = HEIGHT};
    struct bake_device_times times;
    char why[BAKE_WHY_BYTES];
    struct bake_gpu *gpu;

    assert_int_equal(bake_gpu_open(f->ctx, &bake_cuda_driver, 0, &f->job, &gpu), 0);
    for (int i = 0; i < patches; i++) {
        assert_int_equal(bake_gpu_begin(gpu, &patch, f->samples, 0, 0, why), 0);
        assert_int_equal(bake_gpu_end(gpu, &patch, (float *)texels, 0, 0, why), 0);
    }
    times = bake_gpu_times(gpu);
    bake_gpu_close(gpu);
    return times;
}

/* The time of kernels is that of all launches. */
FIXTURE_TEST(test_launches_and_times)
{
    enum { PATCHES = 3 };
    struct fixture *f = *state;
    struct sheet_texel *native = traced_sheet_trace(f, "cpu", 0);
    struct sheet_texel *cuda = calloc(TEXELS, sizeof *cuda);
    const double seconds = 1e-9 * 2500 * TEXELS * SAMPLES * SAMPLES; /* 66 ms a patch */
    struct bake_device_times times;

    setenv("FAKE_CUDA_NS", "2500", 1);
    times = times_of(f, PATCHES, cuda);
    assert_same(native, cuda, TEXELS);
    assert_int_equal(times.launches, PATCHES);
    assert_true(times.kernels > 0.999 * PATCHES * seconds &&
                times.kernels < 1.001 * PATCHES * seconds);
    free(native);
    free(cuda);
}

/* A patch's times are exact however long ago the device was opened, although the time between
 * events is a float. */
FIXTURE_TEST(test_times_after_days)
{
    struct fixture *f = *state;
    struct sheet_texel *cuda = calloc(TEXELS, sizeof *cuda);
    const double seconds = 1e-9 * 10 * TEXELS * SAMPLES * SAMPLES;
    struct bake_device_times times;

    setenv("FAKE_CUDA_NS", "10", 1);
    setenv("FAKE_CUDA_HOURS", "100", 1);
    times = times_of(f, 3, cuda);
    assert_true(times.kernels > 0.99 * 3 * seconds && times.kernels < 1.01 * 3 * seconds);
    free(cuda);
}

/* Opens a named device in a context that keeps warnings, with this much memory; returns its texels.
 */
static struct sheet_texel *trace_with(struct fixture *f, uint64_t memory_bytes)
{
    struct bsq_ctx *ctx = f->ctx;
    struct sheet_texel *texels;
    char bytes[32];

    snprintf(bytes, sizeof bytes, "%" PRIu64, memory_bytes);
    setenv("FAKE_CUDA_MEMORY", bytes, 1);
    f->ctx = create_context(0);
    texels = traced_sheet_trace(f, "cuda", 0);
    test_context_end(f->ctx);
    f->ctx = ctx;
    return texels;
}

/* A grid that takes all of the memory is baked by the processor, since the driver needs some, and a
 * line says so. */
FIXTURE_TEST(test_memory_for_the_driver)
{
    const uint64_t all = 1 << 30;
    struct fixture *f = *state;
    struct sheet_texel *native = traced_sheet_trace(f, "cpu", 0), *cuda;
    struct bake_grid_arrays grid;
    struct bake_gpu *gpu;
    uint64_t needed;

    setenv("FAKE_CUDA_MEMORY", "1073741824", 1);
    assert_int_equal(bake_gpu_open(f->ctx, &bake_cuda_driver, 0, &f->job, &gpu), 0);
    bake_list_arrays(&f->job, &grid);
    needed = all / 16 * 15 - gpu->memory_bytes + grid.bytes; /* texels and triangles, too */
    bake_gpu_close(gpu);
    cuda = trace_with(f, needed);
    assert_same(native, cuda, TEXELS);
    assert_non_null(strstr(warnings, "the grid needs "));
    assert_non_null(strstr(warnings, " MiB for it: the processor bakes it\n"));
    free(cuda);
    cuda = trace_with(f, needed / 15 * 16 + 32);
    assert_same(native, cuda, TEXELS);
    assert_string_equal(warnings, "");
    free(cuda);
    free(native);
}

/* Several launches trace a texel that has many samples. */
FIXTURE_TEST(test_batches_of_texels)
{
    enum { N = 33 /* calls of 7 lines, the last of 5 */ };
    uint64_t none, launches;
    struct sheet_texel *native = traced_sheet_trace_dense(*state, "cpu", N, &none);
    struct sheet_texel *cuda = traced_sheet_trace_dense(*state, "cuda", N, &launches);

    assert_same(native, cuda, DENSE_TEXELS);
    assert_int_equal(launches, (N + BAKE_BATCH_THREAD / N - 1) / (BAKE_BATCH_THREAD / N));
    free(native);
    free(cuda);
}

static void expect_failure(struct fixture *f, const char *device, const char *message)
{
    struct bake_device *opened;

    assert_int_equal(bake_device_open(f->ctx, device, &f->job, &opened), BSQ_ENODEVICE);
    assert_null(opened);
    assert_string_equal(bsq_error(f->ctx), message);
    bsq_clear_error(f->ctx);
    restore();
}

FIXTURE_TEST(test_hidden_devices)
{
    setenv("CUDA_VISIBLE_DEVICES", "", 1);
    setenv("FAKE_CUDA_DEVICES", "0", 1);
    expect_failure(*state, "cuda", "CUDA has no devices (CUDA_VISIBLE_DEVICES is \"\")");
    unsetenv("CUDA_VISIBLE_DEVICES");
}

FIXTURE_TEST(test_wrong_architecture)
{
    const char *target = strstr(bake_cuda_ptx, ".target sm_"); /* 5.0 by Clang, 7.5 by nvcc */
    char message[128];

    assert_non_null(target);
    target += strlen(".target sm_");
    snprintf(message, sizeof message, "Fake GPU 0: compute capability 3.5, the program needs %c.%c",
             target[0], target[1]);
    setenv("FAKE_CUDA_CAPABILITY", "35", 1);
    expect_failure(*state, "cuda", message);
}

/* PTX that is newer than the driver is no error of the compiler. */
FIXTURE_TEST(test_old_driver)
{
    static const int versions[][2] = {{40, 60},  {63, 100}, {70, 110}, {78, 118}, {80, 120},
                                      {85, 125}, {86, 127}, {88, 129}, {90, 130}, {91, 131}};
    struct fixture *f = *state;
    struct bake_device *device;

    for (size_t i = 0; i < sizeof versions / sizeof *versions; i++)
        assert_int_equal(bake_cuda_version_for_ptx(versions[i][0]), versions[i][1]);
    setenv("FAKE_CUDA_VERSION", "11040", 1);
    setenv("FAKE_CUDA_FAIL", "cuModuleLoadDataEx:1:222", 1);
    assert_int_equal(bake_device_open(f->ctx, "cuda", &f->job, &device), BSQ_ENODEVICE);
    assert_non_null(strstr(bsq_error(f->ctx), "Fake GPU 0: NVIDIA's driver is too old: it is for "
                                              "CUDA 11.4, and the program's kernel (PTX "));
    bsq_clear_error(f->ctx);
}

FIXTURE_TEST(test_compiler_refuses)
{
    setenv("FAKE_CUDA_FAIL", "cuModuleLoadDataEx:1:221", 1);
    expect_failure(*state, "cuda",
                   "Fake GPU 0: compiling the kernel: CUDA_ERROR_JIT_COMPILER_NOT_FOUND (PTX JIT "
                   "compiler library not found); install libnvidia-ptxjitcompiler.so.1, a part of "
                   "NVIDIA's driver");
    setenv("FAKE_CUDA_FAIL", "cuModuleLoadDataEx:1:218", 1);
    expect_failure(
        *state, "cuda",
        "Fake GPU 0: compiling the kernel: CUDA_ERROR_INVALID_PTX (a PTX JIT compilation "
        "failed)");
}

FIXTURE_TEST(test_small_device)
{
    struct fixture *f = *state;
    struct bake_device *device;

    setenv("FAKE_CUDA_MEMORY", "1000", 1);
    assert_int_equal(bake_device_open(f->ctx, "cuda", &f->job, &device), BSQ_ENODEVICE);
    assert_non_null(strstr(bsq_error(f->ctx), "of the device's memory, 938 are allowed"));
    bsq_clear_error(f->ctx);
}

/* Each call that opens the device fails in turn; nothing is leaked. */
FIXTURE_TEST(test_opening_fails)
{
    static const char *const calls[] = {
        "cuDeviceGet",     "cuDeviceGetName",    "cuDeviceTotalMem_v2",     "cuDeviceGetAttribute",
        "cuCtxSetCurrent", "cuMemGetInfo_v2",    "cuModuleGetFunction",     "cuStreamCreate",
        "cuEventCreate",   "cuMemAllocHost_v2",  "cuMemAlloc_v2",           "cuMemcpyHtoDAsync_v2",
        "cuEventRecord",   "cuEventSynchronize", "cuDevicePrimaryCtxRetain"};
    struct fixture *f = *state;
    int (*live)(void) = (int (*)(void))dlsym(dlopen("libcuda.so.1", RTLD_NOW), "fake_cuda_live");
    struct bake_device *device;

    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        char setting[64];
        snprintf(setting, sizeof setting, "%s:1:999", calls[i]);
        setenv("FAKE_CUDA_FAIL", setting, 1);
        assert_int_equal(bake_device_open(f->ctx, "cuda", &f->job, &device), BSQ_ENODEVICE);
        assert_non_null(strstr(bsq_error(f->ctx), "CUDA error 999"));
        assert_int_equal(live(), 0);
        bsq_clear_error(f->ctx);
    }
}

/* Each call of a patch fails in turn, which is an error if the user named the device. The numbers
 * skip the calls that open the device: it uploads nine arrays, the triangles and those of the grid,
 * through two halves of a staging buffer. */
FIXTURE_TEST(test_tracing_fails)
{
    static const char *const calls[] = {
        "cuCtxSetCurrent:2",      "cuStreamCreate:2",        "cuMemAlloc_v2:10",
        "cuMemAllocHost_v2:3",    "cuMemcpyHtoDAsync_v2:10", "cuLaunchKernel:1",
        "cuMemcpyDtoHAsync_v2:1", "cuEventElapsedTime:2",    "cuStreamQuery:1"};
    struct fixture *f = *state;
    const struct bk_patch patch = {.width = WIDTH, .height = HEIGHT};
    struct sheet_texel *texels = calloc(TEXELS, sizeof *texels);
    int (*live)(void) = (int (*)(void))dlsym(dlopen("libcuda.so.1", RTLD_NOW), "fake_cuda_live");

    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        struct bake_device *device;
        char setting[64];
        int status;
        snprintf(setting, sizeof setting, "%s:719", calls[i]);
        setenv("FAKE_CUDA_FAIL", setting, 1);
        assert_int_equal(bake_device_open(f->ctx, "cuda", &f->job, &device), 0);
        status = bake_device_trace(device, &patch, f->samples, (float *)texels, 0);
        assert_int_equal(status, BSQ_ENODEVICE);
        assert_non_null(strstr(bsq_error(f->ctx), "Fake GPU 0 (CUDA): cu"));
        assert_non_null(
            strstr(bsq_error(f->ctx), ": CUDA_ERROR_LAUNCH_FAILED (unspecified launch failure)"));
        bsq_clear_error(f->ctx);
        bake_device_close(device);
        assert_int_equal(live(), 0);
    }
    free(texels);
}

/* "auto" takes the next GPU if one cannot be used. */
FIXTURE_TEST(test_auto_takes_the_next)
{
    struct fixture *f = *state;
    struct bsq_ctx *ctx = create_context(0);
    struct bake_device *device;

    setenv("FAKE_CUDA_DEVICES", "2", 1);
    setenv("FAKE_CUDA_FAIL", "cuModuleLoadDataEx:1:218", 1);
    assert_int_equal(bake_device_open(ctx, "auto", &f->job, &device), 0);
    /* The search for the second GPU restarts the fake driver and its count, so it fails too. */
    assert_non_null(strstr(warnings, "cuda:0 is not used: Fake GPU 0: compiling"));
    assert_non_null(strstr(warnings, "cuda:1 is not used: Fake GPU 1: compiling"));
    bake_device_close(device);
    test_context_end(ctx);
}

/* Page-locked memory counts for the budget. */
FIXTURE_TEST(test_budget)
{
    struct fixture *f = *state;
    struct bsq_ctx *ctx = create_context(1 << 20);
    struct bake_device *device;

    assert_int_equal(bake_device_open(ctx, "cuda", &f->job, &device), BSQ_ENOMEM);
    test_context_end(ctx);
}

static void on_any_gpu(void *arg, const struct bake_device_info *info)
{
    if (!info->is_gpu)
        return;
    strcat(arg, info->id);
    strcat(arg, " ");
}

/* Drivers are asked in a process that does not inherit a started CUDA, or else NVIDIA's OpenCL
 * driver and a second list would find no device. */
FIXTURE_TEST(test_list_after_cuda_started)
{
    struct fixture *f = *state;
    struct bsq_ctx *ctx = create_context(0);
    struct bake_device *device;
    char listed[256] = "";

    assert_int_equal(bake_device_open(ctx, "cuda", &f->job, &device), 0);
    assert_int_equal(bake_list_devices(ctx, on_any_gpu, listed), 0);
    assert_string_equal(listed, "cuda:0 opencl:0 ");
    bake_device_close(device);
    listed[0] = '\0';
    assert_int_equal(bake_list_devices(ctx, on_any_gpu, listed), 0);
    assert_string_equal(listed, "cuda:0 opencl:0 ");
    assert_string_equal(warnings, "");
    test_context_end(ctx);
}

/* A caller that was forked after it had started CUDA is told so. */
FIXTURE_TEST(test_forked_caller)
{
    struct fixture *f = *state;
    struct bake_device *device;
    int ended = -1;

    assert_int_equal(bake_device_open(f->ctx, "cuda", &f->job, &device), 0);
    bake_device_close(device);
    pid_t child = fork();
    if (child == 0) {
        int status = bake_device_open(f->ctx, "cuda", &f->job, &device);
        _exit(status == BSQ_ENODEVICE && strstr(bsq_error(f->ctx), "fork()") ? 0 : 1);
    }
    assert_int_equal(waitpid(child, &ended, 0), child);
    assert_int_equal(ended, 0);
}

/* A driver's library is found in directories that the dynamic linker does not search; a file that
 * is no library is skipped. */
FIXTURE_TEST(test_directories)
{
    static const char name[] = "libbisque-driver.so.1";
    char wrong[] = "/tmp/bisque-wrong-XXXXXX", right[] = "/tmp/bisque-right-XXXXXX", path[64];
    const char *const directories[] = {"/nowhere", wrong, right, NULL}, *found = name;
    struct link_map *fake = NULL;
    FILE *file;

    (void)state;
    assert_non_null(mkdtemp(wrong));
    assert_non_null(mkdtemp(right));
    assert_null(bake_driver_library(name, RTLD_NOW, directories, &found));
    assert_null(found);
    snprintf(path, sizeof path, "%s/%s", wrong, name);
    assert_non_null(file = fopen(path, "w"));
    fclose(file);
    assert_int_equal(dlinfo(dlopen("libcuda.so.1", RTLD_NOW), RTLD_DI_LINKMAP, &fake), 0);
    snprintf(path, sizeof path, "%s/%s", right, name);
    assert_int_equal(symlink(fake->l_name, path), 0);
    void *library = bake_driver_library(name, RTLD_NOW, directories, &found);
    assert_non_null(library);
    assert_ptr_equal(found, right);
    assert_non_null(dlsym(library, "fake_cuda_live"));
    assert_non_null(bake_driver_library("libcuda.so.1", RTLD_NOW, directories, &found));
    assert_null(found);
    unlink(path);
    snprintf(path, sizeof path, "%s/%s", wrong, name);
    unlink(path);
    rmdir(wrong);
    rmdir(right);
}

/* Returns whether the build compiled the kernel for CUDA. */
static bool has_kernel(void)
{
    struct bsq_ctx *ctx = create_context(0);
    struct bake_gpu *gpu;
    const struct bake_scene nothing = {0};
    bool has;

    setenv("FAKE_CUDA_DEVICES", "0", 1);
    has = bake_gpu_open(ctx, &bake_cuda_driver, 0, &nothing, &gpu) == BSQ_ENODEVICE &&
          !strstr(bsq_error(ctx), "built without CUDA");
    bsq_ctx_destroy(ctx);
    return has;
}

int main(void)
{
    if (open_fake() < 0)
        return 1;
    if (!has_kernel()) {
        const bool may_lack = !getenv("CI") || !*getenv("CI");
        printf("1..1\n%s 1 - CUDA%s\n", may_lack ? "ok" : "not ok",
               may_lack ? " # skip built without clang and nvcc"
                        : ": built without clang and nvcc");
        return !may_lack;
    }
    return test_run(traced_sheet_setup, traced_sheet_teardown);
}

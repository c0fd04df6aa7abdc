/* Tests which chunks a full cache evicts. */
#include "libvoxel/voxelize/cache/chunk_cache.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "tests/unit/test.h"

#include <fcntl.h>
#include <sys/stat.h>

enum { LEFT, RIGHT, APART, CHUNKS };

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_tris_file *file;
    struct vox_transform transform;
    struct vox_chunk_box boxes[CHUNKS];
    struct vox_chunks *chunks;
};

static void put_square(struct scan_mesh *mesh, uint32_t number, float x)
{
    for (uint32_t v = 0; v < 4; v++) {
        float *p = mesh->positions[4 * number + v];
        p[0] = x + (float)(v & 1);
        p[1] = (float)(v >> 1);
        p[2] = 0.0f;
    }
    for (uint32_t t = 0; t < 2; t++)
        for (uint32_t k = 0; k < 3; k++)
            mesh->triangles[2 * number + t][k] = 4 * number + (t == 0 ? k : 3 - k);
}

/* Makes three chunks, each a square of two triangles, for a cache of two. By their boxes, the right
 * chunk is needed last. */
static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    assert_non_null(f);
    f->ctx = test_context(1, 64 << 20);
    struct scan_mesh mesh = scan_mesh_new(4 * CHUNKS, 2 * CHUNKS);
    put_square(&mesh, LEFT, 0.0f);
    put_square(&mesh, RIGHT, 1.0f);
    put_square(&mesh, APART, 5.0f);
    scan_write(f->ctx, "scan.tris", &mesh, (double[3]){0, 0, 0}, NULL, 0, 2);
    scan_mesh_free(&mesh);
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &f->file), 0);
    const struct fmt_tris_header *header = fmt_tris_get_header(f->file);
    assert_int_equal(header->chunk_count, CHUNKS);
    assert_int_equal(vox_transform_init(f->ctx, header, "scan.tris", 0, 0.1, &f->transform), 0);
    for (uint32_t i = 0; i < CHUNKS; i++)
        f->boxes[i].chunk = i;
    f->boxes[RIGHT].box = (struct vox_box){.lo = {1280, 0, 0}, .hi = {1290, 0, 0}};
    assert_int_equal(
        vox_chunks_create(f->ctx, f->file, &f->transform, f->boxes, CHUNKS, true, 2, &f->chunks),
        0);
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    vox_chunks_destroy(f->chunks);
    fmt_tris_close(f->file);
    bsq_ctx_destroy(f->ctx);
    unlink("scan.tris");
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

/* Processes a region that needs the chunk. next: x of the origin of the next region that needs it,
 * 0: none. Returns the status of getting the chunk. */
static int use(struct fixture *f, uint32_t chunk, int32_t next)
{
    struct vox_box box = {.lo = {next, 0, 0}, .hi = {next, 0, 0}};
    const struct vox_chunk *content;
    vox_chunks_expect(f->chunks, chunk, 1, next ? vox_region_first(&box) : VOX_REGION_KEY_NEVER);
    int status = vox_chunks_acquire(f->chunks, chunk, &content);
    if (status == 0)
        vox_chunks_release(f->chunks, chunk);
    vox_chunks_done(f->chunks, chunk);
    return status;
}

/* Damages the chunk in the file, so that reading it from now on fails. The file keeps its times, so
 * that reading other chunks does not. */
static void damage(struct fixture *f, uint32_t chunk)
{
    int fd = open("scan.tris", O_RDWR);
    struct stat info;
    assert_int_equal(fstat(fd, &info), 0);
    off_t at = (off_t)fmt_tris_chunks(f->file)[chunk].offset + 20;
    uint8_t byte;
    assert_int_equal(pread(fd, &byte, 1, at), 1);
    byte ^= 1;
    assert_int_equal(pwrite(fd, &byte, 1, at), 1);
    assert_int_equal(futimens(fd, (struct timespec[]){info.st_atim, info.st_mtim}), 0);
    close(fd);
}

FIXTURE_TEST(the_chunk_that_is_needed_last_is_evicted)
{
    assert_int_equal(use(f, LEFT, 128), 0);
    assert_int_equal(use(f, RIGHT, 1000), 0);
    damage(f, LEFT);
    assert_int_equal(use(f, APART, 0), 0); /* in place of the right one */
    assert_int_equal(use(f, LEFT, 0), 0);
    damage(f, RIGHT);
    assert_int_equal(use(f, RIGHT, 0), BSQ_EDATA);
}

FIXTURE_TEST(a_chunk_that_is_not_needed_any_more_goes_first)
{
    assert_int_equal(use(f, APART, 0), 0);
    damage(f, APART);
    assert_int_equal(use(f, LEFT, 1000), 0);
    assert_int_equal(use(f, RIGHT, 1000), 0);
    damage(f, LEFT);
    assert_int_equal(use(f, LEFT, 0), 0);
    assert_int_equal(use(f, APART, 0), BSQ_EDATA);
}

RUN_TESTS(NULL, NULL)

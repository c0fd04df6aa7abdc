/* Tests whether inputs are told apart by what they contain. */
#include "formats/chunks/tris.h"
#include "formats/fingerprint.h"
#include "tests/unit/test.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char name[] = "input.file";

/* Writes a file, again and again until the system gives it another time of change. */
static void write_file(const char *text, off_t at)
{
    struct stat before = {0}, now;
    int fd = open(name, O_WRONLY | O_CREAT, 0600);
    assert_true(fd >= 0 && fstat(fd, &before) == 0);
    do {
        assert_int_equal(pwrite(fd, text, strlen(text), at), (ssize_t)strlen(text));
        assert_int_equal(fstat(fd, &now), 0);
    } while (now.st_ctim.tv_sec == before.st_ctim.tv_sec &&
             now.st_ctim.tv_nsec == before.st_ctim.tv_nsec);
    close(fd);
}

struct print {
    char hash[FMT_FINGERPRINT_BYTES];
};

static struct print print_now(void)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct print print;
    assert_int_equal(fmt_fingerprint(ctx, name, print.hash), 0);
    test_context_end(ctx);
    return print;
}

static bool is_same(const struct print *print)
{
    const struct print now = print_now();
    return strcmp(now.hash, print->hash) == 0;
}

/* Other content of the same size is noticed, also if the file has its old time of modification. */
TEST(test_changed_file)
{
    for (int restore = 0; restore < 2; restore++) {
        struct stat info;
        write_file("abcdef", 0);
        assert_int_equal(stat(name, &info), 0);
        const struct print print = print_now();
        write_file("abcdeg", 0);
        const struct timespec times[] = {info.st_atim, info.st_mtim};
        if (restore)
            assert_int_equal(utimensat(AT_FDCWD, name, times, 0), 0);
        assert_false(is_same(&print));
        /* The same content with another time is the same input. */
        write_file("abcdef", 0);
        assert_true(is_same(&print));
    }
}

/* Each byte of a texture or a mesh counts. */
TEST(test_large_file)
{
    const off_t size = (off_t)65 << 20, middle = size / 2 + 77;
    write_file("v 0 0 0\n", 0);
    assert_int_equal(truncate(name, size), 0);
    const struct print print = print_now();
    write_file("x", middle);
    assert_false(is_same(&print));
    assert_int_equal(truncate(name, middle), 0);
    assert_int_equal(truncate(name, size), 0);
    assert_true(is_same(&print));
}

/* ---- chunk files ---- */

enum { TRIANGLES = FMT_TRIS_CHUNK_TRIANGLES, CHUNKS = 22, ALTERED = 11 };

/* Encodes a chunk of triangles that stand side by side. `z` is the height of a vertex in the middle
 * of them, inside of the bounds: below 1. Returns its bytes. */
static uint8_t *encode_row(struct bsq_ctx *ctx, float z, uint64_t *size,
                           struct fmt_tris_chunk_info *info)
{
    float(*positions)[3] = malloc(sizeof(float[3 * TRIANGLES][3]));
    uint32_t(*triangles)[3] = malloc(sizeof(uint32_t[TRIANGLES][3]));
    uint8_t *bytes = malloc(fmt_tris_encoded_bound(0, TRIANGLES, 3 * TRIANGLES));
    for (uint32_t v = 0; v < 3 * TRIANGLES; v++) {
        const float at[3] = {(float)(v / 3), (float)(v % 3 == 1), (float)(v % 3 == 2)};
        memcpy(positions[v], at, sizeof at);
        triangles[v / 3][v % 3] = v;
    }
    positions[3 * (TRIANGLES / 2) + 2][2] = z;
    const struct fmt_tris_chunk chunk = {.triangle_count = TRIANGLES,
                                         .vertex_count = 3 * TRIANGLES,
                                         .positions = (const float(*)[3])positions,
                                         .triangles = (const uint32_t(*)[3])triangles};
    assert_int_equal(fmt_tris_encode(ctx, 0, &chunk, bytes, size, info), 0);
    free(positions);
    free(triangles);
    return bytes;
}

/* Writes chunks, one of which has a vertex at height z. The first and the last 4 KiB hold nothing
 * of it but its checksum, and those of the table and of the header. */
static void write_chunks(float z)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    const struct fmt_tris_header header = {0};
    struct fmt_tris_chunk_info infos[2];
    struct fmt_tris_writer *writer;
    uint64_t size;
    uint8_t *row = encode_row(ctx, 1, &size, &infos[0]),
            *altered = encode_row(ctx, z, &size, &infos[1]);
    assert_int_equal(fmt_tris_create(ctx, name, &header, &writer), 0);
    for (int i = 0; i < CHUNKS; i++)
        assert_int_equal(
            fmt_tris_append(writer, i == ALTERED ? altered : row, size, &infos[i == ALTERED]), 0);
    assert_true(CHUNKS * size > (64 << 20));
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
    free(altered);
    free(row);
    test_context_end(ctx);
}

/* Loads the chunk that may be altered. */
static int load_altered(void)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct fmt_tris_file *file;
    struct fmt_tris_chunk chunk;
    assert_int_equal(fmt_tris_open(ctx, name, &file), 0);
    void *scratch = malloc(fmt_tris_load_size(file, ALTERED));
    const int status = fmt_tris_load(file, ALTERED, scratch, &chunk);
    free(scratch);
    fmt_tris_close(file);
    test_context_end(ctx);
    return status;
}

/* A vertex of a large chunk file counts. A damaged chunk does not; whoever loads it finds that. */
TEST(test_large_chunk_file)
{
    write_chunks(1);
    const struct print print = print_now();
    write_chunks(0.5f);
    assert_false(is_same(&print));
    write_chunks(1);
    assert_true(is_same(&print));
    assert_int_equal(load_altered(), 0);
    write_file("x", ((off_t)33 << 20) + 1000);
    assert_true(is_same(&print));
    assert_int_equal(load_altered(), BSQ_EDATA);
    write_file("x", 40); /* of the header */
    struct bsq_ctx *ctx = test_context(1, 0);
    char hash[FMT_FINGERPRINT_BYTES];
    assert_int_equal(fmt_fingerprint(ctx, name, hash), BSQ_EDATA);
    test_context_end(ctx);
}

RUN_TESTS(NULL, NULL)

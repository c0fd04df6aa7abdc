/* obj_fixture.h - reads mesh files into arrays, for the tests of the readers. */
#ifndef TEST_OBJ_FIXTURE_H
#define TEST_OBJ_FIXTURE_H

#include "formats/mesh/mesh_reader.h"
#include "tests/unit/fixture.h"

/* The batches of a scan, joined. The fields are those of struct fmt_mesh_batch. */
struct obj_scan {
    struct fmt_mesh_totals totals;
    double (*positions)[3];
    float (*colors)[3];
    double (*texcoords)[2];
    float (*normals)[3];
    uint32_t *sizes;
    uint64_t *corners[3];
    uint32_t *materials; /* of each face */
    uint64_t batches;
};

/* A reader and the scan that it read. obj_close() frees all of it. */
struct obj_fixture {
    struct bsq_ctx *ctx;
    struct fmt_mesh_reader *reader;
    struct obj_scan scan;
    int status; /* of opening and reading */
};

void obj_read_files(struct obj_fixture *f, unsigned threads, uint32_t count,
                    const char *const *paths);
/* Reads one file with this text. Fails the test if that fails. */
void obj_read_text(struct obj_fixture *f, const char *text);
void obj_close(struct obj_fixture *f);
void obj_free_scan(struct obj_scan *scan);

/* Returns the line, from 1, of face number `face`, from 0. */
uint64_t obj_line_of_face(const struct obj_fixture *f, uint64_t face);
void obj_assert_material(const struct obj_fixture *f, uint32_t material, const char *name);
/* Checks the indices of a kind of all `count` corners, given as int. Below 0: a corner has none. */
void obj_assert_corners(const struct obj_fixture *f, int kind, uint64_t count, ...);
/* Checks that reading `text` fails with `message`. */
void obj_expect_error(const char *text, size_t size, const char *message);
void ply_expect_error(const char *text, size_t size, const char *message);
void obj_expect_text_error(const char *text, const char *message);
/* Reads a file twice, and checks the warnings, which must come once, each as a line. */
void mesh_expect_warnings(const char *path, unsigned threads, const char *expected);

#endif

/* sort_fixture.h - for the tests of the sorter: scans as text, sorted, and read again as a multiset
 * of triangles. */
#ifndef TEST_SORT_FIXTURE_H
#define TEST_SORT_FIXTURE_H

#include "formats/chunks/tris.h"
#include "libvoxel/sort_limits.h"

#define MIB ((uint64_t)1 << 20)

struct sort_fixture {
    char dir[64], obj[96], obj2[96], tris[96];
    struct bsq_ctx *ctx;
    char warning[256];
    unsigned warnings;
    bool beyond_total;            /* some stage did more than it said it would */
    struct bsq_progress progress; /* the last report of a stage */
    struct vox_sort_report report;
};

/* Ends the context before, which must have given all memory back. */
void sort_open_context(struct sort_fixture *f, uint64_t memory, unsigned threads);
int sort_set_up(void **state);
/* Nothing but the files named in the fixture may be left. */
int sort_tear_down(void **state);
void sort_write_text(const char *path, const char *text);
/* Sorts to tris; the report is the fixture's. */
int sort_files(struct sort_fixture *f, const char *const *paths, uint32_t count);
int sort_text(struct sort_fixture *f, const char *text);
void expect_sorted(struct sort_fixture *f, int status);

struct sorted_corner {
    float position[3];
    float texcoord[2];
    uint32_t color, normal;
};

struct sorted_triangle {
    struct sorted_corner corners[3];
    uint32_t material;
};

struct sorted_triangles {
    struct sorted_triangle *list;
    size_t count, capacity;
};

void sorted_add(struct sorted_triangles *t, const struct sorted_triangle *one);
/* Whatever the order; both are freed. */
void expect_same_triangles(struct sorted_triangles *got, struct sorted_triangles *expected);
/* Reads the sorted file whole; header (may be NULL) is copied without its materials. */
void read_sorted(struct sort_fixture *f, struct sorted_triangles *out,
                 struct fmt_tris_header *header);
/* To be freed with free(). */
uint8_t *sort_read_bytes(const char *path, size_t *size);

#endif

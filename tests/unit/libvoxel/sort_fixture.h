/* sort_fixture.h - sorts scans for tests, and reads the result as a multiset of triangles. */
#ifndef TEST_SORT_FIXTURE_H
#define TEST_SORT_FIXTURE_H

#include "formats/chunks/tris.h"
#include "libvoxel/sort_limits.h"

#define MIB ((uint64_t)1 << 20)

struct sort_fixture {
    struct bsq_ctx *ctx;
    char warning[256], warning_before[256]; /* the last one, and the one before it */
    unsigned warnings;
    bool beyond_total;            /* some stage reported more work than its total */
    struct bsq_progress progress; /* the last report of a stage */
    struct vox_sort_report report;
};

/* Opens a context. Closes the previous one and checks that all its memory was freed. */
void sort_open_context(struct sort_fixture *f, uint64_t memory, unsigned threads);
int sort_set_up(void **state);
int sort_tear_down(void **state);
/* Sorts files to "scan.tris" and fills f->report. */
int sort_files(struct sort_fixture *f, const char *const *paths, uint32_t count);
/* Returns options that sort "scan.obj" to "scan.tris". */
struct vox_sort_options sort_scan_obj(void);
/* Sorts "scan.obj". */
int sort_scan(struct sort_fixture *f);
int sort_text(struct sort_fixture *f, const char *text);
void expect_sorted(struct sort_fixture *f, int status);
/* Writes an image of one texel, "wall.png". Returns its name. */
const char *sort_write_image(void);

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
/* Compares without regard to order, and frees both. */
void expect_same_triangles(struct sorted_triangles *got, struct sorted_triangles *expected);
/* Reads the whole sorted file. *header gets its header without materials, unless it is NULL. */
void read_sorted(struct sort_fixture *f, struct sorted_triangles *out,
                 struct fmt_tris_header *header);

#endif

/* Tests that polygons are triangulated in the same way, whether positions are in memory or in a
 * file. */
#include "libvoxel/partition/partition.h"
#include "sort_grid.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) TEST_EACH(name, sort_set_up, sort_tear_down)

enum {
    NORMALS = 1,
    TEXCOORDS = 2,
    SHUFFLED = 4,
    MATERIALS = 8,
    MIXED = 16,
    GIANT = 32,
    TANGLED = 64
};

#define SIDE          200u /* vertices along a row */
#define GIANT_CORNERS (RUN_TRIANGLES + 3)

/* Writes a polygon of bumpy quads, far from flat and convex: vertices first to first + width of
 * this row, and those of the next row in reverse. */
static void write_face(FILE *file, unsigned flags, uint32_t first, uint32_t width, uint64_t *seed)
{
    const uint32_t corners = 2 * (width + 1);
    if (flags & MATERIALS && sort_random(seed) % 5 == 0)
        fprintf(file, "usemtl m%u\n", sort_random(seed) % 3);
    fputc('f', file);
    for (uint32_t c = 0; c < corners; c++) {
        uint32_t v = c <= width ? first + c : first + SIDE + corners - 1 - c;
        bool textured = flags & TEXCOORDS && !(flags & MIXED && sort_random(seed) % 3 == 0);
        fprintf(file, " %u", v + 1);
        if (textured)
            fprintf(file, "/%u", v % 777 + 1);
        if (flags & NORMALS)
            fprintf(file, "%s/%u", textured ? "" : "/", v % 5 + 1);
    }
    fputc('\n', file);
}

static void shuffle(uint32_t *order, uint32_t count, uint64_t *seed)
{
    for (uint32_t i = count - 1; i > 0; i--) {
        uint32_t other = sort_random(seed) % (i + 1), kept = order[i];
        order[i] = order[other];
        order[other] = kept;
    }
}

#define TANGLED_FACES   1500u
#define TANGLED_CORNERS 100u

/* Writes polygons with corners anywhere in the scan. */
static uint64_t write_tangled(FILE *file, uint64_t *seed)
{
    for (uint32_t i = 0; i < TANGLED_FACES; i++) {
        fputc('f', file);
        for (uint32_t c = 0; c < TANGLED_CORNERS; c++)
            fprintf(file, " %u", sort_random(seed) % (SIDE * SIDE) + 1);
        fputc('\n', file);
    }
    return (uint64_t)TANGLED_FACES * (TANGLED_CORNERS - 2);
}

/* Returns how many triangles the polygons have. */
static uint64_t write_polygons(const char *path, unsigned flags, uint64_t seed)
{
    FILE *file = fopen(path, "wb");
    uint32_t faces[SIDE * SIDE][2], order[SIDE * SIDE], count = 0;
    uint64_t triangles = 0;
    assert_non_null(file);
    for (uint32_t v = 0; v < SIDE * SIDE; v++)
        fprintf(file, "v %.4f %.4f %.4f\n", v % SIDE + sort_random(&seed) % 1000 / 1250.0,
                v / SIDE + sort_random(&seed) % 1000 / 1250.0, sort_random(&seed) % 1000 / 50.0);
    for (uint32_t t = 0; flags & TEXCOORDS && t < 777; t++)
        fprintf(file, "vt %.3f %.3f\n", t / 777.0, sort_random(&seed) % 1000 / 1000.0);
    if (flags & NORMALS)
        fputs("vn 0 0 1\nvn 0 1 0\nvn 1 0 0\nvn 0 0 -1\nvn 1 2 3\n", file);
    for (uint32_t y = 0; y + 1 < SIDE; y++)
        for (uint32_t x = 0, width; x + 1 < SIDE; x += width, count++) {
            width = sort_random(&seed) % 3 ? 1 : sort_random(&seed) % 9 + 1;
            width = width < SIDE - 1 - x ? width : SIDE - 1 - x;
            faces[count][0] = y * SIDE + x;
            faces[count][1] = width;
            order[count] = count;
        }
    if (flags & SHUFFLED)
        shuffle(order, count, &seed);
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t *face = faces[order[i]];
        write_face(file, flags, face[0], face[1], &seed);
        triangles += 2 * face[1];
        if (i % 7 == 0) { /* and a triangle that repeats part of it */
            fprintf(file, "f %u %u %u\n", face[0] + 1, face[0] + 2, face[0] + SIDE + 1);
            triangles++;
        }
    }
    if (flags & GIANT) {
        fputc('f', file);
        for (uint32_t v = 1; v <= GIANT_CORNERS; v++)
            fprintf(file, " %u", v * 31 + 1);
        fputc('\n', file);
        triangles += GIANT_CORNERS - 2;
    }
    if (flags & TANGLED)
        triangles += write_tangled(file, &seed);
    assert_int_equal(fclose(file), 0);
    return triangles;
}

/* Sets the limits of a way to sort. Way 0 keeps everything in memory. */
static void choose_limits(unsigned way, struct sort_limits *limits)
{
    vox_sort_limits_for(128 * MIB, 2, limits);
    if (way > 0)
        limits->stream_bytes = 0;
    limits->two_passes = way % 2;
    if (way == 3 || way == 4)
        limits->batch_triangles = 70000; /* buckets are divided several times */
    if (way == 5 || way == 6)
        limits->vertex_bucket_bytes = SIDE * SIDE; /* a byte for each vertex */
    if (way == 7)
        limits->index_bytes = 5;
    if (way == 8)
        limits->page_memory = limits->max_page_memory = 1;
}

static int sort_polygons(struct sort_fixture *f, unsigned flags, unsigned way)
{
    struct sort_limits limits;
    const char *texture = sort_write_image();
    struct vox_sort_options options = sort_scan_obj();
    options.texture_path = flags & TEXCOORDS ? texture : NULL;
    choose_limits(way, &limits);
    sort_open_context(f, 128 * MIB, way % 2 ? 2 : 3);
    bsq_forget_files(f->ctx);
    return vox_sort_with_limits(f->ctx, &options, &limits, &f->report);
}

static void expect_the_same_for_all_ways(struct sort_fixture *f, unsigned flags)
{
    const uint64_t triangles = write_polygons("scan.obj", flags, 17 + flags);
    size_t sizes[2];
    uint8_t *expected = NULL;
    for (unsigned way = 0; way < 9; way++) {
        expect_sorted(f, sort_polygons(f, flags, way));
        assert_int_equal(f->report.triangles + f->report.degenerate_triangles, triangles);
        assert_string_equal(f->progress.stage, flags & NORMALS ? "writing" : "normals");
        assert_int_equal(f->progress.done, f->progress.total);
        assert_false(f->beyond_total);
        /* Vertices between chunks go to temporary files too, if there are many. */
        if (way > 0 || !(flags & TANGLED))
            assert_int_equal(f->report.temp_bytes > 0, way > 0);
        uint8_t *bytes = test_read("scan.tris", &sizes[way > 0]);
        if (way == 0) {
            expected = bytes;
            continue;
        }
        assert_int_equal(sizes[0], sizes[1]);
        assert_memory_equal(bytes, expected, sizes[0]);
        free(bytes);
    }
    free(expected);
}

FIXTURE_TEST(polygons_of_positions_are_split_the_same_way)
{
    expect_the_same_for_all_ways(*state, 0);
    expect_the_same_for_all_ways(*state, SHUFFLED);
}

FIXTURE_TEST(polygons_keep_their_attributes)
{
    expect_the_same_for_all_ways(*state, NORMALS);
    expect_the_same_for_all_ways(*state, TEXCOORDS | SHUFFLED);
    expect_the_same_for_all_ways(*state, TEXCOORDS | NORMALS | MATERIALS);
}

/* Triangles are textured if their own corners have coordinates. */
FIXTURE_TEST(polygons_may_lack_some_texture_coordinates)
{
    expect_the_same_for_all_ways(*state, TEXCOORDS | MIXED | SHUFFLED);
}

FIXTURE_TEST(a_polygon_may_be_larger_than_a_run)
{
    expect_the_same_for_all_ways(*state, GIANT);
}

FIXTURE_TEST(polygons_may_have_corners_anywhere)
{
    expect_the_same_for_all_ways(*state, TANGLED);
}

RUN_TESTS(NULL, NULL)

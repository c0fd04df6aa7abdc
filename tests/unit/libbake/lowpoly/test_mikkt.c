/* test_mikkt.c - tangents against those that Blender computed (tests/golden/mikkt), and properties
 * that hold for any mesh. Runs from the top of the source tree. */
#include "libbake/lowpoly/mikkt.h"
#include "tests/unit/test.h"

struct soup {
    uint64_t count;
    float (*positions)[3][3];
    float (*normals)[3][3];
    float (*texcoords)[3][2];
    float (*expected)[3][4];
    float (*tangents)[3][4];
};

static struct soup new_soup(uint64_t count)
{
    struct soup s = {.count = count};
    s.positions = calloc(count, sizeof(*s.positions));
    s.normals = calloc(count, sizeof(*s.normals));
    s.texcoords = calloc(count, sizeof(*s.texcoords));
    s.expected = calloc(count, sizeof(*s.expected));
    s.tangents = calloc(count, sizeof(*s.tangents));
    assert_true(s.positions && s.normals && s.texcoords && s.expected && s.tangents);
    return s;
}

static void free_soup(struct soup *s)
{
    free(s->positions);
    free(s->normals);
    free(s->texcoords);
    free(s->expected);
    free(s->tangents);
}

static void compute(struct soup *s)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    assert_int_equal(bake_mikkt(ctx, s->count, (const float(*)[3][3])s->positions,
                                (const float(*)[3][3])s->normals,
                                (const float(*)[3][2])s->texcoords, s->tangents),
                     0);
    test_context_end(ctx);
}

static void read_corner(FILE *file, struct soup *s, uint64_t corner)
{
    float *p = s->positions[corner / 3][corner % 3], *n = s->normals[corner / 3][corner % 3];
    float *uv = s->texcoords[corner / 3][corner % 3], *t = s->expected[corner / 3][corner % 3];
    assert_int_equal(fscanf(file, "%f,%f,%f,%f,%f,%f,%f,%f,%f,%f,%f,%f\n", &p[0], &p[1], &p[2],
                            &n[0], &n[1], &n[2], &uv[0], &uv[1], &t[0], &t[1], &t[2], &t[3]),
                     12);
}

static struct soup read_golden(const char *name)
{
    char path[sizeof test_start + 64], line[256];
    uint64_t lines = 0;

    snprintf(path, sizeof(path), "%s/tests/golden/mikkt/%s.csv", test_start, name);
    FILE *file = fopen(path, "r");
    if (file == NULL)
        fail_msg("cannot open %s", path);
    while (fgets(line, sizeof(line), file))
        lines++;
    assert_true(lines > 1 && (lines - 1) % 3 == 0);
    struct soup s = new_soup((lines - 1) / 3);
    rewind(file);
    assert_non_null(fgets(line, sizeof(line), file));
    for (uint64_t corner = 0; corner < 3 * s.count; corner++)
        read_corner(file, &s, corner);
    fclose(file);
    return s;
}

static double difference(const float a[4], const float b[4])
{
    double worst = 0;
    for (int k = 0; k < 4; k++)
        worst = fmax(worst, fabs((double)a[k] - (double)b[k]));
    return worst;
}

static void assert_equal_tangents(const struct soup *s, const float (*expected)[3][4],
                                  double tolerance, const char *name)
{
    for (uint64_t t = 0; t < s->count; t++) {
        for (int i = 0; i < 3; i++) {
            const float *a = s->tangents[t][i], *b = expected[t][i];
            if (!(difference(a, b) <= tolerance))
                fail_msg("%s: triangle %llu, corner %d: (%g %g %g, %g), expected (%g %g %g, %g)",
                         name, (unsigned long long)t, i, a[0], a[1], a[2], a[3], b[0], b[1], b[2],
                         b[3]);
        }
    }
}

static void golden(const char *name)
{
    struct soup s = read_golden(name);
    compute(&s);
    assert_equal_tangents(&s, (const float(*)[3][4])s.expected, 1e-4, name);
    free_soup(&s);
}

static const char *const golden_names[] = {
    "torus_seams",    "cube_hard_edges",      "split_normals", "mirrored",
    "degenerate_uvs", "degenerate_triangles", "non_manifold",  "soup"};

TEST(test_golden)
{
    for (size_t n = 0; n < sizeof(golden_names) / sizeof(*golden_names); n++)
        golden(golden_names[n]);
}

/* Copies corner `from` of `a` to corner `to` of `b`, with its tangent as the expected one. Corners
 * are numbered 3 * triangle + i. */
static void copy_corner(const struct soup *a, uint64_t from, struct soup *b, uint64_t to)
{
    memcpy(b->positions[to / 3][to % 3], a->positions[from / 3][from % 3], 3 * sizeof(float));
    memcpy(b->normals[to / 3][to % 3], a->normals[from / 3][from % 3], 3 * sizeof(float));
    memcpy(b->texcoords[to / 3][to % 3], a->texcoords[from / 3][from % 3], 2 * sizeof(float));
    memcpy(b->expected[to / 3][to % 3], a->tangents[from / 3][from % 3], 4 * sizeof(float));
}

/* Checks that the order of triangles and their first corners do not matter. This holds for manifold
 * meshes without flat triangles. */
static void reorder(const char *name, unsigned seed)
{
    struct soup s = read_golden(name), shuffled = new_soup(s.count);
    uint64_t *order = calloc(s.count, sizeof(*order));

    assert_non_null(order);
    compute(&s);
    srand(seed);
    for (uint64_t t = 0; t < s.count; t++) {
        uint64_t other = (uint64_t)rand() % (t + 1);
        order[t] = order[other];
        order[other] = t;
    }
    for (uint64_t t = 0; t < s.count; t++) {
        uint64_t turn = (uint64_t)rand() % 3;
        for (uint64_t i = 0; i < 3; i++)
            copy_corner(&s, 3 * order[t] + (i + turn) % 3, &shuffled, 3 * t + i);
    }
    compute(&shuffled);
    assert_equal_tangents(&shuffled, (const float(*)[3][4])shuffled.expected, 1e-5, name);
    free(order);
    free_soup(&shuffled);
    free_soup(&s);
}

TEST(test_order_does_not_matter)
{
    const unsigned seed = 7041;
    (void)state;
    print_message("seed %u\n", seed);
    for (unsigned n = 0; n < 10; n++) {
        reorder("torus_seams", seed + n);
        reorder("split_normals", seed + n);
        reorder("mirrored", seed + n);
    }
}

/* Mirroring the texture space in u negates tangents and signs. */
TEST(test_mirroring_negates)
{
    struct soup s = read_golden("torus_seams");
    compute(&s);
    memcpy(s.expected, s.tangents, s.count * sizeof(*s.expected));
    for (uint64_t t = 0; t < s.count; t++) {
        for (int i = 0; i < 3; i++) {
            s.texcoords[t][i][0] = -s.texcoords[t][i][0];
            for (int k = 0; k < 4; k++)
                s.expected[t][i][k] = -s.expected[t][i][k];
        }
    }
    compute(&s);
    assert_equal_tangents(&s, (const float(*)[3][4])s.expected, 1e-5, "mirrored torus");
    free_soup(&s);
}

/* If the texture coordinates of a plane are its x and y, tangents are the x axis. */
TEST(test_plane)
{
    static const float corners[2][3][2] = {{{0, 0}, {3, 0}, {3, 2}}, {{0, 0}, {3, 2}, {0, 2}}};
    struct soup s = new_soup(2);
    for (int t = 0; t < 2; t++) {
        for (int i = 0; i < 3; i++) {
            memcpy(s.positions[t][i], corners[t][i], 2 * sizeof(float));
            memcpy(s.texcoords[t][i], corners[t][i], 2 * sizeof(float));
            s.normals[t][i][2] = 1;
            s.expected[t][i][0] = s.expected[t][i][3] = 1;
        }
    }
    compute(&s);
    assert_equal_tangents(&s, (const float(*)[3][4])s.expected, 0, "plane");
    free_soup(&s);
}

/* -0 and 0 are the same coordinate. */
TEST(test_negative_zero_welds)
{
    struct soup s = read_golden("mirrored");
    compute(&s);
    memcpy(s.expected, s.tangents, s.count * sizeof(*s.expected));
    for (uint64_t t = 0; t < s.count; t += 2) {
        for (int i = 0; i < 3; i++) {
            if (s.positions[t][i][0] == 0)
                s.positions[t][i][0] = -0.0f;
            if (s.texcoords[t][i][0] == 0)
                s.texcoords[t][i][0] = -0.0f;
        }
    }
    compute(&s);
    assert_equal_tangents(&s, (const float(*)[3][4])s.expected, 0, "negative zeros");
    free_soup(&s);
}

CONTEXT_TEST(test_empty, 1, 0)
{
    assert_int_equal(bake_mikkt(ctx, 0, NULL, NULL, NULL, NULL), 0);
}

/* All triangles share one edge: time stays linear. */
TEST(test_many_triangles_on_one_edge)
{
    const uint64_t count = 100000;
    struct soup s = new_soup(count);
    for (uint64_t t = 0; t < count; t++) {
        const float angle = 6.28f * (float)t / (float)count;
        const float corners[3][3] = {{0, 0, 0}, {0, 0, 1}, {cosf(angle), sinf(angle), 0}};
        const float uvs[3][2] = {{0, 0}, {0, 1}, {1, 0}};
        memcpy(s.positions[t], corners, sizeof(corners));
        memcpy(s.texcoords[t], uvs, sizeof(uvs));
        for (int i = 0; i < 3; i++)
            s.normals[t][i][0] = 1;
    }
    compute(&s);
    for (uint64_t t = 0; t < count; t++)
        assert_true(isfinite(s.tangents[t][0][0]) && fabsf(s.tangents[t][0][3]) == 1);
    free_soup(&s);
}

RUN_TESTS(NULL, NULL)

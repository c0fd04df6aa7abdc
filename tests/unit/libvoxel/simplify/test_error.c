/* Simplifies small random meshes to an error, and compares the result with the scan by brute force:
 * no vertex of one may be farther from the other than the error. With LONG, 1,000 meshes. */
#include <stdlib.h>

#include "libvoxel/voxel.h"
#include "tests/unit/test.h"

enum { MESHES = 10, MESHES_LONG = 1000, SIDE_MAX = 16 };

struct mesh {
    unsigned vertices, triangles;
    double (*positions)[3];
    unsigned (*corners)[3];
};

static double random_number(uint64_t *state)
{
    *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(*state >> 40) / (double)(1 << 24);
}

/* Writes a rough sheet of n x n squares, bent into a tube or with a hole, as the seed says. */
static void write_scan(unsigned n, uint64_t *seed)
{
    const double rough = random_number(seed) * random_number(seed) * fmin(1, SIDE_MAX / (double)n),
                 bent = 6 * random_number(seed);
    const bool hole = random_number(seed) < 0.3, closed = random_number(seed) < 0.3;
    FILE *file = fopen("scan.obj", "w");
    assert_non_null(file);
    for (unsigned i = 0; i < (n + 1) * (n + 1); i++) {
        const double x = (double)(i % (n + 1)) / n, y = (double)(i / (n + 1)) / n;
        const double angle = closed ? 6.283185307179586 * x : bent * x + 0.01;
        const double r = 1 + rough * (random_number(seed) - 0.5);
        fprintf(file, "v %.9g %.9g %.9g\n", r * cos(angle), r * sin(angle), y);
    }
    for (unsigned y = 0; y < n; y++)
        for (unsigned x = 0; x < n; x++) {
            const unsigned a = y * (n + 1) + x + 1, right = closed && x + 1 == n ? a - x : a + 1;
            if (!hole || x != n / 2 || y != n / 2)
                fprintf(file, "f %u %u %u\nf %u %u %u\n", a, right, right + n + 1, a, right + n + 1,
                        a + n + 1);
        }
    assert_int_equal(fclose(file), 0);
}

static void read_mesh(const char *path, struct mesh *mesh)
{
    enum { MOST = 4 * SIDE_MAX * SIDE_MAX };
    char line[256];
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    *mesh = (struct mesh){.positions = calloc(MOST, sizeof *mesh->positions),
                          .corners = calloc(MOST, sizeof *mesh->corners)};
    assert_true(mesh->positions && mesh->corners);
    while (fgets(line, sizeof line, file)) {
        double *p = mesh->positions[mesh->vertices];
        unsigned v[3];
        if (sscanf(line, "v %lf %lf %lf", &p[0], &p[1], &p[2]) == 3) {
            mesh->vertices++;
        } else if (sscanf(line, "f %u//%*u %u//%*u %u//", &v[0], &v[1], &v[2]) == 3 ||
                   sscanf(line, "f %u %u %u", &v[0], &v[1], &v[2]) == 3) {
            for (int k = 0; k < 3; k++)
                mesh->corners[mesh->triangles][k] = v[k] - 1;
            mesh->triangles++;
        }
    }
    fclose(file);
}

static void free_mesh(struct mesh *mesh)
{
    free(mesh->positions);
    free(mesh->corners);
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Returns the squared distance of p from the triangle: by its edges, and by its plane if p is above
 * the inside. */
static double brute_square(const struct mesh *mesh, unsigned t, const double p[3])
{
    double least = INFINITY, normal[3], e[3][3], to[3][3];
    bool inside = true;
    for (int i = 0; i < 3; i++) {
        const double *a = mesh->positions[mesh->corners[t][i]],
                     *b = mesh->positions[mesh->corners[t][(i + 1) % 3]];
        for (int k = 0; k < 3; k++) {
            e[i][k] = b[k] - a[k];
            to[i][k] = p[k] - a[k];
        }
        const double length = dot(e[i], e[i]);
        const double s = length > 0 ? fmin(1, fmax(0, dot(e[i], to[i]) / length)) : 0;
        double square = 0;
        for (int k = 0; k < 3; k++)
            square += (to[i][k] - s * e[i][k]) * (to[i][k] - s * e[i][k]);
        least = fmin(least, square);
    }
    for (int k = 0; k < 3; k++)
        normal[k] = e[0][(k + 1) % 3] * e[1][(k + 2) % 3] - e[0][(k + 2) % 3] * e[1][(k + 1) % 3];
    for (int i = 0; i < 3; i++) {
        double outwards[3];
        for (int k = 0; k < 3; k++)
            outwards[k] =
                e[i][(k + 1) % 3] * normal[(k + 2) % 3] - e[i][(k + 2) % 3] * normal[(k + 1) % 3];
        inside &= dot(outwards, to[i]) <= 0;
    }
    const double height = dot(normal, to[0]), area = dot(normal, normal);
    return inside && area > 0 ? fmin(least, height * height / area) : least;
}

/* Returns the largest distance of a vertex of one mesh from the other. */
static double farthest(const struct mesh *from, const struct mesh *to)
{
    double most = 0;
    for (unsigned t = 0; t < from->triangles; t++)
        for (int k = 0; k < 3; k++) {
            double least = INFINITY;
            for (unsigned i = 0; i < to->triangles; i++)
                least = fmin(least, brute_square(to, i, from->positions[from->corners[t][k]]));
            most = fmax(most, least);
        }
    return sqrt(most);
}

/* Writes a scan, sorts it, and gives the options that simplify it. */
static void begin_simplifying(struct bsq_ctx *ctx, unsigned n, uint64_t *seed,
                              struct vox_simplify_options *options)
{
    static const char *const scans[] = {"scan.obj"}, *const lows[] = {"low.obj"};
    struct vox_sort_options sort;
    struct vox_sort_report sorted = {.size = sizeof sorted};
    write_scan(n, seed);
    vox_sort_defaults(&sort);
    sort.scan_paths = scans;
    sort.scan_count = 1;
    sort.tris_path = "scan.tris";
    assert_int_equal(vox_sort(ctx, &sort, &sorted), 0);
    vox_simplify_defaults(options);
    options->tris_path = "scan.tris";
    options->output_paths = lows;
}

static void try_mesh(uint64_t *seed)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct vox_simplify_options options;
    struct vox_simplify_report report = {.size = sizeof report};
    struct mesh scan, low;
    begin_simplifying(ctx, 4 + (unsigned)(random_number(seed) * (SIDE_MAX - 4)), seed, &options);
    options.error = 0.003 + 0.2 * random_number(seed) * random_number(seed);
    assert_int_equal(vox_simplify(ctx, &options, &report), 0);
    read_mesh("scan.obj", &scan);
    read_mesh("low.obj", &low);
    assert_int_equal(scan.triangles, report.triangles);
    assert_int_equal(low.triangles, report.levels[0].triangles);
    const double there = farthest(&scan, &low), back = farthest(&low, &scan);
    /* Positions are written in nine digits. */
    assert_true(there <= options.error + 1e-6 && back <= options.error + 1e-6);
    assert_true(there <= report.levels[0].from_scan.max + 1e-6);
    assert_true(back <= report.levels[0].from_mesh.max + 1e-6);
    free_mesh(&low);
    free_mesh(&scan);
    test_context_end(ctx);
}

TEST(errors_are_kept)
{
    uint64_t seed = test_seed();
    const int meshes = getenv("LONG") ? MESHES_LONG : MESHES;
    for (int i = 0; i < meshes; i++)
        try_mesh(&seed);
}

/* Scans of more than 200,000 triangles are reduced in groups, which temporary files hold. */
TEST(each_call_counts_its_own_temporary_bytes)
{
    static const uint64_t targets[] = {30000};
    uint64_t seed = 1;
    struct bsq_ctx *ctx = test_context(1, 0);
    struct vox_simplify_options options;
    struct vox_simplify_report first = {.size = sizeof first}, second = {.size = sizeof second};
    begin_simplifying(ctx, 320, &seed, &options);
    options.targets = targets;
    options.target_count = 1;
    assert_int_equal(vox_simplify(ctx, &options, &first), 0);
    assert_int_equal(vox_simplify(ctx, &options, &second), 0);
    assert_true(first.temp_bytes > 0);
    assert_int_equal(second.temp_bytes, first.temp_bytes);
    test_context_end(ctx);
}

RUN_TESTS(NULL, NULL)

/* Compares the distances of pairs of meshes with a search of its own: triangles are cut in four
 * until no part can be farther from the other mesh than points that were found, by brute force. No
 * point may be farther than what is reported, and that may be 1 % above the farthest point. The
 * meshes are random ones, and the kinds that are hard to bound. With LONG, 10,000 pairs. */
#include <stdlib.h>
#include <string.h>

#include "libvoxel/voxel.h"
#include "tests/unit/test.h"

enum { PAIRS = 240, PAIRS_LONG = 10000, MOST = 400, KINDS = 10, DEPTH = 12, PARTS = 6000 };

struct mesh {
    unsigned triangles;
    double corners[MOST][3][3];
};

static double random_number(uint64_t *state)
{
    *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(*state >> 40) / (double)(1 << 24);
}

/* ---- meshes ---- */

static void add(struct mesh *mesh, const double a[3], const double b[3], const double c[3])
{
    assert_true(mesh->triangles < MOST);
    memcpy(mesh->corners[mesh->triangles][0], a, 3 * sizeof *a);
    memcpy(mesh->corners[mesh->triangles][1], b, 3 * sizeof *b);
    memcpy(mesh->corners[mesh->triangles++][2], c, 3 * sizeof *c);
}

struct sheet {
    int kind;           /* how it is bent */
    unsigned hole;      /* a square that is left out; above all: none */
    double rough, lift; /* the height of noise, and of the whole */
    bool turned;        /* triangles face the other way */
};

static void place(const struct sheet *sheet, double x, double y, uint64_t *seed, double out[3])
{
    const double noise = sheet->lift + sheet->rough * (random_number(seed) - 0.5);
    const double angle = 6.283185307179586 * x, r = 0.4 + noise;
    const double flat[3] = {x, y, noise}, round[3] = {r * cos(angle), r * sin(angle), y},
                 fold[3] = {fabs(x - 0.5), y, 0.05 * x + noise};
    memcpy(out, sheet->kind == 0 ? flat : sheet->kind == 1 ? round : fold, sizeof flat);
}

/* Adds n x m squares. Vertices on the seam of a tube are the same. */
static void add_sheet(struct mesh *mesh, const struct sheet *sheet, unsigned n, unsigned m,
                      uint64_t *seed)
{
    static double grid[40][40][3];
    for (unsigned y = 0; y <= m; y++)
        for (unsigned x = 0; x <= n; x++)
            place(sheet, (double)x / n, (double)y / m, seed, grid[y][x]);
    for (unsigned y = 0; y <= m && sheet->kind == 1; y++)
        memcpy(grid[y][n], grid[y][0], sizeof grid[y][0]);
    for (unsigned y = 0; y < m; y++)
        for (unsigned x = 0; x < n; x++) {
            const double *a = grid[y][x], *b = grid[y][x + 1], *c = grid[y + 1][x + 1],
                         *d = grid[y + 1][x];
            if (y * n + x == sheet->hole)
                continue;
            add(mesh, a, sheet->turned ? c : b, sheet->turned ? b : c);
            add(mesh, a, sheet->turned ? d : c, sheet->turned ? c : d);
        }
}

/* A square whose halves have n and m edges along the line between them: T-junctions. */
static void add_strips(struct mesh *mesh, unsigned n, unsigned m, double rough, uint64_t *seed)
{
    for (unsigned side = 0; side < 2; side++)
        for (unsigned i = 0, count = side == 0 ? n : m; i < count; i++) {
            const double x = side == 0 ? 0.0 : 1.0, z = rough * random_number(seed);
            const double a[3] = {0.5, (double)i / count, 0}, b[3] = {0.5, (i + 1.0) / count, 0},
                         c[3] = {x, (double)i / count, z}, d[3] = {x, (i + 1.0) / count, z};
            add(mesh, a, b, c);
            add(mesh, c, b, d);
        }
}

/* The six sides of a cube, each of n x n squares that do not share vertices in memory. */
static void add_box(struct mesh *mesh, unsigned n)
{
    for (int side = 0; side < 6; side++)
        for (unsigned y = 0; y < n; y++)
            for (unsigned x = 0; x < n; x++) {
                double p[4][3];
                for (unsigned i = 0; i < 4; i++) {
                    p[i][side % 3] = side / 3;
                    p[i][(side + 1) % 3] = (double)(x + (i == 1 || i == 2)) / n;
                    p[i][(side + 2) % 3] = (double)(y + i / 2) / n;
                }
                add(mesh, p[0], p[1], p[2]);
                add(mesh, p[0], p[2], p[3]);
            }
}

static void add_soup(struct mesh *mesh, unsigned count, bool needles, uint64_t *seed)
{
    for (unsigned t = 0; t < count; t++) {
        double p[3][3];
        const double size = pow(2, -6 * random_number(seed));
        for (int k = 0; k < 3; k++) {
            p[0][k] = random_number(seed);
            p[1][k] = p[0][k] + size * (random_number(seed) - 0.5);
            p[2][k] = p[0][k] + size * (random_number(seed) - 0.5);
            if (needles)
                p[2][k] = 0.5 * (p[0][k] + p[1][k]) +
                          pow(10, -7 * random_number(seed)) * size * (random_number(seed) - 0.5);
        }
        add(mesh, p[0], p[1], p[2]);
        if (t % 3 == 0)
            add(mesh, p[0], p[t % 2 + 1], p[2 - t % 2]); /* the same again, or its other side */
    }
}

/* Sets a fine mesh and one that is like it. */
static void make_pair(int kind, uint64_t *seed, struct mesh *scan, struct mesh *low)
{
    const unsigned n = 2 + (unsigned)(random_number(seed) * 8), m = 1 + (unsigned)(n / 2);
    struct sheet sheet = {.kind = (int)(random_number(seed) * 3), .hole = 999};
    const double rough = pow(10, -1 - 3 * random_number(seed));
    scan->triangles = low->triangles = 0;
    switch (kind) {
    case 0:
        add_soup(scan, n * 4, false, seed);
        add_soup(low, n, false, seed);
        break;
    case 1:
        add_soup(scan, n * 2, true, seed);
        add_soup(low, n, true, seed);
        break;
    case 2:
        add_box(scan, 1 + n / 2);
        add_box(low, 1 + n % 2);
        break;
    case 3:
        add_strips(scan, n, n + 3, random_number(seed) < 0.5 ? 0 : rough, seed);
        add_sheet(low, &(struct sheet){.hole = 999}, 1 + n % 3, 1, seed);
        break;
    case 4: /* two sides, closer than the distance */
        sheet.rough = rough;
        add_sheet(scan, &sheet, n, n, seed);
        sheet.turned = true;
        sheet.lift = random_number(seed) < 0.3 ? 0 : 0.5 * rough;
        add_sheet(scan, &sheet, n, n, seed);
        add_sheet(low, &(struct sheet){.kind = sheet.kind, .hole = 999}, m + 2, m, seed);
        break;
    case 5: /* a smooth tube */
        sheet.kind = 1;
        add_sheet(scan, &sheet, 3 * n, m, seed);
        add_sheet(low, &sheet, n + 2, 1, seed);
        break;
    case 6: /* exactly the same surface */
        add_sheet(scan, &(struct sheet){.hole = 999}, n, m, seed);
        add_sheet(low, &(struct sheet){.hole = 999}, m + 1, n, seed);
        break;
    case 7: /* a hole of the scan */
        sheet.hole = (unsigned)(random_number(seed) * n * n);
        sheet.rough = 0.1 * rough;
        add_sheet(scan, &sheet, n, n, seed);
        sheet.hole = 999;
        add_sheet(low, &sheet, m + 2, m, seed);
        break;
    case 8: /* a mesh that is finer than the scan, and far from it */
        add_sheet(scan, &sheet, 4, 1, seed);
        sheet.lift = random_number(seed);
        sheet.rough = rough;
        add_sheet(low, &sheet, n, n, seed);
        break;
    default:
        sheet.rough = rough;
        add_sheet(scan, &sheet, n + 4, n + 4, seed);
        sheet.rough *= random_number(seed);
        add_sheet(low, &sheet, m + 2, m, seed);
    }
}

/* Moves and turns a mesh, so that its coordinates are floats. */
static void transform(struct mesh *mesh, const double turn[3][3], const double far[3])
{
    for (unsigned t = 0; t < mesh->triangles; t++)
        for (int i = 0; i < 3; i++) {
            double *p = mesh->corners[t][i], q[3];
            for (int k = 0; k < 3; k++)
                q[k] = (double)(float)(turn[k][0] * p[0] + turn[k][1] * p[1] + turn[k][2] * p[2] +
                                       far[k]);
            memcpy(p, q, sizeof q);
        }
}

/* Writes a mesh, and leaves out of it what sorting leaves out: triangles without area. */
static void write_mesh(const char *path, struct mesh *mesh, double scale)
{
    FILE *file = fopen(path, "w");
    unsigned kept = 0;
    assert_non_null(file);
    for (unsigned t = 0; t < mesh->triangles; t++) {
        double e[2][3], area = 0;
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 2; i++)
                e[i][k] = mesh->corners[t][i + 1][k] - mesh->corners[t][0][k];
        for (int k = 0; k < 3; k++)
            area += fabs(e[0][k] * e[1][(k + 1) % 3] - e[0][(k + 1) % 3] * e[1][k]);
        if (!(area > 0))
            continue;
        memmove(mesh->corners[kept++], mesh->corners[t], sizeof mesh->corners[t]);
        for (int i = 0; i < 3; i++)
            fprintf(file, "v %.17g %.17g %.17g\n", scale * mesh->corners[t][i][0],
                    scale * mesh->corners[t][i][1], scale * mesh->corners[t][i][2]);
        fprintf(file, "f -3 -2 -1\n");
    }
    mesh->triangles = kept;
    assert_int_equal(fclose(file), 0);
}

/* ---- the search ---- */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Returns the squared distance of a point from a triangle: the point's way to the origin, when the
 * triangle is seen from the point, by regions (Ericson, "Real-Time Collision Detection", 5.1.5). */
static double square_to(const double t[3][3], const double p[3])
{
    double ab[3], ac[3], ap[3], bp[3], cp[3], q[3];
    for (int k = 0; k < 3; k++) {
        ab[k] = t[1][k] - t[0][k];
        ac[k] = t[2][k] - t[0][k];
        ap[k] = p[k] - t[0][k];
        bp[k] = p[k] - t[1][k];
        cp[k] = p[k] - t[2][k];
    }
    const double d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp),
                 d5 = dot(ab, cp), d6 = dot(ac, cp);
    const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    double v = 0, w = 0;
    if (d1 <= 0 && d2 <= 0) {
        v = w = 0;
    } else if (d3 >= 0 && d4 <= d3) {
        v = 1;
    } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        v = d1 / (d1 - d3);
    } else if (d6 >= 0 && d5 <= d6) {
        w = 1;
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        w = d2 / (d2 - d6);
    } else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        w = (d4 - d3) / (d4 - d3 + (d5 - d6));
        v = 1 - w;
    } else {
        v = vb / (va + vb + vc);
        w = vc / (va + vb + vc);
    }
    for (int k = 0; k < 3; k++)
        q[k] = ap[k] - v * ab[k] - w * ac[k];
    return dot(q, q);
}

struct search {
    const struct mesh *to;
    double low, high; /* the farthest point found, and what nothing is above */
    double slack;
    unsigned parts;
};

static const double (*find_nearest(struct search *s, const double p[3]))[3]
{
    double least = INFINITY;
    unsigned nearest = 0;
    for (unsigned t = 0; t < s->to->triangles; t++) {
        const double square = square_to(s->to->corners[t], p);
        if (square < least) {
            least = square;
            nearest = t;
        }
    }
    s->low = fmax(s->low, sqrt(least));
    return s->to->corners[nearest];
}

static void search_part(struct search *s, const double p[3][3], int depth)
{
    double middle[3], mids[3][3], most = 0;
    for (int k = 0; k < 3; k++)
        middle[k] = (p[0][k] + p[1][k] + p[2][k]) / 3;
    const double(*nearest)[3] = find_nearest(s, middle);
    for (int i = 0; i < 3; i++)
        most = fmax(most, sqrt(square_to(nearest, p[i])));
    if (most <= fmax(1.001 * s->low, s->slack) || depth == 0 || ++s->parts > PARTS) {
        s->high = fmax(s->high, most);
        return;
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            mids[i][k] = 0.5 * (p[i][k] + p[(i + 1) % 3][k]);
    for (int i = 0; i < 3; i++) {
        double part[3][3];
        memcpy(part[0], p[i], sizeof part[0]);
        memcpy(part[1], mids[i], sizeof part[1]);
        memcpy(part[2], mids[(i + 2) % 3], sizeof part[2]);
        search_part(s, (const double(*)[3])part, depth - 1);
    }
    search_part(s, (const double(*)[3])mids, depth - 1);
}

/* Searches for the farthest points of one mesh from another one. */
static struct search search_all(const struct mesh *from, const struct mesh *to, double slack)
{
    struct search s = {.to = to, .slack = slack};
    for (unsigned t = 0; t < from->triangles; t++)
        for (int i = 0; i < 3; i++)
            find_nearest(&s, from->corners[t][i]);
    for (unsigned t = 0; t < from->triangles; t++)
        search_part(&s, from->corners[t], DEPTH);
    return s;
}

/* Returns the most that may be reported of what a search found. */
static double most_of(const struct search *s)
{
    return 1.01 * fmax(s->low, s->high) + 2 * s->slack;
}

/* Checks what is reported of the way from one mesh to the other. */
static void check(const struct mesh *from, const struct mesh *to, double reported, double slack,
                  const char *what)
{
    const struct search s = search_all(from, to, slack);
    if (!(reported >= s.low * (1 - 1e-9) - slack && reported <= most_of(&s)))
        fail_msg("%s: reported %.9g, found %.9g, bound %.9g", what, reported, s.low, s.high);
}

/* Copies the triangles that have points above a height, which is a multiple of x. */
static const struct mesh *part_above(const struct mesh *from, double height, double sign)
{
    static struct mesh part;
    part.triangles = 0;
    for (unsigned t = 0; t < from->triangles; t++) {
        const double(*p)[3] = (const double(*)[3])from->corners[t];
        if (fmax(sign * p[0][0], fmax(sign * p[1][0], sign * p[2][0])) >= height)
            memcpy(part.corners[part.triangles++], p, sizeof *part.corners);
    }
    return &part;
}

/* Checks what is reported of the way from the triangles that touch one side of a plane. Those that
 * nearly touch it may count or not. */
static void check_side(const struct mesh *from, const struct mesh *to, double plane, double sign,
                       double reported, double slack, const char *what)
{
    const struct search least =
                            search_all(part_above(from, sign * plane + 4 * slack, sign), to, slack),
                        most =
                            search_all(part_above(from, sign * plane - 4 * slack, sign), to, slack);
    if (!(reported >= least.low * (1 - 1e-9) - slack && reported <= most_of(&most)))
        fail_msg("%s, a side: reported %.9g, found %.9g, bound %.9g", what, reported, least.low,
                 most.high);
}

static void sort_mesh(struct bsq_ctx *ctx, const char *path, const char *tris,
                      struct vox_temp_tris *temp)
{
    struct vox_sort_options options;
    struct vox_sort_report report = {.size = sizeof report};
    vox_sort_defaults(&options);
    options.scan_paths = &path;
    options.scan_count = 1;
    options.tris_path = tris;
    options.temp_tris = temp;
    options.scan_normals = BSQ_SCAN_NORMALS_FLAT;
    assert_int_equal(vox_sort(ctx, &options, &report), 0);
}

static void check_figures(const struct vox_distances *d)
{
    assert_true(d->mean <= d->rms * (1 + 1e-9) && d->rms <= d->max * (1 + 1e-9));
    assert_true(d->p99 <= d->max * (1 + 1e-9));
}

static void check_between(double value, double a, double b)
{
    /* Percentiles are cut off at maxima, which are true to 1 %. */
    assert_true(value >= fmin(a, b) / 1.0101 && value <= fmax(a, b) * 1.0101);
}

static void try_pair(int kind, uint64_t *seed)
{
    static struct mesh scan, low;
    static const double scales[] = {1, 1, 1, 0x1p-83, 0x1p83, 0x1p-10, 0x1p20};
    const double scale = scales[(int)(random_number(seed) * 7)];
    const double a = 6 * random_number(seed), far = random_number(seed) < 0.3 ? 4096 : 0.25;
    const bool turned = random_number(seed) < 0.5;
    const double turn[3][3] = {{turned ? cos(a) : 1, turned ? -sin(a) : 0, 0},
                               {turned ? sin(a) : 0, turned ? cos(a) : 1, 0},
                               {0, 0, 1}};
    struct bsq_ctx *ctx = test_context(1 + (unsigned)(random_number(seed) * 3), 0);
    struct vox_temp_tris *temp = NULL;
    struct vox_distances there, back;
    struct vox_measured_box boxes[] = {
        {.low = {-INFINITY, -INFINITY, -INFINITY}, .high = {INFINITY, INFINITY, INFINITY}},
        {.low = {-INFINITY, -INFINITY, -INFINITY}, .high = {INFINITY, INFINITY, INFINITY}}};
    char what[100];
    snprintf(what, sizeof what, "kind %d, scale %g, offset %g", kind, scale, far);
    make_pair(kind, seed, &scan, &low);
    transform(&scan, turn, (const double[3]){far, -far, far});
    transform(&low, turn, (const double[3]){far, -far, far});
    const double(*some)[3] =
        (const double(*)[3])scan.corners[(unsigned)(random_number(seed) * scan.triangles)];
    const double plane = (some[0][0] + some[1][0] + some[2][0]) / 3;
    boxes[0].high[0] = boxes[1].low[0] = plane * scale;
    write_mesh("scan.obj", &scan, scale);
    write_mesh("low.obj", &low, scale);
    sort_mesh(ctx, "scan.obj", "scan.tris", NULL);
    assert_int_equal(vox_temp_tris_create(ctx, &temp), 0);
    sort_mesh(ctx, "low.obj", "low.tris", temp);
    assert_int_equal(vox_measure_mesh(ctx, "scan.tris", NULL, temp, boxes, 2, &there, &back), 0);
    vox_temp_tris_close(temp);
    test_context_end(ctx);
    check(&scan, &low, there.max / scale, 0x1p-21 * (far + 1), what);
    check(&low, &scan, back.max / scale, 0x1p-21 * (far + 1), what);
    for (int i = 0; i < 2; i++) {
        check_side(&scan, &low, plane, i ? 1 : -1, boxes[i].from_scan.max / scale,
                   0x1p-21 * (far + 1), what);
        assert_true(boxes[i].from_mesh.max <= back.max);
        check_figures(&boxes[i].from_scan);
        check_figures(&boxes[i].from_mesh);
    }
    assert_true(fmax(boxes[0].from_mesh.max, boxes[1].from_mesh.max) >=
                back.max - 0x1p-21 * (far + 1) * scale);
    check_figures(&there);
    check_figures(&back);
    /* Each point is in one box. */
    check_between(there.mean, boxes[0].from_scan.mean, boxes[1].from_scan.mean);
    check_between(there.rms, boxes[0].from_scan.rms, boxes[1].from_scan.rms);
    check_between(there.p99, boxes[0].from_scan.p99, boxes[1].from_scan.p99);
    check_between(back.mean, boxes[0].from_mesh.mean, boxes[1].from_mesh.mean);
    check_between(back.rms, boxes[0].from_mesh.rms, boxes[1].from_mesh.rms);
    check_between(back.p99, boxes[0].from_mesh.p99, boxes[1].from_mesh.p99);
}

TEST(no_point_is_farther_than_reported)
{
    uint64_t seed = test_seed();
    const int pairs = getenv("LONG") ? PAIRS_LONG : PAIRS;
    for (int i = 0; i < pairs; i++)
        try_pair(i % KINDS, &seed);
}

RUN_TESTS(NULL, NULL)

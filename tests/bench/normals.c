/* normals.c - holds the vertex normals of each weighting against analytic surfaces.
 *
 *   bench-normals [N]
 *
 * Patches of N x N cells (default 100) of a sphere, a torus, an ellipsoid and a saddle are cut into
 * triangles in several ways, from even to very irregular ones, and with noise along the normal.
 * Prints a table in Markdown: for each weighting the mean angle between the formula's normal and
 * that of the mesh, at vertices and inside of triangles, where normals are interpolated as maps
 * show them. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/smooth_normals.h"

enum surface { SPHERE, TORUS, ELLIPSOID, SADDLE, SURFACES };
static const char *const surface_names[] = {"sphere", "torus", "ellipsoid", "saddle"};

/* How a patch is cut. Cells have widths of the given spread: the widest is about exp(spread) times
 * as wide as the narrowest. Vertices move by `jitter` cells. `split` of the triangles are split at
 * a random point. Noise is a share of the mean edge. */
struct cutting {
    const char *name;
    double spread, jitter, split, noise;
    bool random_diagonals;
};
static const struct cutting cuttings[] = {
    {"even", 0, 0, 0, 0, false},
    {"random", 0, 0.24, 0, 0, true},
    {"random, cells 1 to 10 wide", 2.3, 0.24, 0, 0, true},
    {"random, half of them split", 0, 0.24, 0.5, 0, true},
    {"1 to 50 wide, half split", 3.9, 0.24, 0.5, 0, true},
    {"random, noise 0.5 %", 0, 0.24, 0, 0.005, true},
    {"random, noise 2 %", 0, 0.24, 0, 0.02, true},
    {"half split, noise 0.5 %", 0, 0.24, 0.5, 0.005, true},
    {"half split, noise 2 %", 0, 0.24, 0.5, 0.02, true},
};
enum { CUTTINGS = sizeof cuttings / sizeof *cuttings, WEIGHTS = BSQ_SCAN_NORMALS_FLAT };
static const char *const weight_names[] = {[BSQ_SCAN_NORMALS_ANGLE] = "angle",
                                           [BSQ_SCAN_NORMALS_AREA] = "area",
                                           [BSQ_SCAN_NORMALS_MAX] = "Max"};

struct mesh {
    uint32_t cells, vertex_count, triangle_count;
    double (*parameters)[2]; /* of each vertex, 0 to 1 */
    float (*positions)[3];
    uint32_t (*triangles)[3];
    bool *border; /* for each vertex: on the border of the patch */
    uint32_t *ring_of;
    double (*sums)[4]; /* by vertex + 1 */
};

static uint64_t random_state = 1;

/* Returns a number from 0 to 1. */
static double uniform(void)
{
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (double)(random_state >> 11) * 0x1p-53;
}

static double normal_deviate(void)
{
    double sum = -6;
    for (int i = 0; i < 12; i++)
        sum += uniform();
    return sum;
}

static void *array(size_t count, size_t size)
{
    void *memory = calloc(count, size);
    if (!memory)
        exit(71);
    return memory;
}

/* ---- surfaces ---- */

enum { TORUS_RATIO = 2 }; /* large radius over that of the tube */
static const double axes[3] = {1, 0.7, 0.4};

/* Sets a point of the surface from parameters between 0 and 1. The borders are off the poles. */
static void surface_point(enum surface surface, const double p[2], double out[3])
{
    const double a = (p[0] - 0.5) * 2, b = (p[1] - 0.5) * 2;
    if (surface == SADDLE) {
        out[0] = a;
        out[1] = b;
        out[2] = 0.5 * (a * a - b * b);
    } else if (surface == TORUS) {
        const double ring = TORUS_RATIO + cos(2 * b);
        out[0] = ring * cos(a);
        out[1] = ring * sin(a);
        out[2] = sin(2 * b);
    } else {
        const double unit[3] = {cos(a) * cos(b), sin(a) * cos(b), sin(b)};
        for (int k = 0; k < 3; k++)
            out[k] = surface == ELLIPSOID ? axes[k] * unit[k] : unit[k];
    }
}

/* Sets the normal, of any length, of the level set through a point at or near the surface. */
static void surface_normal(enum surface surface, const double p[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = surface == ELLIPSOID ? p[k] / (axes[k] * axes[k]) : p[k];
    if (surface == SADDLE) {
        out[0] = -p[0];
        out[1] = p[1];
        out[2] = 1;
    } else if (surface == TORUS) {
        const double inner = 1 - TORUS_RATIO / sqrt(p[0] * p[0] + p[1] * p[1]);
        out[0] *= inner;
        out[1] *= inner;
    }
}

static double length_of(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* ---- meshes ---- */

/* Sets cells + 1 ascending numbers from 0 to 1. */
static void widths(uint32_t cells, double spread, double *at)
{
    double sum = 0;
    for (uint32_t i = 0; i < cells; i++) {
        at[i] = sum;
        sum += exp(spread * uniform());
    }
    for (uint32_t i = 0; i < cells; i++)
        at[i] /= sum;
    at[cells] = 1;
}

static void add_triangle(struct mesh *mesh, uint32_t a, uint32_t b, uint32_t c)
{
    uint32_t *v = mesh->triangles[mesh->triangle_count++];
    v[0] = a;
    v[1] = b;
    v[2] = c;
}

static void cut_cells(struct mesh *mesh, const struct cutting *how)
{
    const uint32_t side = mesh->cells + 1;
    double *at[2];
    for (int k = 0; k < 2; k++) {
        at[k] = array(side, sizeof **at);
        widths(mesh->cells, how->spread, at[k]);
    }
    mesh->vertex_count = side * side;
    mesh->triangle_count = 0;
    for (uint32_t v = 0; v < side * side; v++) {
        const uint32_t index[2] = {v % side, v / side};
        mesh->border[v] = false;
        for (int k = 0; k < 2; k++) {
            const uint32_t i = index[k];
            const bool border = i == 0 || i == mesh->cells;
            const double move = border ? 0 : how->jitter * (2 * uniform() - 1);
            mesh->border[v] |= border;
            mesh->parameters[v][k] = at[k][i] + (border     ? 0
                                                 : move > 0 ? move * (at[k][i + 1] - at[k][i])
                                                            : move * (at[k][i] - at[k][i - 1]));
        }
    }
    for (uint32_t y = 0; y < mesh->cells; y++)
        for (uint32_t x = 0; x < mesh->cells; x++) {
            const uint32_t a = y * side + x, b = a + 1, c = a + side, d = c + 1;
            const bool other = how->random_diagonals && uniform() < 0.5;
            add_triangle(mesh, a, b, other ? c : d);
            add_triangle(mesh, other ? b : a, d, c);
        }
    free(at[0]);
    free(at[1]);
}

/* Splits triangles at points of a uniform distribution. */
static void split_triangles(struct mesh *mesh, double share)
{
    const uint32_t before = mesh->triangle_count;
    for (uint32_t t = 0; t < before; t++) {
        uint32_t *v = mesh->triangles[t];
        const uint32_t a = v[0], b = v[1], c = v[2], middle = mesh->vertex_count;
        if (uniform() >= share)
            continue;
        const double root = sqrt(uniform()), other = uniform();
        mesh->vertex_count++;
        mesh->border[middle] = false;
        for (int k = 0; k < 2; k++)
            mesh->parameters[middle][k] = (1 - root) * mesh->parameters[a][k] +
                                          root * (1 - other) * mesh->parameters[b][k] +
                                          root * other * mesh->parameters[c][k];
        v[2] = middle;
        add_triangle(mesh, b, c, middle);
        add_triangle(mesh, c, a, middle);
    }
}

static void place_vertices(struct mesh *mesh, enum surface surface, double noise)
{
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        double point[3], normal[3];
        surface_point(surface, mesh->parameters[v], point);
        surface_normal(surface, point, normal);
        const double height = noise * 2 / mesh->cells * normal_deviate() / length_of(normal);
        for (int k = 0; k < 3; k++)
            mesh->positions[v][k] = (float)(point[k] + height * normal[k]);
    }
}

static void make_mesh(struct mesh *mesh, enum surface surface, const struct cutting *how)
{
    cut_cells(mesh, how);
    split_triangles(mesh, how->split);
    place_vertices(mesh, surface, how->noise);
}

/* ---- errors ---- */

struct errors {
    double at_vertices, inside, count, area;
};

/* Returns the angle in degrees between the formula's normal at a point and another one. */
static double error_at(enum surface surface, const double point[3], const double n[3])
{
    double exact[3], across[3];
    surface_normal(surface, point, exact);
    for (int k = 0; k < 3; k++) {
        const int y = (k + 1) % 3, z = (k + 2) % 3;
        across[k] = exact[y] * n[z] - exact[z] * n[y];
    }
    const double along = exact[0] * n[0] + exact[1] * n[1] + exact[2] * n[2];
    return fabs(atan2(length_of(across), along)) * 180 / BSQ_PI;
}

static void corner_normal(const struct mesh *mesh, uint32_t vertex, double out[3])
{
    const double *sum = mesh->sums[vertex + 1], length = length_of(sum);
    for (int k = 0; k < 3; k++)
        out[k] = sum[k] / length;
}

/* Adds the error of a triangle's interpolated normals at the middle of the triangle and near its
 * corners, weighted by area as texels of a map are. */
static void add_inside(const struct mesh *mesh, enum surface surface, const uint32_t v[3],
                       struct errors *to)
{
    struct row corner[3];
    double normals[3][3];
    if (mesh->border[v[0]] || mesh->border[v[1]] || mesh->border[v[2]])
        return;
    for (int i = 0; i < 3; i++) {
        corner[i] = row_of_floats(mesh->positions[v[i]]);
        corner_normal(mesh, v[i], normals[i]);
    }
    const double area = row_number(bsq_area_vector(corner), 3);
    for (int place = 0; place < 4; place++) {
        double point[3], n[3];
        for (int k = 0; k < 3; k++) {
            point[k] = n[k] = 0;
            for (int i = 0; i < 3; i++) {
                const double weight = place == 3 ? 1.0 / 3 : place == i ? 2.0 / 3 : 1.0 / 6;
                point[k] += weight * row_number(corner[i], k);
                n[k] += weight * normals[i][k];
            }
        }
        to->inside += area * error_at(surface, point, n);
        to->area += area;
    }
}

static struct errors measure(struct mesh *mesh, enum surface surface, enum bsq_scan_normals weights)
{
    struct errors errors = {0};
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        mesh->ring_of[v] = v + 1;
        for (int k = 0; k < 4; k++)
            mesh->sums[v + 1][k] = 0;
    }
    bsq_add_one_rings((const float(*)[3])mesh->positions, (const uint32_t(*)[3])mesh->triangles, 0,
                      mesh->triangle_count, mesh->ring_of, weights, 1, mesh->sums);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const float *p = mesh->positions[v];
        const double point[3] = {(double)p[0], (double)p[1], (double)p[2]};
        double n[3];
        if (mesh->border[v])
            continue;
        corner_normal(mesh, v, n);
        errors.at_vertices += error_at(surface, point, n);
        errors.count++;
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        add_inside(mesh, surface, mesh->triangles[t], &errors);
    errors.at_vertices /= errors.count;
    errors.inside /= errors.area;
    return errors;
}

/* ---- the table ---- */

static void allocate(struct mesh *mesh, uint32_t cells)
{
    const size_t vertices = (size_t)(cells + 1) * (cells + 1) + (size_t)2 * cells * cells;
    mesh->cells = cells;
    mesh->parameters = array(vertices, sizeof *mesh->parameters);
    mesh->positions = array(vertices, sizeof *mesh->positions);
    mesh->triangles = array((size_t)6 * cells * cells, sizeof *mesh->triangles);
    mesh->border = array(vertices, sizeof *mesh->border);
    mesh->ring_of = array(vertices, sizeof *mesh->ring_of);
    mesh->sums = array(vertices + 1, sizeof *mesh->sums);
}

static void release(const struct mesh *mesh)
{
    free(mesh->parameters);
    free(mesh->positions);
    free(mesh->triangles);
    free(mesh->border);
    free(mesh->ring_of);
    free(mesh->sums);
}

int main(int argc, char **argv)
{
    static const enum bsq_scan_normals order[WEIGHTS] = {
        BSQ_SCAN_NORMALS_AREA, BSQ_SCAN_NORMALS_ANGLE, BSQ_SCAN_NORMALS_MAX};
    const unsigned long cells = argc > 1 ? strtoul(argv[1], NULL, 10) : 100;
    struct mesh mesh;
    if (argc > 2 || cells < 3 || cells > 5000) {
        fprintf(stderr, "usage: bench-normals [cells along a side, 3 to 5000]\n");
        return 64;
    }
    allocate(&mesh, (uint32_t)cells);
    printf("Mean angles in degrees: at vertices / inside of triangles.\n\n| surface | triangles |");
    for (int w = 0; w < WEIGHTS; w++)
        printf(" %s |", weight_names[order[w]]);
    printf("\n|:--|:--|--:|--:|--:|\n");
    for (int surface = 0; surface < SURFACES; surface++)
        for (int c = 0; c < CUTTINGS; c++) {
            make_mesh(&mesh, (enum surface)surface, &cuttings[c]);
            printf("| %s | %s |", surface_names[surface], cuttings[c].name);
            for (int w = 0; w < WEIGHTS; w++) {
                const struct errors errors = measure(&mesh, (enum surface)surface, order[w]);
                printf(" %.4f / %.4f |", errors.at_vertices, errors.inside);
            }
            printf("\n");
        }
    release(&mesh);
    return 0;
}

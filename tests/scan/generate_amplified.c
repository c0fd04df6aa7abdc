/* generate_amplified.c - makes a large scan of a small one: each triangle becomes k x k smaller
 * ones.
 *
 * New vertices are numbered in closed form: corners first, then those on edges, then inner ones. So
 * neighbours share them, and only the small scan is in memory. */
#include "tests/scan/generate_options.h"
#include "tests/scan/permutation.h"
#include "tests/scan/mesh_writer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct small {
    double (*position)[3], (*normal)[3];
    uint64_t (*face)[3], (*edge)[3]; /* edges of a face: 01, 12, 20 */
    uint64_t vertices, faces, edges, k;
    double height, wavelength;
    int rounded;
};

struct half_edge {
    uint64_t low, high, number; /* vertices; 3 * face + edge of the face */
};

static void *grow(void *memory, uint64_t count, size_t size)
{
    if (count & (count - 1))
        return memory;
    memory = realloc(memory, (count ? 2 * count : 1) * size);
    if (!memory)
        abort();
    return memory;
}

static void read_small(struct small *m, const char *path)
{
    FILE *file = fopen(path, "r");
    char line[512];
    if (!file) {
        perror(path);
        exit(66);
    }
    while (fgets(line, sizeof line, file)) {
        if (!strncmp(line, "v ", 2)) {
            m->position = grow(m->position, m->vertices, sizeof *m->position);
            double *p = m->position[m->vertices++];
            sscanf(line + 2, "%lf %lf %lf", p, p + 1, p + 2);
        } else if (!strncmp(line, "f ", 2)) {
            m->face = grow(m->face, m->faces, sizeof *m->face);
            char *p = line + 2;
            for (int c = 0; c < 3; c++) {
                m->face[m->faces][c] = strtoull(p, &p, 10) - 1;
                p += strcspn(p, " \t\n");
            }
            m->faces++;
        }
    }
    fclose(file);
}

static int compare_edges(const void *a, const void *b)
{
    const struct half_edge *x = a, *y = b;
    if (x->low != y->low)
        return x->low < y->low ? -1 : 1;
    return x->high < y->high ? -1 : x->high > y->high;
}

static void number_edges(struct small *m)
{
    struct half_edge *half = malloc(3 * m->faces * sizeof *half);
    m->edge = malloc(m->faces * sizeof *m->edge);
    if (!half || !m->edge)
        abort();
    for (uint64_t i = 0; i < 3 * m->faces; i++) {
        uint64_t a = m->face[i / 3][i % 3], b = m->face[i / 3][(i + 1) % 3];
        half[i] = (struct half_edge){a < b ? a : b, a < b ? b : a, i};
    }
    qsort(half, 3 * m->faces, sizeof *half, compare_edges);
    for (uint64_t i = 0; i < 3 * m->faces; i++) {
        m->edges += i == 0 || compare_edges(half + i - 1, half + i);
        m->edge[half[i].number / 3][half[i].number % 3] = m->edges - 1;
    }
    free(half);
}

static void smooth_normals(struct small *m)
{
    m->normal = calloc(m->vertices, sizeof *m->normal);
    if (!m->normal)
        abort();
    for (uint64_t f = 0; f < m->faces; f++) {
        const double *a = m->position[m->face[f][0]], *b = m->position[m->face[f][1]],
                     *c = m->position[m->face[f][2]];
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            double n = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j]);
            for (int corner = 0; corner < 3; corner++)
                m->normal[m->face[f][corner]][i] += n;
        }
    }
    for (uint64_t v = 0; v < m->vertices; v++) {
        double *n = m->normal[v], length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int i = 0; i < 3 && length > 0; i++)
            n[i] /= length;
    }
}

/* Returns the displacement: three octaves of sines. It is a function of the position, so that
 * shared vertices agree. */
static double bump(const struct small *m, const double p[3])
{
    double sum = 0, amplitude = 1, frequency = 6.283185307179586 / m->wavelength;
    for (int octave = 0; octave < 3; octave++, amplitude *= 0.5, frequency *= 2.03)
        sum += amplitude * sin(frequency * (p[0] + 0.31 * p[1])) *
               sin(frequency * (p[1] - 0.27 * p[2])) *
               sin(frequency * (p[2] + 0.23 * p[0]) + octave);
    return m->height * sum;
}

/* Moves a point of a face onto a surface that is curved by the normals of the corners. So edges of
 * the small scan are no creases (Boubekeur & Alexa, "Phong Tessellation", 2008). */
static void round_point(const struct small *m, uint64_t f, const double w[3], double p[3])
{
    double lift[3] = {0};
    for (int c = 0; c < 3; c++) {
        const double *corner = m->position[m->face[f][c]], *n = m->normal[m->face[f][c]];
        double above = 0;
        for (int i = 0; i < 3; i++)
            above += (p[i] - corner[i]) * n[i];
        for (int i = 0; i < 3; i++)
            lift[i] -= 0.5 * w[c] * above * n[i];
    }
    for (int i = 0; i < 3; i++)
        p[i] += lift[i];
}

/* Writes the displaced point with weights (w0, w1, k - w0 - w1) / k on face f. */
static void put_point(struct small *m, struct mesh_writer *mesh, const double *offset, uint64_t f,
                      uint64_t w0, uint64_t w1)
{
    double w[3] = {(double)w0 / (double)m->k, (double)w1 / (double)m->k,
                   (double)(m->k - w0 - w1) / (double)m->k},
           p[3] = {0}, n[3] = {0};
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < 3; i++) {
            p[i] += w[c] * m->position[m->face[f][c]][i];
            n[i] += w[c] * m->normal[m->face[f][c]][i];
        }
    if (m->rounded)
        round_point(m, f, w, p);
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), h = bump(m, p);
    for (int i = 0; i < 3; i++)
        p[i] += (length > 0 ? h * n[i] / length : 0) + offset[i];
    mesh_vertex(mesh, p, NULL, NULL);
}

/* Returns the number, from 1, of the point with weights (w0, w1, k - w0 - w1) / k on face f. */
static uint64_t point_number(const struct small *m, uint64_t f, uint64_t w0, uint64_t w1)
{
    uint64_t w[3] = {w0, w1, m->k - w0 - w1}, k = m->k;
    for (int c = 0; c < 3; c++)
        if (w[c] == k)
            return m->face[f][c] + 1;
    for (int e = 0; e < 3; e++)
        if (w[(e + 2) % 3] == 0) {
            int forward = m->face[f][e] < m->face[f][(e + 1) % 3];
            uint64_t along = forward ? w[(e + 1) % 3] : w[e];
            return m->vertices + m->edge[f][e] * (k - 1) + along;
        }
    /* Inner points are in rows of constant w0 from 1 to k - 2, each with w1 from 1 to k - 1 - w0.
     */
    uint64_t inner = (k - 1) * (k - 2) / 2, rows = w0 - 1;
    uint64_t before = rows * (k - 2) - rows * (rows - 1) / 2;
    if (rows == 0)
        before = 0;
    return m->vertices + m->edges * (k - 1) + f * inner + before + w1;
}

static void put_points(struct small *m, struct mesh_writer *mesh, const double *offset)
{
    /* A face that has the corner or edge; any of them will do. */
    uint64_t *owner = calloc(m->vertices > m->edges ? m->vertices : m->edges, sizeof *owner);
    if (!owner)
        abort();
    for (uint64_t i = 0; i < 3 * m->faces; i++)
        owner[m->face[i / 3][i % 3]] = i;
    for (uint64_t v = 0; v < m->vertices; v++) {
        uint64_t c = owner[v] % 3;
        put_point(m, mesh, offset, owner[v] / 3, c == 0 ? m->k : 0, c == 1 ? m->k : 0);
    }
    for (uint64_t i = 0; i < 3 * m->faces; i++)
        owner[m->edge[i / 3][i % 3]] = i;
    for (uint64_t e = 0; e < m->edges; e++)
        for (uint64_t along = 1; along < m->k; along++) {
            uint64_t f = owner[e] / 3, c = owner[e] % 3, w[3] = {0};
            int forward = m->face[f][c] < m->face[f][(c + 1) % 3];
            w[(c + 1) % 3] = forward ? along : m->k - along;
            w[c] = m->k - w[(c + 1) % 3];
            put_point(m, mesh, offset, f, w[0], w[1]);
        }
    for (uint64_t f = 0; f < m->faces; f++)
        for (uint64_t w0 = 1; w0 + 2 <= m->k; w0++)
            for (uint64_t w1 = 1; w0 + w1 < m->k; w1++)
                put_point(m, mesh, offset, f, w0, w1);
    free(owner);
}

/* Writes small triangle t of face f. Row a has 2 (k - a) - 1 of them, upright and inverted in turn.
 */
static void put_small_face(struct small *m, struct mesh_writer *mesh, uint64_t f, uint64_t t)
{
    uint64_t a = 0;
    while (t >= 2 * (m->k - a) - 1)
        t -= 2 * (m->k - a) - 1, a++;
    uint64_t b = t / 2, corner[3][2] = {{a, b}, {a + 1, b}, {a, b + 1}};
    if (t & 1) {
        uint64_t inverted[3][2] = {{a + 1, b}, {a + 1, b + 1}, {a, b + 1}};
        memcpy(corner, inverted, sizeof corner);
    }
    struct mesh_corner corners[3] = {0};
    for (int c = 0; c < 3; c++)
        corners[c].vertex = point_number(m, f, corner[c][0], corner[c][1]) - 1;
    mesh_face(mesh, corners, 3);
}

static void measure(struct small *m, const struct generate_options *options)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY},
           d = 0;
    for (uint64_t v = 0; v < m->vertices; v++)
        for (int i = 0; i < 3; i++) {
            low[i] = fmin(low[i], m->position[v][i]);
            high[i] = fmax(high[i], m->position[v][i]);
        }
    for (int i = 0; i < 3; i++)
        d += (high[i] - low[i]) * (high[i] - low[i]);
    m->height = options->amplitude * sqrt(d);
    m->wavelength = options->wavelength > 0 ? options->wavelength : 0.03 * sqrt(d);
    m->rounded = options->rounded;
}

void generate_amplified(const struct generate_options *options, const char *input)
{
    struct small m = {0};
    struct mesh_writer mesh;
    read_small(&m, input);
    number_edges(&m);
    smooth_normals(&m);
    measure(&m, options);
    m.k = (uint64_t)fmax(1, round(sqrt((double)options->triangles / (double)m.faces)));
    const uint64_t count = m.faces * m.k * m.k, inner = (m.k - 1) * (m.k - 2) / 2;
    const struct mesh_facts facts = {.vertices = m.vertices + m.edges * (m.k - 1) + m.faces * inner,
                                     .faces = count,
                                     .far = options->offset[0] != 0 || options->offset[1] != 0 ||
                                            options->offset[2] != 0};
    mesh_open(&mesh, options->output, &facts);
    put_points(&m, &mesh, options->offset);
    for (uint64_t n = 0; n < count; n++) {
        uint64_t face = options->shuffle ? scan_permute(n, count, options->seed) : n;
        put_small_face(&m, &mesh, face / (m.k * m.k), face % (m.k * m.k));
    }
    mesh_close(&mesh);
    free(m.position), free(m.normal), free(m.face), free(m.edge);
}

/* generate_vase.c - the vase as a closed grid of triangles or polygons, and its low-poly mesh. */
#include "tests/scan/generate_options.h"
#include "tests/scan/permutation.h"
#include "tests/scan/text_writer.h"
#include "tests/scan/vase.h"

#include <math.h>

/* A grid of nu columns around the axis and ns rows along the profile, both closed. The numbers of
 * vertices and normals wrap around; texture coordinates have one more column and row. */
struct grid {
    struct text_writer text;
    uint64_t nu, ns;
    int normals, texcoords;
};

static void put_corner(struct grid *g, uint64_t i, uint64_t j)
{
    uint64_t vertex = (j % g->ns) * g->nu + i % g->nu + 1;
    text_string(&g->text, " ");
    text_integer(&g->text, vertex);
    if (g->texcoords) {
        text_string(&g->text, "/");
        text_integer(&g->text, j * (g->nu + 1) + i + 1);
    }
    if (g->normals) {
        text_string(&g->text, g->texcoords ? "/" : "//");
        text_integer(&g->text, vertex);
    }
}

static void put_triangle(struct grid *g, uint64_t index)
{
    uint64_t i = index / 2 % g->nu, j = index / 2 / g->nu;
    text_string(&g->text, "f");
    put_corner(g, i, j);
    put_corner(g, i + 1, index & 1 ? j + 1 : j);
    if (index & 1)
        put_corner(g, i, j + 1);
    else
        put_corner(g, i + 1, j + 1);
    text_string(&g->text, "\n");
}

/* Writes a strip of `quads` cells of row j as one polygon. */
static void put_polygon(struct grid *g, uint64_t i, uint64_t j, uint64_t quads)
{
    text_string(&g->text, "f");
    for (uint64_t k = 0; k <= quads; k++)
        put_corner(g, i + k, j);
    for (uint64_t k = quads + 1; k-- > 0;)
        put_corner(g, i + k, j + 1);
    text_string(&g->text, "\n");
}

static void put_texcoords(struct grid *g)
{
    for (uint64_t j = 0; j <= g->ns; j++)
        for (uint64_t i = 0; i <= g->nu; i++) {
            text_string(&g->text, "vt");
            text_real(&g->text, (double)i / (double)g->nu);
            text_real(&g->text, (double)j / (double)g->ns);
            text_string(&g->text, "\n");
        }
}

static void put_vector(struct text_writer *text, const char *keyword, const double v[3],
                       const double *color)
{
    text_string(text, keyword);
    for (int k = 0; k < 3; k++)
        text_real(text, v[k]);
    for (int k = 0; color && k < 3; k++)
        text_real(text, color[k]);
    text_string(text, "\n");
}

static void put_vertices(struct grid *g, const struct generate_options *options)
{
    for (uint64_t j = 0; j < g->ns; j++)
        for (uint64_t i = 0; i < g->nu; i++) {
            double u = (double)i / (double)g->nu, s = (double)j / (double)g->ns, p[3], c[3];
            vase_position(u, s, p);
            for (int k = 0; k < 3; k++)
                p[k] += options->offset[k];
            if (options->colors)
                vase_color(u, s, c);
            put_vector(&g->text, "v", p, options->colors ? c : NULL);
        }
}

static void put_faces(struct grid *g, const struct generate_options *options)
{
    uint64_t quads = options->corners / 2 - 1, strips = quads ? (g->nu + quads - 1) / quads : 0;
    uint64_t count = options->corners == 3 ? 2 * g->nu * g->ns : strips * g->ns;
    for (uint64_t n = 0; n < count; n++) {
        uint64_t face = options->shuffle ? scan_permute(n, count, options->seed) : n;
        if (options->corners == 3) {
            put_triangle(g, face);
            continue;
        }
        uint64_t i = face % strips * quads, rest = g->nu - i;
        put_polygon(g, i, face / strips, rest < quads ? rest : quads);
    }
}

void generate_vase(const struct generate_options *options)
{
    /* Cells are roughly square: at the belly the vase is about as long around as along the profile.
     */
    struct grid g = {.normals = options->normals, .texcoords = options->texcoords};
    double cells = (double)options->triangles / 2;
    g.ns = (uint64_t)fmax(3, round(sqrt(cells)));
    g.nu = (uint64_t)fmax(3, round(cells / (double)g.ns));
    text_open(&g.text, options->output);
    put_vertices(&g, options);
    if (options->texcoords)
        put_texcoords(&g);
    for (uint64_t j = 0; options->normals && j < g.ns; j++)
        for (uint64_t i = 0; i < g.nu; i++) {
            struct vase_point p;
            vase_surface((double)i / (double)g.nu, (double)j / (double)g.ns, &p);
            put_vector(&g.text, "vn", p.normal, NULL);
        }
    put_faces(&g, options);
    text_close(&g.text);
}

void generate_vase_low(const struct generate_options *options, unsigned nu, unsigned ns)
{
    struct grid g = {.nu = nu, .ns = ns, .normals = 1, .texcoords = 1};
    text_open(&g.text, options->output);
    for (int pass = 0; pass < 2; pass++)
        for (uint64_t j = 0; j < ns; j++)
            for (uint64_t i = 0; i < nu; i++) {
                struct vase_point p;
                vase_body((double)i / nu, (double)j / ns, &p);
                for (int k = 0; k < 3; k++)
                    p.position[k] += options->offset[k];
                put_vector(&g.text, pass ? "vn" : "v", pass ? p.normal : p.position, NULL);
            }
    put_texcoords(&g);
    for (uint64_t n = 0; n < 2ull * nu * ns; n++)
        put_triangle(&g, n);
    text_close(&g.text);
}

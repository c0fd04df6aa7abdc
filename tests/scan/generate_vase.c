/* generate_vase.c - the vase as a closed grid of triangles or polygons, and its low-poly mesh. */
#include "tests/scan/generate_options.h"
#include "tests/scan/mesh_writer.h"
#include "tests/scan/permutation.h"
#include "tests/scan/vase.h"

#include <math.h>
#include <stdlib.h>

/* A grid of nu columns around the axis and ns rows along the profile, both closed. The numbers of
 * vertices and normals wrap around; texture coordinates have one more column and row. */
struct grid {
    struct mesh_writer mesh;
    uint64_t nu, ns;
    struct mesh_corner *corners; /* of one face */
    unsigned corner_count;
};

static void open_grid(struct grid *g, const struct generate_options *options, uint64_t faces,
                      int far)
{
    const struct mesh_facts facts = {.vertices = g->nu * g->ns,
                                     .faces = faces,
                                     .colors = options->colors,
                                     .normals = options->normals,
                                     .texcoords = options->texcoords,
                                     .far = far || options->offset[0] != 0 ||
                                            options->offset[1] != 0 || options->offset[2] != 0};
    g->corners = malloc((options->corners + 8) * sizeof *g->corners);
    if (!g->corners)
        abort();
    mesh_open(&g->mesh, options->output, &facts);
}

static void close_grid(struct grid *g)
{
    mesh_close(&g->mesh);
    free(g->corners);
}

static void add_corner(struct grid *g, uint64_t i, uint64_t j)
{
    g->corners[g->corner_count++] =
        (struct mesh_corner){.vertex = (j % g->ns) * g->nu + i % g->nu,
                             .texcoord = j * (g->nu + 1) + i,
                             .uv = {(double)i / (double)g->nu, (double)j / (double)g->ns}};
}

static void put_face(struct grid *g)
{
    mesh_face(&g->mesh, g->corners, g->corner_count);
    g->corner_count = 0;
}

static void put_triangle(struct grid *g, uint64_t index)
{
    uint64_t i = index / 2 % g->nu, j = index / 2 / g->nu;
    add_corner(g, i, j);
    add_corner(g, i + 1, index & 1 ? j + 1 : j);
    add_corner(g, index & 1 ? i : i + 1, j + 1);
    put_face(g);
}

/* Writes a strip of `quads` cells of row j as one polygon. */
static void put_polygon(struct grid *g, uint64_t i, uint64_t j, uint64_t quads)
{
    for (uint64_t k = 0; k <= quads; k++)
        add_corner(g, i + k, j);
    for (uint64_t k = quads + 1; k-- > 0;)
        add_corner(g, i + k, j + 1);
    put_face(g);
}

static void put_texcoords(struct grid *g, unsigned tiles)
{
    for (uint64_t j = 0; j <= g->ns; j++)
        for (uint64_t i = 0; i <= g->nu; i++)
            mesh_texcoord(&g->mesh, (double)(tiles * i) / (double)g->nu, (double)j / (double)g->ns);
}

static void put_vertices(struct grid *g, const struct generate_options *options)
{
    const int with_normals = options->normals && !mesh_normals_apart(&g->mesh);
    for (uint64_t j = 0; j < g->ns; j++)
        for (uint64_t i = 0; i < g->nu; i++) {
            double u = (double)i / (double)g->nu, s = (double)j / (double)g->ns, p[3], c[3];
            struct vase_point point;
            vase_position(u, s, p);
            for (int k = 0; k < 3; k++)
                p[k] += options->offset[k];
            if (options->colors)
                vase_color(u, s, c);
            if (with_normals)
                vase_surface(u, s, &point);
            mesh_vertex(&g->mesh, p, options->colors ? c : NULL,
                        with_normals ? point.normal : NULL);
        }
}

static void put_normals(struct grid *g)
{
    for (uint64_t j = 0; j < g->ns; j++)
        for (uint64_t i = 0; i < g->nu; i++) {
            struct vase_point p;
            vase_surface((double)i / (double)g->nu, (double)j / (double)g->ns, &p);
            mesh_normal(&g->mesh, p.normal);
        }
}

static uint64_t strips_of(const struct grid *g, uint64_t quads)
{
    return quads ? (g->nu + quads - 1) / quads : 0;
}

static uint64_t count_faces(const struct grid *g, const struct generate_options *options)
{
    return options->corners == 3 ? 2 * g->nu * g->ns
                                 : strips_of(g, options->corners / 2 - 1) * g->ns;
}

static void put_faces(struct grid *g, const struct generate_options *options)
{
    uint64_t quads = options->corners / 2 - 1, strips = strips_of(g, quads);
    uint64_t count = count_faces(g, options);
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
    struct grid g = {0};
    double cells = (double)options->triangles / 2;
    g.ns = (uint64_t)fmax(3, round(sqrt(cells)));
    g.nu = (uint64_t)fmax(3, round(cells / (double)g.ns));
    open_grid(&g, options, count_faces(&g, options), 0);
    put_vertices(&g, options);
    if (options->texcoords)
        put_texcoords(&g, 1);
    if (options->normals && mesh_normals_apart(&g.mesh))
        put_normals(&g);
    put_faces(&g, options);
    close_grid(&g);
}

void generate_vase_low(const struct generate_options *from, unsigned nu, unsigned ns)
{
    struct grid g = {.nu = nu, .ns = ns};
    struct generate_options options = *from;
    options.normals = options.texcoords = 1;
    options.colors = 0;
    open_grid(&g, &options, 2ull * nu * ns, 1);
    for (int pass = 0; pass < 2; pass++)
        for (uint64_t j = 0; j < ns; j++)
            for (uint64_t i = 0; i < nu; i++) {
                struct vase_point p;
                vase_body((double)i / nu, (double)j / ns, &p);
                for (int k = 0; k < 3; k++)
                    p.position[k] += options.offset[k];
                if (pass)
                    mesh_normal(&g.mesh, p.normal);
                else
                    mesh_vertex(&g.mesh, p.position, NULL, p.normal);
            }
    put_texcoords(&g, options.tiles);
    for (uint64_t n = 0; n < 2ull * nu * ns; n++)
        put_triangle(&g, n);
    close_grid(&g);
}

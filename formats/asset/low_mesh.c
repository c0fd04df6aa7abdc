/* low_mesh.c - finds the normals of corners, and writes the vertices that have each of them. */
#include "formats/asset/low_mesh.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "base/text.h"
#include "base/geometry/vec.h"
#include "formats/asset/glb.h"

/* A vertex with one of its normals. */
struct shaded {
    uint32_t vertex;
    bool common; /* the normal of all its corners */
    float normal[3];
};

/* A corner of the vertex in work. */
struct facing {
    double normal[3]; /* of its triangle, of length 1 */
    double angle;     /* in radians */
};

struct writing {
    struct bsq_ctx *ctx;
    const struct fmt_low_mesh *mesh;
    const struct fmt_tris_header *header;
    double least_cosine;
    struct facing *around;
    uint32_t *starts, *corners; /* of each vertex: its corners are corners[starts[v]...] */
    struct shaded *shaded;      /* by vertices */
    uint32_t *shaded_of;        /* of corners */
    uint32_t shaded_count;
    uint64_t shaded_capacity;
    struct bsq_output *output;
    FILE *file; /* buffers what goes to the output */
    char *buffer;
    int status; /* of the output */
};

enum { BUFFER_BYTES = 1 << 18, CORNERS_CHECKED = 1 << 22 /* between two looks */ };

/* ---- normals ---- */

static void edge_of(const struct fmt_low_mesh *mesh, uint32_t from, uint32_t to, double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (double)mesh->positions[to][k] - (double)mesh->positions[from][k];
}

static void make_unit(double v[3])
{
    const double length = sqrt(bsq_dotd(v, v));
    for (int k = 0; k < 3 && length > 0; k++)
        v[k] /= length;
}

/* Returns the angle of a triangle at a corner in radians. */
static double angle_at(const struct fmt_low_mesh *mesh, uint32_t corner)
{
    const uint32_t *triangle = mesh->triangles[corner / 3];
    const uint32_t at = triangle[corner % 3];
    double a[3], b[3], normal[3];
    edge_of(mesh, at, triangle[(corner % 3 + 1) % 3], a);
    edge_of(mesh, at, triangle[(corner % 3 + 2) % 3], b);
    bsq_crossd(a, b, normal);
    return atan2(sqrt(bsq_dotd(normal, normal)), bsq_dotd(a, b));
}

/* Sets what is around a vertex. */
static void look_around(struct writing *w, uint32_t vertex)
{
    const uint32_t begin = w->starts[vertex];
    for (uint32_t i = begin; i < w->starts[vertex + 1]; i++) {
        const uint32_t *v = w->mesh->triangles[w->corners[i] / 3];
        struct facing *facing = &w->around[i - begin];
        double a[3], b[3];
        edge_of(w->mesh, v[0], v[1], a);
        edge_of(w->mesh, v[0], v[2], b);
        bsq_crossd(a, b, facing->normal);
        make_unit(facing->normal);
        facing->angle = angle_at(w->mesh, w->corners[i]);
    }
}

static void list_vertex_corners(struct writing *w)
{
    const struct fmt_low_mesh *mesh = w->mesh;
    for (uint32_t c = 0; c < 3 * mesh->triangle_count; c++)
        w->starts[mesh->triangles[c / 3][c % 3] + 1]++;
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        w->starts[v + 1] += w->starts[v];
    for (uint32_t c = 3 * mesh->triangle_count; c-- > 0;)
        w->corners[--w->starts[mesh->triangles[c / 3][c % 3] + 1]] = c;
    /* Now starts[v + 1] is where v begins. */
    memmove(w->starts, w->starts + 1, mesh->vertex_count * sizeof *w->starts);
    w->starts[mesh->vertex_count] = 3 * mesh->triangle_count;
}

/* Sets the normal of a vertex at one of `count` corners around it. Returns whether all of these
 * have the same one, because all are within the angle that is smooth. */
static bool corner_normal(const struct writing *w, uint32_t count, uint32_t corner, float out[3])
{
    const double *face = w->around[corner].normal;
    double sum[3] = {0, 0, 0};
    for (uint32_t i = 0; i < count; i++) {
        const double *other = w->around[i].normal;
        if (bsq_dotd(face, other) < w->least_cosine && other != face)
            continue;
        for (int k = 0; k < 3; k++)
            sum[k] += w->around[i].angle * other[k];
    }
    const double square = bsq_dotd(sum, sum);
    make_unit(sum);
    /* The triangles of a fold have no common normal. */
    for (int k = 0; k < 3; k++)
        out[k] = (float)(square > 1e-12 ? sum[k] : face[k]);
    return w->least_cosine <= -1 && square > 1e-12;
}

/* Normals of equal sums have equal numbers. */
static bool is_same_normal(const float a[3], const float b[3])
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

static int shade(struct writing *w)
{
    uint64_t looked = 0; /* at corners, since the last look at an interruption */
    for (uint32_t v = 0; v < w->mesh->vertex_count; v++) {
        const uint32_t first = w->shaded_count, begin = w->starts[v], end = w->starts[v + 1];
        BSQ_PASS(BSQ_GROW(w->ctx, "writing a mesh", first + (uint64_t)(end - begin), &w->shaded,
                          &w->shaded_capacity));
        look_around(w, v);
        for (uint32_t i = begin; i < end; i++) {
            struct shaded *entry = &w->shaded[w->shaded_count];
            uint32_t same = first;
            *entry = (struct shaded){.vertex = v};
            /* If all edges are smooth, all corners have the same sum. */
            if (i > begin && w->shaded[first].common)
                memcpy(entry, &w->shaded[first], sizeof *entry);
            else
                entry->common = corner_normal(w, end - begin, i - begin, entry->normal);
            while (same < w->shaded_count && !is_same_normal(w->shaded[same].normal, entry->normal))
                same++;
            w->shaded_of[w->corners[i]] = same;
            w->shaded_count += same == w->shaded_count;
            looked += end - begin;
            if (looked > CORNERS_CHECKED && bsq_check(w->ctx) < 0)
                return BSQ_EINTR;
            looked = looked > CORNERS_CHECKED ? 0 : looked;
        }
    }
    return 0;
}

/* ---- files ---- */

/* Writes the buffer of the file, as fopencookie() wants it. */
static ssize_t write_buffer(void *writing, const char *bytes, size_t size)
{
    struct writing *w = writing;
    if (w->status == 0)
        w->status = bsq_output_write(w->output, bytes, size);
    return w->status == 0 ? (ssize_t)size : 0;
}

/* Writes the output by way of a buffer. */
static int write_file(struct writing *w, void (*write)(struct writing *w))
{
    int status = bsq_alloc(w->ctx, "writing a mesh", BUFFER_BYTES, 1, &w->buffer);
    if (status < 0)
        return status;
    w->file = fopencookie(w, "w", (cookie_io_functions_t){.write = write_buffer});
    if (!w->file)
        return bsq_fail(w->ctx, BSQ_ENOMEM, "out of memory for writing a mesh");
    setvbuf(w->file, w->buffer, _IOFBF, BUFFER_BYTES);
    const locale_t host = bsq_plain_numbers();
    write(w);
    uselocale(host);
    fclose(w->file); /* the status tells of failures */
    return w->status;
}

/* Digits that give a float back, or a sum of an origin and a float to about that precision. */
static int digits(double origin)
{
    return origin != 0 ? 15 : 9;
}

static void write_obj(struct writing *w)
{
    const struct fmt_low_mesh *mesh = w->mesh;
    const double *o = w->header->origin;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const float *p = mesh->positions[v];
        fprintf(w->file, "v %.*g %.*g %.*g\n", digits(o[0]), o[0] + (double)p[0], digits(o[1]),
                o[1] + (double)p[1], digits(o[2]), o[2] + (double)p[2]);
    }
    for (uint32_t i = 0; i < w->shaded_count; i++) {
        const float *n = w->shaded[i].normal;
        fprintf(w->file, "vn %.7g %.7g %.7g\n", (double)n[0], (double)n[1], (double)n[2]);
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t], *n = &w->shaded_of[3 * (size_t)t];
        fprintf(w->file, "f %u//%u %u//%u %u//%u\n", v[0] + 1, n[0] + 1, v[1] + 1, n[1] + 1,
                v[2] + 1, n[2] + 1);
    }
}

/* Positions are doubles if there is an origin, so that they keep their detail. */
static void write_ply(struct writing *w)
{
    const struct fmt_low_mesh *mesh = w->mesh;
    const double *origin = w->header->origin;
    const bool wide = origin[0] != 0 || origin[1] != 0 || origin[2] != 0;
    const char *type = wide ? "double" : "float";
    fprintf(w->file,
            "ply\nformat binary_little_endian 1.0\nelement vertex %u\n"
            "property %s x\nproperty %s y\nproperty %s z\n"
            "property float nx\nproperty float ny\nproperty float nz\nelement face %u\n"
            "property list uchar uint vertex_indices\nend_header\n",
            w->shaded_count, type, type, type, mesh->triangle_count);
    for (uint32_t i = 0; i < w->shaded_count; i++) {
        const float *p = mesh->positions[w->shaded[i].vertex];
        for (int k = 0; k < 3; k++) {
            const double world = origin[k] + (double)p[k];
            fwrite(wide ? (const void *)&world : &p[k], wide ? sizeof world : sizeof p[k], 1,
                   w->file);
        }
        fwrite(w->shaded[i].normal, sizeof w->shaded[i].normal, 1, w->file);
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        putc(3, w->file);
        fwrite(&w->shaded_of[3 * (size_t)t], 3 * sizeof *w->shaded_of, 1, w->file);
    }
}

static int write_glb(struct writing *w, const char *path)
{
    const double *o = w->header->origin;
    float(*vertices)[6] = NULL;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(w->ctx, "writing a mesh", w->shaded_count, &vertices));
    for (uint32_t i = 0; i < w->shaded_count; i++) {
        memcpy(vertices[i], w->mesh->positions[w->shaded[i].vertex], 3 * sizeof *vertices[i]);
        memcpy(vertices[i] + 3, w->shaded[i].normal, sizeof w->shaded[i].normal);
    }
    const struct fmt_glb_primitive primitive = {.shaded = (const float(*)[6])vertices,
                                                .indices = w->shaded_of,
                                                .vertex_count = w->shaded_count,
                                                .index_count = 3 * w->mesh->triangle_count,
                                                .plain = true};
    const struct fmt_glb glb = {.name = "low",
                                .translation = {o[0], o[1], o[2]},
                                .primitives = &primitive,
                                .primitive_count = w->mesh->triangle_count > 0};
    status = fmt_glb_write(w->ctx, &glb, path, w->output);
done:
    bsq_free(w->ctx, vertices);
    return status;
}

static const char *ending_of(const char *path)
{
    const size_t length = strlen(path);
    return path + (length > 4 ? length - 4 : length);
}

bool fmt_low_mesh_path_is_known(const char *path)
{
    const char *ending = ending_of(path);
    return strcasecmp(ending, ".obj") == 0 || strcasecmp(ending, ".ply") == 0 ||
           strcasecmp(ending, ".glb") == 0;
}

int fmt_low_mesh_write(struct bsq_ctx *ctx, const char *path, const struct fmt_low_mesh *mesh,
                       const struct fmt_tris_header *header, double hard_angle,
                       struct bsq_output **out)
{
    static const char what[] = "writing a mesh";
    const uint64_t corners = 3 * (uint64_t)mesh->triangle_count;
    uint32_t most = 0; /* corners of a vertex */
    struct writing w = {.ctx = ctx,
                        .mesh = mesh,
                        .header = header,
                        /* below the cosines of all angles, which are rounded */
                        .least_cosine =
                            hard_angle < 180 ? cos(hard_angle * 3.14159265358979323846 / 180) : -2};
    int status = 0;
    BSQ_TRY(bsq_output_open(ctx, path, &w.output));
    BSQ_TRY(BSQ_CALLOC(ctx, what, (uint64_t)mesh->vertex_count + 1, &w.starts));
    BSQ_TRY(BSQ_ALLOC(ctx, what, corners, &w.corners));
    BSQ_TRY(BSQ_ALLOC(ctx, what, corners, &w.shaded_of));
    list_vertex_corners(&w);
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        most = w.starts[v + 1] - w.starts[v] > most ? w.starts[v + 1] - w.starts[v] : most;
    BSQ_TRY(BSQ_ALLOC(ctx, what, most, &w.around));
    BSQ_TRY(
        BSQ_GROW(ctx, what, (uint64_t)mesh->vertex_count + most, &w.shaded, &w.shaded_capacity));
    BSQ_TRY(shade(&w));
    if (strcasecmp(ending_of(path), ".glb") == 0)
        BSQ_TRY(write_glb(&w, path));
    else
        BSQ_TRY(write_file(&w, strcasecmp(ending_of(path), ".ply") == 0 ? write_ply : write_obj));
done:
    BSQ_FREE(ctx, w.buffer, w.shaded_of, w.shaded, w.around, w.corners, w.starts);
    if (status < 0)
        bsq_output_discard(w.output);
    else
        *out = w.output;
    return status;
}

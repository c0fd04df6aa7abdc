/* lowpoly.c - loads the low-poly mesh and gives every triangle three corners of its own.
 *
 * Triangles share no corners: texture seams and hard edges split them anyway, and rays,
 * rasterisation and tangents go triangle by triangle. A corner without a normal in the file gets
 * a smooth one: the weighted mean of the normals of the triangles at its vertex. Texture seams do
 * not show in it. */
#include "libbake/lowpoly/lowpoly.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/file.h"
#include "base/geometry/smooth_normals.h"
#include "base/sort_array.h"
#include "base/geometry/vec.h"
#include "libbake/lowpoly/lowpoly_internal.h"
#include "libbake/lowpoly/mikkt.h"

/* Returns the area vector and the area of a triangle, both doubled. */
static struct row face_vector(const struct bake_lowmesh *mesh, uint64_t triangle)
{
    struct row corner[3];
    for (int i = 0; i < 3; i++) {
        const double *p = mesh->positions[triangle][i];
        corner[i] = row_of(p[0], p[1], p[2], 0.0);
    }
    return bsq_area_vector(corner);
}

/* Writes v scaled to unit length; returns false if v is zero or not finite. */
static bool store_unit(const double v[3], float unit[3])
{
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(length > 0) || !isfinite(length))
        return false;
    for (int k = 0; k < 3; k++)
        unit[k] = (float)(v[k] / length);
    return true;
}

/* A mesh whose distance from the origin is more than this many times its own size has its floats
 * relative to its middle: relative to the origin, they would be too coarse. */
#define FAR 64.0

/* ---- arrays ---- */

/* An array of a mesh, with the bytes of a triangle. */
struct array {
    const char *what;
    void *at;
    size_t size;
};

enum {
    ARRAYS = 8,
    NAMED = 2 /* of these, the last ones, which are absent unless names are wanted */
};

/* Lists the arrays of a mesh. */
static void list_arrays(struct bake_lowmesh *mesh, struct array out[ARRAYS])
{
    out[0] = (struct array){"low-poly mesh positions", &mesh->positions, sizeof *mesh->positions};
    out[1] = (struct array){"low-poly mesh normals", &mesh->normals, sizeof *mesh->normals};
    out[2] = (struct array){"low-poly mesh texture coordinates", &mesh->texcoords,
                            sizeof *mesh->texcoords};
    out[3] = (struct array){"low-poly mesh tangents", &mesh->tangents, sizeof *mesh->tangents};
    out[4] = (struct array){"ray directions", &mesh->directions, sizeof *mesh->directions};
    out[5] = (struct array){"reaches of rays", &mesh->reaches, sizeof *mesh->reaches};
    out[6] = (struct array){"names of triangles", &mesh->object_of, sizeof *mesh->object_of};
    out[7] = (struct array){"names of triangles", &mesh->material_of, sizeof *mesh->material_of};
}

static char *start_of(const struct array *array)
{
    char *start;
    memcpy(&start, array->at, sizeof start);
    return start;
}

/* Replaces an array by one of `count` triangles that `from` points at: those in `order`, or if it
 * is NULL the first `kept` of them and then those of another array. */
static int replace_array(struct bsq_ctx *ctx, const struct array *array, const uint32_t *order,
                         uint64_t count, uint64_t kept, const char *others)
{
    char *from = start_of(array), *to;
    const size_t size = array->size;
    BSQ_PASS(bsq_alloc(ctx, array->what, count, size, &to));
    for (uint64_t i = 0; i < count && order; i++)
        memcpy(to + i * size, from + order[i] * size, size);
    if (!order && kept > 0)
        memcpy(to, from, kept * size);
    if (!order && others)
        memcpy(to + kept * size, others, (count - kept) * size);
    bsq_free(ctx, from);
    memcpy(array->at, &to, sizeof to);
    return 0;
}

static int lowpoly_allocate(struct bsq_ctx *ctx, uint64_t count, bool named,
                            struct bake_lowmesh *out)
{
    struct array arrays[ARRAYS];
    list_arrays(out, arrays);
    for (int i = 0; i < (named ? ARRAYS : ARRAYS - NAMED); i++)
        BSQ_PASS(replace_array(ctx, &arrays[i], NULL, count, 0, NULL));
    return 0;
}

/* ---- names ---- */

/* Objects with one name are one object, also in several files: `all` has the names of all files. */

/* Stands for the material of faces that have none. */
#define NO_MATERIAL "none"

/* Copies a file's name without its folder and suffix; that of "low.ply.gz" is ".ply.gz". */
static int copy_stem(struct bsq_ctx *ctx, const char *path, char **out)
{
    const char *name = bsq_file_name(path);
    const size_t unpacked = fmt_mesh_unpacked_length(name);
    const char *dot = memrchr(name, '.', unpacked);
    const size_t length = dot && dot > name ? (size_t)(dot - name) : unpacked;
    int status = bsq_alloc(ctx, "names", length + 1, 1, out);
    if (status == 0)
        *(char *)mempcpy(*out, name, length) = '\0';
    return status;
}

static bool is_named(const char *name)
{
    return name && *name;
}

/* Enters the names of a material of a file and its object, or of faces without one if it is NULL.
 */
static int enter_names(struct bsq_ctx *ctx, struct bake_lowmesh *all, const char *stem,
                       const struct fmt_material *source, uint32_t numbers[2])
{
    uint64_t number[2] = {0};
    const char *object = source && is_named(source->object) ? source->object : stem;
    const char *material = source && is_named(source->name) ? source->name : NO_MATERIAL;
    int status = bsq_texts_add(ctx, &all->names, &all->objects, object, &number[0]);
    if (status == 0)
        status = bsq_texts_add(ctx, &all->names, &all->materials, material, &number[1]);
    numbers[0] = (uint32_t)number[0]; /* at most that of triangles */
    numbers[1] = (uint32_t)number[1];
    return status;
}

/* Names the triangles of a file. numbers: space for one entry more than the file has materials.
 * Names are entered when a triangle has them, so that empty objects do not count. */
static int name_triangles(struct bsq_ctx *ctx, struct bake_lowmesh *all, const char *stem,
                          const struct fmt_mesh *mesh, uint32_t (*numbers)[2],
                          struct bake_lowmesh *out)
{
    const uint32_t none = mesh->materials.count;
    int status = 0;
    memset(numbers, 0xff, (none + UINT64_C(1)) * sizeof *numbers);
    for (uint64_t t = 0; t < mesh->triangle_count && status == 0; t++) {
        const uint32_t named = mesh->face_materials[mesh->faces[t]],
                       material = named < none ? named : none;
        if (numbers[material][0] == UINT32_MAX)
            status = enter_names(ctx, all, stem,
                                 material < none ? &mesh->materials.list[material] : NULL,
                                 numbers[material]);
        out->object_of[t] = numbers[material][0];
        out->material_of[t] = numbers[material][1];
        if (t % 4096 == 0 && status == 0)
            status = bsq_check(ctx);
    }
    return status;
}

/* Sets the objects and materials of a file's triangles. A triangle without an object belongs to one
 * with the file's name, without folder and suffix. */
static int add_names(struct bsq_ctx *ctx, struct bake_lowmesh *all, const char *path,
                     const struct fmt_mesh *mesh, struct bake_lowmesh *out)
{
    char *stem = NULL;
    uint32_t(*numbers)[2] = NULL;
    int status = 0;
    BSQ_TRY(copy_stem(ctx, path, &stem));
    BSQ_TRY(BSQ_ALLOC(ctx, "names", mesh->materials.count + UINT64_C(1), &numbers));
    BSQ_TRY(name_triangles(ctx, all, stem, mesh, numbers, out));
done:
    BSQ_FREE(ctx, numbers, stem);
    return status;
}

/* A triangle, and what its set is named by. */
struct owned {
    uint64_t set; /* number of the object, and below it that of the material */
    uint32_t triangle;
};

static int compare_owners(const void *a, const void *b)
{
    const struct owned *x = a, *y = b;
    if (x->set != y->set)
        return x->set < y->set ? -1 : 1;
    return (x->triangle > y->triangle) - (x->triangle < y->triangle);
}

/* Return whether each object, or each material, has maps of its own. */
static bool object_maps(const struct bake_options *options)
{
    return options->output_path && strstr(options->output_path, BAKE_OBJECT_TOKEN);
}

static bool material_maps(const struct bake_options *options)
{
    return options->output_path && strstr(options->output_path, BAKE_MATERIAL_TOKEN);
}

/* Makes each run of equal owners a set. */
static int make_sets(struct bsq_ctx *ctx, const struct bake_options *options,
                     const struct owned *owned, uint64_t count, struct bake_lowmesh *mesh)
{
    uint64_t capacity = 0;
    int status = 0;
    for (uint64_t i = 0; i < count && status == 0; i++) {
        if (i > 0 && owned[i - 1].set == owned[i].set) {
            mesh->sets[mesh->set_count - 1].count++;
            continue;
        }
        status =
            BSQ_GROW(ctx, "sets of maps", mesh->set_count + UINT64_C(1), &mesh->sets, &capacity);
        if (status == 0)
            mesh->sets[mesh->set_count++] = (struct bake_low_set){
                .object = object_maps(options) ? mesh->objects.list[owned[i].set >> 32] : NULL,
                .material =
                    material_maps(options) ? mesh->materials.list[(uint32_t)owned[i].set] : NULL,
                .first = i,
                .count = 1};
    }
    return status;
}

/* Sorts the mesh by set, and gives it the sets. */
static int sort_by_set(struct bsq_ctx *ctx, const struct bake_options *options,
                       struct bake_lowmesh *mesh)
{
    const uint64_t count = mesh->triangle_count;
    struct owned *owned = NULL;
    uint32_t *order = NULL;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "sets of maps", count, &owned));
    BSQ_TRY(BSQ_ALLOC(ctx, "sets of maps", count, &order));
    for (uint64_t t = 0; t < count; t++)
        owned[t] = (struct owned){(object_maps(options) ? (uint64_t)mesh->object_of[t] << 32 : 0) |
                                      (material_maps(options) ? mesh->material_of[t] : 0),
                                  (uint32_t)t};
    bsq_sort(owned, count, sizeof *owned, compare_owners);
    BSQ_TRY(make_sets(ctx, options, owned, count, mesh));
    for (uint64_t t = 0; t < count; t++)
        order[t] = owned[t].triangle;
    if (mesh->set_count > 1)
        BSQ_TRY(bake_lowmesh_reorder(ctx, order, count, mesh));
done:
    BSQ_FREE(ctx, order, owned);
    return status;
}

/* ---- one file ---- */

static void lowpoly_copy_positions(const struct fmt_mesh *mesh, struct bake_lowmesh *out)
{
    for (int k = 0; k < 3; k++) {
        out->bounds_min[k] = INFINITY;
        out->bounds_max[k] = -INFINITY;
    }
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            const double *p = mesh->positions[mesh->vertices[t][i]];
            for (int k = 0; k < 3; k++) {
                out->positions[t][i][k] = p[k];
                out->bounds_min[k] = fmin(out->bounds_min[k], p[k]);
                out->bounds_max[k] = fmax(out->bounds_max[k], p[k]);
            }
        }
    }
}

static int copy_texcoords(struct bsq_ctx *ctx, const char *path, const struct fmt_mesh *mesh,
                          struct bake_lowmesh *out)
{
    if (mesh->corner_texcoords == NULL)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: no texture coordinates: the low-poly mesh has to be unwrapped", path);
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            uint32_t index = mesh->corner_texcoords[t][i];
            if (index == UINT32_MAX)
                return fmt_mesh_fail_face(ctx, path, mesh->faces[t], "has no texture coordinates");
            for (int k = 0; k < 2; k++) {
                double value = mesh->texcoords[index][k];
                out->texcoords[t][i][k] = (float)fmin(fmax(value, -FLT_MAX), FLT_MAX);
            }
        }
    }
    return 0;
}

/* Checks whether any corner has no normal. */
static bool lacks_normals(const struct fmt_mesh *mesh)
{
    if (mesh->corner_normals == NULL)
        return true;
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            if (mesh->corner_normals[t][i] == UINT32_MAX)
                return true;
        }
    }
    return false;
}

void bake_choose_origin(const double low[3], const double high[3], double out[3])
{
    double size = 0, farthest = 0;
    for (int k = 0; k < 3; k++) {
        size = fmax(size, high[k] - low[k]);
        farthest = fmax(farthest, fmax(fabs(low[k]), fabs(high[k])));
    }
    for (int k = 0; k < 3; k++)
        out[k] = farthest > FAR * size ? (low[k] + high[k]) / 2 : 0;
}

/* Writes the float positions from which tangents are computed. The convention works on the file's
 * coordinates as floats, so the origin is 0. Only a mesh that is far away for its size gets another
 * one, as floats would merge its corners. */
static void copy_floats(const struct bake_lowmesh *mesh, float (*out)[3][3])
{
    double origin[3];
    bake_choose_origin(mesh->bounds_min, mesh->bounds_max, origin);
    for (uint64_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                out[t][i][k] = (float)(mesh->positions[t][i][k] - origin[k]);
}

/* Writes each corner's triangle normal. A triangle without area has an arbitrary one, as normals
 * must be finite. */
static void fill_flat(struct bake_lowmesh *out)
{
    for (uint64_t t = 0; t < out->triangle_count; t++) {
        float face_normal[3] = {0, 0, 1};
        double vector[4];
        row_store(face_vector(out, t), vector);
        store_unit(vector, face_normal);
        for (int i = 0; i < 3; i++)
            memcpy(out->normals[t][i], face_normal, sizeof face_normal);
    }
}

/* Finds the first corner of each corner's vertex; of formats that split vertices, at the same
 * position. */
static int find_firsts(struct bsq_ctx *ctx, const struct fmt_mesh *mesh,
                       const float (*positions)[3][3], uint32_t *firsts)
{
    const struct mikkt_input input = {.corner_count = (uint32_t)(3 * mesh->triangle_count),
                                      .positions = (const float(*)[3])positions};
    uint32_t *first_of;
    if (mesh->split_vertices)
        return bake_mikkt_weld(ctx, &input, firsts);
    BSQ_PASS(BSQ_ALLOC(ctx, "corners of vertices", mesh->vertex_count, &first_of));
    memset(first_of, 0xff, mesh->vertex_count * sizeof *first_of);
    for (uint32_t c = 0; c < input.corner_count; c++) {
        uint32_t *first = &first_of[mesh->vertices[c / 3][c % 3]];
        *first = *first == UINT32_MAX ? c : *first;
        firsts[c] = *first;
    }
    bsq_free(ctx, first_of);
    return bsq_check(ctx);
}

/* Makes the triangle normals of corners smooth that have none in the file. */
static int smooth_normals(struct bsq_ctx *ctx, const struct fmt_mesh *mesh, bool by_area,
                          struct bake_lowmesh *out)
{
    const uint64_t count = mesh->triangle_count;
    float(*positions)[3][3] = NULL, (*smooth)[3][3] = NULL;
    uint32_t *firsts = NULL;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "smooth normals", count, &positions));
    BSQ_TRY(BSQ_ALLOC(ctx, "smooth normals", count, &smooth));
    BSQ_TRY(BSQ_ALLOC(ctx, "smooth normals", 3 * count, &firsts));
    copy_floats(out, positions);
    BSQ_TRY(find_firsts(ctx, mesh, (const float(*)[3][3])positions, firsts));
    BSQ_TRY(bake_mean_normals(ctx, by_area, (uint32_t)(3 * count), positions[0],
                              (const float(*)[3])out->normals, firsts, smooth[0]));
    for (uint64_t c = 0; c < 3 * count; c++)
        if (!mesh->corner_normals || mesh->corner_normals[c / 3][c % 3] == UINT32_MAX)
            memcpy(out->normals[c / 3][c % 3], smooth[c / 3][c % 3], sizeof **smooth);
done:
    BSQ_FREE(ctx, firsts, smooth, positions);
    return status;
}

/* Fills in normals that the file does not have, by its format if the options leave it open. */
static int fill_missing_normals(struct bsq_ctx *ctx, const struct bake_options *options,
                                const char *path, const struct fmt_mesh *mesh,
                                struct bake_lowmesh *out)
{
    enum bake_low_normals kind = options->low_normals;
    if (kind == BAKE_LOW_AUTO) {
        kind = mesh->flat_normals ? BAKE_LOW_FLAT : BAKE_LOW_ANGLE;
        bsq_warn(
            ctx,
            "%s has no normals%s: it gets %s ones, and must be shown with them; export normals, "
            "or choose: --low normals=angle, smooth or flat",
            path, mesh->corner_normals ? " for some faces" : "",
            kind == BAKE_LOW_FLAT ? "flat" : "smooth");
    }
    return kind == BAKE_LOW_FLAT ? 0 : smooth_normals(ctx, mesh, kind == BAKE_LOW_SMOOTH, out);
}

/* Gives each corner its own normal, the one that the options choose if it has none, or that of the
 * triangle if it has no length. */
static int fill_normals(struct bsq_ctx *ctx, const struct bake_options *options, const char *path,
                        const struct fmt_mesh *mesh, struct bake_lowmesh *out)
{
    fill_flat(out);
    int status = lacks_normals(mesh) ? fill_missing_normals(ctx, options, path, mesh, out) : 0;
    for (uint64_t t = 0; t < mesh->triangle_count && mesh->corner_normals; t++)
        for (int i = 0; i < 3; i++) {
            const uint32_t index = mesh->corner_normals[t][i];
            if (index == UINT32_MAX)
                continue;
            const float *n = mesh->normals[index];
            store_unit((const double[3]){n[0], n[1], n[2]}, out->normals[t][i]);
        }
    return status == 0 ? bsq_check(ctx) : status;
}

/* Computes tangents, and the directions of rays unless a cage gives them. */
static int compute_frames(struct bsq_ctx *ctx, const struct bake_options *options,
                          struct bake_lowmesh *mesh)
{
    float(*positions)[3][3] = NULL;
    BSQ_PASS(BSQ_ALLOC(ctx, "tangent positions", mesh->triangle_count, &positions));
    copy_floats(mesh, positions);
    int status = bake_mikkt(ctx, mesh->triangle_count, (const float(*)[3][3])positions,
                            (const float(*)[3][3])mesh->normals,
                            (const float(*)[3][2])mesh->texcoords, mesh->tangents);
    if (status == 0 && !options->cage_path)
        status = bake_ray_directions(
            ctx, options->rays, mesh->triangle_count, (const float(*)[3][3])positions,
            (const float(*)[3][3])mesh->normals, mesh->directions, mesh->reaches);
    if (status == 0 && options->extrude > 0)
        bake_extrude(options->extrude, mesh);
    bsq_free(ctx, positions);
    return status;
}

/* Returns the number of faces with more than three corners: their triangles follow each other. */
static uint64_t count_polygons(const struct fmt_mesh *mesh)
{
    uint64_t count = 0;
    for (uint64_t t = 1; t < mesh->triangle_count; t++)
        count += mesh->faces[t] == mesh->faces[t - 1] &&
                 (t == 1 || mesh->faces[t - 2] != mesh->faces[t]);
    return count;
}

/* Loads one file, whose bounds are those of its triangles. *out is all zeros; all: gets its names.
 */
static int load_file(struct bsq_ctx *ctx, const struct bake_options *options, const char *path,
                     struct bake_lowmesh *all, struct bake_lowmesh *out)
{
    const bool named = options->match_names || object_maps(options) || material_maps(options);
    struct fmt_mesh mesh = {0};
    int status = fmt_mesh_load(ctx, path, named, &mesh);
    if (status < 0)
        return status;
    if (mesh.has_tangents)
        bsq_warn(ctx, "%s: the file's tangents are not used: they are computed (MikkTSpace)", path);
    if (mesh.uneven_scale)
        bsq_warn(
            ctx,
            "%s: a node has scales that differ by axis; engines make tangents before scaling, so "
            "their shading will be off by some degrees: apply the scale before baking",
            path);
    bake_transform_mesh(options, &mesh);
    BSQ_TRY(lowpoly_allocate(ctx, mesh.triangle_count, named, out));
    out->triangle_count = mesh.triangle_count;
    out->polygon_count = count_polygons(&mesh);
    lowpoly_copy_positions(&mesh, out);
    BSQ_TRY(bsq_check(ctx));
    BSQ_TRY(copy_texcoords(ctx, path, &mesh, out));
    BSQ_TRY(fill_normals(ctx, options, path, &mesh, out));
    if (options->cage_path)
        BSQ_TRY(bake_cage_directions(ctx, options, path, &mesh, out));
    if (named)
        BSQ_TRY(add_names(ctx, all, path, &mesh, out));
    BSQ_TRY(bsq_check(ctx));
done:
    fmt_mesh_free(ctx, &mesh);
    return status < 0 ? status : compute_frames(ctx, options, out);
}

/* ---- several files ---- */

int bake_lowmesh_reorder(struct bsq_ctx *ctx, const uint32_t *order, uint64_t count,
                         struct bake_lowmesh *mesh)
{
    struct array arrays[ARRAYS];
    int status = 0;
    list_arrays(mesh, arrays);
    for (int i = 0; i < ARRAYS && status == 0; i++)
        if (start_of(&arrays[i]))
            status = replace_array(ctx, &arrays[i], order, count, 0, NULL);
    if (status == 0)
        mesh->triangle_count = count;
    return status;
}

/* Adds the triangles of another mesh. */
static int lowpoly_append(struct bsq_ctx *ctx, struct bake_lowmesh *other,
                          struct bake_lowmesh *mesh)
{
    const uint64_t kept = mesh->triangle_count, count = kept + other->triangle_count;
    struct array to[ARRAYS], from[ARRAYS];
    int status = 0;
    list_arrays(mesh, to);
    list_arrays(other, from);
    for (int i = 0; i < ARRAYS && status == 0; i++)
        if (start_of(&from[i]))
            status = replace_array(ctx, &to[i], NULL, count, kept, start_of(&from[i]));
    if (status < 0)
        return status;
    mesh->triangle_count = count;
    mesh->polygon_count += other->polygon_count;
    for (int k = 0; k < 3; k++) {
        mesh->bounds_min[k] = fmin(mesh->bounds_min[k], other->bounds_min[k]);
        mesh->bounds_max[k] = fmax(mesh->bounds_max[k], other->bounds_max[k]);
    }
    return 0;
}

int bake_lowmesh_load(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_lowmesh *out)
{
    *out = (struct bake_lowmesh){0};
    int status = load_file(ctx, options, options->mesh_path, out, out);
    for (uint32_t i = 0; i < options->more_mesh_count && status == 0; i++) {
        struct bake_lowmesh next = {0};
        status = load_file(ctx, options, options->more_mesh_paths[i], out, &next);
        if (status == 0)
            status = lowpoly_append(ctx, &next, out);
        bake_lowmesh_free(ctx, &next);
    }
    if (status == 0 && out->triangle_count > UINT32_MAX / 3)
        status = bsq_fail(ctx, BSQ_EDATA, "%s and other files: more than %u triangles",
                          options->mesh_path, UINT32_MAX / 3);
    if (status == 0 && (object_maps(options) || material_maps(options)))
        status = sort_by_set(ctx, options, out);
    if (status < 0)
        bake_lowmesh_free(ctx, out);
    return status;
}

double bake_lowmesh_area(const struct bake_lowmesh *mesh, uint64_t triangle)
{
    double(*p)[3] = mesh->positions[triangle], a[3], b[3], cross[3];
    for (int k = 0; k < 3; k++) {
        a[k] = p[1][k] - p[0][k];
        b[k] = p[2][k] - p[0][k];
    }
    bsq_crossd(a, b, cross);
    return 0.5 * sqrt(bsq_dotd(cross, cross));
}

void bake_lowmesh_free(struct bsq_ctx *ctx, struct bake_lowmesh *mesh)
{
    BSQ_FREE(ctx, mesh->positions, mesh->normals, mesh->texcoords, mesh->tangents, mesh->directions,
             mesh->reaches, mesh->object_of, mesh->material_of, mesh->sets);
    bsq_texts_free(&mesh->objects);
    bsq_texts_free(&mesh->materials);
    bsq_tally_release(ctx, &mesh->names);
    memset(mesh, 0, sizeof(*mesh));
}

/* names.c - see lowpoly_internal.h. Objects with one name are one object, also in several files. */
#include "libbake/lowpoly/lowpoly_internal.h"

#include <string.h>

#include "base/file.h"
#include "base/sort_array.h"

/* Stands for the material of faces that have none. */
#define NO_MATERIAL "none"

/* ---- a file ---- */

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
static int enter_names(struct bsq_ctx *ctx, struct bake_names *names, const char *stem,
                       const struct fmt_material *source, uint32_t numbers[2])
{
    uint64_t number[2] = {0};
    const char *object = source && is_named(source->object) ? source->object : stem;
    const char *material = source && is_named(source->name) ? source->name : NO_MATERIAL;
    int status = bsq_texts_add(ctx, &names->tally, &names->objects, object, &number[0]);
    if (status == 0)
        status = bsq_texts_add(ctx, &names->tally, &names->materials, material, &number[1]);
    numbers[0] = (uint32_t)number[0]; /* at most that of triangles */
    numbers[1] = (uint32_t)number[1];
    return status;
}

/* Adds the triangles of a file. numbers: space for one entry more than the file has materials.
 * Names are entered when a triangle has them, so that empty objects do not count. */
static int add_triangles(struct bsq_ctx *ctx, struct bake_names *names, const char *stem,
                         const struct fmt_mesh *mesh, uint32_t (*numbers)[2])
{
    const uint32_t none = mesh->materials.count;
    int status = 0;
    memset(numbers, 0xff, (none + UINT64_C(1)) * sizeof *numbers);
    for (uint64_t t = 0; t < mesh->triangle_count && status == 0; t++) {
        const uint32_t named = mesh->face_materials[mesh->faces[t]],
                       material = named < none ? named : none;
        if (numbers[material][0] == UINT32_MAX)
            status = enter_names(ctx, names, stem,
                                 material < none ? &mesh->materials.list[material] : NULL,
                                 numbers[material]);
        memcpy(names->of[names->count++], numbers[material], sizeof *names->of);
        if (t % 4096 == 0 && status == 0)
            status = bsq_check(ctx);
    }
    return status;
}

int bake_names_add(struct bsq_ctx *ctx, struct bake_names *names, const char *path,
                   const struct fmt_mesh *mesh)
{
    char *stem = NULL;
    uint32_t(*numbers)[2] = NULL;
    int status = 0;
    BSQ_TRY(copy_stem(ctx, path, &stem));
    BSQ_TRY(
        bsq_alloc(ctx, "names", mesh->materials.count + UINT64_C(1), sizeof *numbers, &numbers));
    BSQ_TRY(bsq_grow(ctx, "names of triangles", names->count + mesh->triangle_count,
                     sizeof *names->of, &names->of, &names->capacity));
    BSQ_TRY(add_triangles(ctx, names, stem, mesh, numbers));
done:
    bsq_free(ctx, numbers);
    bsq_free(ctx, stem);
    return status;
}

/* ---- sets ---- */

/* A triangle, and what its set is named by. */
struct owned {
    uint32_t object, material, triangle;
};

static int compare_sets(const struct owned *a, const struct owned *b)
{
    if (a->object != b->object)
        return a->object < b->object ? -1 : 1;
    return (a->material > b->material) - (a->material < b->material);
}

static int compare_owners(const void *a, const void *b)
{
    const struct owned *x = a, *y = b;
    const int sets = compare_sets(x, y);
    return sets != 0 ? sets : (x->triangle > y->triangle) - (x->triangle < y->triangle);
}

/* Makes each run of equal owners a set. */
static int make_sets(struct bsq_ctx *ctx, const struct bake_lowmesh_options *options,
                     const struct owned *owned, uint64_t count, struct bake_lowmesh *mesh)
{
    uint64_t capacity = 0;
    int status = 0;
    for (uint64_t i = 0; i < count && status == 0; i++) {
        if (i > 0 && compare_sets(&owned[i - 1], &owned[i]) == 0) {
            mesh->sets[mesh->set_count - 1].count++;
            continue;
        }
        status = bsq_grow(ctx, "sets of maps", mesh->set_count + UINT64_C(1), sizeof *mesh->sets,
                          &mesh->sets, &capacity);
        if (status == 0)
            mesh->sets[mesh->set_count++] = (struct bake_low_set){
                .object = options->object_maps ? mesh->objects.list[owned[i].object] : NULL,
                .material = options->material_maps ? mesh->materials.list[owned[i].material] : NULL,
                .first = i,
                .count = 1};
    }
    return status;
}

static int sort_by_set(struct bsq_ctx *ctx, const struct bake_lowmesh_options *options,
                       const struct bake_names *names, struct bake_lowmesh *mesh)
{
    const uint64_t count = mesh->triangle_count;
    struct owned *owned = NULL;
    uint32_t *order = NULL;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "sets of maps", count, sizeof *owned, &owned));
    BSQ_TRY(bsq_alloc(ctx, "sets of maps", count, sizeof *order, &order));
    for (uint64_t t = 0; t < count; t++)
        owned[t] = (struct owned){options->object_maps ? names->of[t][0] : 0,
                                  options->material_maps ? names->of[t][1] : 0, (uint32_t)t};
    bsq_sort(owned, count, sizeof *owned, compare_owners);
    BSQ_TRY(make_sets(ctx, options, owned, count, mesh));
    for (uint64_t t = 0; t < count; t++)
        order[t] = owned[t].triangle;
    if (mesh->set_count > 1)
        BSQ_TRY(bake_lowmesh_reorder(ctx, order, count, mesh));
done:
    bsq_free(ctx, order);
    bsq_free(ctx, owned);
    return status;
}

/* ---- all files ---- */

int bake_names_apply(struct bsq_ctx *ctx, const struct bake_lowmesh_options *options,
                     struct bake_names *names, struct bake_lowmesh *mesh)
{
    int status = 0;
    mesh->objects = names->objects;
    mesh->materials = names->materials;
    mesh->names = names->tally;
    names->objects = names->materials = (struct bsq_texts){0};
    names->tally = (struct bsq_tally){0};
    if (options->objects)
        status = bsq_alloc(ctx, "objects of triangles", mesh->triangle_count,
                           sizeof *mesh->object_of, &mesh->object_of);
    for (uint64_t t = 0; t < mesh->triangle_count && options->objects && status == 0; t++)
        mesh->object_of[t] = names->of[t][0];
    if (status == 0 && (options->object_maps || options->material_maps))
        status = sort_by_set(ctx, options, names, mesh);
    return status;
}

void bake_names_free(struct bsq_ctx *ctx, struct bake_names *names)
{
    bsq_texts_free(&names->objects);
    bsq_texts_free(&names->materials);
    bsq_tally_release(ctx, &names->tally);
    bsq_free(ctx, names->of);
}

/* gltf_mesh.c - meshes of glTF files: which accessors their primitives use. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "formats/mesh/gltf_internal.h"

enum { MODE_TRIANGLES = 4, MODE_STRIP = 5, MODE_FAN = 6 };

/* Adds to a count of elements. */
static int add(const struct gltf_place *place, uint64_t *sum, uint64_t value)
{
    if (__builtin_add_overflow(*sum, value, sum) || *sum > INT64_MAX)
        return fmt_gltf_fail(place, "too many elements");
    return 0;
}

/* Reads an attribute, whose elements have `least` to `most` components. */
static int read_attribute(const struct gltf_place *place, const struct gltf_source *source,
                          const json_t *primitive, const char *key, uint32_t least, uint32_t most,
                          uint32_t *out)
{
    const json_t *attributes = json_object_get(primitive, "attributes");
    int status = fmt_gltf_index(place, attributes, key, "accessors", out);
    if (status || *out == GLTF_NONE)
        return status;
    const uint32_t components = source->accessors[*out].components;
    if (components < least || components > most)
        return fmt_gltf_fail(place, "%s has another number of components", key);
    return 0;
}

static int read_attributes(const struct gltf_place *place, const struct gltf_source *source,
                           const json_t *object, const char *texcoord, struct gltf_primitive *out)
{
    int status;
    BSQ_TRY(read_attribute(place, source, object, "POSITION", 3, 3, &out->position));
    BSQ_TRY(read_attribute(place, source, object, "NORMAL", 3, 3, &out->normal));
    BSQ_TRY(read_attribute(place, source, object, texcoord, 2, 2, &out->texcoord));
    BSQ_TRY(read_attribute(place, source, object, "COLOR_0", 3, 4, &out->color));
    if (out->position == GLTF_NONE)
        return 0;
    const uint32_t others[] = {out->normal, out->texcoord, out->color};
    const uint64_t vertices = source->accessors[out->position].count;
    for (int i = 0; i < 3; i++)
        if (others[i] != GLTF_NONE && source->accessors[others[i]].count < vertices)
            return fmt_gltf_fail(place,
                                 "an attribute has %" PRIu64 " elements, POSITION has %" PRIu64,
                                 source->accessors[others[i]].count, vertices);
done:
    return status;
}

static int read_indices(const struct gltf_place *place, struct gltf_source *source,
                        const json_t *object, struct gltf_primitive *out)
{
    int status = fmt_gltf_index(place, object, "indices", "accessors", &out->index);
    if (status || out->index == GLTF_NONE)
        return status;
    const struct gltf_accessor *a = &source->accessors[out->index];
    const enum gltf_component type = a->elements.component;
    if (a->components != 1 || a->normalized ||
        (type != GLTF_UINT8 && type != GLTF_UINT16 && type != GLTF_UINT32))
        return fmt_gltf_fail(place, "its indices are no unsigned integers");
    return 0;
}

/* Counts the triangles of a primitive, and indices that belong to none. */
static void count_triangles(struct gltf_source *source, struct gltf_primitive *out)
{
    const uint32_t list = out->index != GLTF_NONE ? out->index : out->position;
    const uint64_t count = source->accessors[list].count;
    if (out->mode == MODE_TRIANGLES) {
        out->triangles = count / 3;
        source->unread.rest += count % 3;
    } else {
        out->triangles = count > 2 ? count - 2 : 0;
        source->unread.rest += count > 2 ? 0 : count;
    }
}

/* Reads the accessors of a primitive of triangles. */
static int read_accessors(const struct gltf_place *place, struct gltf_source *source,
                          const json_t *object, struct gltf_primitive *out)
{
    const uint32_t set = out->material == GLTF_NONE ? 0 : source->materials[out->material].texcoord;
    char texcoord[32];
    snprintf(texcoord, sizeof texcoord, "TEXCOORD_%" PRIu32, set);
    int status;
    BSQ_TRY(read_attributes(place, source, object, texcoord, out));
    BSQ_TRY(read_indices(place, source, object, out));
    BSQ_TRY(fmt_gltf_read_draco(place, source, object, texcoord, out));
    const uint32_t all[] = {out->position, out->normal, out->texcoord, out->color, out->index};
    for (int i = 0; i < 5; i++)
        if (all[i] != GLTF_NONE)
            BSQ_TRY(fmt_gltf_check_zeros(place, source, all[i]));
done:
    return status;
}

/* Returns whether a primitive has colours of vertices beside COLOR_0. */
static bool has_other_colors(const json_t *primitive)
{
    const json_t *attributes = json_object_get(primitive, "attributes");
    for (void *i = json_object_iter((json_t *)attributes); i;
         i = json_object_iter_next((json_t *)attributes, i))
        if (strncmp(json_object_iter_key(i), "COLOR_", 6) == 0 &&
            strcmp(json_object_iter_key(i), "COLOR_0") != 0)
            return true;
    return false;
}

/* Reads a primitive. Leaves its `triangles` 0 if it has none that can be read. */
static int read_primitive(const struct gltf_place *place, struct gltf_source *source,
                          const json_t *object, struct gltf_primitive *out)
{
    uint64_t mode = MODE_TRIANGLES;
    int status = fmt_gltf_number(place, object, "mode", 6, &mode);
    out->mode = (uint32_t)mode;
    if (!status && mode < MODE_TRIANGLES) {
        source->unread.points++;
        return 0;
    }
    if (!status)
        status = fmt_gltf_index(place, object, "material", "materials", &out->material);
    if (!status)
        status = read_accessors(place, source, object, out);
    source->unread.bare += !status && out->position == GLTF_NONE;
    if (status || out->position == GLTF_NONE)
        return status;
    count_triangles(source, out);
    if (out->triangles == 0)
        return 0;
    if (source->accessors[out->position].count == 0)
        return fmt_gltf_fail(place, "it has triangles, but no vertices");
    if (out->color != GLTF_NONE) /* some programs forget to say so */
        source->accessors[out->color].normalized = true;
    source->has_tangents |=
        json_object_get(json_object_get(object, "attributes"), "TANGENT") != NULL;
    source->has_colors |= out->color != GLTF_NONE;
    source->unread.other_colors += out->color == GLTF_NONE && has_other_colors(object);
    source->unread.variants += fmt_gltf_extension(object, "KHR_materials_variants") != NULL;
    source->unread.texture_colors += out->color != GLTF_NONE && out->texcoord != GLTF_NONE &&
                                     out->material != GLTF_NONE &&
                                     source->materials[out->material].described.texture_path;
    return 0;
}

/* Adds a primitive to its mesh. */
static int add_primitive(const struct gltf_place *place, const struct gltf_source *source,
                         struct gltf_mesh *mesh, struct gltf_primitive *p)
{
    const uint64_t vertices = source->accessors[p->position].count;
    const uint64_t counts[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_VERTEX] = vertices,
        [FMT_MESH_TEXCOORD] = p->texcoord != GLTF_NONE ? vertices : 0,
        [FMT_MESH_NORMAL] = p->normal != GLTF_NONE ? vertices : 0};
    int status = add(place, &mesh->triangles, p->triangles);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT && !status; kind++) {
        p->base[kind] = mesh->total[kind];
        status = add(place, &mesh->total[kind], counts[kind]);
    }
    mesh->count++;
    return status;
}

int fmt_gltf_read_mesh(const struct gltf_place *place, struct gltf_source *source, void *element)
{
    struct gltf_mesh *mesh = element;
    const json_t *list = json_object_get(place->object, "primitives");
    int status = 0;
    mesh->first = source->primitive_count;
    for (size_t i = 0; i < json_array_size(list); i++) {
        struct gltf_primitive *p = &source->primitives[source->primitive_count];
        *p = (struct gltf_primitive){
            .position = GLTF_NONE, .mesh = (uint32_t)place->index, .number = (uint32_t)i};
        BSQ_TRY(i % 1024 ? 0 : bsq_check(place->document->ctx));
        BSQ_TRY(read_primitive(place, source, json_array_get(list, i), p));
        if (p->triangles > 0) {
            BSQ_TRY(add_primitive(place, source, mesh, p));
            source->primitive_count++;
        }
    }
done:
    return status;
}

int fmt_gltf_allocate_primitives(struct gltf_document *document, struct gltf_source *source)
{
    const uint64_t count = fmt_gltf_count(document, "meshes");
    uint64_t primitives = 1;
    for (uint64_t i = 0; i < count; i++)
        primitives += json_array_size(
            json_object_get(fmt_gltf_element(document, "meshes", i).object, "primitives"));
    return bsq_calloc(document->ctx, "glTF primitives", primitives, sizeof *source->primitives,
                      &source->primitives);
}

/* gltf_scene.c - meshes and nodes of glTF files: what each mesh has, and where it is placed.
 *
 * The nodes of a scene are visited from their roots, with a stack in memory, so a deep hierarchy
 * needs no deep recursion. A node that is met twice is an error, which excludes circles. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/geometry/vec.h"
#include "formats/mesh/gltf_internal.h"

/* ---- meshes: which accessors their primitives use ---- */

enum { MODE_TRIANGLES = 4, MODE_STRIP = 5, MODE_FAN = 6 };

/* Adds to a count of elements. */
static int add(const struct gltf_item *item, uint64_t *sum, uint64_t value)
{
    if (__builtin_add_overflow(*sum, value, sum) || *sum > INT64_MAX)
        return fmt_gltf_fail(item, "too many elements");
    return 0;
}

/* Reads the accessor of an attribute, whose elements have `least` to `most` components. There must
 * be one for each position. */
static int read_attribute(const struct gltf_item *item, const struct gltf_source *source,
                          const json_t *attributes, const char *key, enum gltf_use use,
                          struct gltf_primitive *p)
{
    static const uint8_t least[] = {3, 3, 2, 3}, most[] = {3, 3, 2, 4};
    int status = fmt_gltf_index(item, attributes, key, "accessors", &p->accessors[use]);
    const struct gltf_accessor *own = gltf_accessor_of(source, p, use);
    const struct gltf_accessor *positions = gltf_accessor_of(source, p, GLTF_POSITION);
    if (status || !own)
        return status;
    if (own->components < least[use] || own->components > most[use])
        return fmt_gltf_fail(item, "%s has another number of components", key);
    if (positions && own->count < positions->count)
        return fmt_gltf_fail(item, "an attribute has %" PRIu64 " elements, POSITION has %" PRIu64,
                             own->count, positions->count);
    return 0;
}

static int read_indices(const struct gltf_item *item, struct gltf_source *source,
                        const json_t *object, struct gltf_primitive *out)
{
    int status = fmt_gltf_index(item, object, "indices", "accessors", &out->accessors[GLTF_INDEX]);
    const struct gltf_accessor *a = gltf_accessor_of(source, out, GLTF_INDEX);
    if (status || !a)
        return status;
    const enum gltf_component type = a->component;
    if (a->components != 1 || a->normalized ||
        (type != GLTF_UINT8 && type != GLTF_UINT16 && type != GLTF_UINT32))
        return fmt_gltf_fail(item, "its indices are no unsigned integers");
    return 0;
}

/* Counts the triangles of a primitive, and indices that belong to none. */
static void count_triangles(struct gltf_source *source, struct gltf_primitive *out)
{
    const enum gltf_use list = out->accessors[GLTF_INDEX] != GLTF_NONE ? GLTF_INDEX : GLTF_POSITION;
    const uint64_t count = gltf_accessor_of(source, out, list)->count;
    if (out->mode == MODE_TRIANGLES) {
        out->triangles = count / 3;
        source->unread.rest += count % 3;
    } else {
        out->triangles = count > 2 ? count - 2 : 0;
        source->unread.rest += count > 2 ? 0 : count;
    }
}

/* Checks that an accessor of a mesh can be read. One without a view stands for zeros. There may be
 * as many of them as the file has bytes, so that a small file cannot stand for endless work. */
static int check_used(const struct gltf_item *item, const struct gltf_source *source,
                      uint32_t number)
{
    const struct gltf_accessor *accessor = &source->accessors[number];
    if (accessor->sparse)
        return fmt_gltf_fail(item,
                             "accessors[%" PRIu32 "] is sparse, which is not read: save the file "
                             "by Blender or gltfpack",
                             number);
    if (accessor->view == GLTF_NONE && accessor->count > source->bytes)
        return fmt_gltf_fail(item,
                             "accessors[%" PRIu32 "] has %" PRIu64
                             " elements without data, which are too many",
                             number, accessor->count);
    return 0;
}

/* Reads the accessors of a primitive of triangles. */
static int read_accessors(const struct gltf_item *item, struct gltf_source *source,
                          const json_t *object, struct gltf_primitive *out)
{
    const uint32_t set = out->material == GLTF_NONE ? 0 : source->materials[out->material].texcoord;
    const json_t *attributes = json_object_get(object, "attributes");
    char texcoord[32];
    const char *const keys[GLTF_USE_COUNT] = {"POSITION", "NORMAL", texcoord, "COLOR_0", NULL};
    snprintf(texcoord, sizeof texcoord, "TEXCOORD_%" PRIu32, set);
    for (int use = 0; use < GLTF_INDEX; use++)
        BSQ_PASS(read_attribute(item, source, attributes, keys[use], (enum gltf_use)use, out));
    BSQ_PASS(read_indices(item, source, object, out));
    BSQ_PASS(fmt_gltf_read_draco(item, source, object, keys, out));
    for (int use = 0; use < GLTF_USE_COUNT; use++)
        if (out->accessors[use] != GLTF_NONE)
            BSQ_PASS(check_used(item, source, out->accessors[use]));
    return 0;
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

/* Returns whether the colour of a primitive's material changes its texture. */
static bool has_texture_factor(const struct gltf_source *source, const struct gltf_primitive *p)
{
    if (p->material == GLTF_NONE || p->accessors[GLTF_TEXCOORD] == GLTF_NONE)
        return false;
    const struct gltf_material *m = &source->materials[p->material];
    return m->described.color.texture_path &&
           (m->color[0] != 1 || m->color[1] != 1 || m->color[2] != 1);
}

/* Reads a primitive. Leaves its `triangles` 0 if it has none that can be read. */
static int read_primitive(const struct gltf_item *item, struct gltf_source *source,
                          const json_t *object, struct gltf_primitive *out)
{
    uint64_t mode = MODE_TRIANGLES;
    BSQ_PASS(fmt_gltf_number(item, object, "mode", 6, &mode));
    out->mode = (uint32_t)mode;
    if (mode < MODE_TRIANGLES) {
        source->unread.points++;
        return 0;
    }
    BSQ_PASS(fmt_gltf_index(item, object, "material", "materials", &out->material));
    BSQ_PASS(read_accessors(item, source, object, out));
    const struct gltf_accessor *positions = gltf_accessor_of(source, out, GLTF_POSITION);
    struct gltf_accessor *colors = gltf_accessor_of(source, out, GLTF_COLOR);
    source->unread.bare += !positions;
    if (!positions)
        return 0;
    count_triangles(source, out);
    if (out->triangles == 0)
        return 0;
    if (positions->count == 0)
        return fmt_gltf_fail(item, "it has triangles, but no vertices");
    if (colors) /* some programs forget to say so */
        colors->normalized = true;
    source->has_tangents |=
        json_object_get(json_object_get(object, "attributes"), "TANGENT") != NULL;
    source->has_colors |= colors || has_texture_factor(source, out);
    source->unread.other_colors += !colors && has_other_colors(object);
    source->unread.variants += fmt_gltf_extension(object, "KHR_materials_variants") != NULL;
    return 0;
}

/* Adds a primitive to its mesh. */
static int add_primitive(const struct gltf_item *item, const struct gltf_source *source,
                         struct gltf_mesh *mesh, struct gltf_primitive *p)
{
    const uint64_t vertices = gltf_accessor_of(source, p, GLTF_POSITION)->count;
    const uint64_t counts[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_VERTEX] = vertices,
        [FMT_MESH_TEXCOORD] = p->accessors[GLTF_TEXCOORD] != GLTF_NONE ? vertices : 0,
        [FMT_MESH_NORMAL] = p->accessors[GLTF_NORMAL] != GLTF_NONE ? vertices : 0};
    BSQ_PASS(add(item, &mesh->triangles, p->triangles));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        p->base[kind] = mesh->total[kind];
        BSQ_PASS(add(item, &mesh->total[kind], counts[kind]));
    }
    mesh->count++;
    return 0;
}

int fmt_gltf_read_mesh(const struct gltf_item *item, struct gltf_source *source, void *element)
{
    struct gltf_mesh *mesh = element;
    const json_t *list = json_object_get(item->object, "primitives");
    mesh->first = source->primitive_count;
    for (size_t i = 0; i < json_array_size(list); i++) {
        struct gltf_primitive *p = &source->primitives[source->primitive_count];
        *p = (struct gltf_primitive){.mesh = (uint32_t)item->index, .number = (uint32_t)i};
        memset(p->accessors, 0xff, sizeof p->accessors);
        BSQ_PASS(i % 1024 ? 0 : bsq_check(item->document->ctx));
        BSQ_PASS(read_primitive(item, source, json_array_get(list, i), p));
        if (p->triangles > 0) {
            BSQ_PASS(add_primitive(item, source, mesh, p));
            source->primitive_count++;
        }
    }
    return 0;
}

/* ---- nodes ---- */

struct visit {
    uint32_t node;
    double matrix[3][4]; /* of its parent */
};

struct walk {
    struct gltf_document *document;
    struct gltf_source *source;
    struct visit *stack;
    uint64_t stack_count, node_count;
    uint8_t *visited; /* for each node */
};

static const double identity[3][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}};

/* ---- transforms ---- */

/* Sets out = a * b. */
static void multiply(const double a[3][4], const double b[3][4], double out[3][4])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 4; k++)
            out[i][k] =
                a[i][0] * b[0][k] + a[i][1] * b[1][k] + a[i][2] * b[2][k] + (k == 3 ? a[i][3] : 0);
}

/* Makes a matrix of translation, rotation (a quaternion x, y, z, w) and scale. */
static void compose(const double t[3], const double rotation[4], const double s[3],
                    double out[3][4])
{
    double q[4], length = 0;
    for (int i = 0; i < 4; i++)
        length += rotation[i] * rotation[i];
    /* Only a quaternion that was rounded to float32 is not of unit length. */
    const double scale = length > 0 && isfinite(length) ? 1 / sqrt(length) : 1;
    for (int i = 0; i < 4; i++)
        q[i] = rotation[i] * scale;
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const double r[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
        {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
        {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)},
    };
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            out[i][k] = r[i][k] * s[k];
        out[i][3] = t[i];
    }
}

static int read_transform(const struct gltf_item *item, double out[3][4])
{
    double matrix[16], t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    BSQ_PASS(fmt_gltf_numbers(item, item->object, "matrix", 16, matrix));
    BSQ_PASS(fmt_gltf_numbers(item, item->object, "translation", 3, t));
    BSQ_PASS(fmt_gltf_numbers(item, item->object, "rotation", 4, q));
    BSQ_PASS(fmt_gltf_numbers(item, item->object, "scale", 3, s));
    compose(t, q, s, out);
    for (int i = 0; i < 12 && json_object_get(item->object, "matrix"); i++)
        out[i / 4][i % 4] = matrix[4 * (i % 4) + i / 4]; /* columns one after the other */
    return 0;
}

/* Sets the matrix of normals of a node's matrix: its inverse transpose, times a positive number.
 * Returns whether the node mirrors. */
static bool invert_for_normals(const double m[3][4], double out[3][3])
{
    double largest = 0;
    for (int i = 0; i < 3; i++) {
        bsq_crossd(m[(i + 1) % 3], m[(i + 2) % 3], out[i]);
        for (int k = 0; k < 3; k++)
            largest = fmax(largest, fabs(out[i][k]));
    }
    const double determinant = bsq_dotd(m[0], out[0]);
    const double scale = largest > 0 ? (determinant < 0 ? -1 : 1) / largest : 1;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            out[i][k] *= scale;
    return determinant < 0;
}

/* Returns whether a matrix changes shapes beyond their size: its columns differ in length, or are
 * not at right angles. Matrices of rounded rotations do not count. */
static bool scales_unevenly(const double m[3][4])
{
    double dots[3][3], largest, across = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            dots[i][k] = m[0][i] * m[0][k] + m[1][i] * m[1][k] + m[2][i] * m[2][k];
    largest = fmax(dots[0][0], fmax(dots[1][1], dots[2][2]));
    for (int i = 0; i < 3; i++) {
        across = fmax(across, fabs(dots[i][(i + 1) % 3]));
        across = fmax(across, largest - dots[i][i]);
    }
    return across > 0.01 * largest;
}

/* ---- placing meshes ---- */

/* Copies the name of an object: that of its node, or else of its mesh. item: the node. */
static int copy_name(const struct gltf_item *item, uint32_t mesh, char **out)
{
    const struct gltf_item mesh_item = fmt_gltf_element(item->document, "meshes", mesh);
    const char *name = fmt_gltf_string(item->object, "name");
    if (!name || !name[0])
        name = fmt_gltf_string(mesh_item.object, "name");
    return bsq_text_copy(item->document->ctx, name ? name : "", out);
}

/* Returns whether morph targets change the shape of a mesh: a weight of the node, or else of the
 * mesh, is not 0. item: the node. */
static bool is_morphed(const struct gltf_item *item, uint32_t mesh)
{
    const json_t *object = fmt_gltf_element(item->document, "meshes", mesh).object;
    const json_t *own = json_object_get(item->object, "weights");
    const json_t *weights = own ? own : json_object_get(object, "weights");
    const json_t *primitives = json_object_get(object, "primitives");
    bool targets = false, weighted = false;
    for (size_t i = 0; i < json_array_size(primitives); i++)
        targets |= json_object_get(json_array_get(primitives, i), "targets") != NULL;
    for (size_t i = 0; i < json_array_size(weights); i++)
        weighted |= json_number_value(json_array_get(weights, i)) != 0;
    return targets && weighted;
}

static int add_placement(struct walk *w, const struct gltf_item *item, uint32_t mesh,
                         const double matrix[3][4])
{
    struct gltf_source *source = w->source;
    const struct gltf_mesh *m = &source->meshes[mesh];
    struct gltf_placement *out = &source->placements[source->placement_count];
    if (m->count == 0)
        return 0;
    source->unread.morphs += is_morphed(item, mesh);
    *out = (struct gltf_placement){.mesh = mesh};
    memcpy(out->matrix, matrix, sizeof out->matrix);
    out->mirrored = invert_for_normals(matrix, out->normal_matrix);
    source->uneven_scale |= scales_unevenly(matrix);
    memcpy(out->base, source->total, sizeof out->base);
    out->object_base = source->object_count;
    source->placement_count++;
    BSQ_PASS(add(item, &source->triangles, m->triangles));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        BSQ_PASS(add(item, &source->total[kind], m->total[kind]));
    BSQ_PASS(add(item, &source->object_count, m->count));
    return copy_name(item, mesh, &out->name);
}

static int place_mesh(struct walk *w, const struct gltf_item *item, const double matrix[3][4])
{
    uint32_t mesh, skin;
    BSQ_PASS(fmt_gltf_index(item, item->object, "mesh", "meshes", &mesh));
    BSQ_PASS(fmt_gltf_index(item, item->object, "skin", "skins", &skin));
    if (mesh == GLTF_NONE)
        return 0;
    w->source->unread.skins += skin != GLTF_NONE;
    w->source->unread.instances +=
        fmt_gltf_extension(item->object, "EXT_mesh_gpu_instancing") != NULL;
    /* A skinned mesh does not move with its node. */
    return add_placement(w, item, mesh, skin != GLTF_NONE ? identity : matrix);
}

/* ---- walking ---- */

/* Puts nodes of a list on the stack, the first one on top. */
static int push_nodes(struct walk *w, const struct gltf_item *item, const json_t *list,
                      const double matrix[3][4])
{
    for (size_t i = json_array_size(list); i-- > 0;) {
        uint64_t node;
        if (w->node_count == 0 ||
            !fmt_gltf_whole(json_array_get(list, i), w->node_count - 1, &node))
            return fmt_gltf_fail(item, "refers to a node that does not exist");
        if (w->visited[node])
            return fmt_gltf_fail(item, "nodes[%" PRIu64 "] occurs twice in the hierarchy", node);
        w->visited[node] = 1;
        struct visit *visit = &w->stack[w->stack_count++];
        visit->node = (uint32_t)node;
        memcpy(visit->matrix, matrix, sizeof visit->matrix);
    }
    return 0;
}

static int visit_nodes(struct walk *w)
{
    for (uint64_t i = 0; w->stack_count > 0; i++) {
        const struct visit visit = w->stack[--w->stack_count];
        const struct gltf_item item = fmt_gltf_element(w->document, "nodes", visit.node);
        double own[3][4], matrix[3][4];
        BSQ_PASS(i % 1024 ? 0 : bsq_check(w->document->ctx));
        BSQ_PASS(read_transform(&item, own));
        w->source->unread.hidden += json_is_false(
            json_object_get(fmt_gltf_extension(item.object, "KHR_node_visibility"), "visible"));
        multiply(visit.matrix, (const double(*)[4])own, matrix);
        BSQ_PASS(place_mesh(w, &item, (const double(*)[4])matrix));
        BSQ_PASS(push_nodes(w, &item, json_object_get(item.object, "children"),
                            (const double(*)[4])matrix));
    }
    return 0;
}

/* Without scenes, every node that is no child of another one is a root. */
static int visit_all_roots(struct walk *w, uint8_t *is_child)
{
    for (uint64_t i = 0; i < w->node_count; i++) {
        const json_t *list =
            json_object_get(fmt_gltf_element(w->document, "nodes", i).object, "children");
        for (size_t k = 0; k < json_array_size(list); k++) {
            uint64_t child;
            if (fmt_gltf_whole(json_array_get(list, k), w->node_count - 1, &child))
                is_child[child] = 1;
        }
    }
    for (uint64_t i = 0; i < w->node_count; i++) {
        if (is_child[i])
            continue;
        w->visited[i] = 1;
        w->stack[0].node = (uint32_t)i;
        memcpy(w->stack[0].matrix, identity, sizeof identity);
        w->stack_count = 1;
        BSQ_PASS(visit_nodes(w));
    }
    return 0;
}

static int visit_scene(struct walk *w)
{
    const struct gltf_item root = {w->document, "scene", 0, w->document->root};
    uint32_t scene;
    BSQ_PASS(fmt_gltf_index(&root, w->document->root, "scene", "scenes", &scene));
    const struct gltf_item item =
        fmt_gltf_element(w->document, "scenes", scene == GLTF_NONE ? 0 : scene);
    BSQ_PASS(push_nodes(w, &item, json_object_get(item.object, "nodes"), identity));
    return visit_nodes(w);
}

/* Counts meshes of nodes that were not visited, and meshes that no node names. */
static void count_outside(struct walk *w)
{
    struct gltf_source *source = w->source;
    for (uint64_t i = 0; i < w->node_count; i++) {
        const json_t *mesh =
            json_object_get(fmt_gltf_element(w->document, "nodes", i).object, "mesh");
        uint64_t number;
        source->unread.outside += !w->visited[i] && mesh != NULL;
        if (mesh && source->mesh_count > 0 && fmt_gltf_whole(mesh, source->mesh_count - 1, &number))
            source->meshes[number].named = true;
    }
    for (uint32_t i = 0; i < source->mesh_count; i++)
        source->unread.unplaced += !source->meshes[i].named && source->meshes[i].triangles > 0;
}

/* A file without nodes is a library of meshes: each is placed once. */
static int place_all(struct walk *w)
{
    for (uint32_t i = 0; i < w->source->mesh_count; i++) {
        const struct gltf_item item = fmt_gltf_element(w->document, "meshes", i);
        BSQ_PASS(add_placement(w, &item, i, identity));
    }
    return 0;
}

int fmt_gltf_read_scene(struct gltf_document *document, struct gltf_source *source)
{
    struct bsq_ctx *ctx = document->ctx;
    struct walk w = {
        .document = document, .source = source, .node_count = fmt_gltf_count(document, "nodes")};
    const uint64_t most = w.node_count > 0 ? w.node_count : source->mesh_count;
    int status;
    BSQ_TRY(BSQ_CALLOC(ctx, "glTF nodes", most + 1, &source->placements));
    BSQ_TRY(BSQ_CALLOC(ctx, "glTF nodes", w.node_count + 1, &w.stack));
    BSQ_TRY(bsq_calloc(ctx, "glTF nodes", w.node_count + 1, 2, &w.visited));
    if (w.node_count == 0)
        BSQ_TRY(place_all(&w));
    else if (fmt_gltf_count(document, "scenes") == 0)
        BSQ_TRY(visit_all_roots(&w, w.visited + w.node_count));
    else
        BSQ_TRY(visit_scene(&w));
    count_outside(&w);
done:
    BSQ_FREE(ctx, w.stack, w.visited);
    return status;
}

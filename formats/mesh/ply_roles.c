/* ply_roles.c - see ply_roles.h. The names are those that scanners and mesh programs write. */
#include "formats/mesh/ply_internal.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

static const struct role_name {
    const char *name;
    enum ply_role role;
} vertex_names[] = {{"x", PLY_X},         {"y", PLY_Y},         {"z", PLY_Z},
                    {"nx", PLY_NX},       {"ny", PLY_NY},       {"nz", PLY_NZ},
                    {"normal_x", PLY_NX}, {"normal_y", PLY_NY}, {"normal_z", PLY_NZ},
                    {"s", PLY_S},         {"t", PLY_T},         {"u", PLY_S},
                    {"v", PLY_T},         {"texture_u", PLY_S}, {"texture_v", PLY_T},
                    {"texture_s", PLY_S}, {"texture_t", PLY_T}},
  color_names[] = {{"red", PLY_RED},           {"green", PLY_GREEN},
                   {"blue", PLY_BLUE},         {"r", PLY_RED},
                   {"g", PLY_GREEN},           {"b", PLY_BLUE},
                   {"diffuse_red", PLY_RED},   {"diffuse_green", PLY_GREEN},
                   {"diffuse_blue", PLY_BLUE}, {"alpha", PLY_ALPHA},
                   {"a", PLY_ALPHA},           {"diffuse_alpha", PLY_ALPHA}},
  face_numbers[] = {{"texnumber", PLY_TEXTURE_NUMBER}},
  index_lists[] = {{"vertex_indices", PLY_INDICES}, {"vertex_index", PLY_INDICES}},
  face_lists[] = {{"texcoord", PLY_CORNER_TEXCOORDS}};

#define COUNT(table) (sizeof(table) / sizeof *(table))

static enum ply_role find_role(const struct role_name *names, size_t count, const char *name)
{
    for (size_t i = 0; i < count; i++)
        if (strcmp(names[i].name, name) == 0)
            return names[i].role;
    return PLY_UNUSED;
}

/* Returns what a property of an element of this kind is for. */
static enum ply_role role_of(enum ply_kind kind, const struct ply_property *p)
{
    bool list = p->count_type != PLY_NO_TYPE;
    enum ply_role role = PLY_UNUSED;
    if (list) {
        if (kind == PLY_FACES || kind == PLY_STRIPS)
            role = find_role(index_lists, COUNT(index_lists), p->name);
        if (role == PLY_UNUSED && kind == PLY_FACES)
            role = find_role(face_lists, COUNT(face_lists), p->name);
        return role;
    }
    if (kind == PLY_VERTICES)
        role = find_role(vertex_names, COUNT(vertex_names), p->name);
    if (kind == PLY_FACES)
        role = find_role(face_numbers, COUNT(face_numbers), p->name);
    if (role == PLY_UNUSED && (kind == PLY_VERTICES || kind == PLY_FACES))
        role = find_role(color_names, COUNT(color_names), p->name);
    return role;
}

static enum ply_kind kind_of(const char *name)
{
    if (strcmp(name, "vertex") == 0)
        return PLY_VERTICES;
    if (strcmp(name, "face") == 0)
        return PLY_FACES;
    return strcmp(name, "tristrips") == 0 ? PLY_STRIPS : PLY_OTHER;
}

/* Takes roles back from groups that are incomplete, such as x and y without z. */
static void drop_group(struct ply_element *element, struct ply_property *properties,
                       enum ply_role first, enum ply_role last)
{
    if (ply_has_roles(element, first, last))
        return;
    for (int role = (int)first; role <= (int)last; role++) {
        if (element->role[role])
            properties[element->role[role] - properties].role = PLY_UNUSED;
        element->role[role] = NULL;
    }
}

static void describe_element(struct ply_header *header, struct ply_element *element)
{
    struct ply_property *properties = header->properties;
    element->kind = kind_of(element->name);
    for (uint32_t i = 0; i < element->property_count; i++) {
        struct ply_property *p = &properties[element->first_property + i];
        bool list = p->count_type != PLY_NO_TYPE;
        p->offset = element->least_bytes;
        element->list_count += list;
        element->least_bytes += fmt_ply_type_bytes[list ? p->count_type : p->type];
        p->role = role_of(element->kind, p);
        if (element->role[p->role] || (p->role == PLY_INDICES && ply_is_real(p->type)) ||
            (p->role == PLY_TEXTURE_NUMBER && ply_is_real(p->type)))
            p->role = PLY_UNUSED;
        if (p->role != PLY_UNUSED)
            element->role[p->role] = p;
    }
    drop_group(element, properties, PLY_X, PLY_Z);
    drop_group(element, properties, PLY_NX, PLY_NZ);
    drop_group(element, properties, PLY_RED, PLY_BLUE);
    drop_group(element, properties, PLY_S, PLY_T);
}

/* ---- checks ---- */

/* Checks that no element that is read comes twice. */
static int check_kinds(struct bsq_ctx *ctx, const char *path, const struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->elements[i];
        if (element->kind != PLY_OTHER && fmt_ply_find_element(header, element->kind) != element)
            return bsq_fail(ctx, BSQ_EDATA, "%s: the header has two elements \"%s\"", path,
                            element->name);
    }
    return 0;
}

static int check_is_mesh(struct bsq_ctx *ctx, const char *path, const struct ply_header *header)
{
    const struct ply_element *vertices = fmt_ply_find_element(header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(header, PLY_FACES);
    const struct ply_element *strips = fmt_ply_find_element(header, PLY_STRIPS);
    const uint64_t face_count = (faces ? faces->count : 0) + (strips ? strips->count : 0);
    if (!vertices || !vertices->role[PLY_X])
        return bsq_fail(ctx, BSQ_EDATA, "%s: the header has no vertices with x, y and z", path);
    if (face_count == 0)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: a point cloud of %" PRIu64 " points without faces; make a mesh of it",
                        path, vertices->count);
    if ((faces && faces->count > 0 && !faces->role[PLY_INDICES]) ||
        (strips && strips->count > 0 && !strips->role[PLY_INDICES]))
        return bsq_fail(ctx, BSQ_EDATA, "%s: faces without a list \"vertex_indices\" of integers",
                        path);
    if (strips && strips->property_count > 1)
        return bsq_fail(ctx, BSQ_EDATA, "%s: strips of triangles with more than one property",
                        path);
    return 0;
}

/* Checks that the file is long enough for all elements, if all their lists were empty. An element
 * of a text file has a line of its own, in which each property takes at least two bytes; the last
 * line may lack its end. */
static int check_size(struct bsq_ctx *ctx, const struct fmt_input *input,
                      const struct ply_header *header)
{
    const uint64_t size = fmt_input_size(input);
    uint64_t left = size - header->bytes + (header->encoding == PLY_ASCII);
    if (size == UINT64_MAX)
        return 0;
    for (uint32_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->elements[i];
        uint64_t each = header->encoding == PLY_ASCII ? 2 * (uint64_t)element->property_count
                                                      : element->least_bytes;
        if (each > 0 && element->count > left / each)
            return bsq_fail(ctx, BSQ_EDATA,
                            "%s: truncated: the header counts %" PRIu64 " elements \"%s\" of at "
                            "least %" PRIu64 " bytes, but %" PRIu64 " bytes are left",
                            fmt_input_path(input), element->count, element->name, each,
                            left - (header->encoding == PLY_ASCII));
        left -= element->count * each;
    }
    return 0;
}

int fmt_ply_find_roles(struct bsq_ctx *ctx, struct fmt_input *input, struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++)
        describe_element(header, &header->elements[i]);
    int status = check_kinds(ctx, fmt_input_path(input), header);
    if (!status)
        status = check_is_mesh(ctx, fmt_input_path(input), header);
    return status ? status : check_size(ctx, input, header);
}

/* ---- what is not read ---- */

/* Appends to a list with commas, as far as it has space. */
static void append(char *list, size_t size, const char *text)
{
    size_t length = strlen(list);
    snprintf(list + length, size - length, "%s%s", length > 0 ? ", " : "", text);
}

static void warn_properties(struct bsq_ctx *ctx, const char *path, const struct ply_header *header,
                            const struct ply_element *element)
{
    char names[160] = "";
    uint32_t count = 0;
    for (uint32_t i = 0; i < element->property_count; i++) {
        const struct ply_property *p = &header->properties[element->first_property + i];
        if (p->role != PLY_UNUSED)
            continue;
        append(names, sizeof names, p->name);
        count++;
    }
    if (count > 0)
        bsq_warn(ctx, "%s: %u %s of \"%s\" not read: %s", path, count,
                 count == 1 ? "property" : "properties", element->name, names);
}

void fmt_ply_warn_unread(struct bsq_ctx *ctx, const char *path, const struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->elements[i];
        if (element->count == 0)
            continue;
        if (element->kind == PLY_OTHER)
            bsq_warn(ctx, "%s: %" PRIu64 " elements \"%s\" not read", path, element->count,
                     element->name);
        else
            warn_properties(ctx, path, header, element);
    }
}

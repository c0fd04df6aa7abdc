/* ply_binary.c - parses parts of binary PLY files.
 *
 * Vertices are converted property by property, in loops over the whole part. Faces are read one by
 * one; there is a loop of its own for runs of triangles without other properties, as most scans
 * have nothing else. */
#include "formats/mesh/ply_internal.h"

/* ---- vertices ---- */

/* Copies one property of `count` vertices of `each` bytes. `type` and `swap` are constants where
 * this is inlined. */
static inline __attribute__((always_inline)) void
copy_property(struct mesh_arrays *a, const uint8_t *from, uint64_t each, uint64_t count,
              const struct ply_property *p, enum ply_type type, bool swap)
{
    const enum ply_role role = p->role;
    const float scale = type == PLY_UINT16 ? 1.0f / 257.0f : 1.0f;
    from += p->offset;
    if (role >= PLY_X && role <= PLY_Z)
        for (uint64_t i = 0; i < count; i++)
            a->positions[i][role - PLY_X] = ply_real(from + i * each, type, swap);
    else if (role >= PLY_NX && role <= PLY_NZ)
        for (uint64_t i = 0; i < count; i++)
            a->normals[i][role - PLY_NX] = (float)ply_real(from + i * each, type, swap);
    else if (role >= PLY_RED && role <= PLY_BLUE)
        for (uint64_t i = 0; i < count; i++)
            a->colors[i][role - PLY_RED] = (float)ply_real(from + i * each, type, swap) * scale;
    else if (role == PLY_S || role == PLY_T)
        for (uint64_t i = 0; i < count; i++)
            a->texcoords[i][role - PLY_S] = ply_real(from + i * each, type, swap);
}

static void read_property(struct mesh_arrays *a, const uint8_t *from, uint64_t each, uint64_t count,
                          const struct ply_property *p, bool swap)
{
    if (p->type == PLY_FLOAT32 && !swap)
        copy_property(a, from, each, count, p, PLY_FLOAT32, false);
    else if (p->type == PLY_FLOAT64 && !swap)
        copy_property(a, from, each, count, p, PLY_FLOAT64, false);
    else if (p->type == PLY_UINT8)
        copy_property(a, from, each, count, p, PLY_UINT8, false);
    else
        copy_property(a, from, each, count, p, p->type, swap);
}

/* Copies positions of three floats in a row, which most scans have. Returns false if they are
 * something else. */
static bool copy_positions(struct mesh_arrays *a, const uint8_t *from,
                           const struct ply_element *element, uint64_t count, bool swap)
{
    const struct ply_property *x = element->role[PLY_X];
    const uint64_t each = element->least_bytes;
    for (int i = 0; i < 3; i++) {
        const struct ply_property *p = element->role[PLY_X + i];
        if (p != x + i || p->type != PLY_FLOAT32 || swap)
            return false;
    }
    from += x->offset;
    for (uint64_t i = 0; i < count; i++) {
        float position[3];
        memcpy(position, from + i * each, sizeof position);
        for (int k = 0; k < 3; k++)
            a->positions[i][k] = (double)position[k];
    }
    return true;
}

/* Parses vertices without lists. */
static void parse_equal_vertices(const struct ply_source *source, const struct ply_element *element,
                                 struct stream_slot *slot, bool swap)
{
    const struct ply_property *p = source->header.properties + element->first_property;
    const uint64_t each = element->least_bytes, count = slot->part.items;
    const bool copied = copy_positions(&slot->arrays, slot->bytes, element, count, swap);
    for (uint32_t i = 0; i < element->property_count; i++)
        if (p[i].role != PLY_UNUSED && !(copied && p[i].role <= PLY_Z))
            read_property(&slot->arrays, slot->bytes, each, count, &p[i], swap);
    fmt_ply_finish_vertices(element, slot, count);
}

/* Returns the position after the property at `from`. A list's numbers begin at *list. */
static const uint8_t *skip_property(const struct ply_property *p, const uint8_t *from, bool swap,
                                    const uint8_t **list, uint64_t *length)
{
    const uint64_t each = fmt_ply_type_bytes[p->type];
    if (p->count_type == PLY_NO_TYPE)
        return from + each;
    *length = (uint64_t)ply_integer(from, p->count_type, swap);
    *list = from + fmt_ply_type_bytes[p->count_type];
    return *list + *length * each;
}

/* Parses vertices with lists, which are skipped. */
static void parse_uneven_vertices(const struct ply_source *source,
                                  const struct ply_element *element, struct stream_slot *slot,
                                  bool swap)
{
    const struct ply_property *p = source->header.properties + element->first_property;
    const uint8_t *from = slot->bytes, *list;
    uint64_t length;
    for (uint64_t vertex = 0; vertex < slot->part.items; vertex++)
        for (uint32_t i = 0; i < element->property_count; i++) {
            if (p[i].role != PLY_UNUSED)
                fmt_ply_store_vertex(&slot->arrays, vertex, &p[i], ply_real(from, p[i].type, swap));
            from = skip_property(&p[i], from, swap, &list, &length);
        }
    fmt_ply_finish_vertices(element, slot, slot->part.items);
}

/* ---- faces ---- */

/* Reads one property of a face at `from`. Returns the position after it, or NULL if an index is
 * wrong. */
static const uint8_t *read_face_property(struct stream_slot *slot, struct ply_face *face,
                                         const struct ply_property *p, const uint8_t *from,
                                         bool swap)
{
    const uint64_t each = fmt_ply_type_bytes[p->type];
    const uint8_t *list = from;
    uint64_t length = 0;
    const uint8_t *end = skip_property(p, from, swap, &list, &length);
    if (p->role == PLY_INDICES) {
        for (uint64_t i = 0; i < length; i++)
            if (!fmt_ply_add_index(slot, face, ply_integer(list + i * each, p->type, swap)))
                return NULL;
    } else if (p->role == PLY_CORNER_TEXCOORDS) {
        face->texcoords = length;
        for (uint64_t i = 0; i < length; i++)
            fmt_ply_add_texcoord(slot, i, ply_real(list + i * each, p->type, swap));
    } else if (p->role != PLY_UNUSED) {
        fmt_ply_set_material(face, p, ply_real(from, p->type, swap));
    }
    return end;
}

/* Reads triangles of 32-bit indices from `from` on, as long as there is nothing else. Returns the
 * position after them; *items counts down. Returns NULL if an index is negative or beyond 2^31. */
static const uint8_t *read_triangles(struct stream_slot *slot, const uint8_t *from, uint64_t *items)
{
    struct mesh_arrays *a = &slot->arrays;
    uint64_t *corners = a->corners[FMT_MESH_VERTEX] + a->corner_count;
    uint32_t *sizes = a->face_sizes + a->face_count, all = 0;
    const uint64_t most = *items;
    uint64_t count = 0;
    for (; count < most && from[13 * count] == 3; count++) {
        uint32_t v[3];
        memcpy(v, from + 13 * count + 1, sizeof v);
        for (int k = 0; k < 3; k++) {
            corners[3 * count + (uint64_t)k] = v[k];
            all |= v[k];
        }
    }
    if (all >> 31)
        return NULL;
    for (uint64_t i = 0; i < count; i++)
        sizes[i] = 3;
    a->face_count += count;
    a->corner_count += 3 * count;
    *items -= count;
    return from + 13 * count;
}

/* Returns whether faces are nothing but a list that read_triangles() understands. */
static bool are_plain(const struct ply_source *source, const struct ply_element *element,
                      const struct stream_slot *slot)
{
    const struct ply_property *p = element->role[PLY_INDICES];
    return element->property_count == 1 && fmt_ply_type_bytes[p->count_type] == 1 &&
           fmt_ply_type_bytes[p->type] == 4 && source->header.encoding == PLY_LITTLE_ENDIAN &&
           source->tags == PLY_TAGS_NONE && slot->last_face == UINT64_MAX;
}

static void parse_faces(const struct ply_source *source, const struct ply_element *element,
                        struct stream_slot *slot, bool swap)
{
    const struct ply_property *p = source->header.properties + element->first_property;
    bool plain = are_plain(source, element, slot);
    const uint8_t *from = slot->bytes;
    for (uint64_t left = slot->part.items; left > 0; left--) {
        const uint8_t *end = plain ? read_triangles(slot, from, &left) : NULL;
        plain = end != NULL;
        from = plain ? end : from;
        if (left == 0)
            return;
        struct ply_face face = ply_face_at(slot->part.offset + (uint64_t)(from - slot->bytes));
        for (uint32_t i = 0; from && i < element->property_count; i++)
            from = read_face_property(slot, &face, &p[i], from, swap);
        if (!from || !fmt_ply_finish_face(source, slot, &face))
            return;
    }
}

/* ---- strips ---- */

/* Adds `length` indices at `list` to a strip. Returns false if parsing must stop. */
static bool add_indices(const struct ply_source *source, struct stream_slot *slot,
                        struct ply_strip *strip, const struct ply_property *p, const uint8_t *list,
                        uint64_t length, bool swap)
{
    const uint64_t each = fmt_ply_type_bytes[p->type];
    const uint64_t at = slot->part.offset + (uint64_t)(list - slot->bytes);
    for (uint64_t i = 0; i < length; i++)
        if (!fmt_ply_add_to_strip(source, slot, strip, ply_integer(list + i * each, p->type, swap),
                                  at + i * each))
            return false;
    return true;
}

static void parse_strips(const struct ply_source *source, const struct ply_element *element,
                         struct stream_slot *slot, bool swap)
{
    const struct ply_property *p = element->role[PLY_INDICES];
    const uint8_t *from = slot->bytes, *list = from;
    uint64_t length = 0;
    bool more = true;
    for (uint64_t i = 0; i < slot->part.items && more; i++) {
        struct ply_strip strip = {0};
        from = skip_property(p, from, swap, &list, &length);
        more = add_indices(source, slot, &strip, p, list, length, swap);
    }
}

static void parse_piece(const struct ply_source *source, const struct ply_element *element,
                        struct stream_slot *slot, bool swap)
{
    const struct ply_property *p = element->role[PLY_INDICES];
    const uint64_t each = fmt_ply_type_bytes[p->type];
    struct ply_strip strip = {.run = slot->part.carry};
    const uint64_t repeated = strip.run < 2 ? strip.run : 2;
    for (uint64_t i = 0; i < repeated; i++)
        strip.last[2 - repeated + i] = (uint64_t)ply_integer(slot->bytes + i * each, p->type, swap);
    add_indices(source, slot, &strip, p, slot->bytes + repeated * each,
                slot->part.size / each - repeated, swap);
}

/* Returns more than the lists of the part can have numbers. */
static uint64_t most_items(const struct ply_element *element, const struct stream_slot *slot)
{
    static const enum ply_role lists[] = {PLY_INDICES, PLY_CORNER_TEXCOORDS};
    uint64_t least = 8;
    for (int i = 0; i < 2; i++) {
        const struct ply_property *p = element->role[lists[i]];
        if (p && fmt_ply_type_bytes[p->type] < least)
            least = fmt_ply_type_bytes[p->type];
    }
    return slot->part.size / least + 1;
}

int fmt_ply_parse_binary(const struct ply_element *element, struct stream_slot *slot)
{
    const struct ply_source *source = slot->source->data;
    const bool swap = source->header.encoding == PLY_BIG_ENDIAN;
    int status = fmt_ply_reserve(element, slot, most_items(element, slot));
    if (status)
        return status;
    if (element->kind == PLY_VERTICES && element->list_count == 0)
        parse_equal_vertices(source, element, slot, swap);
    else if (element->kind == PLY_VERTICES)
        parse_uneven_vertices(source, element, slot, swap);
    else if (element->kind == PLY_FACES)
        parse_faces(source, element, slot, swap);
    else if (slot->part.kind & PLY_PART_PIECE)
        parse_piece(source, element, slot, swap);
    else
        parse_strips(source, element, slot, swap);
    return 0;
}

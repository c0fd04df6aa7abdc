/* triangle_record.c - see triangle_record.h. */
#include "libvoxel/partition/triangle_record.h"

static void layout_values(struct record_layout *layout, const struct scan *scan)
{
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++) {
        layout->value_at[i] = layout->corner_bytes;
        layout->corner_bytes += scan_keeps(scan, i) ? scan->columns[i].element_bytes : 0;
    }
}

static void layout_indices(struct record_layout *layout, const struct scan *scan)
{
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++) {
        /* The largest number of this width must stay free, it stands for "none". */
        uint64_t count = scan_count(scan, scan_column_of(kind))
                         << (kind == FACE_VERTEX && layout->fans);
        uint32_t width = record_index_width(count, scan->limits->index_bytes);
        layout->index_bytes[kind] = scan_keeps(scan, scan_column_of(kind)) ? width : 0;
        layout->index_at[kind] = layout->corner_bytes;
        layout->corner_bytes += layout->index_bytes[kind];
    }
}

bool vox_record_columns_spilled(const struct scan *scan)
{
    bool spilled = false;
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++)
        spilled |= scan->columns[i].spool.spilled && scan_keeps(scan, i);
    return spilled;
}

void vox_record_layout_for(const struct scan *scan, bool by_value, struct record_layout *layout)
{
    *layout = (struct record_layout){.by_value = by_value,
                                     .windowed = !by_value && vox_record_columns_spilled(scan)};
    layout->fans =
        !by_value && scan->columns[SCAN_POSITIONS].spool.spilled && scan->faces.max_size > 3;
    if (layout->by_value)
        layout_values(layout, scan);
    else
        layout_indices(layout, scan);
    if (scan->material_count > 0)
        layout->material_bytes = record_index_width(scan->material_count, 1);
    layout->bytes = 3 * layout->corner_bytes + layout->material_bytes;
    layout->plain = !layout->by_value && scan->attributes == 0 &&
                    layout->index_bytes[FACE_VERTEX] == 4 && layout->bytes == 12;
}

static void vertex_by_value(const struct record_layout *layout, uint32_t attributes,
                            const uint8_t *corner, struct vertex *out)
{
    memcpy(out->position, corner, 12);
    if (attributes & FMT_TRIS_COLORS)
        memcpy(&out->color, corner + layout->value_at[SCAN_COLORS], 4);
    if (attributes & FMT_TRIS_TEXCOORDS)
        memcpy(out->texcoord, corner + layout->value_at[SCAN_TEXCOORDS], 8);
    if (attributes & FMT_TRIS_NORMALS)
        memcpy(&out->normal, corner + layout->value_at[SCAN_NORMALS], 4);
}

static void vertex_by_index(const struct record_layout *layout, const struct scan *scan,
                            const uint8_t *corner, struct vertex *out)
{
    const struct column *columns = scan->columns;
    uint64_t v = record_vertex_index(layout, corner);
    memcpy(out->position, column_at(&columns[SCAN_POSITIONS], v, 12), 12);
    if (scan->attributes & FMT_TRIS_COLORS)
        memcpy(&out->color, column_at(&columns[SCAN_COLORS], v, 4), 4);
    if (scan->attributes & FMT_TRIS_TEXCOORDS) {
        uint64_t t = record_load(corner + layout->index_at[FACE_TEXCOORD],
                                 layout->index_bytes[FACE_TEXCOORD]);
        if (t < scan_count(scan, SCAN_TEXCOORDS))
            memcpy(out->texcoord, column_at(&columns[SCAN_TEXCOORDS], t, 8), 8);
    }
    if (scan->attributes & FMT_TRIS_NORMALS) {
        uint64_t n =
            record_load(corner + layout->index_at[FACE_NORMAL], layout->index_bytes[FACE_NORMAL]);
        out->normal = SCAN_NO_NORMAL;
        if (n < scan_count(scan, SCAN_NORMALS))
            memcpy(&out->normal, column_at(&columns[SCAN_NORMALS], n, 4), 4);
    }
}

void vox_record_vertex(const struct record_layout *layout, const struct scan *scan,
                       const uint8_t *corner, struct vertex *out)
{
    memset(out, 0, sizeof *out);
    if (layout->by_value)
        vertex_by_value(layout, scan->attributes, corner, out);
    else
        vertex_by_index(layout, scan, corner, out);
}

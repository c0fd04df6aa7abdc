/* triangle_record.c - see triangle_record.h. */
#include "libvoxel/partition/triangle_record.h"

static void add_indices(struct record_layout *layout, const struct scan *scan)
{
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        /* The largest number of this width is reserved: it means "none". */
        uint64_t count = scan_count(scan, scan_stream_of(kind))
                         << (kind == FMT_MESH_VERTEX && layout->fans);
        uint32_t width = record_index_width(count, scan->limits->index_bytes);
        layout->index_bytes[kind] = scan_keeps(scan, scan_stream_of(kind)) ? width : 0;
        layout->index_at[kind] = layout->corner_bytes;
        layout->corner_bytes += layout->index_bytes[kind];
    }
}

static bool streams_spilled(const struct scan *scan)
{
    bool spilled = false;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        spilled |= scan->streams[i].spill.spilled && scan_keeps(scan, i);
    return spilled;
}

void vox_record_layout_for(const struct scan *scan, struct record_layout *layout)
{
    *layout = (struct record_layout){.gathered = streams_spilled(scan),
                                     .fans = scan->streams[SCAN_POSITIONS].spill.spilled &&
                                             scan->max_face_size > 3};
    add_indices(layout, scan);
    if (scan->material_count > 0)
        layout->material_bytes = record_index_width(scan->material_count, 1);
    layout->bytes = 3 * layout->corner_bytes + layout->material_bytes;
    layout->plain =
        scan->attributes == 0 && layout->index_bytes[FMT_MESH_VERTEX] == 4 && layout->bytes == 12;
}

void vox_record_vertex(const struct record_layout *layout, const struct scan *scan,
                       const uint8_t *corner, struct vertex *out)
{
    const struct attribute_stream *streams = scan->streams;
    uint64_t v = record_vertex_index(layout, corner);
    memset(out, 0, sizeof *out);
    memcpy(out->position, stream_at(&streams[SCAN_POSITIONS], v, 12), 12);
    if (scan->attributes & FMT_TRIS_COLORS)
        memcpy(&out->color, stream_at(&streams[SCAN_COLORS], v, 4), 4);
    if (scan->attributes & FMT_TRIS_TEXCOORDS) {
        uint64_t t = record_load(corner + layout->index_at[FMT_MESH_TEXCOORD],
                                 layout->index_bytes[FMT_MESH_TEXCOORD]);
        if (t < scan_count(scan, SCAN_TEXCOORDS))
            memcpy(out->texcoord, stream_at(&streams[SCAN_TEXCOORDS], t, 8), 8);
    }
    if (scan->attributes & FMT_TRIS_NORMALS) {
        uint64_t n = record_load(corner + layout->index_at[FMT_MESH_NORMAL],
                                 layout->index_bytes[FMT_MESH_NORMAL]);
        out->normal = SCAN_NO_NORMAL;
        if (n < scan_count(scan, SCAN_NORMALS))
            memcpy(&out->normal, stream_at(&streams[SCAN_NORMALS], n, 4), 4);
    }
}

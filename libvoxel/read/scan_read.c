/* scan_read.c - parsed blocks into columns and faces.
 *
 * This runs in the reader's serial step while other blocks are parsed, so it only converts and
 * appends. When memory runs short the faces go to a file first, as they are only read in sequence;
 * columns follow when they exceed their own share. */
#include "libvoxel/read/scan.h"
#include "libvoxel/float_precision.h"
#include "base/octahedral.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Of colours from 0 to 1. */
static const float largest_of_one = 2.0f;

void vox_scan_init(struct scan *scan, struct bsq_ctx *ctx, const struct sort_limits *limits,
                   const char *const *scan_paths, const char *tris_path)
{
    memset(scan, 0, sizeof *scan);
    scan->ctx = ctx;
    scan->limits = limits;
    scan->paths = scan_paths;
    const uint32_t shift = limits->column_shift;
    column_init(&scan->columns[SCAN_POSITIONS], ctx, "vertices", tris_path, 12, shift);
    column_init(&scan->columns[SCAN_COLORS], ctx, "colours", tris_path, 4, shift);
    column_init(&scan->columns[SCAN_TEXCOORDS], ctx, "texture coordinates", tris_path, 8, shift);
    column_init(&scan->columns[SCAN_NORMALS], ctx, "normals", tris_path, 4, shift);
    vox_face_store_init(&scan->faces, ctx, tris_path);
}

void vox_scan_free(struct scan *scan)
{
    if (!scan->ctx)
        return;
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++)
        vox_spill_free(&scan->columns[i].spool);
    vox_face_store_free(&scan->faces);
    for (uint32_t i = 0; i < scan->material_count; i++)
        bsq_free(scan->ctx, scan->materials[i].texture_path);
    bsq_free(scan->ctx, scan->materials);
    bsq_free(scan->ctx, scan->material_map);
    memset(scan, 0, sizeof *scan);
}

/* ---- memory ---- */

static uint64_t column_memory(const struct scan *scan)
{
    uint64_t bytes = 0;
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++)
        bytes += vox_spill_memory(&scan->columns[i].spool);
    return bytes;
}

static bool stores_fit(const struct scan *scan, uint64_t more)
{
    uint64_t bytes = column_memory(scan) + vox_spill_memory(&scan->faces.bytes);
    return bytes + more <= scan->limits->store_bytes;
}

/* Room for at least one element at the end of a column. */
static int column_room(struct scan *scan, enum scan_column number, void *at, uint64_t *room)
{
    struct column *column = &scan->columns[number];
    uint64_t cost = vox_spill_room_cost(&column->spool);
    int status = 0;
    if (cost > 0 && !stores_fit(scan, cost))
        status = vox_spill_spill(&scan->faces.bytes);
    if (status == 0 && cost > 0 && !column->spool.spilled &&
        (!stores_fit(scan, cost) || column_memory(scan) + cost > scan->limits->column_bytes))
        status = vox_spill_spill(&column->spool);
    if (status < 0)
        return status;
    uint8_t *bytes;
    status = vox_spill_room(&column->spool, &bytes, room);
    *room /= column->element_bytes;
    memcpy(at, &bytes, sizeof bytes);
    return status;
}

static void column_advance(struct scan *scan, enum scan_column number, uint64_t elements)
{
    struct column *column = &scan->columns[number];
    vox_spill_advance(&column->spool, elements * column->element_bytes);
}

/* ---- positions ---- */

/* A scan far from zero in relation to its size would lose detail as float32. The first block stands
 * for the scan, so that one pass is enough. */
static void choose_origin(struct scan *scan, const struct fmt_mesh_block *block)
{
    double low[3], high[3];
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = high[axis] = block->positions[0][axis];
        for (uint64_t v = 1; v < block->vertex_count; v++) {
            low[axis] = fmin(low[axis], block->positions[v][axis]);
            high[axis] = fmax(high[axis], block->positions[v][axis]);
        }
    }
    vox_precision_choose_origin(low, high, scan->origin);
    for (int axis = 0; axis < 3; axis++) {
        scan->bounds_min[axis] = FLT_MAX;
        scan->bounds_max[axis] = -FLT_MAX;
    }
    scan->origin_known = true;
}

static int fail_vertex(const struct scan *scan, const struct fmt_mesh_block *block)
{
    for (uint64_t v = 0; v < block->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            double p = block->positions[v][axis];
            if (!(fabs(p - scan->origin[axis]) <= FLT_MAX))
                return bsq_fail(
                    scan->ctx, BSQ_EDATA, "%s: vertex %llu of the scan: coordinate %g is too large",
                    scan->paths[block->file], (unsigned long long)(block->vertex_base + v + 1), p);
        }
    return BSQ_EBUG;
}

static int add_positions(struct scan *scan, const struct fmt_mesh_block *block)
{
    const double o[3] = {scan->origin[0], scan->origin[1], scan->origin[2]};
    float low[3], high[3], poison = 0.0f;
    memcpy(low, scan->bounds_min, sizeof low);
    memcpy(high, scan->bounds_max, sizeof high);
    for (uint64_t done = 0; done < block->vertex_count;) {
        float(*to)[3];
        uint64_t room;
        int status = column_room(scan, SCAN_POSITIONS, &to, &room);
        if (status < 0)
            return status;
        uint64_t count = block->vertex_count - done < room ? block->vertex_count - done : room;
        const double(*from)[3] = block->positions + done;
        for (uint64_t v = 0; v < count; v++)
            for (int axis = 0; axis < 3; axis++) {
                /* + 0 makes a negative zero positive, so that equal positions have equal bits. */
                float p = (float)(from[v][axis] - o[axis]) + 0.0f;
                poison += p * 0.0f;
                low[axis] = p < low[axis] ? p : low[axis];
                high[axis] = p > high[axis] ? p : high[axis];
                to[v][axis] = p;
            }
        column_advance(scan, SCAN_POSITIONS, count);
        done += count;
    }
    memcpy(scan->bounds_min, low, sizeof low);
    memcpy(scan->bounds_max, high, sizeof high);
    scan->merged_vertices += vox_precision_count_merged(block->positions, block->vertex_count, o);
    return poison == 0.0f ? 0 : fail_vertex(scan, block);
}

/* ---- attributes ---- */

static bool color_given(const float color[3])
{
    return color[0] != -1.0f || color[1] != -1.0f || color[2] != -1.0f;
}

/* Of 0..1 or of 0..255, as the first colours say. Light that a tool left a little above 1 must not
 * turn the scan black; of bytes, the largest of thousands is hardly ever that small. */
static void choose_color_scale(struct scan *scan, const struct fmt_mesh_block *block)
{
    float max = 0.0f;
    for (uint64_t v = 0; v < block->vertex_count; v++)
        for (int i = 0; i < 3; i++)
            max = fmaxf(max, block->colors[v][i]);
    scan->color_scale = max > largest_of_one ? 1.0f : 255.0f;
    scan->has_colors = true;
}

static uint32_t pack_color(struct scan *scan, const float color[3])
{
    uint32_t packed = 0xff000000u;
    bool clamped = false;
    if (!color_given(color))
        return SCAN_DEFAULT_COLOR;
    for (int i = 0; i < 3; i++) {
        float value = color[i] * scan->color_scale;
        clamped |= value < 0.0f || value > 255.0f;
        value = fminf(fmaxf(value, 0.0f), 255.0f);
        packed |= (uint32_t)(value + 0.5f) << 8 * i;
    }
    scan->clamped_colors += clamped;
    return packed;
}

/* Appends colours of the block, or defaults where it has none, until there are as many as `end`. */
static int add_colors(struct scan *scan, const struct fmt_mesh_block *block, uint64_t end)
{
    uint64_t begin = scan_count(scan, SCAN_COLORS);
    while (begin < end) {
        uint32_t *to;
        uint64_t room;
        int status = column_room(scan, SCAN_COLORS, &to, &room);
        if (status < 0)
            return status;
        uint64_t count = end - begin < room ? end - begin : room;
        for (uint64_t i = 0; i < count; i++) {
            bool known = block->colors && begin + i >= block->vertex_base;
            to[i] = known ? pack_color(scan, block->colors[begin + i - block->vertex_base])
                          : SCAN_DEFAULT_COLOR;
        }
        column_advance(scan, SCAN_COLORS, count);
        begin += count;
    }
    return 0;
}

static int add_texcoords(struct scan *scan, const struct fmt_mesh_block *block)
{
    for (uint64_t done = 0; done < block->texcoord_count;) {
        float(*to)[2];
        uint64_t room;
        int status = column_room(scan, SCAN_TEXCOORDS, &to, &room);
        if (status < 0)
            return status;
        uint64_t left = block->texcoord_count - done, count = left < room ? left : room;
        for (uint64_t i = 0; i < count; i++)
            for (int k = 0; k < 2; k++) {
                double value = block->texcoords[done + i][k];
                to[i][k] = (float)fmin(fmax(value, -FLT_MAX), FLT_MAX) + 0.0f;
            }
        column_advance(scan, SCAN_TEXCOORDS, count);
        done += count;
    }
    return 0;
}

static uint32_t pack_normal(const float n[3])
{
    /* Scaled by its largest component first, so that no length over- or underflows. */
    float largest = fmaxf(fabsf(n[0]), fmaxf(fabsf(n[1]), fabsf(n[2])));
    if (!(largest > 0.0f) || !isfinite(largest))
        return SCAN_NO_NORMAL;
    struct bsq_vec3 v = bsq_v3(n[0] / largest, n[1] / largest, n[2] / largest);
    return bsq_oct_pack(bsq_unit3(v));
}

static int add_normals(struct scan *scan, const struct fmt_mesh_block *block)
{
    for (uint64_t done = 0; done < block->normal_count;) {
        uint32_t *to;
        uint64_t room;
        int status = column_room(scan, SCAN_NORMALS, &to, &room);
        if (status < 0)
            return status;
        uint64_t left = block->normal_count - done, count = left < room ? left : room;
        for (uint64_t i = 0; i < count; i++)
            to[i] = pack_normal(block->normals[done + i]);
        column_advance(scan, SCAN_NORMALS, count);
        done += count;
    }
    return 0;
}

/* ---- blocks ---- */

static int add_vertices(struct scan *scan, const struct fmt_mesh_block *block)
{
    if (!scan->origin_known)
        choose_origin(scan, block);
    if (block->colors && !scan->has_colors)
        choose_color_scale(scan, block);
    int status = add_positions(scan, block);
    if (status == 0 && scan->has_colors)
        status = add_colors(scan, block, scan_count(scan, SCAN_POSITIONS));
    return status;
}

int vox_scan_add_faces(struct scan *scan, const struct fmt_mesh_block *block)
{
    int status = 0;
    if (!scan->faces.bytes.spilled &&
        !stores_fit(scan, vox_face_store_append_cost(&scan->faces, block)))
        status = vox_spill_spill(&scan->faces.bytes);
    if (status == 0)
        status = vox_face_store_append(&scan->faces, block);
    return status;
}

int vox_scan_add_elements(struct scan *scan, const struct fmt_mesh_block *block)
{
    int status = 0;
    if (block->vertex_count > 0)
        status = add_vertices(scan, block);
    if (status == 0 && block->texcoord_count > 0)
        status = add_texcoords(scan, block);
    if (status == 0 && block->normal_count > 0)
        status = add_normals(scan, block);
    return status;
}

void vox_scan_touch_ahead(struct scan *scan)
{
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++)
        vox_spill_touch_ahead(&scan->columns[i].spool);
}

int vox_scan_add_block(void *arg, const struct fmt_mesh_block *block)
{
    struct scan *scan = arg;
    int status = bsq_check(scan->ctx);
    if (status == 0)
        status = vox_scan_add_elements(scan, block);
    if (status == 0 && block->face_count > 0)
        status = vox_scan_add_faces(scan, block);
    bsq_progress_add(scan->ctx, block->byte_size);
    return status;
}

/* ---- the end ---- */

/* Describes the first index of the group that is not below its limit. */
static int fail_group(struct scan *scan, struct fmt_mesh_reader *reader, uint64_t number,
                      const uint64_t limits[FACE_KIND_COUNT])
{
    void *room;
    struct face_group group;
    int status = bsq_alloc(scan->ctx, "faces", vox_face_store_decode_bytes(&scan->faces), 1, &room);
    if (status == 0)
        status = vox_face_store_decode(&scan->faces, number, room, &group);
    uint32_t corner = 0;
    for (uint32_t f = 0; status == 0 && f < group.face_count; f++) {
        uint32_t end = corner + (group.sizes ? group.sizes[f] : 3);
        for (; status == 0 && corner < end; corner++)
            for (int kind = 0; status == 0 && kind < FACE_KIND_COUNT; kind++) {
                if (!group.indices[kind])
                    continue;
                uint64_t index = group.indices[kind][corner];
                if (index != FMT_MESH_NONE && index >= limits[kind])
                    status = fmt_mesh_fail_index(reader, group.first_face + f,
                                                 (enum fmt_mesh_kind)kind, index);
            }
    }
    bsq_free(scan->ctx, room);
    return status < 0 ? status : BSQ_EBUG;
}

static int check_indices(struct scan *scan, struct fmt_mesh_reader *reader)
{
    const uint64_t limits[FACE_KIND_COUNT] = {scan_count(scan, SCAN_POSITIONS),
                                              scan_count(scan, SCAN_TEXCOORDS),
                                              scan_count(scan, SCAN_NORMALS)};
    for (uint64_t g = 0; g < scan->faces.group_count; g++)
        for (int kind = 0; kind < FACE_KIND_COUNT; kind++) {
            const struct face_group_info *info = &scan->faces.groups[g];
            if (info->has_index[kind] && info->max[kind] >= limits[kind])
                return fail_group(scan, reader, g, limits);
            scan->has_normals |= kind == FACE_NORMAL && info->has_index[kind];
        }
    return 0;
}

int vox_scan_finish_columns(struct scan *scan)
{
    int status = 0;
    for (int i = 0; status == 0 && i < SCAN_COLUMN_COUNT; i++)
        status = vox_spill_finish(&scan->columns[i].spool);
    return status;
}

int vox_scan_finish(struct scan *scan, struct fmt_mesh_reader *reader)
{
    int status = vox_face_store_finish(&scan->faces);
    if (status == 0)
        status = vox_scan_finish_columns(scan);
    if (status < 0)
        return status;
    if (scan->clamped_colors > 0)
        bsq_warn(scan->ctx, "%s: colours out of range were clamped at %llu %s", scan->paths[0],
                 (unsigned long long)scan->clamped_colors,
                 scan->clamped_colors == 1 ? "vertex" : "vertices");
    if (scan->totals.unread_colors && !scan->has_colors)
        bsq_warn(scan->ctx, "%s: %s", scan->paths[0], scan->totals.unread_colors);
    vox_precision_warn_merged(scan->ctx, scan->paths[0], scan->merged_vertices, scan->bounds_min,
                              scan->bounds_max);
    if (scan->faces.face_count == 0)
        return bsq_fail(scan->ctx, BSQ_EDATA, "%s: no faces", scan->paths[0]);
    return check_indices(scan, reader);
}

/* scan_read.c - appends parsed batches to attribute streams, and scales their colours.
 *
 * This runs in the reader's serial step, while workers parse other batches. So it only converts and
 * appends. */
#include "libvoxel/read/scan.h"
#include "libvoxel/float_precision.h"
#include "base/context.h"
#include "base/geometry/vec.h"

#include <float.h>
#include <math.h>
#include <string.h>

int vox_scan_init(struct scan *scan, struct bsq_ctx *ctx, const struct sort_limits *limits,
                  const char *const *scan_paths, uint32_t path_count, const char *tris_path)
{
    memset(scan, 0, sizeof *scan);
    scan->ctx = ctx;
    scan->limits = limits;
    scan->paths = scan_paths;
    scan->path_count = path_count;
    static const struct {
        const char *what;
        uint32_t element_bytes;
    } streams[SCAN_STREAM_COUNT] = {[SCAN_POSITIONS] = {"vertices", 12},
                                    [SCAN_COLORS] = {"colours", 4},
                                    [SCAN_FINE_COLORS] = {"fine colours", 4},
                                    [SCAN_TEXCOORDS] = {"texture coordinates", 8},
                                    [SCAN_NORMALS] = {"normals", 4}};
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        BSQ_PASS(vox_stream_init(&scan->streams[i], ctx, streams[i].what, tris_path,
                                 streams[i].element_bytes, limits->stream_shift));
    return BSQ_CALLOC(ctx, "files of a scan", path_count, &scan->files);
}

void vox_scan_free(struct scan *scan)
{
    if (!scan->ctx)
        return;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        vox_stream_free(&scan->streams[i]);
    for (uint32_t i = 0; i < scan->material_count; i++) {
        BSQ_FREE(scan->ctx, scan->materials[i].texture_path, scan->materials[i].name);
        for (uint32_t c = 0; scan->materials[i].sources && c < scan->channel_count; c++)
            bsq_free(scan->ctx, scan->materials[i].sources[c].texture_path);
        bsq_free(scan->ctx, scan->materials[i].sources);
    }
    BSQ_FREE(scan->ctx, scan->materials, scan->found_channels, scan->found_optional,
             scan->material_map, scan->material_uses, scan->files);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        bsq_free(scan->ctx, scan->missing[kind].bits);
    bsq_free(scan->ctx, scan->missing_colors.bits);
    memset(scan, 0, sizeof *scan);
}

/* ---- memory ---- */

uint64_t vox_scan_missing_memory(const struct scan *scan)
{
    uint64_t words = scan->missing_colors.capacity;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        words += scan->missing[kind].capacity;
    return words * sizeof(uint64_t);
}

uint64_t vox_scan_stream_memory(const struct scan *scan)
{
    uint64_t bytes = 0;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        bytes += stream_memory(&scan->streams[i]);
    return bytes;
}

/* Finds space for at least one element at the end of a stream, which moves to a file if all streams
 * together exceed their limit. *at: the elements. */
static int reserve(struct scan *scan, struct attribute_stream *stream, uint8_t **at,
                   uint64_t *capacity)
{
    const uint64_t cost = stream_reserve_cost(stream);
    if (cost > 0 && !bsq_spill_in_file(&stream->spill) &&
        vox_scan_stream_memory(scan) + cost > scan->limits->stream_bytes)
        BSQ_PASS(vox_stream_evict(stream));
    return vox_stream_reserve(stream, at, capacity);
}

/* Makes elements [first, first + count) of a stream at `to` from those of a batch. The numbers
 * count over the scan. */
typedef int converter(struct scan *scan, const struct fmt_mesh_batch *batch, uint64_t first,
                      uint64_t count, void *to);

/* Appends to a stream until it has `end` elements. */
static int append(struct scan *scan, const struct fmt_mesh_batch *batch, enum scan_stream number,
                  uint64_t end, converter *convert)
{
    struct attribute_stream *stream = &scan->streams[number];
    uint64_t capacity, count;
    uint8_t *to;
    for (uint64_t first = stream->count; first < end; first += count) {
        BSQ_PASS(reserve(scan, stream, &to, &capacity));
        count = end - first < capacity ? end - first : capacity;
        BSQ_PASS(convert(scan, batch, first, count, to));
        BSQ_PASS(vox_stream_advance(stream, count));
    }
    return 0;
}

/* ---- positions ---- */

/* Chooses the origin from the first batch with positions, so that one pass is enough. float32
 * positions would lose detail if a scan is far from zero for its size. */
static void choose_origin(struct scan *scan, const struct fmt_mesh_batch *batch)
{
    double low[3], high[3];
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = high[axis] = batch->positions[0][axis];
        for (uint64_t v = 1; v < batch->vertex_count; v++) {
            low[axis] = fmin(low[axis], batch->positions[v][axis]);
            high[axis] = fmax(high[axis], batch->positions[v][axis]);
        }
    }
    if (!scan->origin_given)
        vox_precision_choose_origin(low, high, scan->origin);
    for (int axis = 0; axis < 3; axis++) {
        scan->bounds_min[axis] = FLT_MAX;
        scan->bounds_max[axis] = -FLT_MAX;
    }
    scan->origin_known = true;
}

/* Makes missing positions the origin, which no face uses. The others must be within float32. */
static int check_positions(const struct scan *scan, const struct fmt_mesh_batch *batch,
                           uint64_t first, uint64_t count, float (*positions)[3])
{
    const double(*from)[3] = batch->positions + (first - batch->vertex_base);
    for (uint64_t v = 0; v < count; v++)
        for (int axis = 0; axis < 3; axis++) {
            const double p = from[v][axis];
            if (fabs(p - scan->origin[axis]) > FLT_MAX)
                return bsq_fail(scan->ctx, BSQ_EDATA,
                                "%s: vertex %llu of the scan: coordinate %g is too large",
                                scan->paths[batch->file], (unsigned long long)(first + v + 1), p);
            positions[v][axis] = isnan(p) ? 0.0f : positions[v][axis];
        }
    return 0;
}

static int convert_positions(struct scan *scan, const struct fmt_mesh_batch *batch, uint64_t first,
                             uint64_t count, void *out)
{
    const double o[3] = {scan->origin[0], scan->origin[1], scan->origin[2]};
    const double(*from)[3] = batch->positions + (first - batch->vertex_base);
    float(*to)[3] = out, low[3], high[3], poison = 0.0f;
    memcpy(low, scan->bounds_min, sizeof low);
    memcpy(high, scan->bounds_max, sizeof high);
    for (uint64_t v = 0; v < count; v++)
        for (int axis = 0; axis < 3; axis++) {
            /* + 0 makes a negative zero positive, so that equal positions have equal bits. Missing
             * positions, which are NaN, change no bounds. */
            float p = (float)(from[v][axis] - o[axis]) + 0.0f;
            poison += p * 0.0f;
            low[axis] = p < low[axis] ? p : low[axis];
            high[axis] = p > high[axis] ? p : high[axis];
            to[v][axis] = p;
        }
    memcpy(scan->bounds_min, low, sizeof low);
    memcpy(scan->bounds_max, high, sizeof high);
    return poison == 0.0f ? 0 : check_positions(scan, batch, first, count, to);
}

/* ---- attributes ---- */

/* scale: factor to 0..255 */
static uint32_t pack_color(struct scan *scan, const float color[3], float scale)
{
    uint32_t packed = 0xff000000u;
    bool clamped = false;
    if (!scan_color_given(color))
        return SCAN_DEFAULT_COLOR;
    for (int i = 0; i < 3; i++) {
        float value = color[i] * scale;
        clamped |= value < 0.0f || value > 255.0f;
        value = value > 0.0f ? value : 0.0f;
        value = value < 255.0f ? value : 255.0f;
        packed |= (uint32_t)(value + 0.5f) << 8 * i;
    }
    scan->clamped_colors += clamped;
    return packed;
}

/* Returns whether colours of a file that does not say it, an OBJ file or a PLY file with real
 * numbers, range to 255, and not to 1: if one is larger than a bright spot, or if all are whole and
 * one is above 1. So the result depends neither on their order nor on how a file is packed. */
static bool are_bytes(const struct scan_file *file)
{
    return file->largest_color > (file->broken_colors ? 16.0f : 1.0f);
}

/* Packs a colour that may be from 0 to 1 or from 0 to 255 in 9 bits a component: a value up to 1 as
 * its byte of the first scale, a larger one as that of the second, plus 256. The upper byte tells
 * it from RGBA8, whose alpha is 255. */
static uint32_t pack_unscaled(struct scan_file *file, const float color[3])
{
    uint32_t packed = 0;
    float largest = file->largest_color;
    bool out_of_1 = false, out_of_255 = false;
    if (!scan_color_given(color))
        return SCAN_DEFAULT_COLOR;
    for (int i = 0; i < 3; i++) {
        const float value = color[i] > 0.0f ? color[i] : 0.0f;
        largest = value > largest ? value : largest;
        const float byte = value < 255.0f ? value : 255.0f;
        file->broken_colors = file->broken_colors || byte != (float)(uint32_t)byte;
        out_of_1 |= color[i] < 0.0f || value > 1.0f;
        out_of_255 |= color[i] < 0.0f || value > 255.0f;
        packed |= (value > 1.0f ? 256 + (uint32_t)(byte + 0.5f) : (uint32_t)(value * 255.0f + 0.5f))
                  << 9 * i;
    }
    file->largest_color = largest;
    file->clamped_colors[0] += out_of_1;
    file->clamped_colors[1] += out_of_255;
    return packed;
}

/* Returns the RGBA8 of a colour that pack_unscaled() packed. */
static uint32_t scale_color(uint32_t packed, bool bytes)
{
    uint32_t color = 0xff000000u;
    for (int i = 0; i < 3; i++) {
        const uint32_t level = packed >> 9 * i & 511;
        const uint32_t as_unit = level < 256 ? level : 255,
                       as_byte = level < 256 ? level / 128 : level - 256;
        color |= (bytes ? as_byte : as_unit) << 8 * i;
    }
    return color;
}

/* Returns the fine colour beside the result of scale_color(). fine: the one as it was read. */
static uint32_t scale_fine_color(uint32_t packed, bool bytes, uint32_t fine)
{
    const uint32_t color = scale_color(packed, bytes);
    uint32_t scaled = 0;
    for (int i = 0; i < 3; i++) {
        const int32_t level = packed >> 9 * i & 511, rest = fmt_tris_color_rest(fine, i);
        if (bytes == (level > 255))
            scaled |= fmt_tris_pack_rest(rest, i);
        else if (bytes) /* up to 1: steps of 1/255 become steps of 1 */
            scaled |= fmt_tris_pack_rest(
                (1024 * level + rest + 127) / 255 - 1024 * (int32_t)(color >> 8 * i & 255), i);
    }
    return scaled;
}

void vox_scan_scale_colors(const struct scan *scan, uint64_t first, uint64_t count,
                           uint32_t *colors, uint32_t *fine)
{
    uint32_t file = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (colors[i] >> 24 == 0xff)
            continue;
        while (first + i >= scan->files[file].ends[FMT_MESH_VERTEX])
            file++;
        const bool bytes = are_bytes(&scan->files[file]);
        if (fine)
            fine[i] = scale_fine_color(colors[i], bytes, fine[i]);
        colors[i] = scale_color(colors[i], bytes);
    }
}

/* Returns the colour of a vertex up to those of the batch, as written; NULL without one. */
static const float *color_of(const struct fmt_mesh_batch *batch, uint64_t vertex)
{
    return batch->colors && vertex >= batch->vertex_base
               ? batch->colors[vertex - batch->vertex_base]
               : NULL;
}

static int convert_colors(struct scan *scan, const struct fmt_mesh_batch *batch, uint64_t first,
                          uint64_t count, void *out)
{
    uint32_t *to = out;
    for (uint64_t i = first; i < first + count; i++) {
        const float *color = color_of(batch, i);
        *to++ = !color                     ? SCAN_DEFAULT_COLOR
                : scan->batch_scale > 0.0f ? pack_color(scan, color, scan->batch_scale)
                                           : pack_unscaled(&scan->files[batch->file], color);
    }
    return 0;
}

static int convert_fine_colors(struct scan *scan, const struct fmt_mesh_batch *batch,
                               uint64_t first, uint64_t count, void *out)
{
    uint32_t *to = out;
    for (uint64_t i = first; i < first + count; i++) {
        const float *color = batch->fine_colors ? color_of(batch, i) : NULL;
        uint32_t fine = 0;
        for (int k = 0; color && scan_color_given(color) && k < 3; k++) {
            float value = color[k] * (scan->batch_scale > 0.0f ? scan->batch_scale
                                      : color[k] > 1.0f        ? 1.0f
                                                               : 255.0f);
            value = value > 0.0f ? value : 0.0f;
            value = value < 255.0f ? value : 255.0f;
            /* The rounding of pack_color() and pack_unscaled(). */
            const float rest = value - (float)(uint32_t)(value + 0.5f);
            fine |= fmt_tris_pack_rest((int32_t)lrintf(1024.0f * rest), k);
        }
        *to++ = fine;
    }
    return 0;
}

static int convert_texcoords(struct scan *scan, const struct fmt_mesh_batch *batch, uint64_t first,
                             uint64_t count, void *out)
{
    const double(*from)[2] = batch->texcoords + (first - batch->texcoord_base);
    float(*to)[2] = out;
    (void)scan;
    for (uint64_t i = 0; i < count; i++)
        for (int k = 0; k < 2; k++)
            to[i][k] = (float)fmin(fmax(from[i][k], -FLT_MAX), FLT_MAX) + 0.0f;
    return 0;
}

static uint32_t pack_normal(const float n[3])
{
    /* Divides by the largest component first, so that the length cannot over- or underflow. */
    float largest = fmaxf(fabsf(n[0]), fmaxf(fabsf(n[1]), fabsf(n[2])));
    if (!(largest > 0.0f) || !isfinite(largest))
        return SCAN_NO_NORMAL;
    struct bsq_vec3 v = bsq_v3(n[0] / largest, n[1] / largest, n[2] / largest);
    return bsq_oct_pack(bsq_unit3(v));
}

static int convert_normals(struct scan *scan, const struct fmt_mesh_batch *batch, uint64_t first,
                           uint64_t count, void *out)
{
    const float(*from)[3] = batch->normals + (first - batch->normal_base);
    uint32_t *to = out;
    (void)scan;
    for (uint64_t i = 0; i < count; i++)
        to[i] = pack_normal(from[i]);
    return 0;
}

static int convert_late_colors(struct scan *scan, const struct fmt_mesh_batch *batch,
                               uint64_t first, uint64_t count, void *out)
{
    const uint64_t base = batch->late_color_base;
    uint32_t *to = out;
    (void)scan;
    for (uint64_t i = first; i < first + count; i++)
        *to++ = i < base ? SCAN_DEFAULT_COLOR : batch->late_colors[i - base];
    return 0;
}

/* Appends late colours to those of the vertices before them, which are default colours if they have
 * none. Does nothing if the vertices have colours in their own lines. */
static int add_late_colors(struct scan *scan, const struct fmt_mesh_batch *batch)
{
    const uint64_t base = batch->late_color_base, vertices = scan_count(scan, SCAN_POSITIONS);
    const uint64_t end = base + batch->late_color_count;
    enum scan_paint *paint = &scan->files[batch->file].paint;
    if (scan_count(scan, SCAN_COLORS) > base)
        *paint = SCAN_PAINT_LOST;
    if (*paint == SCAN_PAINT_LOST)
        return 0;
    *paint = SCAN_PAINT_USED;
    return append(scan, batch, SCAN_COLORS, end < vertices ? end : vertices, convert_late_colors);
}

/* Returns whether late colours fit the vertices. */
static bool late_colors_fit(const struct scan *scan)
{
    const uint64_t count = scan_count(scan, SCAN_COLORS);
    return count > 0 && count == scan_count(scan, SCAN_POSITIONS) && !scan->totals.unread_colors;
}

/* ---- missing elements ---- */

/* Makes the bits long enough for `count` elements. */
static int extend(struct bsq_ctx *ctx, struct scan_missing *missing, uint64_t count)
{
    const uint64_t words = count / 64 + 1;
    if (words <= missing->words)
        return 0;
    BSQ_PASS(BSQ_GROW(ctx, "elements that are missing", words, &missing->bits, &missing->capacity));
    memset(missing->bits + missing->words, 0, (words - missing->words) * sizeof *missing->bits);
    missing->words = words;
    return 0;
}

static void mark(struct scan_missing *missing, uint64_t index)
{
    missing->bits[index / 64] |= (uint64_t)1 << index % 64;
}

/* Notes which of `count` elements of `size` numbers are missing. base: of the first one. */
static int note_missing(struct scan *scan, enum fmt_mesh_kind kind, const double *elements,
                        unsigned size, uint64_t count, uint64_t base)
{
    BSQ_PASS(extend(scan->ctx, &scan->missing[kind], base + count));
    for (uint64_t i = 0; i < count; i++)
        if (isnan(elements[i * size]))
            mark(&scan->missing[kind], base + i);
    return 0;
}

static bool is_colored(const struct fmt_mesh_batch *batch, uint64_t vertex)
{
    return batch->colors && scan_color_given(batch->colors[vertex]);
}

/* Notes which vertices lack a colour, if others of the file have one. Called before the batch is
 * counted for its file. */
static int note_missing_colors(struct scan *scan, const struct fmt_mesh_batch *batch)
{
    const bool colored_before = scan->files[batch->file].has_colors;
    const uint64_t base = batch->vertex_base, end = base + batch->vertex_count;
    /* The first colours of a file show that all vertices before them lack one. */
    uint64_t first = base, vertex = 0;
    if (batch->color_white > 0.0f || (!batch->colors && !colored_before))
        return 0;
    if (!colored_before)
        first = batch->file > 0 ? scan->files[batch->file - 1].ends[FMT_MESH_VERTEX] : 0;
    while (vertex < batch->vertex_count && is_colored(batch, vertex))
        vertex++;
    if (first == base && vertex == batch->vertex_count)
        return 0;
    BSQ_PASS(extend(scan->ctx, &scan->missing_colors, end));
    for (uint64_t i = first; i < base; i++)
        mark(&scan->missing_colors, i);
    for (; vertex < batch->vertex_count; vertex++)
        if (!is_colored(batch, vertex))
            mark(&scan->missing_colors, base + vertex);
    return 0;
}

/* ---- batches ---- */

/* Notes that batches of a file come. */
static void enter_file(struct scan *scan, uint32_t number)
{
    for (; scan->file_count <= number; scan->file_count++)
        if (scan->file_count > 0)
            memcpy(scan->files[scan->file_count].ends, scan->files[scan->file_count - 1].ends,
                   sizeof scan->files->ends);
}

static int add_vertices(struct scan *scan, const struct fmt_mesh_batch *batch)
{
    const uint64_t end = batch->vertex_base + batch->vertex_count;
    if (!scan->origin_known && batch->missing_positions < batch->vertex_count)
        choose_origin(scan, batch);
    scan->has_colors |= batch->colors != NULL;
    BSQ_PASS(append(scan, batch, SCAN_POSITIONS, end, convert_positions));
    scan->merged_vertices +=
        vox_precision_count_merged(batch->positions, batch->vertex_count, scan->origin);
    if (!scan->has_colors)
        return 0;
    BSQ_PASS(note_missing_colors(scan, batch));
    scan->batch_scale = batch->color_white > 0.0f ? 255.0f / batch->color_white : 0.0f;
    BSQ_PASS(append(scan, batch, SCAN_COLORS, end, convert_colors));
    return batch->fine_colors || scan_count(scan, SCAN_FINE_COLORS) > 0
               ? append(scan, batch, SCAN_FINE_COLORS, end, convert_fine_colors)
               : 0;
}

/* Counts the elements that a batch with some adds to its file. */
static void count_elements(struct scan *scan, const struct fmt_mesh_batch *batch)
{
    struct scan_file *file = &scan->files[batch->file];
    file->has_colors |= batch->colors != NULL;
    file->ends[FMT_MESH_VERTEX] = scan_count(scan, SCAN_POSITIONS);
    file->ends[FMT_MESH_TEXCOORD] = scan_count(scan, SCAN_TEXCOORDS);
    file->ends[FMT_MESH_NORMAL] = scan_count(scan, SCAN_NORMALS);
}

bool vox_scan_has_elements(const struct fmt_mesh_batch *batch)
{
    return batch->vertex_count > 0 || batch->texcoord_count > 0 || batch->normal_count > 0 ||
           batch->late_color_count > 0;
}

int vox_scan_add_elements(struct scan *scan, const struct fmt_mesh_batch *batch)
{
    enter_file(scan, batch->file);
    scan->files[batch->file].bytes += batch->byte_size;
    if (!vox_scan_has_elements(batch))
        return 0;
    const uint64_t texcoords = batch->texcoord_base + batch->texcoord_count;
    const uint64_t normals = batch->normal_base + batch->normal_count;
    if (batch->missing_positions > 0)
        BSQ_PASS(note_missing(scan, FMT_MESH_VERTEX, batch->positions[0], 3, batch->vertex_count,
                              batch->vertex_base));
    if (batch->missing_texcoords > 0)
        BSQ_PASS(note_missing(scan, FMT_MESH_TEXCOORD, batch->texcoords[0], 2,
                              batch->texcoord_count, batch->texcoord_base));
    if (batch->vertex_count > 0)
        BSQ_PASS(add_vertices(scan, batch));
    BSQ_PASS(append(scan, batch, SCAN_TEXCOORDS, texcoords, convert_texcoords));
    BSQ_PASS(append(scan, batch, SCAN_NORMALS, normals, convert_normals));
    if (batch->late_color_count > 0)
        BSQ_PASS(add_late_colors(scan, batch));
    count_elements(scan, batch);
    return 0;
}

void vox_scan_prefault(struct scan *scan)
{
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        vox_stream_prefault(&scan->streams[i]);
}

/* ---- the end ---- */

int vox_scan_finish_streams(struct scan *scan)
{
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        BSQ_PASS(vox_stream_finish(&scan->streams[i]));
    return 0;
}

int vox_scan_finish(struct scan *scan, struct fmt_mesh_reader *reader)
{
    const struct scan_bad_index *bad = &scan->bad_index;
    BSQ_PASS(vox_scan_finish_streams(scan));
    enter_file(scan, scan->path_count - 1); /* the last files may be empty */
    scan->has_colors |= late_colors_fit(scan);
    for (uint64_t i = 0; i < scan->file_count; i++)
        scan->clamped_colors += scan->files[i].clamped_colors[are_bytes(&scan->files[i])];
    if (scan->clamped_colors > 0)
        BSQ_PASS(bsq_warn_loss(scan->ctx, "%s: colours out of range were clamped at %llu %s",
                               scan->paths[0], (unsigned long long)scan->clamped_colors,
                               scan->clamped_colors == 1 ? "vertex" : "vertices"));
    if (scan->totals.unread_colors && !scan->has_colors)
        BSQ_PASS(bsq_warn_loss(scan->ctx, "%s: %s", scan->paths[0], scan->totals.unread_colors));
    BSQ_PASS(vox_precision_warn_merged(scan->ctx, scan->paths[0], scan->merged_vertices,
                                       scan->bounds_min, scan->bounds_max));
    if (scan->totals.faces == 0)
        return fmt_mesh_fail_no_faces(scan->ctx, scan->paths[0], &scan->totals);
    if (bad->found)
        return fmt_mesh_fail_index(reader, bad->face, bad->kind, bad->index);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        BSQ_PASS(fmt_mesh_report_loss(reader, (enum fmt_mesh_kind)kind, &scan->lost[kind],
                                      scan->totals.faces));
    return 0;
}

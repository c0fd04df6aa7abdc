/* polygon_fans.c - see polygon_fans.h. */
#include "libvoxel/chunk/polygon_fans.h"
#include "base/polygon.h"

uint64_t vox_fan_buffer_bytes(const struct record_layout *layout)
{
    return FAN_CORNERS * (layout->corner_bytes + sizeof(double[3]) + sizeof(uint32_t[3])) +
           bsq_triangulate_scratch(FAN_CORNERS);
}

int vox_fan_buffer_init(struct fan_buffer *buffer, struct bsq_ctx *ctx,
                        const struct record_layout *layout)
{
    const char *what = "sorting";
    int status;
    *buffer = (struct fan_buffer){0};
    if ((status = bsq_alloc(ctx, what, FAN_CORNERS, layout->corner_bytes, &buffer->corners)) < 0 ||
        (status = bsq_alloc(ctx, what, FAN_CORNERS, sizeof *buffer->positions,
                            &buffer->positions)) < 0 ||
        (status = bsq_alloc(ctx, what, FAN_CORNERS, sizeof(uint32_t[3]), &buffer->triangles)) < 0)
        return status;
    return bsq_alloc(ctx, what, bsq_triangulate_scratch(FAN_CORNERS), 1, &buffer->scratch);
}

void vox_fan_buffer_free(struct fan_buffer *buffer, struct bsq_ctx *ctx)
{
    bsq_free(ctx, buffer->corners);
    bsq_free(ctx, buffer->positions);
    bsq_free(ctx, buffer->triangles);
    bsq_free(ctx, buffer->scratch);
    *buffer = (struct fan_buffer){0};
}

/* Returns the number of records of the fan that begins at `records`. */
static uint32_t fan_length(const struct record_layout *layout, const uint8_t *records,
                           uint64_t count)
{
    uint32_t length = 1;
    while (length < count &&
           record_continues_fan(layout, records + (uint64_t)length * layout->bytes))
        length++;
    return length;
}

/* Collects the corners of a fan: two of its first triangle, and the third of each triangle. */
static void collect_corners(const struct record_layout *layout, const uint8_t *records,
                            uint32_t length, uint8_t *corners)
{
    const uint32_t bytes = layout->corner_bytes;
    memcpy(corners, records, 2 * bytes);
    for (uint32_t t = 0; t < length; t++)
        memcpy(corners + (t + 2) * bytes, records + (uint64_t)t * layout->bytes + 2 * bytes, bytes);
}

static int triangulate(struct bsq_ctx *ctx, const struct gather_window *window,
                       struct fan_buffer *buffer, uint32_t corners)
{
    for (uint32_t c = 0; c < corners; c++) {
        const uint8_t *corner = buffer->corners + c * window->layout->corner_bytes;
        const float *p = gather_position(window, record_vertex_index(window->layout, corner));
        for (int axis = 0; axis < 3; axis++)
            buffer->positions[c][axis] = p[axis];
    }
    return bsq_triangulate(ctx, (const double(*)[3])buffer->positions, corners, buffer->triangles,
                           buffer->scratch);
}

static bool is_own(const struct fan_buffer *buffer, const struct morton_cube *cube, uint32_t levels,
                   uint32_t bucket, const uint32_t triangle[3])
{
    const double *p = buffer->positions[triangle[0]];
    const float first[3] = {(float)p[0], (float)p[1], (float)p[2]};
    return morton_cell(cube, levels, first) == bucket;
}

static void put_triangle(const struct record_layout *layout, const struct fan_buffer *buffer,
                         const uint32_t triangle[3], const uint8_t *material, uint8_t *to)
{
    const uint32_t bytes = layout->corner_bytes;
    for (uint32_t k = 0; k < 3; k++)
        memcpy(to + k * bytes, buffer->corners + triangle[k] * bytes, bytes);
    memmove(to + 3 * bytes, material, layout->material_bytes);
}

int vox_fans_triangulate(struct bsq_ctx *ctx, const struct gather_window *window,
                         struct fan_buffer *buffer, const struct morton_cube *cube, uint32_t levels,
                         uint32_t bucket, uint8_t *records, uint64_t *count)
{
    const struct record_layout *layout = window->layout;
    uint8_t *to = records;
    int status = 0;
    for (uint64_t t = 0; t < *count && status == 0;) {
        uint8_t *from = records + t * layout->bytes, *material = from + 3 * layout->corner_bytes;
        const uint32_t length = fan_length(layout, from, *count - t);
        t += length;
        if (length == 1) {
            memmove(to, from, layout->bytes);
            to += layout->bytes;
            continue;
        }
        collect_corners(layout, from, length, buffer->corners);
        status = triangulate(ctx, window, buffer, length + 2);
        for (uint32_t i = 0; i < length && status == 0; i++)
            if (is_own(buffer, cube, levels, bucket, buffer->triangles + 3 * i)) {
                put_triangle(layout, buffer, buffer->triangles + 3 * i, material, to);
                to += layout->bytes;
            }
    }
    *count = (uint64_t)(to - records) / layout->bytes;
    return status;
}

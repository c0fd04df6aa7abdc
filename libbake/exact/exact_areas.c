/* exact_areas.c - points of the scan that stand for its area.
 *
 * They are triangles in equal steps of each chunk, taken while the chunk is in memory for its rays.
 * So the scan is not read for them. Chunks that no ray crosses are never read; the area of their
 * triangles is taken to be the mean of the others'. */
#include <math.h>
#include <string.h>

#include "libbake/exact/exact_scene.h"

enum { MOST_POINTS = 4096, MOST_OF_CHUNK = 2048, LEAST_OF_CHUNK = 2 };

#define NOT_READ (-1.0f) /* the area of the first point of a chunk */

int bake_exact_note_areas(struct bake_exact *exact)
{
    uint32_t points = MOST_POINTS / exact->chunk_count;
    points = points > MOST_OF_CHUNK ? MOST_OF_CHUNK : points;
    exact->chunk_points = points < LEAST_OF_CHUNK ? LEAST_OF_CHUNK : points;
    int status = BSQ_CALLOC(exact->ctx, "points of the scan",
                            (uint64_t)exact->chunk_count * exact->chunk_points, &exact->points);
    for (uint32_t c = 0; c < exact->chunk_count && status == 0; c++)
        exact->points[(uint64_t)c * exact->chunk_points].area = NOT_READ;
    return status;
}

/* Sets a point to one in a triangle. number: of the point in its chunk; those of a large triangle,
 * which has several, cover it evenly (the R2 sequence: Roberts, "The Unreasonable Effectiveness of
 * Quasirandom Sequences", 2018). */
static void set_point(const struct fmt_tris_chunk *chunk, uint32_t triangle, uint32_t number,
                      float weight, struct bake_area_point *out)
{
    const double plastic = 1.32471795724474602596;
    double u = fmod((number + 0.5) / plastic, 1), w = fmod((number + 0.5) / plastic / plastic, 1);
    const uint32_t *v = chunk->triangles[triangle];
    const float *a = chunk->positions[v[0]], *b = chunk->positions[v[1]],
                *c = chunk->positions[v[2]];
    const double side = bake_exact_wound_backwards(chunk, triangle) ? -1 : 1;
    double cross[3], square = 0;
    if (u + w > 1) { /* the other half of the parallelogram */
        u = 1 - u;
        w = 1 - w;
    }
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        cross[k] = ((double)b[i] - (double)a[i]) * ((double)c[j] - (double)a[j]) -
                   ((double)b[j] - (double)a[j]) * ((double)c[i] - (double)a[i]);
        square += cross[k] * cross[k];
        out->at[k] = (float)((1 - u - w) * (double)a[k] + u * (double)b[k] + w * (double)c[k]);
    }
    const double length = sqrt(square);
    for (int k = 0; k < 3 && length > 0; k++)
        out->normal[k] = (float)(side * cross[k] / length);
    out->area = (float)(0.5 * length) * weight;
}

void bake_exact_take_areas(const struct bake_exact *exact, uint32_t number,
                           const struct fmt_tris_chunk *chunk)
{
    struct bake_area_point *points = &exact->points[(uint64_t)number * exact->chunk_points];
    if (points->area != NOT_READ)
        return;
    points->area = 0;
    for (uint32_t i = 0; i < exact->chunk_points; i++)
        set_point(chunk, (uint32_t)((uint64_t)chunk->triangle_count * i / exact->chunk_points), i,
                  (float)chunk->triangle_count / (float)exact->chunk_points, &points[i]);
}

/* Makes the first point of a chunk that was not read stand for all of it. */
static void guess_point(const struct fmt_tris_chunk_info *chunk, double triangle_area,
                        struct bake_area_point *out)
{
    *out = (struct bake_area_point){.area = (float)(chunk->triangle_count * triangle_area)};
    for (int k = 0; k < 3; k++)
        out->at[k] = 0.5f * (chunk->bounds_min[k] + chunk->bounds_max[k]);
}

uint64_t bake_exact_areas(struct bake_exact *exact, const struct bake_area_point **out)
{
    double area = 0, triangles = 0;
    *out = exact->points;
    for (uint32_t pass = 0; pass < 2; pass++)
        for (uint32_t c = 0; c < exact->chunk_count; c++) {
            struct bake_area_point *points = &exact->points[(uint64_t)c * exact->chunk_points];
            const bool read = points->area != NOT_READ;
            if (pass == 1 && !read)
                guess_point(&exact->chunks[c], triangles > 0 ? area / triangles : 0, points);
            for (uint32_t i = 0; i < exact->chunk_points && pass == 0 && read; i++)
                area += (double)points[i].area;
            triangles += pass == 0 && read ? exact->chunks[c].triangle_count : 0;
        }
    return (uint64_t)exact->chunk_count * exact->chunk_points;
}

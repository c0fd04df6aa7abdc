/* tris_sample.c - a coarse surface that stands for a chunk's triangles.
 *
 * Triangles follow each other along a curve, so a run of them is a patch of the surface. A run ends
 * after 128 triangles, or where the next triangle is far away: of all the distances between
 * neighbours in the file, the largest ones. The bounds of a run hold all of its corners. So the
 * rectangles of neighbouring runs leave no gap between them, and nothing is missing that stands
 * out. */
#include "formats/chunks/tris_internal.h"

#include <math.h>
#include <xxhash.h>

#include "base/simd/simd.h"
#include "base/geometry/vec.h"

/* Triangles of a run at most; of a run, every EXAMINEDth has a say in its plane: an odd number,
 * because sides may take turns. far_distance() looks at every LOOKED_ATth pair of neighbours, and
 * counts distances by their upper 32 - FAR_BITS bits. Chunks of fewer than LEAST triangles are not
 * worth a sample. */
enum { RUN = 2 * TRIS_SURFEL_RUN, EXAMINED = 5, LOOKED_AT = 8, LEAST = 1024, FAR_BITS = 20 };

#define GRID 65535.0f

/* ---- making ---- */

/* Loads a corner of a triangle. The fourth number is the next one in memory. */
static four_floats sample_corner_of(const struct fmt_tris_chunk *chunk, uint32_t triangle,
                                    int corner)
{
    return four_floats_load(chunk->positions[chunk->triangles[triangle][corner]]);
}

/* Returns the differences of two corners, without their signs. */
static four_floats distances(four_floats a, four_floats b)
{
    return four_floats_max(a - b, b - a);
}

/* Returns a distance that about one in RUN triangles is away from the one before it, first corner
 * from first corner. Looks at every LOOKED_ATth pair. */
static float far_distance(const struct fmt_tris_chunk *chunk)
{
    /* By their upper bits, which order numbers that are not negative. */
    uint32_t counts[1 << (32 - FAR_BITS)] = {0}, far = sizeof counts / sizeof *counts, sum = 0;
    float distance;
    for (uint32_t t = 1; t < chunk->triangle_count; t += LOOKED_AT) {
        const four_floats d =
            distances(sample_corner_of(chunk, t - 1, 0), sample_corner_of(chunk, t, 0));
        uint32_t bits;
        distance = d[0] > d[1] ? d[0] : d[1];
        distance = d[2] > distance ? d[2] : distance;
        memcpy(&bits, &distance, sizeof bits);
        counts[bits >> FAR_BITS]++;
    }
    while (far > 1 && sum + counts[far - 1] <= chunk->triangle_count / (RUN * LOOKED_AT))
        sum += counts[--far];
    far <<= FAR_BITS;
    memcpy(&distance, &far, sizeof distance);
    return distance;
}

/* What is known of a run of triangles. */
struct run {
    float low[3], high[3];
    float normal[3], area;     /* sums over the triangles that are examined: area vectors */
    float middle[3], examined; /* sum of their middles, and their number */
    float side;                /* of facing() */
};

static struct bsq_vec3 sample_vector(const float v[3])
{
    return bsq_v3(v[0], v[1], v[2]);
}

/* Sets the area vector of a triangle, twice as long. */
static void area_vector(const struct fmt_tris_chunk *chunk, uint32_t triangle, float out[3])
{
    const uint32_t *v = chunk->triangles[triangle];
    const struct bsq_vec3 a = sample_vector(chunk->positions[v[0]]),
                          b = sample_vector(chunk->positions[v[1]]),
                          c = sample_vector(chunk->positions[v[2]]);
    const struct bsq_vec3 n = bsq_cross3(bsq_sub3(b, a), bsq_sub3(c, a));
    memcpy(out, &n, sizeof n);
}

/* Returns a negative number if the vertex normals of a triangle look to the other side. */
static float facing(const struct fmt_tris_chunk *chunk, uint32_t triangle, const float n[3])
{
    if (!chunk->normals)
        return 0.0f;
    return bsq_dot3(bsq_oct_unpack(chunk->normals[chunk->triangles[triangle][0]]),
                    sample_vector(n));
}

static void sample_examine(const struct fmt_tris_chunk *chunk, uint32_t triangle, struct run *p)
{
    const uint32_t *v = chunk->triangles[triangle];
    float n[3];
    area_vector(chunk, triangle, n);
    for (int k = 0; k < 3; k++) {
        p->normal[k] += n[k];
        p->middle[k] +=
            (chunk->positions[v[0]][k] + chunk->positions[v[1]][k] + chunk->positions[v[2]][k]) /
            3.0f;
    }
    p->area += bsq_length3(sample_vector(n));
    p->examined++;
    p->side += facing(chunk, triangle, n);
}

/* Gathers a run that begins with a triangle and ends before one that is `far` away. Returns its
 * end. */
static uint32_t sample_gather(const struct fmt_tris_chunk *chunk, uint32_t begin, float far,
                              struct run *p)
{
    const uint32_t left = chunk->triangle_count - begin, most = begin + (left < RUN ? left : RUN);
    four_floats before = sample_corner_of(chunk, begin, 0), low = before, high = before;
    uint32_t end = begin;
    for (; end < most; end++) {
        const four_floats a = sample_corner_of(chunk, end, 0), b = sample_corner_of(chunk, end, 1),
                          c = sample_corner_of(chunk, end, 2), d = distances(a, before);
        if ((d[0] >= far) | (d[1] >= far) | (d[2] >= far))
            break;
        low = four_floats_min(low, four_floats_min(a, four_floats_min(b, c)));
        high = four_floats_max(high, four_floats_max(a, four_floats_max(b, c)));
        before = a;
    }
    *p = (struct run){0};
    memcpy(p->low, &low, sizeof p->low);
    memcpy(p->high, &high, sizeof p->high);
    for (uint32_t t = begin; t < end; t += EXAMINED)
        sample_examine(chunk, t, p);
    return end;
}

/* Returns the axis along which a vector is longest. */
static int main_axis(const float v[3])
{
    const int k = fabsf(v[1]) > fabsf(v[0]);
    return fabsf(v[2]) > fabsf(v[k]) ? 2 : k;
}

static uint16_t to_grid(float at, float low, float high, float rounding)
{
    const float cell = high > low ? (at - low) / (high - low) * GRID + rounding : 0.0f;
    return (uint16_t)(cell > 0.0f ? cell < GRID ? cell : GRID : 0.0f);
}

/* Sets the plane of a run. Returns false if its triangles face different ways. */
static bool sample_set_plane(const struct run *p, const struct fmt_tris_chunk_info *info,
                             struct tris_surfel *out)
{
    const float steady = 0.8f, *n = p->normal;
    const float length = bsq_length3(sample_vector(n));
    if (!(length > steady * p->area) || !isfinite(length))
        return false;
    const float scale = (p->side < 0.0f ? -1.0f : 1.0f) / length;
    out->normal = bsq_oct_pack(bsq_scale3(sample_vector(n), scale));
    const int z = main_axis(n), x = (z + 1) % 3, y = (z + 2) % 3;
    const float dx = 0.5f * (p->low[x] + p->high[x]) - p->middle[x] / p->examined,
                dy = 0.5f * (p->low[y] + p->high[y]) - p->middle[y] / p->examined;
    const float at = p->middle[z] / p->examined - (n[x] * dx + n[y] * dy) / n[z];
    out->low[z] = to_grid(at, info->bounds_min[z], info->bounds_max[z], 0.5f);
    out->high[z] = out->low[z];
    return true;
}

/* Returns the directions into which triangles face: a bit for each axis and side. */
static uint32_t directions(const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end)
{
    uint32_t bits = 0;
    for (uint32_t t = begin; t < end; t++) {
        float n[3];
        area_vector(chunk, t, n);
        const int z = main_axis(n);
        const bool against = (n[z] < 0.0f) != (facing(chunk, t, n) < 0.0f);
        bits |= n[z] == 0.0f ? 0 : 1u << (2 * z + against);
    }
    return bits;
}

void fmt_tris_make_sample(const struct fmt_tris_chunk *chunk,
                          const struct fmt_tris_chunk_info *info, uint8_t *out)
{
    const uint32_t count = chunk->triangle_count;
    memset(out, 0, tris_sample_bytes(count));
    float far = count < RUN ? INFINITY : far_distance(chunk);
    uint32_t short_runs = 0;
    for (uint32_t begin = 0, end; begin < count; begin = end, out += sizeof(struct tris_surfel)) {
        struct tris_surfel surfel;
        struct run run;
        end = sample_gather(chunk, begin, far, &run);
        /* There is a record for as many short runs as full ones. */
        short_runs += end - begin < RUN;
        if (short_runs >= count / RUN)
            far = INFINITY;
        for (int k = 0; k < 3; k++) {
            const float low = info->bounds_min[k], high = info->bounds_max[k];
            surfel.low[k] = to_grid(run.low[k], low, high, 0.0f);
            surfel.high[k] = to_grid(run.high[k], low, high, 1.0f);
        }
        if (!sample_set_plane(&run, info, &surfel))
            surfel.normal = TRIS_NOT_A_PLANE | directions(chunk, begin, end);
        memcpy(out, &surfel, sizeof surfel);
    }
}

/* ---- reading ---- */

/* The surface while it is made of records. */
struct surface {
    float (*positions)[3];
    uint32_t (*triangles)[3];
    uint32_t positions_count, triangle_count;
};

/* Adds a rectangle across axis z that faces along it, or against it. slope: by how much the third
 * coordinate grows along the other two, from `middle`. */
static void add_rectangle(struct surface *s, int z, const float low[3], const float high[3],
                          float middle, const float slope[2], bool against)
{
    static const uint8_t corners[2][2][3] = {{{0, 1, 3}, {0, 3, 2}}, {{3, 1, 0}, {2, 3, 0}}};
    const int x = (z + 1) % 3, y = (z + 2) % 3;
    const uint32_t first = s->positions_count;
    for (int i = 0; i < 4; i++) {
        float *at = s->positions[s->positions_count++];
        const float half_x = 0.5f * (high[x] - low[x]) * (i & 1 ? 1.0f : -1.0f),
                    half_y = 0.5f * (high[y] - low[y]) * (i & 2 ? 1.0f : -1.0f);
        at[x] = i & 1 ? high[x] : low[x];
        at[y] = i & 2 ? high[y] : low[y];
        at[z] = middle + slope[0] * half_x + slope[1] * half_y;
    }
    for (int t = 0; t < 2; t++, s->triangle_count++)
        for (int k = 0; k < 3; k++)
            s->triangles[s->triangle_count][k] = first + corners[against][t][k];
}

/* Adds a rectangle for each direction into which triangles of a patch face: in its middle, or if
 * some face the opposite way, as those of a thin wall, on either side. */
static void sample_add_box(struct surface *s, const float low[3], const float high[3],
                           uint32_t directions)
{
    static const float flat[2] = {0, 0};
    for (int z = 0; z < 3; z++) {
        const uint32_t bits = directions >> (2 * z) & 3;
        const float half = bits == 3 ? 0.5f * (high[z] - low[z]) : 0.0f,
                    middle = 0.5f * (low[z] + high[z]);
        if (bits & 1)
            add_rectangle(s, z, low, high, middle + half, flat, false);
        if (bits & 2)
            add_rectangle(s, z, low, high, middle - half, flat, true);
    }
}

/* Adds what a record stands for. */
static void add_surfel(struct surface *s, const struct tris_surfel *surfel,
                       const struct fmt_tris_chunk_info *info)
{
    float low[3], high[3];
    for (int k = 0; k < 3; k++) {
        const float step = info->bounds_max[k] / GRID - info->bounds_min[k] / GRID;
        low[k] = info->bounds_min[k] + (float)surfel->low[k] * step;
        high[k] = info->bounds_min[k] + (float)surfel->high[k] * step;
    }
    if (surfel->normal >> 16 == TRIS_NOT_A_PLANE >> 16) {
        sample_add_box(s, low, high, surfel->normal);
        return;
    }
    const struct bsq_vec3 unit = bsq_oct_unpack(surfel->normal);
    const float n[3] = {unit.x, unit.y, unit.z};
    const int z = main_axis(n);
    const float slope[2] = {-n[(z + 1) % 3] / n[z], -n[(z + 2) % 3] / n[z]};
    add_rectangle(s, z, low, high, 0.5f * (low[z] + high[z]), slope, n[z] < 0.0f);
}

static bool is_empty(const struct tris_surfel *surfel)
{
    static const struct tris_surfel none;
    return memcmp(surfel, &none, sizeof none) == 0;
}

static bool sample_is_valid(const struct tris_surfel *surfel)
{
    const uint32_t lower = surfel->normal & 0xffff, upper = surfel->normal >> 16;
    bool valid = upper == TRIS_NOT_A_PLANE >> 16 ? lower < 1 << 6 : lower != 0x8000;
    for (int k = 0; k < 3; k++)
        valid &= surfel->low[k] <= surfel->high[k];
    return valid;
}

bool fmt_tris_sample_valid(const void *sample, uint32_t triangles)
{
    bool valid = true, ended = false;
    for (uint32_t i = 0; i < tris_surfel_count(triangles); i++) {
        struct tris_surfel surfel;
        memcpy(&surfel, (const uint8_t *)sample + i * sizeof surfel, sizeof surfel);
        valid &= sample_is_valid(&surfel) && !(ended && !is_empty(&surfel));
        ended |= is_empty(&surfel);
    }
    return valid;
}

int fmt_tris_load_sample(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                         struct fmt_tris_chunk *out, bool *found)
{
    const struct fmt_tris_chunk_info *info = &file->chunks[index];
    const uint32_t attributes = file->header.attributes, count = info->triangle_count;
    const struct tris_layout l = tris_chunk_layout(attributes, count, info->vertex_count);
    const uint32_t records = tris_surfel_count(count);
    struct surface s = {.positions = scratch,
                        .triangles =
                            (uint32_t(*)[3])scratch + (size_t)TRIS_SURFEL_CORNERS * records};
    *out = (struct fmt_tris_chunk){0};
    *found = attributes & FMT_TRIS_SAMPLES && count >= LEAST;
    if (!*found)
        return 0;
    uint8_t *bytes = (uint8_t *)scratch + (tris_sample_memory(count) - tris_sample_bytes(count));
    BSQ_PASS(fmt_tris_read_unchanged(file, bytes, tris_sample_bytes(count),
                                     info->offset + l.values[TRIS_ATTRIBUTE_COUNT - 1]));
    if (XXH3_64bits(bytes, tris_sample_bytes(count)) != info->sample_checksum)
        return fmt_tris_damaged(file, "the checksum of a sample does not match");
    for (uint32_t i = 0; i < records; i++) {
        struct tris_surfel surfel;
        memcpy(&surfel, bytes + i * sizeof surfel, sizeof surfel);
        if (!is_empty(&surfel))
            add_surfel(&s, &surfel, info);
    }
    out->vertex_count = s.positions_count;
    out->triangle_count = s.triangle_count;
    out->positions = (const float(*)[3])s.positions;
    out->triangles = (const uint32_t(*)[3])s.triangles;
    return 0;
}

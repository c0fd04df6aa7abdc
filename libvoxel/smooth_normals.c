/* smooth_normals.c - sums the area normals around each vertex over all chunks that touch it.
 *
 * A chunk's border vertices also belong to its neighbours. Storing their normals would cost room in
 * every chunk file, though only scans that are coarse for the grid need them; so the neighbours,
 * found by their bounds, are read again, one at a time into one scratch, and matched by position.
 */
#include "libvoxel/smooth_normals.h"

#include <math.h>
#include <pthread.h>
#include <string.h>

struct vox_smooth {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    pthread_mutex_t lock;
    uint32_t slot_mask; /* table size - 1 */
    uint32_t *table;    /* positions, open addressing: vertex number + 1, 0 is free */
    uint32_t *twins;    /* of each vertex of the chunk: the first vertex at its position */
    double (*sums)[4];  /* of area vectors and their lengths, of each vertex that is its own twin */
    void *scratch;      /* one decoded neighbour */
};

static uint32_t largest_vertex_count(const struct fmt_tris_file *file)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    uint64_t count = fmt_tris_get_header(file)->chunk_count;
    uint32_t largest = 1;
    for (uint64_t i = 0; i < count; i++)
        largest = infos[i].vertex_count > largest ? infos[i].vertex_count : largest;
    return largest;
}

/* At most half full. */
static uint64_t table_size(uint64_t vertices)
{
    uint64_t size = 16;
    while (size < 2 * vertices)
        size *= 2;
    return size;
}

uint64_t vox_smooth_bytes(const struct fmt_tris_file *file)
{
    uint64_t vertices = largest_vertex_count(file);
    return sizeof(struct vox_smooth) + table_size(vertices) * sizeof(uint32_t) +
           vertices * (sizeof(uint32_t) + sizeof(double[4])) + fmt_tris_load_size_max(file);
}

int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      struct vox_smooth **out)
{
    struct vox_smooth *s;
    uint32_t vertices = largest_vertex_count(file);
    uint64_t size = table_size(vertices);
    *out = NULL;
    int status = bsq_calloc(ctx, "smooth normals", 1, sizeof *s, &s);
    if (status < 0)
        return status;
    s->ctx = ctx;
    s->file = file;
    s->slot_mask = (uint32_t)(size - 1);
    pthread_mutex_init(&s->lock, NULL);
    if ((status = bsq_alloc(ctx, "smooth normals", size, sizeof *s->table, &s->table)) < 0 ||
        (status = bsq_alloc(ctx, "smooth normals", vertices, sizeof *s->twins, &s->twins)) < 0 ||
        (status = bsq_alloc(ctx, "smooth normals", vertices, sizeof *s->sums, &s->sums)) < 0 ||
        (status = bsq_alloc(ctx, "smooth normals", fmt_tris_load_size_max(file), 1, &s->scratch)) <
            0) {
        vox_smooth_destroy(s);
        return status;
    }
    *out = s;
    return 0;
}

void vox_smooth_destroy(struct vox_smooth *s)
{
    if (!s)
        return;
    bsq_free(s->ctx, s->table);
    bsq_free(s->ctx, s->twins);
    bsq_free(s->ctx, s->sums);
    bsq_free(s->ctx, s->scratch);
    pthread_mutex_destroy(&s->lock);
    bsq_free(s->ctx, s);
}

/* ---- positions ---- */

/* The same for both zeros, which are equal positions. */
static uint64_t hash_position(const float p[3])
{
    uint64_t hash = 0;
    for (int a = 0; a < 3; a++) {
        float value = p[a] + 0.0f;
        uint32_t bits;
        memcpy(&bits, &value, sizeof bits);
        hash = (hash ^ bits) * UINT64_C(0x9e3779b97f4a7c15);
        hash ^= hash >> 32;
    }
    return hash;
}

static bool same_position(const float a[3], const float b[3])
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

/* Table slot of a position: holds the first vertex there, or is free. */
static uint32_t find_slot(const struct vox_smooth *s, const struct fmt_tris_chunk *chunk,
                          const float p[3])
{
    uint32_t slot = (uint32_t)hash_position(p) & s->slot_mask;
    while (s->table[slot] && !same_position(chunk->positions[s->table[slot] - 1], p))
        slot = (slot + 1) & s->slot_mask;
    return slot;
}

static void enter_vertices(struct vox_smooth *s, const struct fmt_tris_chunk *chunk)
{
    memset(s->table, 0, ((uint64_t)s->slot_mask + 1) * sizeof *s->table);
    memset(s->sums, 0, (uint64_t)chunk->vertex_count * sizeof *s->sums);
    for (uint32_t v = 0; v < chunk->vertex_count; v++) {
        uint32_t slot = find_slot(s, chunk, chunk->positions[v]);
        if (!s->table[slot])
            s->table[slot] = v + 1;
        s->twins[v] = s->table[slot] - 1;
    }
}

/* ---- sums ---- */

/* Twice the area vector, and its length. */
static void area_vector(const float a[3], const float b[3], const float c[3], double n[4])
{
    double u[3], v[3];
    for (int k = 0; k < 3; k++) {
        u[k] = (double)b[k] - (double)a[k];
        v[k] = (double)c[k] - (double)a[k];
    }
    n[0] = u[1] * v[2] - u[2] * v[1];
    n[1] = u[2] * v[0] - u[0] * v[2];
    n[2] = u[0] * v[1] - u[1] * v[0];
    n[3] = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

static void add(double sum[4], const double n[4])
{
    for (int k = 0; k < 4; k++)
        sum[k] += n[k];
}

static void add_own(struct vox_smooth *s, const struct fmt_tris_chunk *chunk)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const uint32_t *v = chunk->triangles[t];
        double n[4];
        area_vector(chunk->positions[v[0]], chunk->positions[v[1]], chunk->positions[v[2]], n);
        for (int i = 0; i < 3; i++)
            add(s->sums[s->twins[v[i]]], n);
    }
}

static bool inside(const struct fmt_tris_chunk_info *info, const float p[3])
{
    bool in = true;
    for (int a = 0; a < 3; a++)
        in = in && p[a] >= info->bounds_min[a] && p[a] <= info->bounds_max[a];
    return in;
}

static void add_neighbour(struct vox_smooth *s, const struct fmt_tris_chunk *chunk,
                          const struct fmt_tris_chunk_info *info,
                          const struct fmt_tris_chunk *other)
{
    for (uint32_t t = 0; t < other->triangle_count; t++) {
        const uint32_t *v = other->triangles[t];
        for (int i = 0; i < 3; i++) {
            const float *p = other->positions[v[i]];
            uint32_t slot;
            double n[4];
            if (!inside(info, p) || !s->table[slot = find_slot(s, chunk, p)])
                continue;
            area_vector(other->positions[v[0]], other->positions[v[1]], other->positions[v[2]], n);
            add(s->sums[s->table[slot] - 1], n);
        }
    }
}

static bool touch(const struct fmt_tris_chunk_info *a, const struct fmt_tris_chunk_info *b)
{
    bool yes = true;
    for (int k = 0; k < 3; k++)
        yes = yes && a->bounds_min[k] <= b->bounds_max[k] && b->bounds_min[k] <= a->bounds_max[k];
    return yes;
}

static int sum_normals(struct vox_smooth *s, uint64_t index, const struct fmt_tris_chunk *chunk)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(s->file);
    uint64_t count = fmt_tris_get_header(s->file)->chunk_count;
    enter_vertices(s, chunk);
    for (uint64_t i = 0; i < count; i++) {
        struct fmt_tris_chunk other;
        if (i == index) {
            add_own(s, chunk);
        } else if (touch(&infos[i], &infos[index])) {
            int status = fmt_tris_load(s->file, i, s->scratch, &other);
            if (status < 0)
                return status;
            add_neighbour(s, chunk, &infos[index], &other);
        }
    }
    return 0;
}

int vox_smooth_normals(struct vox_smooth *s, uint64_t index, const struct fmt_tris_chunk *chunk,
                       float (*normals)[3])
{
    pthread_mutex_lock(&s->lock);
    int status = sum_normals(s, index, chunk);
    for (uint32_t v = 0; status == 0 && v < chunk->vertex_count; v++) {
        const double *n = s->sums[s->twins[v]];
        double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        bool smooth = length > 0 && length >= FMT_TRIS_CREASE_SHARE * n[3];
        for (int k = 0; k < 3; k++)
            normals[v][k] = smooth ? (float)(n[k] / length) : 0.0f;
    }
    pthread_mutex_unlock(&s->lock);
    return status;
}

/* chunk_build.c - see chunk_build.h.
 *
 * Corners share a vertex of the chunk if all of their values are equal. Values are compared, not
 * indices, because some scans repeat each vertex for each face. Sorted neighbours share most of
 * their corners, so a small cache of recent corners finds most vertices without their values. */
#include "libvoxel/chunk/chunk_build.h"
#include "base/geometry/vec.h"

#define MAX_VERTICES   (3 * FMT_TRIS_CHUNK_TRIANGLES)
#define MIN_TABLE_BITS 16u /* for meshes, which have about one vertex for two triangles */
#define MAX_TABLE_BITS 19u

/* A table entry has the vertex number plus one in its low bits and bits of the hash above; 0:
 * empty. */
#define NUMBER_BITS 18u
#define NUMBER_MASK ((1u << NUMBER_BITS) - 1)
_Static_assert(MAX_VERTICES < NUMBER_MASK, "a vertex number must fit");

#define CACHE_BITS       11u
#define PLAIN_CACHE_BITS 12u
/* Tuples are in the order of their bucket, not of the chunk, so the next ones are prefetched. */
#define PREFETCH_AHEAD 8u

/* ---- memory ---- */

uint64_t vox_chunk_builder_bytes(uint32_t attributes)
{
    uint64_t vertex =
        12 + (attributes & FMT_TRIS_NORMALS ? 4 : 0) + (attributes & FMT_TRIS_TEXCOORDS ? 8 : 0) +
        (attributes & FMT_TRIS_COLORS ? 4 : 0) + (attributes & FMT_TRIS_FINE_COLORS ? 4 : 0);
    uint64_t triangle = 12 + (attributes & FMT_TRIS_MATERIALS ? 4 : 0);
    return vertex * MAX_VERTICES + triangle * FMT_TRIS_CHUNK_TRIANGLES +
           ((uint64_t)4 << MAX_TABLE_BITS) + (sizeof(struct corner_cache) << CACHE_BITS) +
           (sizeof(uint64_t) << PLAIN_CACHE_BITS) +
           fmt_tris_encoded_bound(attributes | FMT_TRIS_SAMPLES, FMT_TRIS_CHUNK_TRIANGLES,
                                  MAX_VERTICES);
}

int vox_chunk_builder_init(struct chunk_builder *b, const struct scan *scan,
                           const struct tuple_layout *layout)
{
    const char *what = "building chunks";
    const uint32_t attributes = scan->attributes;
    uint64_t bound = fmt_tris_encoded_bound(scan_stored_attributes(scan), FMT_TRIS_CHUNK_TRIANGLES,
                                            MAX_VERTICES);
    *b = (struct chunk_builder){.ctx = scan->ctx, .scan = scan, .layout = layout};
    BSQ_PASS(bsq_alloc(b->ctx, what, MAX_VERTICES, 12, &b->positions));
    BSQ_PASS(bsq_alloc(b->ctx, what, FMT_TRIS_CHUNK_TRIANGLES, 12, &b->triangles));
    BSQ_PASS(bsq_alloc(b->ctx, what, (uint64_t)1 << MAX_TABLE_BITS, 4, &b->table));
    BSQ_PASS(BSQ_ALLOC(b->ctx, what, (uint64_t)1 << CACHE_BITS, &b->cache));
    BSQ_PASS(BSQ_ALLOC(b->ctx, what, (uint64_t)1 << PLAIN_CACHE_BITS, &b->plain));
    BSQ_PASS(bsq_alloc(b->ctx, what, bound, 1, &b->encoded));
    if (attributes & FMT_TRIS_NORMALS)
        BSQ_PASS(bsq_alloc(b->ctx, what, MAX_VERTICES, 4, &b->normals));
    if (attributes & FMT_TRIS_TEXCOORDS)
        BSQ_PASS(bsq_alloc(b->ctx, what, MAX_VERTICES, 8, &b->texcoords));
    if (attributes & FMT_TRIS_COLORS)
        BSQ_PASS(bsq_alloc(b->ctx, what, MAX_VERTICES, 4, &b->colors));
    if (attributes & FMT_TRIS_FINE_COLORS)
        BSQ_PASS(bsq_alloc(b->ctx, what, MAX_VERTICES, 4, &b->fine_colors));
    if (attributes & FMT_TRIS_MATERIALS)
        BSQ_PASS(bsq_alloc(b->ctx, what, FMT_TRIS_CHUNK_TRIANGLES, 4, &b->materials));
    return 0;
}

void vox_chunk_builder_free(struct chunk_builder *b)
{
    if (!b->ctx)
        return;
    BSQ_FREE(b->ctx, b->positions, b->normals, b->texcoords, b->colors, b->fine_colors,
             b->triangles, b->materials, b->table, b->cache, b->plain, b->encoded);
    memset(b, 0, sizeof *b);
}

/* ---- vertices ---- */

static inline uint64_t build_mix(uint64_t h, uint64_t value)
{
    h = (h ^ value) * 0x9e3779b97f4a7c15u;
    return h ^ h >> 32;
}

static inline uint64_t build_hash_position(const float position[3])
{
    uint64_t xy;
    uint32_t z;
    memcpy(&xy, position, 8);
    memcpy(&z, position + 2, 4);
    return build_mix(build_mix(0, xy), z);
}

static inline uint64_t hash_vertex(const struct chunk_builder *b, const struct vertex *v)
{
    uint64_t h = build_hash_position(v->position), uv;
    if (b->scan->attributes == 0)
        return h;
    memcpy(&uv, v->texcoord, 8);
    return build_mix(build_mix(h, uv), (uint64_t)v->normal << 32 | v->color);
}

/* Compares bit by bit, so that 0 and -0 stay different. */
static inline bool same_vertex(const struct chunk_builder *b, uint32_t number,
                               const struct vertex *v)
{
    /* NOLINTBEGIN(bugprone-suspicious-memory-comparison): see above */
    return memcmp(b->positions[number], v->position, 12) == 0 &&
           (!b->normals || b->normals[number] == v->normal) &&
           (!b->texcoords || memcmp(b->texcoords[number], v->texcoord, 8) == 0) &&
           (!b->colors || b->colors[number] == v->color) &&
           (!b->fine_colors || b->fine_colors[number] == v->fine_color);
    /* NOLINTEND(bugprone-suspicious-memory-comparison) */
}

static uint64_t hash_stored(const struct chunk_builder *b, uint32_t number)
{
    struct vertex v = {.color = b->colors ? b->colors[number] : 0,
                       .normal = b->normals ? b->normals[number] : 0};
    memcpy(v.position, b->positions[number], 12);
    if (b->texcoords)
        memcpy(v.texcoord, b->texcoords[number], 8);
    return hash_vertex(b, &v);
}

static inline uint32_t table_cell(const struct chunk_builder *b, uint64_t hash)
{
    return (uint32_t)(hash >> (64 - b->table_bits));
}

static inline uint32_t table_entry(uint64_t hash, uint32_t number)
{
    return (uint32_t)hash << NUMBER_BITS | (number + 1);
}

static void clear_table(struct chunk_builder *b, uint32_t bits)
{
    b->table_bits = bits;
    memset(b->table, 0, (size_t)4 << bits);
}

static void enlarge_table(struct chunk_builder *b)
{
    clear_table(b, MAX_TABLE_BITS);
    const uint32_t mask = (1u << b->table_bits) - 1;
    for (uint32_t number = 0; number < b->vertex_count; number++) {
        uint64_t hash = hash_stored(b, number);
        uint32_t cell = table_cell(b, hash);
        while (b->table[cell] != 0)
            cell = (cell + 1) & mask;
        b->table[cell] = table_entry(hash, number);
    }
}

/* Assigns the next number to the vertex whose values were stored last. */
static inline uint32_t enter_vertex(struct chunk_builder *b, uint32_t cell, uint64_t hash)
{
    uint32_t number = b->vertex_count++;
    b->table[cell] = table_entry(hash, number);
    if (b->table_bits < MAX_TABLE_BITS && b->vertex_count > (3u << b->table_bits) / 4)
        enlarge_table(b);
    return number;
}

static uint32_t build_add_vertex(struct chunk_builder *b, const struct vertex *v, uint32_t cell,
                                 uint64_t hash)
{
    const uint32_t number = b->vertex_count;
    memcpy(b->positions[number], v->position, 12);
    if (b->normals)
        b->normals[number] = v->normal;
    if (b->texcoords)
        memcpy(b->texcoords[number], v->texcoord, 8);
    if (b->colors)
        b->colors[number] = v->color;
    if (b->fine_colors)
        b->fine_colors[number] = v->fine_color;
    return enter_vertex(b, cell, hash);
}

/* Returns the number of the vertex in the chunk. Adds it if it is new. */
static inline uint32_t number_hashed(struct chunk_builder *b, const struct vertex *v, uint64_t hash)
{
    const uint32_t mask = (1u << b->table_bits) - 1;
    uint32_t cell = table_cell(b, hash), entry;
    while ((entry = b->table[cell]) != 0) {
        uint32_t number = (entry & NUMBER_MASK) - 1;
        if (entry == table_entry(hash, number) && same_vertex(b, number, v))
            return number;
        cell = (cell + 1) & mask;
    }
    return build_add_vertex(b, v, cell, hash);
}

static inline uint32_t number_vertex(struct chunk_builder *b, const struct vertex *v)
{
    return number_hashed(b, v, hash_vertex(b, v));
}

/* ---- triangles ---- */

static uint32_t face_normal(const struct vertex corners[3])
{
    double u[3], v[3], n[3], largest = 0.0;
    for (int i = 0; i < 3; i++) {
        u[i] = (double)corners[1].position[i] - corners[0].position[i];
        v[i] = (double)corners[2].position[i] - corners[0].position[i];
    }
    for (int i = 0; i < 3; i++) {
        n[i] = u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3];
        largest = fmax(largest, fabs(n[i]));
    }
    /* Scales in double: as float, small triangles would have no normal. */
    struct bsq_vec3 scaled =
        bsq_v3((float)(n[0] / largest), (float)(n[1] / largest), (float)(n[2] / largest));
    return bsq_oct_pack(bsq_unit3(scaled));
}

/* Numbers the corners that are not in the cache. known: mask of those that are. */
static void number_corners(struct chunk_builder *b, const uint8_t *tuple, uint32_t known,
                           struct corner_cache *const cached[3], const struct corner_tag tags[3],
                           uint32_t numbers[3])
{
    const uint32_t bytes = b->layout->corner_bytes;
    struct vertex corners[3];
    for (uint32_t k = 0; k < 3; k++)
        if (!(known >> k & 1) || b->normals)
            vox_tuple_vertex(b->layout, b->scan, tuple + k * bytes, &corners[k]);
    for (uint32_t k = 0; k < 3; k++) {
        if (known >> k & 1)
            continue;
        /* A corner without a normal gets its triangle's, so the cache cannot know its vertex. */
        bool own = b->normals && corners[k].normal == SCAN_NO_NORMAL;
        if (own)
            corners[k].normal = face_normal(corners);
        numbers[k] = number_vertex(b, &corners[k]);
        if (!own && cached[k])
            *cached[k] = (struct corner_cache){tags[k], numbers[k]};
    }
}

static inline struct corner_tag corner_tag(const uint8_t *corner, uint32_t bytes)
{
    if (bytes <= 8)
        return (struct corner_tag){tuple_load(corner, bytes), 0};
    return (struct corner_tag){tuple_load(corner, 8), tuple_load(corner + 8, bytes - 8)};
}

static inline void build_add_triangle(struct chunk_builder *b, const uint8_t *tuple,
                                      uint32_t numbers[3])
{
    const uint32_t bytes = b->layout->corner_bytes;
    struct corner_cache *cached[3] = {NULL, NULL, NULL};
    struct corner_tag tags[3];
    uint32_t known = 0;
    for (uint32_t k = 0; bytes <= sizeof tags[0] && k < 3; k++) {
        tags[k] = corner_tag(tuple + k * bytes, bytes);
        cached[k] = &b->cache[build_mix(tags[k].low, tags[k].high) >> (64 - CACHE_BITS)];
        if (cached[k]->tag.low == tags[k].low && cached[k]->tag.high == tags[k].high) {
            numbers[k] = cached[k]->number;
            known |= 1u << k;
        }
    }
    if (known != 7)
        number_corners(b, tuple, known, cached, tags, numbers);
}

static void build_triangles(struct chunk_builder *b, const uint8_t *tuples,
                            const struct entry *entries, uint32_t count)
{
    const struct tuple_layout *layout = b->layout;
    memset(b->cache, 0xff, sizeof *b->cache << CACHE_BITS);
    for (uint32_t t = 0; t < count; t++) {
        const uint8_t *tuple = tuples + (uint64_t)entries[t].tuple * layout->bytes;
        if (t + PREFETCH_AHEAD < count)
            __builtin_prefetch(tuples +
                               (uint64_t)entries[t + PREFETCH_AHEAD].tuple * layout->bytes);
        build_add_triangle(b, tuple, b->triangles[t]);
        if (b->materials)
            b->materials[t] = tuple_material(layout, tuple);
    }
}

/* ---- plain tuples ----
 *
 * Two things cost time: cache misses at a new vertex's position and at its table entry, and
 * branches on which corners are known. So triangles are numbered in groups. First, all corners of
 * the group that are not in the small cache are collected without branches; they are pending. Then
 * each step runs over all pending corners and prefetches for the next step. Until a pending corner
 * has its number, the cache holds its index in the list, marked with PENDING_FLAG. */

#define GROUP_TRIANGLES 128u
#define PENDING_FLAG    (1u << 31)

/* The element after the last one is scratch for find_pending(). */
struct pending_corners {
    uint32_t index[3 * GROUP_TRIANGLES + 1], number[3 * GROUP_TRIANGLES + 1];
    uint64_t hash[3 * GROUP_TRIANGLES];
};

static inline uint64_t *plain_place(uint64_t *cache, uint32_t index)
{
    return &cache[index * 0x9e3779b1u >> (32 - PLAIN_CACHE_BITS)];
}

/* Collects the corners that are not in the cache and returns their count. `out` gets numbers of
 * vertices or of pending corners. An empty entry of the cache has an index that no scan has. */
static uint32_t find_pending(uint64_t *cache, const uint8_t *tuples, const struct entry *entries,
                             uint32_t count, uint32_t (*out)[3], struct pending_corners *pending)
{
    const uint64_t flag = (uint64_t)PENDING_FLAG << 32;
    uint64_t pending_count = 0;
    for (uint32_t t = 0; t < count; t++) {
        const uint8_t *tuple = tuples + (uint64_t)entries[t].tuple * 12;
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t index;
            memcpy(&index, tuple + 4 * k, 4);
            uint64_t *place = plain_place(cache, index), cached = *place;
            uint64_t unknown = (uint32_t)cached != index;
            cached ^= (cached ^ (flag | pending_count << 32 | index)) & (0 - unknown);
            *place = cached;
            out[t][k] = (uint32_t)(cached >> 32);
            pending->index[pending_count] = index;
            pending_count += unknown;
        }
    }
    return (uint32_t)pending_count;
}

/* Does what number_hashed() does for a vertex that is only a position. */
static inline uint32_t number_position(struct chunk_builder *b, const float position[3],
                                       uint64_t hash)
{
    const uint32_t mask = (1u << b->table_bits) - 1;
    uint32_t cell = table_cell(b, hash), entry;
    for (; (entry = b->table[cell]) != 0; cell = (cell + 1) & mask) {
        uint32_t number = (entry & NUMBER_MASK) - 1;
        /* NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): bit by bit, as same_vertex() */
        if (entry == table_entry(hash, number) && memcmp(b->positions[number], position, 12) == 0)
            return number;
    }
    memcpy(b->positions[b->vertex_count], position, 12);
    return enter_vertex(b, cell, hash);
}

static void number_pending(struct chunk_builder *b, struct pending_corners *pending,
                           uint32_t pending_count)
{
    const struct attribute_stream positions = b->scan->streams[SCAN_POSITIONS];
    for (uint32_t i = 0; i < pending_count; i++)
        __builtin_prefetch(stream_at(&positions, pending->index[i], 12));
    for (uint32_t i = 0; i < pending_count; i++) {
        pending->hash[i] = build_hash_position(stream_at(&positions, pending->index[i], 12));
        __builtin_prefetch(&b->table[table_cell(b, pending->hash[i])]);
    }
    for (uint32_t i = 0; i < pending_count; i++) {
        const uint32_t index = pending->index[i];
        uint32_t number = number_position(b, stream_at(&positions, index, 12), pending->hash[i]);
        uint64_t *place = plain_place(b->plain, index);
        if (*place == ((uint64_t)(PENDING_FLAG | i) << 32 | index))
            *place = (uint64_t)number << 32 | index;
        pending->number[i] = number;
    }
}

/* Replaces the numbers of pending corners by those of their vertices, without branches. */
static void resolve_pending(const struct pending_corners *pending, uint32_t *numbers,
                            uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        uint32_t pending_count = 0 - (numbers[i] >> 31),
                 cell = numbers[i] & ~PENDING_FLAG & pending_count;
        numbers[i] = (pending->number[cell] & pending_count) | (numbers[i] & ~pending_count);
    }
}

static void build_plain(struct chunk_builder *b, const uint8_t *tuples, const struct entry *entries,
                        uint32_t count)
{
    struct pending_corners pending;
    pending.number[0] = 0;
    memset(b->plain, 0xff, sizeof *b->plain << PLAIN_CACHE_BITS);
    for (uint32_t first = 0, end; first < count; first = end) {
        end = count - first < GROUP_TRIANGLES ? count : first + GROUP_TRIANGLES;
        for (uint32_t t = end; t < count && t < end + GROUP_TRIANGLES; t++)
            __builtin_prefetch(tuples + (uint64_t)entries[t].tuple * sizeof(uint32_t[3]));
        uint32_t pending_count = find_pending(b->plain, tuples, entries + first, end - first,
                                              b->triangles + first, &pending);
        number_pending(b, &pending, pending_count);
        resolve_pending(&pending, b->triangles[first], 3 * (end - first));
    }
}

int vox_chunk_builder_run(struct chunk_builder *b, const uint8_t *tuples,
                          const struct entry *entries, uint32_t count)
{
    b->vertex_count = 0;
    clear_table(b, MIN_TABLE_BITS);
    if (b->layout->plain)
        build_plain(b, tuples, entries, count);
    else
        build_triangles(b, tuples, entries, count);
    struct fmt_tris_chunk chunk = {
        .triangle_count = count,
        .vertex_count = b->vertex_count,
        .positions = (const float(*)[3])b->positions,
        .normals = b->normals,
        .texcoords = (const float(*)[2])b->texcoords,
        .colors = b->colors,
        .fine_colors = b->fine_colors,
        .triangles = (const uint32_t(*)[3])b->triangles,
        .materials = b->materials,
    };
    return fmt_tris_encode(b->ctx, scan_stored_attributes(b->scan), &chunk, b->encoded,
                           &b->encoded_bytes, &b->info);
}

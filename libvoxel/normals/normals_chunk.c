/* normals_chunk.c - goes through the chunks: sums the one-rings of their vertices.
 *
 * A vertex is closed if the chunk's triangles run through each edge at it as often towards it as
 * away from it. Each one-ring has a random number; a vertex sums the differences of the numbers of
 * the next and the previous neighbour in each of its triangles, which is 0 if each neighbour is
 * both equally often (after Zobrist, "A New Hashing Method with Application for Game Playing",
 * 1970). Differences tell a triangle that is there twice, which closes nothing.
 */
#include "libvoxel/normals/normals_run.h"

#include <string.h>

#include "base/geometry/positions.h"
#include "base/parallel.h"

enum { CREASES = 8192 /* that are divided at a time */, SLOTS_A_THREAD = 2 };

/* A chunk under way: that of the slot's sequence number. */
struct ring_slot {
    struct fmt_tris_chunk tris;
    struct bsq_positions table; /* of vertices */
    struct vox_rings rings;
    const uint32_t *ring_of;        /* by vertex: its one-ring has the number of its first vertex */
    const uint32_t (*triangles)[3]; /* their one-rings, which are vertices too */
    uint32_t *welded, (*welded_triangles)[3]; /* memory for these */
    uint64_t *neighbours;                     /* by one-ring: sums of differences of numbers */
    uint8_t *flags;                           /* by one-ring: VOX_RING_* */
    bool *asked;                              /* by vertex: its normal was asked for */
    uint32_t *open;                           /* triangles at open vertices */
    uint32_t (*folds)[3]; /* one-rings of those at vertices that may be creases */
    uint32_t open_count, fold_count;
    uint64_t *normals;
    uint64_t *firsts, *seconds; /* of the creases that are divided at a time */
    void *scratch;
};

/* ---- memory ---- */

/* Places the arrays of a slot in memory, and returns their bytes. memory: NULL to only count. */
static uint64_t slot_lay_out(const struct normals_run *run, uint8_t *memory, struct ring_slot *s)
{
    const uint64_t vertices = run->vertices, creases = CREASES + 1;
    uint64_t at = 0;
    normals_place_rings(memory, &at, vertices, creases, &s->rings);
    s->table.cells =
        normals_place(memory, &at, bsq_positions_cells(run->vertices), sizeof *s->table.cells);
    s->welded = normals_place(memory, &at, vertices, sizeof *s->welded);
    s->welded_triangles = normals_place(memory, &at, run->triangles, sizeof *s->welded_triangles);
    s->neighbours = normals_place(memory, &at, vertices, sizeof *s->neighbours);
    s->flags = normals_place(memory, &at, vertices, sizeof *s->flags);
    s->asked = normals_place(memory, &at, vertices, sizeof *s->asked);
    s->open = normals_place(memory, &at, run->triangles, sizeof *s->open);
    s->folds = normals_place(memory, &at, run->triangles, sizeof *s->folds);
    s->normals = normals_place(memory, &at, vertices, sizeof *s->normals);
    s->firsts = normals_place(memory, &at, CREASES, sizeof *s->firsts);
    s->seconds = normals_place(memory, &at, CREASES, sizeof *s->seconds);
    s->scratch = normals_place(memory, &at, fmt_tris_load_size_max(run->file), 1);
    return at;
}

/* ---- one-rings ---- */

/* Finds vertices at the same position. Most vertices find their cell of the table free, which
 * processors cannot predict. So the others are put off without a branch, and looked up after all
 * first ones have cells. */
static void weld_vertices(struct ring_slot *s)
{
    uint32_t *late = s->rings.crease_of, late_count = 0;
    const uint32_t count = s->tris.vertex_count;
    s->table.positions = s->tris.positions;
    s->table.mask = bsq_positions_cells(count) - 1;
    memset(s->table.cells, 0, (s->table.mask + UINT64_C(1)) * sizeof *s->table.cells);
    for (uint32_t v = 0; v < count; v++) {
        uint32_t *cell = &s->table.cells[bsq_position_hash(s->tris.positions[v]) & s->table.mask];
        const uint32_t taken = *cell != 0;
        *cell = taken ? *cell : v + 1;
        s->welded[v] = v;
        late[late_count] = v;
        late_count += taken;
    }
    for (uint32_t i = 0; i < late_count; i++) {
        const uint32_t v = late[i];
        uint32_t *cell = bsq_positions_find(&s->table, s->tris.positions[v]);
        if (*cell == 0)
            *cell = v + 1;
        s->welded[v] = *cell - 1;
    }
    for (uint32_t t = 0; t < s->tris.triangle_count; t++)
        for (int i = 0; i < 3; i++)
            s->welded_triangles[t][i] = s->welded[s->tris.triangles[t][i]];
    s->ring_of = s->welded;
    s->triangles = (const uint32_t(*)[3])s->welded_triangles;
}

/* Finds which one-rings are open, and which others may be creases. */
static void flag_rings(const struct normals_run *run, struct ring_slot *s)
{
    const uint32_t count = s->tris.vertex_count;
    const uint32_t(*triangles)[3] = s->triangles;
    const double(*units)[4] = (const double(*)[4])s->rings.units;
    const uint64_t *numbers = run->numbers;
    uint64_t *neighbours = s->neighbours;
    uint8_t *flags = s->flags;
    memset(neighbours, 0, count * sizeof *neighbours);
    for (uint32_t t = 0; t < s->tris.triangle_count; t++) {
        const uint32_t a = triangles[t][0], b = triangles[t][1], c = triangles[t][2];
        const uint64_t x = numbers[a], y = numbers[b], z = numbers[c];
        neighbours[a] += y - z;
        neighbours[b] += z - x;
        neighbours[c] += x - y;
    }
    for (uint32_t ring = 0; ring < count; ring++)
        flags[ring] =
            neighbours[ring] != 0 ? VOX_RING_OPEN : vox_ring_folds(run->weights, units[ring]);
}

/* Lists the triangles at open vertices, and at those that may be creases. */
static void list_triangles(struct ring_slot *s)
{
    const uint8_t *flags = s->flags;
    s->open_count = s->fold_count = 0;
    for (uint32_t t = 0; t < s->tris.triangle_count; t++) {
        const uint32_t *rings = s->triangles[t];
        const unsigned any = flags[rings[0]] | flags[rings[1]] | flags[rings[2]];
        if (any & VOX_RING_OPEN)
            s->open[s->open_count++] = t;
        if (any & VOX_RING_FOLDS)
            memcpy(s->folds[s->fold_count++], rings, sizeof *s->folds);
    }
}

/* Adds the answers for the creases among `count` one-rings that were divided. */
static int answer_creases(struct normals_run *run, uint32_t chunk, const struct ring_slot *s,
                          uint32_t count)
{
    vox_rings_pack_fn *const pack = BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_pack);
    int status = 0;
    pack((const double(*)[4])s->rings.firsts, run->own_rings + 1, count, s->firsts);
    pack((const double(*)[4])s->rings.seconds, run->own_rings + 1, count, s->seconds);
    pthread_mutex_lock(&run->lock);
    for (uint32_t v = 0; v < s->tris.vertex_count && status == 0; v++) {
        const uint32_t crease = s->rings.crease_of[s->ring_of[v]];
        if (crease > 0)
            status = vox_normals_answer(run, &(struct normals_answer){chunk, v | ANSWER_CREASE,
                                                                      s->firsts[crease - 1],
                                                                      s->seconds[crease - 1]});
    }
    pthread_mutex_unlock(&run->lock);
    return status;
}

/* Divides the creases among the closed vertices. */
static int divide_creases(struct normals_run *run, uint32_t chunk, struct ring_slot *s)
{
    vox_rings_add_fn *const add = BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_add);
    const uint32_t(*folds)[3] = (const uint32_t(*)[3])s->folds;
    const uint32_t rings = s->tris.vertex_count;
    const float(*positions)[3] = s->tris.positions;
    uint32_t count;
    memset(s->rings.crease_of, 0, rings * sizeof *s->rings.crease_of);
    for (uint32_t begin = 0; begin < rings;) {
        begin = vox_rings_number_creases(&s->rings, s->flags, begin, rings, CREASES, &count);
        if (count == 0)
            continue;
        add(&s->rings, VOX_RING_FARTHEST, run->weights, positions, folds, folds, s->fold_count);
        if (vox_rings_divide(&s->rings, count)) {
            add(&s->rings, VOX_RING_SIDES, run->weights, positions, folds, folds, s->fold_count);
            vox_rings_decide(&s->rings, count);
            BSQ_PASS(answer_creases(run, chunk, s, count));
        }
        for (uint32_t i = 1; i <= count; i++)
            s->rings.crease_of[s->rings.crease_rings[i]] = 0;
    }
    return 0;
}

/* ---- the pipeline ---- */

static int visit_work(void *arg, void *slot, uint64_t chunk, unsigned worker)
{
    struct normals_run *run = arg;
    struct ring_slot *s = slot;
    (void)worker;
    BSQ_PASS(fmt_tris_load(run->file, chunk, s->scratch, &s->tris));
    s->ring_of = run->own_rings;
    s->triangles = s->tris.triangles;
    /* Without attributes, vertices of a chunk are at different positions; if two were not, both
     * would be open, and be joined by position. */
    if (s->tris.texcoords || s->tris.colors)
        weld_vertices(s);
    vox_rings_clear(&s->rings, 0, s->tris.vertex_count);
    BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_add)
    (&s->rings, VOX_RING_SUM, run->weights, s->tris.positions, s->triangles, s->triangles,
     s->tris.triangle_count);
    BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_pack)
    ((const double(*)[4])s->rings.sums, s->ring_of, s->tris.vertex_count, s->normals);
    flag_rings(run, s);
    list_triangles(s);
    BSQ_PASS(divide_creases(run, (uint32_t)chunk, s));
    return fmt_tris_normals_put(run->writer, chunk, s->normals);
}

/* Sends the corners of a triangle that are at open vertices. */
static int send_triangle(struct normals_run *run, uint32_t chunk, struct ring_slot *s,
                         const uint32_t v[3])
{
    struct open_corner record = {.chunk = chunk};
    for (int i = 0; i < 3; i++)
        memcpy(record.triangle[i], s->tris.positions[v[i]], sizeof record.triangle[i]);
    for (uint32_t i = 0; i < 3; i++) {
        if (!(s->flags[s->ring_of[v[i]]] & VOX_RING_OPEN))
            continue;
        record.vertex = v[i] | i << OPEN_CORNER_SHIFT | (s->asked[v[i]] ? UINT32_C(0) : OPEN_ASKS);
        s->asked[v[i]] = true;
        const uint32_t hash = bsq_position_hash(record.triangle[i]);
        BSQ_PASS(bsq_spill_add(&run->corners, normals_bucket(hash, run->corners.stream_count),
                               &record, sizeof record));
    }
    return 0;
}

static int visit_emit(void *arg, void *slot, uint64_t sequence)
{
    const uint32_t chunk = (uint32_t)sequence;
    struct normals_run *run = arg;
    struct ring_slot *s = slot;
    memset(s->asked, 0, s->tris.vertex_count * sizeof *s->asked);
    for (uint32_t i = 0; i < s->open_count; i++)
        BSQ_PASS(send_triangle(run, chunk, s, s->tris.triangles[s->open[i]]));
    bsq_progress_add(run->ctx, 1);
    return 0;
}

int vox_normals_visit_chunks(struct normals_run *run)
{
    struct ring_slot *slots = NULL, counted = {0};
    const uint64_t bytes = slot_lay_out(run, NULL, &counted), left = bsq_memory_left(run->ctx) / 2,
                   usual = (uint64_t)SLOTS_A_THREAD * bsq_threads(run->ctx);
    const uint64_t fits = left / bytes < usual ? left / bytes : usual;
    const uint64_t count = fits > run->chunk_count ? run->chunk_count : fits > 0 ? fits : 1;
    uint8_t *memory = NULL;
    int status;
    BSQ_TRY(BSQ_CALLOC(run->ctx, "normals", count, &slots));
    BSQ_TRY(bsq_alloc(run->ctx, "normals", count, bytes, &memory));
    for (uint64_t i = 0; i < count; i++)
        slot_lay_out(run, memory + i * bytes, &slots[i]);
    const struct bsq_pipeline pipeline = {.produce = vox_normals_produce,
                                          .work = visit_work,
                                          .emit = visit_emit,
                                          .arg = run,
                                          .slots = slots,
                                          .slot_size = sizeof *slots,
                                          .slot_count = (unsigned)count};
    status = bsq_pipeline_run(run->ctx, &pipeline);
done:
    BSQ_FREE(run->ctx, memory, slots);
    return status;
}

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
    uint32_t *ring_of; /* by vertex; a one-ring has the number of its first vertex, plus 1 */
    uint32_t *open_triangles, open_count;
    uint64_t *random;     /* by one-ring: constant numbers */
    uint64_t *neighbours; /* by one-ring: sums of differences of random numbers */
    uint8_t *open;        /* by vertex: OPEN, then ASKED */
    uint64_t *normals;
    uint32_t *numbers;               /* 1, 2, 3 ... CREASES */
    uint64_t *seconds;               /* of the creases that are divided at a time */
    uint64_t *found;                 /* second sides of all creases of the chunk */
    uint32_t *found_of, found_count; /* by one-ring: number in `found`, plus 1 */
    void *scratch;
};
enum { OPEN = 1, ASKED = 2 };

/* ---- memory ---- */

/* Places the arrays of a slot in memory, and returns their bytes. memory: NULL to only count. */
static uint64_t slot_lay_out(const struct normals_run *run, uint8_t *memory, struct ring_slot *s)
{
    const uint64_t vertices = run->vertices, rings = vertices + 1, creases = CREASES + 1;
    const uint64_t most = vertices > run->triangles ? vertices : run->triangles;
    uint64_t at = 0;
    s->rings.sums = normals_place(memory, &at, rings * BSQ_RING_ROWS, sizeof *s->rings.sums);
    s->rings.firsts = normals_place(memory, &at, creases * BSQ_RING_ROWS, sizeof *s->rings.firsts);
    s->rings.seconds =
        normals_place(memory, &at, creases * BSQ_RING_ROWS, sizeof *s->rings.seconds);
    s->rings.creases = normals_place(memory, &at, creases, sizeof *s->rings.creases);
    s->rings.crease_of = normals_place(memory, &at, rings, sizeof *s->rings.crease_of);
    s->table.cells =
        normals_place(memory, &at, bsq_positions_cells(run->vertices), sizeof *s->table.cells);
    s->ring_of = normals_place(memory, &at, vertices, sizeof *s->ring_of);
    s->open_triangles = normals_place(memory, &at, most, sizeof *s->open_triangles);
    s->random = normals_place(memory, &at, rings, sizeof *s->random);
    s->neighbours = normals_place(memory, &at, rings, sizeof *s->neighbours);
    s->open = normals_place(memory, &at, vertices, sizeof *s->open);
    s->normals = normals_place(memory, &at, vertices, sizeof *s->normals);
    s->numbers = normals_place(memory, &at, CREASES, sizeof *s->numbers);
    s->seconds = normals_place(memory, &at, CREASES, sizeof *s->seconds);
    s->found = normals_place(memory, &at, vertices, sizeof *s->found);
    s->found_of = normals_place(memory, &at, rings, sizeof *s->found_of);
    s->scratch = normals_place(memory, &at, fmt_tris_load_size_max(run->file), 1);
    return at;
}

/* ---- one-rings ---- */

/* Gives each vertex a one-ring of its own. Without attributes, vertices of a chunk are at different
 * positions; if two were not, both would be open, and be joined by position. */
static void number_vertices(struct ring_slot *s)
{
    for (uint32_t v = 0; v < s->tris.vertex_count; v++)
        s->ring_of[v] = v + 1;
}

/* Finds vertices at the same position. Most vertices find their cell of the table free, which
 * processors cannot predict. So the others are put off without a branch, and looked up after all
 * first ones have cells. */
static void weld_vertices(struct ring_slot *s)
{
    uint32_t *late = s->open_triangles, late_count = 0;
    const uint32_t count = s->tris.vertex_count;
    s->table.positions = s->tris.positions;
    s->table.mask = bsq_positions_cells(count) - 1;
    memset(s->table.cells, 0, (s->table.mask + UINT64_C(1)) * sizeof *s->table.cells);
    for (uint32_t v = 0; v < count; v++) {
        uint32_t *cell = &s->table.cells[bsq_position_hash(s->tris.positions[v]) & s->table.mask];
        const uint32_t taken = *cell != 0;
        *cell = taken ? *cell : v + 1;
        s->ring_of[v] = v + 1;
        late[late_count] = v;
        late_count += taken;
    }
    for (uint32_t i = 0; i < late_count; i++) {
        const uint32_t v = late[i];
        uint32_t *cell = bsq_positions_find(&s->table, s->tris.positions[v]);
        if (*cell == 0)
            *cell = v + 1;
        s->ring_of[v] = *cell;
    }
}

/* Returns a random number (the finishing steps of MurmurHash3, Appleby 2011). */
static uint64_t ring_number(uint64_t ring)
{
    ring *= UINT64_C(0x9e3779b97f4a7c15);
    ring = (ring ^ ring >> 33) * UINT64_C(0xff51afd7ed558ccd);
    return ring ^ ring >> 33;
}

/* Marks open vertices, clears their sums, and lists the triangles at them. */
static void find_open(struct ring_slot *s)
{
    const uint32_t vertices = s->tris.vertex_count, triangles = s->tris.triangle_count;
    const uint32_t(*corners)[3] = s->tris.triangles, *ring_of = s->ring_of;
    const uint64_t *random = s->random;
    uint64_t *neighbours = s->neighbours;
    memset(neighbours, 0, (vertices + UINT64_C(1)) * sizeof *neighbours);
    for (uint32_t t = 0; t < triangles; t++) {
        const uint32_t a = ring_of[corners[t][0]], b = ring_of[corners[t][1]],
                       c = ring_of[corners[t][2]];
        const uint64_t x = random[a], y = random[b], z = random[c];
        neighbours[a] += y - z;
        neighbours[b] += z - x;
        neighbours[c] += x - y;
    }
    for (uint32_t v = 0; v < vertices; v++) {
        const uint64_t ring = s->ring_of[v];
        s->open[v] = neighbours[ring] != 0 ? OPEN : 0;
        if (s->open[v])
            memset(s->rings.sums[ring * BSQ_RING_ROWS], 0, BSQ_RING_ROWS * sizeof *s->rings.sums);
    }
    s->open_count = 0;
    for (uint32_t t = 0; t < triangles; t++) {
        const uint32_t *v = s->tris.triangles[t];
        s->open_triangles[s->open_count] = t;
        s->open_count += s->open[v[0]] | s->open[v[1]] | s->open[v[2]];
    }
}

/* Keeps the second sides of the creases among one-rings from `begin` up to `end`. count: the
 * largest number of one. */
static void keep_seconds(struct ring_slot *s, uint64_t begin, uint64_t end, uint32_t count)
{
    BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_pack)
    ((const double(*)[4])s->rings.seconds, s->numbers, count, s->seconds);
    for (uint64_t ring = begin; ring < end; ring++) {
        const uint32_t crease = s->rings.crease_of[ring];
        if (crease == 0)
            continue;
        s->found[s->found_count] = s->seconds[crease - 1];
        s->found_of[ring] = ++s->found_count;
    }
}

/* Divides the creases among the closed vertices. */
static void divide_creases(const struct normals_run *run, struct ring_slot *s)
{
    vox_rings_add_fn *const add = BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_add);
    const uint64_t rings = s->tris.vertex_count + UINT64_C(1);
    const uint32_t triangles = s->tris.triangle_count;
    uint32_t count;
    memset(s->rings.crease_of, 0, rings * sizeof *s->rings.crease_of);
    memset(s->found_of, 0, rings * sizeof *s->found_of);
    s->found_count = 0;
    for (uint64_t begin = 1, end; begin < rings; begin = end) {
        end = vox_rings_number_creases(&s->rings, run->weights, begin, rings, CREASES, &count);
        if (count == 0)
            continue;
        add(&s->rings, VOX_RING_FARTHEST, run->weights, triangles);
        if (vox_rings_divide(&s->rings, begin, end)) {
            add(&s->rings, VOX_RING_SIDES, run->weights, triangles);
            vox_rings_decide(&s->rings, begin, end);
            keep_seconds(s, begin, end, count);
        }
        memset(&s->rings.crease_of[begin], 0, (end - begin) * sizeof *s->rings.crease_of);
    }
}

/* ---- the pipeline ---- */

static int visit_produce(void *arg, void *slot, uint64_t chunk)
{
    (void)slot;
    return chunk < ((const struct normals_run *)arg)->chunk_count;
}

static int visit_work(void *arg, void *slot, uint64_t chunk, unsigned worker)
{
    const struct normals_run *run = arg;
    struct ring_slot *s = slot;
    (void)worker;
    BSQ_PASS(fmt_tris_load(run->file, chunk, s->scratch, &s->tris));
    if (s->tris.texcoords || s->tris.colors)
        weld_vertices(s);
    else
        number_vertices(s);
    s->rings.positions = s->tris.positions;
    s->rings.triangles = s->tris.triangles;
    s->rings.ring_of = s->ring_of;
    memset(s->rings.sums, 0,
           (s->tris.vertex_count + UINT64_C(1)) * BSQ_RING_ROWS * sizeof *s->rings.sums);
    BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_add)
    (&s->rings, VOX_RING_SUM, run->weights, s->tris.triangle_count);
    find_open(s);
    divide_creases(run, s);
    BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_pack)
    ((const double(*)[4])s->rings.sums, s->ring_of, s->tris.vertex_count, s->normals);
    return fmt_tris_normals_put(run->writer, chunk, s->normals);
}

/* Sends the corners of a triangle that are at open vertices. */
static int send_triangle(struct normals_run *run, uint32_t chunk, struct ring_slot *s,
                         uint32_t triangle)
{
    const uint32_t *v = s->tris.triangles[triangle];
    struct open_corner record = {.chunk = chunk};
    for (int i = 0; i < 3; i++)
        memcpy(record.triangle[i], s->tris.positions[v[i]], sizeof record.triangle[i]);
    for (uint32_t i = 0; i < 3; i++) {
        if (!s->open[v[i]])
            continue;
        record.vertex =
            v[i] | i << OPEN_CORNER_SHIFT | (s->open[v[i]] == OPEN ? OPEN_ASKS : UINT32_C(0));
        s->open[v[i]] = ASKED;
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
    for (uint32_t i = 0; i < s->open_count; i++)
        BSQ_PASS(send_triangle(run, chunk, s, s->open_triangles[i]));
    for (uint32_t v = 0; v < s->tris.vertex_count && s->found_count > 0; v++) {
        const uint32_t found = s->found_of[s->ring_of[v]];
        const struct normals_answer answer = {chunk, v | ANSWER_CREASE, s->normals[v],
                                              found ? s->found[found - 1] : 0};
        BSQ_PASS(found ? vox_normals_answer(run, &answer) : 0);
    }
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
    for (uint64_t i = 0; i < count; i++) {
        slot_lay_out(run, memory + i * bytes, &slots[i]);
        for (uint32_t k = 0; k < CREASES; k++)
            slots[i].numbers[k] = k + 1;
        for (uint32_t r = 0; r <= run->vertices; r++)
            slots[i].random[r] = ring_number(r);
    }
    const struct bsq_pipeline pipeline = {.produce = visit_produce,
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

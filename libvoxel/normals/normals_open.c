/* normals_open.c - sums the one-rings of vertices whose triangles are in several chunks.
 *
 * A bucket has all corners at its positions, in the order of the file. It is read up to four times:
 * for the sums, twice more if there may be creases, and for the vertices that want to know. If
 * there are more positions than fit into memory, the bucket is done in halves, by their hashes. */
#include "libvoxel/normals/normals_run.h"

#include <string.h>

#include "base/geometry/positions.h"
#include "base/parallel.h"

enum { RECORDS = 256 /* that are read at a time */, LEAST_POSITIONS = 1024 };

/* Memory of a worker. */
struct open_worker {
    struct normals_run *run;
    uint32_t most; /* positions */
    uint32_t count;
    struct bsq_positions table;
    float (*positions)[3];
    struct vox_rings rings;
    /* From number 1 on: of one-rings, their normals; of creases, those of both sides. */
    uint64_t *normals, *firsts, *seconds;
    uint8_t *flags;
    /* Of the records that were read: */
    struct open_corner *records;
    float (*corners)[3];
    uint32_t (*triangles)[3], (*ring_of)[3];
};

/* The part of a bucket whose positions have a hash with these bits. */
struct open_part {
    uint32_t bucket, mask, bits;
};

/* Returns other bits of a hash than those that choose a bucket, or a place in a table. */
static uint32_t part_bits(uint32_t hash)
{
    return (uint32_t)(hash * UINT64_C(0x9e3779b97f4a7c15) >> 32);
}

/* ---- memory ---- */

/* Places the arrays of a worker in memory, and returns their bytes. memory: NULL to only count. */
static uint64_t worker_lay_out(uint8_t *memory, struct open_worker *w)
{
    const uint64_t rings = w->most + UINT64_C(1);
    uint64_t at = 0;
    normals_place_rings(memory, &at, rings, rings, &w->rings);
    w->table.cells =
        normals_place(memory, &at, bsq_positions_cells(w->most), sizeof *w->table.cells);
    w->positions = normals_place(memory, &at, w->most, sizeof *w->positions);
    w->normals = normals_place(memory, &at, w->most, sizeof *w->normals);
    w->firsts = normals_place(memory, &at, w->most, sizeof *w->firsts);
    w->seconds = normals_place(memory, &at, w->most, sizeof *w->seconds);
    w->flags = normals_place(memory, &at, rings, sizeof *w->flags);
    w->records = normals_place(memory, &at, RECORDS, sizeof *w->records);
    w->corners = normals_place(memory, &at, 3 * RECORDS + 1, sizeof *w->corners);
    w->triangles = normals_place(memory, &at, RECORDS, sizeof *w->triangles);
    w->ring_of = normals_place(memory, &at, RECORDS, sizeof *w->ring_of);
    return at;
}

/* ---- a part of a bucket ---- */

/* Finds the one-ring of a position, or makes it. Returns false if there is no space for it. */
static bool find_ring(struct open_worker *w, const float position[3], uint32_t hash, uint32_t *ring)
{
    uint32_t *cell = bsq_positions_find_hashed(&w->table, position, hash);
    if (*cell == 0) {
        if (w->count == w->most)
            return false;
        memcpy(w->positions[w->count], position, sizeof *w->positions);
        *cell = ++w->count;
        vox_rings_clear(&w->rings, *cell, 1);
    }
    *ring = *cell;
    return true;
}

/* Reads the next records of the bucket, from `first` on, and finds the one-rings of their corners.
 * *fits: false if there is no space for one. */
static int read_records(struct open_worker *w, const struct open_part *part, uint64_t first,
                        uint32_t count, struct bsq_spill_cursor *cursor, bool *fits)
{
    BSQ_PASS(bsq_spill_read(&w->run->corners, part->bucket, first * sizeof *w->records,
                            count * sizeof *w->records, w->records, cursor));
    memset(w->ring_of, 0, RECORDS * sizeof *w->ring_of);
    for (uint32_t i = 0; i < count && *fits; i++) {
        const struct open_corner *record = &w->records[i];
        const uint32_t corner = record->vertex >> OPEN_CORNER_SHIFT & 3;
        const uint32_t hash = bsq_position_hash(record->triangle[corner]);
        memcpy(w->corners[3 * i], record->triangle, sizeof record->triangle);
        if ((part_bits(hash) & part->mask) == part->bits)
            *fits = find_ring(w, record->triangle[corner], hash, &w->ring_of[i][corner]);
    }
    return 0;
}

/* Adds the answers that the records ask for. */
static int answer_records(struct open_worker *w, uint32_t count)
{
    int status = 0;
    pthread_mutex_lock(&w->run->lock);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        const struct open_corner *record = &w->records[i];
        const uint32_t ring = w->ring_of[i][record->vertex >> OPEN_CORNER_SHIFT & 3];
        if (ring == 0 || !(record->vertex & OPEN_ASKS))
            continue;
        const uint32_t crease = w->rings.crease_of[ring];
        const struct normals_answer answer = {
            record->chunk, (record->vertex & OPEN_VERTEX_MASK) | (crease ? ANSWER_CREASE : 0u),
            crease ? w->firsts[crease - 1] : w->normals[ring - 1],
            crease ? w->seconds[crease - 1] : 0};
        status = vox_normals_answer(w->run, &answer);
    }
    pthread_mutex_unlock(&w->run->lock);
    return status;
}

/* Goes through the records of a part: does a step of its sums, or answers. */
static int run_records(struct open_worker *w, const struct open_part *part, bool answers,
                       enum vox_ring_step step, bool *fits)
{
    vox_rings_add_fn *const add = BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_add);
    const uint64_t records = w->run->corners.list[part->bucket].bytes / sizeof *w->records;
    struct bsq_spill_cursor cursor = {0};
    for (uint64_t first = 0; first < records && *fits; first += RECORDS) {
        const uint32_t count =
            records - first < RECORDS ? (uint32_t)(records - first) : (uint32_t)RECORDS;
        BSQ_PASS(bsq_check(w->run->ctx));
        BSQ_PASS(read_records(w, part, first, count, &cursor, fits));
        if (answers)
            BSQ_PASS(answer_records(w, count));
        else if (*fits)
            add(&w->rings, step, w->run->weights, (const float(*)[3])w->corners,
                (const uint32_t(*)[3])w->triangles, (const uint32_t(*)[3])w->ring_of, count);
    }
    return 0;
}

/* Makes the normals of a part. *fits: false if it has too many positions; then nothing was
 * answered. */
static int join_part(struct open_worker *w, const struct open_part *part, bool *fits)
{
    uint32_t creases;
    const uint32_t *own = w->run->own_rings + 1;
    vox_rings_pack_fn *const pack = BSQ_SIMD_PICK(bsq_simd_best(), vox_rings_pack);
    const uint64_t records = w->run->corners.list[part->bucket].bytes / sizeof *w->records;
    vox_rings_clear(&w->rings, 0, 1); /* of corners of no ring */
    *fits = true;
    w->count = 0;
    w->table.mask = bsq_positions_cells(records < w->most ? (uint32_t)records : w->most) - 1;
    memset(w->table.cells, 0, (w->table.mask + UINT64_C(1)) * sizeof *w->table.cells);
    BSQ_PASS(run_records(w, part, false, VOX_RING_SUM, fits));
    if (!*fits)
        return 0;
    pack((const double(*)[4])w->rings.sums, own, w->count, w->normals);
    for (uint32_t ring = 1; ring <= w->count; ring++)
        w->flags[ring] = vox_ring_folds(w->run->weights, w->rings.units[ring]);
    memset(w->rings.crease_of, 0, (w->count + UINT64_C(1)) * sizeof *w->rings.crease_of);
    vox_rings_number_creases(&w->rings, w->flags, 1, w->count + 1, UINT32_MAX, &creases);
    if (creases > 0) {
        BSQ_PASS(run_records(w, part, false, VOX_RING_FARTHEST, fits));
        if (vox_rings_divide(&w->rings, creases)) {
            BSQ_PASS(run_records(w, part, false, VOX_RING_SIDES, fits));
            vox_rings_decide(&w->rings, creases);
        }
        pack((const double(*)[4])w->rings.firsts, own, creases, w->firsts);
        pack((const double(*)[4])w->rings.seconds, own, creases, w->seconds);
    }
    return run_records(w, part, true, VOX_RING_SUM, fits);
}

/* Does a bucket, in as many parts as are needed: halves, and halves of these. */
static int join_bucket(struct open_worker *w, uint32_t bucket)
{
    struct open_part part = {.bucket = bucket};
    for (bool more = true; more;) {
        bool fits;
        BSQ_PASS(join_part(w, &part, &fits));
        if (!fits && part.mask == UINT32_MAX)
            return bsq_fail(w->run->ctx, BSQ_ENOMEM, "too little memory for normals");
        if (!fits) {
            part.mask = 2 * part.mask + 1;
            continue;
        }
        /* The next part: the bits after these, with the highest bit that differs as the last. */
        while (part.mask != 0 && part.bits & (part.mask / 2 + 1)) {
            part.bits &= part.mask / 2;
            part.mask /= 2;
        }
        more = part.mask != 0;
        part.bits |= more ? part.mask / 2 + 1 : 0;
    }
    return 0;
}

/* ---- all buckets ---- */

static int join_index(void *arg, uint64_t index, unsigned worker)
{
    struct open_worker *workers = arg;
    return join_bucket(&workers[worker], (uint32_t)index);
}

static int make_worker(struct normals_run *run, uint32_t most, struct open_worker *w)
{
    uint8_t *memory;
    *w = (struct open_worker){.run = run, .most = most};
    BSQ_PASS(bsq_alloc(run->ctx, "normals", worker_lay_out(NULL, w), 1, &memory));
    worker_lay_out(memory, w);
    w->table.positions = (const float(*)[3])w->positions;
    for (uint32_t i = 0; i < 3 * RECORDS; i++)
        w->triangles[i / 3][i % 3] = i;
    return 0;
}

int vox_normals_join_corners(struct normals_run *run)
{
    const unsigned threads = bsq_threads(run->ctx);
    const uint64_t share = bsq_memory_left(run->ctx) / 2 / threads;
    struct open_worker *workers = NULL;
    struct open_worker one = {.most = LEAST_POSITIONS};
    uint64_t most = share / worker_lay_out(NULL, &one) * LEAST_POSITIONS;
    most = most < LEAST_POSITIONS ? LEAST_POSITIONS : most;
    most = most > NORMALS_RINGS ? NORMALS_RINGS : most;
    int status = BSQ_CALLOC(run->ctx, "normals", threads, &workers);
    for (unsigned i = 0; i < threads && status == 0; i++)
        status = make_worker(run, (uint32_t)most, &workers[i]);
    if (status == 0)
        status = bsq_parallel_for(run->ctx, run->corners.stream_count, join_index, workers);
    for (unsigned i = 0; workers && i < threads; i++)
        bsq_free(run->ctx, workers[i].rings.sums);
    bsq_free(run->ctx, workers);
    return status;
}

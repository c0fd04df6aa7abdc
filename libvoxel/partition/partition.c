/* partition.c - see partition.h.
 *
 * The serial step of the reader appends vertices to their streams. When the first faces come, all
 * vertices are known: so are the cube around the scan and, if positions are in a file, the bucket
 * of each vertex. From then on all threads triangulate batches of faces. A second serial step
 * copies the result to the buckets, in the order of the file. */
#include "base/context.h"
#include "libvoxel/partition/partition.h"
#include "libvoxel/partition/triangulate.h"

#include <inttypes.h>
#include <string.h>

#define MIB ((uint64_t)1 << 20)
/* Memory that a batch usually takes in the reader and in its triangulator. */
#define BLOCK_BYTES (6 * MIB)
/* Corner numbers of a batch are 32-bit numbers with bits to spare. */
#define MAX_CORNERS (UINT32_MAX / 32)

struct batch_slot {
    struct triangulator triangulator;
    struct scan_face_check check;
};

struct reading {
    struct scan *scan;
    const char *beside;
    struct partition *out;
    enum partition_passes passes;
    bool elements, faces; /* what this pass keeps */
    bool begun;           /* faces have come */
    uint64_t used_before; /* bytes of the budget, before reading */
    struct batch_slot *slots;
    unsigned slot_count;
    struct triangulation rules;
    bool spilled;                         /* positions are in a file, after faces have begun */
    struct vertex_buckets vertex_buckets; /* then */
};

/* ---- the partition ---- */

void vox_partition_free(struct partition *partition)
{
    bsq_spill_free(&partition->buckets);
    memset(partition, 0, sizeof *partition);
}

/* ---- memory ---- */

/* Returns the Morton levels of the buckets, if memory does not matter. A surface meets about
 * 3 * 4^n of the 8^n cells of a grid. Buckets of some ten thousand triangles are sorted inside a
 * core's cache. */
static uint32_t wanted_levels(const struct reading *r)
{
    const struct fmt_mesh_totals *totals = &r->scan->totals;
    const uint64_t triangles = r->passes == PARTITION_ONE_PASS
                                   ? 2 * scan_count(r->scan, SCAN_POSITIONS)
                                   : totals->corners - 2 * totals->faces;
    uint32_t levels = 1;
    while (levels < r->scan->limits->bucket_levels && triangles >> 2 * levels > 100000)
        levels++;
    return levels;
}

/* Fails with the budget that the scan needs. missing: bytes. A larger budget reads more batches at
 * a time, until there are two for each thread. Its other shares grow by less than a third of what
 * is added. */
static int refuse_vertices(const struct reading *r, uint64_t missing)
{
    const struct scan *scan = r->scan;
    const uint64_t limit = bsq_memory_limit(scan->ctx);
    const unsigned slots = 2 * bsq_threads(scan->ctx);
    if (slots > r->slot_count)
        missing += (slots - r->slot_count) * BLOCK_BYTES;
    const uint64_t needed = limit + missing / 2 * 3 + MIB;
    return bsq_fail(scan->ctx, BSQ_ENOMEM,
                    "%s: sorting %llu vertices needs about %llu MiB of memory, it may use %llu MiB",
                    scan->paths[0], (unsigned long long)scan_count(scan, SCAN_POSITIONS),
                    (unsigned long long)(needed / MIB), (unsigned long long)(limit / MIB));
}

/* Makes the table of vertices' buckets. left: bytes for it and all pages. */
static int make_table(struct reading *r, uint64_t left)
{
    const struct sort_limits *limits = r->scan->limits;
    uint64_t most = left > limits->page_memory ? left - limits->page_memory : 0;
    most = most < limits->vertex_bucket_bytes ? most : limits->vertex_bucket_bytes;
    return vox_vertex_buckets_make(r->scan, &r->out->cube, wanted_levels(r), most,
                                   &r->vertex_buckets);
}

/* A third of what is unused, within bounds, stays for the batches of chunk/. The table of vertices'
 * buckets may use that share, since it is freed before the batches come. What the reader has
 * allocated by now depends on timing, so it is not asked: a scan is refused always or never.
 * *pages: the memory of buckets' pages. */
static int partition_divide_memory(struct reading *r, uint64_t *pages)
{
    const struct scan *scan = r->scan;
    const struct sort_limits *limits = scan->limits;
    const uint64_t used =
        r->used_before + vox_scan_stream_memory(scan) + vox_scan_missing_memory(scan);
    const uint64_t limit = bsq_memory_limit(scan->ctx), unused = limit > used ? limit - used : 0;
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    const uint64_t others = limits->reserve_bytes + r->slot_count * BLOCK_BYTES;
    const uint64_t left = unused > others ? unused - others : 0;
    uint64_t batches = unused / 3;
    batches = batches < 24 * MIB ? 24 * MIB : batches > 128 * MIB ? 128 * MIB : batches;
    batches += r->spilled ? vertices / 4 : 0; /* bits and ranks of chunk/gather_window.h */
    if (r->spilled)
        BSQ_PASS(make_table(r, left));
    if (r->spilled && r->vertex_buckets.levels == 0)
        return refuse_vertices(r, others + limits->page_memory + vertices - unused);
    const uint64_t table = r->vertex_buckets.bytes;
    const uint64_t keep = batches > table ? batches : table;
    *pages = left > keep + limits->page_memory ? left - keep : limits->page_memory;
    *pages = *pages < limits->max_page_memory ? *pages : limits->max_page_memory;
    return 0;
}

/* ---- buckets ---- */

/* Returns how many buckets have triangles, at most. */
static uint32_t used_buckets(const struct reading *r, uint32_t levels)
{
    return r->spilled ? r->vertex_buckets.occupied[levels] : 1u << 3 * levels;
}

static int make_buckets(struct reading *r, uint64_t page_memory)
{
    const struct scan *scan = r->scan;
    struct partition *out = r->out;
    /* Every bucket must get a page, and pages must be worth a system call. */
    const uint64_t least = 4096;
    uint64_t page_bytes = scan->limits->page_bytes;
    out->levels = r->spilled ? r->vertex_buckets.levels : wanted_levels(r);
    while (out->levels > 1 && page_memory / used_buckets(r, out->levels) < least)
        out->levels--;
    const uint32_t used = used_buckets(r, out->levels);
    while (page_bytes > least && page_bytes > page_memory / used)
        page_bytes /= 2;
    if (r->spilled && out->levels < r->vertex_buckets.levels)
        vox_vertex_buckets_coarsen(scan, &r->vertex_buckets, out->levels);
    out->vertices_lack_order = r->spilled && !r->vertex_buckets.have_order;
    return bsq_spill_init(&out->buckets, scan->ctx, "sorted tuples", r->beside,
                          1u << 3 * out->levels, used, page_bytes, page_memory);
}

/* ---- steps of the reader ---- */

/* Called for the first batch with faces, when all vertices are known. */
static int begin_faces(struct reading *r)
{
    uint64_t pages = 0;
    BSQ_PASS(vox_scan_finish_streams(r->scan));
    r->spilled = bsq_spill_in_file(&r->scan->streams[SCAN_POSITIONS].spill);
    r->out->cube = morton_cube_over(r->scan->bounds_min, r->scan->bounds_max);
    BSQ_PASS(partition_divide_memory(r, &pages));
    BSQ_PASS(make_buckets(r, pages));
    r->rules = (struct triangulation){
        .scan = r->scan,
        .cube = r->out->cube,
        .levels = r->out->levels,
        .vertex_buckets = r->spilled ? &r->vertex_buckets : NULL,
    };
    for (unsigned i = 0; i < r->slot_count; i++)
        BSQ_PASS(vox_triangulator_init(&r->slots[i].triangulator, r->scan->ctx, &r->rules));
    r->begun = true;
    return 0;
}

static int on_batch(void *arg, const struct fmt_mesh_batch *batch)
{
    struct reading *r = arg;
    int status;
    BSQ_TRY(bsq_check(r->scan->ctx));
    if (r->elements && r->begun && vox_scan_has_elements(batch))
        return BSQ_RETRY;
    if (r->elements)
        BSQ_TRY(vox_scan_add_elements(r->scan, batch));
    if (r->faces && batch->face_count > 0 && !r->begun)
        BSQ_TRY(begin_faces(r));
done:
    bsq_progress_add(r->scan->ctx, batch->byte_size);
    return status;
}

static int follow_batch(void *arg, const struct fmt_mesh_batch *batch, unsigned number)
{
    struct reading *r = arg;
    struct batch_slot *slot = &r->slots[number];
    if (r->elements && vox_scan_has_elements(batch))
        vox_scan_prefault(r->scan);
    if (!r->faces || batch->face_count == 0)
        return 0;
    vox_scan_check_faces(r->scan, batch, &slot->check);
    if (slot->check.max_size > MAX_CORNERS)
        return bsq_fail(r->scan->ctx, BSQ_EDATA, "%s: a face has %u corners, more than %u",
                        r->scan->paths[batch->file], slot->check.max_size, MAX_CORNERS);
    if (slot->check.bad_index.found)
        return 0;
    return vox_triangulate_batch(&slot->triangulator, &slot->check.faces, slot->check.max_size);
}

/* Copies runs to their buckets. Nothing more is kept after an index that is out of range: the scan
 * is refused after everything has been read. */
static int partition_finish(void *arg, const struct fmt_mesh_batch *batch, unsigned number)
{
    struct reading *r = arg;
    const struct batch_slot *slot = &r->slots[number];
    if (!r->faces || batch->face_count == 0)
        return 0;
    BSQ_PASS(vox_scan_note_faces(r->scan, &slot->check));
    if (r->scan->bad_index.found)
        return 0;
    const struct triangulator *t = &slot->triangulator;
    for (uint32_t i = 0; i < t->run_count; i++) {
        BSQ_PASS(bsq_spill_add(&r->out->buckets, t->runs[i].bucket, t->bytes + t->runs[i].offset,
                               t->runs[i].bytes));
        r->out->buckets.list[t->runs[i].bucket].items += t->runs[i].triangles;
    }
    r->out->triangles += t->triangles;
    return 0;
}

/* ---- reading ---- */

static int read_pass(struct reading *r, struct fmt_mesh_reader *reader, bool elements, bool faces)
{
    static const struct fmt_mesh_steps steps = {on_batch, follow_batch, partition_finish};
    r->elements = elements;
    r->faces = faces;
    return fmt_mesh_read_steps(reader, &steps, r, &r->scan->totals);
}

int vox_partition_read(struct scan *scan, struct fmt_mesh_reader *reader, const char *beside,
                       enum partition_passes passes, struct partition *out)
{
    struct reading r = {.scan = scan,
                        .beside = beside,
                        .out = out,
                        .passes = passes,
                        .used_before = bsq_memory_used(scan->ctx),
                        .slot_count = fmt_mesh_max_slots(reader)};
    int status;
    BSQ_TRY(BSQ_CALLOC(scan->ctx, "faces", r.slot_count, &r.slots));
    if (passes == PARTITION_TWO_PASSES)
        BSQ_TRY(read_pass(&r, reader, true, false));
    status = read_pass(&r, reader, passes == PARTITION_ONE_PASS, true);
done:
    for (unsigned i = 0; r.slots && i < r.slot_count; i++)
        vox_triangulator_free(&r.slots[i].triangulator);
    vox_vertex_buckets_free(scan, &r.vertex_buckets);
    bsq_free(scan->ctx, r.slots);
    return status;
}

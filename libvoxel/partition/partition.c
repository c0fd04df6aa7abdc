/* partition.c - see partition.h.
 *
 * Groups of faces are decoded and split on all threads; the serial step copies what became of them
 * cell by cell, so that the order in a cell is that of the file. */
#include "libvoxel/partition/partition.h"
#include "base/parallel.h"
#include "libvoxel/partition/hash_join.h"

struct slot {
    void *room; /* of the decoder */
    struct face_group group;
    struct corner_values values;
    struct splitter splitter;
};

struct job {
    struct scan *scan;
    struct scattered *out;
    struct join *join; /* NULL: triangles are scattered by index */
    struct vertex_cells vertex_cells;
    struct split_plan plan;
    atomic_bool fans_gave_up;
};

/* ---- cells ---- */

/* A surface meets about 3 * 4^n of the 8^n cells. Cells of some ten thousand triangles are sorted
 * inside a core's cache; but all cells must get a page, and pages must be worth a system call. */
static void choose_cells(const struct sort_limits *limits, uint64_t triangles, uint64_t page_memory,
                         uint32_t max_levels, uint32_t *levels, uint64_t *page_bytes)
{
    const uint64_t least = 4096;
    *levels = 1;
    while (*levels<limits->cell_levels && * levels<max_levels && triangles>>(2 * *levels) >
               100000 &&
           page_memory >> (3 * *levels + 3) >= least)
        ++*levels;
    *page_bytes = limits->page_bytes;
    while (*page_bytes > least && *page_bytes > page_memory >> 3 * *levels)
        *page_bytes /= 2;
}

int vox_partition_begin(const struct scan *scan, const char *beside, uint64_t triangles,
                        uint64_t page_memory, uint32_t max_levels, struct scattered *out)
{
    uint64_t page_bytes;
    memset(out, 0, sizeof *out);
    out->cube = morton_cube_over(scan->bounds_min, scan->bounds_max);
    choose_cells(scan->limits, triangles, page_memory, max_levels, &out->levels, &page_bytes);
    return vox_buckets_init(&out->cells, scan->ctx, beside, 1u << 3 * out->levels, page_bytes,
                            page_memory);
}

int vox_partition_note_used(const struct scan *scan, struct scattered *out)
{
    uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    return bsq_calloc(scan->ctx, "vertices in use", used_words(vertices), sizeof *out->used,
                      &out->used);
}

int vox_partition_collect(struct scattered *out, const struct splitter *splitter)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < splitter->piece_count; i++) {
        const struct split_piece *piece = &splitter->pieces[i];
        status = vox_buckets_add(&out->cells, piece->cell, splitter->bytes + piece->offset,
                                 piece->bytes, piece->triangles);
    }
    out->triangles += splitter->triangles;
    return status;
}

uint64_t vox_partition_unused(const struct scan *scan, const struct scattered *scattered)
{
    uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    return vertices -
           (scattered->used ? used_count(scattered->used, vertices) : scattered->used_vertices);
}

void vox_partition_free(const struct scan *scan, struct scattered *scattered)
{
    vox_buckets_free(&scattered->cells);
    bsq_free(scan->ctx, scattered->used);
    memset(scattered, 0, sizeof *scattered);
}

/* ---- slots ---- */

static uint64_t slot_bytes(const struct job *job)
{
    const struct face_store *faces = &job->scan->faces;
    uint64_t values = job->join ? 28 * (uint64_t)faces->max_corners : 0;
    return vox_face_store_decode_bytes(faces) + values +
           vox_triangulator_bytes(&job->plan, faces->max_triangles, faces->max_size) + 1024;
}

static void free_slots(struct bsq_ctx *ctx, struct slot *slots, unsigned count)
{
    for (unsigned i = 0; slots && i < count; i++) {
        struct slot *s = &slots[i];
        void *parts[] = {s->room, s->values.positions, s->values.colors, s->values.texcoords,
                         s->values.normals};
        vox_triangulator_free(&s->splitter);
        for (size_t k = 0; k < sizeof parts / sizeof *parts; k++)
            bsq_free(ctx, parts[k]);
    }
    bsq_free(ctx, slots);
}

static int allocate_values(const struct job *job, struct corner_values *values)
{
    struct bsq_ctx *ctx = job->scan->ctx;
    uint64_t corners = job->scan->faces.max_corners;
    int status = bsq_alloc(ctx, "faces", corners, 12, &values->positions);
    if (status == 0 && job->scan->attributes & FMT_TRIS_COLORS)
        status = bsq_alloc(ctx, "faces", corners, 4, &values->colors);
    if (status == 0 && job->scan->attributes & FMT_TRIS_TEXCOORDS)
        status = bsq_alloc(ctx, "faces", corners, 8, &values->texcoords);
    if (status == 0 && job->scan->attributes & FMT_TRIS_NORMALS)
        status = bsq_alloc(ctx, "faces", corners, 4, &values->normals);
    return status;
}

static int allocate_slot(const struct job *job, struct slot *slot)
{
    struct bsq_ctx *ctx = job->scan->ctx;
    uint64_t room = vox_face_store_decode_bytes(&job->scan->faces);
    int status = bsq_alloc(ctx, "faces", room, 1, &slot->room);
    if (status == 0)
        status = vox_triangulator_init(&slot->splitter, ctx, &job->plan);
    if (status == 0 && job->join)
        status = allocate_values(job, &slot->values);
    return status;
}

static int allocate_slots(struct job *job, struct slot **out, unsigned *count)
{
    struct bsq_ctx *ctx = job->scan->ctx;
    uint64_t taken = bsq_memory_used(ctx) + job->scan->limits->page_memory;
    uint64_t left = bsq_memory_limit(ctx) > taken ? bsq_memory_limit(ctx) - taken : 0;
    uint64_t fitting = left / slot_bytes(job);
    unsigned wanted = job->scan->limits->slots;
    *count = fitting < 1 ? 1 : fitting < wanted ? (unsigned)fitting : wanted;
    job->plan.fan_bytes = left / *count / 2;
    int status = bsq_calloc(ctx, "faces", *count, sizeof **out, out);
    for (unsigned i = 0; status == 0 && i < *count; i++)
        status = allocate_slot(job, &(*out)[i]);
    return status;
}

/* ---- the pipeline ---- */

static int produce(void *arg, void *slot_arg, uint64_t sequence)
{
    struct job *job = arg;
    struct slot *slot = slot_arg;
    if (sequence == job->scan->faces.group_count)
        return 0;
    if (!job->join)
        return 1;
    int status = vox_face_store_decode(&job->scan->faces, sequence, slot->room, &slot->group);
    if (status == 0)
        status = vox_join_fetch(job->join, &slot->group, &slot->values);
    return status < 0 ? status : 1;
}

static int work(void *arg, void *slot_arg, uint64_t sequence, unsigned worker)
{
    struct job *job = arg;
    struct slot *slot = slot_arg;
    (void)worker;
    if (!job->join) {
        int status = vox_face_store_decode(&job->scan->faces, sequence, slot->room, &slot->group);
        if (status < 0)
            return status;
    }
    int status = vox_triangulate_group(&slot->splitter, &slot->group,
                                       job->join ? &slot->values : NULL, job->scan->faces.max_size);
    if (slot->splitter.gave_up)
        atomic_store(&job->fans_gave_up, true);
    return status;
}

static int emit(void *arg, void *slot_arg, uint64_t sequence)
{
    struct job *job = arg;
    const struct slot *slot = slot_arg;
    (void)sequence;
    /* Fans are in several cells. */
    bsq_progress_add(job->scan->ctx,
                     slot->group.corner_count - 2 * (uint64_t)slot->group.face_count);
    return vox_partition_collect(job->out, &slot->splitter);
}

static int run_pipeline(struct job *job)
{
    struct slot *slots = NULL;
    unsigned count = 0;
    int status = allocate_slots(job, &slots, &count);
    if (status == 0) {
        struct bsq_pipeline pipeline = {.produce = produce,
                                        .work = work,
                                        .emit = emit,
                                        .arg = job,
                                        .slots = slots,
                                        .slot_size = sizeof *slots,
                                        .slot_count = count};
        status = bsq_pipeline_run(job->scan->ctx, &pipeline);
    }
    free_slots(job->scan->ctx, slots, count);
    return status;
}

/* ---- the whole ---- */

/* How corners meet positions that are in a file. */
enum method {
    BY_INDEX, /* when batches are sorted; cells are known by vertex */
    BY_PAGES, /* before: see hash_join.h */
    BY_BUCKETS
};

/* Scattering by index asks for the cells of vertices alone, where positions are in a file; 0: these
 * have no room. */
static uint32_t affordable_levels(struct scan *scan)
{
    const struct sort_limits *limits = scan->limits;
    const struct job job = {.scan = scan, .plan = {.scan = scan}};
    if (!scan->columns[SCAN_POSITIONS].spool.spilled)
        return limits->cell_levels;
    if (!vox_triangulate_makes_fans(scan->faces.max_size,
                                    scan_keeps(scan, SCAN_TEXCOORDS) && scan->faces.lacks_texcoord))
        return 0;
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS), limit = bsq_memory_limit(scan->ctx);
    const uint64_t taken = bsq_memory_used(scan->ctx) + vertices / 8 + limits->page_memory +
                           limits->reserve_bytes + slot_bytes(&job);
    return vertex_cells_levels(vertices, taken < limit ? limit - taken : 0,
                               limits->vertex_cells_bytes);
}

/* Marking vertices takes a bit for each, which buckets do without. */
static enum method choose_join(const struct scan *scan)
{
    return scan_count(scan, SCAN_POSITIONS) / 8 <= scan->limits->join_bytes / 4 ? BY_PAGES
                                                                                : BY_BUCKETS;
}

static enum method choose_method(struct scan *scan, uint32_t *levels)
{
    *levels = affordable_levels(scan);
    if (!vox_record_columns_spilled(scan) || *levels > 0)
        return BY_INDEX;
    *levels = scan->limits->cell_levels;
    return choose_join(scan);
}

/* The way that the scan turned out not to suit asks for another one. */
static bool gave_up(const struct job *job)
{
    return atomic_load(&job->fans_gave_up) || (job->join && vox_join_gave_up(job->join));
}

/* Records that are values tell nothing more of the vertices in use. join: NULL where it has not
 * counted them. */
static void settle_used(const struct scan *scan, const struct join *join, struct scattered *out)
{
    out->used_vertices = join ? vox_join_used_vertices(join)
                              : used_count(out->used, scan_count(scan, SCAN_POSITIONS));
    bsq_free(scan->ctx, out->used);
    out->used = NULL;
}

static int know_vertex_cells(struct job *job)
{
    struct scattered *out = job->out;
    int status = vox_vertex_buckets_make(job->scan, &out->cube, out->levels, &job->vertex_cells);
    out->vertices_lack_order = !job->vertex_cells.have_order;
    return status;
}

static int scatter_by(struct job *job, enum method method, uint32_t max_levels, const char *beside)
{
    struct scan *scan = job->scan;
    struct scattered *out = job->out;
    uint64_t triangles = scan->faces.corner_count - 2 * scan->faces.face_count;
    int status =
        vox_partition_begin(scan, beside, triangles, scan->limits->page_memory, max_levels, out);
    vox_record_layout_for(scan, method != BY_INDEX, &out->layout);
    bool spilled = scan->columns[SCAN_POSITIONS].spool.spilled,
         counted = method == BY_BUCKETS && spilled;
    if (status == 0 && method != BY_INDEX)
        status = vox_join_open(scan, beside, method == BY_PAGES ? JOIN_BY_PAGES : JOIN_BY_BUCKETS,
                               &job->join);
    if (status == 0 && !counted)
        status = vox_partition_note_used(scan, out);
    if (status == 0 && method == BY_INDEX && spilled)
        status = know_vertex_cells(job);
    job->plan = (struct split_plan){
        .scan = scan,
        .cube = out->cube,
        .levels = out->levels,
        .values = out->layout.by_value ? &out->layout : NULL,
        .vertex_cells = method == BY_INDEX && spilled ? &job->vertex_cells : NULL,
        .used = out->layout.by_value ? out->used : NULL,
    };
    if (status == 0)
        status = run_pipeline(job);
    vox_vertex_buckets_free(scan, &job->vertex_cells);
    if (status == 0 && out->layout.by_value)
        settle_used(scan, counted ? job->join : NULL, out);
    return status;
}

static void begin_progress(const struct scan *scan)
{
    bsq_progress_begin(scan->ctx, "sorting", "triangles",
                       scan->faces.corner_count - 2 * scan->faces.face_count);
}

int vox_partition_scan(struct scan *scan, const char *beside, struct scattered *out)
{
    struct job job = {.scan = scan, .out = out};
    begin_progress(scan);
    uint32_t levels;
    enum method method = choose_method(scan, &levels);
    int status = scatter_by(&job, method, levels, beside);
    while (status < 0 && gave_up(&job)) {
        vox_join_close(job.join);
        vox_partition_free(scan, out);
        job = (struct job){.scan = scan, .out = out};
        begin_progress(scan);
        method = method == BY_INDEX ? choose_join(scan) : BY_BUCKETS;
        status = scatter_by(&job, method, scan->limits->cell_levels, beside);
    }
    bsq_progress_end(scan->ctx);
    vox_join_close(job.join);
    return status;
}

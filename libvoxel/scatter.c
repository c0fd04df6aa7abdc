/* scatter.c - see scatter.h.
 *
 * Groups of faces are decoded, split into triangles and given a cell on all threads. A worker notes
 * the cells as runs, as neighbours in the file mostly are neighbours in space, and the serial step
 * copies run by run, so that the order in a cell is that of the file. */
#include "libvoxel/scatter.h"
#include "base/parallel.h"
#include "base/polygon.h"
#include "libvoxel/join.h"

#include <stdatomic.h>

struct run {
    uint32_t cell, count;
};

struct slot {
    void *room; /* of the decoder */
    struct face_group group;
    struct corner_values values;
    /* Of the largest polygon. */
    double (*polygon)[3];
    uint32_t *polygon_triangles, *polygon_scratch;
    /* Results. */
    uint8_t *records;
    struct run *runs;
    uint32_t record_count, run_count;
    uint64_t degenerate;
};

struct job {
    struct scan *scan;
    struct scattered *out;
    struct join *join;           /* NULL: all columns are in memory */
    atomic_uint_least64_t *used; /* a bit for each vertex */
    uint64_t next_group;
};

/* ---- slots ---- */

static uint64_t slot_bytes(const struct job *job)
{
    const struct face_store *faces = &job->scan->faces;
    uint64_t values = job->join ? 28 * (uint64_t)faces->max_corners : 0;
    return face_store_decode_bytes(faces) + values + 44 * (uint64_t)faces->max_size +
           (job->out->layout.bytes + sizeof(struct run)) * (uint64_t)faces->max_triangles + 1024;
}

static void free_slots(struct bsq_ctx *ctx, struct slot *slots, unsigned count)
{
    for (unsigned i = 0; slots && i < count; i++) {
        struct slot *s = &slots[i];
        void *parts[] = {s->room,
                         s->values.positions,
                         s->values.colors,
                         s->values.texcoords,
                         s->values.normals,
                         s->polygon,
                         s->polygon_triangles,
                         s->polygon_scratch,
                         s->records,
                         s->runs};
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
    const struct face_store *faces = &job->scan->faces;
    uint64_t size = faces->max_size, triangles = faces->max_triangles;
    int status;
    if ((status = bsq_alloc(ctx, "faces", face_store_decode_bytes(faces), 1, &slot->room)) < 0 ||
        (status = bsq_alloc(ctx, "faces", size, 24, &slot->polygon)) < 0 ||
        (status = bsq_alloc(ctx, "faces", size, 12, &slot->polygon_triangles)) < 0 ||
        (status = bsq_alloc(ctx, "faces", size, 8, &slot->polygon_scratch)) < 0 ||
        (status = bsq_alloc(ctx, "faces", triangles * job->out->layout.bytes + RECORD_SLACK, 1,
                            &slot->records)) < 0 ||
        (status = bsq_alloc(ctx, "faces", triangles, sizeof *slot->runs, &slot->runs)) < 0)
        return status;
    return job->join ? allocate_values(job, &slot->values) : 0;
}

static int allocate_slots(const struct job *job, struct slot **out, unsigned *count)
{
    struct bsq_ctx *ctx = job->scan->ctx;
    uint64_t taken = bsq_memory_used(ctx) + job->scan->limits->page_memory;
    uint64_t left = bsq_memory_limit(ctx) > taken ? bsq_memory_limit(ctx) - taken : 0;
    uint64_t fitting = left / slot_bytes(job);
    unsigned wanted = job->scan->limits->slots;
    *count = fitting < 1 ? 1 : fitting < wanted ? (unsigned)fitting : wanted;
    int status = bsq_calloc(ctx, "faces", *count, sizeof **out, out);
    for (unsigned i = 0; status == 0 && i < *count; i++)
        status = allocate_slot(job, &(*out)[i]);
    return status;
}

/* ---- one triangle ---- */

/* What the triangles of a group have in common while it is split. */
struct group_state {
    const struct job *job;
    struct slot *slot;
    uint32_t material[2]; /* with texture coordinates, without; plus one */
    uint8_t *to;
    uint32_t run_cell;
};

static inline const float *corner_position(const struct job *job, const struct slot *slot,
                                           uint32_t corner)
{
    if (job->join)
        return slot->values.positions[corner];
    return column_at(&job->scan->columns[SCAN_POSITIONS], slot->group.indices[FACE_VERTEX][corner],
                     12);
}

/* In double the products of differences of float32 of like size are exact, so that this is zero for
 * repeated and collinear corners and for nothing else. */
static inline bool without_area(const float *a, const float *b, const float *c)
{
    double u[3], v[3];
    for (int i = 0; i < 3; i++) {
        u[i] = (double)b[i] - a[i];
        v[i] = (double)c[i] - a[i];
    }
    return u[1] * v[2] == u[2] * v[1] && u[2] * v[0] == u[0] * v[2] && u[0] * v[1] == u[1] * v[0];
}

static void store_values(const struct record_layout *layout, const struct corner_values *values,
                         uint32_t corner, uint8_t *to)
{
    memcpy(to, values->positions[corner], 12);
    if (values->colors)
        memcpy(to + layout->value_at[SCAN_COLORS], &values->colors[corner], 4);
    if (values->texcoords)
        memcpy(to + layout->value_at[SCAN_TEXCOORDS], values->texcoords[corner], 8);
    if (values->normals)
        memcpy(to + layout->value_at[SCAN_NORMALS], &values->normals[corner], 4);
}

static inline void store_index(const struct record_layout *layout, const struct face_group *group,
                               enum face_kind kind, uint32_t corner, uint8_t *to)
{
    uint32_t bytes = layout->index_bytes[kind];
    if (bytes == 0)
        return;
    uint64_t index = group->indices[kind] ? group->indices[kind][corner] : FMT_OBJ_NONE;
    memcpy(to + layout->index_at[kind], &index, 8);
}

/* Indices write up to eight bytes, of which later ones overwrite what is too much. */
static inline void store_corner(const struct record_layout *layout, const struct slot *slot,
                                uint32_t corner, uint8_t *to)
{
    if (layout->by_value) {
        store_values(layout, &slot->values, corner, to);
        return;
    }
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
        store_index(layout, &slot->group, kind, corner, to);
}

static bool has_texcoords(const struct face_group *group, const uint32_t corners[3])
{
    const uint64_t *t = group->indices[FACE_TEXCOORD];
    return t && t[corners[0]] != FMT_OBJ_NONE && t[corners[1]] != FMT_OBJ_NONE &&
           t[corners[2]] != FMT_OBJ_NONE;
}

static inline void add_triangle(struct group_state *state, uint32_t a, uint32_t b, uint32_t c)
{
    struct slot *slot = state->slot;
    const struct scattered *out = state->job->out;
    const struct record_layout *layout = &out->layout;
    const uint32_t corners[3] = {a, b, c};
    const float *p[3];
    uint32_t cell[3];
    for (int k = 0; k < 3; k++)
        p[k] = corner_position(state->job, slot, corners[k]);
    if (without_area(p[0], p[1], p[2])) {
        slot->degenerate++;
        return;
    }
    morton_cells(&out->cube, p[0], p[1], p[2], cell);
    for (int k = 0; k < 3; k++) {
        cell[k] >>= MORTON_AXIS_BITS - out->levels;
        store_corner(layout, slot, corners[k], state->to + (uint32_t)k * layout->corner_bytes);
    }
    if (layout->material_bytes > 0)
        record_store(state->to + 3 * layout->corner_bytes,
                     state->material[!has_texcoords(&slot->group, corners)],
                     layout->material_bytes);
    state->to += layout->bytes;
    slot->record_count++;
    uint32_t number = (uint32_t)morton_key(cell);
    if (number != state->run_cell) {
        slot->runs[slot->run_count++] = (struct run){number, 0};
        state->run_cell = number;
    }
    slot->runs[slot->run_count - 1].count++;
}

static void add_polygon(struct group_state *state, uint32_t first, uint32_t size)
{
    struct slot *slot = state->slot;
    for (uint32_t k = 0; k < size; k++) {
        const float *p = corner_position(state->job, slot, first + k);
        for (int axis = 0; axis < 3; axis++)
            slot->polygon[k][axis] = p[axis];
    }
    const uint32_t *t = slot->polygon_triangles;
    bsq_triangulate((const double(*)[3])slot->polygon, size, slot->polygon_triangles,
                    slot->polygon_scratch);
    for (uint32_t i = 0; i < size - 2; i++, t += 3)
        add_triangle(state, first + t[0], first + t[1], first + t[2]);
}

/* ---- a group ---- */

static void set_material(struct group_state *state, uint32_t usemtl)
{
    const struct scan *scan = state->job->scan;
    const uint32_t *map =
        &scan->material_map[2 * (usemtl == FMT_OBJ_NO_MATERIAL ? scan->usemtl_count : usemtl)];
    state->material[0] = map[0] + 1;
    state->material[1] = map[1] + 1;
}

static void mark_used(const struct job *job, const struct face_group *group)
{
    const uint64_t *v = group->indices[FACE_VERTEX];
    for (uint32_t c = 0; c < group->corner_count; c++) {
        atomic_uint_least64_t *word = &job->used[v[c] / 64];
        uint64_t bit = (uint64_t)1 << v[c] % 64;
        if (!(atomic_load_explicit(word, memory_order_relaxed) & bit))
            atomic_fetch_or_explicit(word, bit, memory_order_relaxed);
    }
}

static void split_group(const struct job *job, struct slot *slot)
{
    const struct face_group *group = &slot->group;
    struct group_state state = {
        .job = job, .slot = slot, .to = slot->records, .run_cell = CELLS_NONE};
    uint32_t corner = 0, change = 0;
    slot->record_count = slot->run_count = 0;
    slot->degenerate = 0;
    set_material(&state, group->first_material);
    for (uint32_t f = 0; f < group->face_count; f++) {
        uint32_t size = group->sizes ? group->sizes[f] : 3;
        while (change < group->change_count && group->changes[change].face <= f)
            set_material(&state, group->changes[change++].material);
        if (size == 3)
            add_triangle(&state, corner, corner + 1, corner + 2);
        else
            add_polygon(&state, corner, size);
        corner += size;
    }
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
    int status = face_store_decode(&job->scan->faces, sequence, slot->room, &slot->group);
    if (status == 0)
        status = join_fetch(job->join, &slot->group, &slot->values);
    return status < 0 ? status : 1;
}

static int work(void *arg, void *slot_arg, uint64_t sequence, unsigned worker)
{
    const struct job *job = arg;
    struct slot *slot = slot_arg;
    (void)worker;
    if (!job->join) {
        int status = face_store_decode(&job->scan->faces, sequence, slot->room, &slot->group);
        if (status < 0)
            return status;
    }
    if (job->used)
        mark_used(job, &slot->group);
    split_group(job, slot);
    return 0;
}

static int emit(void *arg, void *slot_arg, uint64_t sequence)
{
    struct job *job = arg;
    const struct slot *slot = slot_arg;
    const uint8_t *from = slot->records;
    (void)sequence;
    for (uint32_t r = 0; r < slot->run_count; r++) {
        const struct run *run = &slot->runs[r];
        int status = cells_add(&job->out->cells, run->cell, from, run->count);
        if (status < 0)
            return status;
        from += (uint64_t)run->count * job->out->layout.bytes;
    }
    job->out->triangles += slot->record_count;
    job->out->degenerate_triangles += slot->degenerate;
    bsq_progress_add(job->scan->ctx, slot->record_count + slot->degenerate);
    return 0;
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

static uint64_t used_vertices(const struct job *job)
{
    uint64_t words = scan_count(job->scan, SCAN_POSITIONS) / 64 + 1, used = 0;
    if (!job->used)
        return join_used_vertices(job->join);
    for (uint64_t i = 0; i < words; i++)
        used += (uint64_t)__builtin_popcountll(job->used[i]);
    return used;
}

/* Cells of some ten thousand triangles are sorted inside a core's cache; a surface meets about
 * 3 * 4^n of the 8^n cells. Records that all stay in memory leave a quarter of it to pages that are
 * not full. Records that do not need pages of some size, for the sake of the system calls and of
 * the lists of pages, or else fewer cells. */
static void choose_cells(const struct scan *scan, struct scattered *out)
{
    const struct sort_limits *limits = scan->limits;
    uint64_t triangles = scan->faces.corner_count - 2 * scan->faces.face_count;
    bool fits = triangles <= limits->page_memory / 4 * 3 / out->layout.bytes;
    uint64_t page_memory = fits ? limits->page_memory / 4 : limits->page_memory;
    uint64_t least = fits ? 1024 : 16384;
    out->levels = 1;
    while (out->levels < limits->cell_levels && triangles >> (2 * out->levels) > 100000 &&
           page_memory >> (3 * out->levels + 3) >= least)
        out->levels++;
    out->page_bytes = page_memory >> 3 * out->levels;
    if (out->page_bytes < least)
        out->page_bytes = least;
    if (out->page_bytes > limits->page_bytes)
        out->page_bytes = limits->page_bytes;
}

/* Marking vertices takes a bit for each, which buckets do without. */
static bool pages_are_possible(const struct scan *scan)
{
    return scan_count(scan, SCAN_POSITIONS) / 8 <= scan->limits->join_bytes / 4;
}

static int scatter_by(struct job *job, enum join_method method, const char *beside)
{
    struct scan *scan = job->scan;
    struct scattered *out = job->out;
    bool buckets = out->layout.by_value && method == JOIN_BY_BUCKETS &&
                   scan->columns[SCAN_POSITIONS].spool.spilled;
    int status = cells_init(&out->cells, scan->ctx, beside, 1u << 3 * out->levels,
                            out->layout.bytes, out->page_bytes, scan->limits->page_memory);
    if (status == 0 && out->layout.by_value)
        status = join_open(scan, beside, method, &job->join);
    if (status == 0 && !buckets)
        status = bsq_calloc(scan->ctx, "vertices in use", scan_count(scan, SCAN_POSITIONS) / 64 + 1,
                            8, &job->used);
    if (status == 0)
        status = run_pipeline(job);
    if (status == 0)
        out->unused_vertices = scan_count(scan, SCAN_POSITIONS) - used_vertices(job);
    return status;
}

static void begin_progress(const struct scan *scan)
{
    bsq_progress_begin(scan->ctx, "sorting", "triangles",
                       scan->faces.corner_count - 2 * scan->faces.face_count);
}

int scatter_scan(struct scan *scan, const char *beside, struct scattered *out)
{
    struct job job = {.scan = scan, .out = out};
    enum join_method method = pages_are_possible(scan) ? JOIN_BY_PAGES : JOIN_BY_BUCKETS;
    memset(out, 0, sizeof *out);
    record_layout_for(scan, &out->layout);
    out->cube = morton_cube_over(scan->bounds_min, scan->bounds_max);
    choose_cells(scan, out);
    begin_progress(scan);
    int status = scatter_by(&job, method, beside);
    if (status < 0 && job.join && join_gave_up(job.join)) {
        join_close(job.join);
        bsq_free(scan->ctx, job.used);
        cells_free(&out->cells);
        job = (struct job){.scan = scan, .out = out};
        out->triangles = out->degenerate_triangles = 0;
        begin_progress(scan);
        status = scatter_by(&job, JOIN_BY_BUCKETS, beside);
    }
    bsq_progress_end(scan->ctx);
    join_close(job.join);
    bsq_free(scan->ctx, job.used);
    return status;
}

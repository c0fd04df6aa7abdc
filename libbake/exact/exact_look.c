/* exact_look.c - traces secondary rays out of core.
 *
 * A hemisphere reaches chunks everywhere. So chunks pass through memory in groups, as many at a
 * time as fit, and each group is traced by all rays that still need it. Between groups, a ray is
 * only its state: a bit if any hit will do, a distance if the nearest counts. The ray itself is
 * computed again. So a batch has millions of rays and loads each chunk once; and a scan that fits
 * into memory is loaded once for all batches. Chunks out of reach of a batch are not loaded. On a
 * device, groups are as large as its memory allows, and the next one is loaded while one is traced.
 *
 * Rays are those of bk_secondary.h, with two differences. Triangles have no planes that disagree,
 * so open rays start above the triangle by no more than rounding errors. And normals are
 * interpolated, so some of the directions around them point through the triangle of the hit; these
 * are mirrored at it. So a convex body is open everywhere. */
#include "libbake/exact/exact_leaves.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/parallel.h"

enum { BLOCK = 64 /* viewpoints that a thread traces at a time */ };

struct bake_exact_look {
    struct bake_exact *exact;
    const struct bk_params *params;
    uint32_t areas; /* of the device that traces; 0: the processor does */
    void *memory;   /* of the chunks' leaves; NULL: they are in areas */
    uint64_t bytes; /* of that, or of an area */
    char *scratch; /* of those who load chunks, scratch_bytes each; with areas, a chunk's leaves are
                      at the end */
    uint64_t scratch_bytes, largest; /* bytes of the largest chunk's leaves */
    uint32_t loaders;                /* who may load chunks at the same time */
    struct exact_group group;        /* the chunks in memory */
    uint32_t loaded;                 /* of them */
    bool whole;                      /* all of the scan's chunks fit */
    struct exact_box *boxes;         /* of the chunks in memory */
    void *tree_memory, *table;       /* table: of an area */
    uint32_t *reached;               /* chunks that the current viewpoints can reach */
};

/* Viewpoints that are traced through one group of chunks after the other. */
struct pass {
    struct bake_exact_look *look;
    const struct bake_viewpoints *viewpoints;
    struct bake_ray_states *states;
    uint64_t steps, step;   /* of the progress: groups of chunks; those before this one */
    const uint32_t *chunks; /* of the group that is loaded */
    uint32_t count;
    uint32_t loaders;   /* who share it */
    uint32_t area;      /* where it is on a device */
    bool sorted, sided; /* see bake_exact_leaves_build() */
};

/* ---- tracing ---- */

/* Traces the rays of a viewpoint, of one kind, of which more can be known. */
static void trace_kind(const struct pass *pass, const bk_viewpoint *viewpoint, uint64_t index,
                       bool open)
{
    const struct bake_exact_look *look = pass->look;
    const struct bake_ray_states *states = pass->states;
    const bk_rays kind = bk_rays_of(look->params, open);
    const bool any = open && states->words > 0;
    const uint64_t *hidden = bake_hidden_rays(states, index);
    const float *distances = bake_ray_distances(states, index, open);
    struct exact_look_limits limits = {
        .two_sided = open, .facing_origin = viewpoint->side < 0, .any = any};
    const bk_vec3 from = bk_ray_start(&kind, viewpoint);
    struct exact_path path;
    if (kind.count > 0)
        BSQ_SIMD_PICK(look->exact->simd, bake_exact_path_find)
    (&look->group, (const float[3]){from.x, from.y, from.z}, &path);
    for (uint32_t i = 0; i < kind.count; i++) {
        double t = 0;
        if (any && hidden[i / 64] >> (i % 64) & 1)
            continue;
        const bk_vec3w d = bk_ray_directions(&kind, viewpoint, i);
        limits.t_max = (double)(any ? kind.limit : fminf(distances[i], kind.limit));
        if (BSQ_SIMD_PICK(look->exact->simd, bake_exact_group_trace)(
                &look->group, &path, (const float[3]){d.x, d.y, d.z}, &limits, &t))
            bake_note_hit(states, index, open, i, (float)t);
    }
}

static void look_add_progress(const struct pass *pass, uint64_t begin, uint64_t end)
{
    const struct bake_viewpoints *viewpoints = pass->viewpoints;
    const double steps = (double)viewpoints->count * (double)pass->steps;
    const double before = (double)viewpoints->count * (double)pass->step;
    bsq_progress_add_share(pass->look->exact->ctx, viewpoints->progress,
                           (before + (double)begin) / steps, (before + (double)end) / steps);
}

static int trace_block(void *arg, uint64_t begin, uint64_t end, unsigned worker)
{
    (void)worker;
    const struct pass *pass = arg;
    const struct bake_viewpoints *viewpoints = pass->viewpoints;
    for (uint64_t i = begin; i < end; i++) {
        bk_viewpoint viewpoint;
        if (!viewpoints->get(viewpoints->arg, i, &viewpoint))
            continue;
        trace_kind(pass, &viewpoint, i, true);
        trace_kind(pass, &viewpoint, i, false);
    }
    look_add_progress(pass, begin, end);
    return 0;
}

/* ---- chunks ---- */

/* Finds the chunks that rays from these viewpoints can reach. Returns their count. */
static uint32_t find_reached(const struct pass *pass)
{
    const struct bake_exact_look *look = pass->look;
    const float open = pass->states->opens > 0 ? look->params->open_limit : 0.0f;
    const float solid = pass->states->solids > 0 ? look->params->thickness_limit : 0.0f;
    /* Directions are unit vectors up to rounding. */
    const float far = 1.001f * fmaxf(open, solid) + 2.0f * bake_exact_lift(look->exact);
    struct exact_box box = EXACT_EMPTY_BOX;
    for (uint64_t i = 0; i < pass->viewpoints->count; i++) {
        bk_viewpoint viewpoint;
        if (!pass->viewpoints->get(pass->viewpoints->arg, i, &viewpoint))
            continue;
        const float a[3] = {viewpoint.open_from.x, viewpoint.open_from.y, viewpoint.open_from.z};
        const float b[3] = {viewpoint.solid_from.x, viewpoint.solid_from.y, viewpoint.solid_from.z};
        for (int k = 0; k < 3; k++) {
            box.low[k] = fminf(box.low[k], fminf(a[k], b[k]) - far);
            box.high[k] = fmaxf(box.high[k], fmaxf(a[k], b[k]) + far);
        }
    }
    /* A box without end would overlap the tree's empty boxes. */
    for (int k = 0; k < 3; k++)
        box.low[k] = fmaxf(box.low[k], -FLT_MAX);
    return bake_exact_tree_overlapping(&look->exact->tree, &box, look->reached);
}

static uint64_t leaves_bytes(const struct bake_exact_look *look, uint32_t chunk)
{
    return bake_exact_leaves_bytes(look->exact->chunks[chunk].triangle_count);
}

/* Returns how many of some chunks fit into memory together, at least one. */
static uint32_t count_fitting(const struct bake_exact_look *look, const uint32_t *chunks,
                              uint32_t count)
{
    uint64_t bytes = 0;
    uint32_t fitting = 0;
    while (fitting < count && (bytes += leaves_bytes(look, chunks[fitting])) <= look->bytes)
        fitting++;
    return fitting;
}

static int load_chunk_leaves(const struct pass *pass, uint32_t index, char *memory, char *scratch)
{
    const struct bake_exact_look *look = pass->look;
    const struct bake_exact *exact = look->exact;
    const uint32_t number = pass->chunks[index];
    const struct fmt_tris_chunk_info *info = &exact->chunks[number];
    struct fmt_tris_chunk chunk;
    BSQ_PASS(fmt_tris_load(exact->file, number, scratch, &chunk));
    ++*exact->loads;
    bake_exact_leaves_build(&chunk, pass->sorted, pass->sided, memory,
                            scratch +
                                bsq_align_up(fmt_tris_load_size_max(exact->file), BSQ_ALIGNMENT),
                            &look->group.chunks[index]);
    memcpy(look->boxes[index].low, info->bounds_min, sizeof look->boxes[index].low);
    memcpy(look->boxes[index].high, info->bounds_max, sizeof look->boxes[index].high);
    return 0;
}

/* Loads a chunk to its place in the group's memory, or in the area. */
static int load_chunk_at(const struct pass *pass, uint32_t index, uint64_t at, char *scratch,
                         unsigned worker)
{
    const struct bake_exact_look *look = pass->look;
    if (look->areas == 0)
        return load_chunk_leaves(pass, index, (char *)look->memory + at, scratch);
    char *leaves = scratch + look->scratch_bytes - look->largest;
    BSQ_PASS(load_chunk_leaves(pass, index, leaves, scratch));
    return bake_device_send(look->exact->device, pass->area,
                            bake_exact_table_bytes(pass->count) + at, leaves,
                            leaves_bytes(look, pass->chunks[index]), worker);
}

/* Loads each chunk of a group whose turn is this loader's. */
static int load_some(void *arg, uint64_t loader, unsigned worker)
{
    const struct pass *pass = arg;
    const struct bake_exact_look *look = pass->look;
    char *scratch = look->scratch + loader * look->scratch_bytes;
    uint64_t at = 0;
    int status = 0;
    for (uint32_t i = 0; i < pass->count && status == 0; i++) {
        if (i % pass->loaders == loader)
            status = load_chunk_at(pass, i, at, scratch, worker);
        if (status == 0)
            status = bsq_check(look->exact->ctx);
        at += leaves_bytes(look, pass->chunks[i]);
    }
    return status;
}

/* Begins a group. Triangles are sorted if there are more rays than triangles: only then does
 * sorting save more time than it takes. */
static void begin_group(struct pass *pass, const uint32_t *chunks, uint32_t count, uint32_t loaders)
{
    struct bake_exact_look *look = pass->look;
    uint64_t triangles = 0;
    for (uint32_t i = 0; i < count; i++)
        triangles += look->exact->chunks[chunks[i]].triangle_count;
    pass->chunks = chunks;
    pass->count = count;
    pass->loaders = loaders;
    pass->sorted =
        pass->viewpoints->count * (pass->states->opens + pass->states->solids) > triangles;
    pass->sided = pass->states->solids > 0;
    look->loaded = 0;
}

/* Builds the tree over the chunks of a group that was loaded. */
static void end_group(const struct pass *pass)
{
    struct bake_exact_look *look = pass->look;
    look->loaded = pass->count;
    bake_exact_tree_build(&look->group.tree, pass->count, look->boxes, look->tree_memory);
}

/* Lists the chunks that rays can reach. Returns their count. */
static uint32_t list_chunks(struct pass *pass)
{
    const struct bake_exact_look *look = pass->look;
    uint32_t count = look->exact->chunk_count;
    if (look->whole)
        for (uint32_t c = 0; c < count; c++)
            look->reached[c] = c;
    else
        count = find_reached(pass);
    pass->steps = 0;
    for (uint32_t c = 0; c < count; c += count_fitting(look, look->reached + c, count - c))
        pass->steps++;
    return count;
}

static int look_through_memory(struct pass *pass)
{
    struct bake_exact_look *look = pass->look;
    struct bsq_ctx *ctx = look->exact->ctx;
    const uint32_t count = list_chunks(pass);
    uint32_t fitting;
    for (uint32_t c = 0; c < count; c += fitting, pass->step++) {
        fitting = count_fitting(look, look->reached + c, count - c);
        if (!look->whole || look->loaded == 0) {
            begin_group(pass, look->reached + c, fitting, look->loaders);
            BSQ_PASS(bsq_parallel_for(ctx, look->loaders, load_some, pass));
            end_group(pass);
        }
        BSQ_PASS(bsq_parallel_ranges(ctx, pass->viewpoints->count, BLOCK, trace_block, pass));
    }
    return 0;
}

/* ---- devices ---- */

/* A group that is loaded to one area, and another one that is traced in the other. */
struct look_turn {
    struct pass load, trace;
    uint64_t batches; /* of viewpoints to trace; 0: no group is traced */
};

static int trace_batch(const struct pass *pass, uint64_t batch, unsigned worker)
{
    const struct bake_exact_look *look = pass->look;
    const uint64_t each = bake_gpu_viewpoints(look->params), begin = batch * each,
                   left = pass->viewpoints->count - begin,
                   end = begin + (left < each ? left : each);
    BSQ_PASS(bake_device_look(look->exact->device, pass->area, look->params, pass->viewpoints,
                              begin, end, worker, pass->states));
    look_add_progress(pass, begin, end);
    return 0;
}

static int run_turn(void *arg, uint64_t index, unsigned worker)
{
    struct look_turn *turn = arg;
    return index < turn->load.loaders
               ? load_some(&turn->load, index, worker)
               : trace_batch(&turn->trace, index - turn->load.loaders, worker);
}

/* Completes the area of a group that was loaded. */
static int send_table(const struct pass *pass)
{
    const struct bake_exact_look *look = pass->look;
    end_group(pass);
    bake_exact_table_set(&look->group, pass->count, look->table);
    return bake_device_send(look->exact->device, pass->area, 0, look->table,
                            bake_exact_table_bytes(pass->count), 0);
}

static int look_through_areas(struct pass *pass)
{
    struct bake_exact_look *look = pass->look;
    const uint32_t count = list_chunks(pass), each = bake_gpu_viewpoints(look->params);
    const uint64_t batches = (pass->viewpoints->count + each - 1) / each;
    struct look_turn turn = {.load = *pass, .trace = *pass};
    uint32_t next = 0;
    if (look->whole && look->loaded > 0) {
        next = count;
        turn.batches = batches;
    }
    while (next < count || turn.batches > 0) {
        const bool load = next < count && (turn.batches == 0 || look->areas > 1);
        turn.load.loaders = 0;
        if (load)
            begin_group(&turn.load, look->reached + next,
                        count_fitting(look, look->reached + next, count - next),
                        turn.batches > 0 ? (look->loaders + 1) / 2 : look->loaders);
        BSQ_PASS(
            bsq_parallel_for(look->exact->ctx, turn.load.loaders + turn.batches, run_turn, &turn));
        turn.batches = 0;
        if (!load)
            continue;
        BSQ_PASS(send_table(&turn.load));
        next += turn.load.count;
        turn.trace = turn.load;
        turn.batches = batches;
        turn.load.area = (turn.load.area + 1) % look->areas;
        turn.load.step++;
    }
    return 0;
}

/* ---- memory ---- */

/* Each coordinate of a hit is off by at most 2^-24 of its value, so a position by sqrt(3) times
 * that. */
float bake_exact_lift(const struct bake_exact *exact)
{
    double most = 0;
    for (int k = 0; k < 3; k++)
        most = fmax(most, fmax(fabs((double)exact->header->bounds_min[k]),
                               fabs((double)exact->header->bounds_max[k])));
    return (float)(most * 0x1p-22);
}

/* Makes areas for groups of the chunks, which need `all` bytes. Leaves none if the device fails and
 * the processor goes on. */
static int allocate_areas(struct bake_exact_look *look, uint64_t all)
{
    const struct bake_exact *exact = look->exact;
    const uint64_t table = bake_exact_table_bytes(exact->chunk_count);
    if (!exact->device || !bake_device_has_areas(exact->device))
        return 0;
    const int status = bake_device_make_areas(exact->device, table + all, table + look->largest,
                                              &look->areas, &look->bytes);
    look->bytes -= status == 0 ? table : 0;
    look->areas = status == 0 ? look->areas : 0;
    return status == BSQ_RETRY ? 0 : status;
}

/* Allocates memory for the chunks that are traced at a time, or for sending them to a device. */
static int allocate_groups(struct bake_exact_look *look)
{
    const struct bake_exact *exact = look->exact;
    struct bsq_ctx *ctx = exact->ctx;
    const uint64_t share = bsq_memory_left(ctx) / 3;
    const uint32_t triangles = exact_most_triangles(exact);
    uint64_t all = 0;
    for (uint32_t c = 0; c < exact->chunk_count; c++)
        all += leaves_bytes(look, c);
    look->largest = bake_exact_leaves_bytes(triangles);
    look->scratch_bytes = bsq_align_up(fmt_tris_load_size_max(exact->file), BSQ_ALIGNMENT) +
                          bake_exact_leaves_scratch_bytes(triangles);
    BSQ_PASS(allocate_areas(look, all));
    look->scratch_bytes += look->areas > 0 ? look->largest : 0;
    look->loaders = bsq_threads(ctx);
    while (look->loaders > 1 && look->loaders * look->scratch_bytes > share / 4)
        look->loaders--;
    const uint64_t scratch = look->loaders * look->scratch_bytes,
                   left = share > scratch + look->largest ? share - scratch : look->largest;
    look->loaded = 0;
    BSQ_PASS(bsq_alloc(ctx, "chunks for secondary rays", scratch, 1, &look->scratch));
    if (look->areas == 0) {
        look->bytes = all < left ? all : left;
        BSQ_PASS(bsq_alloc(ctx, "chunks for secondary rays", look->bytes, 1, &look->memory));
    }
    look->whole = look->bytes >= all;
    return 0;
}

/* Frees what allocate_groups() allocated. */
static void free_groups(struct bake_exact_look *look)
{
    if (look->areas > 0)
        bake_device_release_areas(look->exact->device);
    look->areas = 0;
    BSQ_FREE(look->exact->ctx, look->memory, look->scratch);
    look->memory = look->scratch = NULL;
}

/* If the device fails, the processor begins again: what is known of rays stays true. */
int bake_exact_look_from(struct bake_exact_look *look, const struct bake_viewpoints *viewpoints,
                         struct bake_ray_states *states)
{
    struct pass pass = {.look = look, .viewpoints = viewpoints, .states = states};
    if (look->areas > 0) {
        const int status = look_through_areas(&pass);
        if (status != BSQ_RETRY)
            return status;
        free_groups(look);
        BSQ_PASS(allocate_groups(look));
    }
    return look_through_memory(&pass);
}

static int look_allocate(struct bake_exact_look *look)
{
    const struct bake_exact *exact = look->exact;
    struct bsq_ctx *ctx = exact->ctx;
    BSQ_PASS(allocate_groups(look));
    if (look->areas > 0)
        BSQ_PASS(bsq_alloc(ctx, "tree of chunks", bake_exact_table_bytes(exact->chunk_count), 1,
                           &look->table));
    BSQ_PASS(BSQ_ALLOC(ctx, "chunks for secondary rays", exact->chunk_count, &look->group.chunks));
    BSQ_PASS(bsq_alloc(ctx, "tree of chunks", bake_exact_tree_bytes(exact->chunk_count), 1,
                       &look->tree_memory));
    BSQ_PASS(BSQ_ALLOC(ctx, "tree of chunks", exact->chunk_count, &look->boxes));
    BSQ_PASS(BSQ_ALLOC(ctx, "chunks near rays", exact->chunk_count, &look->reached));
    return 0;
}

int bake_exact_look_create(struct bake_exact *exact, const struct bk_params *params,
                           struct bake_exact_look **out)
{
    struct bake_exact_look *look;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(exact->ctx, "secondary rays", 1, &look));
    look->exact = exact;
    look->params = params;
    const int status = look_allocate(look);
    if (status < 0)
        bake_exact_look_free(look);
    else
        *out = look;
    return status;
}

void bake_exact_look_free(struct bake_exact_look *look)
{
    if (!look)
        return;
    struct bsq_ctx *ctx = look->exact->ctx;
    free_groups(look);
    BSQ_FREE(ctx, look->group.chunks, look->tree_memory, look->table, look->boxes, look->reached,
             look);
}

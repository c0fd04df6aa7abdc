/* one_pass.c - see one_pass.h.
 *
 * The serial step stores vertices; when the first faces come, the cube around the scan is known,
 * and so is each vertex's cell where positions are in a file. From then on blocks are split on all
 * threads and collected in order. */
#include "libvoxel/partition/one_pass.h"

#include <string.h>

#define MIB ((uint64_t)1 << 20)
/* What a block of faces takes in the reader and in the splitter. */
#define BLOCK_BYTES (5 * MIB)

struct block_slot {
    struct splitter splitter;
    struct face_change *changes;
    uint64_t change_capacity;
    uint32_t max_size; /* of a face */
    bool lacks_texcoord, has_normals;
};

struct direct {
    struct scan *scan;
    const char *beside;
    struct scattered *out;
    struct block_slot *slots;
    unsigned slot_count;
    struct split_plan plan;
    struct vertex_cells vertex_cells; /* where positions are in a file */
    bool decided, active;
    atomic_bool gave_up;
};

int vox_one_pass_open(struct scan *scan, const struct fmt_mesh_reader *reader, const char *beside,
                      struct scattered *out, struct direct **direct)
{
    struct direct *d;
    *direct = NULL;
    int status = bsq_calloc(scan->ctx, "faces", 1, sizeof *d, &d);
    if (status < 0)
        return status;
    d->scan = scan;
    d->beside = beside;
    d->out = out;
    d->slot_count = fmt_mesh_max_slots(reader);
    status = bsq_calloc(scan->ctx, "faces", d->slot_count, sizeof *d->slots, &d->slots);
    if (status < 0) {
        vox_one_pass_close(d);
        return status;
    }
    *direct = d;
    return 0;
}

void vox_one_pass_close(struct direct *direct)
{
    if (!direct)
        return;
    struct bsq_ctx *ctx = direct->scan->ctx;
    for (unsigned i = 0; direct->slots && i < direct->slot_count; i++) {
        vox_triangulator_free(&direct->slots[i].splitter);
        bsq_free(ctx, direct->slots[i].changes);
    }
    vox_vertex_buckets_free(direct->scan, &direct->vertex_cells);
    bsq_free(ctx, direct->slots);
    bsq_free(ctx, direct);
}

bool vox_one_pass_gave_up(const struct direct *direct)
{
    return direct && atomic_load(&direct->gave_up);
}

bool vox_one_pass_is_active(const struct direct *direct)
{
    return direct && direct->active;
}

void vox_one_pass_finish(struct direct *direct)
{
    vox_record_layout_for(direct->scan, false, &direct->out->layout);
}

static int give_up(struct direct *direct)
{
    atomic_store(&direct->gave_up, true);
    return BSQ_EBUG;
}

/* ---- the decision ---- */

static uint64_t unused_memory(const struct bsq_ctx *ctx)
{
    uint64_t used = bsq_memory_used(ctx), limit = bsq_memory_limit(ctx);
    return limit > used ? limit - used : 0;
}

/* What is left for the table of vertices' cells and for pages of cells. A third, within bounds,
 * stays for the batches that follow; the table is gone by then. */
struct room {
    uint64_t left, batches;
};

static struct room find_room(const struct direct *direct)
{
    const struct scan *scan = direct->scan;
    uint64_t left = unused_memory(scan->ctx), batches = left / 3;
    uint64_t others = scan->limits->reserve_bytes + direct->slot_count * BLOCK_BYTES +
                      scan_count(scan, SCAN_POSITIONS) / 8;
    batches = batches < 24 * MIB ? 24 * MIB : batches > 128 * MIB ? 128 * MIB : batches;
    return (struct room){.left = left > others ? left - others : 0, .batches = batches};
}

#define LEAST_PAGES (16 * MIB)

/* Memory for pages of cells, 0 where there is too little. */
static uint64_t affordable_pages(const struct direct *direct, const struct room *room,
                                 uint64_t table)
{
    uint64_t keep = room->batches > table ? room->batches : table,
             most = direct->scan->limits->direct_memory;
    uint64_t pages = room->left > keep + LEAST_PAGES ? room->left - keep : 0;
    return pages < most ? pages : most;
}

static int begin(struct direct *direct, uint64_t page_memory, uint32_t max_levels,
                 uint64_t fan_bytes)
{
    struct scan *scan = direct->scan;
    struct scattered *out = direct->out;
    const bool spilled = scan->columns[SCAN_POSITIONS].spool.spilled;
    uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    int status = vox_scan_finish_columns(scan);
    if (status == 0)
        status =
            vox_partition_begin(scan, direct->beside, 2 * vertices, page_memory, max_levels, out);
    if (status == 0)
        status = vox_partition_note_used(scan, out);
    if (status == 0 && spilled) {
        status = vox_vertex_buckets_make(scan, &out->cube, out->levels, &direct->vertex_cells);
        out->vertices_lack_order = !direct->vertex_cells.have_order;
    }
    direct->plan = (struct split_plan){
        .scan = scan,
        .cube = out->cube,
        .levels = out->levels,
        .vertex_cells = spilled ? &direct->vertex_cells : NULL,
        .fan_bytes = fan_bytes,
    };
    for (unsigned i = 0; status == 0 && i < direct->slot_count; i++)
        status = vox_triangulator_init(&direct->slots[i].splitter, scan->ctx, &direct->plan);
    return status;
}

/* Called for the first block with faces. */
static int decide(struct direct *direct)
{
    const struct scan *scan = direct->scan;
    const struct room room = find_room(direct);
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    uint32_t levels = scan->limits->cell_levels;
    uint64_t table = 0;
    if (scan->columns[SCAN_POSITIONS].spool.spilled) {
        uint64_t most = room.left > LEAST_PAGES ? room.left - LEAST_PAGES : 0;
        levels = vertex_cells_levels(vertices, most, scan->limits->vertex_cells_bytes);
        table = vertex_cells_bytes(vertices, levels);
    }
    uint64_t page_memory = affordable_pages(direct, &room, table);
    direct->decided = true;
    direct->active = vertices > 0 && levels > 0 && page_memory > 0;
    /* What stays for the batches is free until they come, but for the table. */
    uint64_t fans =
        BLOCK_BYTES + (room.batches > table ? room.batches - table : 0) / direct->slot_count;
    return direct->active ? begin(direct, page_memory, levels, fans) : 0;
}

/* ---- the steps ---- */

static bool has_elements(const struct fmt_mesh_block *block)
{
    return block->vertex_count > 0 || block->texcoord_count > 0 || block->normal_count > 0;
}

static int on_block(void *arg, const struct fmt_mesh_block *block)
{
    struct direct *direct = arg;
    int status = bsq_check(direct->scan->ctx);
    if (status == 0 && direct->active && has_elements(block))
        return give_up(direct);
    if (status == 0)
        status = vox_scan_add_elements(direct->scan, block);
    if (status == 0 && block->face_count > 0 && !direct->decided)
        status = decide(direct);
    if (status == 0 && block->face_count > 0 && !direct->active)
        status = vox_scan_add_faces(direct->scan, block);
    bsq_progress_add(direct->scan->ctx, block->byte_size);
    return status;
}

/* No index but "none" is `end` or more. Both are below 2^62, so that the difference tells, and
 * "none" is what wraps to `end`. */
static bool all_below(const uint64_t *indices, uint64_t count, uint64_t end)
{
    uint64_t differences = 0;
    for (uint64_t i = 0; i < count; i++)
        differences |= end - 1 - indices[i];
    return differences >> 63 == 0;
}

static bool any_none(const uint64_t *indices, uint64_t count)
{
    bool any = false;
    for (uint64_t i = 0; i < count; i++)
        any |= indices[i] == FMT_MESH_NONE;
    return any;
}

/* Faces that were left out may have been the only ones. */
static bool any_index(const uint64_t *indices, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++)
        if (indices[i] != FMT_MESH_NONE)
            return true;
    return false;
}

/* All indices of the block are those of elements that were read. */
static bool indices_are_known(const struct scan *scan, const struct fmt_mesh_block *block,
                              struct block_slot *slot)
{
    const uint64_t *texcoords = block->corner_texcoords, *normals = block->corner_normals;
    const uint64_t count = block->corner_count;
    slot->lacks_texcoord = !texcoords || any_none(texcoords, count);
    slot->has_normals = normals && any_index(normals, count);
    return all_below(block->corner_vertices, count, scan_count(scan, SCAN_POSITIONS)) &&
           (!normals || all_below(normals, count, scan_count(scan, SCAN_NORMALS))) &&
           (!texcoords || all_below(texcoords, count, scan_count(scan, SCAN_TEXCOORDS)));
}

static int copy_changes(struct block_slot *slot, const struct fmt_mesh_block *block)
{
    struct bsq_ctx *ctx = slot->splitter.ctx;
    int status = bsq_grow(ctx, "faces", block->material_change_count, sizeof *slot->changes,
                          &slot->changes, &slot->change_capacity);
    for (uint64_t i = 0; status == 0 && i < block->material_change_count; i++)
        slot->changes[i] = (struct face_change){(uint32_t)block->material_changes[i].face,
                                                block->material_changes[i].material};
    return status;
}

static uint32_t largest_face(const struct fmt_mesh_block *block)
{
    uint32_t largest = 3;
    if (block->corner_count == 3 * block->face_count)
        return largest;
    for (uint64_t f = 0; f < block->face_count; f++)
        largest = block->face_sizes[f] > largest ? block->face_sizes[f] : largest;
    return largest;
}

static int follow(void *arg, const struct fmt_mesh_block *block, unsigned number)
{
    struct direct *direct = arg;
    if (has_elements(block))
        vox_scan_touch_ahead(direct->scan);
    /* direct->active is settled by the first block with faces. */
    if (block->face_count == 0 || !direct->active)
        return 0;
    struct block_slot *slot = &direct->slots[number];
    uint64_t triangles = block->corner_count - 2 * block->face_count;
    uint32_t max_size = slot->max_size = largest_face(block);
    /* A block unlike any scan's; groups of the face store are smaller. */
    if (vox_triangulator_bytes(&direct->plan, triangles, max_size) > 2 * BLOCK_BYTES &&
        vox_triangulator_bytes(&direct->plan, triangles, max_size) >
            unused_memory(direct->scan->ctx) / direct->slot_count)
        return give_up(direct);
    if (block->corner_count > UINT32_MAX / 32 || !indices_are_known(direct->scan, block, slot))
        return give_up(direct);
    if (direct->plan.vertex_cells &&
        !vox_triangulate_makes_fans(max_size, block->corner_texcoords && slot->lacks_texcoord))
        return give_up(direct);
    int status = copy_changes(slot, block);
    if (status < 0)
        return status;
    const struct face_group group = {
        .first_face = block->face_base,
        .face_count = (uint32_t)block->face_count,
        .corner_count = (uint32_t)block->corner_count,
        .change_count = (uint32_t)block->material_change_count,
        .first_material = block->material_at_start,
        .sizes = max_size > 3 ? block->face_sizes : NULL,
        .indices = {block->corner_vertices, block->corner_texcoords, block->corner_normals},
        .changes = slot->changes,
    };
    status = vox_triangulate_group(&slot->splitter, &group, NULL, max_size);
    return status < 0 && slot->splitter.gave_up ? give_up(direct) : status;
}

static int finish(void *arg, const struct fmt_mesh_block *block, unsigned number)
{
    struct direct *direct = arg;
    if (block->face_count == 0 || !direct->active)
        return 0;
    const struct block_slot *slot = &direct->slots[number];
    struct scan *scan = direct->scan;
    scan->faces.face_count += block->face_count;
    scan->faces.corner_count += block->corner_count;
    scan->faces.lacks_texcoord |= slot->lacks_texcoord;
    scan->faces.max_size =
        slot->max_size > scan->faces.max_size ? slot->max_size : scan->faces.max_size;
    scan->has_normals |= slot->has_normals;
    return vox_partition_collect(direct->out, &slot->splitter);
}

const struct fmt_mesh_steps vox_one_pass_steps = {on_block, follow, finish};

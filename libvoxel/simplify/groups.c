/* groups.c - see groups.h and steps.h.
 *
 * With locked borders, a group keeps about as many vertices as its border has, so a level leaves an
 * eighth, or with clusters a twelfth; groups of the next level are as large as groups of this one
 * were. */
#include "libvoxel/simplify/groups.h"

#include <string.h>

#include "base/parallel.h"
#include "base/text.h"
#include "libvoxel/simplify/steps.h"

/* CLUSTER_FACTOR: a level begins with clusters if it leaves at least this many times the triangles
 * of the last level. Clusters are faster than collapsing edges, and as good that far from the
 * result. */
enum {
    GROUP_TRIANGLES = 65536,
    LEVEL_FACTOR = 8,
    LEVEL_FACTOR_CLUSTERS = 12,
    CLUSTER_FACTOR = 4,
    PAGE_BYTES = 1 << 18,
    WORK_BYTES = 160 /* of a triangle, while its group is reduced */
};
/* Clusters leave 1.5 times as many vertices as are wanted; collapsing edges takes away the rest. */
static const double cluster_more = 1.5;

/* A step from a level to the next one. */
struct step {
    const struct vox_level *from;
    struct vox_level *to;
    uint64_t next_part; /* of produce */
    double ratio;
    bool cluster; /* first */
};

/* A group of neighbouring parts, and then its result. */
struct slot {
    uint64_t begin, end;
    struct vox_mesh mesh;
};

/* ---- parts ---- */

static int open_chunks(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                       struct vox_level *level)
{
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(file);
    const uint64_t count = fmt_tris_get_header(file)->chunk_count;
    level->chunks = file;
    BSQ_PASS(BSQ_ALLOC(ctx, "groups of chunks", count, &level->parts));
    level->part_count = count;
    for (uint64_t i = 0; i < count; i++) {
        struct vox_part *part = &level->parts[i];
        *part = (struct vox_part){
            .vertices = chunks[i].vertex_count, .triangles = chunks[i].triangle_count, .weight = 1};
        memcpy(part->low, chunks[i].bounds_min, sizeof part->low);
        memcpy(part->high, chunks[i].bounds_max, sizeof part->high);
        level->triangles += part->triangles;
    }
    return 0;
}

int vox_level_begin(const struct vox_level *from, uint64_t most, bool quadrics,
                    struct vox_level *to)
{
    *to = (struct vox_level){.ctx = from->ctx, .beside = from->beside, .quadrics = quadrics};
    BSQ_PASS(BSQ_ALLOC(to->ctx, "groups of chunks", most, &to->parts));
    return bsq_spill_init(&to->spill, to->ctx, "simplified groups", to->beside, 1, 1, PAGE_BYTES,
                          0);
}

void vox_level_free(struct vox_level *level, struct vox_level *to)
{
    bsq_spill_free(&level->spill);
    bsq_free(level->ctx, level->parts);
    *level = to ? *to : (struct vox_level){.ctx = level->ctx};
}

int vox_level_add(struct vox_level *level, const struct vox_mesh *mesh, float weight)
{
    struct bsq_spill *spill = &level->spill;
    struct vox_part *part = &level->parts[level->part_count++];
    *part = (struct vox_part){spill->list->bytes,
                              mesh->vertex_count,
                              mesh->triangle_count,
                              {INFINITY, INFINITY, INFINITY},
                              {-INFINITY, -INFINITY, -INFINITY},
                              weight};
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        for (int k = 0; k < 3; k++) {
            part->low[k] = fminf(part->low[k], mesh->positions[v][k]);
            part->high[k] = fmaxf(part->high[k], mesh->positions[v][k]);
        }
    level->triangles += mesh->triangle_count;
    BSQ_PASS(
        bsq_spill_add(spill, 0, mesh->positions, mesh->vertex_count * sizeof *mesh->positions));
    if (level->quadrics)
        BSQ_PASS(
            bsq_spill_add(spill, 0, mesh->quadrics, mesh->vertex_count * sizeof *mesh->quadrics));
    return bsq_spill_add(spill, 0, mesh->triangles, mesh->triangle_count * sizeof *mesh->triangles);
}

static int read_chunk(const struct vox_level *level, uint64_t index, struct vox_mesh *mesh)
{
    const struct vox_part *part = &level->parts[index];
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    int status = 0;
    BSQ_TRY(
        bsq_alloc(level->ctx, "a chunk", fmt_tris_load_size(level->chunks, index), 1, &scratch));
    BSQ_TRY(fmt_tris_load(level->chunks, index, scratch, &chunk));
    memcpy(mesh->positions + mesh->vertex_count, chunk.positions,
           part->vertices * sizeof *mesh->positions);
    memcpy(mesh->triangles + mesh->triangle_count, chunk.triangles,
           part->triangles * sizeof *mesh->triangles);
done:
    bsq_free(level->ctx, scratch);
    return status;
}

int vox_level_read(const struct vox_level *level, uint64_t index, struct vox_mesh *mesh)
{
    const struct vox_part *part = &level->parts[index];
    const uint64_t positions = part->vertices * sizeof *mesh->positions,
                   quadrics = part->vertices * sizeof *mesh->quadrics,
                   triangles = part->triangles * sizeof *mesh->triangles;
    const struct bsq_spill *spill = &level->spill;
    uint64_t at = part->offset;
    if (level->chunks)
        return read_chunk(level, index, mesh);
    BSQ_PASS(bsq_spill_read(spill, 0, at, positions, mesh->positions + mesh->vertex_count, NULL));
    at += positions;
    if (level->quadrics && mesh->quadrics)
        BSQ_PASS(bsq_spill_read(spill, 0, at, quadrics, mesh->quadrics + mesh->vertex_count, NULL));
    at += level->quadrics ? quadrics : 0;
    return bsq_spill_read(spill, 0, at, triangles, mesh->triangles + mesh->triangle_count, NULL);
}

/* Makes a welded mesh of parts [begin, end). */
static int weld_parts(const struct vox_level *level, uint64_t begin, uint64_t end, bool quadrics,
                      struct vox_mesh *mesh)
{
    uint64_t vertices = 0, triangles = 0;
    int status = 0;
    *mesh = (struct vox_mesh){0};
    for (uint64_t i = begin; i < end; i++) {
        vertices += level->parts[i].vertices;
        triangles += level->parts[i].triangles;
    }
    /* Corners have numbers of 32 bits. */
    if (vertices > UINT32_MAX / 8 || triangles > UINT32_MAX / 8)
        return bsq_fail(level->ctx, BSQ_ENOMEM,
                        "simplifying: borders of parts keep %llu triangles in one mesh, more than "
                        "it can have; choose a smaller target or drop small pieces",
                        (unsigned long long)triangles);
    BSQ_TRY(vox_mesh_allocate(level->ctx, (uint32_t)vertices, (uint32_t)triangles, quadrics, mesh));
    mesh->vertex_count = mesh->triangle_count = 0;
    for (uint64_t i = begin; i < end; i++) {
        const struct vox_part *part = &level->parts[i];
        BSQ_TRY(vox_level_read(level, i, mesh));
        for (uint32_t t = 0; t < part->triangles; t++)
            for (int k = 0; k < 3; k++)
                mesh->triangles[mesh->triangle_count + t][k] += mesh->vertex_count;
        mesh->vertex_count += part->vertices;
        mesh->triangle_count += part->triangles;
    }
    if (level->chunks && quadrics)
        vox_mesh_set_quadrics(mesh);
    status = vox_mesh_weld(level->ctx, mesh);
done:
    if (status < 0)
        vox_mesh_free(level->ctx, mesh);
    return status;
}

int vox_level_join(const struct vox_level *level, struct vox_mesh *mesh)
{
    return weld_parts(level, 0, level->part_count, false, mesh);
}

/* ---- a level ---- */

static int produce_group(void *arg, void *slot_, uint64_t sequence)
{
    struct step *step = arg;
    struct slot *slot = slot_;
    const struct vox_level *from = step->from;
    uint64_t triangles = 0;
    (void)sequence;
    *slot = (struct slot){.begin = step->next_part, .end = step->next_part};
    while (slot->end < from->part_count &&
           (slot->end == slot->begin ||
            triangles + from->parts[slot->end].triangles <= GROUP_TRIANGLES))
        triangles += from->parts[slot->end++].triangles;
    step->next_part = slot->end;
    return slot->end > slot->begin;
}

static int collapse_group(void *arg, void *slot_, uint64_t sequence, unsigned worker)
{
    const struct step *step = arg;
    struct slot *slot = slot_;
    (void)sequence, (void)worker;
    int status = 0;
    BSQ_TRY(weld_parts(step->from, slot->begin, slot->end, true, &slot->mesh));
    const uint32_t target = (uint32_t)(step->ratio * slot->mesh.triangle_count) + 1;
    if (step->cluster)
        BSQ_TRY(vox_cluster(step->from->ctx, cluster_more * step->ratio, &slot->mesh));
    status = vox_thin(step->from->ctx, target, &slot->mesh);
done:
    if (status < 0)
        vox_mesh_free(step->from->ctx, &slot->mesh);
    return status;
}

static int write_group(void *arg, void *slot_, uint64_t sequence)
{
    const struct step *step = arg;
    struct slot *slot = slot_;
    struct vox_level *to = step->to;
    int status = 0;
    (void)sequence;
    BSQ_TRY(vox_level_add(to, &slot->mesh, 1));
    for (uint64_t i = slot->begin; i < slot->end; i++)
        bsq_progress_add(to->ctx, step->from->parts[i].triangles);
done:
    vox_mesh_free(to->ctx, &slot->mesh);
    return status;
}

/* Returns how many groups are in work at most: fewer than threads could reduce if memory is small.
 */
static unsigned count_slots(const struct vox_level *level)
{
    uint64_t most = GROUP_TRIANGLES;
    for (uint64_t i = 0; i < level->part_count; i++)
        most = level->parts[i].triangles > most ? level->parts[i].triangles : most;
    return bsq_workers_within(level->ctx, 2 * bsq_threads(level->ctx), most * WORK_BYTES);
}

/* Makes the next level in *to. */
static int reduce_level(const struct vox_level *from, uint64_t target, struct vox_level *to)
{
    const bool cluster = from->triangles / LEVEL_FACTOR / CLUSTER_FACTOR >= target;
    const uint64_t least = cluster ? CLUSTER_FACTOR * target : target,
                   wanted = from->triangles / (cluster ? LEVEL_FACTOR_CLUSTERS : LEVEL_FACTOR);
    const unsigned slot_count = count_slots(from);
    struct slot *slots = NULL;
    struct step step = {.from = from,
                        .to = to,
                        .ratio =
                            (double)(wanted > least ? wanted : least) / (double)from->triangles,
                        .cluster = cluster};
    int status = 0;
    BSQ_TRY(vox_level_begin(from, from->part_count, true, to));
    BSQ_TRY(BSQ_CALLOC(to->ctx, "groups of chunks", slot_count, &slots));
    const struct bsq_pipeline pipeline = {.produce = produce_group,
                                          .work = collapse_group,
                                          .emit = write_group,
                                          .arg = &step,
                                          .slots = slots,
                                          .slot_size = sizeof *slots,
                                          .slot_count = slot_count};
    bsq_progress_begin(to->ctx, "reducing groups", "triangles", from->triangles);
    status = bsq_pipeline_run(to->ctx, &pipeline);
    bsq_progress_end(to->ctx);
done:
    for (unsigned i = 0; slots && i < slot_count; i++)
        vox_mesh_free(to->ctx, &slots[i].mesh);
    bsq_free(to->ctx, slots);
    return status;
}

int vox_reduce_chunks(struct bsq_ctx *ctx, const struct fmt_tris_file *file, uint64_t target,
                      const char *beside, struct vox_level *level)
{
    uint64_t before = UINT64_MAX;
    int status = 0;
    *level = (struct vox_level){.ctx = ctx, .beside = beside};
    BSQ_TRY(open_chunks(ctx, file, level));
    /* A level that takes away less than a tenth has little but borders of groups. */
    while (level->triangles > target && level->triangles < before - before / 10) {
        struct vox_level next = {.ctx = ctx};
        before = level->triangles;
        status = reduce_level(level, target, &next);
        vox_level_free(level, &next);
        BSQ_TRY(status);
    }
done:
    return status;
}

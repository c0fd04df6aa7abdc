/* groups.c - see steps.h.
 *
 * With locked borders, a group keeps about as many vertices as its border has, so a level reduces a
 * mesh to an eighth at most; groups of the next level are as large as groups of this one were. */
#include "libvoxel/simplify/steps.h"

#include <string.h>

#include "base/parallel.h"
#include "base/text.h"
#include "base/spill.h"

/* CLUSTER_FACTOR: a level begins with clusters if it leaves at least this many times the triangles
 * of the last level. Clusters are faster than collapsing edges, and as good that far from the
 * result. */
enum {
    GROUP_TRIANGLES = 65536,
    LEVEL_FACTOR = 8,
    CLUSTER_FACTOR = 4,
    PAGE_BYTES = 1 << 18,
    WORK_BYTES = 160 /* of a triangle, while its group is reduced */
};
/* Clusters leave 1.5 times as many vertices as are wanted; collapsing edges takes away the rest. */
static const double cluster_more = 1.5;

/* A mesh of a level: of the first one a chunk, of others bytes of a spill: positions, quadrics,
 * triangles and materials. */
struct member {
    uint64_t offset;
    uint32_t vertices, triangles;
};

struct level {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *chunks; /* of the first level, else NULL */
    struct bsq_spill spill;             /* of one stream */
    struct member *members;
    uint64_t member_count, triangles;
    const uint32_t *numbers; /* of materials, for the file's ones; NULL: not kept */
};

/* A step from a level to the next one. */
struct step {
    const struct level *from;
    struct level *to;
    uint64_t next_member; /* of produce */
    double ratio;
    bool cluster; /* first */
};

/* A group of neighbouring members, and then its result. */
struct slot {
    uint64_t begin, end;
    struct vox_mesh mesh;
};

/* ---- members ---- */

static int open_chunks(struct bsq_ctx *ctx, const struct fmt_tris_file *file, struct level *level)
{
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(file);
    const uint64_t count = fmt_tris_get_header(file)->chunk_count;
    *level = (struct level){.ctx = ctx, .chunks = file};
    BSQ_PASS(BSQ_ALLOC(ctx, "groups of chunks", count, &level->members));
    level->member_count = count;
    for (uint64_t i = 0; i < count; i++) {
        level->members[i] = (struct member){0, chunks[i].vertex_count, chunks[i].triangle_count};
        level->triangles += chunks[i].triangle_count;
    }
    return 0;
}

static void close_level(struct level *level)
{
    bsq_spill_free(&level->spill);
    bsq_free(level->ctx, level->members);
    level->members = NULL;
}

static int read_chunk(const struct level *level, uint64_t index, struct vox_mesh *mesh)
{
    const struct member *member = &level->members[index];
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    int status = 0;
    BSQ_TRY(
        bsq_alloc(level->ctx, "a chunk", fmt_tris_load_size(level->chunks, index), 1, &scratch));
    BSQ_TRY(fmt_tris_load(level->chunks, index, scratch, &chunk));
    memcpy(mesh->positions + mesh->vertex_count, chunk.positions,
           member->vertices * sizeof *mesh->positions);
    memcpy(mesh->triangles + mesh->triangle_count, chunk.triangles,
           member->triangles * sizeof *mesh->triangles);
    for (uint32_t t = 0; t < member->triangles && mesh->materials; t++) {
        const uint32_t material = chunk.materials ? chunk.materials[t] : UINT32_MAX;
        mesh->materials[mesh->triangle_count + t] =
            material == UINT32_MAX ? UINT32_MAX : level->numbers[material];
    }
done:
    bsq_free(level->ctx, scratch);
    return status;
}

static int read_spilled(const struct level *level, uint64_t index, struct vox_mesh *mesh)
{
    const struct member *member = &level->members[index];
    const uint64_t positions = member->vertices * sizeof *mesh->positions,
                   quadrics = member->vertices * sizeof *mesh->quadrics,
                   triangles = member->triangles * sizeof *mesh->triangles;
    const struct bsq_spill *spill = &level->spill;
    uint64_t at = member->offset;
    BSQ_PASS(bsq_spill_read(spill, 0, at, positions, mesh->positions + mesh->vertex_count, NULL));
    at += positions;
    BSQ_PASS(bsq_spill_read(spill, 0, at, quadrics, mesh->quadrics + mesh->vertex_count, NULL));
    at += quadrics;
    BSQ_PASS(bsq_spill_read(spill, 0, at, triangles, mesh->triangles + mesh->triangle_count, NULL));
    if (mesh->materials)
        return bsq_spill_read(spill, 0, at + triangles, member->triangles * sizeof *mesh->materials,
                              mesh->materials + mesh->triangle_count, NULL);
    return 0;
}

/* Makes a welded mesh of members [begin, end). It has quadrics if `carried` or if it is not of
 * chunks. */
static int join_members(const struct level *level, uint64_t begin, uint64_t end, bool carried,
                        struct vox_mesh *mesh)
{
    const bool quadrics = carried || !level->chunks;
    uint64_t vertices = 0, triangles = 0;
    int status = 0;
    *mesh = (struct vox_mesh){0};
    for (uint64_t i = begin; i < end; i++) {
        vertices += level->members[i].vertices;
        triangles += level->members[i].triangles;
    }
    /* Corners have numbers of 32 bits. */
    if (vertices > UINT32_MAX / 8 || triangles > UINT32_MAX / 8)
        return bsq_fail(level->ctx, BSQ_ENOMEM,
                        "simplifying: borders of parts keep %llu triangles in one mesh, more than "
                        "it can have; choose a smaller target or drop small pieces",
                        (unsigned long long)triangles);
    BSQ_TRY(vox_mesh_allocate(level->ctx, (uint32_t)vertices, (uint32_t)triangles, quadrics,
                              level->numbers != NULL, mesh));
    mesh->vertex_count = mesh->triangle_count = 0;
    for (uint64_t i = begin; i < end; i++) {
        const struct member *member = &level->members[i];
        BSQ_TRY(level->chunks ? read_chunk(level, i, mesh) : read_spilled(level, i, mesh));
        for (uint32_t t = 0; t < member->triangles; t++)
            for (int k = 0; k < 3; k++)
                mesh->triangles[mesh->triangle_count + t][k] += mesh->vertex_count;
        mesh->vertex_count += member->vertices;
        mesh->triangle_count += member->triangles;
    }
    if (level->chunks && quadrics)
        vox_mesh_set_quadrics(mesh);
    status = vox_mesh_weld(level->ctx, mesh);
done:
    if (status < 0)
        vox_mesh_free(level->ctx, mesh);
    return status;
}

/* ---- a level ---- */

static int produce_group(void *arg, void *slot_, uint64_t sequence)
{
    struct step *step = arg;
    struct slot *slot = slot_;
    const struct level *from = step->from;
    uint64_t triangles = 0;
    (void)sequence;
    *slot = (struct slot){.begin = step->next_member, .end = step->next_member};
    while (slot->end < from->member_count &&
           (slot->end == slot->begin ||
            triangles + from->members[slot->end].triangles <= GROUP_TRIANGLES))
        triangles += from->members[slot->end++].triangles;
    step->next_member = slot->end;
    return slot->end > slot->begin;
}

static int collapse_group(void *arg, void *slot_, uint64_t sequence, unsigned worker)
{
    const struct step *step = arg;
    struct slot *slot = slot_;
    (void)sequence, (void)worker;
    int status = 0;
    BSQ_TRY(join_members(step->from, slot->begin, slot->end, true, &slot->mesh));
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
    struct level *to = step->to;
    const struct vox_mesh *mesh = &slot->mesh;
    int status = 0;
    to->members[sequence] =
        (struct member){to->spill.list->bytes, mesh->vertex_count, mesh->triangle_count};
    to->member_count = sequence + 1;
    to->triangles += mesh->triangle_count;
    BSQ_TRY(bsq_spill_add(&to->spill, 0, mesh->positions,
                          mesh->vertex_count * sizeof *mesh->positions));
    BSQ_TRY(
        bsq_spill_add(&to->spill, 0, mesh->quadrics, mesh->vertex_count * sizeof *mesh->quadrics));
    BSQ_TRY(bsq_spill_add(&to->spill, 0, mesh->triangles,
                          mesh->triangle_count * sizeof *mesh->triangles));
    if (mesh->materials)
        BSQ_TRY(bsq_spill_add(&to->spill, 0, mesh->materials,
                              mesh->triangle_count * sizeof *mesh->materials));
    for (uint64_t i = slot->begin; i < slot->end; i++)
        bsq_progress_add(to->ctx, step->from->members[i].triangles);
done:
    vox_mesh_free(to->ctx, &slot->mesh);
    return status;
}

/* Returns how many groups are in work at most: fewer than threads could reduce if memory is small.
 */
static unsigned count_slots(const struct level *level)
{
    uint64_t most = GROUP_TRIANGLES;
    for (uint64_t i = 0; i < level->member_count; i++)
        most = level->members[i].triangles > most ? level->members[i].triangles : most;
    return bsq_workers_within(level->ctx, 2 * bsq_threads(level->ctx), most * WORK_BYTES);
}

/* Makes the next level in *to. */
static int reduce_level(const struct level *from, uint64_t target, const char *beside,
                        struct level *to)
{
    const uint64_t least = from->triangles / LEVEL_FACTOR;
    const unsigned slot_count = count_slots(from);
    struct slot *slots = NULL;
    struct step step = {.from = from,
                        .to = to,
                        .ratio =
                            (double)(target > least ? target : least) / (double)from->triangles,
                        .cluster = least / CLUSTER_FACTOR >= target};
    int status = 0;
    *to = (struct level){.ctx = from->ctx, .numbers = from->numbers};
    BSQ_TRY(BSQ_ALLOC(to->ctx, "groups of chunks", from->member_count, &to->members));
    BSQ_TRY(BSQ_CALLOC(to->ctx, "groups of chunks", slot_count, &slots));
    BSQ_TRY(bsq_spill_init(&to->spill, to->ctx, "simplified groups", beside, 1, 1, PAGE_BYTES, 0));
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

/* Gives materials of equal names the number of the first of these. A chunk file has names if it was
 * sorted with ids. */
static int number_materials(struct bsq_ctx *ctx, const struct fmt_tris_header *header,
                            uint32_t **numbers)
{
    const uint64_t count = header->material_count + 1U;
    struct bsq_tally tally = {0, 0};
    struct bsq_texts names = {0};
    uint32_t *firsts = NULL; /* materials that brought the names */
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "materials", count, numbers));
    BSQ_TRY(BSQ_ALLOC(ctx, "materials", count, &firsts));
    for (uint32_t i = 0; i < header->material_count; i++) {
        const char *name = header->materials[i].name;
        const uint64_t before = names.count;
        uint64_t number = 0;
        (*numbers)[i] = i;
        if (!name)
            continue;
        BSQ_TRY(bsq_texts_add(ctx, &tally, &names, name, &number));
        if (number == before)
            firsts[number] = i;
        (*numbers)[i] = firsts[number];
    }
done:
    bsq_texts_free(&names);
    bsq_tally_release(ctx, &tally);
    bsq_free(ctx, firsts);
    return status;
}

int vox_reduce_chunks(struct bsq_ctx *ctx, const struct fmt_tris_file *file, uint64_t target,
                      const char *beside, bool materials, struct vox_mesh *mesh)
{
    struct level level = {.ctx = ctx}, next;
    uint64_t before = UINT64_MAX;
    uint32_t *numbers = NULL;
    int status = 0;
    BSQ_TRY(open_chunks(ctx, file, &level));
    if (materials)
        BSQ_TRY(number_materials(ctx, fmt_tris_get_header(file), &numbers));
    level.numbers = numbers;
    /* A level that takes away less than a tenth has little but borders of groups. */
    while (level.triangles > target && level.triangles < before - before / 10) {
        before = level.triangles;
        status = reduce_level(&level, target, beside, &next);
        close_level(&level);
        level = next;
        BSQ_TRY(status);
    }
    status = join_members(&level, 0, level.member_count, false, mesh);
done:
    close_level(&level);
    bsq_free(ctx, numbers);
    return status;
}

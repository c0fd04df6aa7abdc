/* regions.c - see steps.h.
 *
 * A region is a box. Its mesh has all triangles with a corner in the box, so
 * each vertex in the box has all of its triangles. Those with a corner in
 * another box, too, are in the meshes of both, and stay as they are; they
 * belong to the box that has their least corner. Each pass divides space
 * elsewhere, so what stayed in the one before collapses then.
 *
 * In the first pass, which is short, all regions lose the same share. What the
 * last edge of each one has cost tells how many triangles it needs. Costs are
 * squares of volumes: those of an area that is bent evenly fall with the fourth
 * power of its triangles, so numbers in the ratio of the fourth roots make the
 * costs of all regions alike. */
#include "libvoxel/simplify/groups.h"

#include <string.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "libvoxel/simplify/steps.h"

/* REGION_BYTES: of a triangle, while its region collapses, with those that are
 * only looked at. */
enum { PART_TRIANGLES = 1 << 14, REGION_BYTES = 220, PASSES = 3, SHARE_STEPS = 60 };
/* Of each pass: the share of a region's triangles that are below the plane that
 * divides it, and how much of the whole ratio, as a power of it, is left for
 * the passes after it. */
static const double shares_below[PASSES] = {0.5, 0.38, 0.45};
static const double powers_left[PASSES] = {0.8, 0.1, 0};
/* Weights of parts differ by this factor from their mean at most. */
static const double weight_most = 4;

struct region {
    const struct vox_region *box;
    struct vox_mesh mesh;
    uint32_t outer;  /* its last triangles, which belong to other regions */
    double wanted;   /* triangles */
    uint8_t *locked; /* of vertices */
    struct vox_removed removed;
};

/* The middle of a part along an axis. */
struct spot {
    float at;
    uint32_t part;
};

struct dividing {
    const struct vox_part *parts;
    struct vox_region *regions;
    uint64_t count, limit; /* limit: triangles of a region */
    double share_below;
};

struct pass {
    struct bsq_ctx *ctx;
    const struct vox_level *from;
    struct vox_level *to;
    struct region *regions;
    uint64_t count;
    double scale; /* of weights, which gives the share of its triangles that a
                     part keeps */
    int number;
    struct vox_removed *removed;
};

/* ---- dividing space ---- */

static int compare_spots(const void *a_, const void *b_)
{
    const struct spot *a = a_, *b = b_;
    if (a->at != b->at)
        return a->at < b->at ? -1 : 1;
    return a->part < b->part ? -1 : a->part > b->part;
}

/* Sorts the parts of a region along the axis in which their middles reach
 * farthest. Returns it. */
static int sort_spots(const struct dividing *d, struct spot *spots, uint64_t count)
{
    float longest = -1;
    int axis = 0;
    for (int k = 0; k < 3; k++) {
        float low = INFINITY, high = -INFINITY;
        for (uint64_t i = 0; i < count; i++) {
            const float at = vox_part_middle(&d->parts[spots[i].part], k);
            low = fminf(low, at);
            high = fmaxf(high, at);
        }
        axis = high - low > longest ? k : axis;
        longest = fmaxf(longest, high - low);
    }
    for (uint64_t i = 0; i < count; i++)
        spots[i].at = vox_part_middle(&d->parts[spots[i].part], axis);
    bsq_sort(spots, count, sizeof *spots, compare_spots);
    return axis;
}

/* Divides a region by planes until each has few enough triangles, or one part.
 */
static void divide_region(struct dividing *d, struct vox_region region, struct spot *spots,
                          uint64_t count)
{
    struct vox_region above = region;
    uint64_t below = 0, split = 0;
    region.triangles = 0;
    for (uint64_t i = 0; i < count; i++)
        region.triangles += d->parts[spots[i].part].triangles;
    if (region.triangles <= d->limit || count < 2) {
        d->regions[d->count++] = region;
        return;
    }
    const int axis = sort_spots(d, spots, count);
    do
        below += d->parts[spots[split++].part].triangles;
    while (split < count - 1 && (double)below < d->share_below * (double)region.triangles);
    region.high[axis] = above.low[axis] = spots[split].at;
    divide_region(d, region, spots, split);
    divide_region(d, above, spots + split, count - split);
}

int vox_divide_level(const struct vox_level *level, uint64_t limit, double share_below,
                     struct vox_region **regions, uint64_t *count)
{
    const struct vox_region all = {.low = {-INFINITY, -INFINITY, -INFINITY},
                                   .high = {INFINITY, INFINITY, INFINITY}};
    struct dividing d = {.parts = level->parts, .limit = limit, .share_below = share_below};
    struct spot *spots = NULL;
    int status = 0;
    *count = 0;
    BSQ_TRY(BSQ_ALLOC(level->ctx, "regions", level->part_count, regions));
    BSQ_TRY(BSQ_ALLOC(level->ctx, "regions", level->part_count, &spots));
    d.regions = *regions;
    for (uint64_t i = 0; i < level->part_count; i++)
        spots[i] = (struct spot){.part = (uint32_t)i};
    divide_region(&d, all, spots, level->part_count);
    *count = d.count;
done:
    bsq_free(level->ctx, spots);
    return status;
}

/* ---- the mesh of a region ---- */

static bool is_part_near(const struct vox_region *region, const struct vox_part *part)
{
    bool near = true;
    for (int k = 0; k < 3; k++)
        near = near && part->high[k] >= region->low[k] && part->low[k] <= region->high[k];
    return near;
}

/* Returns how many corners of a triangle are in a region. *own: whether the
 * least one is. */
static unsigned count_corners(const struct vox_region *region, const float (*positions)[3],
                              const uint32_t corners[3], bool *own)
{
    const float *least = positions[corners[0]];
    unsigned count = 0;
    for (int i = 0; i < 3; i++) {
        const float *p = positions[corners[i]];
        int k = 0;
        while (k < 2 && p[k] == least[k])
            k++;
        least = p[k] < least[k] ? p : least;
        count += vox_region_has(region, p);
    }
    *own = vox_region_has(region, least);
    return count;
}

/* Returns the share of its triangles that a part keeps. */
static double share_kept(const struct vox_part *part, double scale)
{
    return fmin(1, scale * (double)part->weight);
}

/* Keeps those triangles of the part after a region's mesh that have a corner in
 * the region, and their vertices. numbers: space, of the part's vertices. */
static void keep_near(const struct pass *p, const struct vox_part *part, uint32_t *numbers,
                      struct region *region)
{
    struct vox_mesh *mesh = &region->mesh;
    float(*positions)[3] = mesh->positions + mesh->vertex_count;
    const double keep = share_kept(part, p->scale);
    uint32_t kept = mesh->triangle_count, used = 0;
    memset(numbers, 0, part->vertices * sizeof *numbers);
    for (uint32_t i = 0; i < part->triangles; i++) {
        const uint32_t *corners = mesh->triangles[mesh->triangle_count + i];
        bool own;
        const unsigned in = count_corners(region->box, (const float(*)[3])positions, corners, &own);
        if (in == 0)
            continue;
        /* What stays is beyond the share of others, until the last pass. */
        region->wanted += !own ? 0 : in < 3 && p->number < PASSES - 1 ? 1 : keep;
        for (int k = 0; k < 3; k++)
            numbers[corners[k]] = 1;
        vox_mesh_move_triangle(mesh, kept++, mesh->triangle_count + i);
    }
    for (uint32_t v = 0; v < part->vertices; v++)
        if (numbers[v] > 0) {
            memmove(positions[used], positions[v], sizeof *positions);
            numbers[v] = mesh->vertex_count + used++;
        }
    for (uint32_t t = mesh->triangle_count; t < kept; t++)
        for (int k = 0; k < 3; k++)
            mesh->triangles[t][k] = numbers[mesh->triangles[t][k]];
    mesh->vertex_count += used;
    mesh->triangle_count = kept;
}

/* Moves triangles of other regions behind all others, and locks what regions
 * share. */
static int lock_shared(struct bsq_ctx *ctx, struct region *region)
{
    struct vox_mesh *mesh = &region->mesh, others = {0};
    const float(*positions)[3] = (const float(*)[3])mesh->positions;
    uint32_t kept = 0;
    int status = 0;
    BSQ_TRY(BSQ_CALLOC(ctx, "locked vertices", mesh->vertex_count, &region->locked));
    BSQ_TRY(vox_mesh_allocate(ctx, 0, mesh->triangle_count, false, &others));
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *corners = mesh->triangles[t];
        bool own;
        if (count_corners(region->box, positions, corners, &own) < 3)
            for (int k = 0; k < 3; k++)
                region->locked[corners[k]] = 1;
        if (own) {
            vox_mesh_move_triangle(mesh, kept++, t);
            continue;
        }
        memcpy(others.triangles[region->outer++], corners, sizeof *others.triangles);
    }
    memcpy(mesh->triangles + kept, others.triangles, region->outer * sizeof *mesh->triangles);
done:
    vox_mesh_free(ctx, &others);
    return status;
}

static int gather_region(const struct pass *p, struct region *region)
{
    const struct vox_level *from = p->from;
    uint64_t vertices = 0, triangles = 0, most = 0;
    uint32_t *numbers = NULL;
    int status = 0;
    for (uint64_t i = 0; i < from->part_count; i++) {
        const struct vox_part *part = &from->parts[i];
        if (!is_part_near(region->box, part))
            continue;
        vertices += part->vertices;
        triangles += part->triangles;
        most = part->vertices > most ? part->vertices : most;
    }
    BSQ_TRY(BSQ_ALLOC(p->ctx, "a region", most, &numbers));
    BSQ_TRY(
        vox_mesh_allocate(p->ctx, (uint32_t)vertices, (uint32_t)triangles, false, &region->mesh));
    region->mesh.vertex_count = region->mesh.triangle_count = 0;
    for (uint64_t i = 0; i < from->part_count; i++) {
        const struct vox_part *part = &from->parts[i];
        if (!is_part_near(region->box, part))
            continue;
        BSQ_TRY(vox_level_read(from, i, &region->mesh));
        keep_near(p, part, numbers, region);
    }
    BSQ_TRY(vox_mesh_weld(p->ctx, &region->mesh));
    BSQ_TRY(vox_mesh_close_slits(p->ctx, &region->mesh));
    status = lock_shared(p->ctx, region);
done:
    bsq_free(p->ctx, numbers);
    return status;
}

/* ---- a pass ---- */

static int produce_region(void *arg, void *slot, uint64_t sequence)
{
    const struct pass *p = arg;
    (void)slot;
    return sequence < p->count;
}

static int collapse_region(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    const struct pass *p = arg;
    struct region *region = &p->regions[sequence];
    (void)slot, (void)worker;
    BSQ_PASS(gather_region(p, region));
    int status = vox_collapse(p->ctx, region->outer + (uint32_t)region->wanted, NULL,
                              region->locked, &region->mesh, &region->removed);
    bsq_free(p->ctx, region->locked);
    region->locked = NULL;
    return status;
}

/* Adds triangles of a mesh to a level, in parts of neighbours. */
static int write_parts(struct vox_level *to, const struct vox_mesh *mesh, uint32_t triangles,
                       float weight)
{
    struct vox_mesh part = {0};
    uint32_t *numbers = NULL, *vertices = NULL;
    int status = 0;
    BSQ_TRY(BSQ_CALLOC(to->ctx, "a part", mesh->vertex_count, &numbers));
    BSQ_TRY(BSQ_ALLOC(to->ctx, "a part", 3 * PART_TRIANGLES, &vertices));
    BSQ_TRY(vox_mesh_allocate(to->ctx, 3 * PART_TRIANGLES, PART_TRIANGLES, false, &part));
    for (uint32_t begin = 0; begin < triangles; begin += part.triangle_count) {
        part.vertex_count = part.triangle_count = 0;
        for (uint32_t t = begin; t < triangles && part.triangle_count < PART_TRIANGLES; t++) {
            uint32_t *corners = part.triangles[part.triangle_count];
            for (int k = 0; k < 3; k++) {
                const uint32_t v = mesh->triangles[t][k];
                if (numbers[v] >= part.vertex_count || vertices[numbers[v]] != v) {
                    memcpy(part.positions[part.vertex_count], mesh->positions[v],
                           sizeof *part.positions);
                    vertices[part.vertex_count] = v;
                    numbers[v] = part.vertex_count++;
                }
                corners[k] = numbers[v];
            }
            part.triangle_count++;
        }
        BSQ_TRY(vox_level_add(to, &part, weight));
    }
done:
    vox_mesh_free(to->ctx, &part);
    BSQ_FREE(to->ctx, vertices, numbers);
    return status;
}

static int write_region(void *arg, void *slot, uint64_t sequence)
{
    struct pass *p = arg;
    struct region *region = &p->regions[sequence];
    const uint32_t own = region->mesh.triangle_count - region->outer;
    (void)slot;
    int status = write_parts(p->to, &region->mesh, own,
                             p->number == 0 ? (float)sqrt(sqrt(region->removed.cost)) : 1);
    vox_mesh_free(p->ctx, &region->mesh);
    p->removed->pieces += region->removed.pieces;
    p->removed->triangles += region->removed.triangles;
    p->removed->handles += region->removed.handles;
    return status;
}

/* Finds the scale of weights that leaves `target` triangles. Weights become
 * those around their mean. */
static void choose_scale(struct pass *p, struct vox_part *parts, uint64_t target)
{
    const uint64_t count = p->from->part_count;
    double sum = 0, low = 0, high = weight_most; /* with which all are kept */
    for (uint64_t i = 0; i < count; i++)
        sum += parts[i].triangles * (double)parts[i].weight;
    const double mean = sum / (double)p->from->triangles;
    for (uint64_t i = 0; i < count; i++) {
        const double weight = mean > 0 ? (double)parts[i].weight / mean : 1;
        parts[i].weight = (float)fmin(fmax(weight, 1 / weight_most), weight_most);
    }
    for (int step = 0; step < SHARE_STEPS; step++) {
        const double middle = 0.5 * (low + high);
        sum = 0;
        for (uint64_t i = 0; i < count; i++)
            sum += parts[i].triangles * share_kept(&parts[i], middle);
        if (sum > (double)target)
            high = middle;
        else
            low = middle;
    }
    p->scale = low;
}

static int run_pass(struct pass *p, uint64_t target, uint64_t limit)
{
    const struct vox_level *from = p->from;
    struct vox_region *boxes = NULL;
    uint64_t most = 0;
    int status = 0;
    BSQ_TRY(vox_divide_level(from, limit, shares_below[p->number], &boxes, &p->count));
    BSQ_TRY(BSQ_CALLOC(p->ctx, "regions", p->count, &p->regions));
    for (uint64_t i = 0; i < p->count; i++) {
        p->regions[i].box = &boxes[i];
        most = boxes[i].triangles > most ? boxes[i].triangles : most;
    }
    choose_scale(p, from->parts, target);
    BSQ_TRY(vox_level_begin(from, from->triangles / PART_TRIANGLES + p->count, false, p->to));
    const unsigned slot_count =
        bsq_workers_within(p->ctx, bsq_threads(p->ctx), most * REGION_BYTES);
    /* Slots are empty: they only limit how many regions are in memory. */
    const struct bsq_pipeline pipeline = {.produce = produce_region,
                                          .work = collapse_region,
                                          .emit = write_region,
                                          .arg = p,
                                          .slots = p->regions,
                                          .slot_count = slot_count};
    bsq_progress_begin(p->ctx, "collapsing edges", "triangles", from->triangles - target);
    status = bsq_pipeline_run(p->ctx, &pipeline);
    bsq_progress_end(p->ctx);
done:
    for (uint64_t i = 0; p->regions && i < p->count; i++) {
        bsq_free(p->ctx, p->regions[i].locked);
        vox_mesh_free(p->ctx, &p->regions[i].mesh);
    }
    BSQ_FREE(p->ctx, p->regions, boxes);
    return status;
}

int vox_collapse_regions(struct vox_level *level, uint64_t target, uint64_t limit,
                         struct vox_removed *removed)
{
    const double ratio = (double)level->triangles / (double)target;
    for (int i = 0; i < PASSES && level->triangles > target; i++) {
        struct vox_level next = {.ctx = level->ctx};
        struct pass p = {
            .ctx = level->ctx, .from = level, .to = &next, .number = i, .removed = removed};
        int status = run_pass(&p, (uint64_t)((double)target * pow(ratio, powers_left[i])), limit);
        vox_level_free(level, &next);
        BSQ_PASS(status);
    }
    return 0;
}

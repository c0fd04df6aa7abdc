/* folds.c - see folds.h. */
#include "libvoxel/simplify/folds.h"

#include "base/geometry/vec.h"

enum { CHANGED_MAX = 64 /* triangles around an edge */ };
/* Cosine between the normals of triangles that lie back to back, but for its sign. */
static const double fold_cosine = 0.85;

/* A triangle as it would be: its ends beside the vertex that moves, and its normal. */
struct changed {
    uint32_t ends[2];
    double normal[3];
};

/* Returns whether two triangles would lie back to back. */
static bool is_fold(const double a[3], const double b[3])
{
    const double along = bsq_dotd(a, b);
    return along < 0 && along * along > fold_cosine * fold_cosine * bsq_dotd(a, a) * bsq_dotd(b, b);
}

/* Adds the triangles of u without v, as they are with u at p. Returns how many folds they have with
 * triangles beyond their outer edges. */
static unsigned collect_changed(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3],
                                struct changed *changed, unsigned *count)
{
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    unsigned folds = 0;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t a = vox_after(r, k), b = vox_before(r, k);
        if (a == v || b == v)
            continue;
        if (*count == CHANGED_MAX)
            break;
        struct changed *to = &changed[(*count)++];
        const float moved[3][3] = {{p[0], p[1], p[2]},
                                   {positions[a][0], positions[a][1], positions[a][2]},
                                   {positions[b][0], positions[b][1], positions[b][2]}};
        *to = (struct changed){.ends = {a, b}};
        vox_triangle_normal(moved, (const uint32_t[3]){0, 1, 2}, to->normal);
        for (VOX_EACH_CORNER(r, a, j)) {
            double normal[3];
            if (vox_words(r, j) == vox_words(r, k) ||
                (vox_after(r, j) != b && vox_before(r, j) != b))
                continue;
            vox_triangle_normal(positions, vox_corners(r, j), normal);
            folds += vox_after(r, j) != v && vox_before(r, j) != v && is_fold(to->normal, normal);
        }
    }
    return folds;
}

/* Returns how many folds triangles around a vertex have with each other. */
static unsigned count_inner(const struct changed *changed, unsigned count)
{
    unsigned folds = 0;
    for (unsigned i = 1; i < count; i++)
        for (unsigned j = 0; j < i; j++) {
            const uint32_t *a = changed[i].ends, *b = changed[j].ends;
            folds +=
                (a[0] == b[1] || a[1] == b[0]) && is_fold(changed[i].normal, changed[j].normal);
        }
    return folds;
}

/* Returns how many folds there are at the triangles around u and v. */
static unsigned count_folds(struct vox_rings *r, uint32_t u, uint32_t v)
{
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    struct changed changed[CHANGED_MAX];
    unsigned count = 0;
    unsigned folds = collect_changed(r, u, VOX_NONE, positions[u], changed, &count);
    folds += count_inner(changed, count);
    count = 0;
    if (v != VOX_NONE)
        folds += collect_changed(r, v, u, positions[v], changed, &count);
    return folds + count_inner(changed, count);
}

bool vox_makes_fold(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3])
{
    struct changed changed[CHANGED_MAX];
    unsigned count = 0;
    unsigned folds = collect_changed(r, u, v, p, changed, &count);
    if (v != VOX_NONE)
        folds += collect_changed(r, v, u, p, changed, &count);
    folds += count_inner(changed, count);
    if (folds == 0 && vox_rings_keep_orientation(r, u, v, p) &&
        (v == VOX_NONE || vox_rings_keep_orientation(r, v, u, p)))
        return false;
    return count == CHANGED_MAX || folds >= count_folds(r, u, v);
}

bool vox_cap_folds(struct vox_rings *r, const uint32_t cycle[3], const double normal[3])
{
    bool folds = false;
    for (int i = 0; i < 3; i++)
        for (VOX_EACH_CORNER(r, cycle[i], k)) {
            const uint32_t next = cycle[(i + 1) % 3];
            const bool left = vox_after(r, k) == next;
            double other[3];
            if (!left && vox_before(r, k) != next)
                continue;
            vox_triangle_normal((const float(*)[3])r->mesh->positions, vox_corners(r, k), other);
            for (int j = 0; j < 3 && left; j++)
                other[j] = -other[j];
            folds |= is_fold(normal, other);
        }
    return folds;
}

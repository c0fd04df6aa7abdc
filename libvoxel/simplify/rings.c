/* rings.c - see rings.h. */
#include "libvoxel/simplify/rings.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"

/* Least cosine between a triangle's normals before and after a collapse. */
static const double least_cosine = 0.2;

static int link_corners(struct vox_rings *r)
{
    const struct vox_mesh *mesh = r->mesh;
    memset(r->corner, 0xff, mesh->vertex_count * sizeof *r->corner);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t], words[] = {v[2], v[0], v[1], v[2], v[0]};
        memcpy(vox_words(r, VOX_RING_WORDS * t), words, sizeof words);
        for (uint32_t k = 0; k < 3; k++) {
            const uint32_t corner = VOX_RING_WORDS * t + 1 + k;
            uint32_t *first = &r->corner[v[k]], *link = &r->words[corner + VOX_LINK];
            if (*first == VOX_NONE) {
                *first = *link = corner;
            } else {
                *link = r->words[*first + VOX_LINK];
                r->words[*first + VOX_LINK] = corner;
            }
        }
    }
    return bsq_check(r->ctx);
}

/* Returns the end of an edge that has fewer triangles: walks along both rings until one ends. */
static uint32_t with_shorter_ring(struct vox_rings *r, uint32_t u, uint32_t v)
{
    const uint32_t at_u = vox_first_corner(r, u), at_v = vox_first_corner(r, v);
    uint32_t j = at_u, k = at_v;
    do {
        j = vox_next_corner(r, j);
        k = vox_next_corner(r, k);
    } while (j != at_u && k != at_v);
    return j == at_u ? u : v;
}

bool vox_rings_is_border(struct vox_rings *r, uint32_t u, uint32_t v)
{
    const uint32_t near = with_shorter_ring(r, u, v), far = near == u ? v : u;
    uint32_t count = 0;
    for (VOX_EACH_CORNER(r, near, k))
        count += vox_after(r, k) == far || vox_before(r, k) == far;
    return count == 1;
}

/* Flags a vertex by how many triangles each of its edges has: marks count up to three. */
static void flag_vertex(struct vox_rings *r, uint32_t v, uint8_t border)
{
    const uint32_t once = r->walk;
    unsigned single = 0;
    bool crowded = false;
    r->walk += 3;
    for (VOX_EACH_CORNER(r, v, k)) {
        const uint32_t ends[2] = {vox_after(r, k), vox_before(r, k)};
        for (int i = 0; i < 2; i++) {
            uint32_t *mark = &r->marks[ends[i]];
            const uint32_t before = *mark > once ? *mark - once : 0;
            *mark = once + (before < 3 ? before + 1 : 3);
            single += before == 0;
            single -= before == 1;
            crowded |= before >= 2;
        }
    }
    r->flags[v] |= (single > 0 ? border : 0) | (crowded ? VOX_LOCKED : 0);
}

int vox_rings_build(struct bsq_ctx *ctx, struct vox_mesh *mesh, bool lock_borders,
                    struct vox_rings *r)
{
    static const char what[] = "an edge collapse";
    const uint64_t vertices = mesh->vertex_count;
    *r = (struct vox_rings){
        .ctx = ctx, .mesh = mesh, .alive = mesh->triangle_count, .spare = VOX_NONE};
    BSQ_PASS(
        bsq_alloc(ctx, what, mesh->triangle_count, VOX_RING_WORDS * sizeof *r->words, &r->words));
    BSQ_PASS(BSQ_ALLOC(ctx, what, vertices, &r->corner));
    BSQ_PASS(BSQ_CALLOC(ctx, what, vertices, &r->marks));
    BSQ_PASS(BSQ_CALLOC(ctx, what, vertices, &r->flags));
    BSQ_PASS(link_corners(r));
    for (uint32_t v = 0; v < vertices; v++) {
        BSQ_PASS(bsq_check(ctx));
        flag_vertex(r, v, lock_borders ? VOX_BORDER | VOX_LOCKED : VOX_BORDER);
    }
    return 0;
}

void vox_rings_free(struct vox_rings *r)
{
    BSQ_FREE(r->ctx, r->flags, r->marks, r->corner, r->words);
}

static bool is_edge(uint32_t a, uint32_t b, const uint32_t ends[2])
{
    return (a == ends[0] && b == ends[1]) || (a == ends[1] && b == ends[0]);
}

/* Returns whether an edge lies opposite to a vertex. */
static bool has_opposite(struct vox_rings *r, uint32_t v, const uint32_t ends[2])
{
    bool has = false;
    for (VOX_EACH_CORNER(r, v, k))
        has |= is_edge(vox_after(r, k), vox_before(r, k), ends);
    return has;
}

/* Returns whether a triangle at the edge (u, v) is bordered on its other two edges, so that it
 * would vanish without a trace: the last one of its piece. */
static bool is_last(struct vox_rings *r, uint32_t u, uint32_t v, uint32_t opposite)
{
    return (r->flags[opposite] & VOX_BORDER) && vox_rings_is_border(r, u, opposite) &&
           vox_rings_is_border(r, v, opposite);
}

bool vox_rings_keep_topology(struct vox_rings *r, uint32_t u, uint32_t v)
{
    const uint32_t around_u = r->walk + 1, around_v = r->walk + 2;
    uint32_t opposite[2] = {VOX_NONE, VOX_NONE};
    unsigned count = 0, common = 0; /* triangles at the edge; vertices next to u and v */
    bool spans = false;
    r->walk += 2;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t a = vox_after(r, k), b = vox_before(r, k);
        r->marks[a] = r->marks[b] = around_u;
        if (a != v && b != v)
            continue;
        if (count < 2)
            opposite[count] = a == v ? b : a;
        count++;
    }
    const bool both_border = r->flags[u] & r->flags[v] & VOX_BORDER;
    if (count == 0 || count > 2 || (count == 2 && opposite[0] == opposite[1]) ||
        (count == 2 && both_border && !vox_rings_is_border(r, u, v)))
        return false;
    for (unsigned i = 0; both_border && i < count; i++)
        if (is_last(r, u, v, opposite[i]))
            return false;
    for (VOX_EACH_CORNER(r, v, k)) {
        const uint32_t ends[2] = {vox_after(r, k), vox_before(r, k)};
        for (int i = 0; i < 2; i++)
            if (r->marks[ends[i]] == around_u) {
                r->marks[ends[i]] = around_v;
                common += ends[i] != u;
            }
        spans |= is_edge(ends[0], ends[1], opposite);
    }
    return common == count && !(spans && has_opposite(r, u, opposite));
}

bool vox_rings_keep_orientation(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3])
{
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    for (VOX_EACH_CORNER(r, u, k)) {
        const uint32_t a = vox_after(r, k), b = vox_before(r, k);
        if (a == v || b == v)
            continue;
        double edge[3], old_to[3], new_to[3], old_normal[3], new_normal[3];
        for (int i = 0; i < 3; i++) {
            edge[i] = (double)positions[b][i] - (double)positions[a][i];
            old_to[i] = (double)positions[u][i] - (double)positions[a][i];
            new_to[i] = (double)p[i] - (double)positions[a][i];
        }
        bsq_crossd(edge, old_to, old_normal);
        bsq_crossd(edge, new_to, new_normal);
        const double old_square = bsq_dotd(old_normal, old_normal),
                     new_square = bsq_dotd(new_normal, new_normal);
        if (old_square > 0 && !(bsq_dotd(old_normal, new_normal) >
                                least_cosine * sqrt(old_square) * sqrt(new_square)))
            return false;
    }
    return true;
}

void vox_rings_join(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3])
{
    const uint32_t start = r->corner[v];
    uint32_t k = start, gone = VOX_NONE;
    do { /* through all corners, also those that are gone */
        uint32_t *words = vox_words(r, k);
        if (!vox_is_gone(r, k)) {
            const bool has_both = vox_after(r, k) == u || vox_before(r, k) == u;
            for (int i = 0; i < 5; i++)
                words[i] = has_both ? VOX_NONE : words[i] == v ? u : words[i];
            r->alive -= has_both;
            gone = has_both ? k & ~(VOX_RING_WORDS - 1U) : gone;
        }
        k = r->words[k + VOX_LINK];
    } while (k != start);
    uint32_t *link = &r->words[start + VOX_LINK], *other = &r->words[r->corner[u] + VOX_LINK];
    const uint32_t swapped = *link;
    *link = *other;
    *other = swapped;
    r->corner[v] = VOX_NONE;
    if (gone != VOX_NONE) {
        r->words[gone + 1] = r->spare;
        r->words[gone + 2] = v;
        r->spare = gone;
    }
    memcpy(r->mesh->positions[u], p, sizeof *r->mesh->positions);
    r->flags[u] |= r->flags[v];
}

void vox_rings_compact(struct vox_rings *r)
{
    struct vox_mesh *mesh = r->mesh;
    uint32_t *numbers = r->marks;
    uint32_t vertices = 0, triangles = 0;
    memset(numbers, 0xff, mesh->vertex_count * sizeof *numbers);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *corners = vox_corners(r, VOX_RING_WORDS * t);
        if (vox_is_gone(r, VOX_RING_WORDS * t))
            continue;
        for (int k = 0; k < 3; k++)
            numbers[corners[k]] = 0;
        vox_mesh_move_triangle(mesh, triangles, t);
        memcpy(mesh->triangles[triangles++], corners, sizeof *mesh->triangles);
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        if (numbers[v] == VOX_NONE)
            continue;
        memmove(mesh->positions[vertices], mesh->positions[v], sizeof *mesh->positions);
        if (mesh->quadrics)
            mesh->quadrics[vertices] = mesh->quadrics[v];
        numbers[v] = vertices++;
    }
    for (uint32_t t = 0; t < triangles; t++)
        for (int k = 0; k < 3; k++)
            mesh->triangles[t][k] = numbers[mesh->triangles[t][k]];
    mesh->vertex_count = vertices;
    mesh->triangle_count = triangles;
}

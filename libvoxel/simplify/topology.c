/* topology.c - see topology.h. */
#include "libvoxel/simplify/topology.h"

#include <math.h>
#include <string.h>

#include "base/sort_array.h"

enum { RING_MAX = 64 /* triangles around a vertex of a cycle */ };
/* Share of the way to their neighbours that copies of a cycle's vertices move. */
static const double gap = 0.01;

/* ---- the nearest vertex ---- */

/* at: coordinates in the order of the levels of the tree below, the first one for its own level. */
struct vox_place {
    float at[3];
    uint32_t vertex;
};

static int compare_places(const void *a_, const void *b_)
{
    const struct vox_place *a = a_, *b = b_;
    if (a->at[0] != b->at[0])
        return a->at[0] < b->at[0] ? -1 : 1;
    return a->vertex < b->vertex ? -1 : a->vertex > b->vertex;
}

static void rotate(float at[3])
{
    const float first = at[0];
    at[0] = at[1];
    at[1] = at[2];
    at[2] = first;
}

/* Makes a k-d tree (Bentley, 1975) of places: the one in the middle divides the others. Errors:
 * BSQ_EINTR. */
static int divide_places(struct bsq_ctx *ctx, struct vox_place *places, uint32_t count)
{
    const uint32_t middle = count / 2;
    int status = count > VOX_CHECK_EVERY ? bsq_check(ctx) : 0;
    if (status < 0 || count < 2)
        return status;
    bsq_sort(places, count, sizeof *places, compare_places);
    for (uint32_t i = 0; i < count; i++)
        if (i != middle)
            rotate(places[i].at);
    status = divide_places(ctx, places, middle);
    return status < 0 ? status : divide_places(ctx, places + middle + 1, count - middle - 1);
}

static int build_places(struct vox_rings *r, struct vox_places *p)
{
    const struct vox_mesh *mesh = r->mesh;
    bsq_free(r->ctx, p->places);
    *p = (struct vox_places){.alive = r->alive};
    int status = BSQ_ALLOC(r->ctx, "an edge collapse", mesh->vertex_count, &p->places);
    for (uint32_t v = 0; v < mesh->vertex_count && status == 0; v++) {
        const float *at = mesh->positions[v];
        if (r->corner[v] != VOX_NONE)
            p->places[p->count++] = (struct vox_place){{at[0], at[1], at[2]}, v};
    }
    return status < 0 ? status : divide_places(r->ctx, p->places, p->count);
}

static bool has_vertex(const struct vox_small_piece *piece, uint32_t v)
{
    bool found = false;
    for (unsigned i = 0; i < piece->count; i++)
        found |= piece->vertices[i] == v;
    return found;
}

/* Lowers *square to the squared distance of a point from the nearest place whose vertex is still
 * there and not of the piece. */
static void search_places(const struct vox_rings *r, const struct vox_place *places, uint32_t count,
                          const float point[3], const struct vox_small_piece *piece, double *square,
                          uint32_t *nearest)
{
    if (count == 0)
        return;
    const uint32_t middle = count / 2;
    const struct vox_place *place = &places[middle];
    float next[3] = {point[0], point[1], point[2]};
    double way[3], sum = 0;
    for (int k = 0; k < 3; k++) {
        way[k] = (double)point[k] - (double)place->at[k];
        sum += way[k] * way[k];
    }
    if (sum < *square && r->corner[place->vertex] != VOX_NONE &&
        !has_vertex(piece, place->vertex)) {
        *square = sum;
        *nearest = place->vertex;
    }
    rotate(next);
    for (int side = 0; side < 2; side++) {
        const bool above = (way[0] > 0) == (side == 0);
        if (side == 0 || way[0] * way[0] < *square)
            search_places(r, above ? place + 1 : places, above ? count - middle - 1 : middle, next,
                          piece, square, nearest);
    }
}

/* ---- small pieces ---- */

/* Lists the vertices of v's piece, or none if they are too many, or it goes on elsewhere. */
static void list_piece(struct vox_rings *r, uint32_t v, struct vox_small_piece *piece)
{
    *piece = (struct vox_small_piece){.vertices = {v}, .count = 1, .nearest = VOX_NONE};
    for (unsigned n = 0; n < piece->count; n++)
        for (VOX_EACH_CORNER(r, piece->vertices[n], k))
            for (int i = 0; i < 3; i++) {
                const uint32_t w = vox_words(r, k)[1 + i];
                if (has_vertex(piece, w))
                    continue;
                if (piece->count == VOX_PIECE_VERTICES || (r->flags[w] & VOX_SHARED)) {
                    piece->count = 0;
                    return;
                }
                piece->vertices[piece->count++] = w;
            }
}

int vox_find_small_piece(struct vox_rings *r, uint32_t v, struct vox_places *places,
                         struct vox_small_piece *piece)
{
    const float(*positions)[3] = (const float(*)[3])r->mesh->positions;
    list_piece(r, v, piece);
    /* Few of the places count after many vertices have gone. */
    if (piece->count > 0 && (!places->places || r->alive < places->alive / 2)) {
        BSQ_PASS(build_places(r, places));
    }
    /* Points of the piece: the means of each three vertices, which need not differ. */
    for (unsigned i = 0; i < piece->count; i++)
        for (unsigned j = i; j < piece->count; j++)
            for (unsigned n = j; n < piece->count; n++) {
                const float *a = positions[piece->vertices[i]], *b = positions[piece->vertices[j]],
                            *c = positions[piece->vertices[n]];
                double square = INFINITY;
                uint32_t nearest = VOX_NONE;
                float point[3];
                for (int k = 0; k < 3; k++)
                    point[k] = (float)(((double)a[k] + (double)b[k] + (double)c[k]) / 3);
                search_places(r, places->places, places->count, point, piece, &square, &nearest);
                if (piece->nearest == VOX_NONE || square > piece->square) {
                    piece->square = square;
                    piece->nearest = nearest;
                }
            }
    if (piece->nearest == VOX_NONE)
        piece->count = 0;
    return 0;
}

void vox_drop_piece(struct vox_rings *r, const struct vox_small_piece *piece)
{
    for (unsigned i = 0; i < piece->count; i++) {
        const uint32_t v = piece->vertices[i];
        for (uint32_t k; (k = vox_first_corner(r, v)) != VOX_NONE; r->alive--)
            *vox_words(r, k) = VOX_NONE;
    }
}

/* ---- handles ---- */

bool vox_find_cycle(struct vox_rings *r, uint32_t u, uint32_t v, uint32_t cycle[3])
{
    const uint32_t next_to_u = ++r->walk;
    uint32_t least = VOX_NONE;
    for (VOX_EACH_CORNER(r, u, k))
        r->marks[vox_after(r, k)] = r->marks[vox_before(r, k)] = next_to_u;
    for (VOX_EACH_CORNER(r, u, j))
        if (vox_after(r, j) == v || vox_before(r, j) == v)
            r->marks[vox_after(r, j)] = r->marks[vox_before(r, j)] = 0;
    for (VOX_EACH_CORNER(r, v, i)) {
        const uint32_t w = vox_after(r, i);
        least = w < least && r->marks[w] == next_to_u ? w : least;
    }
    memcpy(cycle, (uint32_t[3]){u, v, least}, 3 * sizeof *cycle);
    return least != VOX_NONE;
}

/* The triangles around a vertex of a cycle, by their corners there: those to the left of the cycle,
 * in their order around the vertex, then those to the right. */
struct crossing {
    uint32_t corners[RING_MAX];
    unsigned left, count;
};

/* Sorts the triangles around `at`, which a cycle passes on its way from `from` to `to`. Returns
 * false unless they close around it, with two or more on either side. */
static bool sort_crossing(struct vox_rings *r, uint32_t from, uint32_t at, uint32_t to,
                          struct crossing *x)
{
    uint32_t edge = to;
    *x = (struct crossing){.count = 0};
    for (VOX_EACH_CORNER(r, at, k)) {
        if (x->count == RING_MAX)
            return false;
        x->corners[x->count++] = k;
    }
    for (unsigned i = 0; i < x->count; i++) {
        unsigned next = i;
        while (next < x->count && vox_after(r, x->corners[next]) != edge)
            next++;
        if (next == x->count || (i > 0 && edge == to))
            return false;
        const uint32_t corner = x->corners[next];
        x->corners[next] = x->corners[i];
        x->corners[i] = corner;
        edge = vox_before(r, corner);
        x->left = edge == from ? i + 1 : x->left;
    }
    return edge == to && x->left > 1 && x->count > x->left + 1;
}

/* Makes some corners the ring of a vertex, with one more. */
static void link_ring(struct vox_rings *r, uint32_t v, const uint32_t *corners, unsigned count,
                      uint32_t more)
{
    for (unsigned i = 0; i < count; i++) {
        uint32_t *words = vox_words(r, corners[i]);
        words[corners[i] % VOX_RING_WORDS] = v;
        words[corners[i] % VOX_RING_WORDS + VOX_LINK] = i + 1 < count ? corners[i + 1] : more;
        words[0] = words[3];
        words[4] = words[1];
    }
    r->words[more + VOX_LINK] = corners[0];
    r->corner[v] = more;
}

/* Moves a copy away from the cycle. */
static void open_gap(struct vox_rings *r, uint32_t v)
{
    float(*positions)[3] = r->mesh->positions;
    double sum[3] = {0, 0, 0};
    unsigned count = 0;
    for (VOX_EACH_CORNER(r, v, k)) {
        count++;
        for (int i = 0; i < 3; i++)
            sum[i] += (double)positions[vox_after(r, k)][i] - (double)positions[v][i];
    }
    for (int i = 0; i < 3; i++)
        positions[v][i] = (float)((double)positions[v][i] + gap * sum[i] / count);
}

bool vox_cut_cycle(struct vox_rings *r, const uint32_t cycle[3], uint32_t copies[3])
{
    struct vox_mesh *mesh = r->mesh;
    struct crossing crossings[3];
    uint32_t spare[3], next = r->spare;
    for (int i = 0; i < 3; i++) {
        if (next == VOX_NONE || r->flags[cycle[i]] != 0 ||
            !sort_crossing(r, cycle[(i + 2) % 3], cycle[i], cycle[(i + 1) % 3], &crossings[i]))
            return false;
        spare[i] = next;
        copies[i] = r->words[next + 2];
        next = r->words[next + 1];
    }
    r->spare = next;
    const uint32_t left[5] = {cycle[1], cycle[0], cycle[2], cycle[1], cycle[0]},
                   right[5] = {copies[2], copies[0], copies[1], copies[2], copies[0]};
    memcpy(&r->words[spare[0]], left, sizeof left);
    memcpy(&r->words[spare[1]], right, sizeof right);
    r->alive += 2;
    for (uint32_t i = 0; i < 3; i++) {
        const struct crossing *x = &crossings[i];
        const uint32_t v = copies[i];
        memcpy(mesh->positions[v], mesh->positions[cycle[i]], sizeof *mesh->positions);
        if (mesh->quadrics)
            mesh->quadrics[v] = mesh->quadrics[cycle[i]];
        r->flags[v] = 0;
        link_ring(r, cycle[i], x->corners, x->left, spare[0] + 1 + (3 - i) % 3);
        link_ring(r, v, x->corners + x->left, x->count - x->left, spare[1] + 1 + i);
    }
    for (int i = 0; i < 3; i++)
        open_gap(r, copies[i]);
    return true;
}

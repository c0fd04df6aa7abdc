#include "sort_grid.h"
#include "base/geometry/vec.h"
#include "tests/unit/fixture.h"

uint32_t sort_random(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(*seed >> 32);
}

void sort_grid_make(struct sort_grid *g, uint32_t n, uint64_t seed)
{
    g->n = n;
    g->positions = malloc((size_t)(n + 1) * (n + 1) * sizeof *g->positions);
    g->colors = malloc((size_t)(n + 1) * (n + 1) * sizeof *g->colors);
    for (uint32_t y = 0; y <= n; y++)
        for (uint32_t x = 0; x <= n; x++) {
            size_t v = (size_t)y * (n + 1) + x;
            g->positions[v][0] = x + sort_random(&seed) % 1000 / 4000.0;
            g->positions[v][1] = y + sort_random(&seed) % 1000 / 4000.0;
            g->positions[v][2] = sort_random(&seed) % 1000 / 100.0 + 0.01;
            for (int i = 0; i < 3; i++)
                g->colors[v][i] = (uint8_t)sort_random(&seed);
        }
}

void sort_grid_free(struct sort_grid *g)
{
    free(g->positions);
    free(g->colors);
}

static void quad_corner(const struct sort_grid *g, uint32_t quad, int half, size_t v[3])
{
    size_t a = (size_t)(quad / g->n) * (g->n + 1) + quad % g->n, d = a + g->n + 1;
    v[0] = half ? a + 1 : a;
    v[1] = half ? d + 1 : a + 1;
    v[2] = d;
}

void sort_grid_write(const struct sort_grid *g, const char *path, unsigned flags, uint64_t seed)
{
    FILE *file = fopen(path, "wb");
    const uint32_t quads = g->n * g->n;
    uint32_t *order = malloc(quads * sizeof *order);
    for (size_t v = 0; v < (size_t)(g->n + 1) * (g->n + 1); v++) {
        fprintf(file, "v %.5f %.5f %.5f", g->positions[v][0], g->positions[v][1],
                g->positions[v][2]);
        if (flags & GRID_COLORS)
            fprintf(file, " %.4f %.4f %.4f", g->colors[v][0] / 255.0, g->colors[v][1] / 255.0,
                    g->colors[v][2] / 255.0);
        fputc('\n', file);
    }
    for (uint32_t i = 0; i < quads; i++)
        order[i] = i;
    for (uint32_t i = quads - 1; flags & GRID_SHUFFLED && i > 0; i--) {
        uint32_t other = sort_random(&seed) % (i + 1), kept = order[i];
        order[i] = order[other];
        order[other] = kept;
    }
    if (flags & GRID_NORMALS)
        fputs("vn 0 0 1\nvn 0 1 0\nvn 0 0 0\n", file);
    for (uint32_t i = 0; i < quads; i++)
        for (int half = 0; half < 2; half++) {
            size_t v[3];
            quad_corner(g, order[i], half, v);
            if (flags & GRID_NORMALS)
                fprintf(file, "f %zu//1 %zu//2 %zu\n", v[0] + 1, v[1] + 1, v[2] + 1);
            else
                fprintf(file, "f %zu %zu %zu\n", v[0] + 1, v[1] + 1, v[2] + 1);
        }
    free(order);
    assert_int_equal(fclose(file), 0);
}

static uint32_t pack_cross(const float p[3][3])
{
    double u[3], v[3], n[3];
    for (int i = 0; i < 3; i++) {
        u[i] = (double)p[1][i] - p[0][i];
        v[i] = (double)p[2][i] - p[0][i];
    }
    n[0] = u[1] * v[2] - u[2] * v[1];
    n[1] = u[2] * v[0] - u[0] * v[2];
    n[2] = u[0] * v[1] - u[1] * v[0];
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    return bsq_oct_pack(
        bsq_v3((float)(n[0] / length), (float)(n[1] / length), (float)(n[2] / length)));
}

void sort_grid_expect(const struct sort_grid *g, unsigned flags, struct sorted_triangles *out)
{
    for (uint32_t quad = 0; quad < g->n * g->n; quad++)
        for (int half = 0; half < 2; half++) {
            struct sorted_triangle one;
            size_t v[3];
            memset(&one, 0, sizeof one);
            quad_corner(g, quad, half, v);
            for (int k = 0; k < 3; k++) {
                struct sorted_corner *c = &one.corners[k];
                for (int axis = 0; axis < 3; axis++)
                    c->position[axis] = (float)g->positions[v[k]][axis];
                if (flags & GRID_COLORS)
                    c->color = 0xff000000u | (uint32_t)g->colors[v[k]][2] << 16 |
                               (uint32_t)g->colors[v[k]][1] << 8 | g->colors[v[k]][0];
            }
            if (flags & GRID_NORMALS) {
                one.corners[0].normal = bsq_oct_pack(bsq_v3(0, 0, 1));
                one.corners[1].normal = bsq_oct_pack(bsq_v3(0, 1, 0));
            }
            one.material = UINT32_MAX;
            sorted_add(out, &one);
        }
}

void sort_grid_check_face_normals(struct sorted_triangles *t)
{
    const uint32_t up = bsq_oct_pack(bsq_v3(0, 0, 1)), along = bsq_oct_pack(bsq_v3(0, 1, 0));
    for (size_t i = 0; i < t->count; i++) {
        struct sorted_triangle one = t->list[i];
        float p[3][3];
        for (int k = 0; k < 3; k++)
            memcpy(p[k], one.corners[k].position, 12);
        struct bsq_vec3 expected = bsq_oct_unpack(pack_cross((const float(*)[3])p));
        for (int k = 0; k < 3; k++)
            if (one.corners[k].normal != up && one.corners[k].normal != along) {
                struct bsq_vec3 n = bsq_oct_unpack(one.corners[k].normal);
                assert_true(bsq_dot3(n, expected) > 0.999999f);
                one.corners[k].normal = 0;
            }
        t->count--;
        struct sorted_triangles place = {t->list + i, 0, 1};
        sorted_add(&place, &one);
        t->count++;
    }
}

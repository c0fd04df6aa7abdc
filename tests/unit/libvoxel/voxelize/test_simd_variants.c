/* Tests that functions compiled for several instruction sets give the same bits, and the right
 * ones. */
#include "libvoxel/voxelize/cache/smooth_normals.h"
#include "libvoxel/voxelize/clip/accumulate.h"
#include "base/vec.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "tests/unit/test.h"

enum { LEVELS = BSQ_SIMD_AVX512 + 1 };

/* Returns how many levels this processor can run, from BSQ_SIMD_BASE on. */
static size_t level_count(void)
{
    size_t count = (size_t)bsq_simd_best() + 1;
    if (count < LEVELS)
        print_message("this processor cannot run all levels of instructions\n");
    return count;
}

enum { SUMS = 5003 };

static void random_sum(uint64_t *seed, struct vox_sum *sum)
{
    double length = 0.0, *n = sum->normal;
    for (int k = 0; k < 3; k++) {
        n[k] = scan_random(seed) - 0.5;
        length += n[k] * n[k];
    }
    sum->area = sqrt(length) * (1.0 + scan_random(seed));
    for (int k = 0; k < 3; k++)
        sum->center[k] = sum->area * (2.0 * scan_random(seed) - 1.0);
    sum->noise =
        sum->area * (scan_random(seed) < 0.1 ? VOX_INCONSISTENT * VOX_NO_AREA : scan_random(seed));
}

/* Makes one record as struct fmt_nvdb_record describes it. */
static struct fmt_nvdb_record expected_record(const struct vox_sum *sum)
{
    const double *s = sum->normal, *c = sum->center;
    double length = sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]);
    double n[3] = {0.0, 0.0, 1.0};
    for (int k = 0; k < 3 && length > 0.0; k++)
        n[k] = s[k] / length;
    double d = (n[0] * c[0] + n[1] * c[1] + n[2] * c[2]) / sum->area;
    struct fmt_nvdb_record record = {
        .normal = bsq_oct_pack(bsq_v3((float)n[0], (float)n[1], (float)n[2])),
        .plane = (uint32_t)lrint(fmin(fmax(d, -0.87), 0.87) * 32767.0) & 0xffff,
    };
    record.plane |= (uint32_t)lrint(fmin(length / sum->area, 1.0) * 255.0) << 16;
    record.plane |= sum->noise > 2.0 * sum->area
                        ? FMT_NVDB_PLANE_INCONSISTENT
                        : (uint32_t)lrint(sum->noise / sum->area * 7.0) << 26;
    return record;
}

TEST(test_records)
{
    uint64_t seed = 12;
    print_message("seed %llu\n", (unsigned long long)seed);
    struct vox_sum *sums = calloc(SUMS, sizeof *sums);
    uint32_t *numbers = calloc(SUMS, sizeof *numbers);
    struct fmt_nvdb_record *records = calloc(SUMS, sizeof *records);
    assert_true(sums && numbers && records);
    for (uint32_t i = 0; i < SUMS; i++) {
        random_sum(&seed, &sums[i]);
        numbers[i] = SUMS - 1 - i;
    }
    memset(sums[0].normal, 0, sizeof sums[0].normal); /* no direction */
    for (int k = 0; k < 3; k++) { /* along the axes, with both zeros in the other numbers */
        memset(sums[1 + k].normal, 0, sizeof sums[1 + k].normal);
        sums[1 + k].normal[k] = -0.5;
        sums[1 + k].normal[(k + 1) % 3] = -0.0;
    }
    const size_t count = level_count();
    for (size_t c = 0; c < count; c++) {
        memset(records, 0xff, SUMS * sizeof *records);
        BSQ_SIMD_PICK(c, vox_make_records)(sums, numbers, SUMS, records);
        for (uint32_t i = 0; i < SUMS; i++) {
            struct fmt_nvdb_record expected = expected_record(&sums[numbers[i]]);
            assert_int_equal(records[i].normal, expected.normal);
            assert_int_equal(records[i].plane, expected.plane);
            assert_int_equal(records[i].color, 0);
        }
    }
    free(sums);
    free(numbers);
    free(records);
}

enum { TRIANGLES = 3000 };

/* Triangles of all small sizes in and around a region of 128^3. */
struct soup {
    double points[3 * TRIANGLES][4];
    float normals[3 * TRIANGLES][4];
    uint32_t colors[3 * TRIANGLES];
    uint32_t triangles[TRIANGLES][3];
    struct vox_box groups[TRIANGLES / VOX_GROUP_TRIANGLES + 1];
    bool inconsistent[TRIANGLES / VOX_GROUP_TRIANGLES + 1];
};

static void make_soup(struct soup *soup)
{
    uint64_t seed = 99;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (uint32_t t = 0; t < TRIANGLES; t++) {
        double at[3], size = pow(10.0, 2.0 * scan_random(&seed) - 1.0);
        for (int a = 0; a < 3; a++)
            at[a] = 140.0 * scan_random(&seed) - 6.0;
        for (uint32_t v = 3 * t; v < 3 * t + 3; v++) {
            for (int a = 0; a < 3; a++) {
                soup->points[v][a] = at[a] + size * (scan_random(&seed) - 0.5);
                soup->normals[v][a] = (float)(scan_random(&seed) - 0.5);
            }
            soup->normals[v][3] = (float)(0.6 * scan_random(&seed) - 0.3);
            soup->colors[v] = (uint32_t)(4294967296.0 * scan_random(&seed));
            soup->triangles[t][v - 3 * t] = v;
        }
    }
    for (uint32_t g = 0; g * VOX_GROUP_TRIANGLES < TRIANGLES; g++) {
        soup->groups[g] = (struct vox_box){{-99, -99, -99}, {999, 999, 999}};
        soup->inconsistent[g] = g % 3 == 0;
    }
}

static void check_sums(struct bsq_ctx *ctx, const struct vox_chunk *chunk)
{
    struct fmt_tris_header header = {.attributes = FMT_TRIS_COLORS};
    struct vox_shading shading = {.scan = {.ctx = ctx, .header = &header}};
    struct vox_box region = {{0, 0, 0}, {127, 127, 127}}, window = {{0, 8, 0}, {127, 119, 127}};
    struct vox_accumulator *sums[LEVELS];
    struct vox_fragment_block *block;
    const size_t count = level_count();
    assert_int_equal(fmt_shading_add_color(&shading.scan), 0);
    assert_int_equal(vox_shading_prepare(&shading), 0);
    assert_int_equal(bsq_alloc(ctx, "fragments", vox_fragment_block_bytes(), 1, &block), 0);
    for (size_t c = 0; c < count; c++) {
        uint64_t counted = 0;
        assert_int_equal(vox_accumulator_create(ctx, 64 << 20, true, &sums[c]), 0);
        struct vox_accumulation what = {.shading = &shading,
                                        .chunk = chunk,
                                        .region = &region,
                                        .window = &window,
                                        .sums = sums[c],
                                        .block = block};
        assert_int_equal(BSQ_SIMD_PICK(c, vox_accumulate_chunk)(&what, &counted), 0);
        assert_true(sums[c]->sum_count > 10000);
        assert_int_equal(sums[c]->sum_count, sums[0]->sum_count);
        assert_memory_equal(sums[c]->sums + 1, sums[0]->sums + 1,
                            sums[0]->sum_count * sizeof *sums[0]->sums);
        assert_memory_equal(sums[c]->colors + 1, sums[0]->colors + 1,
                            sums[0]->sum_count * sizeof *sums[0]->colors);
        assert_memory_equal(sums[c]->brick_of, sums[0]->brick_of, sizeof sums[0]->brick_of);
    }
    for (size_t c = 0; c < count; c++)
        vox_accumulator_destroy(sums[c]);
    bsq_free(ctx, block);
    vox_shading_free(&shading);
}

TEST(test_sums)
{
    struct bsq_ctx *ctx = test_context(1, 512 << 20);
    struct soup *soup = calloc(1, sizeof *soup);
    assert_non_null(soup);
    make_soup(soup);
    struct vox_chunk chunk = {
        .source = {.triangle_count = TRIANGLES,
                   .vertex_count = 3 * TRIANGLES,
                   .colors = soup->colors,
                   .triangles = (const uint32_t(*)[3])soup->triangles},
        .points = (const double(*)[4])soup->points,
        .last_cell = {999, 999, 999},
        .groups = soup->groups,
        .group_count = (TRIANGLES + VOX_GROUP_TRIANGLES - 1) / VOX_GROUP_TRIANGLES,
    };
    check_sums(ctx, &chunk);
    chunk.normals = (const float(*)[4])soup->normals;
    check_sums(ctx, &chunk);
    chunk.inconsistent = soup->inconsistent;
    check_sums(ctx, &chunk);
    chunk.coarse = true;
    check_sums(ctx, &chunk);
    chunk.inconsistent = NULL;
    check_sums(ctx, &chunk);
    free(soup);
    bsq_ctx_destroy(ctx);
}

enum { RING_VERTICES = 100 };

/* A one-ring's sums. */
struct one_ring {
    double normal[3], weight, moment[3], unused;
};

/* Computes the one-ring of one vertex as base/smooth_normals.h describes it. */
static struct one_ring expected_ring(const struct fmt_tris_chunk *chunk, uint32_t vertex)
{
    struct one_ring ring = {.weight = 0.0};
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int i = 0; i < 3; i++) {
            const uint32_t *v = chunk->triangles[t];
            if (v[i] != vertex)
                continue;
            double corner[3][3], n[3], length;
            for (int k = 0; k < 3; k++)
                for (int a = 0; a < 3; a++)
                    corner[k][a] = chunk->positions[v[(i + k) % 3]][a];
            for (int a = 0; a < 3; a++) {
                int b = (a + 1) % 3, c = (a + 2) % 3;
                n[a] = (corner[1][b] - corner[0][b]) * (corner[2][c] - corner[0][c]) -
                       (corner[1][c] - corner[0][c]) * (corner[2][b] - corner[0][b]);
            }
            length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            for (int a = 0; a < 3; a++) {
                ring.normal[a] += n[a];
                ring.moment[a] +=
                    length * (corner[0][a] + corner[1][a] + corner[2][a] - 3.0 * corner[0][a]);
            }
            ring.weight += length;
        }
    return ring;
}

/* Vertex 0 has no one-ring. */
TEST(test_rings)
{
    uint64_t seed = 7;
    print_message("seed %llu\n", (unsigned long long)seed);
    float positions[RING_VERTICES][3];
    uint32_t triangles[3 * RING_VERTICES][3], ring_of[RING_VERTICES];
    for (uint32_t v = 0; v < RING_VERTICES; v++) {
        for (int a = 0; a < 3; a++)
            positions[v][a] = (float)(10.0 * scan_random(&seed));
        ring_of[v] = v;
    }
    for (uint32_t t = 0; t < 3 * RING_VERTICES; t++)
        for (int i = 0; i < 3; i++)
            triangles[t][i] = (t + (uint32_t)i * (1 + t % 7)) % RING_VERTICES;
    const struct fmt_tris_chunk chunk = {.vertex_count = RING_VERTICES,
                                         .triangle_count = 3 * RING_VERTICES,
                                         .positions = (const float(*)[3])positions,
                                         .triangles = (const uint32_t(*)[3])triangles};
    struct one_ring rings[LEVELS][RING_VERTICES];
    float normals[LEVELS][RING_VERTICES][4];
    const size_t count = level_count();
    for (unsigned weights = BSQ_SCAN_NORMALS_FLAT; weights-- > BSQ_SCAN_NORMALS_AREA;)
        for (size_t c = 0; c < count; c++) {
            memset(rings[c], 0, sizeof rings[c]);
            BSQ_SIMD_PICK(c, vox_add_one_rings)
            (&chunk, 0, chunk.triangle_count, ring_of, (enum bsq_scan_normals)weights,
             (double(*)[4])(void *)rings[c]);
            assert_memory_equal(rings[c], rings[0], sizeof rings[c]);
        }
    /* The last weights were areas. */
    for (uint32_t v = 1; v < RING_VERTICES; v++) {
        const struct one_ring expected = expected_ring(&chunk, v), *ring = &rings[0][v];
        assert_true(fabs(ring->weight - expected.weight) < 1e-9);
        for (int a = 0; a < 3; a++) {
            assert_true(fabs(ring->normal[a] - expected.normal[a]) < 1e-9);
            assert_true(fabs(ring->moment[a] - expected.moment[a]) < 1e-7);
        }
    }
    const uint32_t empty = 9,
                   finished = RING_VERTICES - 1; /* not a multiple of any number of lanes */
    for (size_t c = 0; c < count; c++) {
        memset(&rings[c][empty], 0, sizeof rings[c][empty]);
        BSQ_SIMD_PICK(c, vox_finish_one_rings)
        ((const double(*)[4])(const void *)rings[c], ring_of, finished, 0.5, normals[c]);
        assert_memory_equal(normals[c], normals[0], finished * sizeof normals[c][0]);
        for (int k = 0; k < 4; k++)
            assert_true(normals[c][empty][k] == 0.0f);
    }
}

RUN_TESTS(NULL, NULL)

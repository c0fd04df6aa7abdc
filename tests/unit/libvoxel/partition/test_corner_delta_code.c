/* Tests delta coding of corners: decoding gives the same indices, and ordinary meshes take two
 * bytes a triangle. */
#include "libvoxel/partition/corner_delta_code.h"
#include "formats/mesh/mesh_reader.h"
#include "tests/unit/test.h"

enum { COUNT = 3000 };

static uint64_t next(uint64_t *seed)
{
    *seed ^= *seed << 13;
    *seed ^= *seed >> 7;
    return *seed ^= *seed << 17;
}

/* Encodes, decodes and compares. Returns the bytes of the code. */
static uint64_t round_trip(const uint64_t (*triangles)[3], uint64_t count)
{
    uint8_t *bytes = malloc(count * CORNER_CODE_MAX + CORNER_CODE_SLACK), *to = bytes;
    struct corner_code code = {0};
    for (uint64_t t = 0; t < count; t++) {
        uint8_t *end = corner_code_put(&code, triangles[t], to);
        assert_in_range(end - to, 1, CORNER_CODE_MAX);
        to = end;
    }
    memset(to, 0, CORNER_CODE_SLACK);
    const uint8_t *from = bytes;
    code = (struct corner_code){0};
    for (uint64_t t = 0; t < count; t++) {
        uint64_t index[3];
        from = corner_code_get(&code, from, index);
        assert_memory_equal(index, triangles[t], sizeof index);
    }
    assert_ptr_equal(from, to);
    const uint64_t size = (uint64_t)(to - bytes);
    free(bytes);
    return size;
}

/* Codes random numbers, with extremes and repetitions among them. */
TEST(any_indices_come_back)
{
    uint64_t(*triangles)[3] = malloc(COUNT * sizeof *triangles);
    for (uint64_t seed = 1; seed <= 50; seed++) {
        uint64_t random = seed;
        for (int t = 0; t < COUNT; t++)
            for (int k = 0; k < 3; k++) {
                uint64_t kind = next(&random) % 8;
                triangles[t][k] = kind == 0           ? FMT_MESH_NONE
                                  : kind == 1         ? next(&random) % 3
                                  : kind < 5 && t > 0 ? triangles[t - 1][next(&random) % 3]
                                                      : next(&random) >> next(&random) % 64;
            }
        round_trip((const uint64_t(*)[3])triangles, COUNT);
    }
    free(triangles);
}

/* Returns the triangles of n x n quads, row by row. The caller frees them. */
static uint64_t (*make_grid(uint64_t n))[3]
{
    uint64_t(*triangles)[3] = malloc(2 * n * n * sizeof *triangles), count = 0;
    for (uint64_t y = 0; y < n; y++)
        for (uint64_t x = 0; x < n; x++) {
            uint64_t a = y * (n + 1) + x, b = a + 1, c = a + n + 1, d = c + 1;
            const uint64_t pair[2][3] = {{a, b, c}, {b, d, c}};
            memcpy(triangles[count], pair, sizeof pair);
            count += 2;
        }
    return triangles;
}

/* Each triangle has one new corner, which is near the last one except at the ends of rows. */
TEST(grids_take_two_bytes)
{
    enum { N = 50 };
    uint64_t(*triangles)[3] = make_grid(N), count = 2 * N * N;
    assert_in_range(round_trip((const uint64_t(*)[3])triangles, count), 2 * count,
                    2 * count + 4 * N);
    free(triangles);
}

/* Shuffled triangles take nine bytes: control, four bytes for the first corner, two for its
 * neighbour in the row, and two for the one in the next row, about 400 indices away. A few take
 * less, by chance. */
TEST(grids_without_order_take_nine_bytes)
{
    enum { N = 400 };
    uint64_t(*triangles)[3] = make_grid(N), count = 2 * N * N, random = 5;
    for (uint64_t t = count - 1; t > 0; t--) {
        uint64_t other = next(&random) % (t + 1), moving[3];
        memcpy(moving, triangles[t], sizeof moving);
        memcpy(triangles[t], triangles[other], sizeof moving);
        memcpy(triangles[other], moving, sizeof moving);
    }
    assert_in_range(round_trip((const uint64_t(*)[3])triangles, count), 8 * count, 9.5 * count);
    free(triangles);
}

/* Three new corners at and past the limits of CORNER_CODE_FAR. */
TEST(far_triangles_come_back)
{
    const uint64_t starts[] = {0x8000, 0x7fffffff, 0x80000000, (uint64_t)1 << 40};
    const uint64_t steps[] = {1, 0x7f, 0x7fff, 0x8000, 0x80000000, (uint64_t)1 << 50};
    for (unsigned s = 0; s < 4; s++)
        for (unsigned a = 0; a < 6; a++)
            for (unsigned b = 0; b < 6; b++) {
                const uint64_t first = starts[s], second = first + steps[a];
                const uint64_t triangles[2][3] = {{first, second, second - steps[b]},
                                                  {second * 3, second * 3 - steps[b], 1}};
                const uint64_t bytes = round_trip(triangles, 1);
                assert_int_equal(bytes == 9, s < 2 && a < 3 && b < 4);
                round_trip(triangles, 2);
            }
}

RUN_TESTS(NULL, NULL)

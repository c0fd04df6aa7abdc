/* test_dilation.c - compares the nearest-texel transform with a search over all texels. */
#include "base/parallel.h"
#include "libbake/maps/dilation.h"
#include "tests/unit/test.h"

static uint32_t next_random(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return *state >> 8;
}

/* A map; the value of a valid texel is its own number. */
struct map {
    uint32_t width, height;
    uint8_t *valid;
};

static void fill_random(struct map *map, uint32_t *seed)
{
    /* From nearly empty to nearly full. Blocks of texels give long runs. */
    uint32_t threshold = 1 + next_random(seed) % 1000, block = 1 + next_random(seed) % 9;
    if (next_random(seed) % 2)
        threshold = threshold * threshold / 1000 / 20;
    for (uint32_t y = 0; y < map->height; ++y)
        for (uint32_t x = 0; x < map->width; ++x) {
            uint32_t cell = (y / block) * 7919u + (x / block) * 104729u + block * threshold;
            map->valid[y * map->width + x] = next_random(&cell) % 1000 < threshold;
        }
}

static struct bake_image *make_image(struct bsq_ctx *ctx, const struct map *map, bool in_memory)
{
    struct bake_image_options options = {.width = map->width,
                                         .height = map->height,
                                         .channels = 2,
                                         .memory_bytes = in_memory ? UINT64_MAX : 0};
    struct bake_image *image;
    assert_int_equal(bake_image_create(ctx, &options, &image), 0);
    assert_int_equal(image->samples != NULL, in_memory);
    for (uint32_t i = 0; i < map->width * map->height; ++i) {
        float texel[2] = {i % 3 ? BAKE_MISSED : BAKE_OUTSIDE, -1.0f};
        if (map->valid[i]) {
            texel[0] = 0.25f;
            texel[1] = (float)i;
        }
        assert_int_equal(bake_image_write(image, i % map->width, i / map->width, 1, 1, texel), 0);
    }
    return image;
}

/* Returns the number of the nearest valid texel, or -1 if all are farther than the padding. Ties go
 * to the lowest row, then the lowest column, as later texels must be strictly nearer. */
static int64_t search(const struct map *map, int64_t x, int64_t y, uint32_t padding)
{
    int64_t best = -1, best_distance = INT64_MAX;
    for (int64_t v = 0; v < map->height; ++v)
        for (int64_t u = 0; u < map->width; ++u) {
            int64_t distance = (u - x) * (u - x) + (v - y) * (v - y);
            if (map->valid[v * map->width + u] && distance < best_distance) {
                best_distance = distance;
                best = v * map->width + u;
            }
        }
    if (padding != UINT32_MAX && best_distance > (int64_t)padding * padding)
        return -1;
    return best;
}

struct check {
    struct bake_dilation *padding;
    const struct map *map;
    const int64_t *expected;
    uint32_t first_row;
};

static int check_row(void *arg, uint64_t row, unsigned worker)
{
    struct check *check = arg;
    const float *const *sources;
    const float *texels;
    bake_dilation_row(check->padding, (uint32_t)row, worker, &sources, &texels);
    for (uint32_t x = 0; x < check->map->width; ++x) {
        size_t i = (check->first_row + row) * check->map->width + x;
        int64_t found = sources[x] ? (int64_t)sources[x][1] : -1;
        if (found != check->expected[i] || (texels[2 * x] > 0) != check->map->valid[i])
            return BSQ_EBUG;
    }
    return 0;
}

static void check_image(struct bsq_ctx *ctx, const struct map *map, const int64_t *expected,
                        uint32_t padding, uint32_t band_rows, bool in_memory)
{
    struct bake_image *image = make_image(ctx, map, in_memory);
    struct check check = {.map = map, .expected = expected};
    assert_int_equal(bake_dilation_create(ctx, image, band_rows, padding, NULL, &check.padding), 0);
    uint32_t rows, next = 0;
    for (;;) {
        assert_int_equal(bake_dilation_next_band(check.padding, &check.first_row, &rows), 0);
        if (rows == 0)
            break;
        assert_int_equal(check.first_row, next);
        assert_int_equal(bsq_parallel_for(ctx, rows, check_row, &check), 0);
        next += rows;
    }
    assert_int_equal(next, map->height);
    bake_dilation_free(check.padding);
    bake_image_free(image);
}

CONTEXT_TEST(test_sources_are_the_nearest, 3, 0)
{
    uint32_t seed = (uint32_t)getpid();
    print_message("seed %u\n", seed);
    uint8_t valid[60 * 60];
    int64_t expected[60 * 60];
    static const uint32_t paddings[] = {0, 1, 2, 5, 16, UINT32_MAX};
    for (int round = 0; round < 120; ++round) {
        struct map map = {1 + next_random(&seed) % 60, 1 + next_random(&seed) % 60, valid};
        uint32_t padding = paddings[next_random(&seed) % 6];
        fill_random(&map, &seed);
        for (uint32_t i = 0; i < map.width * map.height; ++i)
            expected[i] = search(&map, i % map.width, i / map.width, padding);
        check_image(ctx, &map, expected, padding, map.height, true);
        check_image(ctx, &map, expected, padding, 1 + next_random(&seed) % 20, true);
        check_image(ctx, &map, expected, padding, 1 + next_random(&seed) % 20, false);
    }
}

/* A single valid texel is carried over many bands. */
CONTEXT_TEST(test_padding_reaches_over_many_bands, 2, 0)
{
    enum { WIDTH = 300, HEIGHT = 40 };
    uint8_t *valid = calloc(WIDTH * HEIGHT, 1);
    int64_t *expected = malloc(WIDTH * HEIGHT * sizeof *expected);
    struct map map = {WIDTH, HEIGHT, valid};
    for (uint32_t at = 0; at < WIDTH * HEIGHT; at += 1999) {
        valid[at] = 1;
        for (uint32_t i = 0; i < WIDTH * HEIGHT; ++i)
            expected[i] = at;
        check_image(ctx, &map, expected, UINT32_MAX, 1, true);
        check_image(ctx, &map, expected, UINT32_MAX, 3, false);
        valid[at] = 0;
    }
    for (uint32_t i = 0; i < WIDTH * HEIGHT; ++i)
        expected[i] = -1;
    check_image(ctx, &map, expected, UINT32_MAX, 7, true);
    free(valid);
    free(expected);
}

RUN_TESTS(NULL, NULL)

/* operations_lanes.c - checks the operations of base/simd at the level that this is compiled for.
 */
#include "tests/unit/base/simd/operations.h"
#include "tests/unit/fixture.h"

/* Returns a special value, random bits, a whole number or a fraction. */
static double random_double(uint64_t *state)
{
    static const double special[] = {0.0,      -0.0,      1.0,       NAN,
                                     INFINITY, -INFINITY, 0x1p-1074, -0x1p-1030};
    const uint64_t x = test_random(state);
    double number;
    memcpy(&number, &x, sizeof number);
    return x % 4 == 0   ? special[x >> 61]
           : x % 4 == 1 ? number
           : x % 4 == 2 ? (double)(int32_t)(x >> 60) - 8
                        : (double)(int64_t)x * 0x1p-54;
}

static float random_float(uint64_t *state)
{
    static const float special[] = {0, -0.0f, 1, NAN, INFINITY, -INFINITY, 0x1p-149f, -0x1p-130f};
    const uint64_t x = test_random(state);
    const uint32_t bits = (uint32_t)(x >> 32);
    float number;
    memcpy(&number, &bits, sizeof number);
    return x % 4 == 0   ? special[x >> 61]
           : x % 4 == 1 ? number
           : x % 4 == 2 ? (float)(int32_t)(x >> 60) - 8
                        : (float)(int32_t)bits * 0x1p-22f;
}

/* Returns whether the numbers have equal bits or are both NaN: no operation promises the bits of a
 * NaN. */
static bool same(double a, double b)
{
    return memcmp(&a, &b, sizeof a) == 0 || (isnan(a) && isnan(b));
}

/* Each compares number i of a vector or row with an expression in i. */
#define EXPECT(count, got, wanted)                                                                 \
    for (int i = 0; i < (count); i++)                                                              \
    assert_true(same((double)(got), (double)(wanted)))
#define EXPECT_DOUBLES(vector, wanted) EXPECT(LANE_COUNT, (vector)[i], wanted)
#define EXPECT_FLOATS(vector, wanted)  EXPECT(SIMD_FLOATS, (vector)[i], wanted)
#define EXPECT_ROW(row, wanted)        EXPECT(4, row_number(row, i), wanted)
/* The same for integers, and for bit i of a mask. */
#define EXPECT_INTS(count, got, wanted)                                                            \
    for (int i = 0; i < (count); i++)                                                              \
    assert_true((long long)(got) == (long long)(wanted))
#define EXPECT_MASK(mask, wanted) EXPECT_INTS(LANE_COUNT, lanes_bits(mask) >> i & 1, wanted)

static void check_lanes(uint64_t *state)
{
    double a[LANE_COUNT], b[LANE_COUNT], out[LANE_COUNT];
    for (int i = 0; i < LANE_COUNT; i++) {
        a[i] = random_double(state);
        b[i] = random_double(state);
    }
    const doubles x = lanes_load(a), y = lanes_load(b);
    const lane_mask less = lanes_less(x, y);
    lanes_store(x, out);
    assert_memory_equal(out, a, sizeof a);
    EXPECT_DOUBLES(lanes_all(a[0]), a[0]);
    EXPECT_MASK(less, a[i] < b[i]);
    EXPECT_MASK(lanes_equal(x, y), a[i] == b[i]);
    EXPECT_MASK(~less, !(a[i] < b[i]));
    EXPECT_MASK(less | lanes_equal(x, y), a[i] <= b[i]);
    EXPECT_MASK(lanes_signs(x), signbit(a[i]) != 0);
    EXPECT_MASK(lanes_none(), 0);
    EXPECT_DOUBLES(lanes_keep(less, x), a[i] < b[i] ? a[i] : 0.0);
    EXPECT_DOUBLES(lanes_select(less, x, y), a[i] < b[i] ? a[i] : b[i]);
    EXPECT_DOUBLES(lanes_min(x, y), a[i] < b[i] ? a[i] : b[i]);
    EXPECT_DOUBLES(lanes_max(x, y), a[i] > b[i] ? a[i] : b[i]);
    EXPECT_DOUBLES(lanes_abs(x), fabs(a[i]));
    EXPECT_DOUBLES(lanes_sqrt(x), sqrt(a[i]));
    EXPECT_DOUBLES(x + y, a[i] + b[i]);
    EXPECT_DOUBLES(x / y, a[i] / b[i]);
#if LANE_COUNT == 8
    const uint64_t which = test_random(state);
    int packed = 0;
    lane_ints places;
    for (int i = 0; i < LANE_COUNT; i++) {
        places[i] = (long long)(which >> i);
        if (a[i] < b[i])
            out[packed++] = a[i];
    }
    EXPECT_DOUBLES(lanes_pick(x, places), a[which >> i & 7]);
    EXPECT_DOUBLES(lanes_pack(less, x), i < packed ? out[i] : 0.0);
#endif
}

static void check_lane_integers(uint64_t *state)
{
    long long n[LANE_COUNT], m[LANE_COUNT], out[LANE_COUNT];
    double whole[LANE_COUNT], sign[LANE_COUNT];
    for (int i = 0; i < LANE_COUNT; i++) {
        /* Halves, so that sums do not overflow. */
        n[i] = (long long)test_random(state) >> 1;
        m[i] = (long long)test_random(state) >> 1;
        whole[i] = (double)(n[i] >> 12);
        sign[i] = m[i] < 0 ? -1.0 : 1.0;
    }
    const lane_ints x = lanes_load_ints(n), y = lanes_load_ints(m);
    const lane_mask mask = lanes_signs(lanes_load(sign));
    lanes_store_ints(x, out);
    assert_memory_equal(out, n, sizeof n);
    EXPECT_INTS(LANE_COUNT, lanes_all_bits((uint64_t)n[0])[i], n[0]);
    EXPECT_INTS(LANE_COUNT, lanes_set_bits(mask, x, y)[i], m[i] < 0 ? n[i] | m[i] : n[i]);
    EXPECT_INTS(LANE_COUNT, lanes_add_ints(mask, x, y)[i], m[i] < 0 ? n[i] + m[i] : n[i]);
    EXPECT_INTS(LANE_COUNT,
                (lanes_integer_bits(lanes_load(whole))[i] ^ n[i] >> 12) & 0x7ffffffffffff, 0);
}

static void check_gathering(uint64_t *state)
{
    double from[LANE_COUNT][4], to[LANE_COUNT][8], in[6][LANE_COUNT];
    float narrow[LANE_COUNT][4];
    int32_t integers[LANE_COUNT][4];
    const double *doubles_from[LANE_COUNT];
    const float *floats_from[LANE_COUNT];
    const int32_t *integers_from[LANE_COUNT];
    double *rows_to[LANE_COUNT];
    doubles out[6];
    for (int i = 0; i < LANE_COUNT; i++) {
        doubles_from[i] = from[i];
        floats_from[i] = narrow[i];
        integers_from[i] = integers[i];
        rows_to[i] = to[i];
        for (int k = 0; k < 4; k++) {
            from[i][k] = random_double(state);
            narrow[i][k] = random_float(state);
            integers[i][k] = (int32_t)test_random(state);
        }
        for (int k = 0; k < 6; k++)
            in[k][i] = random_double(state);
    }
    lanes_gather_four(doubles_from, out);
    for (int k = 0; k < 4; k++)
        EXPECT_DOUBLES(out[k], from[i][k]);
    lanes_gather_floats(floats_from, out);
    for (int k = 0; k < 4; k++)
        EXPECT_DOUBLES(out[k], narrow[i][k]);
    lanes_gather_integers(integers_from, out);
    for (int k = 0; k < 4; k++)
        EXPECT_DOUBLES(out[k], integers[i][k]);
    for (int k = 0; k < 6; k++)
        out[k] = lanes_load(in[k]);
    lanes_scatter_six(out, rows_to);
    for (int k = 0; k < 6; k++)
        EXPECT(LANE_COUNT, to[i][k], in[k][i]);
    memset(to, 0, sizeof to);
    lanes_scatter(out, rows_to);
    for (int k = 0; k < 8; k++)
        EXPECT(LANE_COUNT, to[i][k], k < 4 ? in[k][i] : 0.0);
}

/* Rows of four words in the middle of records, in any order. */
static void check_float_rows(uint64_t *state)
{
    uint32_t records[SIMD_FLOATS][12], stored[SIMD_FLOATS][12];
    const void *from[SIMD_FLOATS];
    void *to[SIMD_FLOATS];
    floats words[4];
    for (int i = 0; i < SIMD_FLOATS; i++) {
        for (int w = 0; w < 12; w++)
            records[i][w] = (uint32_t)test_random(state);
        from[i] = records[(i * 5 + 3) % SIMD_FLOATS];
        to[i] = stored[(i * 5 + 3) % SIMD_FLOATS];
    }
    floats_load_rows(from, 16, words);
    for (int w = 0; w < 4; w++)
        EXPECT_INTS(SIMD_FLOATS, (uint32_t)((float_ints)words[w])[i],
                    records[(i * 5 + 3) % SIMD_FLOATS][4 + w]);
    memset(stored, 0xa5, sizeof stored);
    floats_store_rows(to, 16, words[0], words[1], words[2], words[3]);
    for (int i = 0; i < SIMD_FLOATS; i++)
        for (int w = 0; w < 12; w++)
            assert_int_equal(stored[i][w], w >= 4 && w < 8 ? records[i][w] : 0xa5a5a5a5);
    /* Of places that are equal, the last one counts. */
    for (int i = 0; i < SIMD_FLOATS; i++)
        to[i] = stored[0];
    floats_store_rows(to, 0, words[0], words[1], words[2], words[3]);
    for (int w = 0; w < 4; w++)
        assert_int_equal(stored[0][w], ((const uint32_t *)from[SIMD_FLOATS - 1])[4 + w]);
}

static void check_floats(uint64_t *state)
{
    float a[SIMD_FLOATS], b[SIMD_FLOATS];
    int32_t n[SIMD_FLOATS], m[SIMD_FLOATS];
    floats x, y;
    float_ints p, q;
    uint32_t bits = (uint32_t)(test_random(state) & ((UINT64_C(1) << SIMD_FLOATS) - 1));
    for (int i = 0; i < SIMD_FLOATS; i++) {
        x[i] = a[i] = random_float(state);
        y[i] = b[i] = random_float(state);
        p[i] = n[i] = (int32_t)test_random(state);
        q[i] = m[i] = (int32_t)test_random(state);
    }
    EXPECT_FLOATS(floats_select(x < y, x, y), a[i] < b[i] ? a[i] : b[i]);
    EXPECT_FLOATS(floats_min(x, y), a[i] < b[i] ? a[i] : b[i]);
    EXPECT_FLOATS(floats_max(x, y), a[i] > b[i] ? a[i] : b[i]);
    EXPECT_FLOATS(floats_sqrt(x), sqrtf(a[i]));
    EXPECT_FLOATS(floats_floor(x), floorf(a[i]));
    EXPECT_FLOATS(floats_abs(x), fabsf(a[i]));
    EXPECT_INTS(SIMD_FLOATS, floats_min_ints(p, q)[i], n[i] < m[i] ? n[i] : m[i]);
    EXPECT_INTS(SIMD_FLOATS, floats_max_ints(p, q)[i], n[i] > m[i] ? n[i] : m[i]);
    EXPECT_INTS(SIMD_FLOATS, floats_bits(x < y) >> i & 1, a[i] < b[i]);
    EXPECT_INTS(SIMD_FLOATS, floats_mask_of(bits)[i], (bits >> i & 1) ? -1 : 0);
    assert_int_equal(floats_bits(floats_mask_of(bits)), bits);
#ifdef floats_gather
    for (int i = 0; i < SIMD_FLOATS; i++)
        q[i] = m[i] & (SIMD_FLOATS - 1);
    EXPECT_INTS(SIMD_FLOATS, floats_gather(n, q)[i], n[m[i] & (SIMD_FLOATS - 1)]);
#endif
}

static void check_rows(uint64_t *state)
{
    double a[4], b[4], sum[4], near[4];
    float narrow[3];
    for (int i = 0; i < 4; i++) {
        sum[i] = a[i] = random_double(state);
        b[i] = random_double(state);
        near[i] = (double)(int64_t)test_random(state) * 0x1p-33;
    }
    for (int i = 0; i < 3; i++)
        narrow[i] = random_float(state);
    const struct row x = row_load(a), y = row_load(b);
    EXPECT_ROW(x, a[i]);
    const struct row of = row_of(a[0], a[1], a[2], a[3]);
    EXPECT_ROW(of, a[i]);
    EXPECT_ROW(row_sum(x, y), a[i] + b[i]);
    EXPECT_ROW(row_difference(x, y), a[i] - b[i]);
    EXPECT_ROW(row_product(x, y), a[i] * b[i]);
    EXPECT_ROW(row_quotient(x, y), a[i] / b[i]);
    EXPECT_ROW(row_times(b[0], x), b[0] * a[i]);
    EXPECT_ROW(row_with_last(x, b[0]), i == 3 ? b[0] : a[i]);
    EXPECT_ROW(row_rotate(x), i == 3 ? a[3] : a[(i + 1) % 3]);
    EXPECT_ROW(row_min(x, y), a[i] < b[i] ? a[i] : b[i]);
    EXPECT_ROW(row_max(x, y), a[i] > b[i] ? a[i] : b[i]);
    EXPECT_ROW(row_of_floats(narrow), i == 3 ? 0.0F : narrow[i]);
    row_add(sum, y);
    EXPECT(4, sum[i], a[i] + b[i]);
    EXPECT_INTS(4, row_floor(row_load(near))[i], floor(near[i]));
}

static void check_integers(uint64_t *state)
{
    int32_t a[4], b[4];
    uint32_t words[16], bits = 0;
    for (int i = 0; i < 4; i++) {
        a[i] = (int32_t)test_random(state);
        b[i] = (int32_t)test_random(state);
    }
    for (int i = 0; i < 16; i++) {
        const uint64_t x = test_random(state);
        words[i] = x & 1 ? (uint32_t)1 << (x >> 59) : 0;
        bits |= (uint32_t)(words[i] != 0) << i;
    }
    const four_ints x = four_load(a), y = four_load(b);
    four_ints one = {0};
    assert_false(four_any(one));
    one[a[0] & 3] = -1;
    assert_true(four_any(one));
    EXPECT_INTS(4, four_min(x, y)[i], a[i] < b[i] ? a[i] : b[i]);
    assert_int_equal(bits_of_sixteen(words), bits);
}

void BSQ_SIMD_NAME(test_operations)(uint64_t seed)
{
    for (int i = 0; i < 20000; i++) {
        check_lanes(&seed);
        check_lane_integers(&seed);
        check_gathering(&seed);
        check_floats(&seed);
        check_float_rows(&seed);
        check_rows(&seed);
        check_integers(&seed);
    }
}

/* test_bake_options.c - the table of a bake's options: it has each byte of them, so that plans keep
 * all members, and its rows agree with themselves. */
#include "tests/unit/test.h"

#include "libbake/bake.h"

static void cover(unsigned char *bytes, size_t offset, size_t count)
{
    for (size_t i = offset; i < offset + count; i++) {
        assert_int_not_equal(bytes[i], 0); /* not covered twice, and no padding */
        bytes[i] = 0;
    }
}

/* Clears the bytes of the rows, which must be exactly those of the structure without padding. */
static void assert_covered(const struct bsq_option *rows, size_t count, unsigned char *bytes,
                           size_t size)
{
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        cover(bytes, row->offset, row->bytes);
        if (row->kind == BSQ_OPTION_LIST)
            cover(bytes, row->count_offset, sizeof(uint32_t));
    }
    for (size_t i = 0; i < size; i++)
        if (bytes[i] != 0)
            fail_msg("byte %zu is in no row", i);
}

#if defined __has_builtin
#if __has_builtin(__builtin_clear_padding)
#define MARK(object)                                                                               \
    do {                                                                                           \
        memset(&(object), 0xff, sizeof(object));                                                   \
        __builtin_clear_padding(&(object));                                                        \
    } while (0)
#endif
#endif

static const struct bsq_option *row_of(const char *member)
{
    size_t count;
    const struct bsq_option *row = bake_option_rows(&count);
    while (strcmp(row->member, member) != 0)
        row++;
    return row;
}

TEST(test_rows_cover_the_structures)
{
#ifdef MARK
    static struct bake_options options;
    static struct bake_transfer transfer;
    static struct bake_tile_size size;
    static struct bake_tile_range range;
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    MARK(options);
    options.size = 0; /* the caller's own: plans do not keep these */
    options.page = NULL;
    options.on_rows = NULL;
    options.rows_user = NULL;
    memset(&options.rows_only, 0, sizeof options.rows_only);
    assert_covered(rows, count, (unsigned char *)&options, sizeof options);
    MARK(transfer);
    MARK(size);
    MARK(range);
    const struct {
        const char *member;
        void *bytes;
        size_t size;
    } lists[] = {{"transfers", &transfer, sizeof transfer},
                 {"tile_sizes", &size, sizeof size},
                 {"tile_ranges", &range, sizeof range}};
    for (size_t i = 0; i < sizeof lists / sizeof *lists; i++) {
        const struct bsq_option *row = row_of(lists[i].member);
        assert_int_equal(row->element_bytes, lists[i].size);
        assert_covered(row->rows, row->row_count, lists[i].bytes, lists[i].size);
    }
#else
    skip(); /* the compiler cannot tell padding from members */
#endif
}

static size_t size_of(enum bsq_option_kind kind)
{
    switch (kind) {
    case BSQ_OPTION_FLAG:
        return sizeof(bool);
    case BSQ_OPTION_COUNT:
    case BSQ_OPTION_CHOICE:
        return sizeof(uint32_t);
    case BSQ_OPTION_BYTES:
        return sizeof(uint64_t);
    case BSQ_OPTION_NUMBER:
        return sizeof(double);
    default:
        return sizeof(void *);
    }
}

CONTEXT_TEST(test_rows_agree_with_themselves, 1, 0)
{
    struct bake_options options;
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        assert_int_equal(row->bytes, size_of(row->kind));
        if (row->key)
            assert_non_null(row->name);
        if (row->name)
            assert_true(row->help && (row->argument || row->kind == BSQ_OPTION_FLAG));
        if (row->kind == BSQ_OPTION_CHOICE)
            assert_non_null(row->words);
        for (const struct bsq_option *other = rows; other < row; other++) {
            assert_string_not_equal(row->member, other->member);
            if (row->name && other->name && strcmp(row->name, other->name) == 0) {
                assert_string_not_equal(row->key, other->key);
                assert_string_equal(row->name, row[-1].name); /* keys follow each other */
            }
        }
    }
    bake_defaults(&options);
    assert_int_equal(bsq_options_check(ctx, rows, count, &options), 0);
}

/* Values just outside of what a row allows are refused, and those on the limits are not. */
CONTEXT_TEST(test_limits_are_checked, 1, 0)
{
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        struct bake_options options;
        bake_defaults(&options);
        void *at = bsq_option_at(row, &options);
        if (row->kind == BSQ_OPTION_NUMBER) {
            *(double *)at = row->most;
            assert_int_equal(bsq_options_check(ctx, row, 1, &options), 0);
            const double bad[] = {NAN, INFINITY, -INFINITY, row->positive ? 0 : NAN};
            for (int i = 0; i < 4; i++) {
                *(double *)at = bad[i];
                assert_int_equal(bsq_options_check(ctx, row, 1, &options), BSQ_EUSAGE);
                bsq_clear_error(ctx);
            }
        } else if (row->kind == BSQ_OPTION_COUNT && row->most < UINT32_MAX - 1.0) {
            *(uint32_t *)at = (uint32_t)row->most;
            assert_int_equal(bsq_options_check(ctx, row, 1, &options), 0);
            *(uint32_t *)at = (uint32_t)row->most + 1;
            assert_int_equal(bsq_options_check(ctx, row, 1, &options), BSQ_EUSAGE);
        } else if (row->kind == BSQ_OPTION_CHOICE || row->kind == BSQ_OPTION_TEXT) {
            memset(at, row->kind == BSQ_OPTION_TEXT ? 0 : 0x7f, row->bytes);
            assert_int_equal(bsq_options_check(ctx, row, 1, &options), BSQ_EUSAGE);
        }
        bsq_clear_error(ctx);
    }
}

TEST(test_words)
{
    static const char words[] = "smooth/area angle max";
    assert_int_equal(bsq_option_word(words, "smooth"), 0);
    assert_int_equal(bsq_option_word(words, "area"), 0);
    assert_int_equal(bsq_option_word(words, "angle"), 1);
    assert_int_equal(bsq_option_word(words, "max"), 2);
    assert_int_equal(bsq_option_word(words, "ma"), -1);
    assert_int_equal(bsq_option_word(words, "maxi"), -1);
    assert_int_equal(bsq_option_word(words, ""), -1);
    assert_int_equal(bsq_option_word(NULL, "max"), -1);
}

RUN_TESTS(NULL, NULL)

/* test_map_table.c - what every row of the table of maps must hold, so that a new map is checked
 * without a test of its own. */
#include "formats/material/channels.h"
#include "libbake/maps/map_encode.h"
#include "tests/unit/test.h"

static struct bake_options options_for(uint32_t maps, const char *output)
{
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = "scan.nvdb";
    options.mesh_path = "low.obj";
    options.output_path = output;
    options.maps = maps;
    return options;
}

/* test_bake.sh reads names from --help and looks for them in the man page: lower-case letters,
 * digits and underscores. */
TEST(test_names_are_unique_words)
{
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i) {
        const char *name = bake_map_name(i);
        assert_non_null(name);
        assert_true(name[0] != '\0');
        assert_true(fmt_is_map_name(name));
        assert_int_equal(strspn(name, "abcdefghijklmnopqrstuvwxyz_0123456789"), strlen(name));
        for (unsigned j = 0; j < i; ++j)
            assert_string_not_equal(name, bake_map_name(j));
        assert_non_null(bake_map_summary(i));
        assert_true(bake_map_summary(i)[0] != '\0');
    }
    assert_null(bake_map_name(BAKE_NAMED_MAPS));
    assert_null(bake_map_summary(BAKE_NAMED_MAPS));
}

TEST(test_a_bit_gives_the_file_of_its_name)
{
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i) {
        char expected[64];
        snprintf(expected, sizeof expected, "%s/a_%s.exr", bake_map_name(i), bake_map_name(i));
        char *path = bake_map_path("<MAP>/a_<MAP>.exr", bake_map_name(i));
        assert_string_equal(path, expected);
        free(path);
    }
}

TEST(test_maps_fill_the_channels_they_declare)
{
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i) {
        const struct bake_map_row *row = &bake_map_table[i];
        const uint32_t values = bake_map_values(i);
        float sums[16] = {0.5f, 0.25f, 0.75f, 0, 0, 0, 1}, value[8];
        assert_true(row->channels == 1 || row->channels == 3);
        assert_true(bake_map_sums[i] <= sizeof sums / sizeof *sums);
        assert_int_equal(bake_image_channels_for(1u << i), 1 + values);
        assert_int_equal(values > 0, row->resolve != NULL);
        assert_true(values == 0 || values >= row->channels);
        for (uint32_t c = 0; c < 8; ++c)
            value[c] = NAN;
        if (!row->resolve)
            continue;
        assert_true(row->resolve(sums, row->channels, 0.5f, value));
        for (uint32_t c = 0; c < 8; ++c)
            assert_int_equal(isnan(value[c]) != 0, c >= values);
    }
}

static struct bake_encoder encoder_for(unsigned number, const struct bake_traced *traced,
                                       bool integers, double largest)
{
    const struct bake_options options = options_for(1u << number, "a.exr");
    struct bake_encoding_facts facts = {
        .options = &options, .traced = traced, .integers = integers};
    struct bake_encoder encoder;
    bake_statistics_add_value(&facts.statistics, (float)largest);
    bake_encoder_init(&facts, 1u << number, number, &encoder);
    return encoder;
}

/* Returns the statistics of an image of a measured map; every third texel is not valid. */
static struct bake_statistics measure(unsigned number, unsigned threads, uint64_t image_bytes)
{
    enum { WIDTH = 37, HEIGHT = 600 };
    struct bsq_ctx *ctx = test_context(threads, 0);
    struct bake_statistics statistics[BK_MAP_COUNT] = {0};
    const struct bake_image_options options = {.width = WIDTH,
                                               .height = HEIGHT,
                                               .channels = bake_image_channels_for(1u << number),
                                               .memory_bytes = image_bytes,
                                               .beside = "map.exr"};
    struct bake_image *image;
    assert_int_equal(bake_image_create(ctx, &options, &image), 0);
    for (uint32_t i = 0; i < WIDTH * HEIGHT; ++i) {
        float texel[64] = {i % 3 > 0 ? 1.0f : BAKE_MISSED};
        texel[bake_map_offset(1u << number, number)] = (i % 2 ? -1.0f : 1.0f) / (float)(1 + i);
        assert_int_equal(bake_image_write(image, i % WIDTH, i / WIDTH, 1, 1, texel), 0);
    }
    assert_int_equal(bake_image_measure(ctx, image, 1u << number, statistics), 0);
    bake_image_free(image);
    test_context_end(ctx);
    return statistics[number];
}

TEST(test_statistics_do_not_depend_on_threads_or_memory)
{
    unsigned number = 0;
    while (!bake_map_table[number].measured)
        number++;
    const struct bake_statistics one = measure(number, 1, 1 << 30), more = measure(number, 5, 0);
    double sum = 0, squares = 0;
    for (uint32_t i = 0; i < 37 * 600; ++i) {
        const double value = i % 3 > 0 ? (double)(1.0f / (float)(1 + i)) : 0;
        sum += value;
        squares += value * value;
    }
    assert_memory_equal(&one, &more, sizeof one);
    assert_int_equal(one.count, 37 * 400);
    assert_true(one.largest == 0.5);
    assert_true(fabs(bake_statistics_mean(&one) * 37 * 400 / sum - 1) < 1e-12);
    assert_true(fabs(bake_statistics_mean_square(&one) * 37 * 400 / squares - 1) < 1e-12);
}

TEST(test_attributes_fit_their_list)
{
    const struct bake_traced traced = {.front = 0.125,
                                       .back = 1e-300,
                                       .sampling = "exact",
                                       .scan_min = {-1e-300, -1e300, -1.0 / 3},
                                       .scan_max = {1e-300, 1e300, 1.0 / 3}};
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i) {
        struct bake_options options = options_for(1u << i, "a.exr");
        struct bake_attributes attributes;
        bake_describe_map(&options, i, &traced, &attributes);
        assert_true(attributes.count <= sizeof attributes.list / sizeof *attributes.list);
        for (uint32_t a = 0; a < attributes.count; ++a)
            if (strcmp(attributes.list[a].name, "bisque:map") == 0)
                assert_string_equal(attributes.list[a].value, bake_map_name(i));
        const struct bake_encoder encoder = encoder_for(i, &traced, true, 1.0 / 3);
        bake_describe_encoding(&encoder, &attributes);
        assert_true(attributes.count <= sizeof attributes.text / sizeof *attributes.text + 1);
        assert_int_equal(attributes.count > 0, bake_map_table[i].unit != NULL);
    }
}

/* A user who names only a map and a file name must get the map in at least one format. Messages
 * about the others name the map. */
CONTEXT_TEST(test_some_format_stores_each_map, 1, 0)
{
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i) {
        bool stored = false;
        for (int f = 0; fmt_image_formats[f]; ++f) {
            char path[32];
            snprintf(path, sizeof path, "a%s", fmt_image_formats[f]->suffix);
            struct bake_options options = options_for(1u << i, path);
            if (bake_check_options(ctx, &options) == 0)
                stored = true;
            else
                assert_non_null(strstr(bsq_error(ctx), bake_map_name(i)));
            bsq_clear_error(ctx);
        }
        assert_true(stored);
    }
}

TEST(test_defaults_need_no_colours)
{
    uint32_t grey = bake_choose_maps(BAKE_MAPS_DEFAULT, false, false);
    uint32_t colored = bake_choose_maps(BAKE_MAPS_DEFAULT, true, false);
    assert_int_equal(grey, BAKE_MAP_NORMAL);
    assert_int_equal(colored, BAKE_MAP_NORMAL | BAKE_MAP_COLOR);
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i) {
        assert_false(grey & 1u << i && bake_map_table[i].needs_color);
        assert_int_equal(bake_choose_maps(1u << i, false, false), 1u << i);
    }
}

/* "All" leaves out what the scan lacks, but not what is named. */
TEST(test_all_maps_are_those_that_the_scan_gives)
{
    const uint32_t every = (1u << BAKE_NAMED_MAPS) - 1;
    assert_int_equal(bake_choose_maps(BAKE_MAPS_ALL, true, true), every);
    assert_int_equal(bake_choose_maps(BAKE_MAPS_ALL, false, true),
                     every & ~(uint32_t)BAKE_MAP_COLOR);
    assert_int_equal(bake_choose_maps(BAKE_MAPS_ALL | BAKE_MAP_COLOR, false, true), every);
    assert_int_equal(bake_choose_maps(BAKE_MAPS_ALL, true, false), every & ~(uint32_t)BAKE_MAP_ID);
}

/* Maps that say how to decode their samples say it correctly, also if there is only one value. */
TEST(test_encodings_decode_to_the_values)
{
    const struct bake_traced traced = {
        .scan_min = {-1, 5, 3}, .scan_max = {2, 5, 4}, .image_origin = {0.5, 4, 3}};
    static const double largest[] = {0.75, 0};
    for (unsigned i = 0; i < BAKE_NAMED_MAPS; ++i)
        for (int variant = 0; variant < 4; ++variant) {
            const bool integers = variant & 1;
            const struct bake_map_row *row = &bake_map_table[i];
            const double most = largest[variant >> 1];
            const struct bake_encoder encoder = encoder_for(i, &traced, integers, most);
            const float value = (float)most, texel[4] = {1, value, value, value};
            const float *const source = texel;
            float samples[3];
            if (!row->unit)
                continue;
            bake_encode_row(&encoder, &source, texel, 4, 1, samples);
            for (uint32_t c = 0; c < row->channels; ++c) {
                const struct bake_encoding *e = &encoder.encoding;
                const double world = e->origin[c] + e->offset[c] + e->scale[c] * (double)samples[c];
                const double shift = row->positions ? traced.image_origin[c] : 0;
                assert_true(!integers || (samples[c] >= 0 && samples[c] <= 1));
                assert_true(fabs(world - shift - (double)value) < 1e-6);
            }
        }
}

TEST(test_samples_are_limited_to_halves)
{
    float samples[] = {0,        65504,     -65504, 65505, -65505,
                       INFINITY, -INFINITY, 1e30f,  6e-8f, (float)NAN};
    assert_int_equal(bake_limit_to_half(samples, 10), 5);
    static const float expected[] = {0, 65504, -65504, 65504, -65504, 65504, -65504, 65504, 6e-8f};
    for (int i = 0; i < 9; ++i)
        assert_true(samples[i] == expected[i]);
    assert_true(isnan(samples[9]));
}

/* Three sums each, after those of the rows; files have the channels of the name. */
TEST(test_transfer_maps_follow_the_rows)
{
    const struct bake_transfer transfers[] = {{.name = "roughness", .texture_path = "r.png"},
                                              {.name = "emission", .texture_path = "e.png"},
                                              {.name = "other", .texture_path = "o.png"}};
    struct bake_options options = options_for(BAKE_MAP_ID | BAKE_MAP_NORMAL, "a_<MAP>.exr");
    options.transfers = transfers;
    options.transfer_count = 3;
    const uint32_t maps = bake_selection(&options), rows = options.maps;
    const uint32_t floats = bk_texel_floats(rows), place = bake_image_channels_for(rows);
    float texel[64] = {0};
    const float values[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9};
    assert_int_equal(bk_texel_floats(maps), floats + 9);
    assert_int_equal(bake_image_channels_for(maps), place + 9);
    assert_int_equal(bake_map_offset(maps, BK_MAP_id), bake_map_offset(rows, BK_MAP_id));
    assert_int_equal(bake_map_offset(maps, BK_MAP_COUNT + 2), place + 6);
    bk_add_transfers(maps, values, texel);
    bk_add_transfers(maps, values, texel);
    for (uint32_t i = 0; i < floats; ++i)
        assert_true(texel[i] == 0);
    for (uint32_t i = 0; i < 9; ++i)
        assert_true(texel[floats + i] == 2.0f * values[i]);
    assert_int_equal(bake_row_of(&options, BK_MAP_COUNT)->channels, 1);
    assert_false(bake_row_of(&options, BK_MAP_COUNT)->color);
    assert_true(bake_row_of(&options, BK_MAP_COUNT + 1)->color);
    assert_int_equal(bake_row_of(&options, BK_MAP_COUNT + 2)->channels, 3);
    char *path = bake_path_of(&options, BK_MAP_COUNT + 1);
    assert_string_equal(path, "a_emission.exr");
    free(path);
    options.maps = 0;
    assert_int_equal(bake_first_of(bake_selection(&options)), BK_MAP_COUNT);
}

CONTEXT_TEST(test_unknown_maps_and_sizes_are_refused, 1, 0)
{
    for (unsigned bit = BAKE_NAMED_MAPS; bit < 32; ++bit) {
        if (1u << bit == BAKE_MAPS_ALL || 1u << bit == BAKE_MAPS_USUAL)
            continue;
        struct bake_options options = options_for(1u << bit, "a_<MAP>.exr");
        assert_int_equal(bake_check_options(ctx, &options), BSQ_EUSAGE);
        assert_non_null(strstr(bsq_error(ctx), "unknown maps: 0x"));
        bsq_clear_error(ctx);
    }
    static const uint32_t sides[] = {0, BAKE_MAX_SIDE + 1};
    for (int i = 0; i < 4; i++) {
        struct bake_options options = options_for(BAKE_MAP_NORMAL, "a.exr");
        *(i % 2 ? &options.width : &options.height) = sides[i / 2];
        assert_int_equal(bake_check_options(ctx, &options), BSQ_EUSAGE);
        bsq_clear_error(ctx);
    }
}

RUN_TESTS(NULL, NULL)

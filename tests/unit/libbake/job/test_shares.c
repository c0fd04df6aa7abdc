/* test_shares.c - the division of blocks among the parts of a bake. */
#include "tests/unit/test.h"

#include "libbake/job/parts.h"

enum { PARTS = 7, TILES = 2 };

/* Makes a job of two tiles without triangles. */
static void begin(struct bsq_ctx *ctx, struct bake_options *options, struct bake_tile *tiles,
                  struct bake_job *job)
{
    bake_defaults(options);
    memset(tiles, 0, TILES * sizeof *tiles);
    tiles[0].options.width = 200;
    tiles[0].options.height = 90;
    tiles[1].options.width = 64;
    tiles[1].options.height = 300;
    *job = (struct bake_job){.ctx = ctx, .options = options, .tiles = tiles, .udim.count = TILES};
}

static void end(struct bake_job *job)
{
    for (uint32_t t = 0; t < TILES; t++) {
        bsq_free(job->ctx, job->tiles[t].shares);
        job->tiles[t].shares = NULL;
    }
}

static uint32_t side_of(struct bake_job *job)
{
    assert_int_equal(bake_cut_blocks(job), 0);
    end(job);
    return job->tiles[0].blocks.side;
}

CONTEXT_TEST(test_sides_suit_the_parts, 2, 0)
{
    struct bake_options options;
    struct bake_tile tiles[TILES];
    struct bake_job job;
    begin(ctx, &options, tiles, &job);
    options.parts = PARTS;
    assert_int_equal(side_of(&job), 16);
    tiles[0].options.width = tiles[0].options.height = 16384;
    options.parts = 16;
    assert_int_equal(side_of(&job), 64);
    options.parts = 2048;
    assert_int_equal(side_of(&job), 32);
}

/* Parts have about as many samples, each block has one part, and blocks that follow each other on
 * the curve have the same one or the next. */
CONTEXT_TEST(test_parts_are_balanced, 2, 0)
{
    static struct bake_share_block blocks[512];
    struct bake_options options;
    struct bake_tile tiles[TILES];
    struct bake_job job;
    uint64_t count = 0, all = 0, most = 0, listed = 0;
    begin(ctx, &options, tiles, &job);
    options.parts = PARTS;
    assert_int_equal(bake_cut_blocks(&job), 0);
    assert_int_equal(tiles[0].blocks.columns, 13);
    assert_int_equal(tiles[0].blocks.rows, 6);
    for (uint32_t t = 0; t < TILES; t++)
        for (uint32_t b = 0; b < tiles[t].blocks.columns * tiles[t].blocks.rows; b++)
            if (b % 5 != 4) /* the others have no samples */
                blocks[count++] = (struct bake_share_block){
                    .index = (b * 37u) % 64, .tile = t, .block = b, .samples = 100 + b};
    bake_share_out(&job, blocks, count);
    for (uint64_t i = 1; i < count; i++) {
        const uint32_t before = tiles[blocks[i - 1].tile].shares[blocks[i - 1].block];
        const uint32_t share = tiles[blocks[i].tile].shares[blocks[i].block];
        assert_true(blocks[i].index >= blocks[i - 1].index);
        assert_true(share == before || share == before + 1);
    }
    for (options.part = 1; options.part <= PARTS; options.part++) {
        job.texels = job.part_texels = 0;
        bake_share_out(&job, blocks, count);
        all += job.part_texels;
        most = job.part_texels > most ? job.part_texels : most;
        for (uint32_t t = 0; t < TILES; t++) {
            struct bake_blocks *of = &tiles[t].blocks;
            uint32_t next = 0;
            of->count = 0;
            assert_int_equal(bake_take_share(&job, &tiles[t]), 0);
            for (uint64_t b = 0; b < (uint64_t)of->columns * of->rows; b++)
                if (of->places[b] != BAKE_NO_PLACE)
                    assert_int_equal(of->places[b], next++);
            assert_int_equal(next, of->count);
            listed += next;
            bsq_free(ctx, (void *)(uintptr_t)of->places);
        }
    }
    assert_int_equal(all, job.texels);
    assert_true(most * PARTS < all + all / 4);
    assert_int_equal(listed, 13 * 6 + 4 * 19);
    end(&job);
}

RUN_TESTS(NULL, NULL)

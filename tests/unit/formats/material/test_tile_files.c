/* test_tile_files.c - which files are tiles of a texture. */
#include <fcntl.h>
#include <sys/stat.h>

#include "formats/material/tile_files.h"
#include "tests/unit/test.h"

static const char *const files[] = {"a.1001.png",
                                    "a.1012.png",
                                    "a.9990.png",
                                    "a.1000.png",
                                    "a.0999.png",
                                    "a.10010.png",
                                    "a.101.png",
                                    "a.1001.jpg",
                                    "b.1001.png",
                                    "a.+001.png",
                                    "a_u1_v1.png",
                                    "a_u2_v1.png",
                                    "a_u10_v2.png",
                                    "a_u11_v1.png",
                                    "a_u0_v1.png",
                                    "a_u01_v1.png",
                                    "a_u1_v.png",
                                    "t1001/c/1001.1001.png",
                                    "t1002/c/1002.1002.png",
                                    "t1002/c/1002.1003.png",
                                    "t1003/c/1002.1002.png",
                                    "t1003/c/u3_v1.1003.png"};
enum { FILES = sizeof files / sizeof *files };
static const char *const folders[] = {"t1001", "t1001/c", "t1002",     "t1002/c",
                                      "t1003", "t1003/c", "d.1001.png"};
enum { FOLDERS = sizeof folders / sizeof *folders };

static int make_files(void **state)
{
    (void)state;
    for (int i = 0; i < FOLDERS; i++)
        if (mkdir(folders[i], 0700) != 0)
            return -1;
    if (mkfifo("d.1002.png", 0600) != 0)
        return -1;
    for (int i = 0; i < FILES; i++)
        close(open(files[i], O_CREAT | O_WRONLY, 0600));
    return 0;
}

/* Checks that a path has these tiles, by number and file name. */
static void check_tiles(const char *path, const struct fmt_tile_file *expected, uint64_t count)
{
    struct bsq_ctx *ctx = test_context(1, 0);
    struct fmt_tile_files found = {0};
    assert_int_equal(fmt_tile_files_find(ctx, path, &found), 0);
    assert_int_equal(found.count, count);
    for (uint64_t i = 0; i < count; i++) {
        assert_int_equal(found.list[i].number, expected[i].number);
        const char *slash = strrchr(found.list[i].path, '/');
        assert_string_equal(slash ? slash + 1 : found.list[i].path, expected[i].path);
    }
    fmt_tile_files_free(ctx, &found);
    test_context_end(ctx);
}

TEST(numbers_of_tiles_are_found)
{
    const struct fmt_tile_file udim[] = {
        {0, (char *)"a.1001.png"}, {11, (char *)"a.1012.png"}, {8989, (char *)"a.9990.png"}};
    char path[64];
    (void)state;
    check_tiles("a.<UDIM>.png", udim, 3);
    snprintf(path, sizeof path, "%s/a.<UDIM>.png", test_directory);
    check_tiles(path, udim, 3);
    check_tiles("c.<UDIM>.png", NULL, 0);
    check_tiles("none/a.<UDIM>.png", NULL, 0);
}

/* u1_v1 and u01_v1 are one tile: the first by its bytes counts. */
TEST(places_of_tiles_are_found)
{
    const struct fmt_tile_file uvtile[] = {
        {0, (char *)"a_u01_v1.png"}, {1, (char *)"a_u2_v1.png"}, {19, (char *)"a_u10_v2.png"}};
    (void)state;
    check_tiles("a_<UVTILE>.png", uvtile, 3);
}

/* Tokens in names of folders, several tokens of both kinds: all stand for one tile. */
TEST(tokens_stand_anywhere)
{
    const struct fmt_tile_file two[] = {{0, (char *)"1001.1001.png"}, {1, (char *)"1002.1002.png"}};
    const struct fmt_tile_file three[] = {{2, (char *)"u3_v1.1003.png"}};
    char path[96];
    (void)state;
    check_tiles("t<UDIM>/c/<UDIM>.<UDIM>.png", two, 2);
    check_tiles("./t<UDIM>//c/<UVTILE>.<UDIM>.png", three, 1);
    snprintf(path, sizeof path, "%s/t<UDIM>/c/<UDIM>.<UDIM>.png", test_directory);
    check_tiles(path, two, 2);
    assert_int_equal(fmt_tile_folder(path), strlen(test_directory) + 1);
    check_tiles("t<UDIM>/none/<UDIM>.png", NULL, 0);
    check_tiles(
        "t<UDIM>/c/1002.1002.png",
        (struct fmt_tile_file[]){{1, (char *)"1002.1002.png"}, {2, (char *)"1002.1002.png"}}, 2);
}

TEST(folders_and_fifos_are_no_tiles)
{
    check_tiles("d.<UDIM>.png", NULL, 0);
}

TEST(only_names_with_a_token_have_tiles)
{
    assert_true(fmt_has_tiles("x/a.<UDIM>.png"));
    assert_true(fmt_has_tiles("<UVTILE>"));
    assert_false(fmt_has_tiles("a.1001.png"));
    assert_true(fmt_has_tiles("<UDIM>/a.png"));
    assert_false(fmt_has_tiles("a.<udim>.png"));
}

RUN_TESTS(make_files, NULL)

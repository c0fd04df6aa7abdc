/* test_obj_path.c - files that OBJ and MTL files name in other spellings. */
#include <sys/stat.h>

#include "formats/mesh/mesh_text.h"
#include "tests/unit/test.h"

static int make_files(void **state)
{
    (void)state;
    static const char *const folders[] = {"sub", "textures", "Both", "both", "textures/Deep"};
    static const char *const files[] = {"textures/t.png",
                                        "textures/Deep/wood grain.png",
                                        "textures/skin.1001.png",
                                        "Both/t.png",
                                        "both/t.png",
                                        "both/u.png",
                                        "t.png",
                                        "a #1.mtl",
                                        "b #1",
                                        "#",
                                        "C.MTL"};
    for (size_t i = 0; i < sizeof folders / sizeof *folders; i++)
        assert_int_equal(mkdir(folders[i], 0777), 0);
    for (size_t i = 0; i < sizeof files / sizeof *files; i++)
        test_text(files[i], "x");
    return 0;
}

CONTEXT_TEST(test_spellings, 1, 0)
{
    /* The path of the file, or after "!" that which messages name. */
    static const char *const cases[][2] = {
        {"textures/t.png", "textures/t.png"},
        {"Textures/t.png", "textures/t.png"},
        {"TEXTURES/T.PNG", "textures/t.png"},
        {"Textures\\T.PNG", "textures/t.png"},
        {".\\Textures\\DEEP\\Wood Grain.png", "./textures/Deep/wood grain.png"},
        {"\"Textures/deep//Wood grain.PNG\"", "textures/Deep//wood grain.png"},
        {"sub/../Textures/T.png", "sub/../textures/t.png"},
        {"Both/t.png", "Both/t.png"}, /* an exact name goes first */
        {"both/t.png", "both/t.png"},
        {"BOTH/T.PNG", "Both/t.png"}, /* then the first one in the order of bytes */
        {"C:\\Users\\me\\T.PNG", "t.png"},
        {"/Nowhere/T.png", "t.png"},
        {"Textures/Skin.<UDIM>.png", "!Textures/Skin.<UDIM>.png"},
        {"Textures\\skin.<UDIM>.png", "textures/skin.<UDIM>.png"},
        {"textures\\other.<UDIM>.png", "!textures\\other.<UDIM>.png"},
        {"a #1.mtl", "a #1.mtl"},
        {"A #1.MTL", "a #1.mtl"},
        {"\"a #1.mtl\" # lib", "a #1.mtl"},
        {"#", "#"},
        {"Textures", "!Textures"},
        {"t.png/x", "!t.png/x"},
        {"d #1.mtl # lib", "!d #1.mtl"},
        {"\"d #1.mtl\" #lib", "!d #1.mtl"},
        {"", "!"},
    };
    char beside[300];
    snprintf(beside, sizeof beside, "%s", "scan.obj");
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const bool missing = cases[i][1][0] == '!';
        bool exists = missing;
        char *path;
        assert_int_equal(fmt_path_find(ctx, beside, cases[i][0], &path, &exists), 0);
        assert_string_equal(path, cases[i][1] + missing);
        assert_int_equal(exists, !missing);
        bsq_free(ctx, path);
    }
}

RUN_TESTS(make_files, NULL)

/* test_mtl.c - MTL files in the forms that programs write. */
#include <sys/stat.h>

#include "formats/mesh/obj_internal.h"
#include "tests/unit/test.h"

static int make_files(void **state)
{
    (void)state;
    if (mkdir("sub dir", 0777))
        return -1;
    test_text("sub dir/wood grain.png", "x");
    test_text("back\\slash.png", "x");
    test_text("here.png", "x");
    return 0;
}

struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_materials materials;
    int warnings;
    char warning[256]; /* the last */
};

static void note_warning(void *user, const char *line)
{
    struct fixture *f = user;
    f->warnings++;
    snprintf(f->warning, sizeof f->warning, "%s", line);
}

static void open_fixture(struct fixture *f)
{
    struct bsq_ctx_options options = {.on_warning = note_warning, .user = f, .threads = 1};
    memset(f, 0, sizeof *f);
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
}

static void close_fixture(struct fixture *f)
{
    fmt_materials_free(f->ctx, &f->materials);
    test_context_end(f->ctx);
}

static void read_text(struct fixture *f, const char *text)
{
    open_fixture(f);
    const char *path = test_text("test.mtl", text);
    assert_int_equal(fmt_mtl_read(f->ctx, path, "a.obj:1", &f->materials), 0);
}

static void assert_diffuse(const struct fmt_material *m, float r, float g, float b)
{
    assert_true(m->color.value[0] == r && m->color.value[1] == g && m->color.value[2] == b);
}

TEST(test_diffuse)
{
    struct fixture f;
    read_text(&f, "# made by hand\r\nnewmtl red paint \r\n\tKd 1 0 .5\r\n  illum 2\r\n\r\n"
                  "newmtl grey\nKd 0.25\nnewmtl none\nKa 1 1 1\nKd spectral a.rfl 1\nKd xyz 1 1 1\n"
                  "newmtl bright\nKd 2 -1 1 # comment\nnewmtl last\nKd 1e-1 0 0");
    assert_int_equal(f.materials.count, 5);
    assert_string_equal(f.materials.list[0].name, "red paint");
    assert_diffuse(&f.materials.list[0], 1, 0, 0.5f);
    assert_true(f.materials.list[0].color.has_value);
    assert_diffuse(&f.materials.list[1], 0.25f, 0.25f, 0.25f);
    assert_diffuse(&f.materials.list[2], 0.8f, 0.8f, 0.8f);
    assert_false(f.materials.list[2].color.has_value);
    assert_diffuse(&f.materials.list[3], 1, 0, 1);
    assert_diffuse(&f.materials.list[4], 0.1f, 0, 0);
    /* Colours that are no numbers of red, green and blue, and one that is clamped. */
    assert_int_equal(f.warnings, 3);
    assert_string_equal(f.materials.list[1].name, "grey");
    close_fixture(&f);
}

/* Colours of further channels are sRGB, unless one of their numbers is light above that. */
TEST(test_linear_colours)
{
    static const struct {
        const char *statement;
        float light[3];
    } cases[] = {{"Ke 0.2 0.4 2", {0.2f, 0.4f, 2}},
                 {"Ke 3", {3, 3, 3}},
                 {"Ke 0.5 0.04 1", {0.21404114f, 0.0030959753f, 1}}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct fixture f;
        char text[80];
        snprintf(text, sizeof text, "newmtl a\n%s\n", cases[i].statement);
        read_text(&f, text);
        const struct fmt_material_channel *emission =
            fmt_material_find_channel(&f.materials.list[0], "emission");
        for (int k = 0; k < 3; k++)
            assert_float_equal(emission->value[k], cases[i].light[k], 1e-7);
        close_fixture(&f);
    }
}

TEST(test_map_paths)
{
    static const struct {
        const char *statement, *expected;
    } cases[] = {
        {"map_Kd here.png", "here.png"},
        {"map_kd  sub dir/wood grain.png  ", "sub dir/wood grain.png"},
        {"map_Kd sub dir\\wood grain.png", "sub dir/wood grain.png"},
        {"map_Kd back\\slash.png", "back\\slash.png"},
        {"map_Kd C:\\Users\\me\\here.png", "here.png"},
        {"map_Kd /nowhere/at all/here.png", "here.png"},
        {"map_Kd \"sub dir/wood grain.png\"", "sub dir/wood grain.png"},
        {"map_Kd not there.png", "not there.png"},
        {"map_Kd .\\not\\there.png", ".\\not\\there.png"},
        {"map_Kd -s 1 1 1 -o 0 0 0 -mm 0 1 here.png", "here.png"},
        {"map_Kd -blendu on -blendv off -cc off -clamp off -bm 1.0 -boost 1 -mm 0.0 1 -texres 512 "
         "sub dir/wood grain.png",
         "sub dir/wood grain.png"},
        {"map_Kd -o 0 2.png", "2.png"},
        {"map_Kd \\\n -s 1 1 \\\r\n 1 here.png", "here.png"},
        {"map_Kd -t 0 0 0 -x.png", "-x.png"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct fixture f;
        char text[300];
        snprintf(text, sizeof text, "newmtl a\n%s\n", cases[i].statement);
        read_text(&f, text);
        assert_string_equal(f.materials.list[0].color.texture_path, cases[i].expected);
        assert_int_equal(f.warnings, 0);
        close_fixture(&f);
    }
}

TEST(test_warnings)
{
    static const struct {
        const char *text, *warning;
    } cases[] = {
        {"Kd 1 1 1\n", "test.mtl:1: no newmtl before this, ignored: \"Kd\""},
        {"newmtl a\nKd 1 1\n", "test.mtl:2: a colour has 1 or 3 numbers, ignored: \"1 1\""},
        {"newmtl a\nKd 1 x 1\n", "test.mtl:2: not a colour, ignored: \"1 x 1\""},
        {"newmtl a\nKd xyz 1 1 1\n",
         "test.mtl:2: a spectral curve or a CIE colour, ignored: \"xyz 1 1 1\""},
        {"newmtl a\nKd spectral a.rfl 1\n",
         "test.mtl:2: a spectral curve or a CIE colour, ignored: \"spectral a.rfl 1\""},
        {"newmtl a\nmap_Kd\n", "test.mtl:2: names no file, ignored: \"map_Kd\""},
        {"newmtl a\nmap_Kd -t 2 2 here.png\n",
         "test.mtl:2: texture is used without this option: \"-t 2 2 here.png\""},
        {"newmtl a\nmap_Kd -mm 0 2 here.png\n",
         "test.mtl:2: texture is used without this option: \"-mm 0 2 here.png\""},
        {"newmtl a\nmap_Pr -clamp on here.png\n",
         "test.mtl:2: texture is used without this option: \"-clamp on here.png\""},
        {"newmtl a\nmap_Pr -imfchan l here.png\n",
         "test.mtl:2: texture is used without this option: \"-imfchan l here.png\""},
        {"newmtl a\nmap_Ke -imfchan g here.png\n",
         "test.mtl:2: texture is used without this option: \"-imfchan g here.png\""},
        {"newmtl a\nmap_Ke -type sphere here.png\n",
         "test.mtl:2: texture is used without this option: \"-type sphere here.png\""},
        {"newmtl a\nnorm -bm 0.5 here.png\n",
         "test.mtl:2: texture is used without this option: \"-bm 0.5 here.png\""},
        {"newmtl a\nmap_Kd -s 1e39 1 1 here.png\n",
         "test.mtl:2: out of range, ignored: \"-s 1e39 1 1 here.png\""},
        {"newmtl a\nmap_Ke -o 1 -1e39 here.png\n",
         "test.mtl:2: out of range, ignored: \"-o 1 -1e39 here.png\""},
        {"newmtl a\nmap_Kd -s 1 1 1\n", "test.mtl:2: names no file, ignored: \"map_Kd\""},
        {"newmtl a\nKd 2 1 1\n", "test.mtl:2: out of range, clamped: \"2 1 1\""},
        {"newmtl a\nKe 2 3 -4\n", "test.mtl:2: out of range, clamped: \"2 3 -4\""},
        {"newmtl a\nPr 1e40\n", "test.mtl:2: out of range, clamped: \"1e40\""},
        {"newmtl a\nTr 1.5\n", "test.mtl:2: out of range, clamped: \"1.5\""},
        {"newmtl a\n# text\n\tpage 1\nillum 2\n<b>\r\nKdd 1 1 1\n",
         "test.mtl:3: lines with statements that are not of the format: 3; this is the first"},
        {"newmtl a\nKe \\\n1 1 \\\n1\nKd x\n", "test.mtl:5: not a colour, ignored: \"x\""},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct fixture f;
        read_text(&f, cases[i].text);
        assert_int_equal(f.warnings, 1);
        assert_string_equal(f.warning, cases[i].warning);
        close_fixture(&f);
    }
}

/* Statements that are not used say nothing, in any capitals. */
TEST(test_ignored_statements)
{
    struct fixture f;
    read_text(&f,
              "  # made by hand\n \nnewmtl a\nKa 1 1 1\nKs 0 0 0\nKt 1\nTf 1 1 1\nNs 96.1\n"
              "Ni 1.45\nd 1\nillum 2\nILLUM 2\nsharpness 60\nbump b.png\ndisp d.png\n"
              "decal d.png\nrefl -type sphere r.png\nnorm n.png\nmap_Bump b.png\nmap_RMA r.png\n"
              "Pr 0.5\nPcr 0.5\naniso 0\nanisor 0\n");
    assert_int_equal(f.materials.count, 1);
    assert_int_equal(f.warnings, 0);
    close_fixture(&f);
}

/* A scale beyond float leaves the texture where it is. */
TEST(test_large_numbers)
{
    struct fixture f;
    read_text(&f, "newmtl a\nmap_Kd -s 1e39 1 1 -o 0.5 0 here.png\n");
    const struct fmt_material *m = &f.materials.list[0];
    assert_true(m->color.uv.scale[0] == 1 && m->color.uv.offset[0] == 0.5f);
    close_fixture(&f);
}

TEST(test_zero_bytes)
{
    static const char text[] = "newmtl a\nKd 0 1 0\nnew\0mtl b\nnewmtl c\n";
    struct fixture f;
    open_fixture(&f);
    const char *path = test_bytes("test.mtl", text, sizeof text - 1);
    assert_int_equal(fmt_mtl_read(f.ctx, path, "a.obj:1", &f.materials), 0);
    assert_int_equal(f.materials.count, 1);
    assert_int_equal(f.warnings, 1);
    assert_string_equal(f.warning,
                        "test.mtl:3: not a text file (zero byte): not read from here on");
    close_fixture(&f);
}

TEST(test_files_append)
{
    struct fixture f;
    read_text(&f, "newmtl a\nnewmtl b\n");
    const char *path = test_bytes("more.mtl", "\xef\xbb\xbfnewmtl c\nKd 0 1 0", 20);
    assert_int_equal(fmt_mtl_read(f.ctx, path, "a.obj:1", &f.materials), 0);
    assert_int_equal(f.materials.count, 3);
    assert_string_equal(f.materials.list[2].name, "c");
    close_fixture(&f);
}

TEST(test_every_truncated_length)
{
    static const char text[] = "newmtl a b\r\nKd 1 0.5 .25\nmap_Kd -s 1 1 1 -mm 0 1 here.png\nKd";
    for (size_t size = 0; size < sizeof text; size++) {
        struct fixture f;
        open_fixture(&f);
        const char *path = test_bytes("cut.mtl", text, size);
        assert_int_equal(fmt_mtl_read(f.ctx, path, "a.obj:1", &f.materials), 0);
        close_fixture(&f);
    }
}

RUN_TESTS(make_files, NULL)

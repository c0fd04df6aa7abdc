/* test_obj_blocks.c - results do not depend on where batches begin or on the number of threads;
 * files that are truncated anywhere, and too little memory, give errors. */
#include <inttypes.h>

#include "formats/mesh/obj_internal.h"
#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/test.h"

/* ---- batches ---- */

static uint64_t random_state; /* of test_random() */

static unsigned below(unsigned limit)
{
    return (unsigned)((test_random(&random_state) >> 32) * limit >> 32);
}

/* A random file, and what reading it must give. */
struct model {
    char *text;
    size_t size;
    struct obj_scan scan;
    uint64_t *face_lines, line;
};

static void put(struct model *m, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    m->size += (size_t)vsprintf(m->text + m->size, format, arguments);
    va_end(arguments);
}

static void put_blank(struct model *m)
{
    static const char *const blanks[] = {" ", " ", " ", " ", "\t", "  ", " \\\n", "\t\\\r\n "};
    unsigned i = below(200) < 190 ? 0 : below(8);
    m->line += i >= 6;
    put(m, "%s", blanks[i]);
}

static void put_line_end(struct model *m, int style)
{
    static const char *const ends[] = {"\n", "\r\n", "\r"};
    if (below(40) == 0)
        put(m, below(2) ? " " : " # trailing \\ words");
    put(m, "%s", ends[style == 3 ? (int)below(3) : style]);
    m->line++;
}

static void put_vertex(struct model *m)
{
    uint64_t i = m->scan.totals.vertices++;
    bool colored = below(10) == 0;
    put(m, "v");
    for (int c = 0; c < 3; c++) {
        put_blank(m);
        /* Multiples of 2^-6 need six decimals, so the text is exact. */
        double value = ((int)below(200000) - 100000) / 64.0;
        m->scan.positions[i][c] = value;
        put(m, "%.6f", value);
    }
    for (int c = 0; c < 3; c++) {
        m->scan.colors[i][c] = colored ? (float)below(65) / 64 : -1;
        if (colored)
            put(m, " %.6f", (double)m->scan.colors[i][c]);
    }
}

static void put_face(struct model *m)
{
    struct obj_scan *scan = &m->scan;
    uint64_t face = scan->totals.faces++;
    uint32_t size = below(2000) ? 3 + below(3) : 3 + below(400000);
    if (m->size > 3 << 20)
        size = 3;
    bool attributes = below(3) == 0;
    scan->sizes[face] = size;
    m->face_lines[face] = m->line;
    put(m, "f");
    for (uint32_t i = 0; i < size; i++) {
        uint64_t corner = scan->totals.corners++, vertex = below((unsigned)scan->totals.vertices);
        bool relative = below(4) == 0, normal = attributes && below(2);
        put_blank(m);
        put(m, "%" PRId64,
            relative ? (int64_t)(vertex - scan->totals.vertices) : (int64_t)vertex + 1);
        scan->corners[0][corner] = vertex;
        scan->corners[1][corner] = attributes ? corner % 1000 : FMT_MESH_NONE;
        scan->corners[2][corner] = normal ? 7 : FMT_MESH_NONE;
        if (attributes)
            put(m, "/%" PRIu64, corner % 1000 + 1);
        if (normal)
            put(m, "/8");
    }
}

static void make_model(struct model *m, int line_style)
{
    const size_t most = 8 << 20;
    memset(m, 0, sizeof *m);
    m->text = malloc(most);
    m->line = 1;
    m->scan.positions = malloc(most);
    m->scan.colors = malloc(most);
    m->scan.sizes = malloc(most);
    m->face_lines = malloc(most);
    for (int kind = 0; kind < 3; kind++)
        m->scan.corners[kind] = malloc(2 * most);
    while (m->size < 4 << 20) {
        switch (m->scan.totals.vertices ? below(8) : 0) {
        case 0:
        case 1:
        case 2:
            put_vertex(m);
            break;
        case 3:
            put(m, "# comment %*d", (int)below(30), 7);
            break;
        default:
            put_face(m);
        }
        put_line_end(m, line_style);
    }
}

static void check_against_model(const struct obj_fixture *f, const struct model *m)
{
    const struct obj_scan *a = &f->scan, *b = &m->scan;
    assert_int_equal(f->status, 0);
    assert_int_equal(a->totals.vertices, b->totals.vertices);
    assert_int_equal(a->totals.faces, b->totals.faces);
    assert_int_equal(a->totals.corners, b->totals.corners);
    assert_memory_equal(a->positions, b->positions, b->totals.vertices * sizeof *b->positions);
    assert_memory_equal(a->colors, b->colors, b->totals.vertices * sizeof *b->colors);
    assert_memory_equal(a->sizes, b->sizes, b->totals.faces * sizeof *b->sizes);
    for (int kind = 0; kind < 3; kind++)
        assert_memory_equal(a->corners[kind], b->corners[kind], b->totals.corners * 8);
    for (int i = 0; i < 5; i++) {
        uint64_t face = below((unsigned)b->totals.faces);
        assert_int_equal(obj_line_of_face(f, face), m->face_lines[face]);
    }
}

TEST(test_random_files)
{
    random_state = test_seed();
    uint64_t most_batches = 0;
    for (int style = 0; style < 4; style++) {
        struct model m;
        make_model(&m, style);
        const char *path = test_bytes("random.obj", m.text, m.size);
        for (unsigned threads = 1; threads <= 4; threads++) {
            struct obj_fixture f;
            obj_read_files(&f, threads, 1, &path);
            if (f.status)
                print_message("%s\n", bsq_error(f.ctx));
            check_against_model(&f, &m);
            if (f.scan.batches > most_batches)
                most_batches = f.scan.batches;
            obj_close(&f);
        }
        free(m.text);
        free(m.face_lines);
        obj_free_scan(&m.scan);
    }
    /* A face with very many corners may leave a file with fewer batches, but not all four. */
    assert_true(most_batches > 2);
}

/* A file of many batches whose only error is in the last, and one with an error in each batch: the
 * first line wins for any number of threads. */
TEST(test_first_error_wins)
{
    const size_t lines = 300000;
    char *text = malloc(lines * 16);
    size_t size = 0;
    for (size_t i = 0; i < lines; i++)
        size += (size_t)sprintf(text + size, i % 1000 == 999 ? "v 0 0 x%zu\n" : "v 1 2 3\n", i);
    for (int repeat = 0; repeat < 5; repeat++)
        obj_expect_error(text, size, "bad.obj:1000: \"x999\" is not a number");
    free(text);
}

/* Puts the border of two batches at every position of the same lines. */
TEST(test_batch_borders)
{
    static const char tail[] =
        "v 1 2 3\r\nf 1 \\\r\n1 \\\n1\nusemtl m \\\nn\n#\\\nf 1 1 1\rg x\\\r\nv 4 5 6";
    char *text = malloc(OBJ_BLOCK_BYTES + 1024);
    size_t border = OBJ_BLOCK_BYTES;
    for (size_t shift = 0; shift <= sizeof tail + 1; shift++) {
        size_t pad = border - shift;
        memset(text, ' ', pad);
        text[0] = '#';
        text[pad - 1] = shift % 2 ? '\n' : '\r';
        memcpy(text + pad, tail, sizeof tail - 1);
        const char *path = test_bytes("border.obj", text, pad + sizeof tail - 1);
        struct obj_fixture f;
        obj_read_files(&f, 2, 1, &path);
        assert_int_equal(f.status, 0);
        assert_int_equal(f.scan.totals.vertices, 2);
        obj_assert_corners(&f, 0, 6, 0, 0, 0, 0, 0, 0);
        obj_assert_material(&f, 0, "m n");
        assert_int_equal(obj_line_of_face(&f, 0), 3);
        assert_int_equal(obj_line_of_face(&f, 1), 9);
        obj_close(&f);
    }
    free(text);
}

static const char small_file[] =
    "\xef\xbb\xbfmtllib a.mtl b.mtl\nv 0 0 0 1 0 0\nv 1.5 -2e-3 0\r\nv 1 1 0 1\nvt 0 1\nvn 0 0 1\n"
    "usemtl some name\ns 1\nf 1/1/1 2//1 \\\n -1 \nf 1 2 3 1 2 # end\nl 1 2\nv 123.456789 2 3\n";

TEST(test_every_truncated_length)
{
    for (size_t size = 0; size < sizeof small_file; size++) {
        struct obj_fixture f;
        const char *path = test_bytes("cut.obj", small_file, size);
        obj_read_files(&f, 1, 1, &path);
        assert_true(f.status == 0 || f.status == BSQ_EDATA);
        obj_close(&f);
    }
}

/* ---- samples ---- */

/* Looks at `rounds` of vertices and the faces after them, with texture coordinates or without. */
static struct fmt_mesh_hints look_at(int rounds, bool texcoords)
{
    enum { LINES = 60000 };
    struct model m = {.text = malloc(2 * LINES * 20)};
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_hints hints;
    struct bsq_ctx *ctx = test_context(1, 0);
    assert_non_null(m.text);
    for (int round = 0; round < rounds; round++) {
        for (int i = 0; i < LINES / rounds; i++)
            put(&m, texcoords && i % 2 ? "vt 0 0\n" : "v 0 0 0\n");
        for (int i = 0; i < LINES / rounds; i++)
            put(&m, "f 1 1 1\n");
    }
    const char *path = test_bytes("look.obj", m.text, m.size);
    assert_int_equal(fmt_mesh_open(ctx, &path, 1, &reader), 0);
    assert_int_equal(fmt_mesh_look(reader, &hints), 0);
    fmt_mesh_close(reader);
    test_context_end(ctx);
    free(m.text);
    return hints;
}

TEST(test_samples_tell_of_order_and_texture_coordinates)
{
    for (int texcoords = 0; texcoords < 2; texcoords++)
        for (int rounds = 1; rounds < 4; rounds++) {
            const struct fmt_mesh_hints hints = look_at(rounds, texcoords);
            assert_int_equal(hints.has_texcoords, texcoords);
            assert_int_equal(hints.faces_come_last, rounds == 1);
        }
}

RUN_TESTS(NULL, NULL)

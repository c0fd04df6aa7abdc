/* test_obj.c - the OBJ reader against what the text means, in all spellings, block cuts and
 * thread counts. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <cmocka.h>

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "formats/obj.h"
#include "formats/obj_internal.h"

/* ---- files ---- */

static char directory[64];

static int make_directory(void **state)
{
    (void)state;
    strcpy(directory, "/tmp/test_obj.XXXXXX");
    return mkdtemp(directory) ? 0 : -1;
}

static int remove_directory(void **state)
{
    (void)state;
    char command[128];
    snprintf(command, sizeof command, "rm -r %s", directory);
    return system(command);
}

/* Path of a file in the directory; the last eight stay valid. */
static const char *path_of(const char *name)
{
    static char paths[8][128];
    static unsigned next;
    char *path = paths[next++ % 8];
    snprintf(path, sizeof paths[0], "%s/%s", directory, name);
    return path;
}

static const char *write_bytes(const char *name, const void *bytes, size_t size)
{
    const char *path = path_of(name);
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    assert_int_equal(fclose(file), 0);
    return path;
}

static const char *write_text(const char *name, const char *text)
{
    return write_bytes(name, text, strlen(text));
}

/* ---- a scan as the reader delivers it ---- */

struct scan {
    struct fmt_obj_totals totals;
    double (*positions)[3];
    float (*colors)[3];
    double (*texcoords)[2];
    float (*normals)[3];
    uint32_t *sizes;
    uint64_t *corners[3];
    uint32_t *materials; /* of each face */
    uint64_t blocks;
};

static void *grown(void *memory, uint64_t count, size_t size)
{
    void *result = realloc(memory, (count + 1) * size);
    assert_non_null(result);
    return result;
}

static int keep_elements(struct scan *scan, const struct fmt_obj_block *b)
{
    uint64_t n = b->vertex_base + b->vertex_count;
    scan->positions = grown(scan->positions, n, sizeof *scan->positions);
    scan->colors = grown(scan->colors, n, sizeof *scan->colors);
    for (uint64_t i = 0; i < b->vertex_count; i++)
        for (int c = 0; c < 3; c++) {
            scan->positions[b->vertex_base + i][c] = b->positions[i][c];
            scan->colors[b->vertex_base + i][c] = b->colors ? b->colors[i][c] : -1;
        }
    n = b->texcoord_base + b->texcoord_count;
    scan->texcoords = grown(scan->texcoords, n, sizeof *scan->texcoords);
    for (uint64_t i = 0; i < b->texcoord_count; i++)
        memcpy(scan->texcoords[b->texcoord_base + i], b->texcoords[i], sizeof b->texcoords[0]);
    n = b->normal_base + b->normal_count;
    scan->normals = grown(scan->normals, n, sizeof *scan->normals);
    for (uint64_t i = 0; i < b->normal_count; i++)
        memcpy(scan->normals[b->normal_base + i], b->normals[i], sizeof b->normals[0]);
    return 0;
}

static int keep_block(void *arg, const struct fmt_obj_block *b)
{
    struct scan *scan = arg;
    const uint64_t *from[3] = {b->corner_vertices, b->corner_texcoords, b->corner_normals};
    uint64_t corner_base = scan->totals.corners, faces = b->face_base + b->face_count;
    assert_int_equal(b->sequence, scan->blocks);
    assert_int_equal(b->vertex_base, scan->totals.vertices);
    assert_int_equal(b->face_base, scan->totals.faces);
    keep_elements(scan, b);
    scan->sizes = grown(scan->sizes, faces, sizeof *scan->sizes);
    scan->materials = grown(scan->materials, faces, sizeof *scan->materials);
    uint32_t material = b->material_at_start;
    uint64_t change = 0, corners = 0;
    for (uint64_t i = 0; i < b->face_count; i++) {
        for (; change < b->material_change_count && b->material_changes[change].face == i; change++)
            material = b->material_changes[change].material;
        scan->sizes[b->face_base + i] = b->face_sizes[i];
        scan->materials[b->face_base + i] = material;
        corners += b->face_sizes[i];
    }
    assert_int_equal(corners, b->corner_count);
    for (int kind = 0; kind < 3; kind++) {
        scan->corners[kind] =
            grown(scan->corners[kind], corner_base + corners, sizeof *scan->corners[kind]);
        for (uint64_t i = 0; i < corners; i++)
            scan->corners[kind][corner_base + i] = from[kind] ? from[kind][i] : FMT_OBJ_NONE;
    }
    scan->totals.vertices += b->vertex_count;
    scan->totals.faces += b->face_count;
    scan->totals.corners += corners;
    scan->blocks++;
    return 0;
}

static void free_scan(struct scan *scan)
{
    free(scan->positions);
    free(scan->colors);
    free(scan->texcoords);
    free(scan->normals);
    free(scan->sizes);
    free(scan->materials);
    for (int kind = 0; kind < 3; kind++)
        free(scan->corners[kind]);
}

/* A context, a reader over files and the scan that came out of it. */
struct fixture {
    struct bsq_ctx *ctx;
    struct fmt_obj_reader *reader;
    struct scan scan;
    int status;
};

static void read_files(struct fixture *f, unsigned threads, uint32_t count,
                       const char *const *paths)
{
    struct bsq_ctx_options options = {.threads = threads, .memory_bytes = 64 << 20};
    struct fmt_obj_totals totals = {0};
    memset(f, 0, sizeof *f);
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
    f->status = fmt_obj_open(f->ctx, paths, count, &f->reader);
    if (!f->status)
        f->status = fmt_obj_read(f->reader, keep_block, &f->scan, &totals);
    if (!f->status)
        assert_int_equal(totals.corners, f->scan.totals.corners);
    f->scan.totals = totals;
}

static void close_fixture(struct fixture *f)
{
    free_scan(&f->scan);
    fmt_obj_close(f->reader);
    assert_int_equal(bsq_memory_used(f->ctx), 0);
    bsq_ctx_destroy(f->ctx);
}

static void read_text(struct fixture *f, const char *text)
{
    const char *path = write_text("scan.obj", text);
    read_files(f, 2, 1, &path);
    if (f->status)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(f->status, 0);
}

static void assert_corners(const struct fixture *f, int kind, uint64_t count, ...)
{
    va_list expected;
    va_start(expected, count);
    assert_int_equal(f->scan.totals.corners, count);
    for (uint64_t i = 0; i < count; i++) {
        int value = va_arg(expected, int);
        assert_int_equal(f->scan.corners[kind][i], value < 0 ? FMT_OBJ_NONE : (uint64_t)value);
    }
    va_end(expected);
}

/* Reads `text`, which must fail with `message` behind the directory. */
static void expect_error(const char *text, size_t size, const char *message)
{
    struct fixture f;
    const char *path = write_bytes("bad.obj", text, size);
    for (unsigned threads = 1; threads <= 3; threads += 2) {
        read_files(&f, threads, 1, &path);
        assert_int_equal(f.status, BSQ_EDATA);
        const char *error = bsq_error(f.ctx);
        assert_int_equal(strncmp(error, directory, strlen(directory)), 0);
        assert_string_equal(error + strlen(directory) + 1, message);
        close_fixture(&f);
    }
}

static void expect_text_error(const char *text, const char *message)
{
    expect_error(text, strlen(text), message);
}

/* ---- spellings ---- */

static void test_vertices(void **state)
{
    (void)state;
    struct fixture f;
    read_text(&f, "v 1 2 3\nv 4 5 6 0.5\n  v\t-1.5  +.5 1e2 0.25 0.5 0.75  \r\n"
                  "v 7 8 9 0 1 0 0.5 # green\nv \\\n 1 \\\r\n 2 3\nv 1 2 3");
    assert_int_equal(f.scan.totals.vertices, 6);
    const double positions[6][3] = {{1, 2, 3}, {4, 5, 6}, {-1.5, 0.5, 100},
                                    {7, 8, 9}, {1, 2, 3}, {1, 2, 3}};
    const float colors[6][3] = {{-1, -1, -1}, {-1, -1, -1}, {0.25f, 0.5f, 0.75f},
                                {0, 1, 0},    {-1, -1, -1}, {-1, -1, -1}};
    assert_memory_equal(f.scan.positions, positions, sizeof positions);
    assert_memory_equal(f.scan.colors, colors, sizeof colors);
    close_fixture(&f);
}

static void test_texcoords_and_normals(void **state)
{
    (void)state;
    struct fixture f;
    read_text(&f, "vt 0.25\nvt 0.5 0.75\nvt 1 -2 3\nvn 0 0 2\nvp 1 2\nvt\t3\t4\t# x\n");
    const double texcoords[4][2] = {{0.25, 0}, {0.5, 0.75}, {1, -2}, {3, 4}};
    const float normals[1][3] = {{0, 0, 2}};
    assert_int_equal(f.scan.totals.texcoords, 4);
    assert_memory_equal(f.scan.texcoords, texcoords, sizeof texcoords);
    assert_int_equal(f.scan.totals.normals, 1);
    assert_memory_equal(f.scan.normals, normals, sizeof normals);
    assert_int_equal(f.scan.totals.skipped_lines, 0);
    close_fixture(&f);
}

static void test_face_forms(void **state)
{
    (void)state;
    struct fixture f;
    read_text(&f, "f 1 2 3\nf 4/5 6/7 8/9\nf 1//2 3//4 5//6 7//8\nf 1/2/3 4/5/6 7/8/9\n"
                  "f 10 20/30 40//50 \\\n 60/70/80\n");
    assert_int_equal(f.scan.totals.faces, 5);
    const uint32_t sizes[5] = {3, 3, 4, 3, 4};
    assert_memory_equal(f.scan.sizes, sizes, sizeof sizes);
    assert_corners(&f, 0, 17, 0, 1, 2, 3, 5, 7, 0, 2, 4, 6, 0, 3, 6, 9, 19, 39, 59);
    assert_corners(&f, 1, 17, -1, -1, -1, 4, 6, 8, -1, -1, -1, -1, 1, 4, 7, -1, 29, -1, 69);
    assert_corners(&f, 2, 17, -1, -1, -1, -1, -1, -1, 1, 3, 5, 7, 2, 5, 8, -1, -1, 49, 79);
    close_fixture(&f);
}

static void test_relative_indices(void **state)
{
    (void)state;
    struct fixture f;
    read_text(&f, "v 0 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 1\nvt 0 0\nf -3/-1/-1 -2/-1/-1 -1/1/1\n"
                  "v 2 2 2\nf -1 -2 1\n");
    assert_corners(&f, 0, 6, 0, 1, 2, 3, 2, 0);
    assert_corners(&f, 1, 6, 0, 0, 0, -1, -1, -1);
    close_fixture(&f);
}

static void test_short_faces_and_unknown(void **state)
{
    (void)state;
    struct fixture f;
    read_text(&f, "\xef\xbb\xbf# comment \\\nv 0 0 0\ng group\no object\ns off\nl 1 2\np 1\n"
                  "fancy statement\nf 1 1\nf\nf 1 2 3\nfo 1 2 3\ncurv2 1 2\nvc 1 2 3\n\n \t\n");
    assert_int_equal(f.scan.totals.vertices, 1);
    assert_int_equal(f.scan.totals.faces, 2);
    assert_int_equal(f.scan.totals.short_faces, 2);
    assert_int_equal(f.scan.totals.skipped_lines, 2);
    close_fixture(&f);
}

static void test_line_ends(void **state)
{
    (void)state;
    static const char *const texts[] = {
        "v 1 2 3\nusemtl a b\nf 1 2 3\n# c\ng x\nf 4 5 6\n",
        "v 1 2 3\r\nusemtl a b \r\nf 1 2 3\r\n# c\r\ng x\r\nf 4 5 6\r\n",
        "v 1 2 3\rusemtl a b\rf 1 2 3\r# c\rg x\rf 4 5 6\r",
        "v 1 2 3\rusemtl a b\rf 1 2 3\r# c\rg x\rf 4 5 6",
        "v 1 2 3\r\nusemtl a b\nf 1 2 3 \r# c\ng x\rf 4 5 6 \\\r\n"};
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        struct fixture f;
        const char *path;
        uint64_t line;
        read_text(&f, texts[i]);
        assert_corners(&f, 0, 6, 0, 1, 2, 3, 4, 5);
        assert_int_equal(fmt_obj_material_count(f.reader), 1);
        assert_string_equal(fmt_obj_material_name(f.reader, 0), "a b");
        assert_int_equal(fmt_obj_locate_face(f.reader, 1, &path, &line), 0);
        assert_int_equal(line, 6);
        close_fixture(&f);
    }
}

static void test_empty_files(void **state)
{
    (void)state;
    struct fixture f;
    const char *paths[3] = {write_text("empty.obj", ""), write_text("some.obj", "f 1 2 3\n"),
                            write_text("blank.obj", "\n\n")};
    read_files(&f, 2, 3, paths);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.totals.faces, 1);
    close_fixture(&f);
    read_files(&f, 2, 1, paths);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.totals.faces, 0);
    close_fixture(&f);
}

static void test_several_files(void **state)
{
    (void)state;
    struct fixture f;
    write_text("b.mtl", "newmtl m\nKd 0 0 1\n");
    write_text("a file.mtl", "newmtl m\nKd 1 0 0\n");
    const char *paths[2] = {
        write_text("a.obj", "mtllib a file.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl m\nf 1 2 3\n"),
        write_text("b.obj", "mtllib b.mtl missing.mtl\nf 1 2 -1\nv 0 0 0\nusemtl m\nf 1 -1 2\n")};
    read_files(&f, 2, 2, paths);
    assert_int_equal(f.status, BSQ_EDATA); /* -1 before any vertex of this file */
    close_fixture(&f);
    write_text("b.obj", "mtllib b.mtl missing.mtl\nv 0 0 0\nf 1 2 -1\nusemtl m\nv 1 1 1\n"
                        "f 1 -1 2\nusemtl\nf 1 1 1");
    read_files(&f, 2, 2, paths);
    assert_int_equal(f.status, 0);
    assert_corners(&f, 0, 12, 0, 1, 2, 3, 4, 3, 3, 4, 4, 3, 3, 3);
    assert_int_equal(f.scan.materials[0], 0);
    assert_int_equal(f.scan.materials[1], FMT_OBJ_NO_MATERIAL);
    assert_int_equal(f.scan.materials[2], 1);
    assert_int_equal(f.scan.materials[3], FMT_OBJ_NO_MATERIAL);
    assert_int_equal(fmt_obj_library_count(f.reader), 3);
    assert_string_equal(fmt_obj_library_path(f.reader, 0), path_of("a file.mtl"));
    assert_string_equal(fmt_obj_library_path(f.reader, 2), path_of("missing.mtl"));
    struct fmt_materials materials;
    assert_int_equal(fmt_obj_read_materials(f.reader, &materials), 0);
    assert_int_equal(materials.count, 2);
    assert_true(materials.list[0].diffuse[0] == 1 && materials.list[0].diffuse[2] == 0);
    assert_true(materials.list[1].diffuse[0] == 0 && materials.list[1].diffuse[2] == 1);
    fmt_mtl_free(f.ctx, &materials);
    /* A second reading gives the same numbers. */
    struct fmt_obj_totals again;
    assert_int_equal(fmt_obj_read(f.reader, NULL, NULL, &again), 0);
    assert_memory_equal(&again, &f.scan.totals, sizeof again);
    assert_int_equal(fmt_obj_material_count(f.reader), 2);
    close_fixture(&f);
}

/* ---- errors ---- */

static void test_errors(void **state)
{
    (void)state;
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"v 0 0 0\nv 1 nan 0\n", "bad.obj:2: \"nan\" is not a finite number"},
        {"v 0 0 0\nv 1 -inf 0\n", "bad.obj:2: \"-inf\" is not a finite number"},
        {"v 0 0 1e999\n", "bad.obj:1: \"1e999\" is not a finite number"},
        {"v 0 0 1.#QNAN0\n", "bad.obj:1: \"1.#QNAN0\" is not a finite number"},
        {"# 1\n#2 \\\n\nv 1,0 2,0 3,0\n", "bad.obj:4: \"1,0\" is not a finite number"},
        {"v 1 2\n", "bad.obj:1: a vertex of 2 numbers, expected 3, 4, 6 or 7"},
        {"v 1 2 3 4 5\n", "bad.obj:1: a vertex of 5 numbers, expected 3, 4, 6 or 7"},
        {"v 1 2 3 4 5 6 7 8\n",
         "bad.obj:1: a vertex of more than 7 numbers, expected 3, 4, 6 or 7"},
        {"vn 1 2\n", "bad.obj:1: a normal of 2 numbers, expected 3"},
        {"vn 1 2 3 4\n", "bad.obj:1: unexpected \"4\" at the end of the line"},
        {"vt\n", "bad.obj:1: a texture coordinate without numbers"},
        {"v 0 0 0\nf 1 0 1\n", "bad.obj:2: face refers to vertex 0, indices begin with 1"},
        {"f 1/0 1 1\n", "bad.obj:1: face refers to texture coordinate 0, indices begin with 1"},
        {"f 1//0 1 1\n", "bad.obj:1: face refers to normal 0, indices begin with 1"},
        {"f 1 2 x\n", "bad.obj:1: \"x\" is not a face corner"},
        {"f 1 2 3/4/5/6\n", "bad.obj:1: \"3/4/5/6\" is not a face corner"},
        {"f 1 2 1234567890123456789\n", "bad.obj:1: \"1234567890123456789\" is not a face corner"},
        {"f 1 2.5 3\n", "bad.obj:1: \"2.5\" is not a face corner"},
        {"v 0 0 0\nv 0 0 0\nv 0 0 0\n# c\n\nf 1 2 3\nf 1 2 -5\n",
         "bad.obj:7: face refers to vertex -5, file has 3 so far"},
        {"v 0 0 0\nf 1 -1 -2\nv 0 0 nan\n",
         "bad.obj:2: face refers to vertex -2, file has 1 so far"},
        {"f 1//-1 2 3\n", "bad.obj:1: face refers to normal -1, file has 0 so far"},
        {"v 0 0 \x01zzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzz\n",
         "bad.obj:1: \"?zzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzz...\" is not a finite number"},
        {"ply\nformat ascii 1.0\n",
         "bad.obj:1: not an OBJ file: \"ply\" is no statement of that format"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        expect_text_error(cases[i].text, cases[i].message);
    static const char zero[] = "v 0 0 0\ng a\0b\nv 1 2 3\n";
    expect_error(zero, sizeof zero - 1, "bad.obj:2: not a text file (zero byte)");
    static const char png[] = "\x89PNG\r\n\x1a\n\0\0\0\rIHDR";
    expect_error(png, sizeof png - 1, "bad.obj:3: not a text file (zero byte)");
    static const char utf16[] = "v\0 \0\x31\0";
    expect_error(utf16, sizeof utf16 - 1, "bad.obj:1: not a text file (zero byte)");
}

static void test_missing_file(void **state)
{
    (void)state;
    struct fixture f;
    const char *path = path_of("nothing.obj");
    read_files(&f, 1, 1, &path);
    assert_int_equal(f.status, BSQ_ENOINPUT);
    assert_non_null(strstr(bsq_error(f.ctx), "nothing.obj"));
    close_fixture(&f);
}

static void test_fail_index(void **state)
{
    (void)state;
    struct fixture f;
    char expected[160];
    const char *paths[2] = {write_text("one.obj", "v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n"),
                            write_text("two.obj", "v 0 0 0\nvt 0 0\nf 1 1 1\n\nf 1/1 1/9 1/1\n")};
    read_files(&f, 2, 2, paths);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.corners[1][7], 8);
    assert_int_equal(fmt_obj_fail_index(f.reader, 2, "texture coordinate", 8), BSQ_EDATA);
    snprintf(expected, sizeof expected,
             "%s/two.obj:5: face refers to texture coordinate 9, file has 1", directory);
    assert_string_equal(bsq_error(f.ctx), expected);
    bsq_clear_error(f.ctx);
    assert_int_equal(fmt_obj_fail_index(f.reader, 2, "vertex", 3 + 98), BSQ_EDATA);
    snprintf(expected, sizeof expected, "%s/two.obj:5: face refers to vertex 99, file has 1",
             directory);
    assert_string_equal(bsq_error(f.ctx), expected);
    close_fixture(&f);
}

/* ---- blocks ---- */

static uint64_t random_state = 4711;

static unsigned below(unsigned limit)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (unsigned)((random_state * 0x2545f4914f6cdd1du >> 32) * limit >> 32);
}

/* What a random file was written from. */
struct model {
    char *text;
    size_t size;
    struct scan scan;
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
    struct scan *scan = &m->scan;
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
        scan->corners[1][corner] = attributes ? corner % 1000 : FMT_OBJ_NONE;
        scan->corners[2][corner] = normal ? 7 : FMT_OBJ_NONE;
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

static void check_against_model(const struct fixture *f, const struct model *m)
{
    const struct scan *a = &f->scan, *b = &m->scan;
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
        const char *path;
        uint64_t line, face = below((unsigned)b->totals.faces);
        assert_int_equal(fmt_obj_locate_face(f->reader, face, &path, &line), 0);
        assert_int_equal(line, m->face_lines[face]);
    }
}

static void test_random_files(void **state)
{
    (void)state;
    print_message("seed %" PRIu64 "\n", random_state);
    for (int style = 0; style < 4; style++) {
        struct model m;
        make_model(&m, style);
        const char *path = write_bytes("random.obj", m.text, m.size);
        for (unsigned threads = 1; threads <= 4; threads++) {
            struct fixture f;
            read_files(&f, threads, 1, &path);
            if (f.status)
                print_message("%s\n", bsq_error(f.ctx));
            check_against_model(&f, &m);
            assert_true(f.scan.blocks > 2);
            close_fixture(&f);
        }
        free(m.text);
        free(m.face_lines);
        free_scan(&m.scan);
    }
}

/* A file of many blocks whose only error is in the last, and one with an error in each block: the
 * first line wins for any number of threads. */
static void test_first_error_wins(void **state)
{
    (void)state;
    const size_t lines = 300000;
    char *text = malloc(lines * 16);
    size_t size = 0;
    for (size_t i = 0; i < lines; i++)
        size += (size_t)sprintf(text + size, i % 1000 == 999 ? "v 0 0 x%zu\n" : "v 1 2 3\n", i);
    for (int repeat = 0; repeat < 5; repeat++)
        expect_error(text, size, "bad.obj:1000: \"x999\" is not a finite number");
    free(text);
}

/* Every way to cut the same lines at the border of two blocks. */
static void test_block_borders(void **state)
{
    (void)state;
    static const char tail[] = "v 1 2 3\r\nf 1 \\\r\n1 \\\n1\nusemtl m\\\nn\n#\\\nf 1 1 1\rv 4 5 6";
    char *text = malloc(OBJ_BLOCK_BYTES + 1024);
    size_t border = OBJ_BLOCK_BYTES;
    for (size_t shift = 0; shift <= sizeof tail + 1; shift++) {
        size_t pad = border - shift;
        memset(text, ' ', pad);
        text[0] = '#';
        text[pad - 1] = shift % 2 ? '\n' : '\r';
        memcpy(text + pad, tail, sizeof tail - 1);
        const char *path = write_bytes("border.obj", text, pad + sizeof tail - 1);
        struct fixture f;
        const char *found;
        uint64_t line;
        read_files(&f, 2, 1, &path);
        assert_int_equal(f.status, 0);
        assert_int_equal(f.scan.totals.vertices, 2);
        assert_corners(&f, 0, 6, 0, 0, 0, 0, 0, 0);
        assert_string_equal(fmt_obj_material_name(f.reader, 0), "m n");
        assert_int_equal(fmt_obj_locate_face(f.reader, 0, &found, &line), 0);
        assert_int_equal(line, 3);
        assert_int_equal(fmt_obj_locate_face(f.reader, 1, &found, &line), 0);
        assert_int_equal(line, 9);
        close_fixture(&f);
    }
    free(text);
}

static const char small_file[] =
    "\xef\xbb\xbfmtllib a.mtl b.mtl\nv 0 0 0 1 0 0\nv 1.5 -2e-3 0\r\nv 1 1 0 1\nvt 0 1\nvn 0 0 1\n"
    "usemtl some name\ns 1\nf 1/1/1 2//1 \\\n -1 \nf 1 2 3 1 2 # end\nl 1 2\nv 123.456789 2 3\n";

static void test_every_truncated_length(void **state)
{
    (void)state;
    for (size_t size = 0; size < sizeof small_file; size++) {
        struct fixture f;
        const char *path = write_bytes("cut.obj", small_file, size);
        read_files(&f, 1, 1, &path);
        assert_true(f.status == 0 || f.status == BSQ_EDATA);
        close_fixture(&f);
    }
}

static void test_every_budget(void **state)
{
    (void)state;
    const char *path = write_bytes("small.obj", small_file, sizeof small_file - 1);
    bool enough = false;
    for (uint64_t budget = 1; !enough; budget += budget / 16 + 64) {
        struct bsq_ctx_options options = {.threads = 1, .memory_bytes = budget};
        struct bsq_ctx *ctx;
        struct fmt_mesh mesh;
        assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
        int status = fmt_mesh_load(ctx, path, &mesh);
        if (status)
            assert_int_equal(status, BSQ_ENOMEM);
        else
            fmt_mesh_free(ctx, &mesh);
        assert_int_equal(bsq_memory_used(ctx), 0);
        assert_true(bsq_memory_high(ctx) <= budget);
        bsq_ctx_destroy(ctx);
        enough = status == 0;
    }
}

/* ---- whole meshes ---- */

static void load_mesh(struct fixture *f, struct fmt_mesh *mesh, const char *text)
{
    const char *path = write_text("mesh.obj", text);
    memset(f, 0, sizeof *f);
    assert_int_equal(bsq_ctx_create(NULL, &f->ctx), 0);
    f->status = fmt_mesh_load(f->ctx, path, mesh);
}

static void test_mesh(void **state)
{
    (void)state;
    struct fixture f;
    struct fmt_mesh mesh;
    /* Faces come first; the quad has its reflex corner at 2, so it must be cut from there. */
    load_mesh(&f, &mesh,
              "f 1/1/1 2/2/1 3/3/2 4/4/1\nf 1 2 3\nv 0 0 0\nv 1 1 0\nv 4 0 0\nv 1 4 0\n"
              "vt 0 0\nvt .1 .1\nvt .2 .2\nvt .3 .3\nvn 0 0 3\nvn 0 0 0\n");
    assert_int_equal(f.status, 0);
    assert_int_equal(mesh.vertex_count, 4);
    assert_int_equal(mesh.triangle_count, 3);
    assert_int_equal(mesh.face_count, 2);
    const uint32_t triangles[3][3] = {{1, 2, 3}, {1, 3, 0}, {0, 1, 2}};
    assert_memory_equal(mesh.vertices, triangles, sizeof triangles);
    const uint32_t texcoords[3][3] = {{1, 2, 3}, {1, 3, 0}, {UINT32_MAX, UINT32_MAX, UINT32_MAX}};
    assert_memory_equal(mesh.corner_texcoords, texcoords, sizeof texcoords);
    const uint32_t normals[3][3] = {{0, 1, 0}, {0, 0, 0}, {UINT32_MAX, UINT32_MAX, UINT32_MAX}};
    assert_memory_equal(mesh.corner_normals, normals, sizeof normals);
    const uint64_t faces[3] = {0, 0, 1};
    assert_memory_equal(mesh.faces, faces, sizeof faces);
    assert_true(mesh.normals[0][2] == 1 && mesh.normals[1][2] == 0);
    fmt_mesh_free(f.ctx, &mesh);
    close_fixture(&f);
}

static void test_mesh_errors(void **state)
{
    (void)state;
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"v 0 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 3\nf 1 2 4\n",
         "mesh.obj:5: face refers to vertex 4, file has 3"},
        {"v 0 0 0\nf 1 1 1\nf 1 1 99999999999\n",
         "mesh.obj:3: face refers to vertex 99999999999, file has 1"},
        {"v 0 0 0\nf 1/1 1/1 1/1\n", "mesh.obj:2: face refers to texture coordinate 1, file has 0"},
        {"v 0 0 0\nvn 0 0 1\nf 1//1 1//4294967296 1//1\n",
         "mesh.obj:3: face refers to normal 4294967296, file has 1"},
        {"v 0 0 0\nl 1 1\n", "mesh.obj: no faces"},
        {"", "mesh.obj: no faces"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct fixture f;
        struct fmt_mesh mesh;
        load_mesh(&f, &mesh, cases[i].text);
        assert_int_equal(f.status, BSQ_EDATA);
        assert_string_equal(bsq_error(f.ctx) + strlen(directory) + 1, cases[i].message);
        close_fixture(&f);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_vertices),
        cmocka_unit_test(test_texcoords_and_normals),
        cmocka_unit_test(test_face_forms),
        cmocka_unit_test(test_relative_indices),
        cmocka_unit_test(test_short_faces_and_unknown),
        cmocka_unit_test(test_line_ends),
        cmocka_unit_test(test_empty_files),
        cmocka_unit_test(test_several_files),
        cmocka_unit_test(test_errors),
        cmocka_unit_test(test_missing_file),
        cmocka_unit_test(test_fail_index),
        cmocka_unit_test(test_random_files),
        cmocka_unit_test(test_first_error_wins),
        cmocka_unit_test(test_block_borders),
        cmocka_unit_test(test_every_truncated_length),
        cmocka_unit_test(test_every_budget),
        cmocka_unit_test(test_mesh),
        cmocka_unit_test(test_mesh_errors),
    };
    return cmocka_run_group_tests(tests, make_directory, remove_directory);
}

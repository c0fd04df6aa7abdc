

#include "formats/mesh/mesh_format.h"
#include "tests/unit/fixture.h"
#include "tests/unit/formats/mesh/obj_fixture.h"

static void *grown(void *memory, uint64_t count, size_t size)
{
    void *result = realloc(memory, (count + 1) * size);
    assert_non_null(result);
    return result;
}

static int keep_elements(struct obj_scan *scan, const struct fmt_mesh_batch *b)
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

static int keep_batch(void *arg, const struct fmt_mesh_batch *b)
{
    struct obj_scan *scan = arg;
    const uint64_t *from[3] = {b->corner_vertices, b->corner_texcoords, b->corner_normals};
    uint64_t corner_base = scan->totals.corners, faces = b->face_base + b->face_count;
    assert_int_equal(b->sequence, scan->batches);
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
            scan->corners[kind][corner_base + i] = from[kind] ? from[kind][i] : FMT_MESH_NONE;
    }
    scan->totals.vertices += b->vertex_count;
    scan->totals.faces += b->face_count;
    scan->totals.corners += corners;
    scan->batches++;
    return 0;
}

void obj_free_scan(struct obj_scan *scan)
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

void obj_read_files(struct obj_fixture *f, unsigned threads, uint32_t count,
                    const char *const *paths)
{
    struct fmt_mesh_totals totals = {0};
    memset(f, 0, sizeof *f);
    f->ctx = test_context(threads, 64 << 20);
    f->status = fmt_mesh_open(f->ctx, paths, count, &f->reader);
    if (!f->status)
        f->status = fmt_mesh_read(f->reader, keep_batch, &f->scan, &totals);
    if (!f->status)
        assert_int_equal(totals.corners, f->scan.totals.corners);
    f->scan.totals = totals;
}

void obj_close(struct obj_fixture *f)
{
    obj_free_scan(&f->scan);
    fmt_mesh_close(f->reader);
    test_context_end(f->ctx);
}

void obj_read_text(struct obj_fixture *f, const char *text)
{
    const char *path = test_text("scan.obj", text);
    obj_read_files(f, 2, 1, &path);
    if (f->status)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(f->status, 0);
}

uint64_t obj_line_of_face(const struct obj_fixture *f, uint64_t face)
{
    struct fmt_mesh_location location;
    assert_int_equal(fmt_stream_locate_face(f->reader, face, &location), 0);
    return location.line;
}

void obj_assert_material(const struct obj_fixture *f, uint32_t material, const char *name)
{
    struct fmt_materials materials;
    assert_int_equal(fmt_mesh_read_materials(f->reader, &materials), 0);
    assert_in_range(material, 0, materials.count - 1);
    assert_string_equal(materials.list[material].name, name);
    fmt_materials_free(f->ctx, &materials);
}

void obj_assert_corners(const struct obj_fixture *f, int kind, uint64_t count, ...)
{
    va_list expected;
    va_start(expected, count);
    assert_int_equal(f->scan.totals.corners, count);
    for (uint64_t i = 0; i < count; i++) {
        int value = va_arg(expected, int);
        assert_int_equal(f->scan.corners[kind][i], value < 0 ? FMT_MESH_NONE : (uint64_t)value);
    }
    va_end(expected);
}

/* Checks that reading a file of this name and content fails with the message. */
static void expect_error(const char *name, const char *text, size_t size, const char *message)
{
    struct obj_fixture f;
    const char *path = test_bytes(name, text, size);
    for (unsigned threads = 1; threads <= 3; threads += 2) {
        obj_read_files(&f, threads, 1, &path);
        assert_int_equal(f.status, BSQ_EDATA);
        assert_string_equal(bsq_error(f.ctx), message);
        obj_close(&f);
    }
}

void obj_expect_error(const char *text, size_t size, const char *message)
{
    expect_error("bad.obj", text, size, message);
}

void ply_expect_error(const char *text, size_t size, const char *message)
{
    expect_error("bad.ply", text, size, message);
}

void obj_expect_text_error(const char *text, const char *message)
{
    obj_expect_error(text, strlen(text), message);
}

static void note_warning(void *user, const char *line)
{
    strcat(user, line);
    strcat(user, "\n");
}

void mesh_expect_warnings(const char *path, unsigned threads, const char *expected)
{
    char warnings[2000] = "";
    struct bsq_ctx_options options = {
        .threads = threads, .memory_bytes = 64 << 20, .on_warning = note_warning, .user = warnings};
    struct fmt_mesh_reader *reader;
    struct bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    assert_int_equal(fmt_mesh_open(ctx, &path, 1, &reader), 0);
    for (int i = 0; i < 2; i++)
        assert_int_equal(fmt_mesh_read(reader, NULL, NULL, NULL), 0);
    fmt_mesh_close(reader);
    assert_string_equal(warnings, expected);
    test_context_end(ctx);
}

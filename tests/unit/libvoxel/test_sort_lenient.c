/* test_sort_lenient.c - scans with faces that refer to nothing. The result is that of a scan
 * without these faces and corners, the same bytes for any threads, budget and number of passes. */
#include "sort_grid.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct sort_fixture, sort_set_up, sort_tear_down)

/* Rows and columns of vertices: some blocks of text. */
enum { SIDE = 200 };

struct losses {
    uint64_t faces, corners, lines;
    uint64_t first_face, first_texcoord, first_normal; /* lines */
};

static void note_first(uint64_t *first, const struct losses *losses)
{
    if (!*first)
        *first = losses->lines + 1;
}

/* Returns true for about one of `of` calls. */
static bool rarely(uint64_t *seed, uint32_t of)
{
    return sort_random(seed) % of == 0;
}

static void write_vertices(FILE *file, bool damaged, uint64_t *seed, struct losses *losses)
{
    for (uint32_t i = 0; i < SIDE * SIDE; i++) {
        const bool missing = i == 7777 || i == 30000;
        const double z = sort_random(seed) % 1000 / 1000.0;
        if (missing && damaged)
            fprintf(file, "v %u nan %g\n", i % SIDE, z);
        else
            fprintf(file, "v %u %u %g\n", i % SIDE, i / SIDE, z);
    }
    fprintf(file, "vt 0 0\nvt 0.5 0.25\nvt %s 0\nvn 0 0 1\nvn %s\n", damaged ? "inf" : "0",
            damaged ? "1.#QNAN 0 0" : "0 0 0");
    losses->lines = SIDE * SIDE + 5;
}

/* Writes "/t/n" of a corner. In a damaged file, what does not exist has an index; otherwise none.
 */
static void write_attributes(FILE *file, bool damaged, uint64_t *seed, struct losses *losses)
{
    static const char *const beyond[] = {"4", "-99", "0", "123456789012345678"};
    const char *wrong = beyond[sort_random(seed) % 4];
    const uint32_t texcoord = sort_random(seed) % 3 + 1;
    const bool no_texcoord = rarely(seed, 500), no_normal = rarely(seed, 400);
    if (no_texcoord)
        fprintf(file, "/%s", damaged ? wrong : "");
    else if (texcoord == 3 && !damaged) /* it is not finite */
        fprintf(file, "/");
    else
        fprintf(file, "/%u", texcoord);
    if (no_normal)
        fprintf(file, damaged ? "/%s" : "", wrong);
    else
        fprintf(file, "/%u", sort_random(seed) % 2 + 1);
    if (no_texcoord)
        note_first(&losses->first_texcoord, losses);
    if (no_normal)
        note_first(&losses->first_normal, losses);
    losses->corners += no_texcoord + no_normal;
}

static bool lacks_position(const uint32_t corners[4])
{
    for (int k = 0; k < 4; k++)
        if (corners[k] == 7777 || corners[k] == 30000)
            return true;
    return false;
}

static void write_faces(FILE *file, bool damaged, uint64_t *seed, struct losses *losses)
{
    for (uint32_t i = 0; i < (SIDE - 1) * (SIDE - 1); i++) {
        const uint32_t a = i / (SIDE - 1) * SIDE + i % (SIDE - 1);
        const uint32_t corners[4] = {a, a + 1, a + SIDE + 1, a + SIDE};
        const bool lost = lacks_position(corners);
        FILE *to = lost && !damaged ? fopen("/dev/null", "w") : file;
        struct losses unused = *losses;
        if (i % 1000 == 0) {
            fprintf(file, "usemtl m%u\n", sort_random(seed) % 3);
            losses->lines++;
        }
        if (lost) {
            note_first(&losses->first_face, losses);
            losses->faces++;
        }
        fprintf(to, "f");
        for (int k = 0; k < (i % 3 ? 4 : 3); k++) {
            fprintf(to, " %u", corners[k] + 1);
            write_attributes(to, damaged, seed, lost ? &unused : losses);
        }
        fprintf(to, "\n");
        losses->lines++;
        if (to != file)
            fclose(to);
    }
}

static struct losses write_scan(const char *path, bool damaged)
{
    uint64_t seed = 5;
    struct losses losses = {0};
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    write_vertices(file, damaged, &seed, &losses);
    write_faces(file, damaged, &seed, &losses);
    assert_int_equal(fclose(file), 0);
    return losses;
}

/* Way 0 keeps everything in memory. Textures make sorting keep texture coordinates. */
static void sort_it(struct sort_fixture *f, unsigned way)
{
    struct sort_limits limits;
    const char *texture = sort_write_image();
    struct vox_sort_options options = sort_scan_obj();
    options.texture_path = texture;
    vox_sort_limits_for(128 * MIB, 2, &limits);
    limits.two_passes = way % 2;
    sort_open_context(f, way == 3 ? 100 * MIB : 128 * MIB, way % 3 + 1);
    bsq_forget_files(f->ctx);
    f->warnings = 0;
    expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
}

FIXTURE_TEST(what_refers_to_nothing_is_left_out)
{
    struct sorted_triangles expected = {0}, got = {0};
    struct fmt_tris_header header;
    size_t size, expected_size = 0;
    uint8_t *expected_bytes = NULL;
    write_scan("scan.obj", false);
    sort_it(f, 0);
    char bare_faces[sizeof f->warning]; /* they have no texture coordinates, in both scans */
    memcpy(bare_faces, f->warning, sizeof bare_faces);
    assert_int_equal(f->warnings, 1);
    assert_non_null(strstr(bare_faces, ": faces without texture coordinates: "));
    read_sorted(f, &expected, &header);
    const struct losses losses = write_scan("scan.obj", true);
    assert_true(losses.faces > 4 && losses.corners > 100);
    for (unsigned way = 0; way < 4; way++) {
        char message[160];
        sort_it(f, way);
        snprintf(message, sizeof message,
                 "%s:%llu: corners that refer to a normal that the file does not have: ",
                 "scan.obj", (unsigned long long)losses.first_normal);
        assert_int_equal(f->warnings, 7);
        assert_int_equal(strncmp(f->warning_before, message, strlen(message)), 0);
        assert_string_equal(f->warning, bare_faces);
        assert_int_equal(f->report.broken_faces, losses.faces);
        assert_int_equal(f->report.lost_corners, losses.corners);
        assert_int_equal(f->report.faces, (SIDE - 1) * (SIDE - 1));
        uint8_t *bytes = test_read("scan.tris", &size);
        if (way == 0) {
            expected_bytes = bytes;
            expected_size = size;
            continue;
        }
        assert_int_equal(size, expected_size);
        assert_memory_equal(bytes, expected_bytes, size);
        free(bytes);
    }
    free(expected_bytes);
    read_sorted(f, &got, &header);
    expect_same_triangles(&got, &expected);
}

/* A block all of whose faces are left out, and a first block without any position. */
FIXTURE_TEST(a_block_may_lose_all_its_faces)
{
    FILE *file = fopen("scan.obj", "wb");
    for (int i = 0; i < 90000; i++)
        fprintf(file, "v nan 0 0\n");
    fprintf(file, "v 5 0 0\nv 6 0 0\nv 5 1 0\n");
    for (int i = 0; i < 700; i++)
        fprintf(file, "f 1 2 3%*s\n", 2000, "");
    for (int i = 0; i < 70000; i++)
        fprintf(file, "f 90001 90002 90003\n");
    assert_int_equal(fclose(file), 0);
    sort_open_context(f, 128 * MIB, 2);
    expect_sorted(f, sort_scan(f));
    assert_int_equal(f->report.broken_faces, 700);
    assert_int_equal(f->report.triangles, 70000);
    assert_true(f->report.origin[0] == 0);
}

/* ---- a scan that is no file ---- */

/* Gives the bytes of a text; fails at a byte that is not in the text's first half. */
struct given {
    const char *text;
    uint64_t limit;
};

static int give(void *user, void *to, uint64_t count, uint64_t offset)
{
    const struct given *given = user;
    memcpy(to, given->text + offset, count);
    return offset + count > given->limit ? BSQ_EIO : 0;
}

static int sort_given(struct sort_fixture *f, struct given *given, size_t size)
{
    const struct bsq_source source = {
        .size = sizeof source, .bytes = strlen(given->text), .read = give, .user = given};
    const char *paths[2] = {"given", "more.obj"};
    const struct bsq_source *sources[2] = {&source, NULL};
    struct vox_sort_options options;
    vox_sort_defaults(&options);
    options.size += size;
    options.scan_paths = paths;
    options.sources = sources;
    options.scan_count = 2;
    options.tris_path = "scan.tris";
    bsq_clear_error(f->ctx);
    bsq_forget_files(f->ctx);
    return vox_sort(f->ctx, &options, &f->report);
}

FIXTURE_TEST(test_a_callback_gives_a_mesh_beside_a_file)
{
    static const char mesh[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n";
    const char *paths[2] = {"scan.obj", "more.obj"};
    struct sorted_triangles got = {0}, expected = {0};
    struct given given = {mesh, sizeof mesh};
    test_text("scan.obj", mesh);
    test_text("more.obj", "v 5 0 0\nv 6 0 0\nv 5 1 0\nf 1 2 3\n");
    expect_sorted(f, sort_files(f, paths, 2));
    read_sorted(f, &expected, NULL);
    expect_sorted(f, sort_given(f, &given, 0));
    read_sorted(f, &got, NULL);
    expect_same_triangles(&got, &expected);

    given.limit = 20;
    assert_int_equal(sort_given(f, &given, 0), BSQ_EIO);
    assert_string_equal(bsq_error(f->ctx), "given: the callback failed");
    given = (struct given){"v 0 0 0\nv 1 0 0\nf 1 2 9\n", 99};
    assert_int_equal(sort_given(f, &given, 0), BSQ_EDATA);
    assert_string_equal(bsq_error(f->ctx), "given:3: face refers to vertex 9, file has 2");
    given = (struct given){"{\"asset\": {\"version\": \"2.0\"}}", 99};
    assert_int_equal(sort_given(f, &given, 0), BSQ_EDATA);
    assert_string_equal(bsq_error(f->ctx),
                        "given: a callback can give OBJ, PLY and STL meshes only");
}

FIXTURE_TEST(test_options_of_another_version_are_refused)
{
    struct given given = {"", 0};
    assert_int_equal(sort_given(f, &given, 8), BSQ_EUSAGE);
    assert_non_null(strstr(bsq_error(f->ctx), "struct vox_sort_options has "));
    const struct bsq_ctx_options options = {.size = 1};
    struct bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), BSQ_EUSAGE);
    assert_null(ctx);
}

RUN_TESTS(NULL, NULL)

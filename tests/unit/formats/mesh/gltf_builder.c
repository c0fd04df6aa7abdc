

#include "tests/unit/fixture.h"
#include "tests/unit/formats/mesh/gltf_builder.h"

void gltf_begin(struct ply_builder *bytes)
{
    *bytes = (struct ply_builder){.encoding = PLY_TEST_LITTLE};
}

/* Returns the JSON with its quotation marks and numbers; free() it. */
static char *expand(const char *json, const struct ply_builder *bytes)
{
    char *text = NULL;
    size_t size = 0;
    FILE *out = open_memstream(&text, &size);
    assert_non_null(out);
    for (; *json; json++) {
        if (strncmp(json, "$BYTES", 6) == 0) {
            fprintf(out, "%zu", bytes ? bytes->size : (size_t)0);
            json += 5;
        } else {
            fputc(*json == '\'' ? '"' : *json, out);
        }
    }
    fclose(out);
    return text;
}

/* Returns a file's name; the last eight stay valid. */
static const char *file_name(const char *name, const char *extension)
{
    static char names[8][64];
    static unsigned next;
    char *file = names[next++ % 8];
    snprintf(file, sizeof names[0], "%s.%s", name, extension);
    return file;
}

const char *gltf_write(const char *name, const char *json, const struct ply_builder *bytes)
{
    char *text = expand(json, bytes);
    if (bytes)
        test_bytes(file_name(name, "bin"), bytes->bytes ? bytes->bytes : "", bytes->size);
    const char *path = test_text(file_name(name, "gltf"), text);
    free(text);
    return path;
}

static void put_u32(char *to, size_t value)
{
    for (int i = 0; i < 4; i++)
        to[i] = (char)(value >> 8 * i);
}

char *gltf_make_glb(const char *json, const struct ply_builder *bytes, size_t *size)
{
    char *text = expand(json, bytes);
    const size_t length = strlen(text), padded = (length + 3) / 4 * 4;
    const size_t own = bytes->size, own_padded = (own + 3) / 4 * 4;
    *size = 12 + 8 + padded + 8 + own_padded;
    char *file = calloc(1, *size);
    assert_non_null(file);
    memset(file + 20, ' ', padded);
    memcpy(file, "glTF\2\0\0\0", 8);
    put_u32(file + 8, *size);
    put_u32(file + 12, padded);
    memcpy(file + 16, "JSON", 4);
    memcpy(file + 20, text, length);
    put_u32(file + 20 + padded, own_padded);
    memcpy(file + 24 + padded, "BIN", 4);
    if (own > 0)
        memcpy(file + 28 + padded, bytes->bytes, own);
    free(text);
    return file;
}

const char *gltf_write_glb(const char *name, const char *json, const struct ply_builder *bytes)
{
    size_t size;
    char *content = gltf_make_glb(json, bytes, &size);
    const char *path = test_bytes(file_name(name, "glb"), content, size);
    free(content);
    return path;
}

void gltf_read(struct obj_fixture *f, const char *path)
{
    obj_read_files(f, 2, 1, &path);
    if (f->status)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(f->status, 0);
}

void gltf_expect_error(const char *path, const char *message)
{
    struct obj_fixture f;
    obj_read_files(&f, 2, 1, &path);
    assert_string_equal(bsq_error(f.ctx), message);
    assert_int_equal(f.status, BSQ_EDATA);
    obj_close(&f);
}

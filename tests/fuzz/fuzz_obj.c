/* fuzz_obj.c - any bytes as an OBJ file: read as a mesh, they give a mesh whose indices are in
 * range or one error line, and leave no memory behind. With BSQ_FUZZ_REPLAY a program that runs the
 * files given on its command line through the same check. */
#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "formats/obj.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition, const char *what)
{
    if (!condition) {
        fprintf(stderr, "fuzz_obj: %s\n", what);
        abort();
    }
}

static void check_mesh(const struct fmt_mesh *mesh)
{
    for (uint64_t i = 0; i < mesh->vertex_count; i++)
        for (int c = 0; c < 3; c++)
            require(isfinite(mesh->positions[i][c]), "a position is not finite");
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        require(mesh->faces[t] < mesh->face_count, "a triangle of no face");
        for (int i = 0; i < 3; i++) {
            require(mesh->vertices[t][i] < mesh->vertex_count, "a vertex out of range");
            if (mesh->corner_texcoords && mesh->corner_texcoords[t][i] != UINT32_MAX)
                require(mesh->corner_texcoords[t][i] < mesh->texcoord_count,
                        "a texture coordinate out of range");
            if (mesh->corner_normals && mesh->corner_normals[t][i] != UINT32_MAX)
                require(mesh->corner_normals[t][i] < mesh->normal_count, "a normal out of range");
        }
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct bsq_ctx_options options = {.threads = 1, .memory_bytes = 64 << 20};
    struct bsq_ctx *ctx;
    struct fmt_mesh mesh;
    char path[64];
    int fd = memfd_create("fuzz.obj", MFD_CLOEXEC);
    require(fd >= 0 && write(fd, data, size) == (ssize_t)size, "cannot make the file");
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    require(bsq_ctx_create(&options, &ctx) == 0, "no context");
    int status = fmt_mesh_load(ctx, path, &mesh);
    if (status == 0) {
        check_mesh(&mesh);
        fmt_mesh_free(ctx, &mesh);
    } else {
        require(status == BSQ_EDATA || status == BSQ_ENOMEM, "an unexpected status");
        require(bsq_error(ctx)[0] && !strchr(bsq_error(ctx), '\n'), "not one line of error");
    }
    require(bsq_memory_used(ctx) == 0, "memory is left");
    bsq_ctx_destroy(ctx);
    close(fd);
    return 0;
}

#ifdef BSQ_FUZZ_REPLAY
static void replay(const char *path)
{
    FILE *file = fopen(path, "rb");
    require(file && !fseek(file, 0, SEEK_END), path);
    long size = ftell(file);
    uint8_t *data = malloc((size_t)size + 1);
    rewind(file);
    require(data && fread(data, 1, (size_t)size, file) == (size_t)size, path);
    fclose(file);
    LLVMFuzzerTestOneInput(data, (size_t)size);
    free(data);
}

int main(int count, char **paths)
{
    for (int i = 1; i < count; i++)
        replay(paths[i]);
    printf("%d files replayed\n", count - 1);
    return 0;
}
#endif

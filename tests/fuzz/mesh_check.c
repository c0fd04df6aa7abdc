#include "tests/fuzz/mesh_check.h"

#include <math.h>

#include "formats/mesh/mesh_reader.h"
#include "tests/fuzz/fuzz_file.h"

static void check_mesh(const struct fmt_mesh *mesh)
{
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        require(mesh->faces[t] < mesh->face_count, "a face number is out of range");
        for (int i = 0; i < 3; i++) {
            require(mesh->vertices[t][i] < mesh->vertex_count, "a vertex index is out of range");
            for (int c = 0; c < 3; c++)
                require(isfinite(mesh->positions[mesh->vertices[t][i]][c]),
                        "a position is not finite");
            if (mesh->corner_texcoords && mesh->corner_texcoords[t][i] != UINT32_MAX)
                require(mesh->corner_texcoords[t][i] < mesh->texcoord_count,
                        "a texture coordinate index is out of range");
            if (mesh->corner_normals && mesh->corner_normals[t][i] != UINT32_MAX)
                require(mesh->corner_normals[t][i] < mesh->normal_count,
                        "a normal index is out of range");
        }
    }
}

int fuzz_mesh(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    struct fmt_mesh mesh;
    require(count == 1, "more than one file");
    int status = fmt_mesh_load(ctx, paths[0], false, &mesh);
    if (status)
        return status;
    check_mesh(&mesh);
    fmt_mesh_free(ctx, &mesh);
    return 0;
}

/* fuzz_mtl.c - fuzz target for material libraries. */
#include "formats/mesh/obj_internal.h"
#include "tests/fuzz/fuzz_file.h"

#include <math.h>

static int use(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    const char *path = paths[0];
    (void)count;
    struct fmt_materials materials = {0};
    int status = fmt_mtl_read(ctx, path, "a.obj:1", &materials);
    for (uint32_t i = 0; !status && i < materials.count; i++) {
        const struct fmt_material *m = &materials.list[i];
        require(m->name != NULL, "a material has no name");
        for (int k = 0; k < 3; k++)
            require(isfinite(m->color.value[k]), "a colour is not finite");
    }
    fmt_materials_free(ctx, &materials);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.mtl"}, 1, use);
}

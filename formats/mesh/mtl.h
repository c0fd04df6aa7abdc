/* mtl.h - Wavefront MTL: the diffuse colour and texture of each material. */
#ifndef FMT_MESH_MTL_H
#define FMT_MESH_MTL_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

struct fmt_material {
    char *name;
    float diffuse[3]; /* Kd, display-referred (sRGB) 0..1; 0.8 where not given */
    bool has_diffuse;
    char *texture_path; /* map_Kd, options removed, resolved against the MTL's directory; or NULL */
};

struct fmt_materials {
    uint32_t count;
    struct fmt_material *list;
};

/* Appends the materials of one MTL file. A file that does not exist is a warning, not an error,
 * as scans are often passed on without it. Malformed statements are warnings. */
int fmt_mtl_read(struct bsq_ctx *ctx, const char *path, struct fmt_materials *materials);
/* Number of the material with this name, or UINT32_MAX. */
uint32_t fmt_mtl_find(const struct fmt_materials *materials, const char *name);
void fmt_mtl_free(struct bsq_ctx *ctx, struct fmt_materials *materials);

#ifdef __cplusplus
}
#endif
#endif

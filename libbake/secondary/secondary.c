/* secondary.c - see secondary.h. */
#include "libbake/secondary/secondary.h"

#include <string.h>

#include "libbake/kernel/bk_secondary.h"

static bk_vec3 secondary_vector(const float v[3])
{
    return bk_v3(v[0], v[1], v[2]);
}

void bake_viewpoint_ray(const struct bk_params *params, const struct bake_viewpoint *viewpoint,
                        bool open, uint32_t number, float origin[3], float direction[3])
{
    const bk_rays kind = bk_rays_of(params, open);
    const bk_vec3w around =
        bk_hemisphere(&kind, viewpoint->share, secondary_vector(viewpoint->normal),
                      secondary_vector(viewpoint->facet), number);
    const bk_vec3 d = bk_lane3(&around, 0);
    memcpy(origin, open ? viewpoint->open_from : viewpoint->solid_from, 3 * sizeof *origin);
    direction[0] = d.x;
    direction[1] = d.y;
    direction[2] = d.z;
}

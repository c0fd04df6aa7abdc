/* secondary.c - see secondary.h. */
#include "libbake/secondary/secondary.h"

#include <string.h>

#include "libbake/kernel/bk_secondary.h"

static bk_vec3 vector(const float v[3])
{
    return bk_v3(v[0], v[1], v[2]);
}

void bake_place_ray(const struct bk_params *params, const struct bake_place *place, bool open,
                    uint32_t number, float origin[3], float direction[3])
{
    const float side = open ? 1.0f : -1.0f;
    const bk_vec3w around = bk_hemisphere(
        place->seed ^ (open ? 0u : BK_SOLID_SEED), bk_scale(vector(place->normal), side),
        bk_scale(vector(place->facet), side), number,
        open ? bk_open_rays(params) : bk_solid_rays(params), open ? params->open_sine2 : 1.0f);
    const bk_vec3 d = bk_lane3(&around, 0);
    memcpy(origin, open ? place->open_from : place->solid_from, 3 * sizeof *origin);
    direction[0] = d.x;
    direction[1] = d.y;
    direction[2] = d.z;
}

/* bake_unused.c - see bake_unused.h.
 *
 * A warning and no error: scripts give the same options to all bakes. */
#include "tools/bake_unused.h"

#include <string.h>

static bool has_normals(const struct bake_options *bake)
{
    return (bake->maps & (BAKE_MAP_NORMAL | BAKE_MAP_BENT)) != 0;
}

static bool has_height(const struct bake_options *bake)
{
    return (bake->maps & BAKE_MAP_HEIGHT) != 0;
}

static bool has_position(const struct bake_options *bake)
{
    return (bake->maps & BAKE_MAP_POSITION) != 0;
}

static bool has_curvature(const struct bake_options *bake)
{
    return (bake->maps & BAKE_MAP_CURVATURE) != 0;
}

static bool has_open_rays(const struct bake_options *bake)
{
    return (bake->maps & (BAKE_MAP_AO | BAKE_MAP_BENT)) != 0;
}

static bool has_thickness(const struct bake_options *bake)
{
    return (bake->maps & BAKE_MAP_THICKNESS) != 0;
}

static bool has_preview(const struct bake_options *bake)
{
    return bake->preview_path != NULL;
}

static bool matches_names(const struct bake_options *bake)
{
    return bake->match_names;
}

static bool may_use_gpu(const struct bake_options *bake)
{
    return strcmp(bake->device, "cpu") != 0;
}

static const struct {
    const char *option, *needs;
    bool (*is_used)(const struct bake_options *bake);
} uses[] = {
    {"height-range", "the map height", has_height},
    {"position-in", "the map position", has_position},
    {"curvature-radius", "the map curvature", has_curvature},
    {"curvature-range", "the map curvature", has_curvature},
    {"ao-rays", "the map ao or bent", has_open_rays},
    {"ao-distance", "the map ao or bent", has_open_rays},
    {"ao-spread", "the map ao or bent", has_open_rays},
    {"ao-falloff", "the map ao or bent", has_open_rays},
    {"ao-coarse", "the map ao or bent", has_open_rays},
    {"thickness-rays", "the map thickness", has_thickness},
    {"thickness-distance", "the map thickness", has_thickness},
    {"normal-space", "the map normal or bent", has_normals},
    {"green", "the map normal or bent", has_normals},
    {"match-suffixes", "--match", matches_names},
    {"preview-views", "--preview", has_preview},
    {"up", "--preview", has_preview},
    {"gpu-memory", "a device other than cpu", may_use_gpu},
};

void bake_warn_unused(struct cli *cli, const struct bake_arguments *arguments)
{
    for (size_t i = 0; i < sizeof uses / sizeof *uses; i++)
        if (bake_arguments_has(arguments, uses[i].option) && !uses[i].is_used(&arguments->bake))
            bsq_warn(cli->ctx, "--%s has no effect: it needs %s", uses[i].option, uses[i].needs);
}

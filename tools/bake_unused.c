/* bake_unused.c - see bake_unused.h.
 *
 * A warning and no error: scripts give the same options to all bakes. */
#include "tools/bake_unused.h"

#include <string.h>

/* What an option can have an effect on. */
struct use {
    const struct bake_options *bake;
    bool grid;            /* one of the scans is a grid */
    bool without_normals; /* one of the scans is a chunk file without normals */
};

static bool has_normals(const struct use *use)
{
    return (use->bake->maps & (BAKE_MAP_NORMAL | BAKE_MAP_BENT)) != 0;
}

static bool has_height(const struct use *use)
{
    return (use->bake->maps & BAKE_MAP_HEIGHT) != 0;
}

static bool has_position(const struct use *use)
{
    return (use->bake->maps & BAKE_MAP_POSITION) != 0;
}

static bool has_curvature(const struct use *use)
{
    return (use->bake->maps & BAKE_MAP_CURVATURE) != 0;
}

static bool has_open_rays(const struct use *use)
{
    return (use->bake->maps & (BAKE_MAP_AO | BAKE_MAP_BENT)) != 0;
}

static bool has_thickness(const struct use *use)
{
    return (use->bake->maps & BAKE_MAP_THICKNESS) != 0;
}

/* Returns whether a map has padding; the mask has none. */
static bool has_padding(const struct use *use)
{
    bool padded = (use->bake->maps & ~(uint32_t)BAKE_MAP_MASK) != 0;
    for (uint32_t i = 0; i < use->bake->transfer_count; i++)
        padded |= !use->bake->transfers[i].no_file;
    return padded;
}

static bool has_preview(const struct use *use)
{
    return use->bake->preview_path != NULL;
}

static bool matches_names(const struct use *use)
{
    return use->bake->match_names;
}

static bool may_use_gpu(const struct use *use)
{
    return strcmp(use->bake->device, "cpu") != 0;
}

static bool is_tangent_space(const struct use *use)
{
    return use->bake->normal_space == BAKE_TANGENT_SPACE;
}

static bool has_grid(const struct use *use)
{
    return use->grid;
}

/* The nearest voxel of triangles is refused later, so it does not go unused. */
static bool sampling_matters(const struct use *use)
{
    return use->grid || use->bake->sampling == BAKE_NEAREST;
}

static bool lacks_normals(const struct use *use)
{
    return use->without_normals;
}

/* An option has a row for each thing that it needs. */
static const struct {
    const char *option, *needs;
    bool (*is_used)(const struct use *use);
    bool of_scans; /* is_used looks at what the scans are */
} uses[] = {
    {"height-range", "the map height", has_height, false},
    {"position-in", "the map position", has_position, false},
    {"curvature-radius", "the map curvature", has_curvature, false},
    {"curvature-range", "the map curvature", has_curvature, false},
    {"ao-rays", "the map ao or bent", has_open_rays, false},
    {"ao-distance", "the map ao or bent", has_open_rays, false},
    {"ao-spread", "the map ao or bent", has_open_rays, false},
    {"ao-falloff", "the map ao or bent", has_open_rays, false},
    {"ao-coarse", "the map ao or bent", has_open_rays, false},
    {"ao-coarse", "a grid", has_grid, true},
    {"thickness-rays", "the map thickness", has_thickness, false},
    {"thickness-distance", "the map thickness", has_thickness, false},
    {"sampling", "a grid", sampling_matters, true},
    {"scan-normals", "triangles without normals", lacks_normals, true},
    {"normal-space", "the map normal or bent", has_normals, false},
    {"green", "the map normal or bent", has_normals, false},
    {"green", "--normal-space tangent", is_tangent_space, false},
    {"padding", "a map other than mask", has_padding, false},
    {"match-suffixes", "--match", matches_names, false},
    {"preview-views", "--preview", has_preview, false},
    {"up", "--preview", has_preview, false},
    {"gpu-memory", "a device other than cpu", may_use_gpu, false},
    {"gpu-memory", "a grid", has_grid, true},
};

/* Returns whether an option was given whose effect depends on the scans. */
static bool depends_on_scans(const struct bake_arguments *arguments)
{
    bool depends = false;
    for (size_t i = 0; i < sizeof uses / sizeof *uses; i++)
        depends |= uses[i].of_scans && bake_arguments_has(arguments, uses[i].option);
    return depends;
}

/* Finds out what the scans are. */
static int inspect_scans(struct cli *cli, struct use *use)
{
    int status = 0;
    for (uint32_t i = 0; i <= use->bake->more_scan_count && status == 0; i++) {
        struct bake_scan_info info;
        status = bake_inspect_scan(
            cli->ctx, i == 0 ? use->bake->scan_path : use->bake->more_scan_paths[i - 1], &info);
        use->grid |= status == 0 && info.is_grid;
        use->without_normals |= status == 0 && !info.has_normals;
    }
    return status;
}

int bake_warn_unused(struct cli *cli, const struct bake_arguments *arguments)
{
    struct use use = {.bake = &arguments->bake};
    const int status = depends_on_scans(arguments) ? inspect_scans(cli, &use) : 0;
    for (size_t i = 0; i < sizeof uses / sizeof *uses && status == 0; i++)
        if (bake_arguments_has(arguments, uses[i].option) && !uses[i].is_used(&use))
            bsq_warn(cli->ctx, "--%s has no effect: it needs %s", uses[i].option, uses[i].needs);
    return status;
}

/* options.c - the table of a bake's options, and checks of them. */
#include "libbake/options/options.h"

#include <float.h>
#include <stdio.h>
#include <string.h>

#include "formats/material/channels.h"

/* ---- what options need to have an effect ---- */

/* Bits of bsq_option.needs. Those of maps mean that one of them is baked. */
enum {
    OPEN_RAYS = BAKE_MAP_AO | BAKE_MAP_BENT,
    NORMALS = BAKE_MAP_NORMAL | BAKE_MAP_BENT,
    PADDED_MAP = 1 << BAKE_MAX_MAPS,
    TANGENT_SPACE = PADDED_MAP << 1,
    PREVIEW = PADDED_MAP << 2,
    GPU = PADDED_MAP << 3,
    GRID = PADDED_MAP << 4,
    GRID_TO_SAMPLE = PADDED_MAP << 5,
    BARE_TRIANGLES = PADDED_MAP << 6,
    ASSET = PADDED_MAP << 7,
    LAST_NEED = ASSET
};

/* Returns whether a map has padding; the mask has none. */
static bool has_padding(const struct bake_options *options)
{
    bool padded = (options->maps & ~(uint32_t)BAKE_MAP_MASK) != 0;
    for (uint32_t i = 0; i < options->transfer_count; i++)
        padded |= !options->transfers[i].no_file;
    return padded;
}

/* Returns what a single bit of `needs` asks for if the bake does not have it, or NULL. */
static const char *lacks(uint32_t need, const struct bake_options *options,
                         const struct bake_scans_found *scans)
{
    switch (need) {
    case PADDED_MAP:
        return has_padding(options) ? NULL : "a map other than mask";
    case TANGENT_SPACE:
        return options->normal_space == BAKE_TANGENT_SPACE ? NULL : "--normal space=tangent";
    case PREVIEW:
        return options->preview_path || options->page_path ? NULL : "--preview or --report";
    case ASSET:
        return options->glb_path ? NULL : "--glb";
    case GPU:
        return !options->device || strcmp(options->device, "cpu") != 0 ? NULL
                                                                       : "a device other than cpu";
    case GRID_TO_SAMPLE: /* the nearest voxel of triangles is an error later */
        return scans->grid || options->sampling == BAKE_NEAREST ? NULL : "a grid";
    case GRID:
        return scans->grid ? NULL : "a grid";
    case BARE_TRIANGLES:
        return scans->normals ? "triangles without normals" : NULL;
    default:
        return NULL;
    }
}

/* ---- the table ---- */

#define KEY(name_, key_, argument_, help_) BSQ_ROW(name_, argument_, help_), .key = key_
#define MEMBER(kind, member)               BSQ_MEMBER(kind, struct bake_options, member)
#define COUNT(member, least, most, usual)  MEMBER(COUNT, member), BSQ_RANGE(least, most, usual)
#define NUMBER(member, most, usual)        MEMBER(NUMBER, member), BSQ_RANGE(0, most, usual)
#define SHIFT(member)                      MEMBER(NUMBER, member), BSQ_RANGE(-MOST_LENGTH, MOST_LENGTH, 0)
#define CHOICE(member, words_)             MEMBER(CHOICE, member), .words = words_
#define EITHER(member, words_)             MEMBER(FLAG, member), .words = words_
#define FINISHES                           .finishes = true

/* Small multiples of a length must be floats too. */
#define MOST_LENGTH ((double)FLT_MAX / 4)

static const struct bsq_option path_rows[] = {{.kind = BSQ_OPTION_INPUT}};
static const struct bsq_option size_rows[] = {
    {BSQ_MEMBER(COUNT, struct bake_tile_size, tile)},
    {BSQ_MEMBER(COUNT, struct bake_tile_size, width)},
    {BSQ_MEMBER(COUNT, struct bake_tile_size, height)},
};
static const struct bsq_option range_rows[] = {
    {BSQ_MEMBER(COUNT, struct bake_tile_range, first)},
    {BSQ_MEMBER(COUNT, struct bake_tile_range, last)},
};
static const struct bsq_option transfer_rows[] = {
    {BSQ_MEMBER(TEXT, struct bake_transfer, name)},
    {BSQ_MEMBER(INPUT, struct bake_transfer, texture_path)},
    {BSQ_MEMBER(FLAG, struct bake_transfer, in_mask)},
    {BSQ_MEMBER(FLAG, struct bake_transfer, no_file), FINISHES},
};

static const struct bsq_option pack_rows[] = {{BSQ_MEMBER(TEXT, struct bake_pack, name)},
                                              {BSQ_MEMBER(TEXT, struct bake_pack, maps)}};

static const struct bsq_option table[] = {
    {MEMBER(INPUT, scan_path)},
    {BSQ_LIST(struct bake_options, more_scan_paths, more_scan_count, path_rows)},
    {MEMBER(INPUT, mesh_path)},
    {BSQ_LIST(struct bake_options, more_mesh_paths, more_mesh_count, path_rows)},

    {BSQ_ROW("output", "FILE", "the maps; must contain \"<MAP>\" if there are several"),
     .heading = "Maps", .letter = 'o', MEMBER(OUTPUT, output_path)},
    {BSQ_ROW("maps", "LIST",
             "the maps to bake, separated by commas; see below\n"
             "(default: normal, and color if the scan has colours)"),
     .own_syntax = true, COUNT(maps, 0, UINT32_MAX, BAKE_MAPS_DEFAULT)},
    {BSQ_ROW("texture", "NAME=FILE", "the scan's image for transfer:NAME"), .own_syntax = true,
     BSQ_LIST(struct bake_options, transfers, transfer_count, transfer_rows)},
    {BSQ_ROW("pack", "NAME=MAP,...",
             "one file of up to four maps, in this order; such as\n"
             "orm=ao,roughness,metallic; 1-MAP: inverted; 0, 1: constant"),
     .own_syntax = true, BSQ_LIST(struct bake_options, packs, pack_count, pack_rows), FINISHES},
    {BSQ_ROW("preset", "NAME",
             "green, type, suffix and packed maps: unreal, unity, blender or gltf"),
     CHOICE(preset, "none unreal unity blender gltf"), FINISHES},
    {MEMBER(FLAG, engine_names), FINISHES},
    {BSQ_ROW("quality", "Q", "draft, normal or final: samples and rays that are not given"),
     CHOICE(quality, "normal draft final"), FINISHES},
    {BSQ_ROW("size", "N | WxH", "texels, or 4k (default: 2048); by UDIM tile: 1001=4096,*=2048"),
     .also = "resolution", .own_syntax = true, COUNT(width, 0, UINT32_MAX, 2048)},
    {COUNT(height, 0, UINT32_MAX, 2048)},
    {BSQ_LIST(struct bake_options, tile_sizes, tile_size_count, size_rows)},
    {BSQ_ROW("tiles", "LIST", "UDIM tiles to bake, such as 1001-1003,1011 (default: all in use)"),
     .own_syntax = true, BSQ_LIST(struct bake_options, tile_ranges, tile_range_count, range_rows),
     FINISHES},
    {BSQ_ROW("type", "TYPE",
             "of samples: half or float in OpenEXR, 16, 8 or 8+16 (by map)\n"
             "in PNG (default: auto, by the map)"),
     CHOICE(sample_type, "auto 8 16 half float 8+16"), FINISHES},
    {BSQ_ROW("exr-tiles", "N", "make OpenEXR files of tiles of N x N texels (default: of lines)"),
     COUNT(exr_tile_side, 8, BAKE_MAX_EXR_TILE, 0), FINISHES},
    {BSQ_ROW("padding", "N", "texels to fill around each chart; all: everywhere"), .words = "all",
     COUNT(padding, 0, UINT32_MAX - 1, 16), FINISHES, .needs = PADDED_MAP},
    {KEY("normal", "space", "SPC", "tangent (MikkTSpace) or object"),
     CHOICE(normal_space, "tangent object"), .needs = NORMALS},
    {KEY("normal", "green", "DIR", "up (OpenGL) or down (Direct3D), for tangent space"),
     EITHER(green_down, "up down"), .needs = NORMALS | TANGENT_SPACE},
    {KEY("range", "height", "D", "height of white in PNG files (default: the largest of the mesh)"),
     .words = "auto", NUMBER(height_range, MOST_LENGTH, -1), FINISHES, .positive = true,
     .needs = BAKE_MAP_HEIGHT},
    {KEY("range", "curvature", "C", "curvature of white (default: by the whole mesh)"),
     .words = "auto", NUMBER(curvature_range, MOST_LENGTH, -1), FINISHES, .positive = true,
     .needs = BAKE_MAP_CURVATURE},
    {KEY("range", "thickness", "D", "thickness of white (default: by the whole mesh)"),
     .words = "auto", NUMBER(thickness_range, MOST_LENGTH, -1), FINISHES, .positive = true,
     .needs = BAKE_MAP_THICKNESS},
    {KEY("range", "position", "SHAPE", "sphere or box around the scan"),
     CHOICE(position_in, "sphere box"), FINISHES, .needs = BAKE_MAP_POSITION},

    {BSQ_ROW("samples", "N", "N x N pairs of rays a texel"), .heading = "Rays",
     COUNT(samples, 1, BAKE_MAX_SAMPLES, 2)},
    {BSQ_ROW("front", "D", "length of the rays outwards, in the mesh's units"), .words = "auto",
     NUMBER(front, DBL_MAX, -1)},
    {BSQ_ROW("back", "D", "length of the rays inwards"), .words = "auto",
     NUMBER(back, DBL_MAX, -1)},
    {BSQ_ROW("cage", "FILE", "start rays at this mesh, with the vertices and faces of LOW.obj"),
     MEMBER(INPUT, cage_path)},
    {BSQ_ROW("extrude", "D", "start rays D outside of the low-poly mesh, along smooth normals"),
     .words = "none", NUMBER(extrude, MOST_LENGTH, -1), .positive = true},
    {BSQ_ROW("skew", "FILE", "grey map: white turns rays towards the faces' normals"),
     MEMBER(INPUT, skew_path)},
    {BSQ_ROW("ray-directions", "D", "smooth, mesh (its normals) or face"),
     CHOICE(rays, "smooth mesh face")},
    {BSQ_ROW("two-sided", NULL, "also hit surfaces that face away from the low-poly mesh"),
     MEMBER(FLAG, two_sided)},
    {BSQ_ROW("match", "name | LOW,HIGH",
             "objects see only scans with their names: body_low sees\n"
             "body_high.nvdb; LOW,HIGH: other endings of these names"),
     .own_syntax = true, MEMBER(FLAG, match_names)},
    {MEMBER(TEXT, low_suffix), .text = "_low"},
    {MEMBER(TEXT, high_suffix), .text = "_high"},
    {BSQ_ROW("max-missed", "P", "exit with 1 if more than P % of the samples find no surface"),
     NUMBER(max_missed, 100, 100), FINISHES},
    {MEMBER(FLAG, strict), FINISHES},
    {KEY("rays", "ao", "N", "rays a texel for ao and bent, shared by its samples"),
     COUNT(ao_rays, 1, BAKE_MAX_RAYS, 64), .needs = OPEN_RAYS},
    {KEY("rays", "thickness", "N", "likewise, for thickness"),
     COUNT(thickness_rays, 1, BAKE_MAX_RAYS, 64), .needs = BAKE_MAP_THICKNESS},
    {KEY("rays", "filter", "MODE", "none or surface: less noise, from texels near on the scan"),
     EITHER(filter_rays, "none surface"), .needs = BAKE_MAP_AO | BAKE_MAP_THICKNESS},
    {KEY("distance", "ao", "D", "length of these rays (default: none, they reach everything)"),
     .words = "none", NUMBER(ao_distance, MOST_LENGTH, -1), .positive = true, .needs = OPEN_RAYS},
    {KEY("distance", "thickness", "D", "likewise; white in PNG files (default: by the whole mesh)"),
     .words = "auto", NUMBER(thickness_distance, MOST_LENGTH, -1), .positive = true,
     .needs = BAKE_MAP_THICKNESS},
    {KEY("distance", "curvature", "D", "around a hit, to measure in (default: 2 texels)"),
     .words = "auto", NUMBER(curvature_radius, DBL_MAX, -1), .positive = true,
     .needs = BAKE_MAP_CURVATURE},
    {KEY("ao", "spread", "DEG", "angle of the cone of rays for ao and bent, to 180 degrees"),
     NUMBER(ao_spread, 180, 180), .positive = true, .needs = OPEN_RAYS},
    {KEY("ao", "falloff", "MODE", "none or linear: far surfaces hide less"),
     EITHER(ao_falloff, "none linear"), .needs = OPEN_RAYS},
    {KEY("ao", "coarse", "N", "in grids, voxels end rays as a whole from N voxels on; none"),
     .words = "none", NUMBER(ao_coarse, MOST_LENGTH, BAKE_AO_COARSE), .positive = true,
     .needs = OPEN_RAYS | BAKE_MAP_THICKNESS | GRID},

    {KEY("low", "scale", "X", "multiply the low-poly mesh by X"), .heading = "Low-poly mesh",
     NUMBER(low_scale, MOST_LENGTH, 1), .positive = true},
    {KEY("low", "turn", "AXES", "then turn it: z-up, y-up, or what becomes of xyz, such as -yxz"),
     CHOICE(low_turn, BAKE_TURNS)},
    {KEY("low", "x", "D", "then shift it along x"), SHIFT(low_x)},
    {KEY("low", "y", "D", "likewise, along y"), SHIFT(low_y)},
    {KEY("low", "z", "D", "likewise, along z"), SHIFT(low_z)},
    {KEY("low", "normals", "NAME",
         "if its file has none: angle or smooth (weighted by angle or area),\n"
         "or flat (default: angle; flat for glTF)"),
     CHOICE(low_normals, "auto angle smooth flat")},
    {BSQ_ROW("as-is", NULL, "bake meshes that do not fit each other"), MEMBER(FLAG, as_is),
     FINISHES},

    {KEY("scan", "sampling", "MODE", "trilinear or nearest, for grids"), .heading = "Scans",
     CHOICE(sampling, "trilinear nearest"), .needs = GRID_TO_SAMPLE},
    {KEY("scan", "normals", "NAME",
         "for triangles without normals: smooth, flat; or smooth ones\n"
         "by weight: area, angle or max (default, auto: those that the\n"
         "chunk file has; smooth is area)"),
     CHOICE(scan_normals, "auto smooth/area angle max flat"), .needs = BARE_TRIANGLES},
    {BSQ_ROW("scan-normal-map", "FILE",
             "add a tangent-space map to the scan's normals, for triangles"),
     MEMBER(INPUT, scan_normal_map)},

    {BSQ_ROW("glb", "FILE.glb",
             "the low-poly mesh as a glTF file with its maps normal, color, ao and\n"
             "transfer:roughness, metallic, occlusion, emission and opacity"),
     .heading = "Asset and preview", MEMBER(OUTPUT, glb_path)},
    {KEY("material", "alpha", "MODE", "how viewers use opacity: blend, or mask for holes"),
     CHOICE(glb_alpha, "blend mask"), FINISHES, .needs = ASSET},
    {KEY("material", "sides", "N", "sides of its triangles that viewers draw: one or two"),
     CHOICE(glb_sides, "one two"), FINISHES, .needs = ASSET},
    {BSQ_ROW("preview", "FILE.png", "a picture of the low-poly mesh, the baked mesh and the scan"),
     MEMBER(OUTPUT, preview_path)},
    {BSQ_ROW("report", "FILE.html",
             "a page to look at: the mesh in 3D, all maps, misses, times, what was\n"
             "lost, and the command"),
     MEMBER(OUTPUT, page_path)},
    {BSQ_ROW("reference", "DIR",
             "folder of maps, such as exact ones: tell how far those of the same\n"
             "names are from them"),
     MEMBER(INPUT, reference_path)},
    {KEY("view", "count", "N", "views around the mesh"), COUNT(preview_views, 1, BAKE_MAX_VIEWS, 4),
     FINISHES, .needs = PREVIEW},
    {KEY("view", "from", "DEG", "of the first view, from the front on; auto: 30 on closed meshes"),
     .words = "auto", NUMBER(preview_from, 360, -1), FINISHES, .needs = PREVIEW},
    {KEY("view", "above", "DEG",
         "how far views look down, to 90 degrees; auto: 17 on closed meshes"),
     .words = "auto", NUMBER(preview_above, 90, -1), FINISHES, .needs = PREVIEW},
    {KEY("view", "up", "AXIS", "the vertical axis: y, z or auto"), CHOICE(preview_up, "auto y z"),
     FINISHES, .needs = PREVIEW},

    {BSQ_ROW("part", "I/N",
             "bake the I-th of N shares of the texels into files beside the maps,\n"
             "unless they are there already"),
     .heading = "Parts for several machines", .own_syntax = true, COUNT(part, 0, BAKE_MAX_PARTS, 0),
     FINISHES},
    {BSQ_ROW("merge", "N",
             "write the maps from all N parts of the same bake;\n"
             "with --tiles: only those of these UDIM tiles (default: no parts)"),
     COUNT(parts, 1, BAKE_MAX_PARTS, 0)},

    {BSQ_ROW("device", "NAME",
             BAKE_DEVICE_NAMES "\n"
                               "(default: cpu if it is expected to finish first, else auto)"),
     .heading = "Devices", .own_syntax = true, MEMBER(TEXT, device), FINISHES, .text = ""},
    {BSQ_ROW("gpu-memory", "SIZE", "most memory of a GPU to use, e.g. 2G (default: what is free)"),
     MEMBER(BYTES, gpu_memory_bytes), FINISHES, .needs = GPU},
};
enum { ROWS = sizeof table / sizeof *table };
_Static_assert((int)ROWS <= (int)BAKE_MOST_OPTION_ROWS, "bisque-bake has a flag for each row");

const struct bsq_option *bake_option_rows(size_t *count)
{
    *count = ROWS;
    return table;
}

void bake_defaults(struct bake_options *options)
{
    bsq_options_defaults(table, ROWS, options);
    options->size = sizeof *options;
    options->page = NULL;
    options->on_rows = NULL;
    options->rows_user = NULL;
    options->rows_only = false;
}

/* ---- options without effect ---- */

static void options_warn(struct bsq_ctx *ctx, const struct bsq_option *row, const char *what)
{
    bsq_warn(ctx, "--%s%s%s has no effect: it needs %s", row->name, row->key ? " " : "",
             row->key ? row->key : "", what);
}

/* Warns of an option that needs one of these maps, of which none is baked. */
static void warn_of_maps(struct bsq_ctx *ctx, const struct bsq_option *row, uint32_t maps)
{
    char text[256] = "the map";
    size_t length = strlen(text);
    for (unsigned i = 0; bake_map_name(i); i++)
        if (maps >> i & 1)
            length += (size_t)snprintf(text + length, sizeof text - length, "%s %s",
                                       maps & ((1u << i) - 1) ? " or" : "", bake_map_name(i));
    options_warn(ctx, row, text);
}

void bake_warn_of_options(struct bsq_ctx *ctx, const struct bake_options *options,
                          const bool *given, const struct bake_scans_found *scans)
{
    for (const struct bsq_option *row = table; row < table + ROWS; row++) {
        const uint32_t maps = row->needs & (PADDED_MAP - 1);
        if (!given[row - table])
            continue;
        if (maps && !(maps & options->maps))
            warn_of_maps(ctx, row, maps);
        for (uint32_t need = PADDED_MAP; need <= LAST_NEED; need <<= 1)
            if (row->needs & need && lacks(need, options, scans))
                options_warn(ctx, row, lacks(need, options, scans));
    }
}

/* ---- checks ---- */

static bool is_tile(uint32_t number)
{
    return number >= BAKE_FIRST_TILE && number <= BAKE_LAST_TILE;
}

int bake_check_tile_numbers(struct bsq_ctx *ctx, const struct bake_options *options)
{
    for (uint32_t i = 0; i < options->tile_range_count; ++i) {
        const struct bake_tile_range *range = &options->tile_ranges[i];
        if (!is_tile(range->first) || !is_tile(range->last) || range->first > range->last)
            return bsq_fail(ctx, BSQ_EUSAGE, "tiles %u to %u: UDIM tiles are %d to %d",
                            range->first, range->last, BAKE_FIRST_TILE, BAKE_LAST_TILE);
    }
    for (uint32_t i = 0; i < options->tile_size_count; ++i)
        if (!is_tile(options->tile_sizes[i].tile))
            return bsq_fail(ctx, BSQ_EUSAGE, "a size for tile %u: UDIM tiles are %d to %d",
                            options->tile_sizes[i].tile, BAKE_FIRST_TILE, BAKE_LAST_TILE);
    return 0;
}

int bake_check_maps(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps)
{
    BSQ_PASS(bake_map_files_check(ctx, options, maps));
    for (uint32_t i = 0; i < options->tile_size_count; ++i) {
        struct bake_options tile = *options;
        tile.width = options->tile_sizes[i].width;
        tile.height = options->tile_sizes[i].height;
        BSQ_PASS(bake_map_files_check(ctx, &tile, maps));
    }
    return 0;
}

/* Checks the transfer maps that the mask is multiplied by. */
static int check_mask(struct bsq_ctx *ctx, const struct bake_options *options)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < options->transfer_count; ++i) {
        const struct bake_transfer *transfer = &options->transfers[i];
        count += transfer->in_mask;
        if (transfer->in_mask && fmt_channel_find(transfer->name)->values != 1)
            return bsq_fail(ctx, BSQ_EUSAGE, "the mask needs one value of %s, which has three",
                            transfer->name);
    }
    if (count > 1)
        return bsq_fail(ctx, BSQ_EUSAGE, "the mask can be multiplied by one channel, not %u",
                        count);
    if (count == 1 && !(options->maps & (BAKE_MAP_MASK | BAKE_MAPS_ALL)))
        return bsq_fail(ctx, BSQ_EUSAGE, "opacity is part of the mask, which is not baked");
    return 0;
}

static int check_transfers(struct bsq_ctx *ctx, const struct bake_options *options)
{
    if (options->transfer_count > BAKE_MAX_TRANSFERS)
        return bsq_fail(ctx, BSQ_EUSAGE, "%u transfer maps: must be at most %d",
                        options->transfer_count, BAKE_MAX_TRANSFERS);
    for (uint32_t i = 0; i < options->transfer_count; ++i) {
        const struct bake_transfer *transfer = &options->transfers[i];
        if (!fmt_is_channel_name(transfer->name))
            return bsq_fail(ctx, BSQ_EUSAGE,
                            "\"%s\" cannot be a transfer map: names have lower-case letters, "
                            "digits and _, with a letter first",
                            transfer->name);
        if (strcmp(transfer->name, FMT_CHANNEL_NORMAL_MAP) == 0)
            return bsq_fail(
                ctx, BSQ_EUSAGE,
                "transfer map %s: directions in tangent space cannot be transferred; the "
                "map normal contains them",
                transfer->name);
        if (fmt_is_map_name(transfer->name))
            return bsq_fail(ctx, BSQ_EUSAGE, "transfer map %s: there is another map of this name",
                            transfer->name);
        for (uint32_t j = 0; j < i; ++j)
            if (strcmp(options->transfers[j].name, transfer->name) == 0)
                return bsq_fail(ctx, BSQ_EUSAGE, "transfer map %s is named twice", transfer->name);
    }
    return check_mask(ctx, options);
}

/* Checks a word of a pack. */
static int check_packed(struct bsq_ctx *ctx, const struct bake_options *options,
                        const struct bake_pack *pack, const struct bake_packed *packed)
{
    const bool known = packed->number < BAKE_UNPACKED;
    if (packed->number == BAKE_CONSTANT)
        return 0;
    if (!known || bake_row_of(options, packed->number)->channels != 1)
        return bsq_fail(ctx, BSQ_EUSAGE, "--pack %s=%s: \"%.*s\" is not a baked map of one value",
                        pack->name, pack->maps, (int)packed->length, packed->word);
    return 0;
}

static int check_packs(struct bsq_ctx *ctx, const struct bake_options *options)
{
    for (uint32_t p = 0; p < options->pack_count; p++) {
        const struct bake_pack *pack = &options->packs[p];
        struct bake_packed packed[BAKE_MAX_PACKED];
        const unsigned count = bake_unpack(options, pack, packed);
        bool twice = fmt_is_map_name(pack->name) || !fmt_is_channel_name(pack->name);
        for (uint32_t i = 0; i < options->transfer_count; i++)
            twice |= strcmp(options->transfers[i].name, pack->name) == 0;
        for (uint32_t i = 0; i < p; i++)
            twice |= strcmp(options->packs[i].name, pack->name) == 0;
        if (twice || count == 0)
            return bsq_fail(ctx, BSQ_EUSAGE,
                            "--pack %s=%s: must be a name that no map has, and up to %d maps",
                            pack->name, pack->maps, BAKE_MAX_PACKED);
        for (unsigned i = 0; i < count; i++)
            BSQ_PASS(check_packed(ctx, options, pack, &packed[i]));
    }
    return 0;
}

int bake_check_options(struct bsq_ctx *ctx, const struct bake_options *options)
{
    BSQ_PASS(bsq_check_size(ctx, "bake_options", options->size, sizeof *options));
    if (!options->scan_path || !options->mesh_path || !options->output_path)
        return bsq_fail(ctx, BSQ_EUSAGE, "a scan, a low-poly mesh and an output are needed");
    if (options->cage_path && options->more_mesh_count > 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: a cage needs a single low-poly file, not %u of them",
                        options->cage_path, options->more_mesh_count + 1);
    if ((options->maps & ~(uint32_t)(BAKE_MAPS_ALL | BAKE_MAPS_USUAL)) >= 1u << BAKE_NAMED_MAPS)
        return bsq_fail(ctx, BSQ_EUSAGE, "unknown maps: %#x", options->maps);
    if (options->front == 0.0 && options->back == 0.0)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "rays of length 0 find nothing: front and back must not both be 0");
    if (options->ao_falloff && options->ao_distance <= 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "a falloff of ambient occlusion needs its distance");
    if (options->cage_path && options->extrude > 0)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s: rays start at a cage or at an extruded mesh, not both",
                        options->cage_path);
    if (bake_has_cage(options) && (options->front >= 0 || options->rays != BAKE_RAYS_SMOOTH))
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "a cage gives the rays' directions and their length in front");
    if (options->skew_path && options->rays == BAKE_RAYS_FACE)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s: a skew map changes nothing if rays run along the faces' normals",
                        options->skew_path);
    if (options->normal_space == BAKE_OBJECT_SPACE && options->green_down)
        return bsq_fail(ctx, BSQ_EUSAGE, "an object-space map has no green direction to flip");
    BSQ_PASS(bsq_options_check(ctx, table, ROWS, options));
    BSQ_PASS(bake_check_tile_numbers(ctx, options));
    BSQ_PASS(check_transfers(ctx, options));
    BSQ_PASS(check_packs(ctx, options));
    /* The default maps depend on the scan; they are checked again after it was opened. */
    struct bake_options chosen = *options;
    if (options->transfer_count == 0 || options->maps != BAKE_MAPS_DEFAULT)
        chosen.maps = bake_choose_maps(options->maps, false, false);
    return bake_check_maps(ctx, options, bake_selection(&chosen));
}

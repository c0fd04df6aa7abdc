/* asset.c - collects the images of an asset from the rows of maps, and writes it. */
#include "libbake/asset/asset.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/file.h"
#include "formats/asset/glb.h"
#include "base/sort_array.h"
#include "formats/image/image_writer.h"

enum { CHUNK_ROWS = 256 }; /* that are converted at once */

/* Maps by their use. */
enum use { COLOR, NORMAL, OCCLUSION, ROUGHNESS, METALLIC, EMISSION, OPACITY, USES };
enum { NO_MAP = UINT32_MAX };
_Static_assert((int)BAKE_ASSET_IMAGES == (int)FMT_GLB_TEXTURES, "images are textures");

/* The images of a UDIM tile. */
struct tile_images {
    uint32_t map_of[USES]; /* numbers of maps, or NO_MAP */
    bool green_down;
    enum fmt_glb_alpha alpha;
    bool double_sided;
    float brightest;                                    /* value of emission, at least 1 */
    uint32_t width, row;                                /* row: the first one that has not come */
    struct fmt_image_writer *writers[FMT_GLB_TEXTURES]; /* while rows come */
    struct bsq_file files[FMT_GLB_TEXTURES];            /* complete */
    char name[80];                                      /* of the material */
};

struct bake_asset {
    struct bsq_ctx *ctx;
    const char *path;
    struct bsq_output *output;
    struct tile_images *tiles;
    uint32_t tile_count, current;
    float *rows; /* CHUNK_ROWS of the current tile */
};

int bake_asset_open(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t tiles,
                    struct bake_asset **out)
{
    struct bake_asset *asset = NULL;
    int status;
    *out = NULL;
    if (options->normal_space != BAKE_TANGENT_SPACE)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: glTF has normals in tangent space only",
                        options->glb_path);
    BSQ_TRY(BSQ_CALLOC(ctx, "GLB file", 1, &asset));
    asset->ctx = ctx;
    asset->path = options->glb_path;
    BSQ_TRY(BSQ_CALLOC(ctx, "GLB file", tiles, &asset->tiles));
    for (; asset->tile_count < tiles; asset->tile_count++)
        for (int k = 0; k < FMT_GLB_TEXTURES; k++)
            asset->tiles[asset->tile_count].files[k] = (struct bsq_file)BSQ_FILE_CLOSED;
    BSQ_TRY(bsq_output_open(ctx, asset->path, &asset->output));
    *out = asset;
    asset = NULL;
done:
    bake_asset_discard(asset);
    return status;
}

/* ---- images ---- */

/* Returns the number of a map; NO_MAP if it is not baked. */
static uint32_t asset_find_map(const struct bake_options *options, uint32_t maps, uint32_t number)
{
    return bake_has_file(options, maps, number) ? number : (uint32_t)NO_MAP;
}

/* Returns the number of a transfer map with this name; NO_MAP if it is not baked. */
static uint32_t asset_find_transfer(const struct bake_options *options, uint32_t maps,
                                    const char *name)
{
    for (uint32_t i = BK_MAP_COUNT; i < bake_selection_end(maps); i++)
        if (bake_has_file(options, maps, i) && strcmp(bake_name_of(options, i), name) == 0)
            return i;
    return NO_MAP;
}

static void asset_find_maps(const struct bake_options *options, uint32_t maps, uint32_t out[USES])
{
    static const char *const names[USES] = {[OCCLUSION] = "occlusion",
                                            [ROUGHNESS] = "roughness",
                                            [METALLIC] = "metallic",
                                            [EMISSION] = "emission",
                                            [OPACITY] = "opacity"};
    out[COLOR] = asset_find_map(options, maps, BK_MAP_color);
    out[NORMAL] = asset_find_map(options, maps, BK_MAP_normal);
    for (int use = OCCLUSION; use < USES; use++)
        out[use] = asset_find_transfer(options, maps, names[use]);
    if (out[OCCLUSION] == NO_MAP)
        out[OCCLUSION] = asset_find_map(options, maps, BK_MAP_ao);
}

/* Values of a tile that its material depends on. */
struct extremes {
    const struct bake_image *image;
    uint32_t emission, opacity; /* offsets in a texel; NO_MAP: none */
    float brightest, clearest;
};

/* Takes a band of rows of the image. */
static int find_extremes(void *arg, uint32_t first_row, uint32_t rows, float *texels)
{
    struct extremes *found = arg;
    const uint32_t step = found->image->channels;
    const float *end = texels + (uint64_t)rows * found->image->width * step;
    (void)first_row;
    for (const float *texel = texels; texel < end; texel += step) {
        if (!(texel[0] > BAKE_OUTSIDE))
            continue;
        for (int k = 0; found->emission != NO_MAP && k < 3; k++)
            found->brightest = fmaxf(found->brightest, texel[found->emission + (uint32_t)k]);
        if (found->opacity != NO_MAP)
            found->clearest = fminf(found->clearest, texel[found->opacity]);
    }
    return 0;
}

/* Chooses the alpha and the emission of a tile's material. Forgets maps that say nothing: no light,
 * and opacity that 8 bits do not tell from 1. */
static int asset_judge_tile(struct bake_asset *asset, struct bake_image *image,
                            const struct bake_options *options, uint32_t maps,
                            struct tile_images *tile)
{
    uint32_t *map_of = tile->map_of;
    struct extremes found = {.image = image, .emission = NO_MAP, .opacity = NO_MAP, .clearest = 1};
    if (map_of[EMISSION] != NO_MAP)
        found.emission = bake_map_offset(maps, map_of[EMISSION]);
    if (map_of[OPACITY] != NO_MAP)
        found.opacity = bake_map_offset(maps, map_of[OPACITY]);
    if (found.emission != NO_MAP || found.opacity != NO_MAP)
        BSQ_PASS(bake_image_bands(asset->ctx, image, CHUNK_ROWS, false, find_extremes, &found));
    if (!(found.brightest > 0))
        map_of[EMISSION] = NO_MAP;
    if (!(found.clearest < 1 - 0.5f / 255))
        map_of[OPACITY] = NO_MAP;
    tile->brightest = fmaxf(found.brightest, 1);
    tile->double_sided = options->glb_sides == BAKE_TWO_SIDES;
    tile->alpha = map_of[OPACITY] == NO_MAP               ? FMT_GLB_OPAQUE
                  : options->glb_alpha == BAKE_ALPHA_MASK ? FMT_GLB_MASK
                                                          : FMT_GLB_BLEND;
    return 0;
}

/* Moves normals up and down by a quarter of a level of 8 bits, as on a checkerboard, before they
 * are rounded: where they hardly change from texel to texel, filtering then averages roundings that
 * would all be the same. All of a flat surface would lean by 0.32 degrees, for 8 bits have no 0. */
static void asset_dither_normals(float *rows, const struct tile_images *tile, uint32_t first,
                                 uint32_t count)
{
    for (uint32_t row = 0; row < count; row++) {
        float *at = rows + 3 * (uint64_t)row * tile->width;
        for (uint32_t x = 0; x + 1 < tile->width; x++, at += 3)
            for (int k = 0; k < 2; k++)
                if (fabsf(at[3 + k] - at[k]) < 0.25f / 255)
                    at[k] += ((tile->row + first + row + x) & 1 ? 0.25f : -0.25f) / 255;
    }
}

static uint32_t asset_channels(const struct tile_images *tile, enum fmt_glb_texture texture)
{
    return texture == FMT_GLB_BASE_COLOR && tile->map_of[OPACITY] != NO_MAP ? 4 : 3;
}

/* Converts rows of the current tile for an image. `first` counts them in the band. */
static void asset_convert(const struct bake_asset *asset, const struct bake_map_files *files,
                          enum fmt_glb_texture texture, uint32_t first, uint32_t rows)
{
    static const enum use uses[FMT_GLB_TEXTURES] = {[FMT_GLB_BASE_COLOR] = COLOR,
                                                    [FMT_GLB_NORMAL] = NORMAL,
                                                    [FMT_GLB_ORM] = OCCLUSION,
                                                    [FMT_GLB_EMISSION] = EMISSION};
    const struct tile_images *tile = &asset->tiles[asset->current];
    const uint64_t texels = (uint64_t)rows * tile->width, begin = (uint64_t)first * tile->width;
    const uint32_t channels = asset_channels(tile, texture);
    const float scale = texture == FMT_GLB_EMISSION ? 1 / tile->brightest : 1;
    for (uint32_t k = 0; k < channels; k++) {
        const bool single = texture == FMT_GLB_ORM || k == 3;
        const uint32_t use = k == 3 ? OPACITY : uses[texture] + (single ? k : 0);
        const float *from = bake_map_rows(files, tile->map_of[use]);
        for (uint64_t i = 0; i < texels; i++)
            asset->rows[channels * i + k] =
                from ? scale * from[single ? begin + i : 3 * (begin + i) + k] : 1.0f;
    }
    for (uint64_t i = 0; texture == FMT_GLB_NORMAL && tile->green_down && i < texels; i++)
        asset->rows[3 * i + 1] = 1.0f - asset->rows[3 * i + 1];
    if (texture == FMT_GLB_NORMAL)
        asset_dither_normals(asset->rows, tile, first, rows);
}

/* Takes a band of rows of all maps. */
static int take_rows(void *arg, const struct bake_map_files *files, uint32_t rows)
{
    struct bake_asset *asset = arg;
    struct tile_images *tile = &asset->tiles[asset->current];
    for (uint32_t first = 0; first < rows; first += CHUNK_ROWS) {
        const uint32_t count = rows - first < CHUNK_ROWS ? rows - first : CHUNK_ROWS;
        for (int k = 0; k < FMT_GLB_TEXTURES; k++) {
            if (!tile->writers[k])
                continue;
            asset_convert(asset, files, (enum fmt_glb_texture)k, first, count);
            BSQ_PASS(fmt_image_write_rows(tile->writers[k], asset->rows, count));
        }
    }
    tile->row += rows;
    return 0;
}

int bake_asset_begin_tile(struct bake_asset *asset, uint32_t number,
                          const struct bake_options *options, uint32_t maps,
                          struct bake_image *image, struct bake_map_files *files)
{
    struct tile_images *tile = &asset->tiles[number];
    const uint32_t *map_of = tile->map_of;
    struct fmt_image_options png = {
        .width = options->width, .height = options->height, .type = FMT_UINT8, .temporary = true};
    asset->current = number;
    asset_find_maps(options, maps, tile->map_of);
    BSQ_PASS(asset_judge_tile(asset, image, options, maps, tile));
    const bool wanted[FMT_GLB_TEXTURES] = {
        [FMT_GLB_BASE_COLOR] = map_of[COLOR] != NO_MAP || map_of[OPACITY] != NO_MAP,
        [FMT_GLB_NORMAL] = map_of[NORMAL] != NO_MAP,
        [FMT_GLB_ORM] = map_of[OCCLUSION] != NO_MAP || map_of[ROUGHNESS] != NO_MAP ||
                        map_of[METALLIC] != NO_MAP,
        [FMT_GLB_EMISSION] = map_of[EMISSION] != NO_MAP};
    tile->green_down = options->green_down;
    tile->width = options->width;
    bsq_free(asset->ctx, asset->rows);
    asset->rows = NULL;
    BSQ_PASS(bsq_alloc(asset->ctx, "rows of a GLB file", (uint64_t)CHUNK_ROWS * options->width,
                       4 * sizeof *asset->rows, &asset->rows));
    for (int k = 0; k < FMT_GLB_TEXTURES; k++) {
        png.channel_count = asset_channels(tile, (enum fmt_glb_texture)k);
        png.color = k == FMT_GLB_BASE_COLOR || k == FMT_GLB_EMISSION;
        png.rounded = k == FMT_GLB_NORMAL;
        if (wanted[k])
            BSQ_PASS(fmt_image_create(asset->ctx, &fmt_png_format, asset->path, &png,
                                      &tile->writers[k]));
    }
    bake_map_files_watch(files, take_rows, asset);
    return 0;
}

int bake_asset_end_tile(struct bake_asset *asset, uint32_t number)
{
    struct tile_images *tile = &asset->tiles[number];
    for (int k = 0; k < FMT_GLB_TEXTURES; k++) {
        struct fmt_image_writer *writer = tile->writers[k];
        struct bsq_output *output;
        if (!writer)
            continue;
        tile->writers[k] = NULL;
        BSQ_PASS(fmt_image_hand_over(writer, &output));
        BSQ_PASS(bsq_output_keep_temp(output, &tile->files[k]));
    }
    return 0;
}

/* ---- vertices and indices ---- */

struct primitives {
    double centre[3]; /* to which positions are relative */
    struct fmt_glb_primitive *list;
    uint32_t *tiles; /* of each primitive: its number in the udim; not of a plain primitive */
    uint32_t count;
    struct fmt_glb_vertex *vertices; /* of all primitives */
    uint32_t *indices;
    uint64_t vertex_count, index_count;
};

struct corner {
    uint32_t vertex[sizeof(struct fmt_glb_vertex) / sizeof(uint32_t)]; /* the bits of its values */
    uint32_t number;
};

static int compare_corners(const void *a, const void *b)
{
    const struct corner *x = a, *y = b;
    const int order = memcmp(x->vertex, y->vertex, sizeof x->vertex);
    return order ? order : (x->number > y->number) - (x->number < y->number);
}

/* Replaces a direction of no length, where the mesh folds, by another one. */
static void replace_zero(float direction[3], const double instead[3])
{
    const float square =
        direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2];
    const double length =
        sqrt(instead[0] * instead[0] + instead[1] * instead[1] + instead[2] * instead[2]);
    for (int k = 0; k < 3 && !(square > 0); k++)
        direction[k] = length > 0 ? (float)(instead[k] / length) : (float)(k == 2);
}

/* Sets a direction that is perpendicular to a normal. */
static void set_perpendicular(const float normal[3], double out[3])
{
    const int k = fabsf(normal[0]) < 0.7f ? 0 : 1; /* an axis that is not along the normal */
    const double n[3] = {(double)normal[0], (double)normal[1], (double)normal[2]};
    for (int i = 0; i < 3; i++)
        out[i] = (i == k) - n[i] * n[k];
}

static void set_vertex(const struct bake_lowmesh *mesh, uint64_t triangle, int i,
                       const double centre[3], struct fmt_glb_vertex *out)
{
    const double(*p)[3] = (const double(*)[3])mesh->positions[triangle];
    const float *uv = mesh->texcoords[triangle][i];
    double face[3], across[3];
    for (int k = 0; k < 3; k++) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        face[k] =
            (p[1][a] - p[0][a]) * (p[2][b] - p[0][b]) - (p[1][b] - p[0][b]) * (p[2][a] - p[0][a]);
        out->position[k] = (float)(p[i][k] - centre[k]) + 0.0f; /* no -0 */
    }
    memcpy(out->normal, mesh->normals[triangle][i], sizeof out->normal);
    memcpy(out->tangent, mesh->tangents[triangle][i], sizeof out->tangent);
    replace_zero(out->normal, face);
    set_perpendicular(out->normal, across);
    replace_zero(out->tangent, across);
    out->texcoord[0] = uv[0];
    out->texcoord[1] = 1.0f - uv[1];
}

/* Returns whether a triangle of a tile is drawn with it. A triangle in several tiles has a copy in
 * each, of which the one with its middle is taken, if that has maps. */
static bool belongs(const struct bake_lowmesh *mesh, uint64_t triangle,
                    const struct bake_udim *udim, const struct bake_udim_tile *tile)
{
    const float(*uv)[2] = (const float(*)[2])mesh->texcoords[triangle];
    int away[2];
    for (int k = 0; k < 2; k++) {
        const float middle = (uv[0][k] + uv[1][k] + uv[2][k]) / 3;
        away[k] = middle < 0 ? -1 : middle > 1;
    }
    const int64_t number = (int64_t)tile->number + away[0] + 10 * (int64_t)away[1];
    bool other = false;
    for (uint32_t i = 0; i < udim->count && number != tile->number; i++)
        other |= udim->tiles[i].set == tile->set && udim->tiles[i].number == number;
    return !other;
}

/* Adds the primitive of a tile, unless it is empty. A tile of number 0 has what is in no tile.
 * corners: memory for all of its corners. */
static int asset_add_primitive(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                               const struct bake_udim *udim, const struct bake_udim_tile *tile,
                               struct corner *corners, struct primitives *out)
{
    const bool plain = tile->number == 0;
    struct fmt_glb_vertex *vertices = out->vertices + out->vertex_count;
    uint32_t *indices = out->indices + out->index_count;
    struct fmt_glb_primitive primitive = {.vertices = vertices, .indices = indices, .plain = plain};
    uint32_t corner_count = 0;
    for (uint64_t t = tile->first; t < tile->first + tile->count; t++)
        for (int i = 0; i < 3 && (plain || belongs(mesh, t, udim, tile)); i++, corner_count++) {
            struct fmt_glb_vertex vertex;
            set_vertex(mesh, t, i, out->centre, &vertex);
            memcpy(corners[corner_count].vertex, &vertex, sizeof vertex);
            corners[corner_count].number = corner_count;
        }
    if (corner_count == 0)
        return 0;
    bsq_sort(corners, corner_count, sizeof *corners, compare_corners);
    for (uint32_t i = 0; i < corner_count; i++) {
        const uint32_t *vertex = corners[i].vertex;
        if (i == 0 || memcmp(vertex, corners[i - 1].vertex, sizeof corners->vertex) != 0)
            memcpy(&vertices[primitive.vertex_count++], vertex, sizeof corners->vertex);
        indices[corners[i].number] = primitive.vertex_count - 1;
    }
    primitive.index_count = corner_count;
    out->vertex_count += primitive.vertex_count;
    out->index_count += primitive.index_count;
    out->list[out->count++] =
        primitive; /* NOLINT(clang-analyzer-core.NullDereference): has space */
    return bsq_check(ctx);
}

/* Makes a primitive of each UDIM tile, and a plain one of triangles outside of all tiles. Corners
 * with equal values share a vertex: they are sorted by the bytes of these. Free *out also after a
 * failure. Errors: BSQ_EDATA, BSQ_ENOMEM, BSQ_EINTR. */
static int make_primitives(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                           const struct bake_udim *udim, struct primitives *out)
{
    const struct bake_udim_tile *last = &udim->tiles[udim->count - 1];
    const uint64_t corners = 3 * mesh->triangle_count, placed = last->first + last->count;
    const struct bake_udim_tile rest = {.first = placed, .count = mesh->triangle_count - placed};
    struct corner *sorted = NULL;
    int status;
    if (corners >= UINT32_MAX)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%" PRIu64
                        " triangles are too many for a GLB file, which has 32-bit indices",
                        mesh->triangle_count);
    for (int k = 0; k < 3; k++)
        out->centre[k] = 0.5 * (mesh->bounds_min[k] + mesh->bounds_max[k]);
    BSQ_TRY(BSQ_CALLOC(ctx, "primitives of a GLB file", udim->count + UINT64_C(1), &out->list));
    BSQ_TRY(BSQ_ALLOC(ctx, "primitives of a GLB file", udim->count + UINT64_C(1), &out->tiles));
    BSQ_TRY(BSQ_ALLOC(ctx, "vertices of a GLB file", corners, &out->vertices));
    BSQ_TRY(BSQ_ALLOC(ctx, "indices of a GLB file", corners, &out->indices));
    BSQ_TRY(BSQ_ALLOC(ctx, "corners of a GLB file", corners, &sorted));
    for (uint32_t i = 0; i < udim->count; i++) {
        out->tiles[out->count] = i;
        BSQ_TRY(asset_add_primitive(ctx, mesh, udim, &udim->tiles[i], sorted, out));
    }
    status = asset_add_primitive(ctx, mesh, udim, &rest, sorted, out);
done:
    bsq_free(ctx, sorted);
    return status;
}

static void free_primitives(struct bsq_ctx *ctx, struct primitives *mesh)
{
    BSQ_FREE(ctx, mesh->list, mesh->tiles, mesh->vertices, mesh->indices);
}

/* ---- the file ---- */

/* Describes the material of a tile. */
static void set_material(struct tile_images *tile, const struct bake_lowmesh *mesh,
                         const struct bake_udim_tile *udim, struct fmt_glb_material *out)
{
    const struct bake_low_set *set = mesh->set_count > 0 ? &mesh->sets[udim->set] : NULL;
    const char *name = !set ? NULL : set->material ? set->material : set->object;
    snprintf(tile->name, sizeof tile->name, "%.60s%s%u", name ? name : "tile", " ", udim->number);
    *out = (struct fmt_glb_material){.name = tile->name,
                                     .occlusion = tile->map_of[OCCLUSION] != NO_MAP,
                                     .roughness = tile->map_of[ROUGHNESS] != NO_MAP,
                                     .metallic = tile->map_of[METALLIC] != NO_MAP,
                                     .alpha = tile->alpha,
                                     .double_sided = tile->double_sided,
                                     .emission_factor = tile->brightest};
    for (int k = 0; k < FMT_GLB_TEXTURES; k++)
        out->textures[k] = tile->files[k].fd >= 0 ? &tile->files[k] : NULL;
}

int bake_asset_write(struct bake_asset *asset, const struct bake_lowmesh *mesh,
                     const struct bake_udim *udim)
{
    struct bsq_ctx *ctx = asset->ctx;
    struct fmt_glb_material *materials = NULL;
    struct primitives primitives = {0};
    int status;
    BSQ_TRY(make_primitives(ctx, mesh, udim, &primitives));
    BSQ_TRY(BSQ_CALLOC(ctx, "materials of a GLB file", primitives.count + UINT64_C(1), &materials));
    for (uint32_t i = 0; i < primitives.count; i++)
        if (!primitives.list[i].plain)
            set_material(&asset->tiles[primitives.tiles[i]], mesh,
                         &udim->tiles[primitives.tiles[i]], &materials[i]);
    const struct fmt_glb glb = {
        .name = "baked",
        .translation = {primitives.centre[0], primitives.centre[1], primitives.centre[2]},
        .primitives = primitives.list,
        .materials = materials,
        .primitive_count = primitives.count};
    BSQ_TRY(fmt_glb_write(ctx, &glb, asset->path, asset->output));
    status = bsq_output_sync(asset->output);
done:
    bsq_free(ctx, materials);
    free_primitives(ctx, &primitives);
    return status;
}

void bake_asset_hand_over(struct bake_asset *asset, struct bsq_output **out)
{
    *out = asset->output;
    asset->output = NULL;
    bake_asset_discard(asset);
}

void bake_asset_discard(struct bake_asset *asset)
{
    if (!asset)
        return;
    for (uint32_t i = 0; i < asset->tile_count; i++)
        for (int k = 0; k < FMT_GLB_TEXTURES; k++) {
            fmt_image_discard(asset->tiles[i].writers[k]);
            bsq_file_close(asset->ctx, &asset->tiles[i].files[k]);
        }
    bsq_output_discard(asset->output);
    BSQ_FREE(asset->ctx, asset->rows, asset->tiles, asset);
}

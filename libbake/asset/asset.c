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
enum use { COLOR, NORMAL, OCCLUSION, ROUGHNESS, METALLIC, USES };
enum { NO_MAP = UINT32_MAX };
_Static_assert((int)BAKE_ASSET_IMAGES == (int)FMT_GLB_TEXTURES, "images are textures");

/* The images of a UDIM tile. */
struct tile_images {
    uint32_t map_of[USES]; /* numbers of maps, or NO_MAP */
    bool green_down;
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

/* Returns the number of a transfer map of one value with this name; NO_MAP: there is none. */
static uint32_t asset_find_transfer(const struct bake_options *options, uint32_t maps,
                                    const char *name)
{
    for (uint32_t i = BK_MAP_COUNT; i < bake_selection_end(maps); i++)
        if (bake_has_file(options, maps, i) && strcmp(bake_name_of(options, i), name) == 0 &&
            bake_row_of(options, i)->channels == 1)
            return i;
    return NO_MAP;
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

/* Converts rows of the current tile for an image. `first` counts them in the band. */
static void asset_convert(const struct bake_asset *asset, const struct bake_map_files *files,
                          enum fmt_glb_texture texture, uint32_t first, uint32_t rows)
{
    const struct tile_images *tile = &asset->tiles[asset->current];
    const uint64_t texels = (uint64_t)rows * tile->width, begin = (uint64_t)first * tile->width;
    for (int k = 0; texture == FMT_GLB_ORM && k < 3; k++) {
        const float *from = bake_map_rows(files, tile->map_of[OCCLUSION + k]);
        for (uint64_t i = 0; i < texels; i++)
            asset->rows[3 * i + (uint64_t)k] = from ? from[begin + i] : 1.0f;
    }
    if (texture == FMT_GLB_ORM)
        return;
    const float *from =
        bake_map_rows(files, tile->map_of[texture == FMT_GLB_NORMAL ? NORMAL : COLOR]);
    memcpy(asset->rows, from + 3 * begin, 3 * texels * sizeof *from);
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
                          struct bake_map_files *files)
{
    struct tile_images *tile = &asset->tiles[number];
    struct fmt_image_options image = {.width = options->width,
                                      .height = options->height,
                                      .channel_count = 3,
                                      .type = FMT_UINT8,
                                      .temporary = true};
    const uint32_t found[USES] = {
        [COLOR] = bake_has_file(options, maps, BK_MAP_color) ? BK_MAP_color : (uint32_t)NO_MAP,
        [NORMAL] = bake_has_file(options, maps, BK_MAP_normal) ? BK_MAP_normal : (uint32_t)NO_MAP,
        [OCCLUSION] = bake_has_file(options, maps, BK_MAP_ao) ? BK_MAP_ao : (uint32_t)NO_MAP,
        [ROUGHNESS] = asset_find_transfer(options, maps, "roughness"),
        [METALLIC] = asset_find_transfer(options, maps, "metallic")};
    const bool wanted[FMT_GLB_TEXTURES] = {[FMT_GLB_BASE_COLOR] = found[COLOR] != NO_MAP,
                                           [FMT_GLB_NORMAL] = found[NORMAL] != NO_MAP,
                                           [FMT_GLB_ORM] = found[OCCLUSION] != NO_MAP ||
                                                           found[ROUGHNESS] != NO_MAP ||
                                                           found[METALLIC] != NO_MAP};
    asset->current = number;
    memcpy(tile->map_of, found, sizeof found);
    tile->green_down = options->green_down;
    tile->width = options->width;
    bsq_free(asset->ctx, asset->rows);
    asset->rows = NULL;
    BSQ_PASS(bsq_alloc(asset->ctx, "rows of a GLB file", (uint64_t)CHUNK_ROWS * options->width,
                       3 * sizeof *asset->rows, &asset->rows));
    for (int k = 0; k < FMT_GLB_TEXTURES; k++) {
        image.color = k == FMT_GLB_BASE_COLOR;
        image.rounded = k == FMT_GLB_NORMAL;
        if (wanted[k])
            BSQ_PASS(fmt_image_create(asset->ctx, &fmt_png_format, asset->path, &image,
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
                                     .metallic = tile->map_of[METALLIC] != NO_MAP};
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

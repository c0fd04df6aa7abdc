/* exact.c - opens a chunk file: tree of its chunks, materials, textures. */
#include "libbake/exact/exact_scene.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

/* ---- opening ---- */

static int build_chunk_tree(struct bake_exact *exact)
{
    struct bsq_ctx *ctx = exact->ctx;
    struct exact_box *boxes = NULL;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "tree of chunks", bake_exact_tree_bytes(exact->chunk_count), 1,
                      &exact->tree_memory));
    BSQ_TRY(BSQ_ALLOC(ctx, "tree of chunks", exact->chunk_count, &boxes));
    for (uint32_t c = 0; c < exact->chunk_count; c++) {
        memcpy(boxes[c].low, exact->chunks[c].bounds_min, sizeof boxes[c].low);
        memcpy(boxes[c].high, exact->chunks[c].bounds_max, sizeof boxes[c].high);
    }
    bake_exact_tree_build(&exact->tree, exact->chunk_count, boxes, exact->tree_memory);
done:
    bsq_free(ctx, boxes);
    return status;
}

/* Chooses the normals of hits. */
static int exact_choose_normals(struct bake_exact *exact, enum bsq_scan_normals wanted)
{
    const enum bsq_scan_normals has = exact->header->made_normals;
    if (exact->header->attributes & FMT_TRIS_NORMALS || wanted == BSQ_SCAN_NORMALS_FLAT)
        return 0;
    exact->smooth = has != 0;
    if (wanted == BSQ_SCAN_NORMALS_AUTO || wanted == has)
        return 0;
    return bsq_fail(
        exact->ctx, BSQ_EUSAGE,
        "%s has %s normals: \"bisque-voxelize %s -o FILE.tris --scan-normals %s\" makes "
        "a file with those",
        exact->path,
        has == 0                       ? "no"
        : has == BSQ_SCAN_NORMALS_AREA ? "smooth (area)"
                                       : fmt_tris_normals_text(has),
        exact->path, fmt_tris_normals_text(wanted));
}

static int exact_open_file(struct bake_exact *exact, enum bsq_scan_normals normals)
{
    BSQ_PASS(fmt_tris_open(exact->ctx, exact->path, &exact->file));
    exact->header = fmt_tris_get_header(exact->file);
    exact->shading = (struct fmt_shading){
        .ctx = exact->ctx, .path = exact->path, .file = exact->file, .header = exact->header};
    exact->chunks = fmt_tris_chunks(exact->file);
    if (exact->header->chunk_count == 0 || exact->header->chunk_count > EXACT_TREE_BOXES)
        return bsq_fail(exact->ctx, BSQ_EDATA, "%s: %" PRIu64 " chunks: must be 1 to %" PRIu32,
                        exact->path, exact->header->chunk_count, EXACT_TREE_BOXES);
    exact->chunk_count = (uint32_t)exact->header->chunk_count;
    exact->simd = bsq_simd_best();
    BSQ_PASS(exact_choose_normals(exact, normals));
    return build_chunk_tree(exact);
}

int bake_exact_open(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                    struct bake_exact **out)
{
    struct bake_exact *exact;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(ctx, "scan", 1, &exact));
    *exact = (struct bake_exact){.ctx = ctx, .path = path, .two_sided = options->two_sided};
    int status = BSQ_CALLOC(ctx, "scan", 1, &exact->loads);
    if (status == 0)
        status = exact_open_file(exact, options->scan_normals);
    if (status < 0)
        bake_exact_close(exact);
    else
        *out = exact;
    return status;
}

void bake_exact_close(struct bake_exact *exact)
{
    if (!exact)
        return;
    struct bsq_ctx *ctx = exact->ctx;
    fmt_shading_close(&exact->shading);
    BSQ_FREE(ctx, exact->tree_memory, (void *)exact->loads);
    fmt_tris_close(exact->file);
    bsq_free(ctx, exact);
}

const struct fmt_tris_header *bake_exact_header(const struct bake_exact *exact)
{
    return exact->header;
}

uint64_t bake_exact_loads(const struct bake_exact *exact)
{
    return *exact->loads;
}

void bake_exact_chunks_in(const struct bake_exact *exact, const float low[3], const float high[3],
                          uint32_t from, uint32_t *first, uint32_t *last)
{
    struct exact_box box = EXACT_EMPTY_BOX;
    exact_box_grow(&box, low, high);
    bake_exact_tree_span(&exact->tree, &box, from, first, last);
}

/* ---- attributes ---- */

/* Returns the bytes that a cache of textures may take. */
static uint64_t cache_bytes(const struct bake_exact *exact)
{
    const uint64_t least = UINT64_C(12) << 20, most = UINT64_C(64) << 20;
    const uint64_t bytes = bsq_memory_left(exact->ctx) / 4;
    return bytes < least ? least : bytes > most ? most : bytes;
}

int bake_exact_use(struct bake_exact *exact, const struct bake_options *options, uint32_t maps)
{
    struct fmt_shading *shading = &exact->shading;
    if (maps & BAKE_MAP_COLOR)
        BSQ_PASS(fmt_shading_add_color(shading));
    for (uint32_t i = 0; i < options->transfer_count; i++)
        BSQ_PASS(fmt_shading_add_channel(shading, options->transfers[i].name,
                                         options->transfers[i].texture_path));
    BSQ_PASS(fmt_shading_add_normal_map(shading, options->scan_normal_map));
    if (maps & BAKE_MAP_ID && exact->header->ids != FMT_IDS_NONE)
        BSQ_PASS(fmt_shading_add_ids(shading));
    return fmt_shading_open_textures(shading, cache_bytes(exact));
}

int bake_exact_tell_losses(const struct bake_exact *exact)
{
    return fmt_shading_tell_losses(&exact->shading);
}

bool bake_exact_wants_footprints(const struct bake_exact *exact)
{
    return exact->shading.textures != NULL;
}

/* read_files.c - says how Bisque's own readers judge files, for compare.py.
 *
 * Reads paths from standard input, one a line. For each, prints a line: whether the file can be
 * used (a grid opens, a chunk file opens and all its chunks load), whether it is verified, a
 * checksum of all that was read (see content.py), and the first message. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <xxhash.h>

#include "formats/chunks/tris.h"
#include "formats/file_kind.h"
#include "tests/grid_lookup.h"

enum { LEAF_MASK = 16 }; /* offset of the mask in a leaf */

struct reading {
    struct bsq_ctx *ctx;
    XXH3_state_t *sum;
    const char *file; /* its path */
};

static void add(struct reading *r, const void *data, size_t size)
{
    if (size > 0)
        XXH3_64bits_update(r->sum, data, size);
}

static void add_u32(struct reading *r, uint32_t value)
{
    add(r, &value, sizeof value);
}

static void add_u64(struct reading *r, uint64_t value)
{
    add(r, &value, sizeof value);
}

/* ---- chunk files ---- */

static uint32_t wrap_bits(const struct fmt_uv *uv)
{
    return (uint32_t)(uv->wrap[0] | uv->wrap[1] << 2 | uv->srgb << 4) << 8;
}

static void add_uv(struct reading *r, const struct fmt_uv *uv)
{
    add(r, uv->scale, sizeof uv->scale);
    add(r, uv->offset, sizeof uv->offset);
}

/* Returns the path of a texture as the file has it: images inside of it have no path there. */
static const char *stored_path(const struct reading *r, const char *path)
{
    const size_t length = strlen(r->file);
    return path && strncmp(path, r->file, length) == 0 && path[length] == '#' ? path + length
                                                                              : path;
}

static void add_source(struct reading *r, const struct fmt_tris_source *source)
{
    const char *path = source->texture_path ? stored_path(r, source->texture_path) : "none";
    add(r, source->value, sizeof source->value);
    add_u32(r, source->component | wrap_bits(&source->uv));
    add_uv(r, &source->uv);
    add(r, path, strlen(path));
}

static void add_header(struct reading *r, const struct fmt_tris_header *h)
{
    add_u32(r, h->attributes);
    add_u64(r, h->triangle_count);
    add_u64(r, h->chunk_count);
    add_u64(r, h->source_faces);
    add_u64(r, h->skipped_triangles);
    add(r, h->origin, sizeof h->origin);
    add(r, h->bounds_min, sizeof h->bounds_min);
    add(r, h->bounds_max, sizeof h->bounds_max);
    add_u32(r, h->material_count);
    add_u32(r, h->ids);
    add_u32(r, h->made_normals);
    add_u32(r, h->channel_count);
    for (uint32_t c = 0; c < h->channel_count; c++)
        add(r, h->channels[c], strlen(h->channels[c]));
    for (uint32_t i = 0; i < h->material_count; i++) {
        const char *path = stored_path(r, h->materials[i].texture_path);
        const char *name = h->materials[i].name;
        add(r, h->materials[i].diffuse, sizeof h->materials[i].diffuse);
        add_u32(r, path ? (uint32_t)strlen(path) : UINT32_MAX);
        add(r, path, path ? strlen(path) : 0);
        add_u32(r, h->materials[i].colorless | h->materials[i].tinted << 1 |
                       wrap_bits(&h->materials[i].uv));
        add_u32(r, name ? (uint32_t)strlen(name) : 0);
        add(r, name, name ? strlen(name) : 0);
        add_uv(r, &h->materials[i].uv);
        for (uint32_t c = 0; c < h->channel_count; c++)
            add_source(r, &h->materials[i].sources[c]);
    }
}

static void add_chunk(struct reading *r, const struct fmt_tris_chunk_info *info,
                      const struct fmt_tris_chunk *c)
{
    const size_t nt = c->triangle_count, nv = c->vertex_count;
    add_u64(r, info->offset);
    add_u64(r, info->size_bytes);
    add_u64(r, info->first_triangle);
    add_u32(r, c->triangle_count);
    add_u32(r, c->vertex_count);
    add(r, info->bounds_min, sizeof info->bounds_min);
    add(r, info->bounds_max, sizeof info->bounds_max);
    add(r, c->positions, nv * sizeof *c->positions);
    add(r, c->normals, c->normals ? nv * sizeof *c->normals : 0);
    add(r, c->texcoords, c->texcoords ? nv * sizeof *c->texcoords : 0);
    add(r, c->colors, c->colors ? nv * sizeof *c->colors : 0);
    add(r, c->fine_colors, c->fine_colors ? nv * sizeof *c->fine_colors : 0);
    add(r, c->materials, c->materials ? nt * sizeof *c->materials : 0);
    add(r, c->triangles, nt * sizeof *c->triangles);
}

/* Adds the made normals of a chunk, if the file has any. */
static int add_normals(struct reading *r, const struct fmt_tris_file *file, uint64_t chunk)
{
    struct fmt_tris_normals normals;
    void *scratch = NULL;
    if (fmt_tris_get_header(file)->made_normals == 0)
        return 0;
    int status = bsq_alloc(r->ctx, "normals", fmt_tris_normals_size_max(file), 1, &scratch);
    if (!status)
        status = fmt_tris_load_normals(file, chunk, scratch, &normals);
    if (!status) {
        add(r, normals.vertices,
            fmt_tris_chunks(file)[chunk].vertex_count * sizeof *normals.vertices);
        add(r, normals.creases, normals.crease_count * sizeof *normals.creases);
    }
    bsq_free(r->ctx, scratch);
    return status;
}

static int use_tris(struct reading *r, const char *path)
{
    struct fmt_tris_file *file;
    void *scratch = NULL;
    int status = fmt_tris_open(r->ctx, path, &file);
    if (status)
        return status;
    add_header(r, fmt_tris_get_header(file));
    for (uint64_t i = 0; !status && i < fmt_tris_get_header(file)->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        status = bsq_alloc(r->ctx, "chunk", fmt_tris_load_size(file, i), 1, &scratch);
        if (!status)
            status = fmt_tris_load(file, i, scratch, &chunk);
        if (!status)
            add_chunk(r, &fmt_tris_chunks(file)[i], &chunk);
        if (!status)
            status = add_normals(r, file, i);
        bsq_free(r->ctx, scratch);
    }
    fmt_tris_close(file);
    return status;
}

/* ---- grids ---- */

static int add_name(void *arg, const char *name)
{
    struct reading *r = arg;
    add_u32(r, (uint32_t)strlen(name));
    add(r, name, strlen(name));
    return 0;
}

static void add_grid(struct reading *r, const struct fmt_nvdb_grid *g)
{
    add_u32(r, g->info.has_color);
    add(r, &g->info.voxel_size, sizeof g->info.voxel_size);
    add(r, g->info.translation, sizeof g->info.translation);
    add_u64(r, g->info.source_triangles);
    add(r, g->info.scan_min, sizeof g->info.scan_min);
    add(r, g->info.scan_max, sizeof g->info.scan_max);
    add(r, g->index_min, sizeof g->index_min);
    add(r, g->index_max, sizeof g->index_max);
    add_u64(r, g->upper_count);
    add_u64(r, g->lower_count);
    add_u64(r, g->leaf_count);
    add_u64(r, g->voxel_count);
    add_u64(r, g->record_count);
    add_u32(r, g->info.ids);
    fmt_nvdb_read_names(r->ctx, g, add_name, r);
}

static void add_record(struct reading *r, const struct fmt_nvdb_grid *g, uint64_t index)
{
    struct fmt_nvdb_record record = grid_get(g, index);
    add_u32(r, record.normal);
    add_u32(r, record.plane);
    add_u32(r, record.color);
    add_u32(r, record.id);
}

/* Looks up a voxel and its neighbour along x, and adds the voxel's records. */
static void add_voxel(struct reading *r, const struct fmt_nvdb_grid *g, const int32_t ijk[3])
{
    const int32_t next[3] = {ijk[0] + (ijk[0] < INT32_MAX), ijk[1], ijk[2]};
    uint64_t value = grid_find(g, ijk), second = fmt_nvdb_second(g, value);
    add(r, ijk, 3 * sizeof *ijk);
    add_u64(r, value);
    add_u64(r, grid_find(g, next));
    if (value)
        add_record(r, g, value);
    add_u64(r, second);
    if (second)
        add_record(r, g, second);
}

static void add_leaf(struct reading *r, const struct fmt_nvdb_grid *g, const uint8_t *leaf)
{
    int32_t low[3], ijk[3];
    memcpy(low, leaf, sizeof low);
    for (int bit = 0; bit < 512; bit++) {
        const int at[3] = {bit >> 6, bit >> 3 & 7, bit & 7};
        if (!(leaf[LEAF_MASK + bit / 8] >> bit % 8 & 1))
            continue;
        for (int k = 0; k < 3; k++)
            ijk[k] = (low[k] & ~7) + at[k];
        add_voxel(r, g, ijk);
    }
}

static int use_nvdb(struct reading *r, const char *path)
{
    struct fmt_nvdb_grid grid;
    int status = fmt_nvdb_open(r->ctx, path, &grid);
    if (status)
        return status;
    add_grid(r, &grid);
    for (uint32_t i = 0; i < grid.leaf_count; i++)
        add_leaf(r, &grid, grid.leaves + (size_t)i * FMT_NVDB_LEAF_BYTES);
    fmt_nvdb_close(r->ctx, &grid);
    return 0;
}

/* ---- both ---- */

static int use(struct reading *r, const char *path)
{
    const size_t length = strlen(path);
    XXH3_64bits_reset(r->sum);
    if (length > 5 && strcmp(path + length - 5, ".tris") == 0)
        return use_tris(r, path);
    return use_nvdb(r, path);
}

static bool answer(struct reading *r, const char *path)
{
    struct bsq_ctx_options options = {.threads = 1, .memory_bytes = 256 << 20};
    struct fmt_verify_report report = {.size = sizeof report};
    char message[512] = "";
    if (bsq_ctx_create(&options, &r->ctx))
        return false;
    r->file = path;
    int used = use(r, path);
    if (used)
        snprintf(message, sizeof message, "%s", bsq_error(r->ctx));
    bsq_ctx_destroy(r->ctx);

    if (bsq_ctx_create(&options, &r->ctx))
        return false;
    int verified = fmt_verify(r->ctx, path, &report);
    if (verified && !used)
        snprintf(message, sizeof message, "%s", bsq_error(r->ctx));
    bsq_ctx_destroy(r->ctx);
    printf("%d %d %016" PRIx64 " %s\n", used, verified, (uint64_t)XXH3_64bits_digest(r->sum),
           message);
    return fflush(stdout) == 0;
}

int main(void)
{
    struct reading reading = {.sum = XXH3_createState()};
    char path[4096];
    bool good = reading.sum != NULL;
    while (good && fgets(path, sizeof path, stdin)) {
        path[strcspn(path, "\n")] = '\0';
        good = answer(&reading, path);
    }
    XXH3_freeState(reading.sum);
    return good ? 0 : 1;
}

/* scan_textures.c - finds out which textures of materials can be used, before a scan is read.
 *
 * Users should learn of a damaged texture before hours of work. A texture that cannot be used is a
 * warning, and its material goes without it. */
#include "base/file_part.h"
#include "base/job_files.h"
#include "base/loss.h"
#include "formats/texture/texture.h"
#include "libvoxel/read/scan.h"

#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Memory for decoding, as a share of what is left. */
enum { DECODING_SHARE = 2 };
#define LEAST_DECODING_BYTES ((uint64_t)12 << 20)

/* A texture of a material that is to be checked. */
struct candidate {
    const struct fmt_material *material;
    bool good;
};

static int compare_candidates(const void *a, const void *b)
{
    const struct candidate *c = a, *d = b;
    const int order = strcmp(c->material->texture_path, d->material->texture_path);
    return order ? order : (c->material > d->material) - (c->material < d->material);
}

static int compare_textures(const void *a, const void *b)
{
    return strcmp(((const struct scan_texture *)a)->path, ((const struct scan_texture *)b)->path);
}

static const struct scan_texture *find(const struct scan_textures *textures, const char *path)
{
    const struct scan_texture key = {.path = (char *)path};
    return textures->count > 0 ? bsearch(&key, textures->list, textures->count,
                                         sizeof *textures->list, compare_textures)
                               : NULL;
}

bool vox_textures_have(const struct scan_textures *textures, const char *path)
{
    const struct scan_texture *texture = find(textures, path);
    return texture && texture->good;
}

/* ---- checking ---- */

/* Warns that a material has no texture. `problem` names it and says why. */
static int warn_bad(struct bsq_ctx *ctx, struct candidate *candidate, const char *path,
                    const char *problem)
{
    const char *place = candidate->material->texture_place;
    candidate->good = false;
    return bsq_warn_loss(ctx, "%s%s%s%s: material \"%s\" goes without it", place ? place : "",
                         place ? ": " : "", path, problem, candidate->material->name);
}

/* Checks what the file system says of the texture. */
static int check_file(struct bsq_ctx *ctx, struct candidate *candidate)
{
    struct bsq_part part;
    struct stat info;
    const char *path = candidate->material->texture_path;
    candidate->good = true;
    if (bsq_part_parse(path, &part) > 0)
        return 0;
    if (stat(path, &info))
        return warn_bad(ctx, candidate, path, ": no such texture");
    if (!S_ISREG(info.st_mode))
        return warn_bad(ctx, candidate, path, ": not a regular file");
    if (info.st_size == 0)
        return warn_bad(ctx, candidate, path, ": an empty file");
    return access(path, R_OK) ? warn_bad(ctx, candidate, path, ": not readable") : 0;
}

static int decode(struct bsq_ctx *ctx, const struct fmt_texture_source *sources, uint32_t count)
{
    struct fmt_textures *textures = NULL;
    const uint64_t share = bsq_memory_left(ctx) / DECODING_SHARE;
    int status =
        fmt_textures_open(ctx, sources, count,
                          share > LEAST_DECODING_BYTES ? share : LEAST_DECODING_BYTES, &textures);
    fmt_textures_close(textures);
    return status;
}

/* Decodes each of the good candidates, one by one, and warns of those that are damaged. */
static int decode_each(struct bsq_ctx *ctx, struct candidate *list, uint64_t count)
{
    int status = 0;
    for (uint64_t i = 0; i < count && !status; i++) {
        if (!list[i].good)
            continue;
        status =
            decode(ctx, &(struct fmt_texture_source){list[i].material->texture_path, false}, 1);
        if (status != BSQ_EDATA)
            continue;
        char *text = strdup(bsq_error(ctx));
        if ((status = bsq_check(ctx)) == 0 && text) {
            bsq_clear_error(ctx);
            status = warn_bad(ctx, &list[i], text, "");
        }
        free(text);
    }
    return status;
}

/* Decodes all good candidates. */
static int decode_all(struct bsq_ctx *ctx, struct candidate *list, uint64_t count)
{
    struct fmt_texture_source *sources = NULL;
    uint32_t good = 0;
    int status = bsq_calloc(ctx, "texture paths", count, sizeof *sources, &sources);
    for (uint64_t i = 0; i < count && !status; i++)
        if (list[i].good)
            sources[good++].path = list[i].material->texture_path;
    if (!status && good > 0)
        status = decode(ctx, sources, good);
    bsq_free(ctx, sources);
    if (status != BSQ_EDATA || bsq_check(ctx))
        return status;
    bsq_clear_error(ctx);
    return decode_each(ctx, list, count);
}

/* ---- the list ---- */

static int add_checked(struct bsq_ctx *ctx, struct scan_textures *textures,
                       const struct candidate *list, uint64_t count)
{
    int status = bsq_grow(ctx, "textures", textures->count + count, sizeof *textures->list,
                          &textures->list, &textures->capacity);
    for (uint64_t i = 0; i < count && !status; i++) {
        const char *path = list[i].material->texture_path;
        struct scan_texture *to = &textures->list[textures->count];
        status = bsq_alloc(ctx, "textures", strlen(path) + 1, 1, &to->path);
        if (status)
            break;
        strcpy(to->path, path);
        to->good = list[i].good;
        textures->count++;
    }
    if (textures->count > 0)
        qsort(textures->list, textures->count, sizeof *textures->list, compare_textures);
    return status;
}

/* Lists each new texture once, with the first material that names it. */
static uint64_t list_candidates(const struct scan_textures *textures,
                                const struct fmt_materials *materials, struct candidate *list)
{
    uint64_t all = 0, count = 0;
    for (uint32_t i = 0; i < materials->count; i++)
        if (materials->list[i].texture_path && !find(textures, materials->list[i].texture_path))
            list[all++].material = &materials->list[i];
    qsort(list, all, sizeof *list, compare_candidates);
    for (uint64_t i = 0; i < all; i++)
        if (count == 0 ||
            strcmp(list[count - 1].material->texture_path, list[i].material->texture_path) != 0)
            list[count++] = list[i];
    return count;
}

/* Notes the textures that other files name as inputs of the job. */
static int note_textures(struct bsq_ctx *ctx, const struct fmt_materials *materials)
{
    int status = 0;
    for (uint32_t i = 0; i < materials->count && !status; i++) {
        const struct fmt_material *material = &materials->list[i];
        if (material->texture_path && material->texture_place)
            status = bsq_note_input(ctx, material->texture_path, "the texture that %s names",
                                    material->texture_place);
    }
    return status;
}

int vox_textures_check(struct bsq_ctx *ctx, const struct fmt_materials *materials,
                       bool has_texcoords, struct scan_textures *textures)
{
    struct candidate *list = NULL;
    int status = note_textures(ctx, materials);
    if (status || materials->count == 0 || !has_texcoords)
        return status;
    status = bsq_calloc(ctx, "textures", materials->count, sizeof *list, &list);
    if (status)
        return status;
    const uint64_t count = list_candidates(textures, materials, list);
    for (uint64_t i = 0; i < count && !status; i++) {
        status = bsq_check(ctx);
        if (!status)
            status = check_file(ctx, &list[i]);
    }
    if (!status && textures->decode && count > 0)
        status = decode_all(ctx, list, count);
    if (!status && count > 0)
        status = add_checked(ctx, textures, list, count);
    bsq_free(ctx, list);
    return status;
}

int vox_textures_preview(struct bsq_ctx *ctx, struct fmt_mesh_reader *reader,
                         const char *texture_path, bool has_texcoords,
                         struct scan_textures *textures)
{
    struct fmt_materials materials = {0};
    if (texture_path && !has_texcoords)
        return 0;
    if (texture_path) {
        int status = bsq_note_input(ctx, texture_path, "the texture");
        return !status && textures->decode
                   ? decode(ctx, &(struct fmt_texture_source){texture_path, false}, 1)
                   : status;
    }
    int status = fmt_mesh_preview_materials(reader, &materials);
    if (!status)
        status = vox_textures_check(ctx, &materials, has_texcoords, textures);
    fmt_materials_free(ctx, &materials);
    return status;
}

void vox_textures_free(struct bsq_ctx *ctx, struct scan_textures *textures)
{
    for (uint64_t i = 0; i < textures->count; i++)
        bsq_free(ctx, textures->list[i].path);
    bsq_free(ctx, textures->list);
    *textures = (struct scan_textures){0};
}

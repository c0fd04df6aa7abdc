/* tile_files.h - textures that consist of a file for each UDIM tile.
 *
 * Their path has "<UDIM>", which stands for the tile's number 1001 + u + 10 v, or "<UVTILE>", which
 * stands for u1_v1 and so on: in the name of the file or of folders, also several times. Tile (u,
 * v) is the unit square of texture space from there. */
#ifndef BSQ_TILE_FILES_H
#define BSQ_TILE_FILES_H

#include "base/context.h"

#define BSQ_TILE_COLUMNS 10u  /* u is below this */
#define BSQ_TILE_ROWS    900u /* and v below this */

/* A tile that has a file. */
struct bsq_tile_file {
    uint32_t number; /* u + 10 v, from 0 on */
    char *path;
};

/* Tiles, by number. All zero at first; free it with bsq_tile_files_free(). */
struct bsq_tile_files {
    struct bsq_tile_file *list;
    uint64_t count, capacity;
};

/* Returns whether the path has a token. */
bool bsq_has_tiles(const char *path);

/* Returns the length of a path before its first component with a token. */
size_t bsq_tile_folder(const char *path);

/* Lists the regular files of a path with a token. There may be none. Errors: BSQ_ENOMEM, BSQ_EINTR.
 */
int bsq_tile_files_find(struct bsq_ctx *ctx, const char *path, struct bsq_tile_files *out);
void bsq_tile_files_free(struct bsq_ctx *ctx, struct bsq_tile_files *files);

#endif

/* tile_files.h - textures that consist of a file for each UDIM tile.
 *
 * Their path has "<UDIM>", which stands for the tile's number 1001 + u + 10 v, or "<UVTILE>", which
 * stands for u1_v1 and so on: in the name of the file or of folders, also several times. Tile (u,
 * v) is the unit square of texture space from there. */
#ifndef FMT_MATERIAL_TILE_FILES_H
#define FMT_MATERIAL_TILE_FILES_H

#include "base/context.h"

#define FMT_TILE_COLUMNS 10u  /* u is below this */
#define FMT_TILE_ROWS    900u /* and v below this */

/* A tile that has a file. */
struct fmt_tile_file {
    uint32_t number; /* u + 10 v, from 0 on */
    char *path;
};

/* Tiles, by number. All zero at first; free it with fmt_tile_files_free(). */
struct fmt_tile_files {
    struct fmt_tile_file *list;
    uint64_t count, capacity;
};

/* Returns whether the path has a token. */
bool fmt_has_tiles(const char *path);

/* Returns the length of a path before its first component with a token. */
size_t fmt_tile_folder(const char *path);

/* Lists the regular files of a path with a token. There may be none. Errors: BSQ_ENOMEM, BSQ_EINTR.
 */
int fmt_tile_files_find(struct bsq_ctx *ctx, const char *path, struct fmt_tile_files *out);
void fmt_tile_files_free(struct bsq_ctx *ctx, struct fmt_tile_files *files);

/* Notes the file of a texture as bsq_note_input() does, or the files of all tiles. */
int fmt_note_texture(struct bsq_ctx *ctx, const char *path, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

#endif

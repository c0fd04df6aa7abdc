/* paths.h - the names of map files: an output path whose tokens are replaced; private to libbake/.
 *
 * All return a path that the caller frees; NULL if there is no memory. */
#ifndef BAKE_UDIM_PATHS_H
#define BAKE_UDIM_PATHS_H

#include <stdint.h>

/* Replaces "<MAP>" by the name of a map. */
char *bake_map_path(const char *path, const char *name);
/* Replaces "<OBJECT>" and "<MATERIAL>" by names; characters that could lead to another folder
 * become '_'. NULL keeps a token. */
char *bake_object_path(const char *path, const char *object, const char *material);
/* Replaces "<UDIM>" and "<UVTILE>" for a tile. */
char *bake_tile_path(const char *path, uint32_t tile);

#endif

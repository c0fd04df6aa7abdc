/* obj_path.h - finds the files that OBJ and MTL files name. */
#ifndef FMT_MESH_OBJ_PATH_H
#define FMT_MESH_OBJ_PATH_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Joins the directory of the file `beside` and a path; an absolute path stays as it is. Free *out
 * with bsq_free(). Errors: BSQ_ENOMEM. */
int fmt_path_beside(struct bsq_ctx *ctx, const char *beside, const char *path, char **out);

/* Finds the file `name` that the file `beside` refers to, after the context's rules for paths
 * (base/path_map.h). Tries in this order: the name as written, relative to the directory of
 * `beside`; its backslashes as slashes, since many files come from Windows; its last component
 * alone, since absolute paths rarely survive a copy. Each of them is tried as it is, then without
 * quotes around it, or without a comment from its last "#" after a blank on, from the one before
 * that, and so on; and each with these capitals, then with folders and a file that differ in
 * capitals. A texture of tiles (base/tile_files.h) exists if a tile does, and its last component
 * keeps its capitals. *out is the first file, otherwise the name without quotes or comment; free it
 * with bsq_free(). exists may be NULL. Errors: BSQ_ENOMEM, BSQ_EINTR; then *out is NULL. */
int fmt_path_find(struct bsq_ctx *ctx, const char *beside, const char *name, char **out,
                  bool *exists);

#ifdef __cplusplus
}
#endif
#endif

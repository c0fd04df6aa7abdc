/* ply_roles.h - private to the PLY reader: what the elements and properties of a header mean. */
#ifndef FMT_MESH_PLY_ROLES_H
#define FMT_MESH_PLY_ROLES_H

#include "formats/mesh/ply_header.h"

/* Sets kinds, roles and sizes of all elements. Checks that the file has a mesh and, if its
 * size is known, that it is long enough for the elements that its header counts. Errors: BSQ_EDATA.
 */
int fmt_ply_find_roles(struct bsq_ctx *ctx, struct fmt_input *input, struct ply_header *header);

/* Warns of elements and properties that are not read. */
void fmt_ply_warn_unread(struct bsq_ctx *ctx, const char *path, const struct ply_header *header);

#endif

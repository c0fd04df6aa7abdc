/* one_pass.h - private to the sorter: faces scattered while they are read.
 *
 * Where all vertices come before all faces, as in nearly all scans, and they or their cells fit in
 * memory, a block's triangles go to their cells at once and faces need no store. Whether it is so
 * shows only at the end; vox_one_pass_gave_up() says that it is not, and then the scan is to be
 * read again without. */
#ifndef VOX_PARTITION_ONE_PASS_H
#define VOX_PARTITION_ONE_PASS_H

#include "libvoxel/partition/partition.h"

struct direct;

/* `out` is filled while the scan is read. */
int vox_one_pass_open(struct scan *scan, const struct fmt_mesh_reader *reader, const char *beside,
                      struct scattered *out, struct direct **direct);
void vox_one_pass_close(struct direct *direct);

/* The steps of fmt_mesh_read_steps(); struct direct is `arg`. */
extern const struct fmt_mesh_steps vox_one_pass_steps;

/* Reading failed without an error because the scan is not of that kind. */
bool vox_one_pass_gave_up(const struct direct *direct);
/* All faces are in `out`; false where they went to the store, as memory is scarce. */
bool vox_one_pass_is_active(const struct direct *direct);
/* Call after reading and vox_scan_finish(). */
void vox_one_pass_finish(struct direct *direct);

#endif

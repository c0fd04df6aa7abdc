/* direct.h - private to the sorter: faces scattered while they are read.
 *
 * Where all vertices come before all faces, as in nearly all scans, and they or their cells fit in memory, a block's
 * triangles go to their cells at once and faces need no store. Whether it is so shows only at the
 * end; direct_gave_up() says that it is not, and then the scan is to be read again without. */
#ifndef VOX_DIRECT_H
#define VOX_DIRECT_H

#include "libvoxel/scatter.h"

struct direct;

/* `out` is filled while the scan is read. */
int direct_open(struct scan *scan, const struct fmt_obj_reader *reader, const char *beside,
                struct scattered *out, struct direct **direct);
void direct_close(struct direct *direct);

/* The steps of fmt_obj_read_steps(); struct direct is `arg`. */
extern const struct fmt_obj_steps direct_steps;

/* Reading failed without an error because the scan is not of that kind. */
bool direct_gave_up(const struct direct *direct);
/* All faces are in `out`; false where they went to the store, as memory is scarce. */
bool direct_is_active(const struct direct *direct);
/* Call after reading and scan_finish(). */
void direct_finish(struct direct *direct);

#endif

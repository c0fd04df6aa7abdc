/* hash_join.h - private to the sorter: corners meet their values before they are scattered, where
 * columns are in files and scattering by index is not possible (partition.c). */
#ifndef VOX_PARTITION_HASH_JOIN_H
#define VOX_PARTITION_HASH_JOIN_H

#include "libvoxel/partition/triangle_record.h"

struct join;

/* By pages memory holds parts of the columns as they are needed, which is fast unless the faces'
 * order has nothing to do with the vertices'. By buckets the cost is the same for any order. */
enum join_method { JOIN_BY_PAGES, JOIN_BY_BUCKETS };

/* Prepares a join over all groups of the scan. */
int vox_join_open(struct scan *scan, const char *beside, enum join_method method,
                  struct join **out);
void vox_join_close(struct join *join);

/* Values of all corners of a group into arrays that have room. Groups must come in order; serial.
 */
int vox_join_fetch(struct join *join, const struct face_group *group, struct corner_values *values);

/* vox_join_fetch() failed without an error because the order does not suit pages. */
bool vox_join_gave_up(const struct join *join);

/* Vertices that some face refers to; only known where positions were joined by buckets. */
uint64_t vox_join_used_vertices(const struct join *join);

#endif

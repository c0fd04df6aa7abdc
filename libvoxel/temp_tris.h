/* temp_tris.h - the open chunk file that vox_sort() hands to vox_voxelize(). */
#ifndef VOX_TEMP_TRIS_H
#define VOX_TEMP_TRIS_H

#include "base/file.h"
#include "libvoxel/voxel.h"

struct vox_temp_tris {
    struct bsq_ctx *ctx;
    struct bsq_file file; /* BSQ_FILE_CLOSED before vox_sort() */
};

#endif

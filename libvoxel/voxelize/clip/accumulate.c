/* accumulate.c - see accumulate.h; the work itself is in accumulate_lanes.h. */
#include "libvoxel/voxelize/clip/fragment_block.h"

uint64_t vox_block_bytes(void)
{
    return sizeof(struct vox_block);
}

int vox_block_create(struct bsq_ctx *ctx, struct vox_block **out)
{
    return bsq_alloc(ctx, "triangle pieces", sizeof **out, 1, out);
}

void vox_block_destroy(struct bsq_ctx *ctx, struct vox_block *block)
{
    bsq_free(ctx, block);
}
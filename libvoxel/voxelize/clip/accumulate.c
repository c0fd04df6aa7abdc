/* accumulate.c - the memory of fragments; accumulate_lanes.c does the work. */
#include "libvoxel/voxelize/clip/fragment_block.h"

uint64_t vox_fragment_block_bytes(void)
{
    return sizeof(struct vox_fragment_block);
}

int vox_fragment_block_create(struct bsq_ctx *ctx, struct vox_fragment_block **out)
{
    return bsq_alloc(ctx, "fragments", sizeof **out, 1, out);
}

void vox_fragment_block_destroy(struct bsq_ctx *ctx, struct vox_fragment_block *block)
{
    bsq_free(ctx, block);
}
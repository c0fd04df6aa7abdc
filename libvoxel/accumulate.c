/* accumulate.c - see accumulate.h; the work itself is in accumulate_lanes.h. */
#include "libvoxel/block.h"
#include "libvoxel/lane_code.h"

static uint64_t color_count(bool has_color)
{
    return has_color ? BLOCK_SAMPLES + 1 : 0;
}

uint64_t vox_block_bytes(bool has_color)
{
    return sizeof(struct vox_block) + color_count(has_color) * sizeof(struct vox_color_sum);
}

int vox_block_create(struct bsq_ctx *ctx, bool has_color, struct vox_block **out)
{
    return bsq_alloc(ctx, "triangle pieces", vox_block_bytes(has_color), 1, out);
}

void vox_block_destroy(struct bsq_ctx *ctx, struct vox_block *block)
{
    bsq_free(ctx, block);
}

int vox_accumulate_chunk(const struct vox_accumulation *what, uint64_t *counted)
{
    return vox_lane_code()->accumulate_chunk(what, counted);
}

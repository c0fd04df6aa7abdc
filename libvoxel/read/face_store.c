/* face_store.c - see face_store.h. A group's bytes are, for each kind that it has, the indices;
 * then the face sizes where they are not all three; then the material changes. Indices of triangles
 * are coded as corner_delta_code.h says, those of other faces and sizes as index_delta_code.h says.
 */
#include "libvoxel/read/face_store.h"
#include "libvoxel/read/corner_delta_code.h"
#include "libvoxel/read/index_delta_code.h"

#include <string.h>

/* Faces in memory are read in parts of a group, so their segments can be of any size. */
#define FACE_SEGMENT_BYTES ((uint64_t)1 << 20)

void vox_face_store_init(struct face_store *store, struct bsq_ctx *ctx, const char *beside)
{
    memset(store, 0, sizeof *store);
    store->ctx = ctx;
    vox_spill_init(&store->bytes, ctx, "faces", beside, FACE_SEGMENT_BYTES);
}

void vox_face_store_free(struct face_store *store)
{
    if (!store->ctx)
        return;
    vox_spill_free(&store->bytes);
    bsq_free(store->ctx, store->groups);
    bsq_free(store->ctx, store->scratch);
    memset(store, 0, sizeof *store);
}

int vox_face_store_finish(struct face_store *store)
{
    bsq_free(store->ctx, store->scratch);
    store->scratch = NULL;
    store->scratch_capacity = 0;
    return vox_spill_finish(&store->bytes);
}

/* ---- appending ---- */

/* Part of a block that becomes one group. */
struct face_range {
    uint64_t first_face, face_count, first_corner, corner_count;
    uint64_t first_change, change_count;
    uint32_t max_size;
    bool triangles;
};

static uint64_t encoded_bound(const struct fmt_mesh_block *block, const struct face_range *range)
{
    uint64_t kinds = 1u + !!block->corner_texcoords + !!block->corner_normals;
    uint64_t triangles =
        range->corner_count / 3; /* of which each has two bytes more when coded as such */
    return kinds * (vox_index_code_bound(range->corner_count) + 2 * triangles) +
           vox_index_code_bound(range->face_count) +
           range->change_count * sizeof(struct face_change);
}

uint64_t vox_face_store_append_cost(const struct face_store *store,
                                    const struct fmt_mesh_block *block)
{
    (void)store;
    struct face_range all = {.face_count = block->face_count,
                             .corner_count = block->corner_count,
                             .change_count = block->material_change_count};
    /* Every group of the block may end in a byte of control bits that is not full. */
    uint64_t groups =
        block->face_count / FACE_GROUP_FACES + block->corner_count / (FACE_GROUP_CORNERS / 2) + 1;
    return encoded_bound(block, &all) + 4 * groups + FACE_SEGMENT_BYTES;
}

static struct face_range next_range(const struct fmt_mesh_block *block,
                                    const struct face_range *before)
{
    struct face_range r = {
        .first_face = before->first_face + before->face_count,
        .first_corner = before->first_corner + before->corner_count,
        .first_change = before->first_change + before->change_count,
        .triangles = true,
    };
    uint64_t end = block->face_count - r.first_face;
    if (end > FACE_GROUP_FACES)
        end = FACE_GROUP_FACES;
    while (r.face_count < end) {
        uint32_t size = block->face_sizes[r.first_face + r.face_count];
        if (r.face_count > 0 && r.corner_count + size > FACE_GROUP_CORNERS)
            break;
        r.triangles &= size == 3;
        r.max_size = size > r.max_size ? size : r.max_size;
        r.corner_count += size;
        r.face_count++;
    }
    while (r.first_change + r.change_count < block->material_change_count &&
           block->material_changes[r.first_change + r.change_count].face <
               r.first_face + r.face_count)
        r.change_count++;
    return r;
}

static uint8_t *encode_changes(const struct fmt_mesh_block *block, const struct face_range *range,
                               uint8_t *to)
{
    for (uint64_t i = 0; i < range->change_count; i++) {
        const struct fmt_mesh_material_change *from =
            &block->material_changes[range->first_change + i];
        struct face_change change = {(uint32_t)(from->face - range->first_face), from->material};
        memcpy(to, &change, sizeof change);
        to += sizeof change;
    }
    return to;
}

static void describe(struct face_group_info *info, const struct fmt_mesh_block *block,
                     const struct face_range *range)
{
    memset(info, 0, sizeof *info);
    info->first_face = block->face_base + range->first_face;
    info->face_count = (uint32_t)range->face_count;
    info->corner_count = (uint32_t)range->corner_count;
    info->change_count = (uint32_t)range->change_count;
    info->first_material = range->first_change > 0
                               ? block->material_changes[range->first_change - 1].material
                               : block->material_at_start;
    info->triangles = range->triangles;
}

/* As vox_index_code_encode(), of triangles. */
static uint8_t *encode_triangles(const uint64_t *indices, uint64_t count, uint8_t *to,
                                 uint64_t *end, bool *none)
{
    struct corner_code code = {0};
    uint64_t largest = 0, any_none = 0;
    for (uint64_t i = 0; i < count; i += 3) {
        for (uint64_t k = i; k < i + 3; k++) {
            uint64_t next = indices[k] + 1; /* FMT_MESH_NONE becomes 0 */
            largest = next > largest ? next : largest;
            any_none |= next == 0;
        }
        to = corner_code_put(&code, indices + i, to);
    }
    *end = largest;
    *none = any_none != 0;
    return to;
}

static const uint8_t *decode_triangles(const uint8_t *from, uint64_t count, uint64_t *indices)
{
    struct corner_code code = {0};
    for (uint64_t i = 0; i < count; i += 3)
        from = corner_code_get(&code, from, indices + i);
    return from;
}

/* Encodes into the scratch buffer, which has room. */
static uint8_t *encode_group(struct face_store *store, const struct fmt_mesh_block *block,
                             const struct face_range *range, struct face_group_info *info)
{
    const uint64_t *kinds[FACE_KIND_COUNT] = {block->corner_vertices, block->corner_texcoords,
                                              block->corner_normals};
    uint8_t *to = store->scratch;
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++) {
        if (!kinds[kind])
            continue;
        bool none;
        uint64_t end;
        const uint64_t *indices = kinds[kind] + range->first_corner;
        to = range->triangles
                 ? encode_triangles(indices, range->corner_count, to, &end, &none)
                 : vox_index_code_encode(indices, range->corner_count, to, &end, &none);
        info->has_kind[kind] = true;
        info->has_index[kind] = end > 0;
        info->max[kind] = end > 0 ? end - 1 : 0;
        if (kind == FACE_TEXCOORD)
            store->lacks_texcoord |= none;
    }
    store->lacks_texcoord |= !kinds[FACE_TEXCOORD];
    if (!range->triangles)
        to = vox_index_code_encode_sizes(block->face_sizes + range->first_face, range->face_count,
                                         to);
    return encode_changes(block, range, to);
}

static int append_bytes(struct spool *spool, const uint8_t *from, uint64_t size)
{
    while (size > 0) {
        uint8_t *at;
        uint64_t room;
        int status = vox_spill_room(spool, &at, &room);
        if (status < 0)
            return status;
        uint64_t part = size < room ? size : room;
        memcpy(at, from, part);
        vox_spill_advance(spool, part);
        from += part;
        size -= part;
    }
    return 0;
}

static void raise_u32(uint32_t *max, uint64_t value)
{
    if (value > *max)
        *max = (uint32_t)value;
}

static int append_group(struct face_store *store, const struct fmt_mesh_block *block,
                        const struct face_range *range)
{
    int status;
    uint64_t bound = encoded_bound(block, range);
    if (range->corner_count > UINT32_MAX / 32)
        return bsq_fail(store->ctx, BSQ_EDATA, "a face has %llu corners, more than %u",
                        (unsigned long long)range->corner_count, UINT32_MAX / 32);
    if ((bound > store->scratch_capacity &&
         (status = bsq_grow(store->ctx, "faces", bound, 1, &store->scratch,
                            &store->scratch_capacity)) < 0) ||
        (status = bsq_grow(store->ctx, "faces", store->group_count + 1, sizeof *store->groups,
                           &store->groups, &store->group_capacity)) < 0)
        return status;
    struct face_group_info *info = &store->groups[store->group_count];
    describe(info, block, range);
    uint8_t *end = encode_group(store, block, range, info);
    info->offset = store->bytes.bytes;
    info->bytes = (uint32_t)(end - store->scratch);
    if ((status = append_bytes(&store->bytes, store->scratch, info->bytes)) < 0)
        return status;
    store->group_count++;
    store->face_count += range->face_count;
    store->corner_count += range->corner_count;
    raise_u32(&store->max_faces, range->face_count);
    raise_u32(&store->max_corners, range->corner_count);
    raise_u32(&store->max_triangles, range->corner_count - 2 * range->face_count);
    raise_u32(&store->max_size, range->max_size);
    raise_u32(&store->max_changes, range->change_count);
    raise_u32(&store->max_bytes, info->bytes);
    return 0;
}

int vox_face_store_append(struct face_store *store, const struct fmt_mesh_block *block)
{
    struct face_range range = {0};
    int status = 0;
    while (status == 0 && range.first_face + range.face_count < block->face_count) {
        range = next_range(block, &range);
        status = append_group(store, block, &range);
    }
    return status;
}

/* ---- decoding ---- */

static uint64_t align8(uint64_t bytes)
{
    return (bytes + 7) & ~(uint64_t)7;
}

uint64_t vox_face_store_decode_bytes(const struct face_store *store)
{
    return FACE_KIND_COUNT * 8 * (uint64_t)store->max_corners +
           align8(4 * (uint64_t)store->max_faces) +
           store->max_changes * sizeof(struct face_change) + store->max_bytes + INDEX_CODE_SLACK +
           8;
}

int vox_face_store_decode(const struct face_store *store, uint64_t index, void *room,
                          struct face_group *out)
{
    const struct face_group_info *info = &store->groups[index];
    uint8_t *at = room;
    uint64_t *indices[FACE_KIND_COUNT];
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++) {
        indices[kind] = (uint64_t *)(void *)at;
        at += info->has_kind[kind] ? 8 * (uint64_t)info->corner_count : 0;
    }
    uint32_t *sizes = (uint32_t *)(void *)at;
    at += info->triangles ? 0 : align8(4 * (uint64_t)info->face_count);
    struct face_change *changes = (struct face_change *)(void *)at;
    at += info->change_count * sizeof *changes;
    int status = vox_spill_read(&store->bytes, info->offset, info->bytes, at);
    if (status < 0)
        return status;
    memset(at + info->bytes, 0, INDEX_CODE_SLACK);
    const uint8_t *from = at;
    *out = (struct face_group){
        .first_face = info->first_face,
        .face_count = info->face_count,
        .corner_count = info->corner_count,
        .change_count = info->change_count,
        .first_material = info->first_material,
        .sizes = info->triangles ? NULL : sizes,
        .changes = changes,
    };
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
        if (info->has_kind[kind]) {
            from = info->triangles ? decode_triangles(from, info->corner_count, indices[kind])
                                   : vox_index_code_decode(from, info->corner_count, indices[kind]);
            out->indices[kind] = indices[kind];
        }
    if (!info->triangles)
        from = vox_index_code_decode_sizes(from, info->face_count, sizes);
    if (info->change_count > 0)
        memcpy(changes, from, info->change_count * sizeof *changes);
    return 0;
}

/* Faces as compact bytes: what goes in comes out, for any index, size and grouping. */
#include "libvoxel/read/face_store.h"
#include "libvoxel/read/index_delta_code.h"

#include <setjmp.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static uint64_t next(uint64_t *seed)
{
    *seed ^= *seed << 13;
    *seed ^= *seed >> 7;
    return *seed ^= *seed << 17;
}

/* Indices of all lengths, "none" and the extremes among them. */
static uint64_t random_index(uint64_t *seed)
{
    uint64_t kind = next(seed) % 10;
    if (kind == 0)
        return FMT_MESH_NONE;
    if (kind == 1)
        return FMT_MESH_NONE - 1 - next(seed) % 3;
    return next(seed) >> next(seed) % 64;
}

static void indices_of_64_bits_come_back(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 2000; seed++) {
        uint64_t indices[70], decoded[70], random = seed, count = seed % 70, end, largest = 0;
        uint8_t bytes[70 * 9];
        bool none, has_none = false;
        for (uint64_t i = 0; i < count; i++) {
            indices[i] = random_index(&random);
            has_none |= indices[i] == FMT_MESH_NONE;
            if (indices[i] != FMT_MESH_NONE && indices[i] + 1 > largest)
                largest = indices[i] + 1;
        }
        assert_true(vox_index_code_bound(count) <= sizeof bytes + 8);
        memset(bytes, 0xaa, sizeof bytes);
        uint8_t *written = vox_index_code_encode(indices, count, bytes, &end, &none);
        assert_true((uint64_t)(written - bytes) + INDEX_CODE_SLACK <= vox_index_code_bound(count));
        assert_true(vox_index_code_decode(bytes, count, decoded) == written);
        assert_memory_equal(indices, decoded, count * sizeof *indices);
        assert_int_equal(none, has_none);
        assert_true(end == largest);
    }
}

static void neighbouring_indices_take_a_byte_and_a_quarter(void **state)
{
    uint64_t indices[4000], end;
    uint8_t bytes[4000 * 9];
    bool none;
    (void)state;
    for (uint64_t i = 0; i < 4000; i++)
        indices[i] = 5000000000u + i + i % 7;
    uint8_t *written = vox_index_code_encode(indices, 4000, bytes, &end, &none);
    assert_int_equal(written - bytes, 1000 + 4000 + 7); /* the first has eight bytes */
}

/* ---- blocks ---- */

#define FACES 40000u

struct scan {
    uint32_t sizes[FACES];
    uint64_t corner_count;
    uint64_t *indices[FACE_KIND_COUNT];
    struct fmt_mesh_material_change changes[100];
};

static struct scan *make_scan(uint64_t seed, bool triangles)
{
    struct scan *s = calloc(1, sizeof *s);
    for (uint32_t f = 0; f < FACES; f++) {
        s->sizes[f] = triangles ? 3 : 3 + (uint32_t)(next(&seed) % 5);
        if (!triangles && f == 777)
            s->sizes[f] = FACE_GROUP_CORNERS + 5;
        s->corner_count += s->sizes[f];
    }
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++) {
        s->indices[kind] = malloc(s->corner_count * sizeof *s->indices[kind]);
        for (uint64_t c = 0; c < s->corner_count; c++)
            s->indices[kind][c] = kind ? random_index(&seed) : next(&seed) >> 20;
    }
    for (uint32_t i = 0; i < 100; i++)
        s->changes[i] = (struct fmt_mesh_material_change){(uint64_t)i * (FACES / 100), i % 7};
    return s;
}

static void free_scan(struct scan *s)
{
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
        free(s->indices[kind]);
    free(s);
}

static void expect_group(const struct scan *s, const struct face_group *g, uint64_t *face,
                         uint64_t *corner)
{
    uint32_t change = 0, material = g->first_material, c = 0;
    assert_int_equal(g->first_face, *face);
    for (uint32_t f = 0; f < g->face_count; f++, ++*face) {
        uint32_t size = g->sizes ? g->sizes[f] : 3;
        while (change < g->change_count && g->changes[change].face <= f)
            material = g->changes[change++].material;
        assert_int_equal(size, s->sizes[*face]);
        assert_int_equal(material, *face / (FACES / 100) % 7);
        for (uint32_t k = 0; k < size; k++, c++, ++*corner)
            for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
                assert_true(g->indices[kind][c] == s->indices[kind][*corner]);
    }
    assert_int_equal(c, g->corner_count);
}

static void blocks_come_back_in_groups(void **state)
{
    (void)state;
    for (int variant = 0; variant < 4; variant++) {
        struct bsq_ctx_options options = {.memory_bytes = 64 << 20, .threads = 1};
        struct bsq_ctx *ctx;
        struct face_store store;
        struct scan *s = make_scan(5 + (uint64_t)variant, variant % 2 == 0);
        assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
        vox_face_store_init(&store, ctx, "/tmp/none");
        struct fmt_mesh_block block = {
            .face_count = FACES,
            .face_sizes = s->sizes,
            .corner_count = s->corner_count,
            .corner_vertices = s->indices[FACE_VERTEX],
            .corner_texcoords = s->indices[FACE_TEXCOORD],
            .corner_normals = s->indices[FACE_NORMAL],
            .material_change_count = 100,
            .material_changes = s->changes,
            .material_at_start = FMT_MESH_NO_MATERIAL,
        };
        uint64_t cost = vox_face_store_append_cost(&store, &block);
        assert_int_equal(vox_face_store_append(&store, &block), 0);
        assert_true(vox_spill_memory(&store.bytes) <= cost);
        if (variant >= 2)
            assert_int_equal(vox_spill_spill(&store.bytes), 0);
        assert_int_equal(vox_face_store_finish(&store), 0);
        assert_int_equal(store.face_count, FACES);
        assert_int_equal(store.corner_count, s->corner_count);
        void *room;
        uint64_t face = 0, corner = 0;
        assert_int_equal(bsq_alloc(ctx, "test", vox_face_store_decode_bytes(&store), 1, &room), 0);
        for (uint64_t g = 0; g < store.group_count; g++) {
            struct face_group group;
            assert_int_equal(vox_face_store_decode(&store, g, room, &group), 0);
            assert_true(group.corner_count <= FACE_GROUP_CORNERS || group.face_count == 1);
            assert_true(group.face_count <= FACE_GROUP_FACES);
            expect_group(s, &group, &face, &corner);
        }
        assert_int_equal(face, FACES);
        bsq_free(ctx, room);
        vox_face_store_free(&store);
        assert_int_equal(bsq_memory_used(ctx), 0);
        bsq_ctx_destroy(ctx);
        free_scan(s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(indices_of_64_bits_come_back),
        cmocka_unit_test(neighbouring_indices_take_a_byte_and_a_quarter),
        cmocka_unit_test(blocks_come_back_in_groups),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests that every triangle lies in one box of its chunk, and that no box reaches across many
 * regions without need. Grids of scattered scans are made as fast as those of compact ones, with
 * the same bytes. */
#include "libvoxel/voxelize/plan/plan.h"
#include "tests/unit/libvoxel/voxelize/voxelize_fixture.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct vox_fixture, vox_set_up, vox_tear_down)

/* Makes clusters of small triangles anywhere in a cube of `size`. Each cluster has one triangle
 * more than the one before. */
static struct scan_mesh make_clusters(uint32_t clusters, double size, uint64_t seed)
{
    uint32_t count = clusters * (clusters + 1) / 2, t = 0;
    print_message("seed %llu\n", (unsigned long long)seed);
    struct scan_mesh mesh = scan_mesh_new(3 * count, count);
    for (uint32_t c = 0; c < clusters; c++) {
        double at[3];
        for (int a = 0; a < 3; a++)
            at[a] = size * scan_random(&seed);
        for (uint32_t i = 0; i <= c; i++, t++)
            for (uint32_t v = 3 * t; v < 3 * t + 3; v++) {
                for (int a = 0; a < 3; a++)
                    mesh.positions[v][a] = (float)(at[a] + scan_random(&seed));
                mesh.triangles[t][v % 3] = v;
            }
    }
    scan_sort(&mesh);
    return mesh;
}

static double regions_of(const struct vox_box *box)
{
    double regions = 1.0;
    for (int a = 0; a < 3; a++)
        regions *= (box->hi[a] >> VOX_REGION_LOG2) - (box->lo[a] >> VOX_REGION_LOG2) + 1;
    return regions;
}

static bool contains(const struct vox_box *outer, const struct vox_box *inner)
{
    for (int a = 0; a < 3; a++)
        if (inner->lo[a] < outer->lo[a] || inner->hi[a] > outer->hi[a])
            return false;
    return true;
}

/* Returns the voxels of a triangle's bounds. */
static struct vox_box triangle_box(const struct vox_transform *transform,
                                   const struct fmt_tris_chunk *chunk, uint32_t t)
{
    float min[3], max[3];
    for (int a = 0; a < 3; a++) {
        min[a] = max[a] = chunk->positions[chunk->triangles[t][0]][a];
        for (int k = 1; k < 3; k++) {
            float p = chunk->positions[chunk->triangles[t][k]][a];
            min[a] = p < min[a] ? p : min[a];
            max[a] = p > max[a] ? p : max[a];
        }
    }
    return vox_transform_box(transform, min, max);
}

struct made {
    struct fmt_tris_file *file;
    struct vox_transform transform;
    struct vox_box *bounds;
    struct vox_chunk_box *boxes;
    uint64_t count;
};

static void make_boxes(const struct vox_fixture *f, double voxel_size, uint64_t bytes,
                       struct made *made)
{
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &made->file), 0);
    const struct fmt_tris_header *header = fmt_tris_get_header(made->file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(made->file);
    assert_int_equal(
        vox_transform_init(f->ctx, header, "scan.tris", 0, voxel_size, &made->transform), 0);
    made->bounds = calloc(header->chunk_count, sizeof *made->bounds);
    for (uint64_t i = 0; i < header->chunk_count; i++)
        made->bounds[i] =
            vox_transform_box(&made->transform, infos[i].bounds_min, infos[i].bounds_max);
    assert_int_equal(vox_chunk_boxes_create(f->ctx, made->file, &made->transform, bytes,
                                            &made->boxes, &made->count),
                     0);
}

static void free_boxes(const struct vox_fixture *f, struct made *made)
{
    bsq_free(f->ctx, made->boxes);
    fmt_tris_close(made->file);
    free(made->bounds);
}

/* Checks, chunk by chunk, that each triangle lies in one of the chunk's boxes. */
static void check_cover(const struct made *made)
{
    void *scratch = malloc(fmt_tris_load_size_max(made->file));
    uint64_t first = 0;
    for (uint64_t i = 0; i < fmt_tris_get_header(made->file)->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        uint64_t end = first;
        assert_int_equal(fmt_tris_load(made->file, i, scratch, &chunk), 0);
        for (; end < made->count && made->boxes[end].chunk == i; end++)
            assert_true(contains(&made->bounds[i], &made->boxes[end].box));
        for (uint32_t t = 0; t < chunk.triangle_count; t++) {
            struct vox_box box = triangle_box(&made->transform, &chunk, t);
            bool found = false;
            for (uint64_t p = first; p < end && !found; p++)
                found = contains(&made->boxes[p].box, &box);
            assert_true(found);
        }
        first = end;
    }
    assert_int_equal(first, made->count);
    free(scratch);
}

FIXTURE_TEST(test_boxes_hold_every_triangle)
{
    struct scan_mesh mesh = make_clusters(60, 1e5, 31);
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 700);
    /* A triangle of size 1 is less than 3 regions wide with voxels of 1/256. */
    static const double sizes[] = {1e6, 1000.0, 1.0, 1.0 / 256};
    for (int i = 0; i < 4; i++) {
        struct made made;
        make_boxes(f, sizes[i], UINT64_C(1) << 20, &made);
        check_cover(&made);
        for (uint64_t p = 0; p < made.count; p++)
            assert_true(regions_of(&made.boxes[p].box) <= 64.0);
        if (i == 0)
            assert_int_equal(made.count, fmt_tris_get_header(made.file)->chunk_count);
        free_boxes(f, &made);
    }
    scan_mesh_free(&mesh);
}

FIXTURE_TEST(test_little_memory_makes_larger_boxes)
{
    struct scan_mesh mesh = make_clusters(60, 1e5, 32);
    scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, 700);
    struct made made;
    for (uint64_t bytes = 0; bytes <= 2000; bytes += 500) {
        make_boxes(f, 1.0, bytes, &made);
        check_cover(&made);
        /* What was begun is still covered: one box for each halving of a chunk. */
        uint64_t chunks = fmt_tris_get_header(made.file)->chunk_count;
        uint64_t most = bytes / (sizeof *made.boxes + vox_schedule_entry_bytes());
        assert_true(made.count <= (chunks > most ? chunks : most) + 10);
        if (bytes == 0)
            assert_int_equal(made.count, chunks);
        free_boxes(f, &made);
    }
    scan_mesh_free(&mesh);
}

/* A billion regions lie between these triangles. As chunks of their own they never reached across
 * them. */
FIXTURE_TEST(test_scattered_triangles_of_one_chunk)
{
    struct scan_mesh mesh = make_clusters(8, 1.3e5, 33);
    uint64_t voxels[2];
    for (uint32_t i = 0; i < 2; i++) {
        struct vox_voxelize_options options = {.size = sizeof(struct vox_voxelize_options),
                                               .tris_path = "scan.tris",
                                               .grid_path = i ? "other.nvdb" : "scan.nvdb",
                                               .voxel_size = 1.0,
                                               .scan_normals = BSQ_SCAN_NORMALS_FLAT};
        struct vox_voxelize_report report = {.size = sizeof report};
        scan_write(f->ctx, "scan.tris", &mesh, NULL, NULL, 0, i ? 1 : mesh.triangle_count);
        assert_int_equal(vox_voxelize(f->ctx, &options, &report), 0);
        voxels[i] = report.voxels;
    }
    assert_int_equal(voxels[0], voxels[1]);
    assert_true(voxels[0] >= 8);
    expect_same_bytes("scan.nvdb", "other.nvdb");
    scan_mesh_free(&mesh);
}

RUN_TESTS(NULL, NULL)

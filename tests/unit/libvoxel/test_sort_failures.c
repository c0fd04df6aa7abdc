/* Tests scans that cannot be sorted, and sorting that fails midway: the error says why, and no file
 * or memory is left. */
#include "sort_grid.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct sort_fixture, sort_set_up, sort_tear_down)

/* ---- bad input ---- */

FIXTURE_TEST(positions_beyond_float_are_refused)
{
    assert_int_equal(sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1e200 0\nf 1 2 3\n"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "1e+200"));
}

/* A scan with only degenerate triangles is refused. */
FIXTURE_TEST(a_scan_without_area_is_refused)
{
    assert_int_equal(sort_text(f, "v 1 2 3\nf 1 1 1\n"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "the scan's only triangle has no area"));
    assert_int_equal(sort_text(f, "v 1 2 3\nf 1 1 1\nf 1 1 1\n"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "none of the scan's 2 triangles has an area"));
    assert_int_not_equal(access("scan.tris", F_OK), 0);
}

FIXTURE_TEST(a_missing_texture_for_all_is_refused)
{
    struct vox_sort_options options = sort_scan_obj();
    options.texture_path = "/nowhere/at all.png";
    test_text("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n");
    assert_int_equal(vox_sort(f->ctx, &options, &f->report), BSQ_ENOINPUT);
    assert_non_null(strstr(bsq_error(f->ctx), options.texture_path));
}

FIXTURE_TEST(too_little_memory_is_refused)
{
    sort_open_context(f, vox_memory_min(2) - 1, 2);
    assert_int_equal(sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), BSQ_ENOMEM);
}

/* Positions are in a file, and there is no memory for one byte a vertex. The message names a budget
 * that is enough. */
FIXTURE_TEST(too_many_vertices_are_refused)
{
    struct vox_sort_options options = sort_scan_obj();
    struct sort_limits limits;
    struct sort_grid g;
    unsigned long long vertices, needed, available;
    sort_grid_make(&g, 600, 5);
    sort_grid_write(&g, "scan.obj", 0, 6);
    vox_sort_limits_for(60 * MIB, 2, &limits);
    limits.stream_bytes = 0;
    limits.reserve_bytes = 34 * MIB;
    for (int passes = 0; passes < 2; passes++) {
        limits.two_passes = passes;
        sort_open_context(f, 60 * MIB, 2);
        assert_int_equal(vox_sort_with_limits(f->ctx, &options, &limits, &f->report), BSQ_ENOMEM);
        const char *message = strstr(bsq_error(f->ctx), ": sorting ");
        assert_non_null(message);
        assert_int_equal(
            sscanf(message,
                   ": sorting %llu vertices needs about %llu MiB of memory, it may use %llu",
                   &vertices, &needed, &available),
            3);
        assert_int_equal(vertices, 601 * 601);
        assert_int_equal(available, 60);
        sort_open_context(f, needed * MIB, 2);
        expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
    }
    sort_grid_free(&g);
}

/* Lets each allocation fail in turn: this is an error, and nothing is left. */
FIXTURE_TEST(memory_may_run_out_anywhere)
{
    struct sort_grid g;
    struct vox_sort_options options = sort_scan_obj();
    unsigned failures = 0;
    sort_grid_make(&g, 60, 5);
    sort_grid_write(&g, "scan.obj", GRID_COLORS | GRID_NORMALS, 6);
    for (unsigned spilled = 0; spilled < 3; spilled++)
        for (uint64_t memory = 1000; memory < 80 * MIB; memory += memory / 5) {
            struct sort_limits limits;
            vox_sort_limits_for(128 * MIB, 2, &limits);
            if (spilled)
                limits.stream_bytes = limits.page_memory = limits.max_page_memory = 0;
            limits.two_passes = spilled > 1;
            sort_open_context(f, memory, 2);
            int status = vox_sort_with_limits(f->ctx, &options, &limits, &f->report);
            failures += status < 0;
            assert_true(status == 0 || status == BSQ_ENOMEM);
            assert_int_equal(bsq_memory_used(f->ctx), 0);
            assert_int_equal(access("scan.tris", F_OK) == 0, status == 0);
            unlink("scan.tris");
        }
    assert_true(failures > 60);
    sort_grid_free(&g);
}

FIXTURE_TEST(a_scan_of_no_file_is_refused)
{
    assert_int_equal(sort_files(f, NULL, 0), BSQ_EUSAGE);
    assert_string_equal(bsq_error(f->ctx), "no mesh file is given");
}

RUN_TESTS(NULL, NULL)

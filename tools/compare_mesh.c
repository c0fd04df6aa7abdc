/* compare_mesh.c - see compare_mesh.h. */
#include "tools/compare_mesh.h"

#include "base/job_files.h"
#include "formats/file_kind.h"

int compare_mesh_recognise(struct cli *cli, const struct compare_mesh *files, bool *is)
{
    int status = 0;
    *is = false;
    for (uint32_t i = 1; i < files->count; i++) {
        enum fmt_kind kind = FMT_KIND_MESH;
        BSQ_TRY(fmt_recognise(cli->ctx, files->inputs[i], &kind));
        if (kind != FMT_KIND_TRIS)
            return 0;
    }
    *is = true;
done:
    return status;
}

int compare_mesh_measure(struct cli *cli, struct compare_mesh *files)
{
    struct vox_temp_tris *mesh = NULL;
    struct vox_sort_options options;
    struct vox_sort_report report = {.size = sizeof report};
    int status = 0;
    for (uint32_t i = 0; i < files->count; i++)
        BSQ_TRY(bsq_note_input(cli->ctx, files->inputs[i], i == 0 ? "the mesh" : "the scan"));
    BSQ_TRY(vox_temp_tris_create(cli->ctx, &mesh));
    vox_sort_defaults(&options);
    options.scan_paths = files->inputs;
    options.scan_count = 1;
    options.tris_path = files->inputs[0];
    options.temp_tris = mesh;
    BSQ_TRY(vox_sort(cli->ctx, &options, &report));
    status = vox_measure_mesh(cli->ctx, files->inputs + 1, files->count - 1, mesh,
                              &files->from_scan, &files->from_mesh);
done:
    vox_temp_tris_close(mesh);
    return status;
}

int compare_mesh_print(struct cli *cli, const struct compare_mesh *files, int failures)
{
    if (cli->json)
        return cli_print_json(cli, json_pack("{s:o, s:o, s:o, s:o, s:b}", "mesh_path",
                                             cli_json_text(files->inputs[0]), "scan_path",
                                             cli_json_text(files->inputs[1]), "from_scan",
                                             cli_distances_json(&files->from_scan), "to_scan",
                                             cli_distances_json(&files->from_mesh), "within_limits",
                                             failures == 0));
    cli_print("%s against the scan %s\n", files->inputs[0], files->inputs[1]);
    cli_print_distances("from the scan", &files->from_scan);
    cli_print_distances("to the scan", &files->from_mesh);
    return 0;
}

/* bake_inputs.c - which files of the command line are scans, and which are low-poly meshes. */
#include <stdlib.h>
#include <string.h>

#include "formats/file_kind.h"
#include "tools/bake_arguments.h"

int bake_arguments_map_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    const struct cli_table table = bake_arguments_table(arguments);
    int status = 0;
    for (int i = 0; i < arguments->file_count && !cli->verify; i++) {
        const char *path = arguments->files[i];
        BSQ_TRY(cli_map_input(cli, &path));
        arguments->files[i] = (char *)(uintptr_t)path;
    }
    BSQ_TRY(cli_map_inputs(cli, &table));
    for (uint32_t i = 0; i < arguments->transfers.count; i++)
        BSQ_TRY(cli_map_input(cli, &arguments->transfers.maps[i].texture_path));
    status = cli_map_input(cli, &arguments->farm.plan);
done:
    return status;
}

/* Writes the inputs that are scans, or those that are not, to `out`. Returns their number, or a
 * negative status. */
static int take_inputs(struct cli *cli, const struct bake_arguments *arguments, bool scans,
                       const char **out)
{
    int count = 0;
    for (int i = 0; i < arguments->file_count; i++) {
        enum fmt_kind kind;
        int status = fmt_recognise(cli->ctx, arguments->files[i], &kind);
        if (status < 0)
            return status;
        if ((kind == FMT_KIND_TRIS || kind == FMT_KIND_NVDB) == scans)
            out[count++] = arguments->files[i];
    }
    return count;
}

/* Points the options at sorted inputs. Without scans, the command of a bake lists its tiles. */
static int use_inputs(struct cli *cli, struct bake_arguments *arguments, int scans, int meshes)
{
    struct bake_options *bake = &arguments->bake;
    if (arguments->list_tiles && meshes == 0)
        return cli_usage(cli, "--list tiles takes files: LOW.obj...");
    if (!arguments->list_tiles && (scans == 0 || meshes == 0))
        return cli_usage(cli, "%d scan%s (.nvdb, .tris) and %d low-poly mesh%s given (see --help)",
                         scans, scans == 1 ? "" : "s", meshes, meshes == 1 ? "" : "es");
    if (scans > 0) {
        bake->scan_path = arguments->paths[0];
        bake->more_scan_paths = arguments->paths + 1;
        bake->more_scan_count = (uint32_t)scans - 1;
    }
    bake->mesh_path = arguments->paths[scans];
    bake->more_mesh_paths = arguments->paths + scans + 1;
    bake->more_mesh_count = (uint32_t)meshes - 1;
    return 0;
}

int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    const int count = arguments->file_count;
    arguments->paths = calloc((size_t)count + 1, sizeof *arguments->paths);
    if (!arguments->paths)
        return bsq_fail(cli->ctx, BSQ_ENOMEM, "out of memory");
    for (int i = 0; i < count; i++)
        if (strcmp(arguments->files[i], "-") == 0)
            return cli_usage(cli, "-: standard input is not read: scans and low-poly meshes must "
                                  "be files");
    if (count == 2 && !arguments->list_tiles) {
        arguments->paths[0] = arguments->files[0];
        arguments->paths[1] = arguments->files[1];
        return use_inputs(cli, arguments, 1, 1);
    }
    const int scans =
        arguments->list_tiles ? 0 : take_inputs(cli, arguments, true, arguments->paths);
    const int meshes =
        scans < 0 ? scans : take_inputs(cli, arguments, false, arguments->paths + scans);
    return meshes < 0 ? meshes : use_inputs(cli, arguments, scans, meshes);
}

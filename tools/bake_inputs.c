/* bake_inputs.c - tells scans from low-poly meshes among the inputs of bisque-bake. */
#include <stdlib.h>
#include <string.h>

#include "formats/file_kind.h"
#include "tools/bake_arguments.h"

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

/* Points the options at sorted inputs. */
static int use_inputs(struct cli *cli, struct bake_arguments *arguments, int scans, int meshes)
{
    struct bake_options *bake = &arguments->bake;
    if (scans == 0 || meshes == 0)
        return cli_usage(cli, "%d scan%s (.nvdb, .tris) and %d low-poly mesh%s given (see --help)",
                         scans, scans == 1 ? "" : "s", meshes, meshes == 1 ? "" : "es");
    bake->scan_path = arguments->paths[0];
    bake->more_scan_paths = arguments->paths + 1;
    bake->more_scan_count = (uint32_t)scans - 1;
    bake->mesh_path = arguments->paths[scans];
    bake->more_mesh_paths = arguments->paths + scans + 1;
    bake->more_mesh_count = (uint32_t)meshes - 1;
    return 0;
}

/* Points the options at the meshes, without scans, so that the command of a bake lists its tiles.
 */
static int use_meshes_alone(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int meshes = take_inputs(cli, arguments, false, arguments->paths);
    if (meshes <= 0)
        return meshes < 0 ? meshes : cli_usage(cli, "--list-tiles takes files: LOW.obj...");
    bake->mesh_path = arguments->paths[0];
    bake->more_mesh_paths = arguments->paths + 1;
    bake->more_mesh_count = (uint32_t)meshes - 1;
    return 0;
}

int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int count = arguments->file_count;
    arguments->paths = calloc((size_t)count + 1, sizeof *arguments->paths);
    if (!arguments->paths)
        return bsq_fail(cli->ctx, BSQ_ENOMEM, "out of memory");
    for (int i = 0; i < count; i++)
        if (strcmp(arguments->files[i], "-") == 0)
            return cli_usage(cli, "-: standard input is not read: scans and low-poly meshes must "
                                  "be files");
    if (arguments->list_tiles)
        return use_meshes_alone(cli, arguments);
    if (count == 2) {
        bake->scan_path = arguments->paths[0] = arguments->files[0];
        bake->mesh_path = arguments->paths[1] = arguments->files[1];
        return 0;
    }
    const int scans = take_inputs(cli, arguments, true, arguments->paths);
    const int meshes =
        scans < 0 ? scans : take_inputs(cli, arguments, false, arguments->paths + scans);
    return meshes < 0 ? meshes : use_inputs(cli, arguments, scans, meshes);
}

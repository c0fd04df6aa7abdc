/* bake_inputs.c - tells scans from low-poly meshes among the inputs of bisque-bake. */
#include <stdlib.h>

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

int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments)
{
    struct bake_options *bake = &arguments->bake;
    const int count = arguments->file_count;
    arguments->paths = calloc((size_t)count + 1, sizeof *arguments->paths);
    if (!arguments->paths)
        return bsq_fail(cli->ctx, BSQ_ENOMEM, "out of memory");
    if (arguments->list_tiles || count == 2) {
        const int scans = arguments->list_tiles ? 0 : 1;
        for (int i = 0; i < count; i++)
            arguments->paths[i] = arguments->files[i];
        bake->scan_path = arguments->paths[0];
        bake->mesh_path = arguments->paths[scans];
        bake->more_mesh_paths = arguments->paths + scans + 1;
        bake->more_mesh_count = (uint32_t)(count - scans - 1);
        return 0;
    }
    const int scans = take_inputs(cli, arguments, true, arguments->paths);
    const int meshes =
        scans < 0 ? scans : take_inputs(cli, arguments, false, arguments->paths + scans);
    return meshes < 0 ? meshes : use_inputs(cli, arguments, scans, meshes);
}

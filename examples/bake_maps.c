/* bake_maps.c - bakes the default maps of a scan, a grid or a chunk file, for a low-poly mesh.
 *
 *   bake_maps SCAN LOWPOLY.obj OUTPUT SIZE      with <MAP> in OUTPUT, as in 'statue_<MAP>.exr' */
#include <libbake/bake.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv)
{
    if (argc != 5) {
        fprintf(stderr, "usage: bake_maps SCAN LOWPOLY.obj OUTPUT SIZE\n");
        return -BSQ_EUSAGE;
    }
    struct bake_options options;
    bake_defaults(&options);
    options.scan_path = argv[1];
    options.mesh_path = argv[2];
    options.output_path = argv[3];
    options.width = options.height = (uint32_t)strtoul(argv[4], NULL, 10);
    options.device = "cpu";

    struct bake_report report = {.size = sizeof report};
    struct bsq_ctx *ctx;
    int status = bsq_ctx_create(NULL, &ctx);
    if (status < 0)
        return -status;
    status = bake_run(ctx, &options, &report);
    if (status == 0)
        printf("%s on %s\n", report.hits > 0 ? "hits" : "no hits", report.device);
    else
        fprintf(stderr, "%s\n", bsq_error(ctx));
    bake_report_free(&report);
    bsq_ctx_destroy(ctx);
    return -status;
}

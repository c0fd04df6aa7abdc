/* compare_maps.c - prints how far apart two maps are.
 *
 *   compare_maps MAP.exr REFERENCE.exr */
#include <libbake/compare.h>
#include <stdio.h>

int main(int argc, char **argv)
{
    if (argc != 3) {
        fprintf(stderr, "usage: compare_maps MAP.exr REFERENCE.exr\n");
        return -BSQ_EUSAGE;
    }
    struct bake_compare_options options;
    struct bake_compare_report report = {.size = sizeof report};
    struct bsq_ctx *ctx;
    int status = bsq_ctx_create(NULL, &ctx);
    if (status < 0)
        return -status;
    bake_compare_defaults(&options);
    options.a_path = argv[1];
    options.b_path = argv[2];
    status = bake_compare(ctx, &options, &report);
    if (status == 0)
        printf("mean %g, max %g %s\n", report.mean, report.max, bake_compare_unit(report.kind));
    else
        fprintf(stderr, "%s\n", bsq_error(ctx));
    bsq_ctx_destroy(ctx);
    return -status;
}

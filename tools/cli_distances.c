/* cli_distances.c - distances between a mesh and its scan, as lines and as JSON. */
#include "tools/cli.h"

void cli_print_distances(const char *what, const struct vox_distances *d)
{
    cli_print("  %s: mean %.4g, rms %.4g, p99 %.4g, max %.4g at %.6g,%.6g,%.6g\n", what, d->mean,
              d->rms, d->p99, d->max, d->where[0], d->where[1], d->where[2]);
}

json_t *cli_distances_json(const struct vox_distances *d)
{
    return json_pack("{s:f, s:f, s:f, s:f, s:[f, f, f]}", "mean", d->mean, "rms", d->rms, "p99",
                     d->p99, "max", d->max, "where", d->where[0], d->where[1], d->where[2]);
}

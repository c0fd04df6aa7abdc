/* transform.c - scales, turns and shifts meshes, as options ask for. */
#include "libbake/lowpoly/lowpoly_internal.h"

#include <stdio.h>
#include <string.h>

/* Reads a word of BAKE_TURNS, or what follows its '/'. Row r of the matrix gives axis r. */
void bake_turn_matrix(unsigned turn, double out[3][3])
{
    const char *at = BAKE_TURNS;
    for (; turn > 0; turn--)
        at = strchr(at, ' ') + 1;
    const size_t length = strcspn(at, " "), other = strcspn(at, " /");
    const char *axes = other < length ? at + other + 1 : strncmp(at, "none", 4) == 0 ? "xyz" : at;
    memset(out, 0, 3 * sizeof *out);
    for (int r = 0; r < 3; r++, axes++) {
        const bool negative = *axes == '-';
        axes += negative;
        out[r][*axes - 'x'] = negative ? -1 : 1;
    }
}

void bake_turn_word(const double turn[3][3], char out[8])
{
    char *to = out;
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++)
            if (turn[r][c] != 0)
                to += sprintf(to, "%s%c", turn[r][c] < 0 ? "-" : "", 'x' + c);
    const char *name = strcmp(out, "x-zy") == 0   ? "z-up"
                       : strcmp(out, "xz-y") == 0 ? "y-up"
                       : strcmp(out, "xyz") == 0  ? "none"
                                                  : NULL;
    if (name)
        strcpy(out, name);
}

void bake_transform_of(const struct bake_options *options, struct bake_transform *out)
{
    *out = (struct bake_transform){.scale = options->low_scale,
                                   .shift = {options->low_x, options->low_y, options->low_z}};
    bake_turn_matrix(options->low_turn, out->turn);
}

void bake_transform_point(const struct bake_transform *transform, const double p[3], double out[3])
{
    double turned[3];
    for (int r = 0; r < 3; r++)
        turned[r] = transform->turn[r][0] * p[0] + transform->turn[r][1] * p[1] +
                    transform->turn[r][2] * p[2];
    for (int r = 0; r < 3; r++)
        out[r] = transform->scale * turned[r] + transform->shift[r];
}

void bake_transform_join(const struct bake_transform *first, const struct bake_transform *then,
                         struct bake_transform *out)
{
    out->scale = then->scale * first->scale;
    bake_transform_point(then, first->shift, out->shift);
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++)
            out->turn[r][c] = then->turn[r][0] * first->turn[0][c] +
                              then->turn[r][1] * first->turn[1][c] +
                              then->turn[r][2] * first->turn[2][c];
}

void bake_transform_mesh(const struct bake_options *options, struct fmt_mesh *mesh)
{
    struct bake_transform transform;
    bake_transform_of(options, &transform);
    struct bake_transform turn = transform;
    turn.scale = 1;
    memset(turn.shift, 0, sizeof turn.shift);
    for (uint64_t v = 0; v < mesh->vertex_count; v++)
        bake_transform_point(&transform, mesh->positions[v], mesh->positions[v]);
    for (uint64_t n = 0; n < mesh->normal_count; n++) {
        double normal[3];
        for (int k = 0; k < 3; k++)
            normal[k] = (double)mesh->normals[n][k];
        bake_transform_point(&turn, normal, normal);
        for (int k = 0; k < 3; k++)
            mesh->normals[n][k] = (float)normal[k];
    }
}

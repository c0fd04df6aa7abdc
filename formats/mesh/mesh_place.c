/* mesh_place.c - scales, turns and shifts the meshes of a scan while they are read.
 *
 * This runs in the reader's serial step, in double precision, before anybody chooses an origin for
 * 32-bit positions. */
#include <math.h>
#include <string.h>

#include "formats/mesh/mesh_format.h"

struct placed {
    const struct fmt_mesh_reader *reader;
    const struct fmt_mesh_steps *steps;
    void *arg;
};

static bool moves(const struct fmt_mesh_placement *p)
{
    return p->scale != 1.0 || p->up != FMT_MESH_UP_KEEP || p->translate[0] != 0.0 ||
           p->translate[1] != 0.0 || p->translate[2] != 0.0;
}

int fmt_mesh_keep_placements(struct fmt_mesh_reader *reader,
                             const struct fmt_mesh_placement *placements)
{
    bool any = false;
    for (uint32_t i = 0; i < reader->input_count; i++) {
        any |= moves(&placements[i]);
        if (!(placements[i].scale > 0.0) || !isfinite(placements[i].scale))
            return bsq_fail(reader->ctx, BSQ_EUSAGE, "%s: a scale of %g",
                            fmt_input_path(reader->inputs[i]), placements[i].scale);
    }
    if (!any)
        return 0;
    int status = bsq_alloc(reader->ctx, "inputs", reader->input_count, sizeof *placements,
                           &reader->placements);
    if (status == 0)
        memcpy(reader->placements, placements, reader->input_count * sizeof *placements);
    return status;
}

static void place_positions(const struct fmt_mesh_placement *p, double (*positions)[3],
                            uint64_t count)
{
    for (uint64_t v = 0; v < count; v++) {
        const double x = positions[v][0] * p->scale, y = positions[v][1] * p->scale,
                     z = positions[v][2] * p->scale;
        const double turned[3][2] = {{y, z}, {z, -y}, {-z, y}}; /* by p->up */
        positions[v][0] = x + p->translate[0];
        positions[v][1] = turned[p->up][0] + p->translate[1];
        positions[v][2] = turned[p->up][1] + p->translate[2];
    }
}

static void turn_normals(const struct fmt_mesh_placement *p, float (*normals)[3], uint64_t count)
{
    for (uint64_t i = 0; p->up != FMT_MESH_UP_KEEP && i < count; i++) {
        const float y = normals[i][1], z = normals[i][2];
        normals[i][1] = p->up == FMT_MESH_UP_Y ? z : -z;
        normals[i][2] = p->up == FMT_MESH_UP_Y ? -y : y;
    }
}

static int on_block(void *arg, const struct fmt_mesh_block *block)
{
    const struct placed *placed = arg;
    const struct fmt_mesh_placement *p = &placed->reader->placements[block->file];
    place_positions(p, (double(*)[3])block->positions, block->vertex_count);
    turn_normals(p, (float(*)[3])block->normals, block->normal_count);
    return placed->steps->on_block ? placed->steps->on_block(placed->arg, block) : 0;
}

static int follow(void *arg, const struct fmt_mesh_block *block, unsigned slot)
{
    const struct placed *placed = arg;
    return placed->steps->follow(placed->arg, block, slot);
}

static int finish(void *arg, const struct fmt_mesh_block *block, unsigned slot)
{
    const struct placed *placed = arg;
    return placed->steps->finish(placed->arg, block, slot);
}

int fmt_mesh_read_placed(struct fmt_mesh_reader *reader, const struct fmt_mesh_steps *steps,
                         void *arg, struct fmt_mesh_totals *totals)
{
    struct placed placed = {.reader = reader, .steps = steps, .arg = arg};
    const struct fmt_mesh_steps own = {.on_block = on_block,
                                       .follow = steps->follow ? follow : NULL,
                                       .finish = steps->follow ? finish : NULL};
    return reader->format->read(reader, &own, &placed, totals);
}

/* farm_divide.c - divides the regions of a grid among tasks. */

#include "base/sort_array.h"
#include "base/space_curve.h"
#include "libvoxel/farm/farm.h"
#include "libvoxel/voxelize/plan/plan.h"

uint64_t vox_farm_place(const struct vox_farm_plan *plan, const int32_t origin[3])
{
    uint32_t cell[3];
    for (int a = 0; a < 3; a++)
        cell[a] =
            (uint32_t)((origin[a] >> VOX_REGION_LOG2) - plan->first_region[a]) >> plan->curve_shift;
    return bsq_hilbert_place(cell, plan->curve_bits);
}

uint32_t vox_farm_task_of(const struct vox_farm_plan *plan, const int32_t origin[3])
{
    const uint64_t place = vox_farm_place(plan, origin);
    uint32_t low = 0, high = plan->base.task_count;
    while (high - low > 1) { /* cuts[low] <= place, and place < cuts[high] */
        const uint32_t middle = low + (high - low) / 2;
        if (plan->cuts[middle] <= place)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static int compare_places(const void *a, const void *b)
{
    const struct vox_farm_region *x = a, *y = b;
    if (x->place != y->place)
        return x->place < y->place ? -1 : 1;
    return (x->work > y->work) - (x->work < y->work); /* so that sums have one order */
}

/* Regions that share a place go to one task: the cells of the curve are never cut. */
void vox_farm_divide(struct vox_farm_plan *plan, struct vox_farm_region *regions, uint64_t count)
{
    const uint32_t tasks = plan->base.task_count;
    double all = 0.0, before = 0.0;
    uint32_t task = 0;
    bsq_sort(regions, count, sizeof *regions, compare_places);
    for (uint64_t i = 0; i < count; i++)
        all += regions[i].work;
    plan->cuts[0] = 0;
    for (uint64_t i = 0; i < count; i++) {
        const bool cell_begins = i > 0 && regions[i].place != regions[i - 1].place;
        const double wanted = (before + regions[i].work / 2) * tasks / all;
        while (cell_begins && task + 1 < tasks && wanted >= task + 1)
            plan->cuts[++task] = regions[i].place;
        plan->costs[task].regions++;
        plan->costs[task].work += regions[i].work;
        before += regions[i].work;
    }
    while (++task <= tasks)
        plan->cuts[task] = UINT64_MAX;
}

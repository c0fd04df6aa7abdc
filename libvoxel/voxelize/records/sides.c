/* sides.c - sums a voxel's fragments by classes of directions, and makes one or two records of
 * them.
 *
 * Which sums a voxel has, and what they hold, does not depend on the order of its fragments. So the
 * sides of a wall are found from the sums alone. Of all ways to divide the sums in two, the best
 * one makes the two normals longest: directions of one side add up, and those of two sides cancel.
 * If the two normals face away from each other, they are two sides; else all sums are one record.
 */
#include "libvoxel/voxelize/records/region.h"

#include <assert.h>
#include <math.h>

/* Two ways to divide are equally good if their lengths differ by a smaller share. Then the first
 * one wins, so that symmetric voxels do not depend on rounding. */
static const double equally_good = 1e-6;

uint32_t vox_accumulator_find(struct vox_accumulator *a, uint32_t first_link, uint32_t class_bits)
{
    const uint32_t first = first_link & VOX_LINK_NUMBER;
    if (a->others[first] == 0) {
        a->others[first] = first_link;
        a->shared[a->shared_count++] = first;
    }
    for (uint32_t number = first;;) {
        const uint32_t link = a->others[number];
        number = link & VOX_LINK_NUMBER;
        if ((link ^ class_bits) <= VOX_LINK_NUMBER)
            return number;
        if (number == first)
            break;
    }
    const uint32_t next = ++a->sum_count;
    a->others[next] = a->others[first];
    a->others[first] = next | class_bits;
    return next;
}

/* The sums of one voxel, in the order of their classes. */
struct voxel_sums {
    uint32_t count;
    uint32_t numbers[VOX_CLASSES];
    const double *normals[VOX_CLASSES];
};

/* Collects the sums of the voxel whose first sum this is, and unlinks them. */
static void sides_collect(struct vox_accumulator *a, uint32_t first, struct voxel_sums *voxel)
{
    uint32_t of_class[VOX_CLASSES] = {0}, number = first;
    do {
        const uint32_t link = a->others[number];
        a->others[number] = 0;
        number = link & VOX_LINK_NUMBER;
        of_class[link >> VOX_LINK_CLASS] = number;
    } while (number != first);
    voxel->count = 0;
    for (uint32_t c = 0; c < VOX_CLASSES; c++) {
        if (of_class[c] == 0)
            continue;
        voxel->numbers[voxel->count] = of_class[c];
        voxel->normals[voxel->count++] = a->sums[of_class[c]].normal;
    }
}

/* Returns whether no two of the sums are more than 90 degrees apart. */
static bool is_one_side(const struct voxel_sums *voxel)
{
    for (uint32_t i = 1; i < voxel->count; i++)
        for (uint32_t k = 0; k < i; k++)
            if (vox_dot(voxel->normals[i], voxel->normals[k]) < 0.0)
                return false;
    return true;
}

/* The sums of the normals of the two parts of a voxel. */
struct two_sides {
    double normal[2][3];
};

/* Moves a normal to part `to` from the other part. */
static void move_normal(struct two_sides *sides, const double normal[3], uint32_t to)
{
    for (int k = 0; k < 3; k++) {
        sides->normal[to][k] += normal[k];
        sides->normal[1 - to][k] -= normal[k];
    }
}

/* Sums the normals of both parts. Bit i of `part`: part of sum i. */
static void sum_sides(const struct voxel_sums *voxel, uint32_t sides_of_normals,
                      struct two_sides *sides)
{
    *sides = (struct two_sides){0};
    for (uint32_t i = 0; i < voxel->count; i++)
        for (int k = 0; k < 3; k++)
            sides->normal[sides_of_normals >> i & 1][k] += voxel->normals[i][k];
}

/* Returns the best way to divide the sums in two. The last sum is in part 0. Each way differs from
 * the one before it by one sum (Gray code). */
static uint32_t divide_best(const struct voxel_sums *voxel)
{
    struct two_sides sides;
    uint32_t best = 0;
    double longest = 0.0;
    assert(voxel->count > 0);
    sum_sides(voxel, 0, &sides);
    for (uint32_t i = 1; i < UINT32_C(1) << (voxel->count - 1); i++) {
        const uint32_t sides_of_normals = i ^ i >> 1, moved = (uint32_t)__builtin_ctz(i);
        move_normal(&sides, voxel->normals[moved], sides_of_normals >> moved & 1);
        const double length = sqrt(vox_dot(sides.normal[0], sides.normal[0])) +
                              sqrt(vox_dot(sides.normal[1], sides.normal[1]));
        if (length > longest * (1.0 + equally_good)) {
            longest = length;
            best = sides_of_normals;
        }
    }
    return best;
}

/* Returns whether the cosine between the two normals is below -1/4. It is for the two sides of a
 * wall or a blade, but not at the edge of a box. */
static bool face_away(const struct two_sides *sides)
{
    const double *one = sides->normal[0], *other = sides->normal[1];
    const double d = vox_dot(one, other);
    return d < 0.0 && d * d > 0.25 * 0.25 * vox_dot(one, one) * vox_dot(other, other);
}

/* Returns the sums of the second side, as bits; 0 if there is only one side. */
static uint32_t second_side(const struct voxel_sums *voxel)
{
    struct two_sides sides;
    if (is_one_side(voxel))
        return 0;
    const uint32_t sides_of_normals = divide_best(voxel);
    sum_sides(voxel, sides_of_normals, &sides);
    return face_away(&sides) ? sides_of_normals : 0;
}

/* Adds a sum to another one. */
static void take_in(struct vox_accumulator *a, uint32_t number, uint32_t from)
{
    struct vox_sum *sum = &a->sums[number];
    const struct vox_sum *more = &a->sums[from];
    for (int k = 0; k < 3; k++) {
        sum->normal[k] += more->normal[k];
        sum->center[k] += more->center[k];
    }
    sum->noise += more->noise;
    sum->area += more->area;
    if (a->colors) {
        for (int k = 0; k < 3; k++)
            a->colors[number].rgb[k] += a->colors[from].rgb[k];
        a->colors[number].area += a->colors[from].area;
    }
    if (a->votes)
        vox_vote(&a->votes[number], a->votes[from].id, a->votes[from].area);
    for (uint32_t i = 0; i < a->channel_words; i++)
        a->channels[(uint64_t)number * a->channel_words + i] +=
            a->channels[(uint64_t)from * a->channel_words + i];
    a->spare_count++;
}

/* Makes one record of two sums of one side, as most voxels with several sums have them. Returns
 * false if this is another voxel. */
static bool settle_pair(struct vox_accumulator *a, uint32_t first)
{
    const uint32_t other = a->others[first] & VOX_LINK_NUMBER;
    if ((a->others[other] & VOX_LINK_NUMBER) != first ||
        vox_dot(a->sums[first].normal, a->sums[other].normal) < 0.0)
        return false;
    a->others[first] = a->others[other] = 0;
    take_in(a, first, other);
    return true;
}

/* Makes the records of the voxel whose first sum this is: that sum, and one of the others. */
static void settle_voxel(struct vox_accumulator *a, uint32_t first)
{
    struct voxel_sums voxel;
    if (settle_pair(a, first))
        return;
    sides_collect(a, first, &voxel);
    uint32_t second_bits = second_side(&voxel), second = 0;
    for (uint32_t i = 0; i < voxel.count; i++)
        if (voxel.numbers[i] == first && (second_bits >> i & 1))
            second_bits = ~second_bits; /* the side with the first sum is first */
    for (uint32_t i = 0; i < voxel.count; i++) {
        const uint32_t number = voxel.numbers[i];
        if (number == first)
            continue;
        if (!(second_bits >> i & 1))
            take_in(a, first, number);
        else if (second == 0)
            second = number;
        else
            take_in(a, second, number);
    }
    a->others[first] = second;
    a->second_count += second != 0;
}

enum { PREFETCH_AHEAD = 16 };

void vox_accumulator_settle(struct vox_accumulator *a)
{
    for (uint32_t i = 0; i < a->shared_count; i++) {
        if (i + PREFETCH_AHEAD < a->shared_count) {
            const uint32_t first = a->shared[i + PREFETCH_AHEAD];
            __builtin_prefetch(&a->sums[first]);
            __builtin_prefetch(&a->sums[a->others[first] & VOX_LINK_NUMBER]);
        }
        settle_voxel(a, a->shared[i]);
    }
}

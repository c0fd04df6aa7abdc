/* scan_normals_check.c - compares a scan's normals with the planes of its triangles.
 *
 * Let an edge have the normals a and b at its ends. If curvature is constant, edge . (a + b) / 2 is
 * 0: the surface rises by the mean of its slopes. The values found instead on the three edges are
 * the coefficients of a Whitney form of degree 1 (Whitney, "Geometric Integration Theory", 1957).
 * As a vector in the triangle's plane, that form is the part of the normals that contradicts the
 * plane. Neither curvature nor the size of triangles counts as a contradiction.
 *
 * A record is a mean over its voxel, so contradictions are averaged over the area of a voxel's
 * face. Those that differ from triangle to triangle cancel there, such as rounding and noise. */
#include "libvoxel/voxelize/cache/scan_normals_check.h"

#include <math.h>

/* Square of the sine of half a degree, which is never too much: triangles as large as voxels err by
 * that even if their normals are right. */
#define INCONSISTENT_LEAST_SQUARE (0.0087 * 0.0087)
/* Share of the normals' mean squared turn over a voxel that may contradict. Planes pull the blended
 * normal by 1.3 times the contradiction. Without planes it errs by 0.83 times that square, in waves
 * with slopes of 20 degrees. At this share both errors are equal. */
#define INCONSISTENT_TURN_SHARE 0.64

/* Sums over triangles: area times contradiction, and area. */
struct contradiction {
    double vector[3], area;
};

/* Sums over edges. */
struct turn {
    double normals, lengths; /* squares of the differences of normals, and of points */
};

static void add_triangle(const struct vox_own_normals *of, const uint32_t v[3],
                         struct contradiction *sum, struct turn *turn)
{
    double edge[3][3], rise[3], across[3];
    for (int i = 0; i < 3; i++) {
        const double *p = of->points[v[i]], *q = of->points[v[(i + 1) % 3]];
        const float *a = of->normals[v[i]], *b = of->normals[v[(i + 1) % 3]];
        rise[i] = 0.0;
        for (int k = 0; k < 3; k++) {
            double change = (double)(b[k] - a[k]);
            edge[i][k] = q[k] - p[k];
            rise[i] += edge[i][k] * 0.5 * (double)(a[k] + b[k]);
            turn->normals += change * change;
            turn->lengths += edge[i][k] * edge[i][k];
        }
    }
    for (int k = 0; k < 3; k++) {
        int l = (k + 1) % 3, m = (k + 2) % 3;
        across[k] = edge[0][l] * edge[1][m] - edge[0][m] * edge[1][l];
        /* The form at the centroid, rotated by a right angle. */
        sum->vector[k] += ((rise[1] - rise[2]) * edge[0][k] + (rise[2] - rise[0]) * edge[1][k] +
                           (rise[0] - rise[1]) * edge[2][k]) /
                          6.0;
    }
    sum->area += 0.5 * sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2]);
}

/* Returns the area times the square of the mean contradiction. */
static double square_of(const struct contradiction *sum)
{
    const double *v = sum->vector;
    return sum->area > 0.0 ? (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / sum->area : 0.0;
}

bool vox_own_normals_inconsistent(const struct vox_own_normals *of, uint32_t begin, uint32_t end)
{
    struct contradiction sum = {.area = 0.0};
    struct turn turn = {.normals = 0.0};
    double squares = 0.0, area = 0.0;
    for (uint32_t t = begin; t < end; t++) {
        add_triangle(of, of->triangles[t], &sum, &turn);
        if (sum.area < 1.0 && t + 1 < end)
            continue;
        squares += square_of(&sum);
        area += sum.area;
        sum = (struct contradiction){.area = 0.0};
    }
    double limit = INCONSISTENT_TURN_SHARE * turn.normals / fmax(turn.lengths, 1e-300);
    return squares > area * fmax(limit * limit, INCONSISTENT_LEAST_SQUARE);
}

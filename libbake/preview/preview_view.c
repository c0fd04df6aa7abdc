/* preview_view.c - places the camera and the lights, and shades. */
#include "libbake/preview/preview_view.h"

static const double radian = 57.29577951308232; /* degrees */
static const double margin = 0.92;              /* share of the panel that the mesh fills */

/* Copies a vector that is meant for axis 1 up. With axis 2 up, the front looks to -y, as in
 * Blender.
 */
static void view_turn(const double v[3], int up, double out[3])
{
    out[0] = v[0];
    out[1] = up == 1 ? v[1] : -v[2];
    out[2] = up == 1 ? v[2] : v[1];
}

static void set_axes(double around, double elevation, int up_axis, struct preview_view *view)
{
    double sa = sin(around), ca = cos(around), se = sin(elevation), ce = cos(elevation);
    const double right[3] = {ca, 0, -sa}, up[3] = {-se * sa, ce, -se * ca},
                 toward[3] = {ce * sa, se, ce * ca};
    view_turn(right, up_axis, view->right);
    view_turn(up, up_axis, view->up);
    view_turn(toward, up_axis, view->toward);
}

/* ---- the vertical axis ---- */

/* Parts of the mesh's longest side: how far above the lower end a base may reach, and how thin a
 * relief is. */
static const double base_height = 0.02, relief_depth = 0.25;

/* Returns the area of the rectangle around what a mesh would stand on along an axis: its corners
 * up to `height` above its lower end. So legs count as far as they are apart, and the rim of a hole
 * as a plane does. */
static double find_footprint(const struct bake_lowmesh *mesh, int axis, double height)
{
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    const double limit = mesh->bounds_min[axis] + height;
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint64_t t = 0; t < mesh->triangle_count; ++t)
        for (int c = 0; c < 3; ++c) {
            const double *p = mesh->positions[t][c];
            for (int k = 0; p[axis] <= limit && k < 3; ++k) {
                low[k] = fmin(low[k], p[k]);
                high[k] = fmax(high[k], p[k]);
            }
        }
    return (high[u] - low[u]) * (high[v] - low[v]);
}

int bake_preview_up_axis(const struct bake_preview *preview)
{
    if (preview->options->preview_up != BAKE_UP_AUTO)
        return preview->options->preview_up == BAKE_UP_Z ? 2 : 1;
    const struct bake_lowmesh *mesh = preview->mesh;
    const double *low = mesh->bounds_min, *high = mesh->bounds_max;
    double longest = 0;
    for (int k = 0; k < 3; ++k)
        longest = fmax(longest, high[k] - low[k]);
    const double height = base_height * longest;
    const bool thin = high[2] - low[2] < relief_depth * longest;
    return !thin && find_footprint(mesh, 2, height) > find_footprint(mesh, 1, height) ? 2 : 1;
}

/* ---- the views ---- */

/* An open mesh faces one way on the whole: the sum of the areas that it shows to each side is more
 * than this part of all its area. Closed ones have 0. */
static const double open_share = 1.0 / 3;
/* Degrees: a three-quarter view of closed meshes, and how far views look down. */
static const double usual_from = 30, usual_above = 17, most_aside = 30;
/* Degrees around in which an open mesh is seen, and by which their middle is aside from its front,
 * so that the light from the left is on it. */
static const double fan = 90, lit = 15;

/* Returns twice the area of a triangle, projected along an axis; positive if it faces upwards. */
static double facing_up(const double (*p)[3], int axis)
{
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    return (p[1][u] - p[0][u]) * (p[2][v] - p[0][v]) - (p[1][v] - p[0][v]) * (p[2][u] - p[0][u]);
}

/* Computes where a mesh faces on the whole: to the right, upwards and to the front, in parts of its
 * area. */
static void find_facing(const struct bake_lowmesh *mesh, int up, double out[3])
{
    double sum[3] = {0}, area = 0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t) {
        const double(*p)[3] = (const double(*)[3])mesh->positions[t];
        area += 2 * bake_lowmesh_area(mesh, t);
        for (int k = 0; k < 3; ++k)
            sum[k] += facing_up(p, k);
    }
    const double scale = area > 0 ? 1 / area : 0;
    out[0] = scale * sum[0];
    out[1] = scale * sum[up];
    out[2] = scale * (up == 1 ? sum[2] : -sum[1]);
}

void bake_preview_place_views(const struct bake_preview *preview, int up,
                              struct bake_preview_views *out)
{
    const struct bake_options *options = preview->options;
    double facing[3];
    find_facing(preview->mesh, up, facing);
    const double aside = sqrt(facing[0] * facing[0] + facing[2] * facing[2]),
                 whole = sqrt(aside * aside + facing[1] * facing[1]);
    const double high = atan2(facing[1], aside) * radian;
    const bool open = whole > open_share;
    *out = (struct bake_preview_views){.from = options->preview_from,
                                       .above = options->preview_above,
                                       .step = 360.0 / options->preview_views};
    if (out->above < 0)
        out->above =
            open ? fmin(fmax(usual_above, high - most_aside), high + most_aside) : usual_above;
    if (out->from >= 0)
        return;
    out->from = usual_from;
    if (!open || aside < whole / 2)
        return;
    out->step = fan / options->preview_views;
    out->from =
        atan2(facing[0], facing[2]) * radian + lit - out->step * (options->preview_views - 1) / 2;
    out->from += out->from < 0 ? 360 : 0;
}

/* ---- a view ---- */

static struct bsq_vec3 direction(const struct preview_view *view, double right, double up,
                                 double toward)
{
    float v[3];
    for (int k = 0; k < 3; ++k)
        v[k] = (float)(right * view->right[k] + up * view->up[k] + toward * view->toward[k]);
    return bsq_unit3(bsq_load3(v));
}

/* Scales and centres the mesh in the panel. */
static void frame_mesh(const struct bake_lowmesh *mesh, struct preview_view *view)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (uint64_t t = 0; t < mesh->triangle_count; ++t)
        for (int c = 0; c < 3; ++c) {
            const double *p = mesh->positions[t][c];
            double at[2] = {bsq_dotd(view->right, p), bsq_dotd(view->up, p)};
            for (int k = 0; k < 2; ++k) {
                low[k] = fmin(low[k], at[k]);
                high[k] = fmax(high[k], at[k]);
            }
        }
    double centre_right = 0.5 * (low[0] + high[0]), centre_up = 0.5 * (low[1] + high[1]);
    double size = fmax(high[0] - low[0], high[1] - low[1]);
    view->scale = size > 0 ? margin * view->samples / size : 1.0;
    /* Depths are measured from the plane through the world's origin. */
    for (int k = 0; k < 3; ++k)
        view->centre[k] = centre_right * view->right[k] + centre_up * view->up[k];
}

/* Finds where camera rays enter and leave the bounds of the scan. */
static void span_scan(const struct bake_surface *scan, struct preview_view *view)
{
    double nearest = -INFINITY, farthest = INFINITY;
    for (int corner = 0; corner < 8; ++corner) {
        double p[3];
        for (int k = 0; k < 3; ++k)
            p[k] = corner >> k & 1 ? scan->scan_max[k] : scan->scan_min[k];
        double depth = bsq_dotd(p, view->toward) - bsq_dotd(view->centre, view->toward);
        nearest = fmax(nearest, depth);
        farthest = fmin(farthest, depth);
    }
    double rim = 4 * scan->detail;
    view->scan_depth = nearest + rim;
    view->scan_span = nearest - farthest + 2 * rim;
}

void bake_preview_view_set(const struct bake_preview *preview, double from, double above, int up,
                           uint32_t side, struct preview_view *view)
{
    view->side = side;
    view->samples = side * PREVIEW_GRID;
    set_axes(from / radian, above / radian, up, view);
    view->key = direction(view, -0.55, 0.65, 0.55);
    view->fill = direction(view, 0.85, 0.05, 0.5);
    view->half = bsq_unit3(bsq_add3(
        view->key, bsq_v3((float)view->toward[0], (float)view->toward[1], (float)view->toward[2])));
    frame_mesh(preview->mesh, view);
    span_scan(preview->surface, view);
}

struct bsq_vec3 bake_preview_turn_normal(const struct preview_view *view, struct bsq_vec3 normal)
{
    const double *t = view->toward;
    const bool away = normal.x * t[0] + normal.y * t[1] + normal.z * t[2] < 0;
    return bsq_scale3(normal, away ? -1.0f : 1.0f);
}

static float above_zero(float v)
{
    return v > 0.0f ? v : 0.0f;
}

struct bsq_vec3 bake_preview_shade(const struct preview_view *view, struct bsq_vec3 normal,
                                   struct bsq_vec3 albedo)
{
    float key = above_zero(bsq_dot3(normal, view->key));
    float fill = above_zero(bsq_dot3(normal, view->fill));
    float light = 0.95f * key + 0.16f * fill + 0.05f;
    /* A faint highlight shows small changes of the normal (Blinn-Phong). */
    float shine = 0.06f * powf(above_zero(bsq_dot3(normal, view->half)), 32.0f);
    return bsq_add3(bsq_scale3(albedo, light), bsq_v3(shine, shine, shine));
}

struct bsq_vec3 bake_preview_grey(void)
{
    return bsq_v3(0.6f, 0.6f, 0.6f);
}

struct bsq_vec3 bake_preview_background(uint32_t row, uint32_t side)
{
    float level = 0.16f - 0.10f * (float)row / (float)side;
    return bsq_v3(level, level, level);
}

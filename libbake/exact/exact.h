/* exact.h - traces rays against the triangles of a scan that need not fit into memory. Takes a
 * chunk file and batches of rays; gives each ray's nearest hit with normal and colour.
 *
 * A batch's rays are sorted into one bucket for each chunk that they cross. Each of these chunks is
 * loaded, gets a tree of boxes, finds the nearest hits of its rays, and evaluates their normals and
 * colours, which hits in later chunks may replace. Results do not depend on chunks, threads or
 * memory: the hit with the smallest (bk_ray_cost(t), -t, triangle number) wins, and all three are
 * computed alike in any order. */
#ifndef BAKE_EXACT_EXACT_H
#define BAKE_EXACT_EXACT_H

#include "formats/chunks/tris.h"
#include "libbake/bake.h"
#include "libbake/device/device.h"
#include "libbake/maps/maps.h"
#include "libbake/ray/ray.h"

struct bake_exact;

/* Opens a scan; close *out with bake_exact_close(), until when the path lives. Of the options: the
 * normals if the scan has none of its own, and whether rays also hit surfaces that face away, whose
 * normals are turned. Errors: those of fmt_tris_open(), BSQ_ENOMEM; BSQ_EUSAGE if the file has
 * other normals than these. */
int bake_exact_open(struct bsq_ctx *ctx, const char *path, const struct bake_options *options,
                    struct bake_exact **out);
void bake_exact_close(struct bake_exact *exact); /* NULL is allowed */
/* Returns what the chunk files say of the scan; valid until it is closed. */
const struct fmt_tris_header *bake_exact_header(const struct bake_exact *exact);
/* Returns the number of chunks that were loaded so far, counted again each time. */
uint64_t bake_exact_loads(const struct bake_exact *exact);

/* Makes later batches evaluate what the maps need besides a normal, and the options' transfer maps,
 * three values for each, and opens the textures. A normal map of the options is added to the scan's
 * normals; without one, what the chunk file keeps, if anything. What lies in no tile of it adds
 * nothing. Call it at most once, not from parallel work; the options' texts must live until
 * bake_exact_close(). Errors: those of fmt_shading_add_channel() and fmt_shading_open_textures().
 */
int bake_exact_use(struct bake_exact *exact, const struct bake_options *options, uint32_t maps);

/* ---- rays ---- */

/* Batches that go through the chunks of a scan one after the other. Rays that have chunks ahead are
 * in the next batch again. Chunks that later batches need stay in memory. */
struct bake_exact_sweep;
/* Begins a sweep of batches that have up to `most_rays` rays; free *out with
 * bake_exact_sweep_free(). Errors: BSQ_ENOMEM. */
int bake_exact_sweep_create(struct bake_exact *exact, uint64_t most_rays,
                            struct bake_exact_sweep **out);
void bake_exact_sweep_free(struct bake_exact_sweep *sweep); /* NULL is allowed */
/* Sets the first and the last chunk from `from` on that overlap a box; without any, *first is above
 * *last. */
void bake_exact_chunks_in(const struct bake_exact *exact, const float low[3], const float high[3],
                          uint32_t from, uint32_t *first, uint32_t *last);

/* Returns the number of rays of a batch that fits what is left of the budget, at least 1. Allows
 * for the rays, hits and footprints that the caller allocates, and for more_bytes for each ray. */
uint64_t bake_exact_capacity(const struct bake_exact *exact, uint64_t more_bytes);

/* Traces a batch on all threads, and on the device if there is one, unless the batch is sampled.
 * Must not be called from parallel work. Errors: BSQ_EDATA for a damaged chunk, BSQ_EIO,
 * BSQ_ENOMEM, BSQ_EINTR, BSQ_ENODEVICE. */
int bake_exact_trace(struct bake_exact *exact, const struct bake_ray_batch *batch);

/* ---- devices ---- */

/* Raises what a scene of chunks needs of a device's memory to what this scan needs of it, for the
 * rays of the scene's parameters. */
void bake_exact_add_needs(const struct bake_exact *exact, struct bake_scene *scene);
/* Lets a device trace the rays of later batches and looks, with the same results, or from NULL on
 * the processor again. It must stay open until these are freed. wave_bytes: of
 * bake_device_make_wave(). */
void bake_exact_set_device(struct bake_exact *exact, struct bake_device *device,
                           uint64_t wave_bytes);

/* ---- secondary rays ---- */

struct bake_exact_look;

/* Prepares secondary rays: takes up to a third of what is left of the budget, for the chunks of the
 * scan. params: maps, counts and lengths of rays; must outlive *out. Errors: BSQ_ENOMEM; of a
 * device, those of bake_device_make_areas(). */
int bake_exact_look_create(struct bake_exact *exact, const struct bk_params *params,
                           struct bake_exact_look **out);
void bake_exact_look_free(struct bake_exact_look *look); /* NULL is allowed */

/* Traces the rays of all viewpoints as bk_secondary.h describes, but against triangles, and notes
 * in their states what the scan adds. Results do not depend on chunks, threads or memory. If all
 * chunks fit into memory, they are loaded by the first call; otherwise each call loads those that
 * its rays can reach. Must not be called from parallel work. Errors: those of bake_exact_trace();
 * BSQ_ENODEVICE. */
int bake_exact_look_from(struct bake_exact_look *look, const struct bake_viewpoints *viewpoints,
                         struct bake_ray_states *states);

/* Returns the distance above a triangle at which open rays start: more than the rounding errors of
 * a hit's position. */
float bake_exact_lift(const struct bake_exact *exact);

/* Warns of textures as fmt_shading_tell_losses() does. */
int bake_exact_tell_losses(const struct bake_exact *exact);

/* Returns whether footprints have an effect: only if something comes from textures. */
bool bake_exact_wants_footprints(const struct bake_exact *exact);

/* Returns the place of a point on a Hilbert curve through the cube at `low` with this side; 33
 * bits. Points outside are clamped into the cube. Batches of rays that follow the curve cross few
 * chunks. */
uint64_t bake_exact_curve_index(const float point[3], const float low[3], double side);

#endif

/* inputs.c - opens the inputs of a bake, and sets the parameters of its rays. */
#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "formats/material/tile_files.h"
#include "formats/material/channels.h"
#include "base/context.h"
#include "base/file.h"
#include "base/sort_array.h"
#include "libbake/fit/fit.h"
#include "libbake/job/job.h"
#include "libbake/options/options.h"

/* Returns the first scan without colours. There must be one. */
static const struct bake_scan *without_color(const struct bake_surface *surface)
{
    const struct bake_scan *scan = surface->scans;
    while (scan->has_color)
        ++scan;
    return scan;
}

/* Warns of maps that only some of several scans can give, and that are not baked therefore. */
static int warn_of_lost_maps(const struct bake_surface *surface, uint32_t asked)
{
    bool colors = false, ids = false;
    for (uint32_t s = 0; s < surface->scan_count && surface->scan_count > 1; ++s) {
        colors |= surface->scans[s].has_color;
        ids |= surface->scans[s].ids != FMT_IDS_NONE;
    }
    int status = 0;
    if (colors && !surface->has_color)
        status = bsq_warn_loss(surface->ctx,
                               "%s has no colour, and other scans have: no map color is baked",
                               without_color(surface)->path);
    if (status == 0 && ids && surface->ids == FMT_IDS_NONE && asked & BAKE_MAPS_ALL)
        status = bsq_warn_loss(surface->ctx,
                               "the scans do not all have ids of one kind: no map id is baked");
    return status;
}

/* Finds the maps that `asked` stands for. Errors: BSQ_EDATA in a strict job. */
static int choose_from(const struct bake_surface *surface, uint32_t asked, uint32_t *out)
{
    *out = bake_choose_maps(asked, surface->has_color, surface->ids != FMT_IDS_NONE);
    return warn_of_lost_maps(surface, asked);
}

/* Returns whether the options leave the choice of maps to the scan. */
static bool leaves_choice(const struct bake_options *options)
{
    return options->maps & (BAKE_MAPS_ALL | BAKE_MAPS_USUAL) ||
           (options->maps == BAKE_MAPS_DEFAULT && options->transfer_count == 0);
}

/* Opens the scans of the options, without what maps need. */
static int open_scans(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *surface)
{
    struct bake_options scans;
    bake_defaults(&scans);
    scans.scan_path = options->scan_path;
    scans.more_scan_paths = options->more_scan_paths;
    scans.more_scan_count = options->more_scan_count;
    scans.match_names = options->match_names;
    bsq_mute_warnings(ctx, true); /* the bake opens the scans again, and then gives them */
    const int status = bake_surface_open(ctx, &scans, surface);
    bsq_mute_warnings(ctx, false);
    return status;
}

/* Warns of options without effect. */
static void warn_unused(const struct bake_surface *surface, const struct bake_options *options,
                        const bool *given)
{
    struct bake_scans_found scans = {.normals = true};
    for (uint32_t s = 0; s < surface->scan_count; s++) {
        const struct bake_exact *exact = surface->scans[s].exact;
        scans.grid |= exact == NULL;
        scans.normals &= !exact || bake_exact_header(exact)->attributes & FMT_TRIS_NORMALS;
    }
    bake_warn_of_options(surface->ctx, options, given, &scans);
}

int bake_inspect(struct bsq_ctx *ctx, struct bake_options *options, const bool *given,
                 int (*add)(void *arg, const char *name), void *arg)
{
    struct bake_surface surface;
    int status = open_scans(ctx, options, &surface);
    if (status < 0)
        goto done;
    if (add)
        BSQ_TRY(bake_surface_list_channels(&surface, add, arg));
    if (leaves_choice(options))
        BSQ_TRY(choose_from(&surface, options->maps, &options->maps));
    if (given)
        warn_unused(&surface, options, given);
done:
    bake_surface_close(&surface);
    return status;
}

/* Reports why the scans have no ids together: one has none, or two tell different things apart. */
static int fail_ids(const struct bake_job *job, const char *map)
{
    const struct bake_scan *scans = job->surface.scans, *lacking = NULL, *other = scans;
    for (const struct bake_scan *s = scans; s < scans + job->surface.scan_count; ++s) {
        if (s->ids == FMT_IDS_NONE && !lacking)
            lacking = s;
        if (s->ids != scans->ids && other == scans)
            other = s;
    }
    if (lacking)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s has no ids for the map %s: make it with bisque-voxelize --channels id",
                        lacking->path, map);
    return bsq_fail(job->ctx, BSQ_EDATA, "%s has ids by %s, %s by %s: make both with one --id",
                    scans->path, fmt_ids_text(scans->ids), other->path, fmt_ids_text(other->ids));
}

/* Checks that the scans can give a map. Errors: BSQ_EDATA if one lacks something. */
static int check_map(const struct bake_job *job, unsigned map)
{
    const struct bake_map_row *row = &bake_map_table[map];
    const struct bake_surface *surface = &job->surface;
    if (row->needs_color && !surface->has_color)
        return bsq_fail(job->ctx, BSQ_EDATA, "%s has no colour; leave %s out of --maps",
                        without_color(surface)->path, bake_map_names[map]);
    return row->needs_ids && surface->ids == FMT_IDS_NONE ? fail_ids(job, bake_map_names[map]) : 0;
}

/* Chooses the maps, after the scan was opened. */
static int choose_maps(struct bake_job *job)
{
    struct bake_options chosen = *job->options;
    if (leaves_choice(job->options))
        BSQ_PASS(choose_from(&job->surface, job->options->maps, &chosen.maps));
    job->maps = bake_selection(&chosen);
    for (unsigned i = 0; i < BK_MAP_COUNT; ++i)
        if (job->maps & 1u << i)
            BSQ_PASS(check_map(job, i));
    return bake_check_maps(job->ctx, job->options, job->maps);
}

/* Makes hits carry what the maps need. */
static int use_attributes(struct bake_job *job)
{
    int status = bake_surface_use(&job->surface, job->options, job->maps);
    return status == 0 && job->maps & BAKE_MAP_ID
               ? bake_surface_report_ids(&job->surface, job->report)
               : status;
}

/* ---- tiles ---- */

/* Sets the size and output path of a tile of a set; NULL: of the whole mesh. */
static int begin_tile(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                      const struct bake_low_set *set, const struct bake_udim_tile *udim,
                      struct bake_tile *out)
{
    *out = (struct bake_tile){.udim = *udim,
                              .options = *options,
                              .maps = maps,
                              .object = set ? set->object : NULL,
                              .material = set ? set->material : NULL};
    bake_tile_size_of(options, udim->number, &out->options.width, &out->options.height);
    char *path = bake_object_path(options->output_path, out->object, out->material);
    out->output_path = path ? bake_tile_path(path, udim->number) : NULL;
    free(path);
    out->options.output_path = out->output_path;
    if (out->output_path)
        out->beside = bake_path_of(&out->options, bake_first_of(maps));
    return out->beside ? 0 : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path);
}

int bake_note_tiles(struct bake_job *job)
{
    struct bake_report *report = job->report;
    assert(job->udim.count > 0);
    report->tiles = calloc(job->udim.count, sizeof *report->tiles);
    if (!report->tiles)
        return bsq_fail(job->ctx, BSQ_ENOMEM, "out of memory");
    for (const struct bake_tile *tile = job->tiles; tile < job->tiles + job->udim.count; ++tile) {
        if (tile->skipped)
            continue;
        struct bake_baked_tile *to = &report->tiles[report->tile_count++];
        *to = (struct bake_baked_tile){.tile = tile->udim.number,
                                       .width = tile->options.width,
                                       .height = tile->options.height,
                                       .object = tile->object ? strdup(tile->object) : NULL,
                                       .material = tile->material ? strdup(tile->material) : NULL};
        if ((tile->object && !to->object) || (tile->material && !to->material))
            return bsq_fail(job->ctx, BSQ_ENOMEM, "out of memory");
    }
    return 0;
}

/* Orders tiles by path, and those with one path as they come in the mesh. */
static int compare_paths(const void *a, const void *b)
{
    const struct bake_tile *x = *(const struct bake_tile *const *)a;
    const struct bake_tile *y = *(const struct bake_tile *const *)b;
    const int order = strcmp(x->output_path, y->output_path);
    return order ? order : (x > y) - (x < y);
}

/* Reports two sets of maps whose names became one, such as "a/b" and "a<b", which
 * both become "a_b". */
static int fail_twice(const struct bake_job *job, const struct bake_tile *a,
                      const struct bake_tile *b)
{
    if (a->object && a->material)
        return bsq_fail(job->ctx, BSQ_EUSAGE,
                        "%s: two outputs have this name: those of object \"%s\" with material "
                        "\"%s\" and of object \"%s\" with material \"%s\"",
                        a->output_path, a->object, a->material, b->object, b->material);
    return bsq_fail(job->ctx, BSQ_EUSAGE,
                    "%s: two outputs have this name: those of %s \"%s\" and \"%s\"", a->output_path,
                    a->object ? "the objects" : "the materials",
                    a->object ? a->object : a->material, b->object ? b->object : b->material);
}

/* Checks that names of objects and materials are different also as parts of file names. */
static int check_tile_paths(struct bake_job *job)
{
    const struct bake_tile **tiles;
    int status = bsq_alloc(job->ctx, "names of maps", job->udim.count, sizeof(void *), &tiles);
    if (status < 0)
        return status;
    for (uint32_t i = 0; i < job->udim.count; ++i)
        tiles[i] = &job->tiles[i];
    bsq_sort(tiles, job->udim.count, sizeof(void *), compare_paths);
    for (uint32_t i = 1; i < job->udim.count && status == 0; ++i)
        if (strcmp(tiles[i - 1]->output_path, tiles[i]->output_path) == 0)
            status = fail_twice(job, tiles[i - 1], tiles[i]);
    bsq_free(job->ctx, tiles);
    return status;
}

static int begin_tiles(struct bake_job *job)
{
    const struct bake_low_set *sets = job->mesh.sets;
    BSQ_PASS(bake_udim_find(job->ctx, job->options, &job->mesh, &job->udim));
    BSQ_PASS(BSQ_CALLOC(job->ctx, "tiles", job->udim.count, &job->tiles));
    for (uint32_t i = 0; i < job->udim.count; ++i)
        BSQ_PASS(begin_tile(job->ctx, job->options, job->maps,
                            sets ? &sets[job->udim.tiles[i].set] : NULL, &job->udim.tiles[i],
                            &job->tiles[i]));
    BSQ_PASS(check_tile_paths(job));
    job->report->outside_uv_triangles = job->udim.outside_triangles;
    return 0;
}

/* Opens the skew maps of all tiles. */
static int open_skew(struct bake_job *job)
{
    enum { LEAST_CACHE = 12 << 20, MOST_CACHE = 256 << 20 };
    const char *path = job->options->skew_path;
    const uint32_t count = job->udim.count;
    struct fmt_texture_source *sources = NULL;
    uint64_t cache = bsq_memory_left(job->ctx) / 16;
    int status = 0;
    if (!path)
        return 0;
    cache = cache < LEAST_CACHE ? LEAST_CACHE : cache > MOST_CACHE ? MOST_CACHE : cache;
    BSQ_TRY(BSQ_CALLOC(job->ctx, "skew map", count, &sources));
    for (uint32_t i = 0; i < count; i++) {
        char *name = bake_tile_path(path, job->udim.tiles[i].number);
        sources[i] = (struct fmt_texture_source){.path = name, .data = true};
        BSQ_TRY(name ? bsq_note_input(job->ctx, name, "the skew map")
                     : bsq_fail(job->ctx, BSQ_ENOMEM, "%s: out of memory", path));
    }
    BSQ_TRY(fmt_textures_open(job->ctx, count, fmt_texture_source_at, sources, cache, &job->skew));
    status = fmt_textures_tell_losses(job->skew);
done:
    for (uint32_t i = 0; sources && i < count; i++)
        free((void *)(uintptr_t)sources[i].path);
    bsq_free(job->ctx, sources);
    return status;
}

/* Notes the files that the options name as inputs, so that no output is written to them. */
static int note_inputs(struct bsq_ctx *ctx, const struct bake_options *options)
{
    BSQ_PASS(bsq_note_input(ctx, options->scan_path, "the scan"));
    for (uint32_t i = 0; i < options->more_scan_count; i++)
        BSQ_PASS(bsq_note_input(ctx, options->more_scan_paths[i], "a scan"));
    BSQ_PASS(bsq_note_input(ctx, options->mesh_path, "the low-poly mesh"));
    for (uint32_t i = 0; i < options->more_mesh_count; i++)
        BSQ_PASS(bsq_note_input(ctx, options->more_mesh_paths[i], "a low-poly mesh"));
    if (options->cage_path)
        BSQ_PASS(bsq_note_input(ctx, options->cage_path, "the cage"));
    for (uint32_t i = 0; i < options->transfer_count; i++)
        if (options->transfers[i].texture_path)
            BSQ_PASS(fmt_note_texture(ctx, options->transfers[i].texture_path, "the texture %s",
                                      options->transfers[i].name));
    return 0;
}

/* ---- scans of objects ---- */

enum { LIST_BYTES = 300 /* of names in a message */ };

/* A scan's name: its file's, without folder and suffix. */
struct name {
    const char *at;
    size_t length;
};

static struct name scan_name(const struct bake_job *job, uint32_t scan)
{
    const char *path = job->surface.scans[scan].path;
    const char *at = bsq_file_name(path), *dot = strrchr(at, '.');
    return (struct name){at, dot && dot > at ? (size_t)(dot - at) : strlen(at)};
}

/* Reads `text` at the start of a name, and advances the name past it. Returns whether it is there.
 */
static bool inputs_take(struct name *name, const char *text, size_t length)
{
    const bool there = name->length >= length && memcmp(name->at, text, length) == 0;
    name->at += there ? length : 0;
    name->length -= there ? length : 0;
    return there;
}

/* Returns the length of an object's name without its suffix. */
static size_t stem_length(const struct bake_options *options, const char *object)
{
    const size_t low = strlen(options->low_suffix), length = strlen(object);
    const bool ends =
        low > 0 && length > low && strcmp(object + length - low, options->low_suffix) == 0;
    return ends ? length - low : length;
}

/* Returns whether an object and a scan have the same name but for their suffixes. What follows the
 * scan's suffix after a '_' is the number of a scan, or any other text. */
static bool inputs_match(const struct bake_options *options, const char *object, struct name scan)
{
    if (!inputs_take(&scan, object, stem_length(options, object)))
        return false;
    return scan.length == 0 ||
           (inputs_take(&scan, options->high_suffix, strlen(options->high_suffix)) &&
            (scan.length == 0 || *scan.at == '_'));
}

/* Lets a scan be seen only by the objects that share most of its name with it: "body_arm_high" is a
 * scan of "body_arm_low", not another one of "body_low", if the suffixes allow both. */
static void keep_longest(struct bake_job *job, uint32_t scan)
{
    const uint32_t scans = job->surface.scan_count, objects = job->mesh.objects.count;
    size_t longest = 0;
    for (uint32_t o = 0; o < objects; o++) {
        const size_t stem = stem_length(job->options, job->mesh.objects.list[o]);
        if (job->sees[(uint64_t)o * scans + scan] && stem > longest)
            longest = stem;
    }
    for (uint32_t o = 0; o < objects; o++)
        job->sees[(uint64_t)o * scans + scan] &=
            stem_length(job->options, job->mesh.objects.list[o]) == longest;
}

/* ---- messages ---- */

/* A list of names in a message; those that do not fit are counted. */
struct list {
    char text[LIST_BYTES];
    size_t used;
    uint64_t left;
};

static void inputs_add_name(struct list *list, const char *name, size_t length)
{
    if (list->left > 0 || list->used + length + 32 > sizeof list->text) {
        list->left++;
        return;
    }
    list->used += (size_t)snprintf(list->text + list->used, sizeof list->text - list->used,
                                   "%s%.*s", list->used > 0 ? ", " : "", (int)length, name);
}

static const char *end_list(struct list *list)
{
    if (list->left > 0)
        snprintf(list->text + list->used, sizeof list->text - list->used, " and %llu more",
                 (unsigned long long)list->left);
    return list->used + list->left > 0 ? list->text : "none";
}

/* Reports the objects and scans that have no partner. */
static int fail_alone(const struct bake_job *job, const bool *sees)
{
    const uint32_t scans = job->surface.scan_count;
    struct list objects = {{0}, 0, 0}, others = {{0}, 0, 0};
    for (uint32_t o = 0; o < job->mesh.objects.count; o++)
        if (!memchr(sees + (uint64_t)o * scans, 1, scans))
            inputs_add_name(&objects, job->mesh.objects.list[o], strlen(job->mesh.objects.list[o]));
    for (uint32_t s = 0; s < scans; s++) {
        bool shown = false;
        for (uint32_t o = 0; o < job->mesh.objects.count && !shown; o++)
            shown = sees[(uint64_t)o * scans + s];
        const struct name name = scan_name(job, s);
        if (!shown)
            inputs_add_name(&others, name.at, name.length);
    }
    if (objects.used + objects.left + others.used + others.left == 0)
        return 0;
    return bsq_fail(job->ctx, BSQ_EUSAGE,
                    "names do not match: low-poly objects without a scan: %s; scans without an "
                    "object: %s",
                    end_list(&objects), end_list(&others));
}

/* Finds out which scans each object sees, by their names. Errors: BSQ_EUSAGE, with the names, if an
 * object sees none, or if none sees a scan. */
static int match_objects(struct bake_job *job)
{
    const uint32_t scans = job->surface.scan_count, objects = job->mesh.objects.count;
    BSQ_PASS(BSQ_CALLOC(job->ctx, "matches", (uint64_t)objects * scans, &job->sees));
    for (uint32_t o = 0; o < objects; o++) {
        if (o % 1024 == 0)
            BSQ_PASS(bsq_check(job->ctx));
        for (uint32_t s = 0; s < scans; s++)
            job->sees[(uint64_t)o * scans + s] =
                inputs_match(job->options, job->mesh.objects.list[o], scan_name(job, s));
    }
    for (uint32_t s = 0; s < scans; s++) {
        BSQ_PASS(bsq_check(job->ctx));
        keep_longest(job, s);
    }
    BSQ_PASS(fail_alone(job, job->sees));
    job->surface.sees = job->sees;
    return 0;
}

int bake_open_inputs(struct bake_job *job)
{
    BSQ_PASS(bake_check_options(job->ctx, job->options));
    BSQ_PASS(note_inputs(job->ctx, job->options));
    BSQ_PASS(bake_surface_open(job->ctx, job->options, &job->surface));
    BSQ_PASS(choose_maps(job));
    BSQ_PASS(use_attributes(job));
    BSQ_PASS(bake_lowmesh_load(job->ctx, job->options, &job->mesh));
    job->report->low_triangles = job->mesh.triangle_count;
    job->report->low_polygons = job->mesh.polygon_count;
    if (job->options->match_names)
        BSQ_PASS(match_objects(job));
    BSQ_PASS(begin_tiles(job));
    return open_skew(job);
}

/* ---- parameters ---- */

int bake_set_params(struct bake_job *job)
{
    const struct bake_options *options = job->options;
    double front, back;
    bake_surface_set_params(&job->surface, options, job->maps);
    BSQ_PASS(bake_fit(&job->surface, &job->mesh, options, &front, &back));
    if (bake_has_cage(options))
        front = job->mesh.cage_distance;
    job->report->front = front;
    job->report->back = back;
    bake_surface_set_lengths(&job->surface, front, back);
    return 0;
}

/* scan_scale.c - the scale of vertex colours of each file: from 0 to 1, or from 0 to 255.
 *
 * OBJ files, and PLY files with real numbers, do not say it. All colours of a file vote, so the
 * result depends neither on their order nor on how a file is packed.
 *
 * Colours are stored as they come, with the scale that those before them tell. If later ones tell
 * another scale, the scan is read again. Black has no scale, so a file may begin with any number of
 * black vertices. A file of black, pure and white colours alone does not tell, so it takes the
 * scale of the first file that does. */
#include "libvoxel/read/scan.h"

/* ---- votes ---- */

/* A damaged value in a thousand colours must not turn a scan black. */
enum { FRACTIONAL_PER_BRIGHT = 1000 };

/* Returns whether a component is a fraction above 0 and at most COLOR_BRIGHT. */
static uint32_t is_fractional(float value)
{
    value = value > 0.0f ? value : 0.0f;
    value = value < COLOR_BRIGHT ? value : COLOR_BRIGHT;
    return value != (float)(int32_t)value;
}

void vox_color_votes_add(struct color_votes *votes, const float (*colors)[3], uint64_t count)
{
    enum { RUN = 1 << 16 }; /* whose numbers fit in 32 bits, for vector instructions */
    while (count > 0) {
        const uint32_t run = count < RUN ? (uint32_t)count : RUN;
        uint32_t nonzero = 0, fractional = 0, large = 0, bright = 0;
        for (uint32_t v = 0; v < run; v++) {
            const float r = colors[v][0], g = colors[v][1], b = colors[v][2];
            const float of_two = r > g ? r : g, most = of_two > b ? of_two : b;
            nonzero += most > 0.0f;
            large += most > COLOR_UNIT;
            bright += most > COLOR_BRIGHT;
            fractional += is_fractional(r) | is_fractional(g) | is_fractional(b);
        }
        votes->nonzero += nonzero;
        votes->large += large;
        votes->bright += bright;
        votes->fractional += fractional;
        colors += run;
        count -= run;
    }
}

/* Bytes are whole, so any whole value above 2 is one. Among fractions, values above 2 are bright
 * spots of colours from 0 to 1, unless many are too large for that. */
float vox_color_votes_scale(const struct color_votes *votes)
{
    if (votes->fractional == 0)
        return votes->large > 0 ? 1.0f : 0.0f;
    return votes->bright > votes->fractional / FRACTIONAL_PER_BRIGHT ? 1.0f : 255.0f;
}

/* ---- files ---- */

/* Returns the scale of a file's colours so far: 255 or 1. */
static float scale_of(const struct scan *scan, const struct scan_file *file)
{
    const float own = vox_color_votes_scale(&file->color_votes);
    if (own > 0.0f || !scan->has_telling_file)
        return own > 0.0f ? own : 255.0f;
    return vox_color_votes_scale(&scan->files[scan->telling_file].color_votes);
}

/* Returns whether a file's colours were stored with another scale than they have. */
static bool is_misread(const struct scan *scan, const struct scan_file *file)
{
    return file->color_votes.nonzero > 0 && file->color_scale != scale_of(scan, file);
}

int vox_scan_find_color_scale(struct scan *scan, const struct fmt_mesh_block *block, float *scale)
{
    struct scan_file *file = &scan->files[block->file];
    if (!block->colors || block->color_white > 0.0f) {
        *scale = block->colors ? 255.0f / block->color_white : 0.0f;
        return 0;
    }
    vox_color_votes_add(&file->color_votes, block->colors, block->vertex_count);
    if (!scan->has_telling_file && vox_color_votes_scale(&file->color_votes) > 0.0f) {
        scan->has_telling_file = true;
        scan->telling_file = block->file;
    }
    if (file->color_scale == 0.0f && block->file < scan->known_count)
        file->color_scale = scan->known_scales[block->file];
    if (file->color_scale == 0.0f && file->color_votes.nonzero > 0)
        file->color_scale = scale_of(scan, file);
    *scale = file->color_scale > 0.0f ? file->color_scale : 255.0f;
    scan->misread_colors = !scan->reads_again && is_misread(scan, file);
    return scan->misread_colors ? BSQ_RETRY : 0;
}

int vox_scan_check_color_scales(struct scan *scan)
{
    for (uint64_t i = 0; i < scan->file_count; i++)
        scan->misread_colors |= is_misread(scan, &scan->files[i]);
    return scan->misread_colors ? BSQ_RETRY : 0;
}

int vox_scan_list_color_scales(const struct scan *scan, float **out)
{
    int status = bsq_calloc(scan->ctx, "files of a scan", scan->file_count + 1, sizeof **out, out);
    for (uint64_t i = 0; status == 0 && i < scan->file_count; i++)
        if (scan->files[i].color_votes.nonzero > 0)
            (*out)[i] = scale_of(scan, &scan->files[i]);
    return status;
}

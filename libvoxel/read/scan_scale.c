/* scan_scale.c - the scale of vertex colours of each file, while the files are read.
 *
 * Colours are stored as they come, with the scale that those before them tell. If later ones tell
 * another scale, the scan is read again. Black has no scale, so a file may begin with any number of
 * black vertices. A file of black, pure and white colours alone does not tell, so it takes the
 * scale of the first file that does. */
#include "libvoxel/read/scan.h"

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

/* surface_channels.c - the further channels of scans, such as roughness, for transfer maps. */
#include <stdlib.h>
#include <string.h>

#include "base/channels.h"
#include "base/loss.h"
#include "libbake/surface/surface.h"

/* Returns whether a single scan has a channel. */
static bool has_own_channel(const struct bake_scan *scan, const char *name)
{
    const struct fmt_nvdb_grid *grid = &scan->grid;
    uint32_t first;
    if (!scan->exact)
        return grid->channels &&
               bsq_channel_list_find(grid->channel_list, grid->channel_list_bytes, name, &first);
    const struct bake_exact_info *info = bake_exact_get_info(scan->exact);
    for (uint32_t c = 0; c < info->channel_count; c++)
        if (strcmp(info->channels[c], name) == 0)
            return true;
    return false;
}

/* Returns whether each scan has a channel. */
static bool has_channel(const struct bake_surface *surface, const char *name)
{
    for (uint32_t s = 0; s < surface->scan_count; s++)
        if (!has_own_channel(&surface->scans[s], name))
            return false;
    return true;
}

/* What each channel of the scans is given to. */
struct listing {
    const struct bake_surface *all;
    const struct bake_scan *scan; /* the one whose channels are listed */
    int (*fn)(void *arg, const char *name);
    void *arg;
};

/* Returns whether a scan before the listed one has a channel. */
static bool was_listed(const struct listing *listing, const char *name)
{
    for (const struct bake_scan *s = listing->all->scans; s < listing->scan; s++)
        if (has_own_channel(s, name))
            return true;
    return false;
}

static int list_channel(const struct listing *listing, const char *name)
{
    /* A normal map belongs to the scan's normals. */
    if (strcmp(name, BSQ_CHANNEL_NORMAL_MAP) == 0 || was_listed(listing, name))
        return 0;
    if (has_channel(listing->all, name))
        return listing->fn(listing->arg, name);
    return bsq_warn_loss(listing->all->ctx,
                         "the scans do not all have the channel %s: no map transfer:%s is baked",
                         name, name);
}

static int list_grid(const struct listing *listing, const struct fmt_nvdb_grid *grid)
{
    const char *at = grid->channel_list, *end = at + grid->channel_list_bytes;
    int status = 0;
    while (grid->channels && at < end && status == 0) {
        const char *comma = memchr(at, ',', (size_t)(end - at));
        const size_t length = (size_t)((comma ? comma : end) - at);
        char *name = strndup(at, length);
        status =
            name ? list_channel(listing, name)
                 : bsq_fail(listing->all->ctx, BSQ_ENOMEM, "out of memory for names of channels");
        free(name);
        at += length + 1;
    }
    return status;
}

static int list_scan(const struct listing *listing)
{
    if (!listing->scan->exact)
        return list_grid(listing, &listing->scan->grid);
    const struct bake_exact_info *info = bake_exact_get_info(listing->scan->exact);
    int status = 0;
    for (uint32_t c = 0; c < info->channel_count && status == 0; c++)
        status = list_channel(listing, info->channels[c]);
    return status;
}

int bake_surface_list_channels(const struct bake_surface *surface,
                               int (*fn)(void *arg, const char *name), void *arg)
{
    struct listing listing = {surface, surface->scans, fn, arg};
    int status = 0;
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++, listing.scan++)
        status = list_scan(&listing);
    return status;
}

/* Finds the channels of transfer maps in a grid. */
static int use_channels(struct bake_scan *scan, const struct bake_transfer *transfers,
                        uint32_t count)
{
    struct fmt_nvdb_grid *grid = &scan->grid;
    int status = bsq_alloc(scan->ctx, "transfer maps", count, sizeof *scan->transfer_words,
                           &scan->transfer_words);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        uint32_t first = 0;
        const struct bsq_channel *channel =
            grid->channels ? bsq_channel_list_find(grid->channel_list, grid->channel_list_bytes,
                                                   transfers[i].name, &first)
                           : NULL;
        if (transfers[i].texture_path)
            status = bsq_fail(scan->ctx, BSQ_EDATA,
                              "%s is a grid, which cannot use %s: make it with bisque-voxelize "
                              "--channels %s=%s",
                              scan->path, transfers[i].texture_path, transfers[i].name,
                              transfers[i].texture_path);
        else if (!channel)
            status = bsq_fail(scan->ctx, BSQ_EDATA,
                              "%s has no channel %s: make it with bisque-voxelize --channels %s",
                              scan->path, transfers[i].name, transfers[i].name);
        else if (first + channel->values > grid->channel_words) /* another process changed it */
            status = bsq_fail(scan->ctx, BSQ_EIO, "%s: was changed while it was read", scan->path);
        else
            scan->transfer_words[i] = first << 2 | channel->values;
    }
    if (status == 0) {
        grid->transfers = scan->transfer_words;
        grid->transfer_count = count;
    }
    return status;
}

int bake_surface_use_transfers(struct bake_surface *surface, const struct bake_options *options)
{
    const struct bake_transfer *transfers = options->transfers;
    const uint32_t count = options->transfer_count;
    int status = 0;
    for (uint32_t i = 0; i < count && options->more_scan_count > 0; i++)
        if (transfers[i].texture_path)
            return bsq_fail(surface->ctx, BSQ_EUSAGE,
                            "%s is a texture of one scan, but there are %u scans",
                            transfers[i].texture_path, options->more_scan_count + 1);
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++) {
        struct bake_scan *scan = &surface->scans[s];
        if (count == 0)
            scan->grid.channels = NULL; /* grids leave out channels that no map needs */
        else if (scan->exact)
            status = bake_exact_use_transfers(scan->exact, transfers, count);
        else
            status = use_channels(scan, transfers, count);
    }
    return status;
}

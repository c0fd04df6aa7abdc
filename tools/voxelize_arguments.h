/* voxelize_arguments.h - the command line of bisque-voxelize. */
#ifndef VOXELIZE_ARGUMENTS_H
#define VOXELIZE_ARGUMENTS_H

#include "libvoxel/voxel.h"
#include "tools/cli_tasks.h"

enum { VOXELIZE_MOST_ROWS = 32 };

struct voxelize_arguments {
    bool given[VOXELIZE_MOST_ROWS]; /* by rows of the options */
    const char *const *inputs;
    uint32_t input_count;
    const char *output;
    uint32_t resolution; /* 0: a voxel size is given */
    double voxel_size;   /* 0: not given */
    enum vox_grid_type grid_type;
    enum bsq_scan_normals scan_normals;
    const char *vdb, *texture, *tris;
    const char *scan_normal_map;
    bool channel_ids;
    struct vox_channel *channels; /* further ones; the names are owned */
    uint32_t channel_count;
    char *channel_list; /* their names, separated by commas; NULL: none */
    enum vox_ids ids;   /* VOX_IDS_NONE: not given */
    bool no_tris, parse_only, resume;
    bool sort_only; /* the output is a chunk file: no grid is made */
    struct cli_tasks farm;
    /* Of all files, or of each one: as often as the option was given. */
    double scale; /* the last one */
    double *scales;
    enum vox_up *ups;
    double (*translations)[3];
    uint32_t scale_count, up_count, translation_count;
    struct vox_placement *placements; /* one for each input; NULL: none is given */
};

/* Parses the command line, and checks what can be checked without opening a file. Returns what
 * cli_parse() returns. */
int voxelize_arguments_parse(struct cli *cli, struct voxelize_arguments *arguments, int argc,
                             char **argv);

/* Applies the rules for paths to the inputs of the command line. */
int voxelize_arguments_map_inputs(struct cli *cli, struct voxelize_arguments *arguments);

/* Returns whether the chunk file is to keep the materials' normal maps. */
bool voxelize_keeps_normal_map(const struct voxelize_arguments *arguments);

/* Frees what parsing allocated. */
void voxelize_arguments_free(struct voxelize_arguments *arguments);

#endif

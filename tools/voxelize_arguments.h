/* voxelize_arguments.h - the command line of bisque-voxelize. */
#ifndef VOXELIZE_ARGUMENTS_H
#define VOXELIZE_ARGUMENTS_H

#include "libvoxel/voxel.h"
#include "tools/cli.h"

enum { VOXELIZE_MOST_ROWS = 32 };

struct voxelize_arguments {
    bool given[VOXELIZE_MOST_ROWS];   /* by rows of the options */
    struct vox_sort_options sort;     /* of the meshes; the job adds its files */
    struct vox_voxelize_options grid; /* likewise */
    const char *const *inputs;
    uint32_t input_count;
    const char *tris;
    bool no_tris, parse_only, info;
    bool sort_only;                     /* the output is a chunk file: no grid is made */
    struct vox_channel *channels;       /* those of sort */
    bool all_channels;                  /* keep all that the materials have */
    struct bsq_placement *placements;   /* those of sort */
    uint32_t scales, ups, translations; /* how often these options were given */
    double origin[3];                   /* that of sort, if it was given */
};

/* Parses the command line, and checks what can be checked without opening a file. Returns what
 * cli_parse() returns. */
int voxelize_arguments_parse(struct cli *cli, struct voxelize_arguments *arguments, int argc,
                             char **argv);

/* Checks the options if chunk files, such as `part`, are among the inputs. */
int voxelize_arguments_check_part(struct cli *cli, const struct voxelize_arguments *arguments,
                                  const char *part, bool beside_meshes);

/* Adds the image of --scan-normal-map to the channels of the chunk file and, with --channels all,
 * what materials can have. */
void voxelize_arguments_add_channels(struct voxelize_arguments *arguments);

/* Prints what is in files, for --info (voxelize_info.c). */
int voxelize_info_print(struct cli *cli, const char *const *paths, uint32_t count);

#endif

/* compare_mesh.h - bisque-compare of a mesh with a scan. */
#ifndef COMPARE_MESH_H
#define COMPARE_MESH_H

#include "libvoxel/voxel.h"
#include "tools/cli.h"

/* The files of the command line: a mesh, and the chunk files of a scan. */
struct compare_mesh {
    const char *const *inputs;
    uint32_t count;
    struct vox_distances from_scan, from_mesh;
};

/* Sets *is to whether the first input is a mesh and all others are chunk files. */
int compare_mesh_recognise(struct cli *cli, const struct compare_mesh *files, bool *is);

/* Measures the distances. */
int compare_mesh_measure(struct cli *cli, struct compare_mesh *files);

/* Prints them as lines or as JSON; failures: limits that do not hold. */
int compare_mesh_print(struct cli *cli, const struct compare_mesh *files, int failures);

#endif

/* triangle_scan.h - meshes of tests, written as chunk files with chunks of any size. */
#ifndef TEST_TRIANGLE_SCAN_H
#define TEST_TRIANGLE_SCAN_H

#include "formats/chunks/tris.h"

struct triangle_scan {
    uint32_t attributes, vertex_count, triangle_count, material_count;
    float (*positions)[3];
    uint32_t *normals, *colors, *materials;
    float (*texcoords)[2];
    uint32_t (*triangles)[3];
    struct fmt_tris_material material[2];
    bool smooth; /* make vertex normals by area */
};

/* Returns a mesh that is all zeros, with memory for every attribute. Free it with
 * triangle_scan_free(). Aborts without memory. */
struct triangle_scan triangle_scan_new(uint32_t vertices, uint32_t triangles);
void triangle_scan_free(struct triangle_scan *scan);

/* Writes the triangles in their order, chunk_triangles to a chunk. The test fails if that fails. */
void triangle_scan_write(const struct triangle_scan *scan, const double origin[3],
                         uint32_t chunk_triangles, const char *path);

#endif

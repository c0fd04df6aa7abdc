/* stl_internal.h - private to the STL reader: its state and how its parts share it.
 *
 * STL files repeat each vertex for each triangle. Vertices of a part that are equal are made one
 * here, which leaves about one vertex for a triangle; the rest is left to later stages, which match
 * vertices by position (docs/decisions). So memory does not grow with the file. */
#ifndef FMT_MESH_STL_INTERNAL_H
#define FMT_MESH_STL_INTERNAL_H

#include "formats/mesh/mesh_format.h"

enum stl_kind {
    STL_TEXT,
    STL_BINARY,        /* colours as in VisCAM and SolidView */
    STL_BINARY_MAGICS, /* colours as in Materialise Magics */
    STL_BINARY_MESHLAB /* colours as in MeshLab, which differs from Magics in the highest bit */
};

/* Bytes of a binary file before its triangles, and of a triangle. */
#define STL_HEADER_BYTES   ((uint64_t)84)
#define STL_TRIANGLE_BYTES ((uint64_t)50)

/* What the reader keeps of a file: source->data. */
struct stl_source {
    enum stl_kind kind;
    float object_color[3]; /* of STL_BINARY_MAGICS */
    uint64_t triangles;    /* of a binary file, by its size or its header */
    int64_t open_solids;   /* "solid" without "endsolid", of one reading */
};

/* ---- stl_reader.c ---- */

/* Prepares slot->work and slot->arrays for a part of up to `most` vertices. */
int fmt_stl_begin_weld(struct stream_slot *slot, uint64_t most);
/* Returns the number, in the part, of the vertex at this position; adds it if it is new. position:
 * finite, or all NAN. color: NULL unless slot->arrays.has_colors. */
uint64_t fmt_stl_weld(struct stream_slot *slot, const double position[3], const float *color);

/* ---- stl_text.c ---- */

int fmt_stl_cut_text(const struct stream_part *before, struct stream_slot *slot);
int fmt_stl_parse_text(struct stream_slot *slot);

#endif

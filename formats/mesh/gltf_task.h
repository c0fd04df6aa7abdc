/* gltf_task.h - private to formats/mesh: what the program bisque-gltf gets, which decompresses
 * arrays of glTF files by meshoptimizer and Draco. */
#ifndef FMT_MESH_GLTF_TASK_H
#define FMT_MESH_GLTF_TASK_H

#include "formats/program/program.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gltf_meshopt_mode { GLTF_MESHOPT_ATTRIBUTES, GLTF_MESHOPT_TRIANGLES, GLTF_MESHOPT_INDICES };
enum gltf_meshopt_filter {
    GLTF_MESHOPT_NONE,
    GLTF_MESHOPT_OCTAHEDRAL,
    GLTF_MESHOPT_QUATERNION,
    GLTF_MESHOPT_EXPONENTIAL
};

/* One attribute of a mesh that Draco compressed, or its indices. */
struct gltf_draco_output {
    bool indices;        /* uint32, three for each face */
    uint32_t id;         /* of the attribute in the compressed mesh */
    uint32_t components; /* of an element: 1 to 4 */
    uint32_t type;       /* of a component: 5120 int8, 5121 uint8, 5122 int16, 5123 uint16,
                            5125 uint32, 5126 float */
    uint64_t bytes;      /* elements follow each other */
};

/* Compressed data: a view, or the accessors of a primitive. The program's input is
 * for each of them this head and the compressed bytes. Its output is what they
 * become, one after the other; or, if its exit status is BSQ_EDATA, a text that says what is wrong.
 */
struct gltf_packed {
    bool is_draco;
    uint32_t number; /* of the view or mesh, for messages */
    uint32_t buffer;
    uint64_t offset, size; /* in the buffer */
    uint64_t bytes;        /* when decoded */
    /* A view of EXT_meshopt_compression becomes count * stride bytes. The stride suits mode and
     * filter: see meshopt_fits(). */
    uint64_t count;
    uint32_t stride;
    enum gltf_meshopt_mode mode;
    enum gltf_meshopt_filter filter;
    /* A mesh of KHR_draco_mesh_compression must have these counts. */
    uint64_t points, faces;
    struct gltf_draco_output outputs[5];
    uint32_t output_count;
};

#ifdef __cplusplus
}
#endif
#endif

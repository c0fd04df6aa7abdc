/* fuzz_compressed.c - fuzz target for compressed parts of glTF files: what meshoptimizer and Draco
 * decode. The first 8 bytes choose the decoder and what the file's JSON would say of the data. */
#include <stdlib.h>
#include <string.h>

#include "tests/fuzz/compressed_check.h"
#include "tests/fuzz/fuzz_file.h"

enum { HEAD = 8, MOST = 4096 };

static uint32_t load16(const uint8_t *from)
{
    return (uint32_t)from[1] << 8 | from[0];
}

/* Decodes a view whose stride suits its mode and filter, as the reader checks before. */
static void use_meshopt(const uint8_t *head, const uint8_t *data, size_t size)
{
    struct gltf_packed view = {
        .size = size, .count = load16(head + 2) % MOST, .mode = head[0] % 3, .filter = head[1] % 4};
    view.stride =
        view.mode == GLTF_MESHOPT_ATTRIBUTES ? (head[4] % 64 + 1u) * 4 : (head[4] % 2 + 1u) * 2;
    if (view.mode != GLTF_MESHOPT_ATTRIBUTES)
        view.filter = GLTF_MESHOPT_NONE;
    if (view.filter == GLTF_MESHOPT_OCTAHEDRAL)
        view.stride = head[4] % 2 ? 4 : 8;
    if (view.filter == GLTF_MESHOPT_QUATERNION)
        view.stride = 8;
    if (view.mode == GLTF_MESHOPT_TRIANGLES)
        view.count -= view.count % 3;
    uint8_t *to = malloc(view.count * view.stride + 1);
    decode_view(&view, data, to);
    free(to);
}

static void use_draco(const uint8_t *head, const uint8_t *data, size_t size)
{
    static const uint32_t types[] = {5120, 5121, 5122, 5123, 5125, 5126};
    static const uint32_t sizes[] = {1, 1, 2, 2, 4, 4};
    struct gltf_packed mesh = {
        .size = size, .points = load16(head + 2), .faces = load16(head + 4), .output_count = 3};
    for (uint32_t i = 0; i < 3; i++) {
        mesh.outputs[i] = (struct gltf_draco_output){.indices = i == 0,
                                                     .id = i == 1 ? 0 : head[6] % 4,
                                                     .components = i == 2 ? head[7] % 4 + 1u : 3,
                                                     .type = i == 2 ? types[head[1] % 6] : 5126};
        mesh.outputs[i].bytes = i == 0 ? 12 * mesh.faces
                                : i == 1
                                    ? 12 * mesh.points
                                    : mesh.outputs[2].components * mesh.points * sizes[head[1] % 6];
        mesh.bytes += mesh.outputs[i].bytes;
    }
    uint8_t *to = malloc(mesh.bytes + 1);
    decode_compressed_mesh(&mesh, data, to);
    free(to);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size <= HEAD)
        return -1;
    uint8_t *exact = malloc(size - HEAD);
    memcpy(exact, data + HEAD, size - HEAD);
    if (data[0] % 8 < 3)
        use_meshopt(data, exact, size - HEAD);
    else
        use_draco(data, exact, size - HEAD);
    free(exact);
    return 0;
}

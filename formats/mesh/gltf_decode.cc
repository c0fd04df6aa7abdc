// gltf_decode.cc - decompresses parts of glTF files by meshoptimizer and Draco.
#include <cstring>
#include <memory>
#include <new>

#include <draco/compression/decode.h>
#include <draco/core/decoder_buffer.h>
#include <meshoptimizer.h>

#include "formats/mesh/gltf_module.h"

namespace
{

const char *decode_meshopt(const gltf_meshopt *view)
{
    int failed = 0;
    switch (view->mode) {
    case GLTF_MESHOPT_ATTRIBUTES:
        failed =
            meshopt_decodeVertexBuffer(view->to, view->count, view->stride, view->from, view->size);
        break;
    case GLTF_MESHOPT_TRIANGLES:
        failed =
            meshopt_decodeIndexBuffer(view->to, view->count, view->stride, view->from, view->size);
        break;
    case GLTF_MESHOPT_INDICES:
        failed = meshopt_decodeIndexSequence(view->to, view->count, view->stride, view->from,
                                             view->size);
        break;
    }
    if (failed)
        return "meshoptimizer cannot decode it";
    if (view->filter == GLTF_MESHOPT_OCTAHEDRAL)
        meshopt_decodeFilterOct(view->to, view->count, view->stride);
    if (view->filter == GLTF_MESHOPT_QUATERNION)
        meshopt_decodeFilterQuat(view->to, view->count, view->stride);
    if (view->filter == GLTF_MESHOPT_EXPONENTIAL)
        meshopt_decodeFilterExp(view->to, view->count, view->stride);
    return nullptr;
}

// ---- Draco ----

template <typename T>
bool copy_values(const draco::PointAttribute &from, uint64_t points, uint32_t components,
                 uint8_t *to)
{
    T values[4] = {};
    for (uint64_t i = 0; i < points; i++, to += components * sizeof(T)) {
        const auto index = from.mapped_index(draco::PointIndex(uint32_t(i)));
        if (index.value() >= from.size() ||
            !from.ConvertValue<T>(index, int8_t(components), values))
            return false;
        std::memcpy(to, values, components * sizeof(T));
    }
    return true;
}

bool copy_attribute(const draco::Mesh &mesh, const gltf_draco_output &out)
{
    const draco::PointAttribute *from = mesh.GetAttributeByUniqueId(out.id);
    if (!from)
        return false;
    const uint64_t points = mesh.num_points();
    switch (out.type) {
    case 5120:
        return copy_values<int8_t>(*from, points, out.components, out.to);
    case 5121:
        return copy_values<uint8_t>(*from, points, out.components, out.to);
    case 5122:
        return copy_values<int16_t>(*from, points, out.components, out.to);
    case 5123:
        return copy_values<uint16_t>(*from, points, out.components, out.to);
    case 5125:
        return copy_values<uint32_t>(*from, points, out.components, out.to);
    default:
        return copy_values<float>(*from, points, out.components, out.to);
    }
}

void copy_indices(const draco::Mesh &mesh, uint8_t *to)
{
    for (uint32_t i = 0; i < mesh.num_faces(); i++)
        for (int k = 0; k < 3; k++, to += sizeof(uint32_t)) {
            const uint32_t index = mesh.face(draco::FaceIndex(i))[size_t(k)].value();
            std::memcpy(to, &index, sizeof index);
        }
}

const char *decode_mesh(const gltf_draco *task)
{
    draco::DecoderBuffer buffer;
    buffer.Init(reinterpret_cast<const char *>(task->from), task->size);
    draco::Decoder decoder;
    auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
    if (!decoded.ok())
        return "Draco cannot decode it";
    const std::unique_ptr<draco::Mesh> mesh = std::move(decoded).value();
    if (mesh->num_points() != task->points || mesh->num_faces() != task->faces)
        return "its compressed mesh has other counts of vertices or triangles";
    for (uint32_t i = 0; i < task->output_count; i++) {
        if (task->outputs[i].indices)
            copy_indices(*mesh, task->outputs[i].to);
        else if (!copy_attribute(*mesh, task->outputs[i]))
            return "its compressed mesh lacks an attribute";
    }
    return nullptr;
}

const char *decode_draco(const gltf_draco *task)
{
    try {
        return decode_mesh(task);
    } catch (const std::bad_alloc &) {
        return "there is no memory to decode it";
    } catch (...) {
        return "Draco cannot decode it";
    }
}

} // namespace

extern "C" const struct fmt_gltf_module bisque_module;
const struct fmt_gltf_module bisque_module = {{fmt_module_stamp}, decode_meshopt, decode_draco};

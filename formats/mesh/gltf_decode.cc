// gltf_decode.cc - the program bisque-gltf, which decompresses blocks of glTF files by
// meshoptimizer and Draco.
//
// gltf_packed.c runs it: damaged data make Draco take any amount of memory and time. So it has
// limits of both, and can open no file. gltf_task.h describes its standard input and output.
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <vector>

#include <draco/compression/decode.h>
#include <draco/core/decoder_buffer.h>
#include <meshoptimizer.h>

#include <unistd.h>

#include "formats/mesh/gltf_task.h"

namespace
{

// Decode a block of a file into its task's number of bytes. Return NULL, or what is wrong.

const char *decode_meshopt(const gltf_packed &view, const uint8_t *from, uint8_t *to)
{
    int failed = 0;
    switch (view.mode) {
    case GLTF_MESHOPT_ATTRIBUTES:
        failed = meshopt_decodeVertexBuffer(to, view.count, view.stride, from, view.size);
        break;
    case GLTF_MESHOPT_TRIANGLES:
        failed = meshopt_decodeIndexBuffer(to, view.count, view.stride, from, view.size);
        break;
    case GLTF_MESHOPT_INDICES:
        failed = meshopt_decodeIndexSequence(to, view.count, view.stride, from, view.size);
        break;
    }
    if (failed)
        return "meshoptimizer cannot decode it";
    if (view.filter == GLTF_MESHOPT_OCTAHEDRAL)
        meshopt_decodeFilterOct(to, view.count, view.stride);
    if (view.filter == GLTF_MESHOPT_QUATERNION)
        meshopt_decodeFilterQuat(to, view.count, view.stride);
    if (view.filter == GLTF_MESHOPT_EXPONENTIAL)
        meshopt_decodeFilterExp(to, view.count, view.stride);
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

bool copy_attribute(const draco::Mesh &mesh, const gltf_draco_output &out, uint8_t *to)
{
    const draco::PointAttribute *from = mesh.GetAttributeByUniqueId(out.id);
    // glTF has no booleans, and damaged ones would be read as other bytes than 0 and 1.
    if (!from || from->data_type() == draco::DT_BOOL)
        return false;
    const uint64_t points = mesh.num_points();
    switch (out.type) {
    case 5120:
        return copy_values<int8_t>(*from, points, out.components, to);
    case 5121:
        return copy_values<uint8_t>(*from, points, out.components, to);
    case 5122:
        return copy_values<int16_t>(*from, points, out.components, to);
    case 5123:
        return copy_values<uint16_t>(*from, points, out.components, to);
    case 5125:
        return copy_values<uint32_t>(*from, points, out.components, to);
    default:
        return copy_values<float>(*from, points, out.components, to);
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

const char *decode_mesh(const gltf_packed &task, const uint8_t *from, uint8_t *to)
{
    draco::DecoderBuffer buffer;
    buffer.Init(reinterpret_cast<const char *>(from), task.size);
    draco::Decoder decoder;
    auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
    if (!decoded.ok())
        return "Draco cannot decode it";
    const std::unique_ptr<draco::Mesh> mesh = std::move(decoded).value();
    if (mesh->num_points() != task.points || mesh->num_faces() != task.faces)
        return "its compressed mesh has other counts of vertices or triangles";
    for (uint32_t i = 0; i < task.output_count; i++) {
        if (task.outputs[i].indices)
            copy_indices(*mesh, to);
        else if (!copy_attribute(*mesh, task.outputs[i], to))
            return "its compressed mesh lacks an attribute";
        to += task.outputs[i].bytes;
    }
    return nullptr;
}

const char *decode_draco(const gltf_packed &task, const uint8_t *from, uint8_t *to)
{
    try {
        return decode_mesh(task, from, to);
    } catch (...) {
        return "Draco cannot decode it";
    }
}

// ---- tasks ----

// Decodes a block, and writes what it becomes.
void run(const gltf_packed &task, const uint8_t *from)
{
    std::vector<uint8_t> out(task.bytes);
    const char *wrong = task.is_draco ? decode_draco(task, from, out.data())
                                      : decode_meshopt(task, from, out.data());
    const std::string list = task.is_draco ? "meshes[" : "bufferViews[";
    if (wrong)
        fmt_program_refuse(BSQ_EDATA, (list + std::to_string(task.number) + "]: " + wrong).c_str());
    for (size_t done = 0; done < out.size();) {
        const ssize_t count = write(STDOUT_FILENO, &out[done], out.size() - done);
        if (count <= 0)
            _exit(-BSQ_EIO);
        done += size_t(count);
    }
}

// Does all tasks of an input.
void run_all(const uint8_t *input, size_t size)
{
    gltf_packed task = {};
    for (size_t at = 0; at + sizeof task <= size;) {
        std::memcpy(&task, input + at, sizeof task);
        at += sizeof task;
        if (task.size > size - at)
            _exit(-BSQ_EUSAGE);
        run(task, input + at);
        at += task.size;
    }
}

} // namespace

// Ends without destructors.
int main(int argument_count, char **arguments)
{
    fmt_program_input input;
    fmt_program_begin(argument_count, arguments, 0, 0, &input);
    std::set_new_handler([] { _exit(-BSQ_ENOMEM); });
    run_all(input.bytes, input.size);
    _exit(0);
}

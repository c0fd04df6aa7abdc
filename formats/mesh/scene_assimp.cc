// scene_assimp.cc - the program bisque-scene, which reads meshes of many formats by Assimp.
//
// scene_reader.c runs it: damaged files make Assimp crash, loop, or take any amount of memory. So
// it has limits of memory and time, and can open no file: what the file refers to is never read.
// The file is its standard input, and what scene_file.h describes its standard output.
#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include <sys/resource.h>
#include <unistd.h>

#include <assimp/Importer.hpp>
#include <assimp/config.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include "formats/mesh/scene_file.h"

namespace
{

// ---- places of meshes ----

struct Matrix {
    double m[3][4];
};

Matrix multiply(const Matrix &a, const aiMatrix4x4 &b)
{
    Matrix out;
    for (unsigned i = 0; i < 3; i++)
        for (unsigned k = 0; k < 4; k++)
            out.m[i][k] = a.m[i][0] * double(b[0][k]) + a.m[i][1] * double(b[1][k]) +
                          a.m[i][2] * double(b[2][k]) + (k == 3 ? a.m[i][3] : 0);
    return out;
}

// Returns the product of a vector and a row of a matrix without its translation.
double multiply(const double *row, const aiVector3D &v)
{
    return row[0] * double(v.x) + row[1] * double(v.y) + row[2] * double(v.z);
}

struct Place {
    const aiMesh *mesh;
    Matrix matrix;
    const aiNode *node;
};

// Returns how the axes and the unit of an FBX file become x to the right, y upwards, and metres, as
// Assimp does for other formats. Its factor counts in centimetres.
Matrix find_axes(const aiMetadata *data)
{
    static const char *const names[] = {"CoordAxis", "UpAxis", "FrontAxis"};
    Matrix out = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}}, turned = {};
    float unit = 0;
    int used = 0;
    for (int i = 0; data && i < 3; i++) {
        int32_t axis = 0, sign = 0;
        if (data->Get(names[i], axis) && data->Get(std::string(names[i]) + "Sign", sign) &&
            axis >= 0 && axis < 3 && (sign == 1 || sign == -1)) {
            turned.m[i][axis] = sign;
            used |= 1 << axis;
        }
    }
    if (used == 7)
        out = turned;
    if (data && data->Get("UnitScaleFactor", unit) && std::isfinite(unit) && unit > 0)
        for (auto &row : out.m)
            std::transform(row, row + 3, row,
                           [=](double value) { return value * double(unit) / 100; });
    return out;
}

// Returns the meshes, node by node.
std::vector<Place> find_places(const aiScene &scene)
{
    std::vector<Place> places;
    std::vector<std::pair<const aiNode *, Matrix>> stack;
    if (scene.mRootNode)
        stack.emplace_back(scene.mRootNode, find_axes(scene.mMetaData));
    while (!stack.empty()) {
        const aiNode *node = stack.back().first;
        const Matrix matrix = multiply(stack.back().second, node->mTransformation);
        stack.pop_back();
        for (unsigned i = 0; i < node->mNumMeshes; i++)
            if (node->mMeshes[i] < scene.mNumMeshes)
                places.push_back({scene.mMeshes[node->mMeshes[i]], matrix, node});
        for (unsigned i = node->mNumChildren; i-- > 0;)
            stack.emplace_back(node->mChildren[i], matrix);
    }
    return places;
}

// ---- text ----

// Appends numbers, each after a blank, so that they are read as they are.
template <typename Number, size_t count>
void put_numbers(std::string &line, const Number (&numbers)[count])
{
    char text[32];
    for (const Number number : numbers)
        line.append(" ").append(text, std::to_chars(text, text + sizeof text, number).ptr);
}

// Returns a name as the rest of a line.
std::string name_text(const aiString &name)
{
    std::string text = name.C_Str();
    for (char &c : text)
        c = (unsigned char)c < ' ' ? ' ' : c;
    if (!text.empty() && text.back() == '\\') // it would continue the line
        text.back() = '/';
    return text;
}

void put(FILE *to, const std::string &text)
{
    fwrite(text.data(), 1, text.size(), to);
}

// ---- materials ----

struct Material {
    bool textured, has_diffuse;
    float diffuse[3]; // 0.8 if there is none
};

// What is written before the meshes.
struct Output {
    fmt_scene_head head;
    std::vector<Material> materials;
    std::string material_text;
    bool has_colors; // of vertices
};

// Returns the diffuse colour, unless importers made the material up for meshes without one.
Material find_diffuse(const aiMaterial &from)
{
    const std::string name = from.GetName().C_Str();
    Material to = {false, false, {0.8F, 0.8F, 0.8F}};
    aiColor3D color;
    to.has_diffuse = name != AI_DEFAULT_MATERIAL_NAME && name != "%%%DEFAULT" &&
                     from.Get(AI_MATKEY_COLOR_DIFFUSE, color) == aiReturn_SUCCESS &&
                     std::isfinite(color.r) && std::isfinite(color.g) && std::isfinite(color.b);
    for (unsigned k = 0; k < 3 && to.has_diffuse; k++)
        to.diffuse[k] = float(color[k]);
    return to;
}

// Describes the diffuse texture, and how it moves texture coordinates. Returns whether there is one
// in another file.
bool put_texture(const aiMaterial &from, Output &out)
{
    aiString name;
    aiUVTransform transform;
    unsigned type = aiTextureType_DIFFUSE, set = 0;
    if (from.GetTextureCount(aiTextureType_DIFFUSE) == 0)
        type = aiTextureType_BASE_COLOR;
    if (from.Get(AI_MATKEY_TEXTURE(type, 0), name) != aiReturn_SUCCESS || name.length == 0)
        return false;
    if (name.data[0] == '*') { // the number of an embedded texture
        out.head.inner_textures++;
        return false;
    }
    from.Get(AI_MATKEY_UVWSRC(type, 0), set);
    from.Get(AI_MATKEY_UVTRANSFORM(type, 0), transform);
    const float scale[] = {float(transform.mScaling.x), float(transform.mScaling.y), 1},
                offset[] = {float(transform.mTranslation.x), float(transform.mTranslation.y), 0};
    out.head.turned_textures += set != 0 || transform.mRotation != 0;
    out.material_text += "map_Kd";
    if (std::isfinite(scale[0] + scale[1] + offset[0] + offset[1])) {
        put_numbers(out.material_text += " -s", scale);
        put_numbers(out.material_text += " -o", offset);
    }
    out.material_text += " " + name_text(name) + "\n";
    return true;
}

void put_material(const aiMaterial &from, Output &out)
{
    Material material = find_diffuse(from);
    float inside[3];
    for (int k = 0; k < 3; k++)
        inside[k] = std::min(std::max(material.diffuse[k], 0.0F), 1.0F);
    out.material_text += "newmtl " + name_text(from.GetName()) + "\n";
    if (material.has_diffuse)
        put_numbers(out.material_text += "Kd", inside);
    out.material_text += "\n";
    material.textured = put_texture(from, out);
    out.materials.push_back(material);
}

// ---- meshes ----

// Counts a mesh, and checks its indices. A diffuse colour is one of the vertices if others have
// colours.
void count_mesh(const aiMesh &mesh, Output &out)
{
    const Material *material =
        mesh.mMaterialIndex < out.materials.size() ? &out.materials[mesh.mMaterialIndex] : nullptr;
    const bool textured = material && material->textured;
    out.head.hidden_colors += mesh.HasVertexColors(0) && textured && mesh.HasTextureCoords(0);
    out.head.clamped_colors += !out.has_colors && material && !textured &&
                               std::any_of(material->diffuse, material->diffuse + 3,
                                           [](float v) { return v < 0 || v > 1; });
    for (unsigned f = 0; f < mesh.mNumFaces; f++)
        for (unsigned i = 0; i < mesh.mFaces[f].mNumIndices; i++)
            if (mesh.mFaces[f].mIndices[i] >= mesh.mNumVertices)
                throw std::runtime_error("a face refers to a vertex that does not exist");
}

// A mesh without colours has that of its material.
void put_color(std::string &line, const aiMesh &mesh, unsigned v, const Output &out)
{
    float color[3] = {1, 1, 1};
    if (mesh.HasVertexColors(0)) {
        const aiColor4D &c = mesh.mColors[0][v];
        color[0] = float(c.r), color[1] = float(c.g), color[2] = float(c.b);
    } else if (mesh.mMaterialIndex < out.materials.size() &&
               out.materials[mesh.mMaterialIndex].has_diffuse) {
        std::copy_n(out.materials[mesh.mMaterialIndex].diffuse, 3, color);
    }
    put_numbers(line, color);
}

// Writes positions with colours, texture coordinates and normals.
void write_vertices(FILE *to, const Place &place, const Output &out)
{
    const aiMesh &mesh = *place.mesh;
    const auto &m = place.matrix.m;
    double n[3][3];
    fmt_invert_for_normals(m, n);
    for (unsigned v = 0; v < mesh.mNumVertices; v++) {
        std::string line = "v";
        double position[3];
        for (int k = 0; k < 3; k++)
            position[k] = multiply(m[k], mesh.mVertices[v]) + m[k][3];
        put_numbers(line, position);
        if (out.has_colors)
            put_color(line, mesh, v, out);
        if (mesh.HasTextureCoords(0)) {
            const aiVector3D &from = mesh.mTextureCoords[0][v];
            const float texcoord[] = {float(from.x), float(from.y)};
            put_numbers(line += "\nvt", texcoord);
        }
        float normal[3];
        for (int k = 0; k < 3 && mesh.HasNormals(); k++) {
            const double value = multiply(n[k], mesh.mNormals[v]);
            normal[k] = std::fabs(value) < 3e38 ? float(value) : NAN;
        }
        if (mesh.HasNormals())
            put_numbers(line += "\nvn", normal);
        put(to, line += "\n");
    }
}

// Returns the name of a node or, if it has none, of its mesh.
const aiString &name_of(const Place &place)
{
    const char *name = place.node->mName.C_Str(), *made_up = "$ColladaAutoName$";
    const bool named = *name != 0 && std::strncmp(name, made_up, std::strlen(made_up)) != 0;
    return named ? place.node->mName : place.mesh->mName;
}

// Writes the polygons, which are turned round if the node mirrors. first: the numbers of the mesh's
// first position, texture coordinate and normal, from 1; they move on to the next mesh.
void write_faces(FILE *to, const Place &place, uint64_t first[3])
{
    const aiMesh &mesh = *place.mesh;
    const bool has[3] = {true, mesh.HasTextureCoords(0), mesh.HasNormals()};
    double unused[3][3];
    const bool mirrored = fmt_invert_for_normals(place.matrix.m, unused);
    put(to, "o " + name_text(name_of(place)) + "\nusemtl " + std::to_string(mesh.mMaterialIndex) +
                "\n");
    for (unsigned f = 0; f < mesh.mNumFaces; f++) {
        const aiFace &face = mesh.mFaces[f];
        const unsigned size = face.mNumIndices;
        std::string line = "f";
        for (unsigned i = 0; i < size; i++)
            for (int k = 0; k < 3; k++) {
                line += k == 0 ? " " : "/";
                if (has[k])
                    line +=
                        std::to_string(first[k] + face.mIndices[mirrored && i > 0 ? size - i : i]);
            }
        put(to, line += "\n");
    }
    for (int k = 0; k < 3; k++)
        first[k] += has[k] ? mesh.mNumVertices : 0;
}

void write_scene(const aiScene &scene, bool has_tangents, uint64_t memory_bytes, FILE *to)
{
    const std::vector<Place> places = find_places(scene);
    Output out = {};
    uint64_t first[3] = {1, 1, 1};
    for (const Place &place : places)
        out.has_colors |= place.mesh->HasVertexColors(0);
    for (unsigned i = 0; i < scene.mNumMaterials; i++)
        put_material(*scene.mMaterials[i], out);
    for (const Place &place : places)
        count_mesh(*place.mesh, out);
    std::strncpy(out.head.stamp, fmt_program_stamp, sizeof out.head.stamp - 1);
    out.head.memory_bytes = memory_bytes;
    out.head.material_bytes = out.material_text.size();
    out.head.has_tangents = has_tangents;
    fwrite(&out.head, sizeof out.head, 1, to);
    put(to, out.material_text);
    for (const Place &place : places)
        write_vertices(to, place, out);
    for (const Place &place : places)
        write_faces(to, place, first);
}

// ---- reading ----

// Removes the tangents of all meshes, which nothing uses: the validation refuses a mesh that has
// tangents but no bitangents. Returns whether there were any.
bool drop_tangents(const aiScene &scene)
{
    bool any = false;
    for (unsigned i = 0; i < scene.mNumMeshes; i++) {
        aiMesh *mesh = scene.mMeshes[i];
        if (!mesh)
            continue;
        any |= mesh->mTangents != nullptr;
        delete[] mesh->mTangents;
        delete[] mesh->mBitangents;
        mesh->mTangents = mesh->mBitangents = nullptr;
    }
    return any;
}

// Returns the memory that the process has taken at most, in bytes.
uint64_t peak_memory()
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return uint64_t(usage.ru_maxrss) * 1024;
}

// Reads a file whose format `suffix` tells, and writes its scene. Throws what is wrong.
void convert(const void *file, size_t size, const char *suffix, FILE *to)
{
    const uint64_t before = peak_memory();
    Assimp::Importer importer;
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_ANIMATIONS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_CAMERAS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_LIGHTS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, true);
    // Versions after 5.2.5 would turn the scene; find_axes() does.
    importer.SetPropertyBool("AI_CONFIG_IMPORT_FBX_IGNORE_UP_DIRECTION", true);
    const aiScene *scene = importer.ReadFileFromMemory(file, size, 0, suffix);
    bool has_tangents = false;
    if (scene) {
        has_tangents = drop_tangents(*scene);
        scene = importer.ApplyPostProcessing(aiProcess_ValidateDataStructure);
    }
    if (!scene)
        throw std::runtime_error(importer.GetErrorString());
    write_scene(*scene, has_tangents, peak_memory() - before, to);
}

} // namespace

// Arguments: the suffix of the format, bytes of memory, seconds of a processor. Ends without
// destructors, which need time, and may crash for damaged scenes.
int main(int argument_count, char **arguments)
{
    fmt_program_input file;
    fmt_program_begin(argument_count, arguments, 1, 0, 0, &file);
    std::set_new_handler([] { _exit(-BSQ_ENOMEM); });
    try {
        convert(file.bytes, file.size, arguments[1], stdout);
    } catch (const std::exception &error) {
        const std::string text = std::string("cannot be read: ") + error.what();
        fmt_program_refuse(BSQ_EDATA, text.substr(0, 196).c_str());
    }
    _exit(fflush(stdout) == 0 && !ferror(stdout) ? 0 : -BSQ_EIO);
}

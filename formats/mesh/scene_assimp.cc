// scene_assimp.cc - reads meshes of many formats by Assimp.
//
// Assimp sees one file, through a descriptor that is open already. For all other names it is told
// that there is no file, so what a file refers to is never opened.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <new>
#include <string>
#include <vector>

#include <assimp/IOStream.hpp>
#include <assimp/IOSystem.hpp>
#include <assimp/Importer.hpp>
#include <assimp/ProgressHandler.hpp>
#include <assimp/config.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include "formats/mesh/scene_module.h"

namespace
{

// ---- the file ----

struct Source {
    const struct fmt_host *host;
    struct bsq_ctx *ctx;
    const struct bsq_file *file;
    std::string name;
};

class Stream final : public Assimp::IOStream
{
  public:
    explicit Stream(const Source &source) : source(source)
    {
    }
    size_t Read(void *to, size_t size, size_t count) override
    {
        uint64_t got = 0;
        if (size == 0 || count > UINT64_MAX / size ||
            source.host->file_read_some(source.ctx, source.file, to, size * count, at, &got) != 0)
            return 0;
        got -= got % size;
        at += got;
        return got / size;
    }
    size_t Write(const void *, size_t, size_t) override
    {
        return 0;
    }
    aiReturn Seek(size_t offset, aiOrigin origin) override
    {
        const uint64_t from = origin == aiOrigin_SET   ? 0
                              : origin == aiOrigin_CUR ? at
                                                       : source.file->size;
        if (offset > source.file->size - std::min<uint64_t>(from, source.file->size))
            return aiReturn_FAILURE;
        at = from + offset;
        return aiReturn_SUCCESS;
    }
    size_t Tell() const override
    {
        return at;
    }
    size_t FileSize() const override
    {
        return source.file->size;
    }
    void Flush() override
    {
    }

  private:
    const Source &source;
    uint64_t at = 0;
};

class OneFile final : public Assimp::IOSystem
{
  public:
    explicit OneFile(const Source &source) : source(source)
    {
    }
    bool Exists(const char *name) const override
    {
        return source.name == name;
    }
    char getOsSeparator() const override
    {
        return '/';
    }
    Assimp::IOStream *Open(const char *name, const char *mode) override
    {
        return source.name == name && mode[0] == 'r' ? new Stream(source) : nullptr;
    }
    void Close(Assimp::IOStream *stream) override
    {
        delete stream;
    }

  private:
    const Source &source;
};

class Interruption final : public Assimp::ProgressHandler
{
  public:
    explicit Interruption(const Source &source) : source(source)
    {
    }
    bool Update(float) override
    {
        return source.host->check(source.ctx) == 0;
    }

  private:
    const Source &source;
};

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

struct Place {
    const aiMesh *mesh;
    Matrix matrix;
    const aiNode *node;
};

// Returns the meshes with triangles or polygons, node by node.
std::vector<Place> find_places(const aiScene &scene)
{
    std::vector<Place> places;
    std::vector<std::pair<const aiNode *, Matrix>> stack;
    const Matrix identity = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
    if (scene.mRootNode)
        stack.emplace_back(scene.mRootNode, identity);
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

// ---- copying ----

// Sets the inverse transpose of a matrix, times a positive number. Returns whether it mirrors.
bool invert_for_normals(const Matrix &matrix, double out[3][3])
{
    const auto &m = matrix.m;
    double determinant = 0, largest = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            out[i][k] = m[i1][k1] * m[i2][k2] - m[i1][k2] * m[i2][k1];
            largest = std::max(largest, std::fabs(out[i][k]));
        }
    for (int k = 0; k < 3; k++)
        determinant += m[0][k] * out[0][k];
    const double scale = largest > 0 ? (determinant < 0 ? -1 : 1) / largest : 1;
    for (int i = 0; i < 9; i++)
        out[i / 3][i % 3] *= scale;
    return determinant < 0;
}

void copy_vertex(const Place &place, const double normals[3][3], unsigned v, fmt_scene *out)
{
    const auto &m = place.matrix.m;
    const aiVector3D &p = place.mesh->mVertices[v];
    const uint64_t to = out->vertex_count++;
    for (int k = 0; k < 3; k++) {
        out->positions[to][k] =
            m[k][0] * double(p.x) + m[k][1] * double(p.y) + m[k][2] * double(p.z) + m[k][3];
        out->normals[to][k] = 0;
    }
    out->texcoords[to][0] = out->texcoords[to][1] = 0;
    for (unsigned k = 0; k < 2 && place.mesh->HasTextureCoords(0); k++)
        out->texcoords[to][k] = double(place.mesh->mTextureCoords[0][v][k]);
    for (int k = 0; k < 3 && place.mesh->HasNormals(); k++) {
        const aiVector3D &n = place.mesh->mNormals[v];
        const double value =
            normals[k][0] * double(n.x) + normals[k][1] * double(n.y) + normals[k][2] * double(n.z);
        out->normals[to][k] = std::fabs(value) < 3e38 ? float(value) : NAN;
    }
}

// Copies polygons, turned round if the node mirrors. Returns false if an index is out of range.
bool copy_faces(const aiMesh &mesh, bool mirrored, uint64_t first_vertex, fmt_scene *out)
{
    for (unsigned f = 0; f < mesh.mNumFaces; f++) {
        const aiFace &face = mesh.mFaces[f];
        const unsigned size = face.mNumIndices;
        if (size < 3)
            continue;
        out->face_sizes[out->face_count++] = size;
        for (unsigned i = 0; i < size; i++) {
            const unsigned index = face.mIndices[mirrored && i > 0 ? size - i : i];
            if (index >= mesh.mNumVertices)
                return false;
            out->corners[out->corner_count++] = first_vertex + index;
        }
    }
    return true;
}

// Copies the colours of the vertices that copy_vertex() is about to copy.
void copy_colors(const aiMesh &mesh, fmt_scene *out)
{
    static const fmt_scene_material white = {nullptr, true, {1, 1, 1}, nullptr, {}};
    const bool known = mesh.mMaterialIndex < out->material_count;
    const fmt_scene_material &material = known ? out->materials[mesh.mMaterialIndex] : white;
    if (!mesh.HasVertexColors(0)) {
        for (unsigned v = 0; v < mesh.mNumVertices; v++)
            std::copy_n(material.has_diffuse ? material.diffuse : white.diffuse, 3,
                        out->colors[out->vertex_count + v]);
        return;
    }
    out->hidden_colors += material.texture && mesh.HasTextureCoords(0);
    for (unsigned v = 0; v < mesh.mNumVertices; v++) {
        const aiColor4D &c = mesh.mColors[0][v];
        const float values[3] = {float(c.r), float(c.g), float(c.b)};
        std::copy_n(values, 3, out->colors[out->vertex_count + v]);
    }
}

bool copy_place(const Place &place, fmt_scene *out)
{
    double normals[3][3];
    const bool mirrored = invert_for_normals(place.matrix, normals);
    const uint64_t first = out->vertex_count;
    out->parts[out->part_count++] = {first,
                                     out->face_count,
                                     out->corner_count,
                                     place.mesh->mMaterialIndex,
                                     place.mesh->HasNormals(),
                                     place.mesh->HasTextureCoords(0),
                                     nullptr};
    if (out->colors)
        copy_colors(*place.mesh, out);
    for (unsigned v = 0; v < place.mesh->mNumVertices; v++)
        copy_vertex(place, normals, v, out);
    return copy_faces(*place.mesh, mirrored, first, out);
}

int copy_name(const Source &s, const aiString &name, char **out)
{
    const size_t size = std::strlen(name.C_Str()) + 1;
    const int status = s.host->alloc(s.ctx, "names", size, 1, out);
    if (status == 0)
        std::memcpy(*out, name.C_Str(), size);
    return status;
}

// Returns the name of a node or, if it has none, of its mesh.
const aiString &name_of(const Place &place)
{
    const char *name = place.node->mName.C_Str(), *made_up = "$ColladaAutoName$";
    const bool named = *name != 0 && std::strncmp(name, made_up, std::strlen(made_up)) != 0;
    return named ? place.node->mName : place.mesh->mName;
}

// Copies the diffuse colour, unless importers made the material up for meshes without one.
void copy_diffuse(const aiMaterial &from, fmt_scene_material *to)
{
    const std::string name = from.GetName().C_Str();
    aiColor3D color;
    std::fill_n(to->diffuse, 3, 0.8F);
    to->has_diffuse = name != AI_DEFAULT_MATERIAL_NAME && name != "%%%DEFAULT" &&
                      from.Get(AI_MATKEY_COLOR_DIFFUSE, color) == aiReturn_SUCCESS &&
                      std::isfinite(color.r) && std::isfinite(color.g) && std::isfinite(color.b);
    for (unsigned k = 0; k < 3 && to->has_diffuse; k++)
        to->diffuse[k] = float(color[k]);
}

// Copies the name of the diffuse texture, and how it moves texture coordinates.
int copy_texture(const Source &s, const aiMaterial &from, fmt_scene_material *to, fmt_scene *out)
{
    aiString name;
    aiUVTransform transform;
    unsigned type = aiTextureType_DIFFUSE, set = 0;
    if (from.GetTextureCount(aiTextureType_DIFFUSE) == 0)
        type = aiTextureType_BASE_COLOR;
    if (from.Get(AI_MATKEY_TEXTURE(type, 0), name) != aiReturn_SUCCESS || name.length == 0)
        return 0;
    if (name.data[0] == '*') { // the number of an embedded texture
        out->inner_textures++;
        return 0;
    }
    from.Get(AI_MATKEY_UVWSRC(type, 0), set);
    from.Get(AI_MATKEY_UVTRANSFORM(type, 0), transform);
    const aiVector2D &scale = transform.mScaling, &offset = transform.mTranslation;
    if (std::isfinite(scale.x) && std::isfinite(scale.y) && std::isfinite(offset.x) &&
        std::isfinite(offset.y))
        to->uv = {scale.x != 1 || scale.y != 1 || offset.x != 0 || offset.y != 0,
                  {float(scale.x), float(scale.y)},
                  {float(offset.x), float(offset.y)}};
    out->turned_textures += set != 0 || transform.mRotation != 0;
    return copy_name(s, name, &to->texture);
}

int copy_materials(const Source &s, const aiScene &scene, fmt_scene *out)
{
    int status = 0;
    for (unsigned i = 0; i < scene.mNumMaterials && status == 0; i++) {
        const aiMaterial &from = *scene.mMaterials[i];
        fmt_scene_material material = {};
        copy_diffuse(from, &material);
        status = copy_name(s, from.GetName(), &material.name);
        if (status == 0)
            status = copy_texture(s, from, &material, out);
        out->materials[out->material_count++] = material;
    }
    return status;
}

int copy_objects(const Source &s, const std::vector<Place> &places, fmt_scene *out)
{
    int status = 0;
    for (size_t i = 0; i < places.size() && status == 0; i++)
        status = copy_name(s, name_of(places[i]), &out->parts[i].object);
    return status;
}

int allocate(const Source &s, const aiScene &scene, const std::vector<Place> &places,
             fmt_scene *out)
{
    uint64_t vertices = 0, faces = 0, corners = 0;
    bool colored = false;
    for (const Place &place : places) {
        colored |= place.mesh->HasVertexColors(0);
        vertices += place.mesh->mNumVertices;
        for (unsigned f = 0; f < place.mesh->mNumFaces; f++) {
            const unsigned size = place.mesh->mFaces[f].mNumIndices;
            faces += size > 2;
            corners += size > 2 ? size : 0;
            out->short_faces += size <= 2;
        }
    }
    const struct {
        uint64_t count, size;
        void *to;
    } arrays[] = {{vertices, sizeof *out->positions, &out->positions},
                  {vertices, sizeof *out->texcoords, &out->texcoords},
                  {vertices, sizeof *out->normals, &out->normals},
                  {faces, sizeof *out->face_sizes, &out->face_sizes},
                  {corners, sizeof *out->corners, &out->corners},
                  {places.size() + 1, sizeof *out->parts, &out->parts},
                  {scene.mNumMaterials, sizeof *out->materials, &out->materials}};
    int status = 0;
    for (const auto &array : arrays)
        if (status == 0)
            status = s.host->alloc(s.ctx, "a scene", array.count + 1, array.size, array.to);
    if (status == 0 && colored)
        status = s.host->alloc(s.ctx, "a scene", vertices, sizeof *out->colors, &out->colors);
    return status;
}

int copy_scene(const Source &s, const aiScene &scene, fmt_scene *out)
{
    const std::vector<Place> places = find_places(scene);
    int status = allocate(s, scene, places, out);
    if (status == 0)
        status = copy_materials(s, scene, out);
    for (const Place &place : places) {
        if (status == 0)
            status = s.host->check(s.ctx);
        if (status == 0 && !copy_place(place, out))
            status = s.host->fail(s.ctx, BSQ_EDATA,
                                  "%s: a face refers to a vertex that does not "
                                  "exist",
                                  s.file->path);
    }
    if (status != 0)
        return status;
    out->parts[out->part_count] = {
        out->vertex_count, out->face_count, out->corner_count, 0, false, false, nullptr};
    return copy_objects(s, places, out);
}

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

int import(const Source &s, fmt_scene *out)
{
    Assimp::Importer importer;
    Interruption interruption(s);
    importer.SetIOHandler(new OneFile(s));
    importer.SetProgressHandler(&interruption);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_ANIMATIONS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_CAMERAS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_LIGHTS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, true);
    const aiScene *scene = importer.ReadFile(s.name, 0);
    if (scene) {
        out->has_tangents = drop_tangents(*scene);
        scene = importer.ApplyPostProcessing(aiProcess_ValidateDataStructure);
    }
    std::string reason = importer.GetErrorString();
    importer.SetProgressHandler(nullptr);
    int status = s.host->check(s.ctx);
    std::replace_if(
        reason.begin(), reason.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
    if (status == 0 && !scene)
        status = s.host->fail(s.ctx, BSQ_EDATA, "%s: cannot be read: %.200s", s.file->path,
                              reason.c_str());
    return status != 0 ? status : copy_scene(s, *scene, out);
}

int read_scene(const struct fmt_host *host, struct bsq_ctx *ctx, const struct bsq_file *file,
               const char *name, struct fmt_scene *out)
{
    try {
        return import({host, ctx, file, name}, out);
    } catch (const std::bad_alloc &) {
        return host->fail(ctx, BSQ_ENOMEM, "%s: no memory to read it", file->path);
    } catch (const std::exception &error) {
        return host->fail(ctx, BSQ_EDATA, "%s: cannot be read: %.200s", file->path, error.what());
    }
}

} // namespace

extern "C" const struct fmt_scene_module bisque_module;
const struct fmt_scene_module bisque_module = {{fmt_module_stamp}, read_scene};

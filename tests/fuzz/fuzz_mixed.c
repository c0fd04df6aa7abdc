/* fuzz_mixed.c - fuzz target for scans from several files, of any formats. The input has up to four
 * files, with the line "#next" between them. Numbers of batches, elements and materials must go on
 * from file to file, and a second reading must give the same batches. */
#include "tests/fuzz/fuzz_file.h"

#include <string.h>
#include <xxhash.h>

#include "formats/mesh/mesh_reader.h"

static const char separator[] = "\n#next\n";
static uint32_t path_count;
static bool moved;

/* What one reading has delivered. */
struct reading {
    struct fmt_mesh_totals sum;
    uint64_t batches, hash;
    uint32_t file, materials; /* of the last batch; 1 + the largest number */
};

static void add(struct reading *r, const void *bytes, uint64_t size)
{
    if (bytes && size > 0)
        r->hash = XXH3_64bits_withSeed(bytes, size, r->hash);
}

static void use_material(struct reading *r, uint32_t material)
{
    if (material != FMT_MESH_NO_MATERIAL && material >= r->materials)
        r->materials = material + 1;
    add(r, &material, sizeof material);
}

static void check_corners(const struct fmt_mesh_batch *batch)
{
    uint64_t corners = 0;
    for (uint64_t f = 0; f < batch->face_count; f++) {
        require(batch->face_sizes[f] >= 3, "a face has fewer than three corners");
        corners += batch->face_sizes[f];
    }
    require(corners == batch->corner_count, "faces and corners do not match");
}

static int on_batch(void *arg, const struct fmt_mesh_batch *batch)
{
    struct reading *r = arg;
    require(batch->sequence == r->batches++, "a batch is not the next one");
    require(batch->file >= r->file && batch->file < path_count, "a wrong file number");
    require(batch->vertex_base == r->sum.vertices && batch->texcoord_base == r->sum.texcoords &&
                batch->normal_base == r->sum.normals && batch->face_base == r->sum.faces,
            "elements are not numbered over the whole scan");
    check_corners(batch);
    r->file = batch->file;
    r->sum.bytes += batch->byte_size;
    r->sum.vertices += batch->vertex_count;
    r->sum.texcoords += batch->texcoord_count;
    r->sum.normals += batch->normal_count;
    r->sum.faces += batch->face_count;
    r->sum.corners += batch->corner_count;
    add(r, batch->positions, batch->vertex_count * sizeof *batch->positions);
    add(r, batch->colors, batch->vertex_count * sizeof *batch->colors);
    add(r, batch->texcoords, batch->texcoord_count * sizeof *batch->texcoords);
    add(r, batch->normals, batch->normal_count * sizeof *batch->normals);
    add(r, batch->face_sizes, batch->face_count * sizeof *batch->face_sizes);
    add(r, batch->corner_vertices, batch->corner_count * sizeof(uint64_t));
    add(r, batch->corner_texcoords, batch->corner_count * sizeof(uint64_t));
    add(r, batch->corner_normals, batch->corner_count * sizeof(uint64_t));
    use_material(r, batch->material_at_start);
    for (uint64_t i = 0; i < batch->material_change_count; i++)
        use_material(r, batch->material_changes[i].material);
    return 0;
}

static int read_once(struct fmt_mesh_reader *reader, struct reading *out)
{
    struct fmt_mesh_totals totals = {0};
    *out = (struct reading){.hash = 0};
    int status = fmt_mesh_read(reader, on_batch, out, &totals);
    if (status)
        return status;
    require(totals.vertices == out->sum.vertices && totals.texcoords == out->sum.texcoords &&
                totals.normals == out->sum.normals && totals.faces == out->sum.faces &&
                totals.corners == out->sum.corners,
            "batches do not add up to the totals");
    require(out->materials <= totals.materials, "a material is out of range");
    return 0;
}

static int read_twice(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    struct bsq_placement placements[FUZZ_MAX_FILES];
    path_count = count;
    for (uint32_t i = 0; i < count; i++)
        placements[i] = (struct bsq_placement){
            .scale = 1 + i, .up = i % 2 ? BSQ_UP_Z : BSQ_UP_KEEP, .translate = {i, 0, 3}};
    const struct fmt_mesh_inputs inputs = {
        .paths = paths, .path_count = count, .placements = moved ? placements : NULL};
    struct fmt_mesh_reader *reader = NULL;
    struct reading first, second;
    int status = fmt_mesh_open_inputs(ctx, &inputs, &reader);
    if (status == 0)
        status = read_once(reader, &first);
    if (status == 0) {
        require(read_once(reader, &second) == 0, "a second reading fails");
        require(first.hash == second.hash && first.batches == second.batches,
                "a second reading differs");
    }
    fmt_mesh_close(reader);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_input inputs[FUZZ_MAX_FILES] = {
        {.name = "1"}, {.name = "2"}, {.name = "3"}, {.name = "4"}};
    const uint8_t *end = data + size;
    uint32_t count = 0;
    moved = size % 2;
    while (count < FUZZ_MAX_FILES && data) {
        const uint8_t *next = memmem(data, (size_t)(end - data), separator, sizeof separator - 1);
        inputs[count].data = data;
        inputs[count++].size = (size_t)((next ? next : end) - data);
        data = next ? next + sizeof separator - 1 : NULL;
    }
    return fuzz_files(inputs, count, read_twice);
}

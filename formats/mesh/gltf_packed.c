/* gltf_packed.c - compressed arrays of glTF files: EXT_meshopt_compression and
 * KHR_draco_mesh_compression.
 *
 * Both are decoded whole, one after the other, before a file is read for the first time. What comes
 * out goes to a temporary file, whose blocks are then read like those of a buffer. So memory is
 * needed for one compressed view or mesh at a time.
 *
 * The program bisque-gltf decodes: a mesh of 144 bytes makes Draco take 16 GB. */
#include <inttypes.h>
#include <string.h>

#include "formats/mesh/gltf_internal.h"

/* ---- meshoptimizer ---- */

static bool find_name(const char *name, const char *const *names, int count, int *out)
{
    for (int i = 0; i < count; i++)
        if (name && strcmp(name, names[i]) == 0) {
            *out = i;
            return true;
        }
    return false;
}

/* Checks what meshoptimizer expects of its callers. */
static bool meshopt_fits(const struct gltf_packed *view)
{
    const uint32_t stride = view->stride;
    if (view->mode != GLTF_MESHOPT_ATTRIBUTES)
        return (stride == 2 || stride == 4) && view->filter == GLTF_MESHOPT_NONE &&
               (view->mode != GLTF_MESHOPT_TRIANGLES || view->count % 3 == 0);
    if (view->filter == GLTF_MESHOPT_OCTAHEDRAL)
        return stride == 4 || stride == 8;
    if (view->filter == GLTF_MESHOPT_QUATERNION)
        return stride == 8;
    return stride > 0 && stride % 4 == 0 && stride <= 256;
}

static int read_modes(const struct gltf_item *item, const json_t *object, struct gltf_packed *out)
{
    static const char *const modes[] = {"ATTRIBUTES", "TRIANGLES", "INDICES"};
    static const char *const filters[] = {"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"};
    const char *filter = fmt_gltf_string(object, "filter");
    int number = 0;
    if (!find_name(fmt_gltf_string(object, "mode"), modes, 3, &number))
        return fmt_gltf_fail(item, "unknown mode of meshoptimizer");
    out->mode = (enum gltf_meshopt_mode)number;
    if (!find_name(filter ? filter : "NONE", filters, 4, &number))
        return fmt_gltf_fail(item, "unknown filter of meshoptimizer");
    out->filter = (enum gltf_meshopt_filter)number;
    return 0;
}

/* Returns the place of `bytes` decoded bytes in the temporary file. */
static int add_decoded(const struct gltf_item *item, struct gltf_source *source, uint64_t bytes,
                       uint64_t *out)
{
    uint64_t *size = &source->decoded.extent.size;
    *out = *size;
    if (__builtin_add_overflow(*size, bytes, size) || *size > INT64_MAX)
        return fmt_gltf_fail(item, "too many bytes");
    return 0;
}

static int add_packed(const struct gltf_item *item, struct gltf_source *source,
                      const struct gltf_packed *packed)
{
    if (source->packed_count == source->packed_capacity)
        BSQ_PASS(BSQ_GROW(item->document->ctx, "compressed views",
                          (uint64_t)source->packed_count + 1, &source->packed,
                          &source->packed_capacity));
    source->packed[source->packed_count++] = *packed;
    return 0;
}

int fmt_gltf_read_packed_view(const struct gltf_item *item, struct gltf_source *source,
                              const json_t *object, struct gltf_view *view)
{
    struct gltf_packed packed = {
        .number = (uint32_t)item->index, .count = GLTF_REQUIRED, .size = GLTF_REQUIRED};
    uint64_t stride = GLTF_REQUIRED;
    BSQ_PASS(fmt_gltf_index(item, object, "buffer", "buffers", &packed.buffer));
    BSQ_PASS(fmt_gltf_number(item, object, "byteOffset", INT64_MAX / 4, &packed.offset));
    BSQ_PASS(fmt_gltf_number(item, object, "byteLength", INT64_MAX / 4, &packed.size));
    BSQ_PASS(fmt_gltf_number(item, object, "byteStride", 256, &stride));
    BSQ_PASS(fmt_gltf_number(item, object, "count", INT64_MAX / 4096, &packed.count));
    BSQ_PASS(read_modes(item, object, &packed));
    packed.stride = (uint32_t)stride;
    packed.bytes = packed.count * stride;
    if (!meshopt_fits(&packed))
        return fmt_gltf_fail(item, "a stride or count that meshoptimizer cannot decode");
    /* The encoding takes a quarter of a byte for 16 bytes at least. */
    if (packed.bytes != view->size || packed.bytes / 64 > packed.size)
        return fmt_gltf_fail(item, "%" PRIu64 " compressed bytes cannot hold %" PRIu64, packed.size,
                             view->size);
    const uint64_t bytes = packed.buffer == GLTF_NONE || source->buffers[packed.buffer].missing
                               ? 0
                               : source->buffers[packed.buffer].extent.size;
    if (packed.offset > bytes || packed.size > bytes - packed.offset)
        return fmt_gltf_fail(item, "its compressed bytes are outside of their buffer");
    view->buffer = GLTF_NONE;
    BSQ_PASS(add_decoded(item, source, packed.bytes, &view->offset));
    return add_packed(item, source, &packed);
}

/* ---- Draco ---- */

/* A byte holds this many vertices or triangles at most. A plane of two million triangles, the best
 * case, takes a byte for 500 of them; larger planes take less. */
enum { DRACO_ELEMENTS_PER_BYTE = 65536 };

/* Checks the counts of a compressed mesh before memory is reserved for them. */
static int check_counts(const struct gltf_item *item, const struct gltf_packed *mesh)
{
    const uint64_t count = mesh->points > mesh->faces ? mesh->points : mesh->faces;
    if (count <= UINT32_MAX && count / DRACO_ELEMENTS_PER_BYTE <= mesh->size)
        return 0;
    return fmt_gltf_fail(item, "%" PRIu64 " compressed bytes cannot hold %" PRIu64 " %s",
                         mesh->size, count, mesh->points > mesh->faces ? "vertices" : "triangles");
}

/* Adds a view for the elements of an accessor. */
static int add_view(const struct gltf_item *item, struct gltf_source *source, uint32_t number,
                    uint32_t component_bytes)
{
    struct gltf_accessor *accessor = &source->accessors[number];
    struct gltf_view view = {.buffer = GLTF_NONE};
    if (source->view_count == GLTF_NONE - 1 ||
        __builtin_mul_overflow(accessor->count, (uint64_t)accessor->components * component_bytes,
                               &view.size))
        return fmt_gltf_fail(item, "too many elements");
    if (source->view_count == source->view_capacity)
        BSQ_PASS(BSQ_GROW(item->document->ctx, "glTF views", (uint64_t)source->view_count + 1,
                          &source->views, &source->view_capacity));
    BSQ_PASS(add_decoded(item, source, view.size, &view.offset));
    accessor->view = source->view_count;
    accessor->offset = 0;
    source->views[source->view_count++] = view;
    return 0;
}

/* Adds an attribute, or the indices, to what is decoded, unless the file has it uncompressed. */
static int add_output(const struct gltf_item *item, struct gltf_source *source, uint32_t accessor,
                      const json_t *attributes, const char *key, struct gltf_packed *mesh)
{
    struct gltf_accessor *a = &source->accessors[accessor];
    uint64_t id = GLTF_REQUIRED;
    if (accessor == GLTF_NONE || a->view != GLTF_NONE || (key && !json_object_get(attributes, key)))
        return 0;
    BSQ_PASS(key ? fmt_gltf_number(item, attributes, key, UINT32_MAX, &id) : 0);
    if (!key)
        a->component = GLTF_UINT32;
    const uint32_t each = fmt_gltf_component_bytes(a->component);
    const uint64_t bytes = a->count * a->components * each;
    mesh->outputs[mesh->output_count++] = (struct gltf_draco_output){.indices = !key,
                                                                     .id = key ? (uint32_t)id : 0,
                                                                     .components = a->components,
                                                                     .type = (uint32_t)a->component,
                                                                     .bytes = bytes};
    mesh->bytes += bytes;
    return add_view(item, source, accessor, each);
}

int fmt_gltf_read_draco(const struct gltf_item *item, struct gltf_source *source,
                        const json_t *object, const char *const keys[GLTF_USE_COUNT],
                        struct gltf_primitive *p)
{
    const json_t *draco = fmt_gltf_extension(object, "KHR_draco_mesh_compression");
    const json_t *attributes = json_object_get(draco, "attributes");
    const struct gltf_accessor *positions = gltf_accessor_of(source, p, GLTF_POSITION);
    const struct gltf_accessor *indices = gltf_accessor_of(source, p, GLTF_INDEX);
    struct gltf_packed packed = {.is_draco = true, .number = p->mesh};
    uint32_t view;
    if (!draco || !positions || !indices)
        return 0;
    BSQ_PASS(fmt_gltf_index(item, draco, "bufferView", "bufferViews", &view));
    if (view == GLTF_NONE || source->views[view].buffer == GLTF_NONE)
        return fmt_gltf_fail(item, "a compressed mesh without bufferView");
    packed.points = positions->count;
    packed.faces = indices->count / 3;
    packed.buffer = source->views[view].buffer;
    packed.offset = source->views[view].offset;
    packed.size = source->views[view].size;
    BSQ_PASS(check_counts(item, &packed));
    for (int use = 0; use < GLTF_USE_COUNT; use++)
        BSQ_PASS(add_output(item, source, p->accessors[use], attributes, keys[use], &packed));
    if (source->views[indices->view].buffer == GLTF_NONE)
        p->mode = 4; /* strips too are compressed as single triangles */
    return packed.output_count > 0 ? add_packed(item, source, &packed) : 0;
}

/* ---- decoding ---- */

/* Processor time in seconds that decoding may take: LEAST_SECONDS for any file, and a second more
 * for each BYTES_A_SECOND of what comes out. */
enum { LEAST_SECONDS = 20, BYTES_A_SECOND = 1 << 20 };

/* Appends a block to the program's input. */
static int add_task(struct bsq_ctx *ctx, const struct gltf_source *source,
                    const struct gltf_packed *packed, struct bsq_file *input)
{
    /* What Draco may need while it decodes: about twice what version 1.5.5 took for meshes of a
     * million triangles. */
    const uint64_t draco = 64 * packed->faces + 64 * packed->points + 2 * packed->bytes;
    const uint64_t needed = packed->bytes + (packed->is_draco ? draco : 0);
    uint8_t *bytes = NULL;
    int status;
    BSQ_TRY(bsq_reserve(ctx, "decompression of a glTF file", needed));
    bsq_release(ctx, needed);
    BSQ_TRY(bsq_alloc(ctx, "a compressed part of a glTF file", packed->size, 1, &bytes));
    BSQ_TRY(fmt_gltf_read_bytes(ctx, source, packed->buffer, packed->offset, bytes, packed->size));
    BSQ_TRY(bsq_file_append(ctx, input, packed, sizeof *packed));
    BSQ_TRY(bsq_file_append(ctx, input, bytes, packed->size));
done:
    bsq_free(ctx, bytes);
    return status;
}

int fmt_gltf_unpack(struct bsq_ctx *ctx, struct gltf_source *source)
{
    struct bsq_file input = BSQ_FILE_CLOSED;
    struct bsq_file *decoded = &source->decoded.file;
    const uint64_t bytes = source->decoded.extent.size;
    const struct fmt_converter how = {.program = "bisque-gltf",
                                      .purpose = "compressed glTF files",
                                      .library = "Draco or meshoptimizer",
                                      .path = source->own.path,
                                      .seconds = LEAST_SECONDS + bytes / BYTES_A_SECOND};
    if (source->packed_count == 0 || decoded->fd >= 0)
        return 0;
    int status;
    BSQ_TRY(bsq_require_disk(ctx, NULL, bytes));
    BSQ_TRY(bsq_file_temp(ctx, NULL, "a compressed glTF file", &input));
    BSQ_TRY(bsq_file_temp(ctx, NULL, "a decompressed glTF file", decoded));
    for (uint32_t i = 0; i < source->packed_count; i++)
        BSQ_TRY(add_task(ctx, source, &source->packed[i], &input));
    BSQ_TRY(fmt_program_convert(ctx, &how, input.fd, decoded));
    if (decoded->size != bytes)
        status = fmt_program_misfit(ctx, &how);
done:
    bsq_file_close(ctx, &input);
    if (status)
        bsq_file_close(ctx, decoded);
    return status;
}

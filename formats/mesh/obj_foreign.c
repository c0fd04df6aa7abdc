/* obj_foreign.c - files that are called .obj, or given as one, and are something else. */
#include <string.h>

#include "formats/mesh/obj_internal.h"

/* First bytes, and what to say. Text is left to the parser, which names the line; but for PLY,
 * whose text ends at line ten. */
static const struct foreign {
    const char *magic;
    unsigned size;
    const char *kind, *advice;
} foreign_kinds[] = {
    {"\x1f\x8b", 2, "one packed by gzip", "unpack it first"},
    {"BZh", 3, "one packed by bzip2", "unpack it first"},
    {"\3757zXZ", 5, "one packed by xz", "unpack it first"},
    {"\x28\xb5\x2f\xfd", 4, "one packed by Zstandard", "unpack it first"},
    {"PK\x03\x04", 4, "a ZIP archive", "unpack it first"},
    {"7z\xbc\xaf\x27\x1c", 6, "a 7z archive", "unpack it first"},
    {"ply\n", 4, "a PLY file", "export the mesh as OBJ"},
    {"ply\r", 4, "a PLY file", "export the mesh as OBJ"},
    {"glTF", 4, "a glTF file", "export the mesh as OBJ"},
    {"Kaydara FBX Binary", 18, "an FBX file", "export the mesh as OBJ"},
    {"BLENDER", 7, "a Blender file", "export the mesh as OBJ"},
    {"\xff\xfe", 2, "text in UTF-16", "save it as UTF-8"},
    {"\xfe\xff", 2, "text in UTF-16", "save it as UTF-8"},
};

int fmt_obj_refuse_foreign(struct bsq_ctx *ctx, const struct bsq_file *file, const char *path)
{
    char head[32];
    uint64_t size;
    int status = bsq_file_read_some(ctx, file, head, sizeof head, 0, &size);
    if (status)
        return status;
    for (size_t i = 0; i < sizeof foreign_kinds / sizeof *foreign_kinds; i++) {
        const struct foreign *foreign = &foreign_kinds[i];
        if (size >= foreign->size && memcmp(head, foreign->magic, foreign->size) == 0)
            return bsq_fail(ctx, BSQ_EDATA, "%s: not an OBJ file, but %s: %s", path, foreign->kind,
                            foreign->advice);
    }
    return 0;
}

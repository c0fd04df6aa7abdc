/* module_internal.h - parts of formats that are opened at their first use, as they bring some 250
 * shared libraries with them: bisque-texture.so (OpenImageIO) and bisque-openvdb.so (OpenVDB).
 *
 * A module exports one object, `bisque_module`: a table of its functions, which begins with a stamp
 * that must be equal on both sides. It gets what it needs of base in a table, too. */
#ifndef FMT_MODULE_INTERNAL_H
#define FMT_MODULE_INTERNAL_H

#include "base/file.h"
#include "base/output.h"
#include "base/parallel.h"
#include "formats/grid/nvdb.h"
#include "formats/image/texture.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The functions of base that modules call: host->fail(ctx, ...) is bsq_fail(ctx, ...). */
#define FMT_HOST_FUNCTIONS(X)                                                                      \
    X(fail)                                                                                        \
    X(fail_errno)                                                                                  \
    X(check)                                                                                       \
    X(threads)                                                                                     \
    X(alloc)                                                                                       \
    X(free)                                                                                        \
    X(reserve)                                                                                     \
    X(release)                                                                                     \
    X(parallel_for)                                                                                \
    X(file_temp)                                                                                   \
    X(file_close)                                                                                  \
    X(file_read_some)                                                                              \
    X(file_write)                                                                                  \
    X(output_write_at)

struct fmt_host {
#define MEMBER(name) __typeof__(bsq_##name) *name;
    FMT_HOST_FUNCTIONS(MEMBER)
#undef MEMBER
};

extern const struct fmt_host fmt_host_functions;

/* What every module's table begins with. */
struct fmt_module {
    const char
        *stamp; /* FMT_MODULE_STAMP: the version and a checksum of the headers included here */
};

/* What textures of any module begin with; their module adds its own. */
struct fmt_textures {
    const struct fmt_texture_module *module;
};

/* The functions of texture.h. */
struct fmt_texture_module {
    struct fmt_module module;
    int (*open)(const struct fmt_host *host, struct bsq_ctx *ctx, const char *const *paths,
                uint32_t count, uint64_t cache_bytes, struct fmt_textures **out);
    void (*close)(struct fmt_textures *textures);
    void (*size)(const struct fmt_textures *textures, uint32_t image, uint32_t *width,
                 uint32_t *height);
    int (*sample)(struct fmt_textures *textures, uint32_t image, float u, float v, float du,
                  float dv, float out[3]);
};

struct fmt_vdb_module {
    struct fmt_module module;
    /* Bytes of memory that write() takes. */
    uint64_t (*memory)(const struct fmt_nvdb_grid *grid);
    /* Writes the whole file; messages name `path`. */
    int (*write)(const struct fmt_host *host, struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                 struct bsq_output *output, const char *path);
};

/* Opens the module bisque-NAME.so, for good; opening it again is cheap. `purpose` begins the
 * message where that fails: "textures need ...". Thread-safe. Errors: BSQ_ENOINPUT. */
int fmt_module_open(struct bsq_ctx *ctx, const char *name, const char *purpose,
                    const struct fmt_module **out);

/* Where modules are installed; compiled in. */
extern const char fmt_module_directory[];

#ifdef __cplusplus
}
#endif
#endif

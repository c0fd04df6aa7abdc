/* vdb_module.h - the table of the module bisque-openvdb.so, which writes OpenVDB files. */
#ifndef FMT_GRID_VDB_MODULE_H
#define FMT_GRID_VDB_MODULE_H

#include "formats/grid/nvdb.h"
#include "formats/module/module.h"

#ifdef __cplusplus
extern "C" {
#endif

struct fmt_vdb_module {
    struct fmt_module module;
    /* Returns the bytes of memory that write() needs. */
    uint64_t (*memory)(const struct fmt_nvdb_grid *grid);
    /* Writes the whole file to `output`; error messages name `path`. */
    int (*write)(const struct fmt_host *host, struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                 struct bsq_output *output, const char *path);
};

#ifdef __cplusplus
}
#endif
#endif

/** @file
 * Rules that replace the beginnings of paths, for files that lie elsewhere on this
 * machine than where their names were written.
 *
 * The rules are those of Open Job Description's pathmapping-1.0: a rule fits a path that is its
 * source or lies below it, and of several the one with the longest source is applied, once. */
#ifndef BSQ_PATH_MAP_H
#define BSQ_PATH_MAP_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/** How the source of a rule was written. */
enum bsq_path_format {
    BSQ_PATH_POSIX,   /**< "/" separates components. */
    BSQ_PATH_WINDOWS, /**< "/" and "\\" separate components; letters match in either case. */
    BSQ_PATH_URI      /**< As BSQ_PATH_POSIX, after a scheme. */
};

/** Adds a rule for all files that this context opens later by a name from a file or from
 * bsq_map_path(). Empty sources are refused. Errors: BSQ_EDATA, BSQ_ENOMEM. */
int bsq_add_path_rule(struct bsq_ctx *ctx, enum bsq_path_format format, const char *source,
                      const char *destination);

/** Returns the path that a name stands for by the rules: the name itself if none fits, else a text
 * that lives as long as the context. Returns NULL if there is no memory, which it reports.
 * Thread-safe. */
const char *bsq_map_path(struct bsq_ctx *ctx, const char *name);

#ifdef __cplusplus
}
#endif
#endif

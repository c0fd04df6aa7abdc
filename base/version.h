/** @file
 * The version of Bisque. The Makefile reads it from here. */
#ifndef BSQ_VERSION_H
#define BSQ_VERSION_H

#define BSQ_VERSION_MAJOR 0 /**< Changes without compatibility, from 1 on. */
#define BSQ_VERSION_MINOR 2 /**< New features; before 1.0 also changes without compatibility. */
#define BSQ_VERSION_PATCH 0 /**< Corrections. */

#define BSQ_VERSION_TEXT_(major, minor, patch) #major "." #minor "." #patch
#define BSQ_VERSION_TEXT(major, minor, patch)  BSQ_VERSION_TEXT_(major, minor, patch)
/** The version as a string literal: "MAJOR.MINOR.PATCH". */
#define BSQ_VERSION BSQ_VERSION_TEXT(BSQ_VERSION_MAJOR, BSQ_VERSION_MINOR, BSQ_VERSION_PATCH)

#ifdef __cplusplus
extern "C" {
#endif

/** Returns the version of the linked library, "MAJOR.MINOR.PATCH", in static storage. A program can
 * compare it with BSQ_VERSION, the version of the headers. Thread-safe. */
const char *bsq_version(void);

#ifdef __cplusplus
}
#endif
#endif

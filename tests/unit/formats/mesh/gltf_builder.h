/* gltf_builder.h - writes glTF files, for tests. */
#ifndef TEST_GLTF_BUILDER_H
#define TEST_GLTF_BUILDER_H

#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/formats/mesh/ply_builder.h"

/* JSON text is written with ' for ". "$BYTES" stands for the number of bytes of the buffer. */

/* Begins the bytes of a buffer; ply_put() appends numbers. */
void gltf_begin(struct ply_builder *bytes);
/* Writes NAME.gltf, and the bytes as NAME.bin unless `bytes` is NULL. Returns the path. */
const char *gltf_write(const char *name, const char *json, const struct ply_builder *bytes);
/* Writes NAME.glb. Returns the path. */
const char *gltf_write_glb(const char *name, const char *json, const struct ply_builder *bytes);
/* Returns the content of a GLB file; free() it. */
char *gltf_make_glb(const char *json, const struct ply_builder *bytes, size_t *size);

/* Reads a file with two threads, in parts as small as they come. Fails the test if that fails. */
void gltf_read(struct obj_fixture *f, const char *path);
/* Reads a file and checks that this fails with DIRECTORY/ and `message`. */
void gltf_expect_error(const char *path, const char *message);

#endif

/* tris_samples.h - chunk files with known content, for tests. */
#ifndef TEST_TRIS_SAMPLES_H
#define TEST_TRIS_SAMPLES_H

#include <stddef.h>
#include <stdint.h>

#include "formats/chunks/tris.h"

#define MAX_VERTICES 70000u

struct tris_sample {
    struct fmt_tris_chunk chunk;
    float positions[MAX_VERTICES][3], texcoords[MAX_VERTICES][2];
    uint32_t normals[MAX_VERTICES], colors[MAX_VERTICES], fine_colors[MAX_VERTICES];
    uint32_t triangles[FMT_TRIS_CHUNK_TRIANGLES][3], materials[FMT_TRIS_CHUNK_TRIANGLES];
};

/* The file of each test. */
#define tris_path "scan.tris"

struct tris_fixture {
    struct bsq_ctx *ctx;
    struct tris_sample *samples[2];
};

/* Make and remove a context and samples; *state is the fixture. */
int tris_setup(void **state);
int tris_teardown(void **state);

/* Fills a sample with random values. */
void tris_fill(struct tris_sample *s, uint32_t attributes, uint32_t triangles, uint32_t vertices,
               uint64_t seed);

/* Writes the first samples of a fixture as the chunks of tris_path. */
void tris_write_samples(struct tris_fixture *f, uint32_t attributes, uint32_t chunk_count);

/* Writes a file of two chunks, of 7 and 9 vertices, with made normals by angle: tris_made_normal()
 * of the chunk's number and the vertex. The second chunk has creases at vertices 1 and 8, for which
 * 2 stands for the chunk. Returns its bytes, which the caller frees. */
uint8_t *tris_write_normals(struct tris_fixture *f, size_t *size);
uint64_t tris_made_normal(uint64_t chunk, uint64_t vertex);

/* Returns a little-endian number. */
uint64_t tris_u64_at(const uint8_t *bytes, size_t at);

#endif

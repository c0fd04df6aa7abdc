/* ply_builder.h - makes PLY files of any encoding from the same calls, for tests. */
#ifndef TEST_PLY_BUILDER_H
#define TEST_PLY_BUILDER_H

#include <stddef.h>
#include <stdint.h>

enum ply_test_encoding { PLY_TEST_ASCII, PLY_TEST_LITTLE, PLY_TEST_BIG, PLY_TEST_ENCODINGS };

struct ply_builder {
    char *bytes; /* owned */
    size_t size, capacity, header_size;
    enum ply_test_encoding encoding;
};

/* Begins a file. header: the lines between "format" and "end_header". */
void ply_begin(struct ply_builder *b, enum ply_test_encoding encoding, const char *header);
/* Appends numbers, of which each letter of `types` is one: c C signed and unsigned char, s S short,
 * i I int, l L long, f float, d double. They are passed as double. */
void ply_put(struct ply_builder *b, const char *types, ...);
/* Ends an element: a line of text. */
void ply_end(struct ply_builder *b);
void ply_free(struct ply_builder *b);

#endif

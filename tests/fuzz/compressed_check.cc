// compressed_check.cc - lets a fuzz target call the decoders of bisque-gltf. It includes the
// program's source, because the program takes files.
#include "tests/fuzz/compressed_check.h"

#define main gltf_main
int gltf_main(int argument_count, char **arguments);
#include "formats/mesh/gltf_decode.cc"
#undef main

const char *decode_view(const struct gltf_packed *view, const uint8_t *from, uint8_t *to)
{
    return decode_meshopt(*view, from, to);
}

const char *decode_compressed_mesh(const struct gltf_packed *mesh, const uint8_t *from, uint8_t *to)
{
    return decode_draco(*mesh, from, to);
}

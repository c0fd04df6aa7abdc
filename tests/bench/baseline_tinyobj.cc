/* baseline_tinyobj.cc - parses an OBJ file with tinyobjloader, which many programs embed, and
 * prints the cost of parsing, without freeing. */
#include <cstdio>
#include <string>
#include <vector>

#include <tiny_obj_loader.h>

#include "tests/bench/phase.h"

int main(int argc, char **argv)
{
    if (argc != 2) {
        std::fputs("usage: baseline-tinyobj SCAN.obj\n", stderr);
        return 64;
    }
    tinyobj::attrib_t attributes;
    std::vector<tinyobj::shape_t> shapes;
    std::vector<tinyobj::material_t> materials;
    std::string warning, error;
    phase_clock clock = phase_now();
    if (!tinyobj::LoadObj(&attributes, &shapes, &materials, &warning, &error, argv[1])) {
        std::fprintf(stderr, "baseline-tinyobj: %s: %s\n", argv[1], error.c_str());
        return 65;
    }
    phase_end("parse", &clock);
    unsigned long long triangles = 0;
    for (const tinyobj::shape_t &shape : shapes)
        triangles += shape.mesh.num_face_vertices.size();
    std::printf("triangles=%llu\nvertices=%llu\n", triangles,
                static_cast<unsigned long long>(attributes.vertices.size() / 3));
    return 0;
}

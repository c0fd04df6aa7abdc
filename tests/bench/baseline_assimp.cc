/* baseline_assimp.cc - reads a mesh with Assimp, which many programs embed, and prints the cost of
 * reading, without freeing. Assimp splits polygons into triangles; nothing else is asked of it. */
#include <cstdio>

#include <assimp/Importer.hpp>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include "tests/bench/phase.h"

int main(int argc, char **argv)
{
    if (argc != 2) {
        std::fputs("usage: baseline-assimp SCAN.ply\n", stderr);
        return 64;
    }
    Assimp::Importer importer;
    phase_clock clock = phase_now();
    const aiScene *scene = importer.ReadFile(argv[1], aiProcess_Triangulate);
    if (!scene) {
        std::fprintf(stderr, "baseline-assimp: %s: %s\n", argv[1], importer.GetErrorString());
        return 65;
    }
    phase_end("parse", &clock);
    unsigned long long triangles = 0;
    for (unsigned i = 0; i < scene->mNumMeshes; i++)
        triangles += scene->mMeshes[i]->mNumFaces;
    std::printf("triangles=%llu\n", triangles);
    return 0;
}

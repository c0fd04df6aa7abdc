/* generate.c - the scan generator: writes scans of any size for tests, demos and benchmarks. */
#include "tests/scan/generate_options.h"
#include "tests/scan/mesh_writer.h"

#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "usage: generate-scan [options] vase -o FILE              analytic vase with relief\n"
    "       generate-scan [options] vase-low -o FILE          its low-poly mesh (40 x 64 quads)\n"
    "       generate-scan [options] sine -o FILE.obj          crossed sine waves on a square of side 100\n"
    "       generate-scan [options] sine-low -o FILE.obj      the square\n"
    "       generate-scan [options] SMALL.obj -o FILE         a small scan, amplified\n"
    "FILE may end in .obj or, but for the sine, in .stl, .ply (binary), .big.ply or .text.ply.\n"
    "  -n, --triangles N     about N triangles (default 2000000)\n"
    "  -c, --colors          vertex colours (vase)\n"
    "      --normals         vertex normals (vase, sine)\n"
    "      --uvs             texture coordinates (vase)\n"
    "      --tiles N         UDIM tiles side by side, at most 10 (vase-low; default 1)\n"
    "      --corners N       polygons with N corners, 3 or an even number (vase; default 3)\n"
    "      --shuffle SEED    faces in random order\n"
    "      --offset X,Y,Z    added to every position\n"
    "      --amplitude A     displacement as a share of the diagonal (default 0.002)\n"
    "      --rounded         round off the edges of the small scan\n"
    "      --wavelength W    of the sine (default 10), the longest of an amplified scan (default 0.03 diagonals)\n";

static int bad_usage(void)
{
    fputs(usage, stderr);
    return 64;
}

int main(int argc, char **argv)
{
    struct generate_options options = {
        .triangles = 2000000, .tiles = 1, .corners = 3, .amplitude = 0.002, .wavelength = 0};
    enum { NORMALS = 256, UVS, TILES, CORNERS, SHUFFLE, OFFSET, AMPLITUDE, ROUNDED, WAVELENGTH };
    static const struct option table[] = {{"triangles", 1, 0, 'n'},
                                          {"colors", 0, 0, 'c'},
                                          {"normals", 0, 0, NORMALS},
                                          {"uvs", 0, 0, UVS},
                                          {"tiles", 1, 0, TILES},
                                          {"corners", 1, 0, CORNERS},
                                          {"shuffle", 1, 0, SHUFFLE},
                                          {"offset", 1, 0, OFFSET},
                                          {"output", 1, 0, 'o'},
                                          {"amplitude", 1, 0, AMPLITUDE},
                                          {"rounded", 0, 0, ROUNDED},
                                          {"wavelength", 1, 0, WAVELENGTH},
                                          {0}};
    for (int c; (c = getopt_long(argc, argv, "n:co:", table, NULL)) != -1;) {
        switch (c) {
        case 'n':
            options.triangles = strtoull(optarg, NULL, 10);
            break;
        case 'c':
            options.colors = 1;
            break;
        case 'o':
            options.output = optarg;
            break;
        case NORMALS:
            options.normals = 1;
            break;
        case UVS:
            options.texcoords = 1;
            break;
        case TILES:
            options.tiles = (unsigned)strtoul(optarg, NULL, 10);
            break;
        case CORNERS:
            options.corners = (unsigned)strtoul(optarg, NULL, 10);
            break;
        case SHUFFLE:
            options.shuffle = 1, options.seed = strtoull(optarg, NULL, 10);
            break;
        case AMPLITUDE:
            options.amplitude = strtod(optarg, NULL);
            break;
        case ROUNDED:
            options.rounded = 1;
            break;
        case WAVELENGTH:
            options.wavelength = strtod(optarg, NULL);
            break;
        case OFFSET:
            if (sscanf(optarg, "%lf,%lf,%lf", options.offset, options.offset + 1,
                       options.offset + 2) != 3)
                return bad_usage();
            break;
        default:
            return bad_usage();
        }
    }
    if (optind + 1 != argc || !options.output || options.triangles < 1 || options.tiles < 1 ||
        options.tiles > 10 || !(options.wavelength >= 0) ||
        (options.corners != 3 && (options.corners < 4 || options.corners % 2)) ||
        (mesh_output_of(options.output) != MESH_OBJ && strncmp(argv[optind], "sine", 4) == 0) ||
        (mesh_output_of(options.output) == MESH_STL && options.corners != 3))
        return bad_usage();
    if (!strcmp(argv[optind], "vase"))
        generate_vase(&options);
    else if (!strcmp(argv[optind], "vase-low"))
        generate_vase_low(&options, 40, 64);
    else if (!strcmp(argv[optind], "sine"))
        generate_sine(&options);
    else if (!strcmp(argv[optind], "sine-low"))
        generate_sine_low(&options);
    else
        generate_amplified(&options, argv[optind]);
    return 0;
}

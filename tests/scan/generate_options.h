/* generate_options.h - what the scan generator was asked for. */
#ifndef SCAN_GENERATE_OPTIONS_H
#define SCAN_GENERATE_OPTIONS_H

#include <stdint.h>

struct generate_options {
    uint64_t triangles; /* about this many */
    int colors, normals, texcoords;
    unsigned corners; /* 3: triangles, else polygons with this even number of corners */
    int shuffle;      /* faces in random order */
    uint64_t seed;
    double offset[3]; /* added to every position: geo-referenced scans */
    double amplitude; /* amplify: height of the displacement as a share of the diagonal */
    int rounded;      /* amplify: no creases along the edges of the small scan */
    double
        wavelength; /* sine, and the longest waves of amplify: in world units; 0: the usual one */
    const char *output;
};

/* The vase: a regular grid over the analytic surface. */
void generate_vase(const struct generate_options *options);
/* The vase's body as a low mesh of nu x ns quads with texture coordinates (u, s) and normals. */
void generate_vase_low(const struct generate_options *options, unsigned nu, unsigned ns);
/* Any small scan, each triangle split into k x k and displaced along its normals. */
void generate_amplified(const struct generate_options *options, const char *input);
/* Crossed sine waves with slopes up to 20 degrees, and the square of side 100 under them as a low
 * mesh. */
void generate_sine(const struct generate_options *options);
void generate_sine_low(const struct generate_options *options);

#endif

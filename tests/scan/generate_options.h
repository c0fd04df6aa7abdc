/* generate_options.h - options and outputs of the scan generator. */
#ifndef SCAN_GENERATE_OPTIONS_H
#define SCAN_GENERATE_OPTIONS_H

#include <stdint.h>

struct generate_options {
    uint64_t triangles; /* approximate count */
    int colors, normals, texcoords;
    unsigned tiles;   /* of the low-poly vase's texture coordinates: UDIM tiles side by side */
    unsigned corners; /* 3: triangles, else polygons with this even number of corners */
    int shuffle;      /* faces in random order, by `seed` */
    uint64_t seed;
    double offset[3];  /* added to every position: geo-referenced scans */
    double amplitude;  /* amplified scans: height of the displacement as a share of the diagonal */
    int rounded;       /* amplified scans: no creases along the edges of the small scan */
    double wavelength; /* of the sine, or the longest of an amplified scan; 0: the default */
    const char *output;
};

/* Writes the vase as a regular grid over the analytic surface. */
void generate_vase(const struct generate_options *options);
/* Writes the body of the vase as a low-poly mesh of nu x ns quads with texture coordinates
 * (tiles u, s) and normals. */
void generate_vase_low(const struct generate_options *options, unsigned nu, unsigned ns);
/* Writes a small scan with each triangle split into k x k and displaced along its normals. */
void generate_amplified(const struct generate_options *options, const char *input);
/* Write crossed sine waves with slopes up to 20 degrees, and the square of side 100 below them as
 * the low-poly mesh. */
void generate_sine(const struct generate_options *options);
void generate_sine_low(const struct generate_options *options);

#endif

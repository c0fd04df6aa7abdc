/* bake.h - stage 2: rays from a low mesh to the scan, as a voxel grid or as its triangles, give
 * texture maps. */
#ifndef BAKE_BAKE_H
#define BAKE_BAKE_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

enum bake_map {
    BAKE_MAPS_DEFAULT = 0, /* normal, and color where the scan has colours */
    BAKE_MAP_NORMAL = 1,   /* unit normal n as n / 2 + 1/2 in R, G, B */
    BAKE_MAP_COLOR = 2,    /* linear Rec. 709 light in EXR, sRGB in PNG */
    BAKE_MAP_MASK = 4 /* share of a texel's samples that hit: 1 all, 0 none or outside the charts */
};
enum bake_normal_space { BAKE_TANGENT_SPACE, BAKE_OBJECT_SPACE };
enum bake_sampling {
    BAKE_TRILINEAR, /* normals and colours blended over the occupied neighbours */
    BAKE_NEAREST    /* those of the voxel that is hit (West 2008) */
};
/* Normals of triangles (exact baking) of a scan that has none of its own. */
enum bake_scan_normals {
    BAKE_SCAN_NORMALS_SMOOTH, /* interpolated from vertex normals weighted by area */
    BAKE_SCAN_NORMALS_FLAT
};
enum bake_format {
    BAKE_FORMAT_DEFAULT, /* by the output's name: .png is BAKE_PNG16, else BAKE_EXR_HALF */
    BAKE_EXR_HALF,
    BAKE_EXR_FLOAT,
    BAKE_PNG8, /* dithered */
    BAKE_PNG16
};

struct bake_options {
    /* A grid (.nvdb), or for exact maps a chunk file (.tris); told apart by content. */
    const char *scan_path;
    const char *mesh_path; /* low mesh, OBJ with texture coordinates */
    uint32_t maps;         /* of enum bake_map, or-ed */
    /* Output path; "<MAP>" in it stands for normal, color, mask, and must be there when there
     * are several maps. Must end in .png for a PNG format, and must not for EXR. */
    const char *output_path;
    enum bake_format format;
    uint32_t width, height; /* texels */
    uint32_t samples;       /* N: N x N ray pairs a texel */
    double front,
        back;         /* ray lengths in world units along and against the normal; < 0: automatic */
    uint32_t padding; /* texels around each chart; UINT32_MAX: everywhere */
    bool green_down;  /* flip the tangent-space map's green channel (Direct3D convention) */
    enum bake_normal_space normal_space;
    enum bake_sampling sampling;         /* of a grid */
    enum bake_scan_normals scan_normals; /* of a chunk file */
    bool two_sided;                      /* also take surfaces that face away from the low mesh */
    const char *device;                  /* one of BAKE_DEVICE_NAMES */
    /* Most bytes to use of a GPU's memory, 0: all that is free. A grid that needs more is baked in
     * passes. The processor reads the grid from its file and uses none. */
    uint64_t gpu_memory_bytes;
    const char *preview_path; /* PNG, or NULL */
};

/* Name of one map's file: output_path with every "<MAP>" replaced; to be freed with free(). NULL:
 * no memory. */
char *bake_map_path(const char *output_path, enum bake_map map);

/* Fills in the defaults: default maps, 2048 x 2048, 2 x 2 samples, automatic distances, padding 16.
 */
void bake_defaults(struct bake_options *options);

struct bake_report {
    char device[128]; /* name of the device that traced */
    uint64_t low_triangles, degenerate_uv_triangles, outside_uv_triangles;
    uint64_t covered_texels; /* with at least one sample inside a chart */
    uint64_t samples, hits, misses;
    uint64_t overlapping_samples; /* inside more than one triangle: the first takes them */
    double front, back;           /* as used */
    /* Wall times. open has what comes before the first ray, the upload of the grid too; trace also
     * rasterises and averages texels; resolve encodes pixels. */
    double seconds_open, seconds_trace, seconds_padding, seconds_resolve, seconds_write,
        seconds_preview;
    /* Of a device other than the processor, else 0: upload of the grid (wall time), and on the
     * device's clock how long kernels and copies of tiles ran; those of several threads at once
     * count once. */
    double seconds_upload, seconds_kernels, seconds_copies;
    uint64_t kernel_calls;
    uint64_t passes; /* over the map, each with a part of the grid; 1: the device holds all of it */
};

/* Bakes and writes the maps. They are all written before the first takes its final name, so a
 * failure leaves none of them. Errors: BSQ_EDATA for a low mesh without texture coordinates, a scan
 * without colour when a colour map is asked for, a damaged grid or chunk file, or when no ray hits
 * the scan; BSQ_ENODEVICE; BSQ_EUSAGE, for the name of a device too that is none of
 * BAKE_DEVICE_NAMES. */
int bake_run(struct bsq_ctx *ctx, const struct bake_options *options, struct bake_report *report);

/* Whether a grid or chunk file has colours. Errors: as for one that cannot be opened. */
int bake_scan_has_color(struct bsq_ctx *ctx, const char *path, bool *out);

/* One line a device: "cpu  16 threads ...", "opencl:0  NVIDIA ...". */
struct bake_device_info {
    char id[32]; /* what --device takes */
    char name[128];
    uint64_t memory_bytes;
    bool is_gpu;
};
/* Whether this is how devices are named: BAKE_DEVICE_NAMES. There need be no such device. */
bool bake_is_device_name(const char *name);
#define BAKE_DEVICE_NAMES "auto, cpu, cuda, cuda:N, opencl or opencl:N"
/* Calls fn for each device that can be used; warnings explain drivers that cannot. */
int bake_list_devices(struct bsq_ctx *ctx,
                      void (*fn)(void *arg, const struct bake_device_info *device), void *arg);

#ifdef __cplusplus
}
#endif
#endif

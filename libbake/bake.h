/** @file
 * libbake, stage 2: rays from a low-poly mesh  to a high-poly mesh (the scan) give
 * texture maps. The scan is a voxel grid, or a chunk file for exact results.
 *
 * Lengths are in the scan's units. Both meshes share one coordinate system.
 *
 * @example bake_maps.c
 * Bakes the maps of a grid or of a chunk file. */
#ifndef BAKE_BAKE_H
#define BAKE_BAKE_H

#include "base/options.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Maps; bits that can be combined. bake_map_name() lists all maps, also those without a constant
 * here. */
enum bake_map {
    BAKE_MAPS_DEFAULT = 0, /**< What bake_inspect() finds for the scan. */
    BAKE_MAP_NORMAL = 1,   /**< The unit normal n as n / 2 + 1/2 in R, G, B. */
    BAKE_MAP_COLOR = 2,    /**< Linear Rec. 709 light in EXR, sRGB in PNG. */
    BAKE_MAP_MASK = 4,     /**< Share of a texel's samples that hit: 1 all, 0 none or outside the UV
                              charts. */
    BAKE_MAP_HEIGHT = 8,   /**< Distance along the ray from the low-poly mesh to the hit. */
    BAKE_MAP_POSITION = 16,   /**< Position of the hit. */
    BAKE_MAP_CURVATURE = 32,  /**< Mean curvature of the scan, positive where it is convex. */
    BAKE_MAP_AO = 64,         /**< Share of the hemisphere above the hit that is open. */
    BAKE_MAP_BENT = 128,      /**< Mean open direction, as BAKE_MAP_NORMAL has it. */
    BAKE_MAP_THICKNESS = 256, /**< Mean distance through the solid below the hit. */
    BAKE_MAP_ID = 512, /**< A colour for each region, see struct bake_id. Scans with ids only. */
    BAKE_MAP_CONFIDENCE = 1024, /**< How sure hits are, 0 to 1; 0 where nothing was hit. */
    BAKE_MAPS_USUAL =
        1 << 29, /**< The maps of BAKE_MAPS_DEFAULT, and maps whose bits are also set. */
    BAKE_MAPS_ALL =
        1 << 30 /**< All maps that the scan can give, and maps whose bits are also set. */
};

/** What the samples 0 and 1 of an integer file with positions stand for. */
enum bake_position_in {
    BAKE_IN_SPHERE, /**< The ends of the sphere around the scan's bounding box, on each axis. */
    BAKE_IN_BOX     /**< The ends of the scan's bounding box, on each axis. */
};

/** How viewers use the opacity in a GLB file. */
enum bake_alpha {
    BAKE_ALPHA_BLEND, /**< Texels hide what is behind the surface as far as the opacity says. */
    BAKE_ALPHA_MASK   /**< Texels with an opacity below 0.5 are not drawn. */
};

/** The sides of a GLB file's triangles that viewers draw. */
enum bake_sides { BAKE_ONE_SIDE, BAKE_TWO_SIDES };

/** The vertical axis of a preview. */
enum bake_up {
    BAKE_UP_AUTO, /**< The one along which the low-poly mesh stands on a larger rectangle. */
    BAKE_UP_Y,    /**< Views from the front look along -z. */
    BAKE_UP_Z     /**< Views from the front look along y. */
};

/** Space of a normal map. */
enum bake_normal_space {
    BAKE_TANGENT_SPACE, /**< MikkTSpace tangent frames of the low-poly mesh. */
    BAKE_OBJECT_SPACE   /**< The coordinate system of the meshes. */
};

/** Words for the 24 turns of a mesh by right angles, with spaces between them and '/' between words
 * that mean the same. x-zy makes (x, y, z) to (x, -z, y), so that z points upwards and not y. */
#define BAKE_TURNS                                                                                 \
    "none z-up/x-zy y-up/xz-y yzx zxy x-y-z -xy-z -x-yz -y-zx -yz-x y-z-x -z-xy -zx-y z-x-y "      \
    "-xzy -x-z-y -yxz y-xz yx-z -y-x-z -zyx z-yx zy-x -z-y-x"

/** Normals of a low-poly mesh whose file has none. */
enum bake_low_normals {
    BAKE_LOW_AUTO, /**< BAKE_LOW_ANGLE; in glTF files BAKE_LOW_FLAT, as their specification says. */
    BAKE_LOW_ANGLE,  /**< Smooth, weighted by the angles of the corners, as Blender shows them. */
    BAKE_LOW_SMOOTH, /**< Smooth, weighted by the areas of the faces. */
    BAKE_LOW_FLAT    /**< Those of the triangles. */
};

/** Directions of rays. Corners of the low-poly mesh have them, and triangles interpolate them. */
enum bake_rays {
    BAKE_RAYS_SMOOTH, /**< The mean of the mesh's normals in the same place, also across hard edges
                         and UV seams, so that rays leave no gaps. */
    BAKE_RAYS_MESH,   /**< The mesh's normals. */
    BAKE_RAYS_FACE    /**< The triangles' own normals. */
};

/** What a ray takes from a grid. */
enum bake_sampling {
    BAKE_TRILINEAR, /**< Normals and colours blended over the occupied neighbours of the hit. */
    BAKE_NEAREST    /**< Those of the voxel that is hit (West 2008). */
};

/** How a map file stores a sample. */
enum bake_sample_type {
    BAKE_SAMPLE_USUAL, /**< The map's own, if it has one. Else BAKE_HALF in OpenEXR, BAKE_UINT16 in
                          PNG. */
    BAKE_UINT8,        /**< 8 bits, dithered. PNG only. */
    BAKE_UINT16,       /**< 16 bits. PNG only. */
    BAKE_HALF,         /**< 16-bit floating point, limited to 65504. OpenEXR only. */
    BAKE_FLOAT,        /**< 32-bit floating point. OpenEXR only. */
    BAKE_UINT8_16 /**< 8 bits, but 16 of real values such as heights and curvature. PNG only. */
};

/** The size of the maps of one UDIM tile, in texels. */
struct bake_tile_size {
    uint32_t tile;   /**< Number of the tile. */
    uint32_t width;  /**< Width of its maps. */
    uint32_t height; /**< Height of its maps. */
};

/** A range of UDIM tiles. */
struct bake_tile_range {
    uint32_t first; /**< Number of the first tile. */
    uint32_t last;  /**< Number of the last tile, inclusive. */
};

/** A transfer map: another texture of the scan, such as its roughness. */
struct bake_transfer {
    /** Lower-case letters, digits and underscores, with a letter first; not the name of another
     * map. Stands for "<MAP>" in the output path. docs/maps.md lists names that have a meaning. */
    const char *name;
    /** Image for all faces of the scan, which is a chunk file; NULL: the channel of this name that
     * the chunk file has. */
    const char *texture_path;
    bool
        in_mask; /**< The mask, which must be baked, is multiplied by it. At most one; one value. */
    bool no_file; /**< No file of its own. */
};

/** Maps of one value each that become the channels of one file. */
struct bake_pack {
    const char *name; /**< Stands for "<MAP>" in the output path, as for transfer maps. */
    /** Up to four words with commas between them, for red, green, blue and alpha: maps or transfer
     * maps that are baked and then have no file of their own; "1-" and such a name: its samples are
     * subtracted from 1; "0" or "1". Three or fewer give red, green and blue. */
    const char *maps;
};

/** Rows of a map, from top to bottom, as its file gets them: encoded, with padding. */
struct bake_rows {
    const char *map;      /**< Its name. */
    const char *path;     /**< Of its file, which tells UDIM tiles, objects and materials apart. */
    uint32_t width;       /**< Width of the map in texels. */
    uint32_t height;      /**< Height of the map in texels. */
    uint32_t channels;    /**< Interleaved in each row. */
    bool light;           /**< Samples are linear light, of colours. */
    uint32_t first;       /**< Number of the first row, from 0 at the top. */
    uint32_t count;       /**< Number of rows. */
    const float *samples; /**< Of these rows; valid until the callback returns. */
};

/** How much work a bake is, see bake_options.quality. */
enum bake_quality { BAKE_QUALITY_NORMAL, BAKE_QUALITY_DRAFT, BAKE_QUALITY_FINAL };

/** A page about a bake or a comparison, see bake_page_open(). */
struct bake_page;

/** What bake_run() reads and writes. The caller owns all strings and arrays. */
struct bake_options {
    size_t size; /**< Of the structure, see bsq_check_size(). */
    const char
        *scan_path; /**< Input: a grid (.nvdb) or a chunk file (.tris); the content decides. */
    const char *const *more_scan_paths; /**< More scans; the nearest surface of all is taken. */
    uint32_t more_scan_count;           /**< Entries of more_scan_paths. */
    /** Objects of the low-poly mesh see only the scans with their names: an object body +
     * low_suffix sees the scans body + high_suffix, also if '_' and any text follow. A scan's name
     * is that of its file, without folder and suffix. Every name needs a partner. */
    bool match_names;
    const char *low_suffix;  /**< Of objects' names, such as "_low". */
    const char *high_suffix; /**< Of scans' names, such as "_high". */
    const char *mesh_path;   /**< Input: the low-poly mesh, a mesh file with texture coordinates. */
    const char *const *more_mesh_paths; /**< More of them; all are baked. */
    uint32_t more_mesh_count;           /**< Entries of more_mesh_paths. */
    double low_scale;  /**< The low-poly meshes, and the cage, are multiplied by it, then turned. */
    unsigned low_turn; /**< Which word of BAKE_TURNS. */
    double low_x;      /**< Then they are shifted along x. */
    double low_y;      /**< Likewise, along y. */
    double low_z;      /**< Likewise, along z. */
    enum bake_low_normals low_normals; /**< Of low-poly meshes without normals. */
    bool as_is;    /**< Bakes meshes that do not fit each other, see bake_run(). */
    uint32_t maps; /**< Bits of enum bake_map. */
    const struct bake_transfer
        *transfers;                /**< Transfer maps. With any, maps may be 0: no others. */
    uint32_t transfer_count;       /**< Entries of transfers. */
    const struct bake_pack *packs; /**< Maps that share files. */
    uint32_t pack_count;           /**< Entries of packs. */
    /** For the caller, who sets other options by it. Likewise the preset: 0 none, or a number from
     * 1 on. */
    enum bake_quality quality;
    uint32_t preset; /**< See quality. */
    bool
        engine_names; /**< "<MAP>" stands for what the preset's engine calls the map, such as BC. */
    /** Output path. "<MAP>" in it stands for the map's name, see bake_map_name(), "<UDIM>" and
     * "<UVTILE>" for the tile, "<OBJECT>" and "<MATERIAL>" for what has maps of its own. It must
     * contain "<MAP>" if there are several maps, and "<UDIM>" or "<UVTILE>" if there are several
     * tiles. Its suffix, .exr or .png, chooses the format. */
    const char *output_path;
    enum bake_sample_type sample_type;         /**< One that the image format can store. */
    uint32_t width;                            /**< Width of the maps in texels. */
    uint32_t height;                           /**< Height of the maps in texels. */
    const struct bake_tile_size *tile_sizes;   /**< Tiles whose maps have another size. */
    uint32_t tile_size_count;                  /**< Entries of tile_sizes. */
    const struct bake_tile_range *tile_ranges; /**< Tiles to bake, if triangles lie in them. */
    uint32_t tile_range_count; /**< Entries of tile_ranges; 0: all tiles with triangles. */
    uint32_t samples;          /**< N: each texel gets N x N pairs of rays. */
    enum bake_rays rays;       /**< Directions of rays without a cage. */
    /** Input: a mesh with the vertices and faces of the low-poly mesh around it and the scan, or
     * NULL. Rays start at it, go through the low-poly mesh and take the first surface. */
    const char *cage_path;
    double
        extrude; /**< Distance of a cage along the smooth normals, instead of a mesh; < 0: none. */
    /** A grey image in the texture space of the low-poly meshes, or NULL. White turns rays to the
     * normals of the faces, black leaves them. BAKE_UDIM_TOKEN and BAKE_UVTILE_TOKEN stand for each
     * baked tile; without them, all tiles have the same image. */
    const char *skew_path;
    double front;     /**< Length of rays along the normal; < 0: automatic. */
    double back;      /**< Length of rays against the normal; < 0: automatic. */
    uint32_t padding; /**< Texels to fill around each UV chart; UINT32_MAX: everywhere. */
    bool green_down;  /**< Flips the green channel of a tangent-space map, as Direct3D expects. */
    enum bake_normal_space normal_space; /**< Space of the normal map. */
    enum bake_sampling sampling;         /**< For grids. */
    enum bsq_scan_normals scan_normals;  /**< For chunk files without normals. */
    /** Input: a tangent-space normal map in the texture space of the scan, added to its normals.
     * For chunk files. NULL: what the chunk file keeps, if anything. Its green grows with the
     * second texture coordinate. */
    const char *scan_normal_map;
    /** Distance that the samples 0 and 1 of an integer file with heights stand for, negative and
     * positive; < 0: the largest of the whole mesh. */
    double height_range;
    enum bake_position_in position_in; /**< For integer files. */
    /** Curvature that the samples 0 and 1 of an integer file with curvature stand for, negative and
     * positive; < 0: the mean magnitude of the whole mesh plus its standard deviation. */
    double curvature_range;
    /** Distance around a hit within which curvature is measured; < 0: two texels of the map and,
     * for grids, at least two voxels. */
    double curvature_radius;
    /** Rays of each texel for BAKE_MAP_AO and BAKE_MAP_BENT, cosine-weighted. The samples of a
     * texel send equally many of them, at least one; so more are sent if samples do not divide
     * them. */
    uint32_t ao_rays;
    double ao_distance; /**< Length of these rays; <= 0: no limit. */
    double ao_spread;   /**< Angle of the cone that they fill, in degrees, to 180. */
    /** In grids, a voxel at this distance from the hit or farther ends these rays, and those of
     * BAKE_MAP_THICKNESS, as if its surface filled it; in voxels; <= 0: none does. */
    double ao_coarse;
    /** Each texel of ao and thickness becomes a mean of those near it on the scan. */
    bool filter_rays;
    bool ao_falloff;         /**< A surface hides less the farther it is: nothing at ao_distance. */
    uint32_t thickness_rays; /**< The same for BAKE_MAP_THICKNESS. */
    /** Length of these rays; <= 0: the diagonal of the scan's bounding box. */
    double thickness_distance;
    /** Thickness that the sample 1 of an integer file stands for; < 0: thickness_distance or, if
     * that is not given, the mean of the whole mesh plus twice its standard deviation. */
    double thickness_range;
    bool two_sided; /**< Also takes surfaces that face away from the low-poly mesh. */
    /** Percentage of the samples that may miss before a farm stops, 0 to 100. The report has the
     * misses; this is for the caller. */
    double max_missed;
    bool strict;    /**< For the caller, too, who sets bsq_set_strict(). */
    uint32_t parts; /**< Number of parts that the bake is divided into; 0: none, see bake_run(). */
    uint32_t part;  /**< The one to bake, from 1 on; 0: all parts are merged. */
    /** One of BAKE_DEVICE_NAMES; NULL or "": "cpu" if its cores are expected to finish before a
     * fast GPU, else "auto". */
    const char *device;
    /** Most bytes of a GPU's memory to use; 0: all that is free. The processor bakes a grid that
     * needs more, after a warning: it reads the grid from its file. */
    uint64_t gpu_memory_bytes;
    /** Side of the tiles that OpenEXR files are made of, in texels, to BAKE_MAX_EXR_TILE;
     * 0: lines. */
    uint32_t exr_tile_side;
    /** Output: the low-poly mesh with the maps normal, color, ao, and the transfer maps roughness,
     * metallic, occlusion (instead of ao), emission and opacity, as a glTF file (GLB), or NULL. */
    const char *glb_path;
    enum bake_alpha glb_alpha; /**< How viewers of that file use its opacity. */
    enum bake_sides glb_sides; /**< The sides of its triangles that they draw. */
    const char *preview_path;  /**< Output: a preview, PNG, or NULL. */
    uint32_t preview_views;    /**< Views around the mesh, to BAKE_MAX_VIEWS. */
    enum bake_up preview_up;   /**< Vertical axis of the preview. */
    /** The first view of the preview, in degrees around the vertical axis, from the front on to its
     * right (seen from the mesh: to its left); below 0: 30, or the front of an open mesh. */
    double preview_from;
    /** How far all views look down, in degrees; below 0: 17, or near where an open mesh faces. */
    double preview_above;
    /** Gets the rows of all maps, never concurrently; NULL: nobody does. Of a map that several
     * objects or tiles have, one file's rows come after the other's. A negative status ends the job
     * and is returned. */
    int (*on_rows)(void *user, const struct bake_rows *rows);
    void *rows_user; /**< Passed to on_rows. */
    bool rows_only;  /**< Maps have no files; output_path only chooses how samples are encoded. */
    const char *page_path; /**< Name of the page that the caller writes, or NULL: no other output
                                may have it. */
    const char *reference_path; /**< Folder of maps with which the caller compares those of the same
                                     names, or NULL. */
    struct bake_page *page; /**< Gets the mesh, the preview and the misses; NULL: there is none. */
};

/** In an output path: stands for the map's name. */
#define BAKE_MAP_TOKEN "<MAP>"
/** In an output path: stands for the number of the UDIM tile, such as 1001. */
#define BAKE_UDIM_TOKEN "<UDIM>"
/** In an output path: stands for the tile as u and v from 1 on, such as u1_v1. */
#define BAKE_UVTILE_TOKEN "<UVTILE>"

/** In an output path: stands for the name of the low-poly mesh's object, which then has maps of its
 * own. An object follows an "o" or "g" statement of an OBJ file, or is a node with a mesh in glTF
 * files; without any, it is the whole file. */
#define BAKE_OBJECT_TOKEN "<OBJECT>"
/** In an output path: stands for the name of the low-poly mesh's material, which then has maps of
 * its own. */
#define BAKE_MATERIAL_TOKEN "<MATERIAL>"

/** Numbers of UDIM tiles. Tile 1001 + u + 10 v is the unit square of texture space from (u, v). */
enum { BAKE_FIRST_TILE = 1001, BAKE_LAST_TILE = 9990 };

enum {
    BAKE_MAX_MAPS = 16,         /**< Largest number of maps with a bit of enum bake_map. */
    BAKE_MAX_TRANSFERS = 16383, /**< Most transfer maps of a bake. */
    BAKE_MAX_SIDE = 1 << 20,    /**< Largest width and height of a map. */
    BAKE_MAX_SAMPLES = 64,      /**< Largest N of N x N samples a texel. */
    BAKE_MAX_RAYS = 4096,       /**< Most rays of a texel for a map. */
    BAKE_AO_COARSE = 64,        /**< Default of bake_options.ao_coarse. */
    BAKE_MAX_VIEWS = 360,       /**< Most views of a preview. */
    BAKE_MAX_EXR_TILE = 8192,   /**< Largest side of a tile of an OpenEXR file. */
    BAKE_MAX_PARTS = 65536      /**< Most parts of a bake. */
};

/** Returns the name of a map, such as "normal". Map number 0, 1, ... has the bit 1 << number in
 * enum bake_map. Returns NULL after the last map. */
const char *bake_map_name(unsigned number);
/** Returns another name of the map, or NULL. */
const char *bake_map_alias(unsigned number);
/** Returns what the map shows, in a few words; NULL after the last map. */
const char *bake_map_summary(unsigned number);

/** Looks at the scans of the options, and completes these: the bits of BAKE_MAPS_DEFAULT and
 * BAKE_MAPS_ALL and BAKE_MAPS_USUAL become those of maps. First calls `add` with `arg` for the name
 * of each channel that all scans have and that can be a transfer map, such as "roughness"; it may
 * change the options. A status of `add` below 0 is returned. NULL: no channels are added. Warns of
 * colours, ids and channels that only some of several scans have; a strict job fails with
 * BSQ_EDATA. Also warns of each option that was given and has no effect on the maps, and names what
 * it needs. given: a flag for each row of bake_option_rows(); NULL: no such warnings. Returns the
 * errors of opening a scan. */
int bake_inspect(struct bsq_ctx *ctx, struct bake_options *options, const bool *given,
                 int (*add)(void *arg, const char *name), void *arg);

/** Fills in the defaults: default maps, 2048 x 2048 texels, 2 x 2 samples, automatic ray lengths,
 * 16 texels of padding, tangent space, any device. */
void bake_defaults(struct bake_options *options);

/** At least the number of rows of bake_option_rows(), for arrays with an element for each. */
enum { BAKE_MOST_OPTION_ROWS = 96 };

/** Returns the table of the options, with *count rows: defaults, values, and the options of
 * bisque-bake that set the members. */
const struct bsq_option *bake_option_rows(size_t *count);

/** How the samples of a file stand for values with a unit: value = origin + offset + scale *
 * sample, in each channel. */
struct bake_value_encoding {
    const char *unit;  /**< NULL: the map is not baked, or its values have no unit. */
    uint32_t channels; /**< 1 or 3. */
    double scale[3];   /**< See above. */
    double offset[3];  /**< See above. */
    double origin[3];  /**< In double precision, as geo-referenced positions need it; else 0. */
    double range;      /**< Half of the largest scale that an integer file has. */
    double radius;     /**< In which curvature was measured; else 0. */
};

/** A set of maps that bake_run() wrote: a UDIM tile, of one object or material if these have maps
 * of their own. */
struct bake_baked_tile {
    uint32_t tile;   /**< Number of the tile. */
    uint32_t width;  /**< Width of its maps in texels. */
    uint32_t height; /**< Height of its maps in texels. */
    char *object;    /**< The name for "<OBJECT>", or NULL. */
    char *material;  /**< The name for "<MATERIAL>", or NULL. */
};

/** A file of a map. */
struct bake_file {
    const char *path; /**< Where the map is written. */
    const char *map;  /**< Name of the map. */
    unsigned number;  /**< Of the map, see bake_map_name(); BAKE_MAX_MAPS for transfer maps and
                         packs. */
};

/** Calls `fn` with `arg` for the file of each map in a tile; NULL: with the tokens of tiles,
 * objects and materials in the path. bake_inspect() must have set the maps. A status of `fn`
 * below 0 ends the list and is returned. Errors: BSQ_ENOMEM. */
int bake_list_files(struct bsq_ctx *ctx, const struct bake_options *options,
                    const struct bake_baked_tile *tile,
                    int (*fn)(void *arg, const struct bake_file *file), void *arg);

/** A region of the scan in BAKE_MAP_ID. */
struct bake_id {
    char *name;       /**< Of the material or the object; "" for faces without one. */
    uint8_t color[3]; /**< Its colour, of 255: red, green, blue. It depends on the name alone. */
};

/** What bake_run() did. Times are wall times in seconds. */
struct bake_report {
    size_t size;                      /**< Of the structure, see bsq_clear_report(). */
    char device[256];                 /**< Name of the device that traced. */
    uint64_t low_triangles;           /**< Triangles of the low-poly mesh. */
    uint64_t low_polygons;            /**< Its faces that had more corners. */
    uint64_t degenerate_uv_triangles; /**< Of these, without an area in the map. */
    uint64_t outside_uv_triangles;    /**< Of these, partly or wholly outside the baked tiles. */
    struct bake_baked_tile *tiles;    /**< The UDIM tiles that were baked, by set and number. */
    uint32_t tile_count;              /**< Entries of tiles. */
    uint32_t traced_tiles;            /**< Of these, the ones that this job traces. */
    bool done;                        /**< A part that was there already; nothing was done. */
    uint64_t expected_rays;           /**< Rays of all texels, before tracing. */
    double expected_seconds; /**< Of one core, for these rays; machines differ by a factor. */
    uint64_t covered_texels; /**< Texels with at least one sample inside a UV chart. */
    uint64_t samples;        /**< Samples inside UV charts. */
    uint64_t hits;           /**< Samples whose rays found the scan. */
    uint64_t misses;         /**< Samples whose rays did not. */
    uint64_t
        overlapping_samples; /**< Samples in several triangles; the first triangle takes them. */
    double texel;            /**< Mean side of a texel on the low-poly mesh, world units. */
    double voxel;            /**< That of the coarsest grid; 0: there is none. */
    double front;            /**< Length of rays along the normal. */
    double back;             /**< Length of rays against the normal. */
    double seconds_open;     /**< Before the first ray; includes the upload of the grid. */
    double seconds_trace;    /**< Rasterising, tracing and averaging. */
    double seconds_padding;  /**< Filling texels around charts. */
    double seconds_resolve;  /**< Encoding pixels. */
    double seconds_write;    /**< Writing files. */
    double seconds_preview;  /**< Rendering the preview. */
    double seconds_upload;   /**< Upload of the grid to a GPU; 0 for the processor. */
    /** Time with at least one kernel running, on the GPU's clock; 0 for the processor. */
    double seconds_kernels;
    /** Time with at least one copy of a tile running, on the GPU's clock; 0 for the processor. */
    double seconds_copies;
    /** Vertical axis of the preview and the page; AUTO: there is none. */
    enum bake_up preview_up;
    uint64_t kernel_calls; /**< Kernel launches; 0 for the processor. */
    struct bake_value_encoding encodings[BAKE_MAX_MAPS]; /**< Of each map, by its number. */
    /** Chunks of an exact bake that were loaded, counted again each time. */
    uint64_t chunk_loads;
    const char *id_source; /**< What ids tell apart: "material", "object" or "color". NULL: none. */
    struct bake_id *ids; /**< The names that BAKE_MAP_ID has colours for, ascending. Vertex colours
                            have no names: they are their own ids. */
    uint64_t id_count;   /**< Entries of ids. */
};

/** Checks everything that can be checked without opening a file; bake_run() does so too. Returns
 * BSQ_EUSAGE if something is wrong. */
int bake_check_options(struct bsq_ctx *ctx, const struct bake_options *options);

/** Bakes and writes the maps, and fills in *report; after success the caller frees it with
 * bake_report_free().
 *
 * Each UDIM tile that triangles lie in has its own maps.
 *
 * The method follows West, "GPU-optimized generation of normal and color maps" (Linkoping 2008):
 * each sample of a texel sends a ray along the interpolated normal and one against it, and the
 * nearest hit wins. Tangent frames are MikkTSpace's (Mikkelsen 2008).
 *
 * Unless options->as_is is set, samples of the low-poly mesh are compared with the scan before the
 * work. If they fit much better after a turn by right angles, in other units, mirrored or turned
 * inside out, the bake fails with BSQ_EDATA and says so. It warns of other pairs that do not fit.
 *
 * With options->part, only the texels of that part are baked, to files "part-I-of-N" beside the
 * maps, which FORMATS.md describes: not if they are there already, whole and of the same inputs,
 * options and version. The report counts them alone. With options->parts alone, the texels come
 * from the files of all parts, and the outputs get the bytes of a bake that is not divided;
 * tile_ranges then chooses which maps are written, without a GLB file and a preview. Paths and
 * machines may differ. Parts may be baked, and tiles be merged, at once.
 *
 * All maps are complete on the disk before the first gets its final name, so a failure leaves none
 * of them. Errors: BSQ_ENOINPUT, also for parts, which it names; BSQ_EDATA for a damaged part or
 * one of another bake, for a low-poly mesh without texture coordinates, for a
 * colour map of a scan without colours, for a damaged input, and if no ray hits the scan;
 * BSQ_ENODEVICE; BSQ_EUSAGE for options that contradict each other and for a device name that is
 * not one of BAKE_DEVICE_NAMES; BSQ_ENOMEM; BSQ_ECANTCREAT; BSQ_EIO; BSQ_EINTR. */
int bake_run(struct bsq_ctx *ctx, const struct bake_options *options, struct bake_report *report);

/** Frees what bake_run() allocated in a report; a zeroed report is allowed. */
void bake_report_free(struct bake_report *report);

/* ---- a page to look at ---- */

/** Begins a page under a temporary name; `path` ends in .html. It is one HTML file that needs no
 * network. Its frame and script are installed with Bisque; three.js is taken from Debian's package
 * libjs-three, without which the page has pictures instead of the mesh. Errors: BSQ_EUSAGE,
 * BSQ_ENOINPUT if its parts are not installed, BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int bake_page_open(struct bsq_ctx *ctx, const char *path, struct bake_page **out);
/** Adds pictures of maps: bake_options.on_rows, with the page as rows_user. */
int bake_page_take(void *page, const struct bake_rows *rows);
/** Completes the page with the figures that it shows, a JSON object as the programs print it, and
 * gives it its name. Errors: BSQ_EIO, BSQ_ECANTCREAT. */
int bake_page_finish(struct bake_page *page, const char *json);
/** Frees a page, and removes it if it is not finished; NULL is allowed. */
void bake_page_close(struct bake_page *page);

/** A UDIM tile that triangles of a low-poly mesh lie in. */
struct bake_tile_info {
    uint32_t tile;      /**< Its number. */
    uint32_t width;     /**< Width of its maps in texels, by the options. */
    uint32_t height;    /**< Height of its maps in texels, by the options. */
    uint64_t triangles; /**< In it; a triangle can be in several tiles. */
};

/** Calls `fn` with `arg` for each UDIM tile that bake_run() would bake, by number. Of the options,
 * reads mesh_path, more_mesh_paths, the sizes and the tile ranges. Errors: those of reading the
 * mesh; BSQ_EUSAGE as in bake_run(). */
int bake_list_tiles(struct bsq_ctx *ctx, const struct bake_options *options,
                    void (*fn)(void *arg, const struct bake_tile_info *tile), void *arg);

/** A device that can trace rays. */
struct bake_device_info {
    char id[32];           /**< Name for bake_options.device, such as "cpu" or "opencl:0". */
    char name[128];        /**< Name for people, such as "16 threads" or "NVIDIA ...". */
    uint64_t memory_bytes; /**< Its memory. */
    bool is_gpu;           /**< False for processors, also if they are OpenCL devices. */
};

/** Names of devices, for messages. */
#define BAKE_DEVICE_NAMES "auto, cpu, cuda, cuda:N, opencl or opencl:N"

/** Checks that `name` is one of BAKE_DEVICE_NAMES. Does not check that the device exists. */
bool bake_is_device_name(const char *name);

/** Calls `fn` with `arg` for each device that can be used. Warns about drivers that cannot be used,
 * and says why. Errors: BSQ_ENOMEM. */
int bake_list_devices(struct bsq_ctx *ctx,
                      void (*fn)(void *arg, const struct bake_device_info *device), void *arg);

#ifdef __cplusplus
}
#endif
#endif

/** @file
 * libvoxel, stage 1: a scan (the high-poly mesh) of any size becomes a chunk file and a voxel grid.
 *
 * | function       | reads       | writes                                                   |
 * |----------------|-------------|----------------------------------------------------------|
 * | vox_sort()     | mesh files  | a chunk file, .tris: triangles in spatially sorted chunks |
 * | vox_voxelize() | chunk files | a grid, .nvdb: sparse surface voxels                     |
 *
 * Both stay within the context's memory budget. Output bytes are the same for any budget and any
 * number of threads. Each call uses the context's threads; run one call of a context at a time.
 *
 * Positions and lengths are in the scan's units, in its coordinate system.
 *
 * @example voxelize_scan.c
 * Turns a mesh file into a chunk file and a grid. */
#ifndef VOX_VOXEL_H
#define VOX_VOXEL_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/** What ids tell apart, see docs/maps.md. */
enum vox_ids {
    VOX_IDS_NONE,     /**< There are no ids. */
    VOX_IDS_MATERIAL, /**< Materials, by name. */
    VOX_IDS_OBJECT,   /**< Objects and groups, by name. */
    VOX_IDS_COLOR     /**< Vertex colours; that of the nearest corner counts. */
};

/** An open chunk file. vox_sort() writes it and vox_voxelize() reads it. Without a name, it is gone
 * when it is closed or the process ends. */
struct vox_temp_tris;

/** Creates a handle without content in *out, which the caller owns. Errors: BSQ_ENOMEM. */
int vox_temp_tris_create(struct bsq_ctx *ctx, struct vox_temp_tris **out);

/** Closes the file and frees the handle; NULL is allowed. */
void vox_temp_tris_close(struct vox_temp_tris *temp);

/** A further channel of a scan, such as its roughness, see docs/maps.md. */
struct vox_channel {
    const char *name; /**< Lower-case letters, digits and underscores, with a letter first. */
    const char *texture_path; /**< Image for all faces with texture coordinates. NULL: what the
                                 materials have. */
    bool optional; /**< Keep the channel only if some material has a value or a texture of it. */
};

/** What vox_sort() reads and writes. The caller owns all strings and handles. */
struct vox_sort_options {
    size_t size; /**< Of the structure, see bsq_check_size(). */
    /** Mesh files, read as one scan. They may be packed by gzip or Zstandard. A FIFO, or "-" for
     * standard input, is read once. */
    const char *const *scan_paths;
    /** One for each mesh file that is read by a callback, NULL for others; its path is then its
     * name in messages. NULL: all are files. */
    const struct bsq_source *const *sources;
    /** One for each mesh file; NULL: all stay in place. */
    const struct bsq_placement *placements;
    uint32_t scan_count;      /**< Number of mesh files, at least 1. */
    const char *texture_path; /**< Image for all faces with texture coordinates. NULL: the images
                                 that the materials name. */
    enum vox_ids ids;         /**< Ids that the chunk file keeps. */
    const struct vox_channel *channels; /**< Channels that the chunk file keeps. */
    uint32_t channel_count;             /**< Entries of channels. */
    const char *tris_path;              /**< Output: the chunk file. */
    /** NULL, or the output to use instead of tris_path, which then only names the directory of
     * temporary files. */
    struct vox_temp_tris *temp_tris;
    /** With temp_tris: makes the file tris_path too. vox_voxelize() reads the chunks of this job,
     * even if another job replaces that file meanwhile. */
    bool keeps_tris;
    /** Warn of textures of materials that belong to none of the channels: their content is lost. */
    bool tells_unkept;
    /** Copy the images of textures into the chunk file tris_path, except for textures of tiles. */
    bool embed_textures;
    /** Vertex normals that the chunk file gets if the scan has none; FLAT: none. */
    enum bsq_scan_normals scan_normals;
    /** Three numbers: the origin that stored positions are relative to, for parts of a scan that
     * are sorted one by one. NULL: that of origin_path, or one near the scan. */
    const double *origin;
    const char *origin_path; /**< NULL, or a chunk file whose origin is taken. */
};

/** Bytes of a list of names in a report. What does not fit is left out. */
enum { VOX_NAMES_BYTES = 512 };

/** What vox_sort() did. */
struct vox_sort_report {
    size_t size;                   /**< Of the structure, see bsq_clear_report(). */
    uint64_t bytes_read;           /**< Bytes of the mesh files, unpacked. */
    uint64_t vertices;             /**< Vertices of the scan. */
    uint64_t faces;                /**< Faces of the scan, polygons included. */
    uint64_t triangles;            /**< Triangles in the chunk file. */
    uint64_t degenerate_triangles; /**< Triangles without area; left out. */
    uint64_t short_faces;          /**< Faces with fewer than three corners; left out. */
    uint64_t broken_faces;  /**< Faces with a vertex whose position is not finite; left out. */
    uint64_t lost_corners;  /**< Corners that refer to a texture coordinate or normal that does not
                               exist; they go without. */
    uint64_t skipped_lines; /**< Lines with statements that the format does not define. */
    uint64_t chunks;        /**< Chunks in the chunk file. */
    uint64_t tris_bytes;    /**< Size of the chunk file. */
    uint64_t temp_bytes;    /**< Bytes that it wrote to temporary files. */
    double origin[3];       /**< Origin that stored positions are relative to. */
    bool has_normals;       /**< The scan has normals. */
    bool has_texcoords;     /**< The scan has texture coordinates. */
    bool has_colors;        /**< The scan has vertex colours. */
    bool has_fine_colors;   /**< Some of them need more than 8 bits. */
    bool has_material_colors; /**< Some material has a colour, without a texture. */
    bool unused_texcoords;    /**< It has texture coordinates, but nothing that needs them. */
    bool double_sided;        /**< Some faces have a material that is seen from behind too. */
    bool uses_textures;       /**< The chunk file needs textures. */
    /** One that is not in the chunk file, and must stay where it is; "": none. It may be cut off.
     */
    char outer_texture[VOX_NAMES_BYTES];
    /** Channels that the chunk file keeps: names separated by commas. */
    char kept_channels[VOX_NAMES_BYTES];
    /** Channels that materials have textures or values of, and the chunk file does not keep. */
    char unkept_channels[VOX_NAMES_BYTES];
    double seconds_read; /**< Wall time of reading. */
    double seconds_sort; /**< Wall time of sorting and writing. */
};

/** Fills in the defaults: no inputs, no outputs, textures of the materials, no ids. */
void vox_sort_defaults(struct vox_sort_options *options);

/** Sorts the triangles of a scan in space and writes them as a chunk file (formats/FORMATS.md).
 * Fills in *report. Errors: BSQ_ENOINPUT; BSQ_EDATA for a damaged input and for a scan without any
 * triangle that has an area; BSQ_ENOMEM, also if the budget is below vox_memory_min();
 * BSQ_ECANTCREAT; BSQ_EIO; BSQ_EINTR. */
int vox_sort(struct bsq_ctx *ctx, const struct vox_sort_options *options,
             struct vox_sort_report *report);

/** What vox_join() reads and writes. The caller owns all strings and handles. */
struct vox_join_options {
    size_t size;                     /**< Of the structure, see bsq_check_size(). */
    const char *const *tris_paths;   /**< Input: chunk files, in any order. */
    uint32_t tris_count;             /**< Number of tris_paths. */
    struct vox_temp_tris *temp_tris; /**< NULL, or a handle; its file is one more part. */
    const char *output_path;         /**< Output: a chunk file. */
    /** The handle gets the output instead, in place of its file, if any; output_path then only
     * names the directory of temporary files. */
    bool temporary;
    /** Vertex normals that it gets if the scan has none. AUTO: by the weights of the chunk files if
     * these have the same, or none if none has any; else smooth ones. FLAT: none. */
    enum bsq_scan_normals scan_normals;
    bool ids; /**< All must have ids of one kind. */
};

/** Writes chunk files as one chunk file, with vertex normals that are smooth across their borders.
 * One file alone gets other normals. The file has the attributes of any of them, ids that all have
 * of one kind, the channels that all have, and normal maps of any. Of *report, fills in triangles,
 * chunks, tris_bytes, temp_bytes, origin, has_normals, has_texcoords, has_colors and seconds_sort.
 * Errors: BSQ_ENOINPUT; BSQ_EDATA for a damaged file, for some files with normals beside others,
 * and for different origins; BSQ_ENOMEM, BSQ_ECANTCREAT, BSQ_EIO, BSQ_EINTR. */
int vox_join(struct bsq_ctx *ctx, const struct vox_join_options *options,
             struct vox_sort_report *report);

/** Reads the mesh files of a scan and keeps nothing, to measure the reader. Does not check the
 * indices of faces. Of the options, reads scan_paths. Fills in what *report says of reading.
 * Errors: BSQ_ENOINPUT, BSQ_EDATA, BSQ_ENOMEM, BSQ_EIO, BSQ_EINTR. */
int vox_parse(struct bsq_ctx *ctx, const struct vox_sort_options *options,
              struct vox_sort_report *report);

/** Returns the smallest budget in bytes that vox_sort() and vox_voxelize() accept, for a number of
 * threads. */
uint64_t vox_memory_min(unsigned threads);

/** The largest resolution, in voxels along the longest side. */
#define VOX_RESOLUTION_MAX (UINT32_C(1) << 30)

/** What vox_voxelize() reads and writes. The caller owns all strings and handles. */
struct vox_voxelize_options {
    size_t size;           /**< Of the structure, see bsq_check_size(). */
    const char *tris_path; /**< Input: a chunk file. */
    /** NULL, or the input to read instead of tris_path, which is then only used in messages. */
    const struct vox_temp_tris *temp_tris;
    const char *grid_path; /**< Output: the grid. */
    uint32_t resolution; /**< Voxels along the longest side, up to VOX_RESOLUTION_MAX. 0: voxel_size
                            counts. */
    double voxel_size;   /**< Edge of a voxel in the scan's units. Voxels are then aligned to its
                            multiples. */
    enum bsq_scan_normals scan_normals; /**< Normals of a scan without normals. If its edges are
                                           shorter than 0.7 voxels, all choices are the same. */
    const char *vdb_path;               /**< Output: an OpenVDB file, or NULL. */
    bool ids;                           /**< Give the grid the ids of the chunk file. */
    /** Channels of the chunk file that the grid gets: names separated by commas, "all" or NULL. */
    const char *channels;
    /** Input: a tangent-space normal map in the texture space of the scan, added to its normals.
     * NULL: what the chunk file keeps, if anything. Its green grows with the second texture
     * coordinate. */
    const char *scan_normal_map;
};

/** What vox_voxelize() did. */
struct vox_voxelize_report {
    size_t size;        /**< Of the structure, see bsq_clear_report(). */
    uint64_t triangles; /**< Triangles of the scan. */
    uint64_t voxels;    /**< Voxels that are set. */
    uint64_t
        second_records;   /**< Voxels with a second record, for a sheet of opposite orientation. */
    uint64_t leaves;      /**< Leaf nodes, 8 x 8 x 8 voxels. */
    uint64_t lowers;      /**< Lower nodes, 128 x 128 x 128 voxels. */
    uint64_t uppers;      /**< Upper nodes, 4096 x 4096 x 4096 voxels. */
    uint64_t grid_bytes;  /**< Size of the grid file. */
    double voxel_size;    /**< Edge of a voxel in the scan's units. */
    int32_t index_min[3]; /**< Smallest index of a set voxel on each axis. */
    int32_t index_max[3]; /**< Largest index of a set voxel on each axis. */
    bool has_color;       /**< The grid has a colour channel. */
    bool rounds_colors;   /**< The scan's vertex colours have more than its 8 bits. */
    bool has_ids;         /**< The grid has a channel of ids. */
    double seconds;       /**< Wall time. */
};

/** Fills in the defaults: a resolution of 2048, a mask grid, smooth normals, no OpenVDB file. */
void vox_voxelize_defaults(struct vox_voxelize_options *options);

/** Voxelizes a chunk file into a grid (formats/FORMATS.md) and fills in *report.
 *
 * A voxel is a half-open box. It is set if a triangle touches it by the separating-axis test
 * (Akenine-Moeller, "Fast 3D Triangle-Box Overlap Testing", 2001; in the form of Schwarz and
 * Seidel, "Fast Parallel Surface and Solid Voxelization on GPUs", 2010). Its record is the
 * area-weighted mean over the fragments of triangles that are clipped to it.
 *
 * Errors: BSQ_ENOINPUT; BSQ_EDATA for a damaged chunk file; BSQ_EUSAGE for a resolution or voxel
 * size that no grid can have; BSQ_ENOMEM, also if the budget is below vox_memory_min();
 * BSQ_ECANTCREAT; BSQ_EIO; BSQ_EINTR; those of vox_check_export(). */
int vox_voxelize(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_voxelize_report *report);

/** Checks that OpenVDB files can be written. vox_voxelize() checks this too; call it before other
 * long work. Errors: BSQ_ENOINPUT if its program is missing. */
int vox_check_export(struct bsq_ctx *ctx);

/** Distances between two surfaces, in the scan's units. */
struct vox_distances {
    double mean;     /**< Mean by area. */
    double rms;      /**< Root of the mean square by area. */
    double p99;      /**< Hundredth part of the area is farther, to 5 %. */
    double max;      /**< No point is farther, see bisque-simplify(1). */
    double where[3]; /**< A point that is as far, to 1 %. */
};

/** A box of space, whose sides may be infinite, and how far a mesh is from a scan in it. Maxima are
 * of all points of triangles that touch the box, the other figures of points in it, at its lower
 * sides too. All are 0 if there is none. */
struct vox_measured_box {
    double low[3];                  /**< Its lower corner, in the scan's units. */
    double high[3];                 /**< Its upper corner. */
    struct vox_distances from_scan; /**< Of the scan from the mesh. */
    struct vox_distances from_mesh; /**< Of the mesh from the scan. */
};

/** A mesh that vox_simplify() wrote. */
struct vox_simplified {
    uint64_t target;                /**< Triangles that were asked for; 0: an error. */
    uint64_t triangles;             /**< Triangles that it has. */
    uint64_t vertices;              /**< Positions that it has. */
    struct vox_distances from_scan; /**< From all of the scan to the mesh. */
    struct vox_distances from_mesh; /**< From all of the mesh to the scan. */
};

/** Most meshes of one vox_simplify(). */
#define VOX_LEVELS_MAX 32

/** What vox_simplify() reads and writes. The caller owns all strings and handles. */
struct vox_simplify_options {
    size_t size;                           /**< Of the structure, see bsq_check_size(). */
    const char *tris_path;                 /**< Input: a chunk file. */
    const struct vox_temp_tris *temp_tris; /**< NULL, or the input to read instead of tris_path. */
    /** Outputs, .obj, .ply or .glb: one for each target, or one alone for an error. */
    const char *const *output_paths;
    const uint64_t *targets; /**< Triangles of each mesh, falling. */
    uint32_t target_count;   /**< Number of targets; 0: `error` counts. */
    double error;            /**< Largest distance that a mesh may have, both ways; above 0. */
    /** Pieces whose box has a diagonal below this share of the scan's are dropped. */
    double min_component;
    /** Pieces of fewer triangles of the scan are dropped. Those of a scan that is reduced in parts
     * are estimated: each triangle that is left before the last collapse stands for as many. */
    uint64_t min_triangles;
    double hard_angle; /**< Normals are smooth over edges up to that many degrees. */
    bool unmeasured;   /**< Distances are not measured: they are 0. Not for an error. */
};

/** What vox_simplify() did. */
struct vox_simplify_report {
    size_t size;        /**< Of the structure, see bsq_clear_report(). */
    uint64_t triangles; /**< Triangles of the scan. */
    double diagonal;    /**< Diagonal of the scan's bounding box. */
    /** Pieces below min_component or min_triangles, and those whose loss changed the surface less
     * than a collapse of other edges would have. */
    uint64_t dropped_pieces;
    uint64_t dropped_triangles; /**< Their triangles when they went. */
    uint64_t cut_handles;       /**< Handles, tunnels and necks that were cut and closed. */
    struct vox_simplified levels[VOX_LEVELS_MAX]; /**< The meshes. */
    uint32_t level_count;                         /**< Number of meshes. */
    uint64_t temp_bytes;                          /**< Bytes that it wrote to temporary files. */
    double seconds_reduce;                        /**< Wall time of reducing chunks. */
    double seconds_collapse;                      /**< Wall time of the last collapse. */
    double seconds_measure;                       /**< Wall time of measuring. */
};

/** Reads what shares of a scan are of: the triangles of a chunk file, and the diagonal of their
 * bounding box. temp_tris: NULL, or the file to read instead of tris_path. Errors: BSQ_ENOINPUT,
 * BSQ_EDATA, BSQ_ENOMEM, BSQ_EIO. */
int vox_scan_size(struct bsq_ctx *ctx, const char *tris_path, const struct vox_temp_tris *temp_tris,
                  uint64_t *triangles, double *diagonal);

/** Fills in the defaults: no inputs and outputs, no piece dropped, smooth normals. */
void vox_simplify_defaults(struct vox_simplify_options *options);

/** Makes low-poly meshes of a scan by edge collapse, and measures how far each is from all of the
 * scan. The first part collapses groups of chunks with locked borders and quadrics (Garland and
 * Heckbert, 1997), the last one the whole mesh without memory of the scan, under the constraint
 * that its volume stays (Lindstrom and Turk, 1998). Vertices are welded by position; colours,
 * texture coordinates and materials have no influence. Output bytes do not
 * depend on budget or threads. Errors: BSQ_ENOINPUT; BSQ_EDATA for a damaged chunk file, or an
 * error that cannot be kept; BSQ_EUSAGE; BSQ_ENOMEM; BSQ_ECANTCREAT; BSQ_EIO; BSQ_EINTR. */
int vox_simplify(struct bsq_ctx *ctx, const struct vox_simplify_options *options,
                 struct vox_simplify_report *report);

/** Measures how far any mesh is from a scan, as vox_simplify() measures its own. The mesh is held
 * in memory. scan: NULL, or the chunk file to read instead of scan_path. mesh: of vox_sort().
 * from_scan receives the distances of the scan from the mesh, from_mesh those of the mesh from the
 * scan. boxes: NULL if box_count is 0; those of each box are set. Errors: BSQ_ENOINPUT, BSQ_EDATA,
 * BSQ_ENOMEM, BSQ_EIO, BSQ_EINTR. */
int vox_measure_mesh(struct bsq_ctx *ctx, const char *scan_path, const struct vox_temp_tris *scan,
                     const struct vox_temp_tris *mesh, struct vox_measured_box *boxes,
                     uint32_t box_count, struct vox_distances *from_scan,
                     struct vox_distances *from_mesh);

#ifdef __cplusplus
}
#endif
#endif

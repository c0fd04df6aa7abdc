/* voxelize.c - bisque-voxelize: a scan becomes a chunk file and a voxel grid. */
#include <assert.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "base/file.h"
#include "formats/recognise.h"
#include "libvoxel/voxel.h"
#include "tools/cli.h"

static const char help[] =
    "Usage: bisque-voxelize [OPTION]... SCAN.obj... -o SCAN.nvdb\n"
    "       bisque-voxelize [OPTION]... SCAN.tris -o SCAN.nvdb\n"
    "       bisque-voxelize --verify FILE...\n"
    "Turns a scan of any size into a sparse grid of surface voxels with normals and colours.\n"
    "Several OBJ files are read as one scan. The scan's sorted triangles are kept in a chunk file\n"
    "(SCAN.tris), from which grids of other resolutions can be made without reading the OBJ "
    "again.\n"
    "\n"
    "  -o, --output FILE       the grid, a NanoVDB file\n"
    "      --resolution N      voxels along the scan's longest side (default: 2048)\n"
    "      --voxel-size X      edge of a voxel in the scan's units, instead of a resolution\n"
    "      --grid-type TYPE    mask or onindex (NanoVDB 32.6 and later) (default: mask)\n"
    "      --scan-normals MODE smooth or flat, for a scan without normals (default: smooth)\n"
    "      --vdb FILE          also write the grid as an OpenVDB file\n"
    "      --texture FILE      colours for a scan with texture coordinates but no MTL file\n"
    "      --tris FILE         name of the chunk file (default: the output's, ending in .tris)\n"
    "      --no-tris           do not keep the chunk file\n"
    "      --parse-only        read the OBJ files and keep nothing, to measure the reader\n"
    "      --resume            go on with the chunk file of the same job, interrupted after sorting\n"
    "      --tmpdir DIR        directory for temporary files (default: $TMPDIR, else the "
    "output's)\n"
    "      --verify            check FILES (.tris, .nvdb) and print a line on each, nothing else\n" CLI_COMMON_HELP;

enum {
    OPT_RESOLUTION = CLI_OWN,
    OPT_VOXEL_SIZE,
    OPT_GRID_TYPE,
    OPT_SCAN_NORMALS,
    OPT_VDB,
    OPT_TEXTURE,
    OPT_TRIS,
    OPT_NO_TRIS,
    OPT_PARSE_ONLY,
    OPT_RESUME,
    OPT_VERIFY
};

static const struct option long_options[] = {
    {"output", required_argument, NULL, 'o'},
    {"resolution", required_argument, NULL, OPT_RESOLUTION},
    {"voxel-size", required_argument, NULL, OPT_VOXEL_SIZE},
    {"grid-type", required_argument, NULL, OPT_GRID_TYPE},
    {"scan-normals", required_argument, NULL, OPT_SCAN_NORMALS},
    {"vdb", required_argument, NULL, OPT_VDB},
    {"texture", required_argument, NULL, OPT_TEXTURE},
    {"tris", required_argument, NULL, OPT_TRIS},
    {"no-tris", no_argument, NULL, OPT_NO_TRIS},
    {"parse-only", no_argument, NULL, OPT_PARSE_ONLY},
    CLI_TMPDIR_OPTION,
    {"resume", no_argument, NULL, OPT_RESUME},
    {"verify", no_argument, NULL, OPT_VERIFY},
    CLI_COMMON_OPTIONS,
    {NULL, 0, NULL, 0},
};

enum { DEFAULT_RESOLUTION = 2048, MAX_RESOLUTION = 1 << 30 };

struct arguments {
    const char *const *inputs;
    uint32_t input_count;
    const char *output;
    uint64_t resolution; /* 0: not given */
    double voxel_size;   /* 0: not given */
    enum vox_grid_type grid_type;
    enum vox_scan_normals scan_normals;
    const char *vdb, *texture, *tris;
    bool no_tris, parse_only, resume, verify;
    const char *job_option; /* name of one that is of no use to --verify, NULL: none given */
};

struct job {
    struct cli *cli;
    const struct arguments *arguments;
    bool sorted_input; /* the input is a chunk file */
    bool resumed;      /* the chunk file was there already, see --resume */
    struct vox_job *record; /* of a job that can be resumed, or NULL */
    char *tris_path;   /* owned; of the chunk file that is read in the end */
    bool temporary_tris; /* the chunk file has no name: tris_path is that of none */
    struct bsq_file tris_file;
    struct vox_sort_report sort;
    struct vox_voxelize_report grid;
};

/* ---- arguments ---- */

static int parse_grid_type(struct cli *cli, struct arguments *arguments)
{
    static const char *const words[] = {"mask", "onindex", NULL};
    unsigned type = 0;
    int status = cli_parse_word(cli, "--grid-type", optarg, words, &type);
    if (status == 0)
        arguments->grid_type = type == 0 ? VOX_GRID_MASK : VOX_GRID_ONINDEX;
    return status;
}

static int parse_scan_normals(struct cli *cli, struct arguments *arguments)
{
    static const char *const words[] = {"smooth", "flat", NULL};
    unsigned mode = 0;
    int status = cli_parse_word(cli, "--scan-normals", optarg, words, &mode);
    if (status == 0)
        arguments->scan_normals = mode == 0 ? VOX_NORMALS_SMOOTH : VOX_NORMALS_FLAT;
    return status;
}

static int parse_option(struct cli *cli, struct arguments *arguments, int option)
{
    switch (option) {
    case 'o':
        arguments->output = optarg;
        return 0;
    case OPT_RESOLUTION:
        return cli_parse_count(cli, "--resolution", optarg, 1, MAX_RESOLUTION,
                               &arguments->resolution);
    case OPT_VOXEL_SIZE:
        return cli_parse_length(cli, "--voxel-size", optarg, true, &arguments->voxel_size);
    case OPT_GRID_TYPE:
        return parse_grid_type(cli, arguments);
    case OPT_SCAN_NORMALS:
        return parse_scan_normals(cli, arguments);
    case OPT_VDB:
        arguments->vdb = optarg;
        return 0;
    case OPT_TEXTURE:
        arguments->texture = optarg;
        return 0;
    case OPT_TRIS:
        arguments->tris = optarg;
        return 0;
    case OPT_NO_TRIS:
        arguments->no_tris = true;
        return 0;
    case OPT_PARSE_ONLY:
        arguments->parse_only = true;
        return 0;
    case OPT_RESUME:
        arguments->resume = true;
        return 0;
    case OPT_VERIFY:
        arguments->verify = true;
        return 0;
    default:
        return cli_common_option(cli, option, help);
    }
}

static int check_arguments(struct cli *cli, const struct arguments *arguments)
{
    if (arguments->input_count == 0)
        return cli_usage(cli, "no input file given (see --help)");
    if (arguments->verify && arguments->job_option)
        return cli_usage(cli, "--verify only checks files: leave out --%s", arguments->job_option);
    if (arguments->verify)
        return 0;
    if (arguments->parse_only && arguments->output)
        return cli_usage(cli, "--parse-only writes nothing: leave out --output");
    if (!arguments->parse_only && !arguments->output)
        return cli_usage(cli, "no output given: add -o FILE.nvdb");
    if (arguments->resolution > 0 && arguments->voxel_size > 0)
        return cli_usage(cli, "--resolution and --voxel-size exclude each other");
    if (arguments->tris && arguments->no_tris)
        return cli_usage(cli, "--tris and --no-tris exclude each other");
    if (arguments->resume && (arguments->no_tris || arguments->parse_only))
        return cli_usage(cli, "--resume goes on with a chunk file: leave out %s",
                         arguments->no_tris ? "--no-tris" : "--parse-only");
    return 0;
}

static int parse_arguments(struct cli *cli, struct arguments *arguments, int argc, char **argv)
{
    int option;
    while ((option = getopt_long(argc, argv, "o:", long_options, NULL)) != -1) {
        int status = parse_option(cli, arguments, option);
        if (status != 0)
            return status;
        if (option >= CLI_OWN || option == 'o')
            arguments->job_option = option == OPT_VERIFY ? arguments->job_option : cli_option_name(long_options, option);
    }
    arguments->inputs = (const char *const *)argv + optind;
    arguments->input_count = (uint32_t)(argc - optind);
    return check_arguments(cli, arguments);
}

/* ---- before the work: what would fail only after hours ---- */

static int recognise_inputs(struct job *job)
{
    const struct arguments *arguments = job->arguments;
    for (uint32_t i = 0; i < arguments->input_count; i++) {
        enum fmt_kind kind;
        int status = fmt_recognise(job->cli->ctx, arguments->inputs[i], &kind);
        if (status < 0)
            return status;
        if (kind == FMT_KIND_OTHER)
            continue;
        if (kind != FMT_KIND_TRIS)
            return bsq_fail(job->cli->ctx, BSQ_EDATA, "%s: a grid already; one is made from OBJ files or a chunk file",
                            arguments->inputs[i]);
        if (arguments->input_count > 1)
            return cli_usage(job->cli, "%s: a chunk file must be the only input",
                             arguments->inputs[i]);
        if (arguments->parse_only)
            return cli_usage(job->cli, "%s: --parse-only reads OBJ files", arguments->inputs[i]);
        if (arguments->texture || arguments->tris || arguments->resume)
            return cli_usage(job->cli, "%s is a chunk file already: leave out %s",
                             arguments->inputs[i],
                             arguments->tris ? "--tris" : arguments->texture ? "--texture" : "--resume");
        job->sorted_input = true;
    }
    return 0;
}

/* "out/scan.nvdb" gives "out/scan.tris". */
static char *default_tris_path(const char *output)
{
    char *path = NULL;
    size_t length = strlen(output);
    if (cli_ends_with(output, ".nvdb"))
        length -= strlen(".nvdb");
    if (asprintf(&path, "%.*s.tris", (int)length, output) < 0)
        return NULL;
    return path;
}

static int choose_tris_path(struct job *job)
{
    const struct arguments *arguments = job->arguments;
    job->temporary_tris = arguments->no_tris && !job->sorted_input;
    if (job->sorted_input)
        job->tris_path = strdup(arguments->inputs[0]);
    else if (arguments->tris)
        job->tris_path = strdup(arguments->tris);
    else
        job->tris_path = default_tris_path(arguments->output);
    if (!job->tris_path)
        return bsq_fail_errno(job->cli->ctx, BSQ_ENOMEM, ENOMEM, "%s", arguments->output);
    return 0;
}

static int check_outputs(struct job *job)
{
    const struct arguments *arguments = job->arguments;
    bool makes_tris = !job->sorted_input && !job->temporary_tris;
    const char *outputs[] = {arguments->output, makes_tris ? job->tris_path : NULL, arguments->vdb};
    for (unsigned i = 0; i < 3; i++) {
        if (!outputs[i])
            continue;
        for (unsigned j = 0; j < i; j++) {
            if (outputs[j] && cli_same_file(outputs[i], outputs[j]))
                return cli_usage(job->cli, "%s: two outputs have this name", outputs[i]);
        }
        int status = cli_check_output(job->cli, outputs[i], &arguments->texture, 1);
        if (status == 0)
            status =
                cli_check_output(job->cli, outputs[i], arguments->inputs, arguments->input_count);
        if (status < 0)
            return status;
    }
    return 0;
}

/* Sorting and voxelizing both need temporary files. */
static int check_temporary_files(struct job *job)
{
    struct bsq_file file;
    int status = bsq_file_temp(job->cli->ctx, job->arguments->output, "chunks", &file);
    bsq_file_close(job->cli->ctx, &file);
    return status;
}

static int check_memory(struct cli *cli)
{
    uint64_t least = vox_memory_min(bsq_threads(cli->ctx));
    uint64_t least_mib = (least + (1 << 20) - 1) >> 20;
    char limit[CLI_TEXT];
    if (bsq_memory_limit(cli->ctx) >= least)
        return 0;
    return cli_usage(cli, "--memory: %s is too small, %u thread%s need at least %lluMiB",
                     cli->memory_text ? cli->memory_text
                                      : cli_size_text(bsq_memory_limit(cli->ctx), limit),
                     bsq_threads(cli->ctx), bsq_threads(cli->ctx) == 1 ? "" : "s",
                     (unsigned long long)least_mib);
}

/* ---- reports ---- */

static void print_inputs(const struct arguments *arguments)
{
    if (arguments->input_count == 1)
        printf("%s: ", arguments->inputs[0]);
    else
        printf("%u files: ", arguments->input_count);
}

static void print_read(const struct job *job)
{
    const struct vox_sort_report *sort = &job->sort;
    char vertices[CLI_TEXT], faces[CLI_TEXT], triangles[CLI_TEXT], size[CLI_TEXT];
    print_inputs(job->arguments);
    printf("%s, %s, %s, %s, %.2f s\n", cli_things_text(sort->vertices, "vertex", "vertices", vertices),
           cli_things_text(sort->faces, "face", "faces", faces),
           cli_things_text(sort->triangles, "triangle", "triangles", triangles),
           cli_size_text(sort->bytes_read, size), sort->seconds_read);
    const char *first = "left out: ";
    const char *next = cli_print_count(first, sort->degenerate_triangles, "degenerate triangle",
                                       "degenerate triangles");
    next = cli_print_count(next, sort->short_faces, "face with fewer than three corners",
                           "faces with fewer than three corners");
    next = cli_print_count(next, sort->unused_vertices, "unused vertex", "unused vertices");
    next = cli_print_count(next, sort->skipped_lines, "unknown line", "unknown lines");
    if (next != first)
        putchar('\n');
}

static void print_grid(const struct job *job)
{
    const struct vox_voxelize_report *grid = &job->grid;
    const struct arguments *arguments = job->arguments;
    char voxels[CLI_TEXT], size[CLI_TEXT], chunks[CLI_TEXT];
    if (!job->sorted_input && !job->resumed && !job->temporary_tris)
        printf("%s: %s, %s, %.2f s\n", job->tris_path,
               cli_things_text(job->sort.chunks, "chunk", "chunks", chunks), cli_size_text(job->sort.tris_bytes, size),
               job->sort.seconds_sort);
    printf("%s: %s in %lld x %lld x %lld, voxel size %g, %s%s, %.2f s\n", arguments->output,
           cli_things_text(grid->voxels, "voxel", "voxels", voxels),
           (long long)grid->index_max[0] - grid->index_min[0] + 1,
           (long long)grid->index_max[1] - grid->index_min[1] + 1,
           (long long)grid->index_max[2] - grid->index_min[2] + 1, grid->voxel_size,
           cli_size_text(grid->grid_bytes, size), grid->has_color ? ", with colour" : "",
           grid->seconds);
    if (arguments->vdb)
        printf("%s: the same as OpenVDB\n", arguments->vdb);
}

static json_t *inputs_json(const struct arguments *arguments)
{
    json_t *list = json_array();
    for (uint32_t i = 0; list && i < arguments->input_count; i++) {
        if (json_array_append_new(list, cli_json_text(arguments->inputs[i])) != 0) {
            json_decref(list);
            list = NULL;
        }
    }
    return list;
}

static json_t *sort_json(const struct vox_sort_report *sort)
{
    return json_pack(
        "{s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:[f, f, f], s:b, s:b, s:b,"
        " s:f, s:f}",
        "bytes_read", (json_int_t)sort->bytes_read, "vertices", (json_int_t)sort->vertices, "faces",
        (json_int_t)sort->faces, "triangles", (json_int_t)sort->triangles, "degenerate_triangles",
        (json_int_t)sort->degenerate_triangles, "short_faces", (json_int_t)sort->short_faces,
        "unused_vertices", (json_int_t)sort->unused_vertices, "skipped_lines",
        (json_int_t)sort->skipped_lines, "chunks", (json_int_t)sort->chunks, "tris_bytes",
        (json_int_t)sort->tris_bytes, "temp_bytes", (json_int_t)sort->temp_bytes, "origin",
        sort->origin[0], sort->origin[1], sort->origin[2], "has_normals", (int)sort->has_normals,
        "has_texcoords", (int)sort->has_texcoords, "has_colors", (int)sort->has_colors,
        "seconds_read", sort->seconds_read, "seconds_sort", sort->seconds_sort);
}

static json_t *grid_json(const struct vox_voxelize_report *grid)
{
    return json_pack("{s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:[i, i, i], s:[i, i, i], s:b, s:f}",
                     "triangles", (json_int_t)grid->triangles, "voxels", (json_int_t)grid->voxels,
                     "second_records", (json_int_t)grid->second_records, "leaves",
                     (json_int_t)grid->leaves, "lowers", (json_int_t)grid->lowers, "uppers",
                     (json_int_t)grid->uppers, "grid_bytes", (json_int_t)grid->grid_bytes,
                     "voxel_size", grid->voxel_size, "index_min", grid->index_min[0],
                     grid->index_min[1], grid->index_min[2], "index_max", grid->index_max[0],
                     grid->index_max[1], grid->index_max[2], "has_color", (int)grid->has_color,
                     "seconds", grid->seconds);
}

static int print_json(const struct job *job)
{
    const struct arguments *arguments = job->arguments;
    bool keeps_tris = !arguments->parse_only && !job->temporary_tris;
    json_t *root = json_pack("{s:o, s:b, s:o, s:o, s:o, s:o, s:o}", "inputs", inputs_json(arguments), "resumed", (int)job->resumed,
                             "grid_path", cli_json_text(arguments->output), "tris_path",
                             cli_json_text(keeps_tris ? job->tris_path : NULL), "vdb_path",
                             cli_json_text(arguments->vdb), "scan",
                             job->sorted_input || job->resumed ? json_null() : sort_json(&job->sort), "grid",
                             arguments->parse_only ? json_null() : grid_json(&job->grid));
    return cli_print_json(job->cli, root);
}

static int report(const struct job *job)
{
    if (job->cli->json)
        return print_json(job);
    if (job->resumed)
        printf("%s: complete from the run before, reading and sorting were skipped\n", job->tris_path);
    else if (!job->sorted_input)
        print_read(job);
    if (!job->arguments->parse_only)
        print_grid(job);
    cli_print_cost(job->cli);
    return 0;
}

/* ---- the work ---- */

static int sort_scan(struct job *job)
{
    const struct arguments *arguments = job->arguments;
    struct vox_sort_options options = {
        .obj_paths = arguments->inputs,
        .obj_count = arguments->input_count,
        .texture_path = arguments->texture,
        .tris_path = job->tris_path,
        .tris_file = job->temporary_tris ? &job->tris_file : NULL,
    };
    struct bsq_ctx *ctx = job->cli->ctx;
    int status = 0;
    /* A temporary chunk file is removed whatever happens, so there is nothing to go on with. */
    if (!job->temporary_tris && (status = vox_job_open(ctx, &options, &job->record)) < 0)
        return status;
    if (arguments->resume)
        status = vox_job_resume(job->record, &job->resumed);
    if (status < 0 || job->resumed)
        return status;
    options.job = job->record;
    status = vox_sort(ctx, &options, &job->sort);
    return status == 0 && job->record ? vox_job_record(job->record) : status;
}

static int make_grid(struct job *job)
{
    const struct arguments *arguments = job->arguments;
    struct vox_voxelize_options options = {
        .tris_path = job->tris_path,
        .tris_file = job->temporary_tris ? &job->tris_file : NULL,
        .grid_path = arguments->output,
        .resolution = (uint32_t)arguments->resolution,
        .voxel_size = arguments->voxel_size,
        .grid_type = arguments->grid_type,
        .scan_normals = arguments->scan_normals,
        .vdb_path = arguments->vdb,
    };
    if (options.resolution == 0 && options.voxel_size == 0)
        options.resolution = DEFAULT_RESOLUTION;
    return vox_voxelize(job->cli->ctx, &options, &job->grid);
}

static int do_work(struct job *job)
{
    const struct arguments *arguments = job->arguments;
    if (arguments->parse_only)
        return vox_parse_only(job->cli->ctx, arguments->inputs, arguments->input_count, &job->sort);
    assert(arguments->output); /* see check_arguments() */
    int status = check_memory(job->cli);
    if (status == 0 && arguments->vdb)
        status = vox_check_export(job->cli->ctx);
    if (status == 0)
        status = choose_tris_path(job);
    if (status == 0)
        status = check_outputs(job);
    if (status == 0)
        status = check_temporary_files(job);
    if (status == 0 && !job->sorted_input)
        status = sort_scan(job);
    if (status == 0)
        status = make_grid(job);
    if (status == 0)
        vox_job_finish(job->record);
    return status;
}

static int run(struct cli *cli, const struct arguments *arguments)
{
    struct job job = {.cli = cli, .arguments = arguments, .tris_file = BSQ_FILE_CLOSED};
    if (arguments->verify)
        return cli_verify(cli, (char *const *)arguments->inputs, (int)arguments->input_count);
    int status = recognise_inputs(&job);
    if (status == 0)
        status = do_work(&job);
    bsq_file_close(cli->ctx, &job.tris_file);
    if (status == 0)
        status = report(&job);
    vox_job_close(job.record);
    free(job.tris_path);
    return status;
}

int main(int argc, char **argv)
{
    struct cli cli;
    struct arguments arguments = {0};
    cli_begin(&cli, "bisque-voxelize", argv);
    int status = parse_arguments(&cli, &arguments, argc, argv);
    if (status == 0)
        status = cli_create_context(&cli);
    if (status == 0)
        status = run(&cli, &arguments);
    return cli_end(&cli, status);
}

/* voxelize_arguments.c - see voxelize_arguments.h. */
#include "tools/voxelize_arguments.h"

#include "formats/material/channels.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "Usage: bisque-voxelize [OPTION]... SCAN.obj... -o SCAN.nvdb\n"
    "       bisque-voxelize [OPTION]... SCAN.tris... -o SCAN.nvdb\n"
    "       bisque-voxelize [OPTION]... SCAN.obj|SCAN.tris... -o SCAN.tris\n"
    "       bisque-voxelize --info|--verify FILE...\n"
    "Turns a scan (a high-poly mesh) of any size into a sparse grid of surface voxels with normals\n"
    "and colours. Several files are read as one scan. The sorted triangles of meshes are kept in a chunk\n"
    "file (SCAN.tris), which makes grids of other resolutions without reading them again.\n";

/* Bits of bsq_option.needs: what the option does nothing without. */
enum { GRID = 1, MESHES = 2 };

#define MEMBER(kind, member) BSQ_MEMBER(kind, struct voxelize_arguments, member)

static const struct bsq_option rows[] = {
    {BSQ_ROW("output", "FILE", "the grid, a NanoVDB file; a name that ends in .tris sorts only"),
     .letter = 'o', .heading = "Grid", MEMBER(OUTPUT, grid.grid_path)},
    {BSQ_ROW("resolution", "N", "voxels along the scan's longest side"),
     MEMBER(COUNT, grid.resolution), BSQ_RANGE(1, VOX_RESOLUTION_MAX, 2048), .needs = GRID},
    {BSQ_ROW("voxel-size", "X",
             "edge of a voxel in the scan's units, instead of a resolution\n"
             "(default: by the resolution)"),
     MEMBER(NUMBER, grid.voxel_size), BSQ_RANGE(0, DBL_MAX, 0), .positive = true, .needs = GRID},
    {BSQ_ROW("vdb", "FILE", "also write the grid as an OpenVDB file"),
     MEMBER(OUTPUT, grid.vdb_path), .needs = GRID},

    {BSQ_ROW("scan-normals", "NAME",
             "for a scan without normals: smooth, flat; or smooth ones by\n"
             "weight: area, angle (as Blender, no creases) or max (default,\n"
             "auto: those of the chunk file, smooth for meshes; that is area)"),
     .heading = "Scan", MEMBER(CHOICE, grid.scan_normals),
     .words = "auto smooth/area angle max flat"},
    {BSQ_ROW("channels", "LIST",
             "what else to keep in chunks and grid: id; for maps transfer:NAME,\n"
             "NAME of the materials, all of them, or NAME=FILE; none"),
     BSQ_OWN},
    {BSQ_ROW("scan-normal-map", "FILE",
             "the scan's own normal map in tangent space, added to its normals"),
     MEMBER(INPUT, grid.scan_normal_map)},
    {BSQ_ROW("id", "KIND", "what ids tell apart: material, object or color (default: material)"),
     MEMBER(CHOICE, sort.ids), .words = "none material object color", .needs = MESHES},
    {BSQ_ROW("texture", "FILE", "colours for a scan with texture coordinates but no MTL file"),
     MEMBER(INPUT, sort.texture_path), .needs = MESHES},
    {BSQ_ROW("scale", "X", "multiply the scan's positions by X"), BSQ_OWN},
    {BSQ_ROW("up", "AXIS", "turn the scan so that y or z points upwards"), BSQ_OWN},
    {BSQ_ROW("translate", "X,Y,Z",
             "then shift the scan; these three options, given once, are for all\n"
             "files; given once for each file, they are for the files in order"),
     BSQ_OWN},

    {BSQ_ROW("origin", "X,Y,Z",
             "store positions relative to this point: the same one for parts of\n"
             "a scan that are sorted one by one (default: one near the scan)"),
     BSQ_OWN, .needs = MESHES},

    {BSQ_ROW("tris", "FILE", "name of the chunk file (default: the output's, ending in .tris)"),
     .heading = "Chunk file", MEMBER(OUTPUT, tris), .needs = GRID | MESHES},
    {BSQ_ROW("embed-textures", NULL,
             "copy the scan's textures into the chunk file, which can then move"),
     MEMBER(FLAG, sort.embed_textures), .needs = MESHES},
    {BSQ_ROW("no-tris", NULL, "do not keep the chunk file"), MEMBER(FLAG, no_tris), .needs = GRID},
    {BSQ_ROW("parse-only", NULL, "only read the mesh files, to measure the reader"),
     MEMBER(FLAG, parse_only)},
    {BSQ_ROW("info", NULL, "print what is in FILES (meshes, .tris, .nvdb), do nothing else"),
     MEMBER(FLAG, info)},
};
enum { ROWS = sizeof rows / sizeof *rows };
_Static_assert(sizeof rows / sizeof *rows <= VOXELIZE_MOST_ROWS, "a flag for each row");

static const struct bsq_option cli_rows[] = {CLI_TMPDIR_ROW, CLI_STRICT_ROW, CLI_VERIFY_ROW};

/* Returns the name of an option, other than --info, that was given and has one of these bits in
 * `needs`; 0: of any option. NULL: none was. */
static const char *given_option(const struct voxelize_arguments *arguments, uint32_t needs)
{
    for (unsigned i = 0; i < ROWS; i++)
        if (arguments->given[i] && strcmp(rows[i].name, "info") != 0 &&
            (needs == 0 || rows[i].needs & needs))
            return rows[i].name;
    return NULL;
}

static struct cli_table scan_args_table(const struct voxelize_arguments *arguments)
{
    return (struct cli_table){rows, ROWS, (void *)(uintptr_t)arguments,
                              (bool *)(uintptr_t)arguments->given};
}

/* ---- where files lie ---- */

static int parse_scale(struct cli *cli, struct voxelize_arguments *a, const char *text)
{
    static const struct bsq_option row = {BSQ_MEMBER(NUMBER, struct bsq_placement, scale),
                                          BSQ_RANGE(0, DBL_MAX, 1), .positive = true};
    return cli_parse_value(cli, "--scale", &row, text, &a->placements[a->scales++]);
}

static int parse_up(struct cli *cli, struct voxelize_arguments *a, const char *text)
{
    unsigned axis = 0;
    const int status = cli_parse_word(cli, "--up", text, "y z", &axis);
    a->placements[a->ups++].up = axis == 0 ? BSQ_UP_Y : BSQ_UP_Z;
    return status;
}

/* Parses "X,Y,Z". */
static int parse_point(struct cli *cli, const char *option, const char *text, double point[3])
{
    const bool decimal = strspn(text, "0123456789.eE+-,") == strlen(text);
    const char *from = text;
    for (int axis = 0; axis < 3; axis++) {
        char *end;
        point[axis] = strtod(from, &end);
        if (!decimal || end == from || !isfinite(point[axis]) || *end != (axis < 2 ? ',' : '\0'))
            return cli_usage(cli, "--%s: \"%s\" is not of the form X,Y,Z", option, text);
        from = end + 1;
    }
    return 0;
}

/* Turns the options into a placement for each file: what was given once is for all of them. */
static int finish_placements(struct cli *cli, struct voxelize_arguments *a)
{
    const uint32_t inputs = a->input_count;
    const struct {
        const char *name;
        uint32_t count;
    } given[] = {{"--scale", a->scales}, {"--up", a->ups}, {"--translate", a->translations}};
    for (int i = 0; i < 3; i++)
        if (given[i].count > 1 && given[i].count != inputs)
            return cli_usage(cli,
                             "%s is given %u times for %u file%s: give it once, or once for each "
                             "file",
                             given[i].name, given[i].count, inputs, inputs == 1 ? "" : "s");
    for (uint32_t i = 1; i < inputs; i++) {
        struct bsq_placement *to = &a->placements[i];
        if (a->scales == 1)
            to->scale = a->placements->scale;
        if (a->ups == 1)
            to->up = a->placements->up;
        if (a->translations == 1)
            memcpy(to->translate, a->placements->translate, sizeof to->translate);
    }
    if (a->scales + a->ups + a->translations > 0)
        a->sort.placements = a->placements;
    return 0;
}

/* Makes a placement for each word of the command line: more than options or files. */
static void begin_placements(struct voxelize_arguments *a, int words)
{
    a->placements = cli_keep((size_t)words * sizeof *a->placements);
    for (int i = 0; i < words; i++)
        a->placements[i].scale = 1;
}

/* ---- channels ---- */

/* Adds a channel to those of the chunk file. path: of its image, or NULL; optional: if the scan has
 * it. */
static void scan_args_add_channel(struct voxelize_arguments *arguments, const char *name,
                                  const char *path, bool optional)
{
    struct vox_sort_options *sort = &arguments->sort;
    arguments->channels =
        cli_extend(arguments->channels, sort->channel_count, sizeof *arguments->channels);
    arguments->channels[sort->channel_count++] = (struct vox_channel){name, path, optional};
    sort->channels = arguments->channels;
}

static bool has_channel(const struct voxelize_arguments *arguments, const char *name)
{
    bool any = false;
    for (uint32_t i = 0; i < arguments->sort.channel_count; i++)
        any |= strcmp(arguments->channels[i].name, name) == 0;
    return any;
}

/* Parses "id", "all", "none", "NAME" or "NAME=FILE". */
static int parse_channel(struct cli *cli, struct voxelize_arguments *arguments, const char *word)
{
    const char *equals = strchr(word, '=');
    arguments->all_channels |= strcmp(word, "all") == 0;
    arguments->grid.ids |= strcmp(word, "id") == 0;
    if (strcmp(word, "id") == 0 || strcmp(word, "all") == 0 || strcmp(word, "none") == 0)
        return 0;
    const char *name = cli_keep_text("%.*s", (int)strcspn(word, "="), word);
    const char *list = arguments->grid.channels;
    scan_args_add_channel(arguments, name, equals ? equals + 1 : NULL, false);
    if (!fmt_is_channel_name(name))
        return cli_usage(cli, "--channels: \"%s\" is not a channel", word);
    if (fmt_is_map_name(name))
        return cli_usage(cli, "--channels: \"%s\": there is a map of this name", word);
    if (equals && equals[1] == '\0')
        return cli_usage(cli, "--channels: \"%s\" names no file", word);
    if (strcmp(name, FMT_CHANNEL_NORMAL_MAP) != 0)
        arguments->grid.channels = cli_keep_text("%s%s%s", list ? list : "", list ? "," : "", name);
    return 0;
}

static bool keeps_normal_map(const struct voxelize_arguments *arguments)
{
    return has_channel(arguments, FMT_CHANNEL_NORMAL_MAP);
}

static int scan_args_take_option(struct cli *cli, void *arg, const struct bsq_option *row,
                                 const char *text)
{
    struct voxelize_arguments *arguments = arg;
    if (strcmp(row->name, "scale") == 0)
        return parse_scale(cli, arguments, text);
    if (strcmp(row->name, "up") == 0)
        return parse_up(cli, arguments, text);
    if (strcmp(row->name, "translate") == 0)
        return parse_point(cli, row->name, text,
                           arguments->placements[arguments->translations++].translate);
    if (strcmp(row->name, "origin") == 0) {
        arguments->sort.origin = arguments->origin;
        return parse_point(cli, row->name, text, arguments->origin);
    }
    /* --channels: paths of images must not have commas. */
    for (char *word = (char *)(uintptr_t)text; word;) {
        char *next = strchr(word, ',');
        if (next)
            *next++ = '\0';
        BSQ_PASS(parse_channel(cli, arguments, word));
        word = next;
    }
    return 0;
}

void voxelize_arguments_add_channels(struct voxelize_arguments *arguments)
{
    const char *path = arguments->grid.scan_normal_map;
    if (path)
        scan_args_add_channel(arguments, FMT_CHANNEL_NORMAL_MAP, path, false);
    for (unsigned i = 0; arguments->all_channels && fmt_channel_at(i); i++) {
        const char *any = fmt_channel_at(i)->name;
        if (!has_channel(arguments, any))
            scan_args_add_channel(arguments, any, NULL, true);
    }
}

/* ---- all of them ---- */

static int scan_args_check(struct cli *cli, const struct voxelize_arguments *arguments)
{
    static const char *const exclude[][2] = {
        {"resolution", "voxel-size"}, {"tris", "no-tris"}, {"embed-textures", "no-tris"}};
    const struct cli_table table = scan_args_table(arguments);
    const char *output = arguments->grid.grid_path;
    if (arguments->parse_only && output)
        return cli_usage(cli, "--parse-only writes nothing: leave out --output");
    if (arguments->parse_only && arguments->scales + arguments->ups + arguments->translations > 0)
        return cli_usage(cli, "--parse-only only reads: leave out --scale, --up and --translate");
    if (!arguments->parse_only && !output)
        return cli_usage(cli, "no output given: add -o FILE.nvdb");
    if (output && cli_ends_with(output, ".vdb"))
        return cli_usage(cli,
                         "%s: a grid is a NanoVDB file: give -o FILE.nvdb, and --vdb %s for an "
                         "OpenVDB file beside it",
                         output, output);
    for (size_t i = 0; i < sizeof exclude / sizeof *exclude; i++)
        if (cli_is_given(&table, exclude[i][0]) && cli_is_given(&table, exclude[i][1]))
            return cli_usage(cli, "--%s and --%s exclude each other", exclude[i][0], exclude[i][1]);
    if (cli_is_given(&table, "id") && !arguments->grid.ids)
        return cli_usage(cli, "--id needs --channels id");
    if (arguments->grid.scan_normal_map && keeps_normal_map(arguments))
        return cli_usage(cli, "--scan-normal-map and --channels " FMT_CHANNEL_NORMAL_MAP
                              " exclude each other");
    if (arguments->sort_only && given_option(arguments, GRID))
        return cli_usage(cli, "%s: a chunk file is not a grid: leave out --%s", output,
                         given_option(arguments, GRID));
    return 0;
}

int voxelize_arguments_check_part(struct cli *cli, const struct voxelize_arguments *arguments,
                                  const char *part, bool beside_meshes)
{
    const char *option = given_option(arguments, MESHES);
    bool images = false;
    for (uint32_t i = 0; i < arguments->sort.channel_count; i++)
        images |= arguments->channels[i].texture_path != NULL;
    if (arguments->parse_only)
        return cli_usage(cli, "%s: --parse-only reads meshes", part);
    if (arguments->sort.placements)
        return cli_usage(cli, "%s is a chunk file: --scale, --up and --translate are for meshes",
                         part);
    if (!beside_meshes && (option || images))
        return cli_usage(cli, "%s is already a chunk file: leave out %s%s", part,
                         option ? "--" : "", option ? option : "the images of --channels");
    if (!beside_meshes && keeps_normal_map(arguments))
        return cli_usage(cli,
                         "%s is already a chunk file: leave out the channel " FMT_CHANNEL_NORMAL_MAP
                         ", because its normals contain it if it has one",
                         part);
    if (beside_meshes && !arguments->tris &&
        (arguments->sort.channel_count > 0 || arguments->all_channels))
        return cli_usage(cli, "--channels: beside chunk files, meshes are kept with --tris only");
    return 0;
}

/* Sets what follows from the options. */
static int scan_args_finish(struct cli *cli, struct voxelize_arguments *arguments)
{
    const struct cli_table table = scan_args_table(arguments);
    if (cli_is_given(&table, "voxel-size"))
        arguments->grid.resolution = 0;
    if (!arguments->grid.ids)
        arguments->sort.ids = VOX_IDS_NONE;
    if (arguments->all_channels)
        arguments->grid.channels = "all";
    arguments->sort.tells_unkept = !cli_is_given(&table, "channels");
    return finish_placements(cli, arguments);
}

int voxelize_arguments_parse(struct cli *cli, struct voxelize_arguments *arguments, int argc,
                             char **argv)
{
    const struct cli_command command = {
        .usage = usage,
        .tables = {scan_args_table(arguments),
                   {cli_rows, sizeof cli_rows / sizeof *cli_rows, cli, NULL}},
        .take = scan_args_take_option,
        .arguments = arguments,
    };
    vox_sort_defaults(&arguments->sort);
    vox_voxelize_defaults(&arguments->grid);
    arguments->sort.ids = VOX_IDS_MATERIAL;
    begin_placements(arguments, argc);
    const int status = cli_parse(cli, &command, argc, argv);
    arguments->inputs = (const char *const *)argv + optind;
    arguments->input_count = (uint32_t)(argc - optind);
    arguments->sort_only =
        arguments->grid.grid_path && cli_ends_with(arguments->grid.grid_path, ".tris");
    if (status != 0 || cli->verify)
        return status;
    if (arguments->input_count == 0)
        return cli_usage(cli, "no input file given (see --help)");
    if (arguments->info)
        return given_option(arguments, 0)
                   ? cli_usage(cli, "--info only describes files: leave out --%s",
                               given_option(arguments, 0))
                   : 0;
    BSQ_PASS(scan_args_check(cli, arguments));
    return scan_args_finish(cli, arguments);
}

/* cli_verify.c - the option --verify: checks files and reports on each. */
#include "formats/file_kind.h"
#include "tools/cli.h"

static void print_content(const char *path, const struct fmt_verify_report *r)
{
    char triangles[CLI_TEXT], parts[CLI_TEXT], more[CLI_TEXT], size[CLI_TEXT];
    cli_counted_text(r->triangles, "triangle", "triangles", triangles);
    cli_size_text(r->file_bytes, size);
    if (r->kind == FMT_KIND_TRIS)
        cli_print("%s: ok (chunk file of version %u: %s and %s in %s, %s)\n", path, r->version,
                  triangles, cli_counted_text(r->vertices, "vertex", "vertices", more),
                  cli_counted_text(r->chunks, "chunk", "chunks", parts), size);
    else
        cli_print(
            "%s: ok (surface grid of version %u, NanoVDB %u.%u.%u %s: %s and %s of %s%s, %s)\n",
            path, r->version, r->nanovdb_version[0], r->nanovdb_version[1], r->nanovdb_version[2],
            r->is_mask ? "mask" : "onindex", cli_counted_text(r->voxels, "voxel", "voxels", parts),
            cli_counted_text(r->second_records, "second record", "second records", more), triangles,
            r->has_color ? ", with colour" : "", size);
}

static json_t *content_json(const char *path, const struct fmt_verify_report *r)
{
    if (r->kind == FMT_KIND_TRIS)
        return json_pack("{s:o, s:b, s:s, s:i, s:I, s:I, s:I, s:I}", "path", cli_json_text(path),
                         "ok", 1, "kind", "tris", "version", (int)r->version,
                         CLI_COUNT(r, file_bytes), CLI_COUNT(r, triangles), CLI_COUNT(r, vertices),
                         CLI_COUNT(r, chunks));
    return json_pack("{s:o, s:b, s:s, s:i, s:[i, i, i], s:s, s:I, s:I, s:I, s:I, s:f, s:b}", "path",
                     cli_json_text(path), "ok", 1, "kind", "nvdb", "version", (int)r->version,
                     "nanovdb_version", (int)r->nanovdb_version[0], (int)r->nanovdb_version[1],
                     (int)r->nanovdb_version[2], "grid_type", r->is_mask ? "mask" : "onindex",
                     CLI_COUNT(r, file_bytes), CLI_COUNT(r, triangles), CLI_COUNT(r, voxels),
                     CLI_COUNT(r, second_records), CLI_VALUE(r, voxel_size), "has_color",
                     (int)r->has_color);
}

/* Checks one file. *entry is its JSON object; NULL without --json or without memory. */
static int verify_file(struct cli *cli, const char *path, json_t **entry)
{
    struct fmt_verify_report report = {.size = sizeof report};
    int status = fmt_verify(cli->ctx, path, &report);
    *entry = NULL;
    cli_clear_bar(cli);
    if (status < 0)
        fprintf(stderr, "%s: %s\n", cli->program, bsq_error(cli->ctx));
    else if (!cli->json)
        print_content(path, &report);
    if (cli->json && status == 0)
        *entry = content_json(path, &report);
    else if (cli->json)
        *entry = json_pack("{s:o, s:b, s:i, s:o}", "path", cli_json_text(path), "ok", 0, "status",
                           -status, "error", cli_json_text(bsq_error(cli->ctx)));
    return status;
}

int cli_verify(struct cli *cli, char *const *paths, int count)
{
    json_t *list = cli->json ? json_array() : NULL;
    int result = 0;
    for (int i = 0; i < count; i++) {
        json_t *entry;
        int status = verify_file(cli, paths[i], &entry);
        if (cli->json)
            cli_json_append(&list, entry);
        result = result < 0 ? result : status;
        if (status == BSQ_EINTR)
            break;
        if (status < 0)
            bsq_clear_error(cli->ctx);
    }
    cli->reported = result < 0;
    if (cli->json) {
        int status = cli_print_json(cli, json_pack("{s:o}", "files", list));
        if (status < 0)
            cli->reported = false;
        result = result < 0 ? result : status;
    }
    return result;
}

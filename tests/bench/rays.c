/* rays.c - measures how many ray pairs a second each device traces, and Embree with the same rays
 * on the triangles of the scan. Prints a table in Markdown.
 *
 *   bench-rays SCAN.nvdb SCAN.tris LOW.obj SIZE SAMPLES ROUNDS */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/bench/rays.h"

enum { MAX_DEVICES = 16, MAX_ROUNDS = 99 };

struct row {
    char id[32], name[128];
    double rates[MAX_ROUNDS], per_processor[MAX_ROUNDS], ratios[MAX_ROUNDS];
    double upload;
    uint64_t hits;
    bool failed;
};

struct bench {
    struct bsq_ctx *ctx;
    struct rays_scene scene;
    const char *tris;
    unsigned rounds, devices;
    struct row rows[MAX_DEVICES], embree;
};

static void on_device(void *arg, const struct bake_device_info *info)
{
    struct bench *bench = arg;
    if (bench->devices == MAX_DEVICES)
        return;
    struct row *row = &bench->rows[bench->devices++];
    snprintf(row->id, sizeof row->id, "%s", info->id);
    snprintf(row->name, sizeof row->name, "%s", info->name);
}

/* Records the cost of a round. */
static void note(struct bench *bench, struct row *row, unsigned round, const struct rays_cost *cost)
{
    const double pairs = 1e-6 * (double)bench->scene.count;
    row->rates[round] = pairs / cost->wall;
    row->per_processor[round] = pairs / cost->processor;
    row->ratios[round] = row->rates[round] / bench->embree.rates[round];
    row->hits = cost->hits;
}

/* Measures a device once. If it fails, later rounds and the table skip it. */
static int run_device(struct bench *bench, struct row *row, unsigned round)
{
    struct bake_device *device;
    struct bake_device_times times;
    struct rays_cost cost;
    int status = bake_device_open(bench->ctx, row->id, &bench->scene.job, &device);
    if (status == 0)
        status = rays_trace(&bench->scene, device, &cost);
    if (status == 0) {
        note(bench, row, round, &cost);
        bake_device_times(device, &times);
        row->upload = times.upload;
        bake_device_close(device);
        return 0;
    }
    fprintf(stderr, "bench-rays: %s: %s\n", row->id, bsq_error(bench->ctx));
    bsq_clear_error(bench->ctx);
    row->failed = true;
    return status == BSQ_EINTR ? status : 0;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(const double *values, unsigned count)
{
    double sorted[MAX_ROUNDS];
    memcpy(sorted, values, count * sizeof *sorted);
    qsort(sorted, count, sizeof *sorted, by_value);
    return count % 2 ? sorted[count / 2] : (sorted[count / 2 - 1] + sorted[count / 2]) / 2;
}

static void print_row(const struct bench *bench, const struct row *row, bool on_processor)
{
    char per[32] = "-";
    if (on_processor)
        snprintf(per, sizeof per, "%.2f", median(row->per_processor, bench->rounds));
    printf("| %-10s | %6.2f | %8.2f | %9s | %6.3f | %8.2f | %s |\n", row->id,
           median(row->ratios, bench->rounds), median(row->rates, bench->rounds), per,
           (double)row->hits / (double)bench->scene.count, row->upload, row->name);
}

static void print(const struct bench *bench)
{
    printf("%.1f million ray pairs a round, %u thread%s, %u round%s\n\n",
           1e-6 * (double)bench->scene.count, bsq_threads(bench->ctx),
           bsq_threads(bench->ctx) == 1 ? "" : "s", bench->rounds, bench->rounds == 1 ? "" : "s");
    puts("| device     |  ratio |  M/s     | M/s, core | hits   | upload s | name |\n"
         "|:-----------|-------:|---------:|----------:|-------:|---------:|:-----|");
    print_row(bench, &bench->embree, true);
    for (unsigned i = 0; i < bench->devices; i++)
        if (!bench->rows[i].failed)
            print_row(bench, &bench->rows[i], strcmp(bench->rows[i].id, "cpu") == 0);
}

static int run(struct bench *bench)
{
    struct rays_cost building = {0}, cost;
    int status = 0;
    for (unsigned round = 0; round < bench->rounds && status == 0; round++) {
        /* The first device also counts the rays. */
        status = run_device(bench, &bench->rows[0], round);
        if (status == 0)
            status = rays_embree(&bench->scene, bench->tris, &building, &cost);
        if (status < 0)
            return status;
        note(bench, &bench->embree, round, &cost);
        bench->embree.upload = building.wall;
        bench->rows[0].ratios[round] = bench->rows[0].rates[round] / bench->embree.rates[round];
        for (unsigned i = 1; i < bench->devices && status == 0; i++)
            if (!bench->rows[i].failed)
                status = run_device(bench, &bench->rows[i], round);
    }
    return status;
}

int main(int argc, char **argv)
{
    static struct bench bench;
    if (argc != 7 || atoi(argv[6]) < 1 || atoi(argv[6]) > MAX_ROUNDS) {
        fputs("usage: bench-rays SCAN.nvdb SCAN.tris LOW.obj SIZE SAMPLES ROUNDS\n", stderr);
        return 64;
    }
    bench.tris = argv[2];
    bench.rounds = (unsigned)atoi(argv[6]);
    snprintf(bench.embree.id, sizeof bench.embree.id, "Embree");
    snprintf(bench.embree.name, sizeof bench.embree.name,
             "the scan's triangles; upload: building the tree");
    if (bsq_ctx_create(NULL, &bench.ctx) < 0)
        return 71;
    int status = rays_open(bench.ctx, argv[1], argv[3], (uint32_t)atoi(argv[4]),
                           (uint32_t)atoi(argv[5]), &bench.scene);
    if (status == 0)
        status = bake_list_devices(bench.ctx, on_device, &bench);
    if (status == 0)
        status = run(&bench);
    if (status < 0)
        fprintf(stderr, "bench-rays: %s\n", bsq_error(bench.ctx));
    else
        print(&bench);
    rays_close(&bench.scene);
    bsq_ctx_destroy(bench.ctx);
    return -status;
}

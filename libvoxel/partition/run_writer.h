/* run_writer.h - writes runs of delta-coded triangles, see record_runs.h. */
#ifndef VOX_PARTITION_RUN_WRITER_H
#define VOX_PARTITION_RUN_WRITER_H

#include "libvoxel/partition/corner_delta_code.h"
#include "libvoxel/partition/record_runs.h"

struct run_writer {
    uint8_t *header; /* of the current run, NULL between runs */
    uint8_t *to;
    struct run_header run;
    uint8_t *fan_bits; /* RUN_TRIANGLES bits, only used if runs have fans */
    struct corner_code codes[FMT_MESH_KIND_COUNT];
};

/* Completes the current run's header, if there is a run. */
static inline void run_writer_end(struct run_writer *w)
{
    if (!w->header)
        return;
    if (w->run.form & RUN_FANS) {
        memcpy(w->to, w->fan_bits, (w->run.triangles + 7u) / 8);
        w->to += (w->run.triangles + 7u) / 8;
    }
    w->run.bytes = (uint32_t)(w->to - w->header - (ptrdiff_t)sizeof w->run);
    memcpy(w->header, &w->run, sizeof w->run);
    w->header = NULL;
    w->run.triangles = 0;
}

/* Ends the current run, if any, and begins another. */
static inline void run_writer_begin(struct run_writer *w, unsigned form, uint32_t material)
{
    run_writer_end(w);
    if (form & RUN_FANS)
        memset(w->fan_bits, 0, RUN_TRIANGLES / 8);
    *w = (struct run_writer){.header = w->to,
                             .fan_bits = w->fan_bits,
                             .to = w->to + sizeof w->run,
                             .run = {.form = (uint16_t)form, .material = material}};
}

#endif

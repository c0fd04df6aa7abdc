/* fake_streams.c - the fake driver's copies, events and streams, which do their work only when a
 * call waits for it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "base/context.h"
#include "tests/fake/fake_cuda_internal.h"

struct CUstream_st {
    pthread_mutex_t lock; /* protects the work and its execution */
    unsigned number;      /* in the order of creation, from 1 */
    bool unsubmitted;     /* its last launch was not asked about */
    struct work *first, *last;
    CUstream next;
};

struct CUevent_st {
    CUstream stream; /* that it was recorded on */
    int pending;
    bool blocking; /* waiting threads sleep */
    double at;
};

static CUstream streams; /* protected by the lock */
static struct CUstream_st default_stream = {.lock = PTHREAD_MUTEX_INITIALIZER};
static unsigned streams_made;

static void note_call(const char *kind, CUstream stream)
{
    const char *path = getenv("FAKE_CUDA_LOG");
    FILE *file = path ? fopen(path, "a") : NULL;

    if (!file)
        return;
    fprintf(file, "%s %u\n", kind, stream->number); /* in one piece, when it is closed */
    fclose(file);
}

/* Notes that a stream starts or ends work that uses memory. Requires the lock. Returns false if
 * another stream has pending work on the same memory and either writes: their order is undefined.
 */
static bool note_uses(const struct work *work, CUstream stream, int change)
{
    bool alone = true;

    for (unsigned i = 0; i < work->use_count; i++) {
        struct allocation *a = fake_find_allocation(work->used[i]);
        const bool writes = i + work->written >= work->use_count;
        if (!a) /* an empty array */
            continue;
        a->uses[stream->number] += (unsigned)change;
        a->writes[stream->number] += writes ? (unsigned)change : 0;
        for (unsigned s = 0; s < MAX_STREAMS; s++)
            if (s != stream->number && (writes ? a->uses[s] : a->writes[s]))
                alone = false;
    }
    return alone;
}

CUresult fake_append(CUstream stream, const struct work *work)
{
    struct work *copy;
    bool alone;

    if (work->kind == LAUNCH && stream->unsubmitted) {
        fputs("fake CUDA: two launches would be submitted at once\n", stderr);
        return INVALID_VALUE;
    }
    stream->unsubmitted |= work->kind == LAUNCH;
    if (work->kind == LAUNCH)
        note_call("launch", stream);
    pthread_mutex_lock(&fake.lock);
    alone = note_uses(work, stream, 1);
    pthread_mutex_unlock(&fake.lock);
    copy = malloc(sizeof *copy);
    *copy = *work;
    copy->next = NULL;
    pthread_mutex_lock(&stream->lock);
    if (stream->last)
        stream->last->next = copy;
    else
        stream->first = copy;
    stream->last = copy;
    pthread_mutex_unlock(&stream->lock);
    if (!alone)
        fputs("fake CUDA: two streams use the same memory at the same time\n", stderr);
    return alone ? CUDA_SUCCESS : INVALID_VALUE;
}

static void run_work(struct work *work)
{
    if (work->kind == COPY) {
        memcpy(work->to, work->from, work->bytes);
    } else if (work->kind == LAUNCH) {
        fake_run_kernel(work);
    } else {
        pthread_mutex_lock(&fake.lock);
        work->event->at = fake.sample_seconds > 0 ? fake.virtual_now : bsq_seconds_now();
        pthread_mutex_unlock(&fake.lock);
        work->event->pending = 0;
    }
}

/* Does a stream's work, up to an event if it is not NULL. */
static void run_stream(CUstream stream, CUevent until)
{
    pthread_mutex_lock(&stream->lock);
    stream->unsubmitted = false;
    while (stream->first && !(until && !until->pending)) {
        struct work *work = stream->first;
        stream->first = work->next;
        if (!stream->first)
            stream->last = NULL;
        run_work(work);
        pthread_mutex_lock(&fake.lock);
        note_uses(work, stream, -1);
        pthread_mutex_unlock(&fake.lock);
        free(work);
    }
    pthread_mutex_unlock(&stream->lock);
}

void fake_run_streams(void)
{
    for (CUstream stream = streams; stream; stream = stream->next)
        run_stream(stream, NULL);
}

CUresult cuStreamCreate(CUstream *stream, unsigned flags)
{
    BEGIN_IN_CONTEXT;
    *stream = calloc(1, sizeof **stream);
    pthread_mutex_init(&(*stream)->lock, NULL);
    pthread_mutex_lock(&fake.lock);
    (*stream)->next = streams;
    streams = *stream;
    (*stream)->number = ++streams_made % MAX_STREAMS;
    fake.live++;
    pthread_mutex_unlock(&fake.lock);
    return flags <= CU_STREAM_NON_BLOCKING ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuStreamQuery(CUstream stream)
{
    bool pending;

    BEGIN_IN_CONTEXT;
    stream->unsubmitted = false;
    pthread_mutex_lock(&stream->lock);
    pending = stream->first;
    pthread_mutex_unlock(&stream->lock);
    return pending ? NOT_READY : CUDA_SUCCESS;
}

CUresult cuStreamDestroy_v2(CUstream stream)
{
    NEED_CONTEXT;
    run_stream(stream, NULL);
    pthread_mutex_lock(&fake.lock);
    for (CUstream *link = &streams; *link; link = &(*link)->next)
        if (*link == stream) {
            *link = stream->next;
            break;
        }
    fake.live--;
    pthread_mutex_unlock(&fake.lock);
    pthread_mutex_destroy(&stream->lock);
    free(stream);
    return CUDA_SUCCESS;
}

CUresult cuMemcpyHtoDAsync_v2(CUdeviceptr to, const void *from, size_t bytes, CUstream stream)
{
    struct work work = {.kind = COPY,
                        .to = fake_device_memory(to, bytes),
                        .from = from,
                        .bytes = bytes,
                        .used = {to},
                        .use_count = 1,
                        .written = 1};

    BEGIN_IN_CONTEXT;
    if (!work.to || !fake_is_locked(from, bytes))
        return INVALID_VALUE;
    note_call("send", stream);
    return fake_append(stream, &work);
}

CUresult cuMemcpyDtoHAsync_v2(void *to, CUdeviceptr from, size_t bytes, CUstream stream)
{
    struct work work = {.kind = COPY,
                        .to = to,
                        .from = fake_device_memory(from, bytes),
                        .bytes = bytes,
                        .used = {from},
                        .use_count = 1};

    BEGIN_IN_CONTEXT;
    if (!work.from || !fake_is_locked(to, bytes))
        return INVALID_VALUE;
    note_call("fetch", stream);
    return fake_append(stream, &work);
}

CUresult cuEventCreate(CUevent *event, unsigned flags)
{
    BEGIN_IN_CONTEXT;
    *event = calloc(1, sizeof **event);
    (*event)->blocking = flags & CU_EVENT_BLOCKING_SYNC;
    fake_count_live(1);
    return flags <= CU_EVENT_BLOCKING_SYNC ? CUDA_SUCCESS : INVALID_VALUE;
}

CUresult cuEventDestroy_v2(CUevent event)
{
    NEED_CONTEXT;
    free(event);
    fake_count_live(-1);
    return CUDA_SUCCESS;
}

CUresult cuEventRecord(CUevent event, CUstream stream)
{
    struct work work = {.kind = RECORD, .event = event};

    BEGIN_IN_CONTEXT;
    event->stream = stream ? stream : &default_stream;
    event->pending = 1;
    return fake_append(event->stream, &work);
}

CUresult cuEventSynchronize(CUevent event)
{
    const bool busy = event->pending && !event->blocking;
    if (event->stream)
        note_call("wait", event->stream);
    if (event->pending)
        run_stream(event->stream, event);
    BEGIN_IN_CONTEXT;
    if (busy)
        fputs("fake CUDA: a thread waits busily\n", stderr);
    return busy ? INVALID_VALUE : CUDA_SUCCESS;
}

CUresult cuEventElapsedTime(float *milliseconds, CUevent from, CUevent to)
{
    BEGIN_IN_CONTEXT;
    if (!from->stream || !to->stream)
        return INVALID_HANDLE;
    if (from->pending || to->pending)
        return NOT_READY;
    *milliseconds = (float)(1e3 * (to->at - from->at));
    return CUDA_SUCCESS;
}

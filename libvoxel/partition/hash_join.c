/* hash_join.c - see hash_join.h.
 *
 * By buckets, columns that do not fit in memory are met in sequential passes, so that faces in any
 * order cost bounded memory and no random access to files:
 *   1. the indices of all corners are distributed to buckets by range of the column,
 *   2. each range is loaded once, and its bucket's indices are replaced by values, in order,
 *   3. the corners are walked again; each takes the next value from the bucket of its index.
 * The third pass is vox_join_fetch(). As buckets keep the order of corners no key has to be stored
 * with the values. */
#include "libvoxel/partition/hash_join.h"
#include "libvoxel/read/stream_pager.h"

/* Values of one bucket, in the order of the corners. */
struct stream {
    uint64_t offset, end; /* in the file, of what is not buffered yet */
    uint8_t *buffer;
    uint32_t at, fill; /* bytes */
};

struct joined {
    bool active; /* the column is in a file */
    struct pager pager;
    uint32_t element_bytes, shift;
    uint64_t bucket_count;
    struct stream *streams;
    uint8_t *buffers;
    uint32_t buffer_bytes;
    struct bsq_file file;
};

struct join {
    struct scan *scan;
    const char *beside;
    enum join_method method;
    bool gave_up;
    struct joined columns[SCAN_COLUMN_COUNT];
    uint64_t used_vertices;
};

#define ID_BATCH 16384u

/* Most corners are corners of the triangle before as well, whose values are at hand. */
#define NOT_REPEATED UINT32_MAX

static inline uint32_t repeated_corner(const struct face_group *group, const uint64_t *indices,
                                       uint32_t corner)
{
    const uint32_t triangle = corner - corner % 3;
    if (group->sizes || triangle == 0)
        return NOT_REPEATED;
    for (uint32_t before = triangle - 3; before < triangle; before++)
        if (indices[before] == indices[corner])
            return before;
    return NOT_REPEATED;
}

/* ---- first pass ---- */

static int distribute_group(struct cells *buckets, const struct face_group *group,
                            const uint64_t *indices, uint32_t shift)
{
    const uint64_t mask = ((uint64_t)1 << shift) - 1;
    int status = 0;
    for (uint32_t c = 0; status == 0 && c < group->corner_count; c++) {
        if (indices[c] == FMT_MESH_NONE || repeated_corner(group, indices, c) != NOT_REPEATED)
            continue;
        uint32_t local = (uint32_t)(indices[c] & mask);
        status = vox_buckets_add(buckets, (uint32_t)(indices[c] >> shift), &local, sizeof local, 1);
    }
    return status;
}

static int distribute(struct join *join, enum face_kind kind, uint32_t shift, struct cells *buckets)
{
    const struct face_store *faces = &join->scan->faces;
    void *room;
    int status = bsq_alloc(join->scan->ctx, "faces", vox_face_store_decode_bytes(faces), 1, &room);
    for (uint64_t g = 0; status == 0 && g < faces->group_count; g++) {
        struct face_group group;
        status = bsq_check(join->scan->ctx);
        if (status == 0)
            status = vox_face_store_decode(faces, g, room, &group);
        if (status == 0 && group.indices[kind])
            status = distribute_group(buckets, &group, group.indices[kind], shift);
    }
    bsq_free(join->scan->ctx, room);
    return status;
}

/* ---- second pass ---- */

struct gather {
    struct join *join;
    const struct cells *buckets;
    struct joined *joined;
    const struct column *column;
    uint8_t *range, *values;
    uint32_t *ids;
    uint64_t *used; /* bits of the range, or NULL */
};

static int load_range(struct gather *gather, uint64_t bucket)
{
    const struct joined *joined = gather->joined;
    uint64_t first = bucket << joined->shift;
    uint64_t count = column_count(gather->column) - first;
    if (count > (uint64_t)1 << joined->shift)
        count = (uint64_t)1 << joined->shift;
    if (gather->used)
        memset(gather->used, 0, ((uint64_t)1 << joined->shift) / 8 + 8);
    return vox_spill_read(&gather->column->spool, first * joined->element_bytes,
                          count * joined->element_bytes, gather->range);
}

static void look_up(struct gather *gather, uint32_t count)
{
    const uint32_t bytes = gather->joined->element_bytes;
    for (uint32_t i = 0; i < count; i++)
        memcpy(gather->values + (uint64_t)i * bytes,
               gather->range + (uint64_t)gather->ids[i] * bytes, bytes);
    for (uint32_t i = 0; gather->used && i < count; i++)
        gather->used[gather->ids[i] / 64] |= (uint64_t)1 << gather->ids[i] % 64;
}

static int gather_bucket(struct gather *gather, uint32_t bucket)
{
    struct joined *joined = gather->joined;
    struct stream *stream = &joined->streams[bucket];
    const uint64_t total = gather->buckets->list[bucket].items;
    struct cell_cursor cursor = {0};
    int status = load_range(gather, bucket);
    stream->offset = joined->file.size;
    for (uint64_t done = 0; status == 0 && done < total;) {
        uint32_t count = total - done < ID_BATCH ? (uint32_t)(total - done) : ID_BATCH;
        if ((status = bsq_check(gather->join->scan->ctx)) < 0 ||
            (status = vox_buckets_read(gather->buckets, bucket, 4 * done, 4 * (uint64_t)count,
                                       gather->ids, &cursor)) < 0)
            break;
        look_up(gather, count);
        status = bsq_file_append(gather->join->scan->ctx, &joined->file, gather->values,
                                 (uint64_t)count * joined->element_bytes);
        done += count;
    }
    stream->end = joined->file.size;
    for (uint64_t i = 0; gather->used && i < ((uint64_t)1 << joined->shift) / 64 + 1; i++)
        gather->join->used_vertices += (uint64_t)__builtin_popcountll(gather->used[i]);
    return status;
}

static int gather_column(struct join *join, enum scan_column number, const struct cells *buckets)
{
    struct bsq_ctx *ctx = join->scan->ctx;
    struct joined *joined = &join->columns[number];
    struct gather gather = {
        .join = join, .buckets = buckets, .joined = joined, .column = &join->scan->columns[number]};
    uint64_t range = (uint64_t)1 << joined->shift;
    int status;
    if ((status = bsq_calloc(ctx, "join", joined->bucket_count, sizeof *joined->streams,
                             &joined->streams)) < 0 ||
        (status = bsq_file_temp(ctx, join->beside, "joined corners", &joined->file)) < 0 ||
        (status = bsq_alloc(ctx, "join", range, joined->element_bytes, &gather.range)) < 0 ||
        (status = bsq_alloc(ctx, "join", ID_BATCH, joined->element_bytes, &gather.values)) < 0 ||
        (status = bsq_alloc(ctx, "join", ID_BATCH, 4, &gather.ids)) < 0)
        goto done;
    if (number == SCAN_POSITIONS &&
        (status = bsq_alloc(ctx, "join", range / 8 + 8, 1, &gather.used)) < 0)
        goto done;
    for (uint32_t b = 0; status == 0 && b < joined->bucket_count; b++)
        status = gather_bucket(&gather, b);
done:
    bsq_free(ctx, gather.used);
    bsq_free(ctx, gather.ids);
    bsq_free(ctx, gather.values);
    bsq_free(ctx, gather.range);
    return status;
}

/* Both passes for the columns of a kind that are in files. */
static int join_kind(struct join *join, enum face_kind kind)
{
    const uint64_t budget = join->scan->limits->join_bytes;
    uint64_t count = 0;
    uint64_t each = 0; /* bytes of a corner's values */
    uint32_t widest = 0, shift = 0;
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++)
        if (scan_kind_of(i) == kind && join->columns[i].active) {
            count = scan_count(join->scan, i);
            each += join->columns[i].element_bytes;
            widest =
                join->columns[i].element_bytes > widest ? join->columns[i].element_bytes : widest;
        }
    if (widest == 0)
        return 0;
    while (shift < 31 && ((uint64_t)widest << (shift + 1)) <= budget / 2)
        shift++;
    uint64_t bucket_count = (count >> shift) + 1, page = budget / 2 / bucket_count;
    struct cells buckets;
    page = page < 8 ? 4 : page < 65536 ? page / 4 * 4 : 65536;
    int status = vox_buckets_init(&buckets, join->scan->ctx, join->beside, (uint32_t)bucket_count,
                                  page, budget / 2);
    if (status == 0)
        status = distribute(join, kind, shift, &buckets);
    for (int i = 0; status == 0 && i < SCAN_COLUMN_COUNT; i++)
        if (scan_kind_of(i) == kind && join->columns[i].active) {
            join->columns[i].shift = shift;
            join->columns[i].bucket_count = bucket_count;
            status = gather_column(join, i, &buckets);
        }
    vox_buckets_free(&buckets);
    return status;
}

/* ---- pages ---- */

static int open_pagers(struct join *join)
{
    uint64_t share = join->scan->limits->join_bytes / SCAN_COLUMN_COUNT;
    int status = 0;
    for (int i = 0; status == 0 && i < SCAN_COLUMN_COUNT; i++)
        if (join->columns[i].active)
            status = vox_pager_open(&join->columns[i].pager, &join->scan->columns[i],
                                    i == SCAN_POSITIONS ? 2 * share : share);
    return status;
}

/* Reading a column several times over costs as much as buckets do. */
static bool pager_is_thrashing(const struct pager *pager)
{
    return pager->bytes_read > 6 * pager->column->spool.bytes;
}

/* ---- third pass ---- */

static int allocate_buffers(struct join *join, struct joined *joined)
{
    const uint32_t element = joined->element_bytes;
    uint64_t share = join->scan->limits->join_bytes / SCAN_COLUMN_COUNT / joined->bucket_count;
    share = share > 65536 ? 65536 : share < element ? element : share;
    joined->buffer_bytes = (uint32_t)(share / element * element);
    int status = bsq_alloc(join->scan->ctx, "join", joined->bucket_count, joined->buffer_bytes,
                           &joined->buffers);
    for (uint64_t b = 0; status == 0 && b < joined->bucket_count; b++)
        joined->streams[b].buffer = joined->buffers + b * joined->buffer_bytes;
    return status;
}

static int refill(struct join *join, const struct joined *joined, struct stream *stream)
{
    uint64_t left = stream->end - stream->offset;
    stream->fill = left < joined->buffer_bytes ? (uint32_t)left : joined->buffer_bytes;
    stream->at = 0;
    if (stream->fill == 0)
        return bsq_fail(join->scan->ctx, BSQ_EBUG, "a joined column ends early");
    int status =
        bsq_file_read(join->scan->ctx, &joined->file, stream->buffer, stream->fill, stream->offset);
    stream->offset += stream->fill;
    return status;
}

/* The element that comes next in the stream of its bucket, as corners are in the order of the first
 * pass. */
static int take_joined(struct join *join, struct joined *joined, uint64_t index,
                       const uint8_t **element)
{
    struct stream *stream = &joined->streams[index >> joined->shift];
    if (stream->at == stream->fill) {
        int status = refill(join, joined, stream);
        if (status < 0)
            return status;
    }
    *element = stream->buffer + stream->at;
    stream->at += joined->element_bytes;
    return 0;
}

/* ---- corners ---- */

/* From a column in a file: by pages, or in the order of the first pass. */
static int fetch_file(struct join *join, struct joined *column, const struct face_group *group,
                      const uint64_t *indices, uint8_t *to)
{
    const uint32_t bytes = column->element_bytes;
    const bool paged = join->method == JOIN_BY_PAGES;
    for (uint32_t c = 0; c < group->corner_count; c++) {
        const uint8_t *from;
        int status = 0;
        if (indices[c] == FMT_MESH_NONE)
            continue;
        uint32_t before = repeated_corner(group, indices, c);
        if (before != NOT_REPEATED)
            from = to + (uint64_t)before * bytes;
        else
            status = paged ? pager_get(&column->pager, indices[c], &from)
                           : take_joined(join, column, indices[c], &from);
        if (status < 0)
            return status;
        memcpy(to + (uint64_t)c * bytes, from, bytes);
    }
    join->gave_up = paged && pager_is_thrashing(&column->pager);
    return join->gave_up ? BSQ_EBUG : 0;
}

static void fetch_memory(const struct column *column, const uint64_t *indices, uint32_t count,
                         uint8_t *to)
{
    const uint32_t bytes = column->element_bytes;
    for (uint32_t c = 0; c < count; c++, to += bytes)
        if (indices[c] != FMT_MESH_NONE)
            memcpy(to, column_at(column, indices[c], bytes), bytes);
}

/* What corners have that lack an index. */
static void fill_absent(enum scan_column number, uint32_t count, void *to)
{
    if (number == SCAN_TEXCOORDS)
        memset(to, 0, (size_t)count * 8);
    if (number == SCAN_NORMALS)
        for (uint32_t c = 0; c < count; c++)
            ((uint32_t *)to)[c] = SCAN_NO_NORMAL;
}

int vox_join_fetch(struct join *join, const struct face_group *group, struct corner_values *values)
{
    void *const to[SCAN_COLUMN_COUNT] = {values->positions, values->colors, values->texcoords,
                                         values->normals};
    int status = 0;
    for (int i = 0; status == 0 && i < SCAN_COLUMN_COUNT; i++) {
        const uint64_t *indices = group->indices[scan_kind_of(i)];
        if (!to[i])
            continue;
        fill_absent(i, group->corner_count, to[i]);
        if (!indices)
            continue;
        if (!join->columns[i].active)
            fetch_memory(&join->scan->columns[i], indices, group->corner_count, to[i]);
        else
            status = fetch_file(join, &join->columns[i], group, indices, to[i]);
    }
    return status;
}

/* ---- the whole ---- */

static int join_by_buckets(struct join *join)
{
    int status = 0;
    for (int kind = 0; status == 0 && kind < FACE_KIND_COUNT; kind++)
        status = join_kind(join, kind);
    for (int i = 0; status == 0 && i < SCAN_COLUMN_COUNT; i++)
        if (join->columns[i].active)
            status = allocate_buffers(join, &join->columns[i]);
    return status;
}

int vox_join_open(struct scan *scan, const char *beside, enum join_method method, struct join **out)
{
    struct join *join;
    *out = NULL;
    int status = bsq_calloc(scan->ctx, "join", 1, sizeof *join, &join);
    if (status < 0)
        return status;
    join->scan = scan;
    join->beside = beside;
    join->method = method;
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++) {
        join->columns[i].file = (struct bsq_file)BSQ_FILE_CLOSED;
        join->columns[i].element_bytes = scan->columns[i].element_bytes;
        join->columns[i].active = scan->columns[i].spool.spilled && scan_keeps(scan, i);
    }
    status = method == JOIN_BY_PAGES ? open_pagers(join) : join_by_buckets(join);
    if (status < 0) {
        vox_join_close(join);
        return status;
    }
    *out = join;
    return 0;
}

void vox_join_close(struct join *join)
{
    if (!join)
        return;
    struct bsq_ctx *ctx = join->scan->ctx;
    for (int i = 0; i < SCAN_COLUMN_COUNT; i++) {
        vox_pager_close(&join->columns[i].pager);
        bsq_free(ctx, join->columns[i].buffers);
        bsq_free(ctx, join->columns[i].streams);
        bsq_file_close(ctx, &join->columns[i].file);
    }
    bsq_free(ctx, join);
}

bool vox_join_gave_up(const struct join *join)
{
    return join->gave_up;
}

uint64_t vox_join_used_vertices(const struct join *join)
{
    return join->used_vertices;
}

/* triangulate.c - see triangulate.h.
 *
 * Neighbours in the file mostly are neighbours in space, so triangles are noted as links, one
 * behind the other in one cell. Then each cell's links are coded at one go: in a file without any
 * order a cell's triangles still share runs. */
#include "libvoxel/partition/triangulate.h"
#include "base/polygon.h"
#include "libvoxel/partition/polygon_fans.h"

/* ---- memory ---- */

/* Bytes of one triangle of this scan, coded, at most: differences of indices take four bytes where
 * there are fewer than 2^31. */
static uint32_t coded_bound(const struct split_plan *plan, uint32_t kinds)
{
    const struct scan *scan = plan->scan;
    if (plan->values)
        return run_triangle_bound(plan->values);
    uint64_t most = scan_count(scan, SCAN_POSITIONS) | scan_count(scan, SCAN_TEXCOORDS) |
                    scan_count(scan, SCAN_NORMALS);
    return kinds * (most >> 31 ? CORNER_CODE_MAX : 13);
}

uint64_t vox_triangulator_bytes(const struct split_plan *plan, uint64_t triangles,
                                uint32_t max_size)
{
    uint64_t each = sizeof(struct run_header) + sizeof(struct split_piece) +
                    2 * sizeof(struct split_link) + sizeof(uint32_t[3]) +
                    coded_bound(plan, FACE_KIND_COUNT) + 1;
    return each * triangles + 44 * (uint64_t)max_size + ((uint64_t)4 << 3 * plan->levels);
}

int vox_triangulator_init(struct splitter *s, struct bsq_ctx *ctx, const struct split_plan *plan)
{
    uint64_t cells = (uint64_t)1 << 3 * plan->levels;
    *s = (struct splitter){.ctx = ctx, .plan = plan};
    int status = bsq_alloc(ctx, "faces", cells, sizeof *s->cell_pieces, &s->cell_pieces);
    if (status == 0)
        memset(s->cell_pieces, 0xff, cells * sizeof *s->cell_pieces);
    return status;
}

void vox_triangulator_free(struct splitter *s)
{
    void *parts[] = {s->pieces,          s->bytes,       s->corners, s->links,
                     s->sorted,          s->cell_pieces, s->polygon, s->polygon_triangles,
                     s->polygon_scratch, s->fan_cells};
    for (size_t i = 0; s->ctx && i < sizeof parts / sizeof *parts; i++)
        bsq_free(s->ctx, parts[i]);
    memset(s, 0, sizeof *s);
}

static int room_for_triangles(struct splitter *s, uint64_t triangles, uint64_t links)
{
    int status =
        bsq_grow(s->ctx, "faces", triangles, sizeof *s->corners, &s->corners, &s->corners_capacity);
    if (status == 0)
        status = bsq_grow(s->ctx, "faces", links, sizeof *s->links, &s->links, &s->link_capacity);
    return status;
}

/* Polygons of many corners in many cells, which no surface has, would multiply; but twice as many
 * triangles as there are is what other groups have room for. */
static bool fans_are_too_many(const struct splitter *s, const struct face_group *group,
                              uint64_t triangles)
{
    const uint64_t usual = 2 * (group->corner_count - 2 * (uint64_t)group->face_count);
    const uint64_t each = sizeof *s->corners + coded_bound(s->plan, FACE_KIND_COUNT) + 1;
    return triangles > usual && triangles > s->plan->fan_bytes / each;
}

static int room_for_polygons(struct splitter *s, uint32_t max_size)
{
    const char *what = "faces";
    int status = 0;
    if (max_size <= 3)
        return 0;
    if (s->plan->vertex_cells)
        return bsq_grow(s->ctx, what, max_size, sizeof *s->fan_cells, &s->fan_cells,
                        &s->fan_capacity);
    if ((status = bsq_grow(s->ctx, what, max_size, sizeof *s->polygon, &s->polygon,
                           &s->polygon_capacity[0])) < 0 ||
        (status = bsq_grow(s->ctx, what, max_size, 12, &s->polygon_triangles,
                           &s->polygon_capacity[1])) < 0)
        return status;
    return bsq_grow(s->ctx, what, max_size, 8, &s->polygon_scratch, &s->polygon_capacity[2]);
}

#define NO_PIECE UINT32_MAX

/* What comes this far ahead of what is in hand is asked for: without it a file whose faces have no
 * order waits for memory at every corner. */
#define CORNERS_AHEAD 48
#define LINKS_AHEAD   16

/* ---- triangles ---- */

/* What is being split. */
struct source {
    const struct face_group *group;
    const struct corner_values *values;
    uint32_t material[2]; /* of triangles with texture coordinates, of others */
};

static inline const float *corner_position(const struct splitter *s, const struct source *source,
                                           uint32_t corner)
{
    if (source->values)
        return source->values->positions[corner];
    return column_at(&s->plan->scan->columns[SCAN_POSITIONS],
                     source->group->indices[FACE_VERTEX][corner], 12);
}

static inline bool lacks_texcoord(const struct face_group *group, uint32_t a, uint32_t b,
                                  uint32_t c)
{
    const uint64_t *t = group->indices[FACE_TEXCOORD];
    return !t || t[a] == FMT_MESH_NONE || t[b] == FMT_MESH_NONE || t[c] == FMT_MESH_NONE;
}

/* The next `count` triangles are in this cell. */
static inline void extend_links(struct splitter *s, uint32_t cell, uint32_t material,
                                uint32_t count)
{
    if (s->link_count == 0 || s->links[s->link_count - 1].cell != cell ||
        s->links[s->link_count - 1].material != material)
        s->links[s->link_count++] = (struct split_link){
            .cell = cell, .first = (uint32_t)s->triangles, .material = material};
    s->links[s->link_count - 1].count += count;
}

/* By its first corner. */
static inline uint32_t triangle_cell(const struct splitter *s, const struct source *source,
                                     uint32_t corner)
{
    if (s->plan->vertex_cells)
        return vertex_cell(s->plan->vertex_cells, source->group->indices[FACE_VERTEX][corner]);
    return morton_cell(&s->plan->cube, s->plan->levels, corner_position(s, source, corner));
}

static inline void add_triangle(struct splitter *s, const struct source *source, uint32_t a,
                                uint32_t b, uint32_t c)
{
    uint32_t number = triangle_cell(s, source, a);
    uint32_t material = source->material[lacks_texcoord(source->group, a, b, c)];
    extend_links(s, number, material, 1);
    uint32_t *corners = s->corners[s->triangles++];
    corners[0] = a;
    corners[1] = b;
    corners[2] = c;
}

/* Where it is told which cell a corner is in. */
static inline const void *cell_source(const struct splitter *s, const struct source *source,
                                      uint32_t corner)
{
    if (s->plan->vertex_cells)
        return vertex_cell_place(s->plan->vertex_cells,
                                 source->group->indices[FACE_VERTEX][corner]);
    return corner_position(s, source, corner);
}

static void add_polygon(struct splitter *s, const struct source *source, uint32_t first,
                        uint32_t size)
{
    for (uint32_t k = 0; k < size; k++) {
        const float *p = corner_position(s, source, first + k);
        for (int axis = 0; axis < 3; axis++)
            s->polygon[k][axis] = p[axis];
    }
    const uint32_t *t = s->polygon_triangles;
    bsq_triangulate((const double(*)[3])s->polygon, size, s->polygon_triangles, s->polygon_scratch);
    for (uint32_t i = 0; i < size - 2; i++, t += 3)
        add_triangle(s, source, first + t[0], first + t[1], first + t[2]);
}

static void set_material(struct source *source, uint32_t usemtl)
{
    source->material[0] = run_material(usemtl, false);
    source->material[1] = run_material(usemtl, true);
}

/* Different cells of a polygon's corners; returns how many. */
static uint32_t list_cells(struct splitter *s, const struct source *source, uint32_t first,
                           uint32_t size)
{
    uint32_t count = 0;
    for (uint32_t k = 0; k < size; k++) {
        uint32_t cell = triangle_cell(s, source, first + k), before = 0;
        while (before < count && s->fan_cells[before] != cell)
            before++;
        s->fan_cells[before] = cell;
        count += before == count;
    }
    return count;
}

/* Goes to all cells that one of its triangles may belong to, of whatever shape these will be. */
static int add_fan(struct splitter *s, const struct source *source, uint32_t first, uint32_t size)
{
    const uint32_t cells = list_cells(s, source, first, size);
    const uint32_t material =
        source->material[lacks_texcoord(source->group, first, first + 1, first + 2)];
    const uint64_t triangles = s->triangles + (uint64_t)cells * (size - 2);
    if (fans_are_too_many(s, source->group, triangles)) {
        s->gave_up = true;
        return BSQ_EBUG;
    }
    int status = room_for_triangles(s, triangles, (uint64_t)s->link_count + cells);
    for (uint32_t i = 0; status == 0 && i < cells; i++) {
        extend_links(s, s->fan_cells[i], material, size - 2);
        for (uint32_t k = 2; k < size; k++) {
            uint32_t *corners = s->corners[s->triangles++];
            corners[0] = first | (k > 2 ? SPLIT_CONTINUES : 0);
            corners[1] = first + k - 1;
            corners[2] = first + k;
        }
    }
    return status;
}

static int add_face(struct splitter *s, const struct source *source, uint32_t first, uint32_t size)
{
    const bool fans = s->plan->vertex_cells && source->group->sizes;
    if (fans && size > 3)
        return add_fan(s, source, first, size);
    int status = fans ? room_for_triangles(s, s->triangles + 1, (uint64_t)s->link_count + 1)
                      : 0; /* which fans may have taken */
    if (status == 0 && size == 3)
        add_triangle(s, source, first, first + 1, first + 2);
    else if (status == 0)
        add_polygon(s, source, first, size);
    return status;
}

static int add_faces(struct splitter *s, struct source *source)
{
    const struct face_group *group = source->group;
    uint32_t corner = 0, change = 0;
    s->triangles = 0;
    s->link_count = 0;
    set_material(source, group->first_material);
    for (uint32_t f = 0; f < group->face_count; f++) {
        uint32_t size = group->sizes ? group->sizes[f] : 3;
        while (change < group->change_count && group->changes[change].face <= f)
            set_material(source, group->changes[change++].material);
        for (uint32_t k = corner + CORNERS_AHEAD;
             !source->values && k < corner + CORNERS_AHEAD + size && k < group->corner_count;
             k += group->sizes ? 1 : 3)
            __builtin_prefetch(cell_source(s, source, k));
        int status = add_face(s, source, corner, size);
        if (status < 0)
            return status;
        corner += size;
    }
    return 0;
}

static void mark_used(used_word *used, const struct face_group *group)
{
    const uint64_t *vertex = group->indices[FACE_VERTEX];
    for (uint32_t c = 0; c < group->corner_count; c++) {
        if (c + CORNERS_AHEAD < group->corner_count)
            __builtin_prefetch(&used[vertex[c + CORNERS_AHEAD] / 64], 1);
        used_mark(used, vertex[c]);
    }
}

/* ---- coding ---- */

/* A run being written. */
struct writer {
    uint8_t *header; /* of the run, NULL between runs */
    uint8_t *to;
    struct run_header run;
    uint8_t *fan_bits;      /* room for those of a run, zeroed when one begins */
    const uint32_t *before; /* corners of the triangle before */
    struct corner_code codes[FACE_KIND_COUNT];
};

static void end_run(struct writer *w)
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

static void begin_run(struct writer *w, unsigned form, uint32_t material)
{
    end_run(w);
    if (form & RUN_FANS)
        memset(w->fan_bits, 0, RUN_TRIANGLES / 8);
    *w = (struct writer){.header = w->to,
                         .fan_bits = w->fan_bits,
                         .to = w->to + sizeof w->run,
                         .run = {.form = (uint16_t)form, .material = material}};
}

static void put_value(const struct record_layout *layout, const struct corner_values *values,
                      uint32_t corner, uint8_t *to)
{
    memcpy(to, values->positions[corner], 12);
    if (values->colors)
        memcpy(to + layout->value_at[SCAN_COLORS], &values->colors[corner], 4);
    if (values->texcoords)
        memcpy(to + layout->value_at[SCAN_TEXCOORDS], values->texcoords[corner], 8);
    if (values->normals)
        memcpy(to + layout->value_at[SCAN_NORMALS], &values->normals[corner], 4);
}

/* Corner of the triangle before that has the same indices. */
static unsigned match_corner(const struct face_group *group, const uint32_t *before,
                             uint32_t corner)
{
    for (unsigned k = 0; before && k < 3; k++) {
        bool same = true;
        for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
            same &= !group->indices[kind] ||
                    group->indices[kind][before[k]] == group->indices[kind][corner];
        if (same)
            return k;
    }
    return CORNER_NEW;
}

static void put_values(struct splitter *s, const struct source *source, struct writer *w,
                       const uint32_t *before, const uint32_t corners[3])
{
    const struct record_layout *layout = s->plan->values;
    uint8_t *control = w->to++;
    *control = 0;
    for (uint32_t k = 0; k < 3; k++) {
        unsigned match = match_corner(source->group, before, corners[k]);
        *control |= (uint8_t)(match << 2 * k);
        if (match == CORNER_NEW) {
            put_value(layout, source->values, corners[k], w->to);
            w->to += layout->corner_bytes;
        }
    }
}

static void put_indices(const struct face_group *group, struct writer *w, const uint32_t corners[3])
{
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++) {
        const uint64_t *from = group->indices[kind];
        if (!from)
            continue;
        const uint64_t index[3] = {from[corners[0] & ~SPLIT_CONTINUES], from[corners[1]],
                                   from[corners[2]]};
        w->to = corner_code_put(&w->codes[kind], index, w->to);
    }
}

static unsigned form_of(const struct source *source, bool fans)
{
    unsigned form = 0;
    if (source->values)
        return RUN_VALUES;
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
        form |= (unsigned)(source->group->indices[kind] != NULL) << kind;
    if (source->group->sizes && fans)
        form |= RUN_FANS;
    return form;
}

/* Triangles from t on that must be in one run, as they are a fan. */
static uint32_t count_together(const struct splitter *s, uint32_t t, uint32_t end)
{
    uint32_t next = t + 1;
    while (next < end && s->corners[next][0] & SPLIT_CONTINUES)
        next++;
    return next - t;
}

/* Writes a link's triangles, in the run before where that has room. */
static void put_link(struct splitter *s, const struct source *source, unsigned form,
                     const struct split_link *link, struct writer *w)
{
    const uint32_t end = link->first + link->count;
    for (uint32_t t = link->first; t < end; t++) {
        const bool continues = s->corners[t][0] & SPLIT_CONTINUES;
        if (w->run.triangles == 0 || w->run.material != link->material ||
            (!continues && w->run.triangles + count_together(s, t, end) > RUN_TRIANGLES))
            begin_run(w, form, link->material);
        if (continues)
            w->fan_bits[w->run.triangles / 8] |= (uint8_t)(1u << w->run.triangles % 8);
        if (source->values)
            put_values(s, source, w, w->run.triangles > 0 ? w->before : NULL, s->corners[t]);
        else
            put_indices(source->group, w, s->corners[t]);
        w->before = s->corners[t];
        w->run.triangles++;
    }
}

/* Sorts links by cell, in the file's order within each, and makes a piece of each cell's. */
static void sort_links(struct splitter *s)
{
    uint32_t end = 0;
    s->piece_count = 0;
    for (uint32_t i = 0; i < s->link_count; i++) {
        uint32_t *number = &s->cell_pieces[s->links[i].cell];
        if (*number == NO_PIECE) {
            *number = s->piece_count++;
            s->pieces[*number] = (struct split_piece){.cell = s->links[i].cell};
        }
        s->pieces[*number].links++;
    }
    for (uint32_t i = 0; i < s->piece_count; i++)
        s->pieces[i].first_link = end += s->pieces[i].links;
    for (uint32_t i = s->link_count; i-- > 0;)
        s->sorted[--s->pieces[s->cell_pieces[s->links[i].cell]].first_link] = s->links[i];
    for (uint32_t i = 0; i < s->piece_count; i++)
        s->cell_pieces[s->pieces[i].cell] = NO_PIECE;
}

/* Asks for the indices of links to come. Inlined always, as GCC leaves out calls of functions that
 * do nothing but ask. */
static inline __attribute__((always_inline)) void ask_for_links(const struct splitter *s,
                                                                const struct face_group *group,
                                                                unsigned form, uint32_t turn)
{
    if (turn + 2 * LINKS_AHEAD >= s->link_count)
        return;
    __builtin_prefetch(s->corners[s->sorted[turn + 2 * LINKS_AHEAD].first]);
    const uint32_t corner = s->corners[s->sorted[turn + LINKS_AHEAD].first][0];
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
        if (form >> kind & 1)
            __builtin_prefetch(&group->indices[kind][corner]);
}

/* Writes all links of a cell as runs. */
static void put_piece(struct splitter *s, const struct source *source, struct split_piece *piece,
                      struct writer *w)
{
    const unsigned form = form_of(source, s->plan->vertex_cells != NULL);
    piece->offset = (uint64_t)(w->to - s->bytes);
    for (uint32_t i = piece->first_link; i < piece->first_link + piece->links; i++) {
        ask_for_links(s, source->group, form, i);
        put_link(s, source, form, &s->sorted[i], w);
        piece->triangles += s->sorted[i].count;
    }
    end_run(w);
    piece->bytes = (uint64_t)(w->to - s->bytes) - piece->offset;
}

static int code_links(struct splitter *s, const struct source *source)
{
    const char *what = "faces";
    uint64_t kinds = 0, cells = (uint64_t)1 << 3 * s->plan->levels;
    for (int kind = 0; kind < FACE_KIND_COUNT; kind++)
        kinds += source->group->indices[kind] != NULL;
    uint64_t runs =
        s->link_count + 2 * s->triangles / RUN_TRIANGLES; /* a fan may not fit in what is left */
    uint64_t bound =
        s->triangles * (coded_bound(s->plan, (uint32_t)kinds) + 1) + /* and a bit in a fan */
        runs * sizeof(struct run_header) + CORNER_CODE_SLACK;
    uint64_t pieces = cells < s->link_count ? cells : s->link_count;
    int status;
    if ((status = bsq_grow(s->ctx, what, bound, 1, &s->bytes, &s->bytes_capacity)) < 0 ||
        (status = bsq_grow(s->ctx, what, s->link_count, sizeof *s->sorted, &s->sorted,
                           &s->sorted_capacity)) < 0 ||
        (status =
             bsq_grow(s->ctx, what, pieces, sizeof *s->pieces, &s->pieces, &s->piece_capacity)) < 0)
        return status;
    sort_links(s);
    uint8_t fan_bits[RUN_TRIANGLES / 8];
    struct writer w = {.to = s->bytes, .fan_bits = fan_bits};
    for (uint32_t i = 0; i < s->piece_count; i++)
        put_piece(s, source, &s->pieces[i], &w);
    return 0;
}

/* ---- plain groups ----
 *
 * Triangles with positions alone and of one material, the groups of most scans. They are coded as
 * they are keyed, a piece for each link, as long as that makes few pieces. */

static bool is_plain(const struct face_group *group, const struct corner_values *values)
{
    return !values && !group->sizes && group->change_count == 0 && !group->indices[FACE_TEXCOORD] &&
           !group->indices[FACE_NORMAL];
}

static uint32_t plain_pieces(uint32_t triangles)
{
    return 64 + triangles / 16;
}

static int room_for_plain(struct splitter *s, uint32_t triangles)
{
    uint64_t pieces = plain_pieces(triangles), runs = pieces + triangles / RUN_TRIANGLES + 1;
    uint64_t bound = triangles * (uint64_t)coded_bound(s->plan, 1) +
                     runs * sizeof(struct run_header) + CORNER_CODE_SLACK;
    int status = bsq_grow(s->ctx, "faces", bound, 1, &s->bytes, &s->bytes_capacity);
    if (status == 0)
        status =
            bsq_grow(s->ctx, "faces", pieces, sizeof *s->pieces, &s->pieces, &s->piece_capacity);
    return status;
}

static void end_piece(struct splitter *s, struct writer *w)
{
    end_run(w);
    if (s->piece_count == 0)
        return;
    struct split_piece *piece = &s->pieces[s->piece_count - 1];
    piece->bytes = (uint64_t)(w->to - s->bytes) - piece->offset;
    s->triangles += piece->triangles;
}

/* Where one group has no order, so have the next ones: a trial takes as long as a sixteenth of
 * them. */
#define GROUPS_WITHOUT_ORDER 16

/* False where there would be too many pieces; what is in the splitter then means nothing. */
static bool split_plain(struct splitter *s, const struct face_group *group)
{
    /* Copies, which what is written cannot change as far as the compiler knows. */
    const struct column positions = s->plan->scan->columns[SCAN_POSITIONS];
    const struct morton_cube cube = s->plan->cube;
    const uint32_t levels = s->plan->levels;
    const bool known = s->plan->vertex_cells != NULL;
    const struct vertex_cells vertex_cells =
        known ? *s->plan->vertex_cells : (struct vertex_cells){0};
    const uint32_t material = run_material(group->first_material, true);
    const uint64_t *v = group->indices[FACE_VERTEX];
    const uint32_t most = plain_pieces(group->face_count);
    struct writer w = {.to = s->bytes};
    uint32_t cell = UINT32_MAX;
    s->triangles = 0;
    s->piece_count = 0;
    for (uint32_t t = 0; t < group->face_count; t++, v += 3) {
        uint32_t number = known ? vertex_cell(&vertex_cells, v[0])
                                : morton_cell(&cube, levels, column_at(&positions, v[0], 12));
        bool first = number != cell || w.run.triangles == RUN_TRIANGLES;
        if (number != cell) {
            end_piece(s, &w);
            if (s->piece_count == most)
                return false;
            s->pieces[s->piece_count++] =
                (struct split_piece){.cell = number, .offset = (uint64_t)(w.to - s->bytes)};
            cell = number;
        }
        if (first)
            begin_run(&w, 1u << FACE_VERTEX, material);
        w.to = corner_code_put(&w.codes[FACE_VERTEX], v, w.to);
        w.run.triangles++;
        s->pieces[s->piece_count - 1].triangles++;
    }
    end_piece(s, &w);
    return true;
}

bool vox_triangulate_makes_fans(uint32_t max_size, bool lacks_texcoord)
{
    return max_size <= 3 || (max_size <= FAN_CORNERS && !lacks_texcoord);
}

int vox_triangulate_group(struct splitter *s, const struct face_group *group,
                          const struct corner_values *values, uint32_t max_size)
{
    struct source source = {.group = group, .values = values};
    uint64_t triangles = group->corner_count - 2 * (uint64_t)group->face_count;
    int status = 0;
    if (is_plain(group, values) && s->groups_without_order == 0) {
        status = room_for_plain(s, group->face_count);
        if (status < 0 || split_plain(s, group))
            return status;
        s->groups_without_order = GROUPS_WITHOUT_ORDER;
    } else if (s->groups_without_order > 0) {
        s->groups_without_order--;
    }
    status = room_for_triangles(s, triangles, triangles);
    if (status == 0)
        status = room_for_polygons(s, max_size);
    if (status < 0)
        return status;
    if (s->plan->used)
        mark_used(s->plan->used, group);
    status = add_faces(s, &source);
    return status < 0 ? status : code_links(s, &source);
}

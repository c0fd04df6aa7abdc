/* read_tris.c - a second reader of chunk files, written from formats/FORMATS.md alone.
 *
 *   naive-read-tris FILE              checks everything; prints the header and sums over triangles
 *   naive-read-tris --triangles FILE  prints the triangles, one a line: corners with all
 *                                     attributes, normals last; the least corner comes first
 */
#include "bytes.h"

enum { NORMALS = 1, TEXCOORDS = 2, COLORS = 4, MATERIALS = 8, KNOWN = 15 };
enum { HEADER_BYTES = 152, ENTRY_BYTES = 56, CHUNK_HEADER_BYTES = 16 };
#define NONE 4294967295u

struct header {
    uint32_t version, attributes, material_count;
    uint64_t triangles, chunks, faces, skipped, materials_at, table_at;
    double origin[3];
    float low[3], high[3];
};

/* A chunk, and the offsets of its arrays. */
struct chunk {
    uint64_t at, size, first;
    uint32_t triangles, vertices;
    float low[3], high[3];
    uint64_t positions, normals, texcoords, colors, materials, indices;
    unsigned index_bytes;
};

struct sums {
    uint64_t triangles, vertices, hash;
    double area, volume;
};

struct corner {
    float position[3], texcoord[2];
    uint32_t normal, color;
};

/* ---- header and table ---- */

static void read_box(const struct bytes *file, uint64_t at, float low[3], float high[3])
{
    for (uint64_t k = 0; k < 3; k++) {
        low[k] = f32(file, at + 4 * k);
        high[k] = f32(file, at + 12 + 4 * k);
        require(file, isfinite(low[k]) && isfinite(high[k]) && low[k] <= high[k], "wrong bounds");
    }
}

static struct header read_header(const struct bytes *file)
{
    struct header h;
    require_text(file, 0, "BSQTRIS\n", "not a chunk file");
    h.version = u32(file, 8);
    if (h.version < 1 || h.version > 3)
        refuse(file, "chunk file of version %u, this reader knows 1 to 3", h.version);
    require(file, u64(file, 144) == checksum(file, 0, 144), "wrong checksum of the header");
    h.attributes = u32(file, 12);
    h.triangles = u64(file, 16);
    h.chunks = u64(file, 24);
    h.faces = u64(file, 32);
    h.skipped = u64(file, 40);
    for (uint64_t k = 0; k < 3; k++) {
        h.origin[k] = f64(file, 48 + 8 * k);
        require(file, isfinite(h.origin[k]), "wrong origin");
    }
    read_box(file, 72, h.low, h.high);
    h.materials_at = u64(file, 96);
    h.table_at = u64(file, 104);
    h.material_count = u32(file, 120);
    require(file, u64(file, 112) == file->size, "another length than the header says");
    require(file, (h.attributes & ~(uint32_t)KNOWN) == 0, "unknown attributes");
    require(file, u32(file, 124) == 0, "reserved is not 0");
    require(file,
            h.materials_at >= HEADER_BYTES && h.materials_at <= h.table_at &&
                h.table_at <= file->size && h.materials_at % 8 == 0 && h.table_at % 8 == 0,
            "wrong offsets");
    require(file,
            (file->size - h.table_at) % ENTRY_BYTES == 0 &&
                (file->size - h.table_at) / ENTRY_BYTES == h.chunks,
            "wrong length of the table");
    require(file, u64(file, 128) == checksum(file, h.materials_at, h.table_at - h.materials_at),
            "wrong checksum of the materials");
    require(file, u64(file, 136) == checksum(file, h.table_at, file->size - h.table_at),
            "wrong checksum of the table");
    return h;
}

static uint64_t align8(uint64_t at)
{
    return (at + 7) / 8 * 8;
}

/* Reads what version 2 has after the path of a material. Returns where it ends. */
static uint64_t read_name(const struct bytes *file, const struct header *h, uint64_t at, int print)
{
    uint64_t length = u32(file, at + 4);
    require(file, u32(file, at) < 2, "unknown flags of a material");
    require(file, at + 8 + length <= h->table_at, "a name is cut off");
    const char *text = (const char *)bytes_at(file, at + 8, length);
    require(file, length == 0 || memchr(text, 0, length) == NULL, "a name with a zero byte");
    if (print)
        printf("name %.*s%s\n", (int)length, text, u32(file, at) ? ", colourless" : "");
    return at + 8 + length;
}

/* Reads the names of channels. Returns where they end. */
static uint64_t read_channels(const struct bytes *file, const struct header *h, uint64_t at,
                              uint32_t *count, int print)
{
    *count = u32(file, at);
    require(file, u32(file, at + 4) == 0, "reserved is not 0");
    at += 8;
    for (uint32_t i = 0; i < *count; i++) {
        uint64_t length = u32(file, at);
        require(file, at + 4 + length <= h->table_at, "a channel is cut off");
        const char *text = (const char *)bytes_at(file, at + 4, length);
        require(file, length > 0 && text[0] >= 'a' && text[0] <= 'z', "a channel without a name");
        for (uint64_t k = 0; k < length; k++)
            require(file, text[k] && strchr("abcdefghijklmnopqrstuvwxyz0123456789_", text[k]),
                    "a name of a channel");
        if (print)
            printf("channel %.*s\n", (int)length, text);
        at += 4 + length;
    }
    return at;
}

static void read_numbers(const struct bytes *file, uint64_t at, uint64_t count, int print)
{
    for (uint64_t k = 0; k < count; k++) {
        require(file, isfinite(f32(file, at + 4 * k)), "a number of a channel");
        if (print)
            printf(" %g", (double)f32(file, at + 4 * k));
    }
}

/* Reads what version 3 has after the name of a material. Returns where it ends. */
static uint64_t read_sources(const struct bytes *file, const struct header *h, uint64_t at,
                             uint32_t channels, int print)
{
    if (print)
        printf("coordinates");
    read_numbers(file, at, 4, print);
    at += 16;
    for (uint32_t i = 0; i < channels; i++) {
        uint32_t length = u32(file, at + 32);
        uint64_t path = length == NONE ? 0 : length;
        if (print)
            printf("\nsource");
        read_numbers(file, at, 3, print);
        require(file, u32(file, at + 12) < 5, "a component of a channel");
        if (print)
            printf(" component %u", u32(file, at + 12));
        read_numbers(file, at + 16, 4, print);
        require(file, at + 36 + path <= h->table_at, "a path is cut off");
        const char *text = (const char *)bytes_at(file, at + 36, path);
        require(file, path == 0 || memchr(text, 0, path) == NULL, "a path with a zero byte");
        require(file, length == NONE || (path > 0 && text[0] == '/'),
                "a path that is not absolute");
        if (print)
            printf(" %.*s", length == NONE ? 4 : (int)path, length == NONE ? "none" : text);
        at += 36 + path;
    }
    if (print)
        printf("\n");
    return at;
}

static void read_materials(const struct bytes *file, const struct header *h, int print)
{
    uint64_t at = h->materials_at;
    uint32_t channels = 0;
    if (h->version >= 2) {
        require(file,
                u32(file, at) + h->version >= 3 && u32(file, at) <= 3 && u32(file, at + 4) == 0,
                "unknown ids");
        if (print)
            printf("ids %u\n", u32(file, at));
        at += 8;
    }
    if (h->version == 3)
        at = read_channels(file, h, at, &channels, print);
    for (uint32_t i = 0; i < h->material_count; i++) {
        uint32_t length = u32(file, at + 12);
        uint64_t path = length == NONE ? 0 : length;
        for (uint64_t k = 0; k < 3; k++)
            require(file, isfinite(f32(file, at + 4 * k)), "wrong colour of a material");
        require(file, at + 16 + path <= h->table_at, "a path is cut off");
        const char *text = (const char *)bytes_at(file, at + 16, path);
        require(file, path == 0 || memchr(text, 0, path) == NULL, "a path with a zero byte");
        require(file, length == NONE || (path > 0 && text[0] == '/'),
                "a path that is not absolute");
        if (print)
            printf("material %g %g %g %.*s\n", (double)f32(file, at), (double)f32(file, at + 4),
                   (double)f32(file, at + 8), length == NONE ? 4 : (int)path,
                   length == NONE ? "none" : text);
        at += 16 + path;
        if (h->version >= 2)
            at = read_name(file, h, at, print);
        if (h->version == 3)
            at = read_sources(file, h, at, channels, print);
    }
    require(file, align8(at) == h->table_at, "the materials do not fill their part");
    require_zeros(file, at, h->table_at - at);
}

static void place_arrays(const struct header *h, struct chunk *c)
{
    uint64_t nv = c->vertices, nt = c->triangles, at = c->at + CHUNK_HEADER_BYTES;
    c->index_bytes = nv <= 65536 ? 2 : 4;
    c->positions = at, at += 12 * nv;
    c->normals = at, at += h->attributes & NORMALS ? 4 * nv : 0;
    c->texcoords = at, at += h->attributes & TEXCOORDS ? 8 * nv : 0;
    c->colors = at, at += h->attributes & COLORS ? 4 * nv : 0;
    c->materials = at, at += h->attributes & MATERIALS ? 4 * nt : 0;
    c->indices = at;
}

static struct chunk read_entry(const struct bytes *file, const struct header *h, uint64_t number)
{
    uint64_t at = h->table_at + ENTRY_BYTES * number;
    struct chunk c = {.at = u64(file, at),
                      .size = u64(file, at + 8),
                      .first = u64(file, at + 16),
                      .triangles = u32(file, at + 24),
                      .vertices = u32(file, at + 28)};
    read_box(file, at + 32, c.low, c.high);
    require(file, c.triangles >= 1 && c.triangles <= 65536, "wrong number of triangles");
    require(file, c.vertices >= 1 && c.vertices <= 3 * c.triangles, "wrong number of vertices");
    place_arrays(h, &c);
    uint64_t end = c.indices + (uint64_t)3 * c.index_bytes * c.triangles;
    require(file, c.size == align8(end - c.at), "wrong size of a chunk");
    require_zeros(file, end, c.at + c.size - end);
    return c;
}

/* ---- chunks ---- */

/* Checks that the bounds in the table are exactly those of the vertices. */
static void check_positions(const struct bytes *file, const struct chunk *c)
{
    for (uint64_t k = 0; k < 3; k++) {
        float low = INFINITY, high = -INFINITY;
        for (uint64_t v = 0; v < c->vertices; v++) {
            float p = f32(file, c->positions + 12 * v + 4 * k);
            require(file, isfinite(p), "a position is not finite");
            low = p < low ? p : low;
            high = p > high ? p : high;
        }
        require(file, low == c->low[k] && high == c->high[k], "bounds are not those of vertices");
    }
}

static uint32_t vertex_number(const struct bytes *file, const struct chunk *c, uint64_t corner)
{
    uint64_t at = c->indices + c->index_bytes * corner;
    uint32_t v = c->index_bytes == 2 ? u16(file, at) : u32(file, at);
    require(file, v < c->vertices, "a vertex number is too large");
    return v;
}

static void check_used(const struct bytes *file, const struct chunk *c)
{
    unsigned char *used = calloc(c->vertices, 1);
    require(file, used != NULL, "no memory");
    for (uint64_t i = 0; i < (uint64_t)3 * c->triangles; i++)
        used[vertex_number(file, c, i)] = 1;
    require(file, memchr(used, 0, c->vertices) == NULL, "a vertex is in no triangle");
    free(used);
}

static void check_chunk(const struct bytes *file, const struct header *h, const struct chunk *c)
{
    require(file, u64(file, c->at) == checksum(file, c->at + 8, c->size - 8),
            "wrong checksum of a chunk");
    require(file, u32(file, c->at + 8) == c->triangles && u32(file, c->at + 12) == c->vertices,
            "counts of chunk and table differ");
    check_positions(file, c);
    check_used(file, c);
    for (uint64_t i = 0; h->attributes & TEXCOORDS && i < (uint64_t)2 * c->vertices; i++)
        require(file, isfinite(f32(file, c->texcoords + 4 * i)), "wrong texture coordinate");
    for (uint64_t v = 0; h->attributes & COLORS && v < c->vertices; v++)
        require(file, u32(file, c->colors + 4 * v) >> 24 == 255, "wrong colour");
    for (uint64_t t = 0; h->attributes & MATERIALS && t < c->triangles; t++) {
        uint32_t material = u32(file, c->materials + 4 * t);
        require(file, material < h->material_count || material == NONE, "unknown material");
    }
}

static struct corner read_corner(const struct bytes *file, const struct header *h,
                                 const struct chunk *c, uint64_t number)
{
    uint64_t v = vertex_number(file, c, number);
    struct corner corner;
    memset(&corner, 0, sizeof corner);
    for (uint64_t k = 0; k < 3; k++)
        corner.position[k] = f32(file, c->positions + 12 * v + 4 * k);
    for (uint64_t k = 0; h->attributes & TEXCOORDS && k < 2; k++)
        corner.texcoord[k] = f32(file, c->texcoords + 8 * v + 4 * k);
    if (h->attributes & NORMALS)
        corner.normal = u32(file, c->normals + 4 * v);
    if (h->attributes & COLORS)
        corner.color = u32(file, c->colors + 4 * v);
    return corner;
}

static int before(const struct corner *a, const struct corner *b)
{
    for (int k = 0; k < 3; k++)
        if (a->position[k] != b->position[k])
            return a->position[k] < b->position[k];
    return 0;
}

/* Rotates the corners so that the least comes first, which keeps the winding. */
static void read_triangle(const struct bytes *file, const struct header *h, const struct chunk *c,
                          uint64_t t, struct corner out[3])
{
    struct corner corners[3];
    uint64_t least = 0;
    for (uint64_t i = 0; i < 3; i++) {
        corners[i] = read_corner(file, h, c, 3 * t + i);
        if (before(&corners[i], &corners[least]))
            least = i;
    }
    for (uint64_t i = 0; i < 3; i++)
        out[i] = corners[(least + i) % 3];
}

/* ---- results ---- */

static void print_triangle(const struct header *h, const struct corner corners[3],
                           uint32_t material)
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            printf("%.6f ", h->origin[k] + (double)corners[i].position[k]);
    for (int i = 0; h->attributes & TEXCOORDS && i < 3; i++)
        printf("%.6f %.6f ", (double)corners[i].texcoord[0], (double)corners[i].texcoord[1]);
    for (int i = 0; h->attributes & COLORS && i < 3; i++)
        printf("%u %u %u ", corners[i].color & 255, corners[i].color >> 8 & 255,
               corners[i].color >> 16 & 255);
    if (h->attributes & MATERIALS)
        printf("m%u ", material);
    printf("|");
    for (int i = 0; h->attributes & NORMALS && i < 3; i++) {
        double n[3];
        decode_normal(corners[i].normal, n);
        printf(" %.6f %.6f %.6f", n[0], n[1], n[2]);
    }
    printf("\n");
}

static void add_triangle(const struct corner corners[3], uint32_t material, struct sums *sums)
{
    double p[3][3], u[3], v[3], n[3];
    uint32_t hashed[3 * 7 + 1];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            p[i][k] = (double)corners[i].position[k];
    for (int k = 0; k < 3; k++) {
        u[k] = p[1][k] - p[0][k];
        v[k] = p[2][k] - p[0][k];
    }
    for (int k = 0; k < 3; k++)
        n[k] = u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
    sums->area += 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    sums->volume += (p[0][0] * n[0] + p[0][1] * n[1] + p[0][2] * n[2]) / 6.0;
    memcpy(hashed, corners, sizeof hashed - 4);
    hashed[3 * 7] = material;
    sums->hash += XXH3_64bits(hashed, sizeof hashed);
    sums->triangles++;
}

static void read_triangles(const struct bytes *file, const struct header *h, const struct chunk *c,
                           int print, struct sums *sums)
{
    for (uint64_t t = 0; t < c->triangles; t++) {
        struct corner corners[3];
        uint32_t material = h->attributes & MATERIALS ? u32(file, c->materials + 4 * t) : NONE;
        read_triangle(file, h, c, t, corners);
        add_triangle(corners, material, sums);
        if (print)
            print_triangle(h, corners, material);
    }
    sums->vertices += c->vertices;
}

static void widen(const struct chunk *c, float low[3], float high[3])
{
    for (int k = 0; k < 3; k++) {
        low[k] = c->low[k] < low[k] ? c->low[k] : low[k];
        high[k] = c->high[k] > high[k] ? c->high[k] : high[k];
    }
}

static struct sums read_chunks(const struct bytes *file, const struct header *h, int print)
{
    struct sums sums = {0};
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    uint64_t at = HEADER_BYTES;
    for (uint64_t i = 0; i < h->chunks; i++) {
        struct chunk c = read_entry(file, h, i);
        require(file, c.at == at, "a chunk does not follow the one before");
        require(file, c.first == sums.triangles, "wrong number of a chunk's first triangle");
        check_chunk(file, h, &c);
        read_triangles(file, h, &c, print, &sums);
        widen(&c, low, high);
        at += c.size;
    }
    require(file, at == h->materials_at, "chunks do not end where materials begin");
    require(file, sums.triangles == h->triangles, "wrong number of triangles in the header");
    if (h->chunks == 0)
        memset(low, 0, sizeof low), memset(high, 0, sizeof high);
    for (int k = 0; k < 3; k++)
        require(file, h->low[k] == low[k] && h->high[k] == high[k],
                "bounds of the header are not those of the chunks");
    return sums;
}

static void print_header(const struct header *h)
{
    printf("attributes %u\nchunks %llu\nsource_faces %llu\nskipped %llu\n", h->attributes,
           (unsigned long long)h->chunks, (unsigned long long)h->faces,
           (unsigned long long)h->skipped);
    printf("origin %.17g %.17g %.17g\n", h->origin[0], h->origin[1], h->origin[2]);
    for (int end = 0; end < 2; end++) {
        const float *bounds = end ? h->high : h->low;
        printf("%s", end ? "max" : "min");
        for (int k = 0; k < 3; k++)
            printf(" %.17g", h->origin[k] + (double)bounds[k]);
        printf("\n");
    }
}

int main(int argc, char **argv)
{
    int dump = argc == 3 && strcmp(argv[1], "--triangles") == 0;
    if (argc != 2 + dump) {
        fprintf(stderr, "usage: naive-read-tris [--triangles] FILE\n");
        return 64;
    }
    struct bytes file = read_bytes(argv[argc - 1]);
    struct header h = read_header(&file);
    read_materials(&file, &h, !dump);
    struct sums sums = read_chunks(&file, &h, dump);
    if (!dump) {
        print_header(&h);
        printf("triangles %llu\nvertices %llu\narea %.12g\nvolume %.12g\nhash %016llx\n",
               (unsigned long long)sums.triangles, (unsigned long long)sums.vertices, sums.area,
               sums.volume, (unsigned long long)sums.hash);
    }
    free(file.data);
    return 0;
}

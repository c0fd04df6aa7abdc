/* baseline_embree.c - prepares a scan as bakers do that hold it in memory. One thread reads and
 * parses the whole OBJ file into arrays of positions and indices. Then Embree builds its tree over
 * all triangles with all threads. Prints the cost of each phase; does not free memory.
 *
 * To be a fair comparison, the parser is as fast as good parsers in memory: it makes no calls per
 * number, frees the text before the tree is built, and grows arrays by remapping. It understands v
 * and f lines, polygons as fans, and negative indices, and rounds numbers to within an ulp. */
#include <embree3/rtcore.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/bench/phase.h"

struct mesh {
    float (*positions)[3];
    uint32_t (*triangles)[3];
    uint64_t vertex_count, vertex_capacity, triangle_count, triangle_capacity;
};

struct text {
    char *data; /* one '\n' and one '\0' follow it */
    uint64_t size;
};

static void die(int status, const char *what, const char *why)
{
    fprintf(stderr, "baseline-embree: %s: %s\n", what, why);
    exit(status);
}

/* ---- reading ---- */

static struct text read_text(const char *path)
{
    struct stat info;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0 || fstat(fd, &info) != 0)
        die(66, path, strerror(errno));
    struct text text = {.size = (uint64_t)info.st_size};
    text.data = malloc(text.size + 2);
    if (!text.data)
        die(71, path, "no memory for the text");
    for (uint64_t done = 0; done < text.size;) {
        ssize_t got = read(fd, text.data + done, text.size - done);
        if (got < 0)
            die(74, path, strerror(errno));
        if (got == 0)
            die(74, path, "became shorter while it was read");
        done += (uint64_t)got;
    }
    close(fd);
    text.data[text.size] = '\n';
    text.data[text.size + 1] = '\0';
    return text;
}

/* ---- parsing ---- */

static inline bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

static inline const char *skip_blanks(const char *p)
{
    while (*p == ' ' || *p == '\t')
        p++;
    return p;
}

static double power_of_ten(int exponent)
{
    static const double exact[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                   1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                   1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    enum { EXACT = sizeof exact / sizeof *exact };
    double power = 1;
    for (; exponent >= EXACT; exponent -= EXACT - 1)
        power *= exact[EXACT - 1];
    return power * exact[exponent];
}

static const char *parse_exponent(const char *p, int *exponent)
{
    const char *digits = p + 1;
    bool negative = *digits == '-';
    if (*digits == '-' || *digits == '+')
        digits++;
    if (!is_digit(*digits))
        return p;
    int value = 0;
    for (; is_digit(*digits); digits++)
        value = value < 1000 ? 10 * value + (*digits - '0') : value;
    *exponent += negative ? -value : value;
    return digits;
}

/* Parses a number. Digits after the 18th change a float by its rounding error at most. */
static inline const char *parse_float(const char *p, float *out)
{
    static const uint64_t full = 100000000000000000;
    uint64_t mantissa = 0;
    int exponent = 0;
    p = skip_blanks(p);
    bool negative = *p == '-';
    if (*p == '-' || *p == '+')
        p++;
    for (; is_digit(*p); p++) {
        if (mantissa < full)
            mantissa = 10 * mantissa + (uint64_t)(*p - '0');
        else
            exponent++;
    }
    if (*p == '.') {
        for (p++; is_digit(*p); p++) {
            if (mantissa >= full)
                continue;
            mantissa = 10 * mantissa + (uint64_t)(*p - '0');
            exponent--;
        }
    }
    if (*p == 'e' || *p == 'E')
        p = parse_exponent(p, &exponent);
    double value = (double)mantissa;
    value = exponent < 0 ? value / power_of_ten(-exponent) : value * power_of_ten(exponent);
    *out = (float)(negative ? -value : value);
    return p;
}

/* Grows an array to hold `more` elements. Large arrays are remapped, not copied, and pages that are
 * not written take no memory. */
static void *grow(void *array, uint64_t count, uint64_t more, uint64_t *capacity, size_t size)
{
    if (count + more <= *capacity)
        return array;
    *capacity = *capacity ? 2 * *capacity : 1 << 20;
    array = realloc(array, *capacity * size);
    if (!array)
        die(71, "mesh", "no memory");
    return array;
}

static inline const char *parse_vertex(const char *p, struct mesh *mesh)
{
    /* One element is spare: Embree reads 16 bytes at each position. */
    mesh->positions = grow(mesh->positions, mesh->vertex_count, 2, &mesh->vertex_capacity,
                           sizeof *mesh->positions);
    float *position = mesh->positions[mesh->vertex_count++];
    for (int axis = 0; axis < 3; axis++)
        p = parse_float(p, position + axis);
    return p;
}

/* Parses the position index of a corner and skips its other indices. */
static inline const char *parse_corner(const char *p, const struct mesh *mesh, uint32_t *index)
{
    bool negative = *p == '-';
    uint64_t value = 0;
    p += negative;
    for (; is_digit(*p); p++)
        value = 10 * value + (uint64_t)(*p - '0');
    *index = (uint32_t)(negative ? mesh->vertex_count - value : value - 1);
    while (*p > ' ')
        p++;
    return skip_blanks(p);
}

static inline const char *parse_face(const char *p, struct mesh *mesh)
{
    uint32_t first = 0, last = 0, index;
    p = skip_blanks(p);
    for (uint32_t corner = 0; is_digit(*p) || *p == '-'; corner++) {
        p = parse_corner(p, mesh, &index);
        if (corner == 0)
            first = index;
        if (corner >= 2) {
            mesh->triangles = grow(mesh->triangles, mesh->triangle_count, 1,
                                   &mesh->triangle_capacity, sizeof *mesh->triangles);
            uint32_t *triangle = mesh->triangles[mesh->triangle_count++];
            triangle[0] = first, triangle[1] = last, triangle[2] = index;
        }
        last = index;
    }
    return p;
}

static struct mesh parse(const struct text *text)
{
    struct mesh mesh = {0};
    const char *p = text->data, *end = text->data + text->size;
    while (p < end) {
        p = skip_blanks(p);
        if (p[0] == 'v' && (p[1] == ' ' || p[1] == '\t'))
            p = parse_vertex(p + 2, &mesh);
        else if (p[0] == 'f' && (p[1] == ' ' || p[1] == '\t'))
            p = parse_face(p + 2, &mesh);
        while (*p != '\n')
            p++;
        p++;
    }
    return mesh;
}

/* ---- building ---- */

static void on_embree_error(void *user, enum RTCError code, const char *text)
{
    (void)user;
    die(code == RTC_ERROR_OUT_OF_MEMORY ? 71 : 70, "Embree", text ? text : "unknown error");
}

static RTCScene build(RTCDevice device, const struct mesh *mesh)
{
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               mesh->positions, 0, sizeof *mesh->positions, mesh->vertex_count);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               mesh->triangles, 0, sizeof *mesh->triangles, mesh->triangle_count);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
    return scene;
}

int main(int argc, char **argv)
{
    if (argc != 2) {
        fputs("usage: baseline-embree SCAN.obj\n", stderr);
        return 64;
    }
    struct phase_clock clock = phase_now();
    struct text text = read_text(argv[1]);
    struct mesh mesh = parse(&text);
    free(text.data);
    phase_end("parse", &clock);
    if (mesh.triangle_count == 0)
        die(65, argv[1], "no faces");
    RTCDevice device = rtcNewDevice(NULL);
    if (!device)
        die(70, "Embree", "no device");
    rtcSetDeviceErrorFunction(device, on_embree_error, NULL);
    RTCScene scene = build(device, &mesh);
    phase_end("build", &clock);
    struct RTCBounds bounds;
    rtcGetSceneBounds(scene, &bounds);
    printf("triangles=%llu\nvertices=%llu\nbounds=%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n",
           (unsigned long long)mesh.triangle_count, (unsigned long long)mesh.vertex_count,
           (double)bounds.lower_x, (double)bounds.lower_y, (double)bounds.lower_z,
           (double)bounds.upper_x, (double)bounds.upper_y, (double)bounds.upper_z);
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    free(mesh.positions);
    free(mesh.triangles);
    return 0;
}

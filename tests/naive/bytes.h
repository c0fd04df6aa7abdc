/* bytes.h - shared by the naive readers: loads a file, reads numbers from it, ends with a message.
 *
 * The readers are written from formats/FORMATS.md alone and share no code with Bisque. So a mistake
 * in the page, in the writer or in Bisque's reader makes them disagree. They are simple and slow:
 * the whole file is in memory, and each access is checked. */
#ifndef NAIVE_BYTES_H
#define NAIVE_BYTES_H

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

enum { EXIT_DAMAGED = 65 };

struct bytes {
    const char *path;
    uint8_t *data;
    uint64_t size;
};

__attribute__((noreturn, format(printf, 2, 3))) static inline void refuse(const struct bytes *file,
                                                                          const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "%s: ", file->path);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
    exit(EXIT_DAMAGED);
}

static inline void require(const struct bytes *file, int condition, const char *what)
{
    if (!condition)
        refuse(file, "%s", what);
}

static inline struct bytes read_bytes(const char *path)
{
    struct bytes file = {path, NULL, 0};
    FILE *stream = fopen(path, "rb");
    if (!stream)
        refuse(&file, "cannot be opened");
    for (uint64_t capacity = 0, got = 1; got > 0; file.size += got) {
        if (file.size == capacity)
            file.data = realloc(file.data, capacity = 2 * capacity + 4096);
        if (!file.data)
            refuse(&file, "no memory");
        got = fread(file.data + file.size, 1, capacity - file.size, stream);
    }
    fclose(stream);
    return file;
}

/* Returns the bytes [at, at + size), which must be in the file. */
static inline const uint8_t *bytes_at(const struct bytes *file, uint64_t at, uint64_t size)
{
    if (at > file->size || size > file->size - at)
        refuse(file, "cut off: no %llu bytes at %llu", (unsigned long long)size,
               (unsigned long long)at);
    return file->data + at;
}

static inline uint64_t load(const struct bytes *file, uint64_t at, unsigned size)
{
    const uint8_t *from = bytes_at(file, at, size);
    uint64_t value = 0;
    for (unsigned i = 0; i < size; i++)
        value |= (uint64_t)from[i] << 8 * i;
    return value;
}

static inline uint16_t u16(const struct bytes *file, uint64_t at)
{
    return (uint16_t)load(file, at, 2);
}

static inline uint32_t u32(const struct bytes *file, uint64_t at)
{
    return (uint32_t)load(file, at, 4);
}

static inline uint64_t u64(const struct bytes *file, uint64_t at)
{
    return load(file, at, 8);
}

static inline int32_t i32(const struct bytes *file, uint64_t at)
{
    return (int32_t)u32(file, at);
}

static inline float f32(const struct bytes *file, uint64_t at)
{
    uint32_t bits = u32(file, at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline double f64(const struct bytes *file, uint64_t at)
{
    uint64_t bits = u64(file, at);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline uint64_t checksum(const struct bytes *file, uint64_t at, uint64_t size)
{
    return XXH3_64bits(bytes_at(file, at, size), size);
}

static inline void require_zeros(const struct bytes *file, uint64_t at, uint64_t size)
{
    const uint8_t *from = bytes_at(file, at, size);
    for (uint64_t i = 0; i < size; i++)
        if (from[i] != 0)
            refuse(file, "byte %llu is not zero", (unsigned long long)(at + i));
}

static inline void require_text(const struct bytes *file, uint64_t at, const char *text,
                                const char *what)
{
    require(file, memcmp(bytes_at(file, at, strlen(text)), text, strlen(text)) == 0, what);
}

/* Checks a name of `size` bytes that is padded with zeros. */
static inline void require_name(const struct bytes *file, uint64_t at, const char *name,
                                uint64_t size)
{
    require_text(file, at, name, "wrong name");
    require_zeros(file, at + strlen(name), size - strlen(name));
}

/* ---- octahedral normals ---- */

static inline double octahedral_part(uint32_t bits)
{
    double value = (double)(int16_t)(uint16_t)bits / 32767.0;
    return value < -1.0 ? -1.0 : value;
}

static inline void decode_normal(uint32_t packed, double n[3])
{
    double x = octahedral_part(packed), y = octahedral_part(packed >> 16);
    double z = 1.0 - fabs(x) - fabs(y), length;
    n[0] = x, n[1] = y, n[2] = z;
    if (z < 0.0) {
        n[0] = (1.0 - fabs(y)) * (x < 0.0 ? -1.0 : 1.0);
        n[1] = (1.0 - fabs(x)) * (y < 0.0 ? -1.0 : 1.0);
    }
    length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int k = 0; k < 3; k++)
        n[k] /= length;
}

#endif

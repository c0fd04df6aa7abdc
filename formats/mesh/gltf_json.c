/* gltf_json.c - reads values of a glTF file's JSON, and says where those are that cannot be. */
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>

#include "formats/mesh/gltf_internal.h"

struct gltf_place fmt_gltf_element(struct gltf_document *document, const char *array,
                                   uint64_t index)
{
    const json_t *list = json_object_get(document->root, array);
    return (struct gltf_place){.document = document,
                               .array = array,
                               .index = index,
                               .object = json_array_get(list, index)};
}

uint64_t fmt_gltf_count(const struct gltf_document *document, const char *array)
{
    return json_array_size(json_object_get(document->root, array));
}

int fmt_gltf_fail(const struct gltf_place *place, const char *format, ...)
{
    char text[300];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return bsq_fail(place->document->ctx, BSQ_EDATA, "%s: %s[%" PRIu64 "]: %s",
                    place->document->file.path, place->array, place->index, text);
}

bool fmt_gltf_whole(const json_t *value, uint64_t most, uint64_t *out)
{
    if (json_is_integer(value)) {
        const json_int_t number = json_integer_value(value);
        *out = (uint64_t)number;
        return number >= 0 && *out <= most;
    }
    const double real = json_real_value(value); /* 0 if it is none */
    if (!json_is_real(value) || !(real >= 0 && real < 9007199254740992.0) || real != floor(real))
        return false;
    *out = (uint64_t)real;
    return *out <= most;
}

int fmt_gltf_number(const struct gltf_place *place, const json_t *object, const char *key,
                    uint64_t most, uint64_t *out)
{
    const json_t *value = json_object_get(object, key);
    if (!value && *out == GLTF_REQUIRED)
        return fmt_gltf_fail(place, "\"%s\" is missing", key);
    if (!value)
        return 0;
    if (!fmt_gltf_whole(value, most, out))
        return fmt_gltf_fail(place, "\"%s\" is no whole number from 0 to %" PRIu64, key, most);
    return 0;
}

int fmt_gltf_index(const struct gltf_place *place, const json_t *object, const char *key,
                   const char *array, uint32_t *out)
{
    const uint64_t count = fmt_gltf_count(place->document, array);
    uint64_t index = GLTF_NONE;
    int status = fmt_gltf_number(place, object, key, INT32_MAX, &index);
    if (!status && index != GLTF_NONE && index >= count)
        status = fmt_gltf_fail(place, "\"%s\" refers to %s[%" PRIu64 "], the file has %" PRIu64,
                               key, array, index, count);
    *out = status ? GLTF_NONE : (uint32_t)index;
    return status;
}

int fmt_gltf_numbers(const struct gltf_place *place, const json_t *object, const char *key,
                     unsigned count, double *out)
{
    const json_t *list = json_object_get(object, key);
    if (!list)
        return 0;
    if (json_array_size(list) != count)
        return fmt_gltf_fail(place, "\"%s\" is no list of %u numbers", key, count);
    for (unsigned i = 0; i < count; i++) {
        const json_t *value = json_array_get(list, i);
        if (!json_is_number(value))
            return fmt_gltf_fail(place, "\"%s\" is no list of %u numbers", key, count);
        out[i] = json_number_value(value);
    }
    return 1;
}

const char *fmt_gltf_string(const json_t *object, const char *key)
{
    return json_string_value(json_object_get(object, key));
}

const json_t *fmt_gltf_extension(const json_t *object, const char *name)
{
    return json_object_get(json_object_get(object, "extensions"), name);
}

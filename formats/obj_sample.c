/* obj_sample.c - how a file is laid out, from samples. A wrong answer costs time, nothing else. */
#include "formats/obj_internal.h"

enum { SAMPLES = 32, SAMPLE_BYTES = 4096 };

/* First letters of the sample's lines; what the sample cuts off at both ends is left out. */
static bool element_follows_face(const char *text, uint64_t size, bool *face_seen)
{
    for (uint64_t i = 1; i < size; i++) {
        if (text[i - 1] != '\n')
            continue;
        if (text[i] == 'f')
            *face_seen = true;
        if (text[i] == 'v' && *face_seen)
            return true;
    }
    return false;
}

bool fmt_obj_faces_come_last(const struct fmt_obj_reader *reader)
{
    struct bsq_file file;
    bool face_seen = false, found = reader->source_count != 1;
    if (found || bsq_file_open(reader->ctx, reader->sources[0].path, &file) < 0)
        return false;
    uint64_t step = file.size / SAMPLES > SAMPLE_BYTES ? file.size / SAMPLES : SAMPLE_BYTES;
    for (uint64_t offset = 0; !found && offset < file.size; offset += step) {
        char text[SAMPLE_BYTES];
        uint64_t got;
        if (bsq_file_read_some(reader->ctx, &file, text, sizeof text, offset, &got) < 0)
            break; /* reading in earnest will say so again */
        found = element_follows_face(text, got, &face_seen);
    }
    bsq_file_close(reader->ctx, &file);
    return !found;
}

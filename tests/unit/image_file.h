/* image_file.h - completes image files of tests. */
#ifndef TEST_IMAGE_FILE_H
#define TEST_IMAGE_FILE_H

#include "formats/image/image_writer.h"

/* Completes a file and gives it its name; frees the writer in any case. */
static inline int test_commit_image(struct fmt_image_writer *writer)
{
    struct bsq_output *output;
    int status = fmt_image_hand_over(writer, &output);
    return status < 0 ? status : bsq_output_commit(output);
}

#endif

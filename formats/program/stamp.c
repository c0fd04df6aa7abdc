/* stamp.c - the stamp, compiled in. A file of its own: only this one is compiled again when
 * a header that it covers changes. */
#include "formats/program/program.h"

const char fmt_program_stamp[] = FMT_PROGRAM_STAMP;

/* directory.c - the directory that such programs are installed in. Installing under another prefix
 * than the library was built for replaces only this object. */
#include "formats/program/program.h"

const char fmt_program_directory[] = FMT_PROGRAM_DIRECTORY;

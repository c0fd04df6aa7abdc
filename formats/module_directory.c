/* module_directory.c - where modules are installed. A file of its own, so that installing the
 * library under another prefix than it was built for replaces nothing else. */
#include "formats/module_internal.h"

const char fmt_module_directory[] = FMT_MODULE_DIRECTORY;

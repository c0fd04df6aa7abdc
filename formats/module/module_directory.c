/* module_directory.c - the directory that modules are installed in. Installing under another prefix
 * than the library was built for replaces only this object. */
#include "formats/module/module.h"

const char fmt_module_directory[] = FMT_MODULE_DIRECTORY;

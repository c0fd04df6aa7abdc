/* module_stamp.c - the stamp, compiled in. A file of its own: only this one is compiled again when
 * a header that it covers changes. */
#include "formats/module/module.h"

const char fmt_module_stamp[] = FMT_MODULE_STAMP;

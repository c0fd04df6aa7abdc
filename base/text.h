/* text.h - texts: copies; distinct ones in a table, with the memory that they take; what a text in
 * JSON needs when it is parsed; numbers in texts. */
#ifndef BSQ_TEXT_H
#define BSQ_TEXT_H

#include <locale.h>

#include "base/context.h"

/* Lets this thread print and read numbers with a decimal point, whatever the locale of the program
 * that uses the library is. Returns the locale before it, which uselocale() sets again. */
locale_t bsq_plain_numbers(void);

/* Returns a bound of the bytes that Jansson 2 needs for a text of `size` bytes, with the system's
 * overhead of each block. Reserve them before parsing. */
uint64_t bsq_json_bound(const char *text, uint64_t size);

/* Continues a hash, FNV-1a (Fowler, Noll, Vo) of 64 bits, with the bytes of a text. Starts from
 * BSQ_HASH_START. */
#define BSQ_HASH_START UINT64_C(0xcbf29ce484222325)
uint64_t bsq_text_hash(uint64_t hash, const char *text, size_t length);

/* ---- tables of distinct texts, such as the names of files; not thread-safe ---- */

/* Bytes of lists that grow with the files of a job. The first BSQ_FREE_BYTES are not counted
 * against the budget, so that jobs with few files have the same memory as without these lists. */
struct bsq_tally {
    uint64_t bytes, reserved;
};
#define BSQ_FREE_BYTES (UINT64_C(64) << 10)

/* Counts more bytes. Errors: BSQ_ENOMEM. */
int bsq_tally_add(struct bsq_ctx *ctx, struct bsq_tally *tally, uint64_t bytes);
/* Returns all bytes to the budget. */
void bsq_tally_release(struct bsq_ctx *ctx, struct bsq_tally *tally);

/* Copies a text; NULL gives NULL. Free *out with bsq_free(). Errors: BSQ_ENOMEM. */
int bsq_text_copy(struct bsq_ctx *ctx, const char *text, char **out);
/* Makes a text as printf() does. Free *out with bsq_free(). Errors: BSQ_ENOMEM. */
int bsq_text_print(struct bsq_ctx *ctx, char **out, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Texts in the order in which they were added. All zeros: empty. Free it with bsq_texts_free(). */
struct bsq_texts {
    char **list; /* each stays where it is */
    uint64_t count, capacity;
    uint64_t *cells; /* open addressing: number of the text + 1, 0 in empty cells; twice as many as
                        `capacity`, a power of 2 */
};

/* Returns the number of a text; texts->count if it is not there. */
uint64_t bsq_texts_find(const struct bsq_texts *texts, const char *text);
/* Sets *number to the number of a text. A copy is added if the text is new: then *number was
 * texts->count. Errors: BSQ_ENOMEM. */
int bsq_texts_add(struct bsq_ctx *ctx, struct bsq_tally *tally, struct bsq_texts *texts,
                  const char *text, uint64_t *number);
void bsq_texts_free(struct bsq_texts *texts);

/* Grows *inout, an array of elements of `size` bytes, to hold at least `count` of them, by doubling
 * *capacity. New elements are not initialised. Errors: BSQ_ENOMEM. */
int bsq_tally_grow(struct bsq_ctx *ctx, struct bsq_tally *tally, uint64_t count, uint64_t size,
                   void *inout, uint64_t *capacity);

#endif

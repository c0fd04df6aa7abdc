/** @file
 * Options as tables. A row says what an option is called, which values it takes, and which member
 * of a structure holds its value. Defaults, checks, the command line, its help and what the parts
 * of a bake must share all follow from the rows. */
#ifndef BSQ_OPTIONS_H
#define BSQ_OPTIONS_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/** What a member holds. */
enum bsq_option_kind {
    BSQ_OPTION_FLAG,   /**< bool. On a command line without a value, or one of two `words`. */
    BSQ_OPTION_COUNT,  /**< uint32_t. `words`, if any, is a word for UINT32_MAX. */
    BSQ_OPTION_BYTES,  /**< uint64_t, a size in bytes; 0: not given. */
    BSQ_OPTION_NUMBER, /**< double. `words`, if any, is a word for all numbers below 0. */
    BSQ_OPTION_CHOICE, /**< unsigned, or an enumeration: the index of one of `words`. */
    BSQ_OPTION_TEXT,   /**< const char *. */
    BSQ_OPTION_INPUT,  /**< const char *, a file that is read; NULL: none. */
    BSQ_OPTION_OUTPUT, /**< const char *, a file that is written; NULL: none. */
    BSQ_OPTION_LIST,   /**< A pointer to elements, and a uint32_t with their number. */
    BSQ_OPTION_NONE    /**< Nothing: the program takes the value. */
};

/** A row. A member without a name is set by another option, or not from the command line. */
struct bsq_option {
    const char *name;    /**< Without dashes, or NULL. */
    const char *also;    /**< What others call it, which is not taken but told of; NULL: nothing. */
    const char *key;     /**< Of options such as --range height=D,curvature=C: "height"; or NULL.
                            Rows with keys and the same name follow each other. */
    char letter;         /**< Of the short form, or 0. */
    const char *heading; /**< Of the rows from here on in the help; NULL: the same as before. */
    bool own_syntax;     /**< The program parses the value. */
    bool finishes;       /**< Has no effect on what parts of a bake contain. */
    const char *argument; /**< What the help calls the value; NULL: takes none. */
    const char *help;     /**< Lines, with newlines between them. NULL: understood, but hidden. */
    enum bsq_option_kind kind; /**< What the member holds. */
    const char *member;        /**< Its name. NULL: no member. */
    size_t offset;             /**< Where it is in the structure. */
    size_t bytes;              /**< Its size. */
    /** Words with spaces between them, and '/' between words that mean the same. */
    const char *words;
    double least;     /**< Of a count or a number. */
    double most;      /**< Likewise. */
    double usual;     /**< Default of a count, a number or a choice. */
    const char *text; /**< Default of a text. */
    bool positive;    /**< A number must be above `least`. */
    uint32_t needs;   /**< Bits: what the option has an effect on. The table says what they mean. */
    /** @name Of a list
     * A single row without a member stands for elements that are single values.
     * @{ */
    const struct bsq_option *rows; /**< The members of an element. */
    size_t row_count;              /**< Number of these rows. */
    size_t element_bytes;          /**< Size of an element. */
    size_t count_offset;           /**< Where the number of elements is in the structure. */
    /** @} */
};

/** @name Initialisers of rows
 * `type` is the structure.
 * @{ */
/** Name, what the help calls the value, and help. */
#define BSQ_ROW(name_, argument_, help_) .name = name_, .argument = argument_, .help = help_
/** A value that the program parses. */
#define BSQ_OWN .own_syntax = true, .kind = BSQ_OPTION_NONE
/** A member of any kind but LIST. */
#define BSQ_MEMBER(kind_, type, member_)                                                           \
    .kind = BSQ_OPTION_##kind_, .member = #member_, .offset = offsetof(type, member_),             \
    .bytes = sizeof((type *)NULL)->member_
/** What a count or a number may be, and its default. */
#define BSQ_RANGE(least_, most_, usual_) .least = least_, .most = most_, .usual = usual_
/** A list: the member that points to its elements, that with their number, and their rows. */
#define BSQ_LIST(type, member_, count_, rows_)                                                     \
    .kind = BSQ_OPTION_LIST, .member = #member_, .offset = offsetof(type, member_),                \
    .bytes = sizeof(void *), .rows = rows_, .row_count = sizeof rows_ / sizeof *rows_,             \
    .element_bytes = sizeof *((type *)NULL)->member_, .count_offset = offsetof(type, count_)
/** @} */

/** Returns where a row's member is. */
static inline void *bsq_option_at(const struct bsq_option *row, const void *options)
{
    return (char *)(uintptr_t)options + row->offset;
}

/** Returns the index of a word in the `words` of a row, or -1. NULL has no words. */
int bsq_option_word(const char *words, const char *word);

/** The size of a buffer for bsq_option_text(). */
enum { BSQ_OPTION_TEXT_BYTES = 64 };
/** Returns the value of a row as a command line has it, in `buffer` or in the options; NULL: not
 * given, or the program takes it apart. */
const char *bsq_option_text(const struct bsq_option *row, const void *options,
                            char buffer[BSQ_OPTION_TEXT_BYTES]);

/** Sets the members of all rows to their defaults, and those without one to zeros. */
void bsq_options_defaults(const struct bsq_option *rows, size_t count, void *options);

/** Checks that all members have values that their rows allow. Errors: BSQ_EUSAGE. */
int bsq_options_check(struct bsq_ctx *ctx, const struct bsq_option *rows, size_t count,
                      const void *options);

#ifdef __cplusplus
}
#endif
#endif

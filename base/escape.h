/* escape.h - makes text from files and command lines fit for terminals and logs. */
#ifndef BSQ_ESCAPE_H
#define BSQ_ESCAPE_H

#ifdef __cplusplus
extern "C" {
#endif

/* Returns a copy of `text` in which "\xHH" replaces each byte that is not part of valid UTF-8 or is
 * part of a control character: C0 and C1, line and paragraph separators, and characters that change
 * the direction of text. A newline stays if `keep_newlines` is set. The result is valid UTF-8 in
 * one line, and a terminal shows it as it is. A backslash stays, so this cannot be undone. Free it
 * with free(); NULL if there is no memory. */
char *bsq_escape(const char *text, int keep_newlines);

#ifdef __cplusplus
}
#endif
#endif

/* sanitized.h - is this built with a sanitizer that takes ten times as long? Tests whose long part
 * repeats what a short one does already then do the short one; what they prove by numbers they
 * prove without sanitizers. */
#ifndef TEST_SANITIZED_H
#define TEST_SANITIZED_H

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define TEST_SANITIZED 1
#else
#define TEST_SANITIZED 0
#endif

#endif

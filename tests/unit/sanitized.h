/* sanitized.h - tells whether a sanitizer is built in, which makes tests about ten times slower.
 * Long tests that repeat a short part many times then run the short part only. */
#ifndef TEST_SANITIZED_H
#define TEST_SANITIZED_H

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define TEST_SANITIZED 1
#else
#define TEST_SANITIZED 0
#endif

#endif

/* fault.h - counts calls of a program, and does something at one of them, as the environment says:
 *
 * FAULT_CALLS   which calls count: words of open, read, map, write, sync, size, name, remove, close
 *               (faults.c) or check (checks.c)
 * FAULT_PATH    only files whose path contains this text count; of checks, only those in stages
 *               whose name contains it
 * FAULT_AT      number of the call at which something happens, from 1; 0 or not set: none
 * FAULT_STICKY  1: all calls from that number on fail
 * FAULT_DO      an errno (ENOSPC ...): the call fails;
 *               short: a read or write transfers half;
 *               a signal (TERM, KILL ...): the thread gets it before the call;
 *               pause: creates the file FAULT_FLAG and continues when that file is gone
 * FAULT_LOG     file that gets a line for each call that counts
 * FAULT_COUNT   file that gets a line when the program ends: the number of these calls, and how
 * many of them came after the signal */
#ifndef TESTS_FAULTS_FAULT_H
#define TESTS_FAULTS_FAULT_H

enum { FAULT_GO_ON, FAULT_SHORT, FAULT_FAIL };

/* Returns a setting, or "" if it is not set. */
const char *fault_setting(const char *name);

/* Counts a call of this kind on a file, or in a stage, and returns what to do with it. Sets errno
 * for FAULT_FAIL. May be called by several threads at once. */
int fault_at(const char *kind, const char *call, const char *path);

#endif

/* cli_percent.h - progress as lines for schedulers: openjd, percent and alf. Programs need it only
 * if they do a job several times. */
#ifndef CLI_PERCENT_H
#define CLI_PERCENT_H

#include "tools/cli.h"

/* Returns whether --progress asks for these lines. */
bool cli_prints_percent(const struct cli *cli);

/* Prints the first line, and starts the heartbeat. */
void cli_percent_begin(const struct cli *cli);

/* Takes a report of the context. */
void cli_percent_report(struct cli *cli, const struct bsq_progress *progress);

/* Notes that a program does the job of its stages for the time `turn` of `turns`, from 0 on. Each
 * time has an equal share of the percentage. */
void cli_percent_turn(struct cli *cli, uint32_t turn, uint32_t turns);

/* Stops the heartbeat; prints 100 % after a success. Does nothing if nothing was begun. */
void cli_percent_end(const struct cli *cli, bool success);

/* Prints a failure for Open Job Description. */
void cli_percent_fail(const struct cli *cli, const char *text);

#endif

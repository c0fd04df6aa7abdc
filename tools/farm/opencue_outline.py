#!/usr/bin/env python3
"""opencue_outline.py PLAN TASKS - an example: the tasks of a plan and their merge, for OpenCue.

This example is untested: it follows OpenCue's documentation of PyOutline, but was never run on an
OpenCue farm. Write the plan first, with bisque-bake --tasks TASKS --plan PLAN.
"""
import sys

import outline
import outline.cuerun
import outline.modules.shell


def make_job(plan, tasks):
    """Returns a job with a layer for the tasks, and one for the merge that waits for all of them."""
    job = outline.Outline("bisque-bake", frame_range=f"0-{tasks - 1}", show="testing")
    bake = outline.modules.shell.Shell(
        "bake",
        command=["bisque-bake", "--plan", plan, "--task", "#IFRAME#", "--progress", "percent"],
        chunk=1,
        threads=4,
        memory="4g",
    )
    merge = outline.modules.shell.Shell(
        "merge",
        command=["bisque-bake", "--plan", plan, "--merge", "--progress", "percent"],
        range="0-0",
        memory="4g",
    )
    merge.depend_all(bake)
    job.add_layer(bake)
    job.add_layer(merge)
    return job


if __name__ == "__main__":
    outline.cuerun.launch(make_job(sys.argv[1], int(sys.argv[2])), use_pycuerun=False)

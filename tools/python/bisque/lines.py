"""lines.py - reads what Bisque's programs print to standard error with --progress json. Blender's extension has this
file, too."""
import json


def read_line(line):
    """Returns what a line is, and its content: "step" and a dict with stage, done, total and unit; "warning" and its
    text; or "line" and the line itself, of any other kind."""
    line = line.strip()
    try:
        said = json.loads(line)
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, dict):
        return "line", line
    if isinstance(said.get("warning"), str):
        return "warning", said["warning"]
    if all(type(said.get(key)) in (int, float) for key in ("done", "total")) and all(
            isinstance(said.get(key), str) for key in ("stage", "unit")):
        return "step", said
    return "line", line

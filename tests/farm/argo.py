"""argo.py - holds an Argo Workflow against Argo's schema, and runs its steps here, one after another.

Usage: argo.py WORKFLOW NAME=VALUE...
Knows what bake.argo.yaml uses: a dag with dependencies, withSequence, parameters, containers."""
import re
import subprocess
import sys

import yaml
from hera.workflows.models import Workflow

with open(sys.argv[1], encoding="utf-8") as file:
    text = yaml.safe_load(file)
parsed = Workflow.parse_obj(text)


def left_out(given, known, place="workflow"):
    """Yields members of the file that the schema does not have."""
    if isinstance(given, dict) and isinstance(known, dict):
        for key, value in given.items():
            if key not in known:
                yield f"{place}.{key}"
            else:
                yield from left_out(value, known[key], f"{place}.{key}")
    elif isinstance(given, list):
        for i, value in enumerate(given):
            yield from left_out(value, known[i], f"{place}[{i}]")


unknown = list(left_out(text, parsed.dict(by_alias=True, exclude_none=True)))
if unknown:
    sys.exit(f"argo.py: not in Argo's schema: {unknown}")

spec = text["spec"]
values = {f"workflow.parameters.{p['name']}": p.get("value") for p in spec["arguments"]["parameters"]}
for word in sys.argv[2:]:
    name, value = word.split("=", 1)
    assert f"workflow.parameters.{name}" in values, name
    values[f"workflow.parameters.{name}"] = value
templates = {t["name"]: t for t in spec["templates"]}
names = {v["name"] for v in spec["volumes"]}


def fill(text, more):
    return re.sub(r"\{\{(.*?)\}\}", lambda m: {**values, **more}[m[1]], text)


def run(name, inputs):
    container = templates[name]["container"]
    assert {m["name"] for m in container["volumeMounts"]} <= names and fill(container["image"], {})
    more = {f"inputs.parameters.{k}": v for k, v in inputs.items()}
    assert set(inputs) == {p["name"] for p in templates[name].get("inputs", {}).get("parameters", [])}
    subprocess.run([fill(w, more) for w in container["command"] + container["args"]], check=True)


done = set()
tasks = templates[spec["entrypoint"]]["dag"]["tasks"]
while len(done) < len(tasks):
    task = next(t for t in tasks if t["name"] not in done and set(t.get("dependencies", [])) <= done)
    count = int(fill(task["withSequence"]["count"], {})) if "withSequence" in task else 1
    for item in reversed(range(count)):  # in any order
        run(task["template"], {p["name"]: fill(p["value"], {"item": str(item)})
                               for p in task.get("arguments", {}).get("parameters", [])})
    done.add(task["name"])

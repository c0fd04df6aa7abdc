"""What the readers of parts have in common: plans, and the loop over the files of a command line."""
import json

from refusal import Refused, need


def read_json_plan(path, kind, version):
    """Returns a plan of this kind and version."""
    with open(path, encoding="utf-8") as file:
        plan = json.load(file)
    need(plan["format"] == kind and plan["format_version"] == version, "not a plan")
    need(len(plan["id"]) == 32, "id")
    need(1 <= plan["tasks"] <= 65536 and len(plan["expected"]) == plan["tasks"], "tasks")
    return plan


def check_parts(plan_path, paths, read_plan, accept):
    """Prints a line for each part. accept(plan, data) returns its task. Returns 1 after a refusal."""
    refused = 0
    try:
        plan = read_plan(plan_path)
    except Refused as reason:
        print(f"{plan_path}: refused: {reason}")
        return 1
    for path in paths:
        with open(path, "rb") as file:
            data = file.read()
        try:
            print(f"{path}: task {accept(plan, data)}, ok")
        except Refused as reason:
            print(f"{path}: refused: {reason}")
            refused = 1
    return refused

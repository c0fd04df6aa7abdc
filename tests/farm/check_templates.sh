#!/bin/sh
# check_templates.sh - Deadline's job bundle gives the maps of a single run. OPENJD is the command of openjd-cli.
openjd=$(cd "$(dirname "${OPENJD:?is the command of openjd-cli}")" && pwd)/openjd || exit 1
python=$(dirname "$openjd")/python3
. "$(dirname "$0")/../cli/lib.sh"
PATH=$BIN:$PATH
export PATH
farm=$top/tools/farm
"$TESTS/generate-scan" --triangles 20000 --colors vase -o scan.obj
"$TESTS/generate-scan" --tiles 2 vase-low -o low.obj
options="--maps normal,height --size 96 --device cpu"
ok run bisque-voxelize scan.obj -o scan.nvdb --no-tris --resolution 128
ok run bisque-bake scan.nvdb low.obj -o 'one_<MAP>.<UDIM>.exr' $options

# words WORD...: runs a command, which must succeed.
words()
{
    command=$* code=0
    "$@" >"$out" 2>"$err" || code=$?
    check "$(basename "$1") ${2##*/}" $code
}

words "$openjd" check "$farm/deadline/template.yaml"
"$python" - "$farm/deadline" >values 2>"$err" <<'END'
import sys
import yaml
template, values, assets = (yaml.safe_load(open(f"{sys.argv[1]}/{name}.yaml"))
                            for name in ("template", "parameter_values", "asset_references"))
names = {p["name"] for p in template["parameterDefinitions"]}
assert set(assets["assetReferences"]) == {"inputs", "outputs", "referencedPaths"}
for p in values["parameterValues"]:
    assert p["name"] in names, p
    print("-p", f"{p['name']}={p['value']}", sep="\n")
END
check "the bundle's values are parameters of its template" $?
set --
while read -r word; do
    set -- "$@" "$word"
done <values
# The last value counts: small ones for a test.
words "$openjd" run "$farm/deadline/template.yaml" --step Merge --run-dependencies "$@" -p Parts=4 -p Resolution=128 \
    -p BakeOptions="$options"
for map in normal height; do
    for tile in 1001 1002; do
        same one_$map.$tile.exr maps/map_$map.$tile.exr
    done
done
finish

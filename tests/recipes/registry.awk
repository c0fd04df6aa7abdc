# registry.awk - prints mesh_format.h with the registry that formats/mesh/README.md shows.
# Usage: awk -f registry.awk README.md mesh_format.h
function goes_on() { return $0 ~ /\\$/ }
/^ *#define FMT_MESH_FORMATS\(ROW\)/ { inside = 1 }
inside && FNR == NR { shown = shown $0 "\n" }
inside && FNR != NR && !goes_on() { printf "%s", shown }
inside { inside = goes_on(); next }
FNR != NR

#!/bin/sh
# test_combine.sh - random scenes and options, each baked in many ways that must give the same bytes.
# LONG=1 draws other ones; SEED repeats a run; tests/combine/combine.py has further options.
. "$(dirname "$0")/lib.sh"

combine() # ARGUMENT...: what run() sets
{
    command="combine.py $*" code=0
    python3 -B "$top/tests/combine/combine.py" "$@" >"$out" 2>"$err" || code=$?
}

export BIN TESTS
trials=100
[ -z "${LONG-}" ] || trials=5000
sanitized && trials=$((trials / 10))
combine --seed "$(seed)" --trials $trials --keep "$TESTS/../combine-failures"
cat "$out"
code 0

# A program that does not keep the promise is found, and the commands that show it are few. What is
# tested is Python: sanitizers would find nothing.
if sanitized; then
    finish
    exit
fi
mkdir bin
cp "$BIN"/bisque-voxelize "$BIN"/bisque-simplify "$BIN"/bisque-compare bin
cat >bin/bisque-bake <<'SH'
#!/bin/sh
"$REAL/bisque-bake" "$@" || exit
case " $* " in *' --threads '* | *' --merge '*)
    for map in m_*; do [ ! -e "$map" ] || printf x >>"$map"; done ;;
esac
SH
chmod +x bin/bisque-bake
ln -s "$BIN/../lib" lib
REAL=$BIN BIN=$PWD/bin combine --seed 1 --trials 12
code 1
holds "a difference is named" grep -q '^other_threads: other files or bytes: m_' "$out"
holds "its commands are there" grep -q '^(cd other_threads && BSQ_SIMD=[^ ]* bisque-bake .* --threads ' "$out"
finish

# ---- documentation ----
.PHONY: doc
## doc: API documentation of the libraries in build/CONFIG/doc/html, with Doxygen
doc: deps-doc $(public_copies)
	@mkdir -p $(BUILD)/doc
	{ cat docs/Doxyfile; echo 'INPUT = docs/api.md $(public_copies)'; \
	    echo 'STRIP_FROM_PATH = $(BUILD)/include .'; echo 'PROJECT_NUMBER = $(VERSION)'; \
	    echo 'OUTPUT_DIRECTORY = $(BUILD)/doc'; } | doxygen -

# Takes the lines of `make -n` that compile one source.
compile_commands := [inputs | select(test(" -c \\S+ -o ")) | \
    {$$directory, command: ltrimstr("$(here) "), file: capture(" -c (?<file>\\S+) -o ").file}]
.PHONY: compile_commands.json
## compile_commands.json: how each source is compiled, for editors and clangd (needs jq)
compile_commands.json:
	@$(MAKE) --no-print-directory -Bn tests-build | \
	    jq -nR --arg directory '$(CURDIR)' '$(compile_commands)' > $@

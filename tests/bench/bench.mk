# bench.mk - builds and runs the benchmarks. Part of the Makefile.
BENCH ?= medium
bench_bins := $(addprefix $(BUILD)/tests/,measure baseline-embree)
$(BUILD)/tests/measure: $(BUILD)/obj/tests/bench/measure.c.o
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^
$(BUILD)/tests/baseline-embree: $(BUILD)/obj/tests/bench/baseline_embree.c.o
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^ -lembree3
rays_archives := $(archive.libbake) $(archive.formats) $(archive.base)
rays_bins := $(addprefix $(BUILD)/tests/,bench-maps bench-exact-rays tree-visits)
$(BUILD)/tests/bench-maps: $(BUILD)/obj/tests/bench/maps.c.o
$(BUILD)/tests/bench-exact-rays: $(BUILD)/obj/tests/bench/exact_rays.c.o
$(BUILD)/tests/tree-visits: $(BUILD)/obj/tests/bench/tree_visits.c.o
$(BUILD)/obj/tests/bench/tree_visits.c.o: $(BUILD)/gen/kernel_source.inc
$(rays_bins): $(patsubst %,$(BUILD)/obj/tests/bench/%.c.o,rays_scene rays_embree) $(rays_archives) \
    | $(helpers) $(BUILD)/tests/lib
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $(filter %.o,$^) $(rays_archives) $(LIBS.all) -lembree3

.PHONY: bench bench-build
bench-build: all $(generator) $(bench_bins)

## bench: compare stage 1 with Embree, BENCH=small, medium (default) or large
bench: deps
	@$(MAKE) --no-print-directory -j$(jobs) bench-build >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/stage1.py $(BENCH)

.PHONY: bench-maps
## bench-maps: compare the cost of maps, and secondary rays with Embree, BENCH=small or medium (default)
bench-maps: deps
	@$(MAKE) --no-print-directory -j$(jobs) all $(generator) $(rays_bins) >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/maps.sh $(BENCH)

.PHONY: bench-accuracy
## bench-accuracy: compare maps from voxels with exact maps, BENCH=small or medium (default)
bench-accuracy: deps
	@$(MAKE) --no-print-directory -j$(jobs) all $(generator) $(checkers) >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/accuracy.sh $(BENCH)

.PHONY: bench-blender
## bench-blender: compare maps, and the cost of whole jobs, with Blender's, BENCH=small or medium (default)
bench-blender: all $(generator) $(BUILD)/tests/measure
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/blender.sh
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/blender_job.sh $(BENCH)

simplify_venv := build/simplify-venv
$(simplify_venv)/ready: tests/bench/bench.mk
	@python3 -m venv $(simplify_venv) && $(simplify_venv)/bin/pip install -q \
	    fast_simplification==0.2.0 meshoptimizer==0.2.30a0 meshlib==3.1.4.297 open3d==0.20.0 pymeshlab==2025.7.post1 \
	    scikit-image==0.26.0 trimesh==5.2.0 scipy==1.17.1 numpy==2.4.6 pillow==13.0.0 && touch $@
# Lindstrom and Turk's method as CGAL has it, if its headers (libcgal-dev) are installed.
$(BUILD)/simplify_cgal: tests/bench/simplify_cgal.cpp
	@if [ -d /usr/include/CGAL ]; then $(CXX) -O2 -std=c++17 -DNDEBUG $< -lgmp -lmpfr -o $@; fi

.PHONY: bench-simplify
## bench-simplify: compare bisque-simplify with others from PyPI and CGAL, SCANS='a.obj b.obj' (default: generated)
bench-simplify: all $(generator) $(simplify_venv)/ready $(BUILD)/simplify_cgal
	@CGAL=$$(ls $(CURDIR)/$(BUILD)/simplify_cgal 2>/dev/null) BIN=$(BUILD)/bin TESTS=$(BUILD)/tests $(simplify_venv)/bin/python3 tests/bench/simplify.py $(SCANS)

.PHONY: bench-pace
## bench-pace: compare the core's speed with that of the commit PACE_REF=HEAD~1, in pairs
bench-pace: all $(generator)
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/pace.sh $(or $(PACE_REF),HEAD~1)

# The programs with their shared libraries, except those of C and C++, for machines that cannot
# build.
gpu_bundle := build/gpu
.PHONY: bench-gpu gpu-bundle
## bench-gpu: measure bakes on this machine's GPU beside the processor in at most 300 s, BENCH=small or full (default)
bench-gpu: gpu-bundle
	@tests/bench/gpu.sh $(if $(filter small,$(BENCH)),small,full)

## gpu-bundle: collect what bench-gpu and check-gpu need on a machine that cannot build, in build/gpu
gpu-bundle: $(bins) $(generator) $(helpers)
	rm -rf $(gpu_bundle)
	@mkdir -p $(gpu_bundle)/bin $(gpu_bundle)/lib/bisque
	cp $(filter-out $(helpers),$^) $(gpu_bundle)/bin
	cp $(helpers) $(gpu_bundle)/lib/bisque
	strip $(gpu_bundle)/bin/* $(gpu_bundle)/lib/bisque/*
	ldd $(gpu_bundle)/bin/* | awk '$$2 == "=>" && $$3 ~ /^\// { print $$3 }' | sort -u | \
	    grep -Ev '/(libc|libm|libdl|libpthread|librt|libgcc_s|libstdc[+][+])[.]so' | \
	    xargs -I LIB cp LIB $(gpu_bundle)/lib

.PHONY: bench-materials
## bench-materials: compare materials of assets and of SCANS='a.gltf b.glb' in Blender, BPY=python-with-bpy
bench-materials: $(venv)/installed
	@$(or $(BPY),python3) tests/bench/materials.py $(venv)/bin/bisque-asset $(OPTIONS) -- $(SCANS)

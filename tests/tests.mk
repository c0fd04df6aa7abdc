# tests.mk - builds and runs the tests. Part of the Makefile.
# tests/unit/LIB/ROOM/test_NAME.c becomes the cmocka program $(BUILD)/tests/LIB/test_NAME, so NAME
# is unique within a library. It links LIB and the libraries that LIB may include.
unit_sources := $(sort $(shell find tests/unit -name 'test_*.c' -o -name 'test_*.cc'))
unit_lib = $(word 3,$(subst /, ,$(1)))
unit_bin = $(BUILD)/tests/$(call unit_lib,$(1))/$(basename $(notdir $(1)))
unit_bins    := $(foreach s,$(unit_sources),$(call unit_bin,$(s)))
comma := ,
needs.base     := $(archive.base)
needs.formats  := $(archive.formats) $(archive.base)
needs.libvoxel := $(archive.libvoxel) $(archive.formats) $(archive.base)
needs.libbake  := $(archive.libbake) $(archive.formats) $(archive.base)
# These tests run jobs of both stages.
needs.exhaustion := $(archive.libvoxel) $(archive.libbake) $(archive.formats) $(archive.base)
needs.locale     := $(needs.exhaustion)
sanitizer_wraps := $(if $(filter asan tsan,$(config)),$(addprefix -Wl$(comma)--wrap=,malloc calloc \
    realloc pthread_create))
$(filter $(BUILD)/tests/exhaustion/%,$(unit_bins)): LDFLAGS += $(sanitizer_wraps)
# Helpers of a library's tests: the sources beside them whose names do not begin with test_, and for
# libbake those that write grids.
$(foreach l,base formats libvoxel libbake exhaustion,$(eval src.helpers.$(l) := $(filter-out \
    $(unit_sources),$(shell find tests/unit/$(l) -name '*.c')) \
    $(if $(filter libbake,$(l)),tests/unit/formats/grid/nvdb_scene.c))\
    $(eval helpers.$(l) := $(call objs,helpers.$(l))))
define unit_rule
$(call unit_bin,$(1)): $(BUILD)/obj/$(1).o $(needs.$(call unit_lib,$(1))) \
    $(helpers.$(call unit_lib,$(1))) \
    | $(if $(filter base,$(call unit_lib,$(1))),,$(module_files) $(helpers) $(BUILD)/tests/lib)
	@mkdir -p $$(@D)
	$$(CXX) $$(common) $$(LDFLAGS) -o $$@ $$(filter %.o,$$^) $(needs.$(call unit_lib,$(1))) -lcmocka \
	    $(if $(filter base,$(call unit_lib,$(1))),,$$(LIBS.formats) $$(LIBS.bake) $$(LIBS.tests)) \
	    $$(LIBS.base)
endef
$(foreach s,$(unit_sources),$(eval $(call unit_rule,$(s))))
# Libraries that some tests compare results with, or make files with.
LIBS.tests = $(LIBS.vdb) -lembree3 $(shell $(pkg_config) --libs libjpeg)
# Tests look for helpers in ../lib/bisque, as programs do.
$(BUILD)/tests/lib:
	@mkdir -p $(@D)
	ln -sfn ../lib $@

# The scan generator and the programs that check maps.
scan_objs = $(patsubst %,$(BUILD)/obj/tests/scan/%.c.o,$(1))
generator := $(BUILD)/tests/generate-scan
checkers  := $(addprefix $(BUILD)/tests/check-,vase tangent)
$(generator): $(call scan_objs,$(basename $(notdir $(wildcard tests/scan/generate*.c))) \
    mesh_writer text_writer vase)
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^ -lm
$(checkers): $(BUILD)/tests/check-%: $(call scan_objs,check_% verdict vase) $(archive.libbake) \
    $(archive.formats) $(archive.base)
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $^ $(LIBS.all)

# Drivers for tests: a CUDA driver without a GPU, an OpenCL driver that crashes, an OpenCL library
# that starts CUDA, and one whose devices are GPUs that fail.
fake_cuda := $(BUILD)/tests/fake/libcuda.so.1
$(fake_cuda): $(patsubst %.c,$(BUILD)/obj/%.c.o,$(wildcard tests/fake/fake_*.c))
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -shared -Wl,-soname,libcuda.so.1 -o $@ $^ -lm
crashing_driver := $(BUILD)/tests/fake/crashing_driver.so
$(crashing_driver): $(BUILD)/obj/tests/fake/crashing_driver.c.o
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -shared -o $@ $^

nvidia_opencl := $(BUILD)/tests/fake/nvidia/libOpenCL.so.1
$(nvidia_opencl): $(BUILD)/obj/tests/fake/nvidia_opencl.c.o
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -shared -Wl,-soname,libOpenCL.so.1 -o $@ $^ -ldl
fake_opencl := $(BUILD)/tests/fake/opencl/libOpenCL.so.1
$(fake_opencl): $(BUILD)/obj/tests/fake/opencl_gpu.c.o
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -shared -Wl,-soname,libOpenCL.so.1 -o $@ $^ -ldl
fakes := $(fake_cuda) $(crashing_driver) $(nvidia_opencl) $(fake_opencl)

examples := $(patsubst %.c,$(BUILD)/%,$(wildcard examples/*.c))
$(examples): $(BUILD)/%: %.c $(public_copies) $(archives)
	@mkdir -p $(@D)
	$(CC) -std=c99 -Wall -Wextra -Werror $(opt.$(config)) -I$(BUILD)/include $(LDFLAGS) -o $@ $< \
	    $(archive.libvoxel) $(archive.libbake) $(archive.formats) $(archive.base) \
	    $(LIBS.all) -pthread

# Says how Bisque's readers judge files, for the readers of tests/oracle.
read_files := $(BUILD)/tests/read-files
$(read_files): $(BUILD)/obj/tests/oracle/read_files.c.o $(archive.formats) $(archive.base)
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $^ $(LIBS.all)

# Gives damaged images to the code of bisque-tiff and bisque-texture.
damage_images := $(BUILD)/tests/damage-images
$(damage_images): $(patsubst %,$(BUILD)/obj/%.cc.o,tests/fuzz/damage_images \
    formats/texture/image_program) $(archive.formats) $(archive.base)
	@mkdir -p $(@D)
	$(CXX) $(common) $(LDFLAGS) -o $@ $^ $(LIBS.texture) $(LIBS.tiff) $(LIBS.all)

# Fuzz targets: tests/fuzz/fuzz_NAME.c with seeds in tests/fuzz/corpus/NAME; fuzz.NAME lists further
# objects. Without config=fuzz they become programs that replay files.
fuzz_sources := $(filter-out tests/fuzz/fuzz_file.c,$(wildcard tests/fuzz/fuzz_*.c))
fuzz_names   := $(fuzz_sources:tests/fuzz/fuzz_%.c=%)
fuzz_objs  := $(patsubst %,$(BUILD)/obj/tests/fuzz/%.c.o,fuzz_file memory_files)
# Calls that memory_files.c may answer itself.
fuzz_wrap  := $(patsubst %,-Wl$(comma)--wrap=%,open64 close fcntl64 stat64 fstat64 pread64 pwrite64 \
    opendir pthread_create)
fuzz.nvdb  := $(patsubst %,$(BUILD)/obj/tests/%.c.o,fuzz/grid_patch fuzz/grid_use \
    unit/formats/grid/nvdb_scene)
fuzz.overwritten := $(fuzz.nvdb)
fuzz.tris  := $(BUILD)/obj/tests/fuzz/tris_mend.c.o
fuzz.scan  := $(fuzz.tris)
fuzz.obj   := $(BUILD)/obj/tests/fuzz/mesh_check.c.o
fuzz.ply   := $(fuzz.obj)
fuzz.stl   := $(fuzz.obj)
fuzz.gltf  := $(fuzz.obj)
fuzz.packed := $(fuzz.obj)
fuzz.compressed := $(BUILD)/obj/tests/fuzz/compressed_check.cc.o
fuzz_libs.compressed := $(LIBS.gltf)
fuzz_link.compressed := $(CXX)
fuzz_libs  := $(archive.libvoxel) $(archive.libbake) $(archive.formats) $(archive.base)
.SECONDEXPANSION:
replays    := $(fuzz_names:%=$(BUILD)/tests/replay-%)
$(replays): $(BUILD)/tests/replay-%: $(BUILD)/obj/tests/fuzz/fuzz_%.c.o $(fuzz_objs) $$(fuzz.$$*) \
    $(BUILD)/obj/tests/fuzz/replay.c.o $(fuzz_libs)
	@mkdir -p $(@D)
	$(or $(fuzz_link.$*),$(CC)) $(common) $(LDFLAGS) $(fuzz_wrap) -o $@ $^ $(LIBS.all) \
	    $(fuzz_libs.$*)
$(BUILD)/tests/fuzz-%: $(BUILD)/obj/tests/fuzz/fuzz_%.c.o $(fuzz_objs) $$(fuzz.$$*) $(fuzz_libs)
	@mkdir -p $(@D)
	$(or $(fuzz_link.$*),$(CC)) $(common) -fsanitize=fuzzer $(LDFLAGS) $(fuzz_wrap) -o $@ $^ \
	    $(LIBS.all) $(fuzz_libs.$*)

# A library that lets a program's system calls fail, and the program that runs it; see
# tests/cli/test_faults.sh. Built without sanitizers, as it is loaded into programs without them.
faults := $(BUILD)/tests/faults.so $(BUILD)/tests/torture $(BUILD)/tests/no-sockets
$(BUILD)/tests/faults.so: tests/faults/faults.c tests/faults/fault.c tests/faults/fault.h
	@mkdir -p $(@D)
	$(CC) -std=c11 -D_GNU_SOURCE -I. $(WARN) -O1 -g -fPIC -shared -o $@ $(filter %.c,$^) -ldl
$(BUILD)/tests/torture $(BUILD)/tests/no-sockets: $(BUILD)/tests/%: tests/faults/%.c
	@mkdir -p $(@D)
	$(CC) -std=c11 -D_GNU_SOURCE $(WARN) -O1 -g -o $@ $<
# The programs once more, with the calls that checks.c counts.
counted      := $(addprefix $(BUILD)/tests/bin/,$(programs))
counted_objs := $(patsubst %,$(BUILD)/obj/tests/faults/%.c.o,checks fault)
$(counted): LDFLAGS += $(patsubst %,-Wl$(comma)--wrap=%,bsq_check bsq_progress_begin)
$(counted): | $(BUILD)/tests/lib
$(foreach p,$(programs:bisque-%=%),$(eval $(call program,$(p),tests/bin,$(counted_objs))))

# bisque-voxelize with a mesh reader that was added as formats/mesh/README.md says.
recipe        := $(BUILD)/obj/recipe
recipe_header := $(recipe)/formats/mesh/mesh_format.h
recipe_objs   := $(recipe)/mesh_reader.o $(recipe)/off.o
$(recipe_header): tests/recipes/registry.awk formats/mesh/README.md formats/mesh/mesh_format.h
	@mkdir -p $(@D)
	awk -f $^ >$@
$(recipe)/mesh_reader.o: formats/mesh/mesh_reader.c
$(recipe)/off.o: tests/recipes/off.c
$(recipe_objs): $(recipe_header)
	$(CC) -I$(recipe) $(CPPFLAGS) $(CFLAGS) -c -o $@ $(filter %.c,$^)
$(BUILD)/tests/recipe/bisque-voxelize: | $(BUILD)/tests/lib
$(eval $(call program,voxelize,tests/recipe,$(recipe_objs)))

fuzz_seconds ?= 60
fuzz_options ?= -max_total_time=$(fuzz_seconds)
.PHONY: $(fuzz_names:%=fuzz-%) fuzz-all fuzz-all-build fuzz-merge
## fuzz-NAME: fuzz a target of tests/fuzz for fuzz_seconds=60: obj, ply, stl, mtl, tris, nvdb, …
$(fuzz_names:%=fuzz-%): fuzz-%:
	@$(MAKE) --no-print-directory config=fuzz build/fuzz/tests/fuzz-$*
	tests/fuzz/run_all.sh '$(fuzz_options)' 1 $*

## fuzz-all: all targets for fuzz_seconds=60 each; inputs that fail are in build/fuzz/failures
fuzz-all:
	@$(MAKE) --no-print-directory -j$(jobs) config=fuzz fuzz-all-build
	tests/fuzz/run_all.sh '$(fuzz_options)' $(jobs) $(fuzz_names)
fuzz-all-build: $(fuzz_names:%=$(BUILD)/tests/fuzz-%)

## fuzz-merge: add what fuzzing found and reaches new code to tests/fuzz/corpus
fuzz-merge:
	@$(MAKE) --no-print-directory -j$(jobs) config=fuzz fuzz-all-build
	for name in $(fuzz_names); do mkdir -p build/fuzz/corpus/$$name; \
	    build/fuzz/tests/fuzz-$$name -merge=1 tests/fuzz/corpus/$$name build/fuzz/corpus/$$name \
	    2>&1 | tail -n 1; done

.PHONY: unit tests-build test check
## unit: build and run the unit tests only
unit: $(unit_bins) $(fakes)
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh $(unit_bins)

tests-build: all $(examples) $(unit_bins) $(generator) $(checkers) \
    $(read_files) $(damage_images) $(replays) $(fakes) $(faults) $(counted) \
    $(BUILD)/tests/recipe/bisque-voxelize

# The scripts take longest, so they start first.
## test: build and run all tests, with the packages that are installed
test: tests-build
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh $(sort $(wildcard tests/cli/test_*.sh)) \
	    $(unit_bins)

# Other tests start no threads, or only threads that these tests start too.
threaded_bins := $(filter $(patsubst %,$(BUILD)/tests/%,base/% formats/% libvoxel/% libbake/%), \
    $(unit_bins))
.PHONY: test-threads
## test-threads: the tests of parallel work; config=tsan finds races
test-threads: all $(threaded_bins) $(generator) $(fakes)
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh $(threaded_bins) tests/cli/test_threads.sh

## check: install missing packages, build, run all tests
check: deps
	@$(MAKE) --no-print-directory -j$(jobs) tests-build
	@$(MAKE) --no-print-directory test

# NVIDIA's assemblers and headers, of the last CUDA 12 and of the current CUDA, from PyPI. Each has
# a virtual environment, since their files have the same names.
ptx_tools := build/ptx-tools
pip_cuda12 := nvidia-cuda-nvcc-cu12 nvidia-cuda-runtime-cu12
pip_cuda13 := nvidia-cuda-nvcc nvidia-cuda-runtime nvidia-cuda-nvdisasm
$(ptx_tools)/%/installed:
	@rm -rf $(@D) && mkdir -p $(@D)
	@python3 -m venv $(@D) && $(@D)/bin/pip install --quiet $(pip_$*) && touch $@
nvcc_ptx := build/ptx/gen/kernel-nvcc.ptx
.PHONY: check-ptx
## check-ptx: assemble the kernel with NVIDIA's assemblers (from PyPI) and check the machine code
check-ptx: $(BUILD)/gen/kernel-$(PTX).ptx
	@if tests/install-packages.sh python3-venv && \
	    $(MAKE) -s $(patsubst %,$(ptx_tools)/%/installed,cuda12 cuda13); then \
	    $(MAKE) -s PTX=nvcc BUILD=build/ptx $(nvcc_ptx) \
	        ptx_nvcc="$$(find $(ptx_tools)/cuda13 -name nvcc -type f)" && \
	    tests/ptx/check.sh $(ptx_tools) $(filter-out %-nvcc.ptx,$<) $(nvcc_ptx); \
	else tests/skip.sh check-ptx "NVIDIA's assemblers cannot be installed"; fi

.PHONY: check-gpu
## check-gpu: all maps of this machine's NVIDIA GPU and OpenCL devices beside the processor's, byte by byte
check-gpu: gpu-bundle
	@tests/gpu/check_gpu.sh

# openjd-cli, in a virtual environment of the tests.
farm_venv := build/farm-venv
.PHONY: check-farm deps-farm
deps-farm:
	@tests/install-packages.sh slurm-wlm python3-venv
	@$(farm_venv)/bin/python3 -c 'import openjd.cli, yaml' 2>/dev/null || { \
	    python3 -m venv $(farm_venv) && \
	    $(farm_venv)/bin/pip install -q openjd-cli==0.8.0 pyyaml; }
## check-farm: bake in parts on a Slurm cluster on this machine, and with openjd
check-farm: tests-build deps-farm $(venv)/installed
	@OPENJD=$(farm_venv)/bin/openjd ASSET=$(venv)/bin BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh \
	    tests/farm/check_openjd.sh tests/farm/check_slurm.sh \
	    tests/farm/check_templates.sh

.PHONY: check-doors
## check-doors: look at reports in a headless Chromium (installs it), and bake from inside Blender if BPY
##                 names Pythons with the module bpy; pictures in build/doors
BPY ?= python3
check-doors: tests-build
	@for python in $(BPY); do \
	    if $$python -c 'import bpy' 2>/dev/null; then \
	        $(MAKE) -s extension && \
	        BPY=$$python EXTENSION=$(extension)/bisque.zip PICTURES=build/doors BIN=$(BUILD)/bin \
	            TESTS=$(BUILD)/tests tests/run.sh tests/doors/check_blender.sh || exit 1; \
	    else CI= tests/skip.sh "check-doors in Blender" "$$python has no module bpy (set BPY)"; fi; done
	@if tests/install-packages.sh chromium libjs-three; then \
	    BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh tests/doors/check_reports.sh; \
	else tests/skip.sh check-doors "chromium and libjs-three cannot be installed"; fi

.PHONY: check-gltf
## check-gltf: maps of the glTF files in models=FOLDER beside Blender's;
##             table and pictures in build/gltf
check-gltf: all
	@BIN=$(BUILD)/bin $(BPY) tests/cli/gltf_blender.py models \
	    $(or $(models),$(error models= names no folder)) build/gltf

trials ?= 5000
seed   ?= $(shell date +%Y%m%d)
.PHONY: check-combine
## check-combine: trials=5000 of random options of seed=TEXT, and the table of what was run
check-combine: tests-build
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests XDG_CACHE_HOME=$(CURDIR)/$(BUILD)/tests/cache \
	    python3 -B tests/combine/combine.py --seed $(seed) --trials $(trials) \
	    --keep $(BUILD)/combine-failures

# The tests that need no drivers and no limits of the system, which qemu does not emulate.
arm64 := aarch64-linux-gnu
emulated := build/$(arm64)-emulated
emulated_units := $(filter-out %/test_cuda %/test_devices, \
    $(filter $(patsubst %,$(BUILD)/tests/%,base/% formats/% libvoxel/% libbake/%),$(unit_bins)))
build/$(arm64)-sysroot/ready:
	@tests/cross/sysroot.sh $(@D) arm64 libc6-dev $(filter lib% zlib% opencl-c%,$(packages_build)) \
	    libcmocka-dev libembree-dev libnanovdb-dev && touch $@
.PHONY: check-arm64 unit-build
unit-build: $(unit_bins)
## check-arm64: compile for ARM64; unit tests, and the bytes of x86, under qemu-user (installs both)
check-arm64: all $(generator)
	@tests/install-packages.sh gcc-$(arm64) g++-$(arm64) qemu-user-static
	@$(MAKE) --no-print-directory build/$(arm64)-sysroot/ready
	@$(MAKE) --no-print-directory -j$(jobs) CROSS=$(arm64) all unit-build
	@tests/cross/emulate.sh build/$(arm64)-release build/$(arm64)-sysroot $(emulated)
	@NATIVE=$(BUILD)/bin BIN=$(emulated)/bin TESTS=$(emulated)/tests tests/run.sh \
	    tests/cross/check_bytes.sh $(emulated_units:$(BUILD)/%=$(emulated)/%)

## check-long: check, check-python, check-arm64, many more rounds of random tests, and one by the clock
.PHONY: check-long
check-long: check
	@LONG=1 $(MAKE) --no-print-directory check-python
	@$(MAKE) --no-print-directory check-arm64
	@LONG=1 BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh \
	    $(patsubst %,tests/cli/test_%.sh,combine farm faults gltf_materials images \
	    interrupt limits overwritten oracle reproducible) \
	    tests/recipes/check_map.sh $(BUILD)/tests/exhaustion/test_exhaustion \
	    $(BUILD)/tests/libvoxel/test_error

# ---- quality ----
sources_c := $(foreach l,$(libs),$(src.$(l))) $(src.helper) $(wildcard tools/*.c)
# The sources that .clang-format applies to.
formatted = $(sort $(shell find $(libs) tools tests $(wildcard examples) \
    -name '*.c' -o -name '*.h' -o -name '*.cc' -o -name '*.cl'))
# States that Clang's static analyzer visits in each function at most.
lint_nodes ?= 225000
.PHONY: lint format
## lint: check rooms, documents, names, formatting, cppcheck, clang-tidy (installs missing tools)
lint: deps-lint $(addprefix $(BUILD)/gen/,kernel_source.inc kernel_ptx.inc)
	tests/lint/rooms.sh
	tests/lint/documents.sh
	tests/lint/statics.sh
	clang-format --dry-run -Werror $(formatted)
	cppcheck --quiet -j $(jobs) --std=c11 --enable=warning,performance,portability --inline-suppr \
	    --suppress=missingIncludeSystem --error-exitcode=1 -I. -I$(BUILD)/gen \
	    -D__x86_64__ $(filter %.c,$(sources_c))
	printf '%s\n' $(filter %.c,$(sources_c)) | xargs -P $(jobs) -I FILE clang-tidy --quiet FILE -- \
	    -std=c11 $(CPPFLAGS) $(formats_cppflags) $(directory_cppflags) $(stamp_cppflags) \
	    -Xclang -analyzer-config -Xclang max-nodes=$(lint_nodes)

## format: format all sources with clang-format
format: deps-lint
	clang-format -i $(formatted)

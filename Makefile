# The only build of Bisque. `make help` lists the targets; config=release, debug, asan, tsan, fuzz.
# base/version.h has the version's three numbers.
VERSION := $(shell awk '/define BSQ_VERSION_M|define BSQ_VERSION_P/ { v = v d $$3; d = "." } \
    END { print v }' base/version.h)
config  ?= release
BUILD   ?= build/$(config)
prefix  ?= /usr/local
libdir  ?= $(prefix)/lib
DESTDIR ?=

ifeq ($(config),fuzz)
CC  := clang
CXX := clang++
endif

# All x86 processors since 2009 have x86-64-v2; faster code is chosen at run time.
ARCH ?= $(if $(filter x86_64,$(shell uname -m)),-march=x86-64-v2)
# psabi: without AVX, vectors of eight floats are passed in another way than before GCC 4.6; all
# functions that take them are inlined (base/simd/eights.h).
WARN := -Wall -Wextra -Wshadow -Wpointer-arith -Wstrict-prototypes -Wmissing-prototypes -Wvla \
    -Wno-psabi
opt.release := -O3 -g
opt.debug   := -O0 -g3
opt.asan    := -O1 -g1 -fsanitize=address,undefined,float-cast-overflow -fno-omit-frame-pointer \
    -fno-sanitize-recover=all
opt.tsan    := -O1 -g -fsanitize=thread
opt.fuzz    := -O2 -g -fsanitize=fuzzer-no-link,address,undefined,float-cast-overflow \
    -fno-sanitize-recover=all -DFUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION \
    -fsanitize-coverage-ignorelist=tests/fuzz/no_coverage.txt
ifndef opt.$(config)
$(error config=$(config) is not one of release, debug, asan, tsan, fuzz)
endif

# No contraction and no fast math: results are the same on each device and with each compiler.
CPPFLAGS += -I. -I$(BUILD)/gen -D_GNU_SOURCE -D_FILE_OFFSET_BITS=64
common   := $(opt.$(config)) $(ARCH) -ffp-contract=off -fno-math-errno -fPIC -pthread -MMD -MP
CFLAGS   += -std=c11 $(WARN) $(common)
CXXFLAGS += -std=c++17 -Wall -Wextra $(common)
# A program loads only the shared libraries that it calls.
LDFLAGS  += -Wl,--as-needed

pc_formats := OpenEXR libpng libxxhash jansson libisal libzstd libdeflate
pc_texture := OpenImageIO Imath libpng libjpeg
pc_tools   := jansson
# Expanded only when something is compiled: `make help` and `make deps` work without the packages.
formats_cppflags = $(shell pkg-config --cflags $(pc_formats) $(pc_texture))
LIBS.base    := -lm
LIBS.formats  = $(shell pkg-config --libs $(pc_formats)) -lz
LIBS.texture  = $(shell pkg-config --libs $(pc_texture))
LIBS.gltf     = -ldraco -lmeshoptimizer
LIBS.scene    = -lassimp
LIBS.openvdb  = -lopenvdb -ltbb $(shell pkg-config --libs Imath)
LIBS.bake     = -ldl $(LIBS.tools)
LIBS.all      = $(LIBS.formats) $(LIBS.bake) $(LIBS.base)
LIBS.tools    = $(shell pkg-config --libs $(pc_tools))

libs := base formats libvoxel libbake
# A library is a folder; its subfolders are its rooms.
# The helper is a program of its own.
src.helper := libbake/device/helper/bisque-devices.c
$(foreach l,$(libs),$(eval src.$(l) := $(filter-out $(src.helper),$(sort $(shell find $(l) \
    -name '*.c')))))
objs = $(patsubst %,$(BUILD)/obj/%.o,$(src.$(1))) \
    $(foreach s,$(simd),$(patsubst %,$(BUILD)/obj/%.$(s).o,$(filter %_lanes.c,$(src.$(1)))))
archive.base     := $(BUILD)/lib/libbisque-base.a
archive.formats  := $(BUILD)/lib/libbisque-formats.a
archive.libvoxel := $(BUILD)/lib/libbisque-voxel.a
archive.libbake  := $(BUILD)/lib/libbisque-bake.a
archives := $(foreach l,$(libs),$(archive.$(l)))

# Parts of formats that are opened at their first use, see formats/module/module.h. The stamp holds
# the version and a checksum of the headers that a module shares with its host.
modules      := texture openvdb gltf scene
src.texture  := $(addprefix formats/texture/,texture_oiio.cc texture_pass.cc texture_lookup.cc \
    texture_pyramid.cc held_input.cc texture_formats.cc jpeg_check.c png_rows.c) \
    formats/exr_header.c
src.gltf     := formats/mesh/gltf_decode.cc
src.scene    := formats/mesh/scene_assimp.cc
src.openvdb  := formats/grid/vdb_export_openvdb.cc base/octahedral.c
module_stamp := formats/module/module_stamp.c
$(foreach m,$(modules),$(eval src.$(m) += $(module_stamp)))
module_files := $(modules:%=$(BUILD)/lib/bisque/bisque-%.so)
module_headers  := $(addprefix base/,version.h context.h file.h file_part.h output.h \
    parallel.h) \
    $(addprefix formats/,module/module.h mesh/gltf_module.h mesh/scene_module.h \
    $(addprefix grid/,nvdb.h nvdb_layout_internal.h vdb_module.h) \
    texture/texture.h texture/texture_module.h)
directory_cppflags = -DFMT_MODULE_DIRECTORY='"$(prefix)/lib/bisque"'
stamp_cppflags = \
    -DFMT_MODULE_STAMP='"$(VERSION)-$(firstword $(shell cat $(module_headers) | cksum))"'

programs := bisque-voxelize bisque-bake bisque-compare
bins     := $(addprefix $(BUILD)/bin/,$(programs))
# Asks drivers for their devices; installed beside the modules and found like them.
helper   := $(BUILD)/lib/bisque/bisque-devices

.PHONY: all
## all: build the libraries, modules and programs (default), into build/$(config)/
all: $(archives) $(module_files) $(helper) $(bins)

# Debug information names the folder of the sources. With this name, builds in different folders have
# the same bytes; debuggers find the sources if they are started there.
here := PWD=/proc/self/cwd

$(BUILD)/obj/%.c.o: %.c
	@mkdir -p $(@D)
	$(here) $(CC) $(CPPFLAGS) $(cppflags.$(firstword $(subst /, ,$<))) $(CFLAGS) -c $< -o $@
$(BUILD)/obj/%.cc.o: %.cc
	@mkdir -p $(@D)
	$(here) $(CXX) $(CPPFLAGS) $(cppflags.$(firstword $(subst /, ,$<))) $(CXXFLAGS) -c $< -o $@
$(BUILD)/obj/formats/module/module_directory.c.o: CPPFLAGS += $(directory_cppflags)
$(BUILD)/obj/$(module_stamp).o: CPPFLAGS += $(stamp_cppflags)
$(BUILD)/obj/$(module_stamp).o: $(module_headers)
# Fused operations would change results. -ffp-contract=off already prevents them, and with -mno-fma
# Clang would drop AVX-512, so only GCC gets it.
no_fma := $(if $(findstring clang,$(shell $(CC) --version 2>/dev/null)),,-mno-fma)
# Sources named *_lanes.c are also compiled for each of these instruction sets; base/simd/simd.h
# chooses at run time.
ifneq ($(filter x86_64,$(shell uname -m)),)
simd := avx2 avx512
endif
simd.avx2   := -DBSQ_SIMD_SUFFIX=avx2 -mavx2 -mbmi -mbmi2 -mlzcnt $(no_fma)
simd.avx512 := -DBSQ_SIMD_SUFFIX=avx512 -mavx512f -mavx512vl -mavx512dq -mavx512bw -mbmi -mbmi2 \
    -mlzcnt $(no_fma)
# counted/ holds objects with the kernel's counters.
define simd_rule
$(BUILD)/$(2)/%_lanes.c.$(1).o: %_lanes.c
	@mkdir -p $$(@D)
	$(here) $$(CC) $$(CPPFLAGS) $$(cppflags.$$(firstword $$(subst /, ,$$<))) $$(CFLAGS) $$(simd.$(1)) -c $$< \
	    -o $$@
endef
$(foreach s,$(simd),$(foreach d,obj counted,$(eval $(call simd_rule,$(s),$(d)))))
$(BUILD)/counted/%.o: CPPFLAGS += -DBK_COUNTERS
$(foreach s,native tree_rays tree_voxels,$(patsubst \
    %,$(BUILD)/%/libbake/device/native/$(s)_lanes.c.avx512.o,obj counted)): CFLAGS += \
    -mprefer-vector-width=512
cppflags.formats = $(formats_cppflags)
cppflags.tests   = $(formats_cppflags)
# Two sources hold much of OpenVDB and NanoVDB as templates. With all sanitizers each takes a minute
# and a half to compile. The test's own code needs no checks, and no speed.
$(BUILD)/obj/formats/grid/vdb_export_openvdb.cc.o: CXXFLAGS += \
    -fno-sanitize=undefined,float-cast-overflow
$(BUILD)/obj/tests/unit/formats/grid/test_nvdb_reader.cc.o: CXXFLAGS += -O0 -fno-sanitize=all

define archive_rule
$(archive.$(1)): $$(call objs,$(1))
	@mkdir -p $$(@D)
	rm -f $$@ && $$(AR) rcsD $$@ $$^
endef
$(foreach l,$(libs),$(eval $(call archive_rule,$(l))))

# Linking fails if a module calls a function that its host's table does not have. Clang resolves its
# sanitizers' functions in the program, so config=fuzz cannot check this.
no_undefined := $(if $(filter fuzz,$(config)),,-Wl,-z,defs)
define module_rule
$(BUILD)/lib/bisque/bisque-$(1).so: $$(call objs,$(1)) formats/module/module.map
	@mkdir -p $$(@D)
	$$(CXX) $$(common) $$(LDFLAGS) -shared $(no_undefined) \
	    -Wl,--version-script=formats/module/module.map -o $$@ $$(filter %.o,$$^) $$(LIBS.$(1))
endef
$(foreach m,$(modules),$(eval $(call module_rule,$(m))))

# The kernel's source as an array in the library; OpenCL compiles it at run time.
kernel_sources := $(wildcard libbake/kernel/*.h libbake/kernel/*.cl)
$(BUILD)/gen/kernel_source.inc: libbake/kernel/embed.awk $(kernel_sources)
	@mkdir -p $(@D)
	awk -f libbake/kernel/embed.awk libbake/kernel/bake.cl > $@
$(call objs,libbake): | $(BUILD)/gen/kernel_source.inc $(BUILD)/gen/kernel_ptx.inc

# The kernel for NVIDIA GPUs, as PTX. Clang is preferred to nvcc: older drivers accept its PTX.
# Without both, or if the PTX would round differently from the processor, the program has no CUDA.
ptx_clang := $(shell for c in clang clang-21 clang-20 clang-19 clang-18 clang-17 clang-16 clang-15 \
    clang-14; do \
    command -v $$c && break; done)
ptx_nvcc  := $(firstword $(shell command -v nvcc) $(wildcard /usr/local/cuda/bin/nvcc))
PTX ?= $(if $(ptx_clang),clang,$(if $(ptx_nvcc),nvcc,none))
ptx.clang = $(ptx_clang) -x cl -cl-std=CL1.2 --target=nvptx64-nvidia-cuda -Xclang -target-cpu \
    -Xclang sm_50 -DBK_PTX -O3 -mllvm -unroll-threshold=3000 -ffp-contract=off \
    -cl-fp32-correctly-rounded-divide-sqrt -S -o $@.tmp $<
# nvcc writes the version of PTX that its own CUDA has, which older drivers refuse. The kernel needs
# nothing after 7.0, the version of CUDA 11.0; the assembler beside nvcc checks that.
ptx.nvcc  = $(ptx_nvcc) -x cu -ptx -arch=compute_75 -O3 --fmad=false -prec-div=true \
    -prec-sqrt=true -ftz=false -o $@.new $< && \
    sed 's/^\.version .*/.version 7.0/' $@.new > $@.tmp && \
    { $(dir $(ptx_nvcc))ptxas -arch=sm_75 -o /dev/null $@.tmp || cp $@.new $@.tmp; }
ptx.none  = false
$(BUILD)/gen/kernel-$(PTX).ptx: libbake/kernel/bake.cl libbake/kernel/check_ptx.awk \
    $(kernel_sources)
	@mkdir -p $(@D)
	@{ $(ptx.$(PTX)) && awk -f libbake/kernel/check_ptx.awk $@.tmp && mv $@.tmp $@; } || \
	    { echo "libbake: no PTX, so --device cuda will not work (PTX=$(PTX))"; : > $@; }; \
	    rm -f $@.new $@.tmp
$(BUILD)/gen/kernel_ptx.inc: $(BUILD)/gen/kernel-$(PTX).ptx libbake/kernel/embed.awk
	{ awk -f libbake/kernel/embed.awk $< && echo '""'; } > $@

# A checksum of all sources that a chunk file or a grid may depend on, see libvoxel/job_record.c and
# libvoxel/farm/farm_plan.c.
chunk_sources := $(sort $(shell find base formats libvoxel -name '*.c' -o -name '*.cc' \
    -o -name '*.h'))
$(BUILD)/gen/chunk_sources.inc: $(chunk_sources) Makefile
	@mkdir -p $(@D)
	cat $(chunk_sources) | cksum | awk '{ printf "\"%08x\"\n", $$1 }' > $@
$(patsubst %,$(BUILD)/obj/libvoxel/%.c.o,job_record farm/farm_plan): \
    $(BUILD)/gen/chunk_sources.inc

# The same of all sources that the maps of a plan may depend on, see libbake/farm/farm_plan.c.
bake_sources := $(sort $(shell find base formats libbake -name '*.c' -o -name '*.cc' \
    -o -name '*.h' -o -name '*.cl'))
$(BUILD)/gen/bake_sources.inc: $(bake_sources) Makefile
	@mkdir -p $(@D)
	cat $(bake_sources) | cksum | awk '{ printf "\"%08x\"\n", $$1 }' > $@
$(BUILD)/obj/libbake/farm/farm_plan.c.o: $(BUILD)/gen/bake_sources.inc

# A program is made of tools/bisque-NAME.c, tools/NAME_*.c and tools/cli*.c.
define program
$(BUILD)/bin/bisque-$(1): $(patsubst %,$(BUILD)/obj/%.o,tools/bisque-$(1).c \
    $(wildcard tools/$(1)_*.c tools/cli*.c)) $(archives)
	@mkdir -p $$(@D)
	$$(CC) $$(common) $$(LDFLAGS) -o $$@ $$(filter %.o,$$^) $(archive.libvoxel) $(archive.libbake) \
	    $(archive.formats) $(archive.base) $$(LIBS.tools) $$(LIBS.all)
endef
$(foreach p,$(programs:bisque-%=%),$(eval $(call program,$(p))))

$(helper): $(BUILD)/obj/$(src.helper).o $(archives)
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $< $(archive.libbake) $(archive.formats) $(archive.base) \
	    $(LIBS.all)

# ---- tests ----
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
# These tests run jobs of both stages and let memory and threads run out.
needs.exhaustion := $(archive.libvoxel) $(archive.libbake) $(archive.formats) $(archive.base)
sanitizer_wraps := $(if $(filter asan tsan,$(config)),$(addprefix -Wl$(comma)--wrap=,malloc calloc \
    realloc pthread_create))
$(filter $(BUILD)/tests/exhaustion/%,$(unit_bins)): LDFLAGS += $(sanitizer_wraps)
# Helpers of a library's tests: the sources beside them whose names do not begin with test_.
$(foreach l,base formats libvoxel libbake exhaustion,$(eval src.helpers.$(l) := $(filter-out \
    $(unit_sources),$(shell find tests/unit/$(l) -name '*.c')))\
    $(eval helpers.$(l) := $(call objs,helpers.$(l))))
define unit_rule
$(call unit_bin,$(1)): $(BUILD)/obj/$(1).o $(needs.$(call unit_lib,$(1))) \
    $(helpers.$(call unit_lib,$(1))) \
    | $(if $(filter base,$(call unit_lib,$(1))),,$(module_files) $(BUILD)/tests/lib) \
    $(if $(filter libbake exhaustion,$(call unit_lib,$(1))),$(helper))
	@mkdir -p $$(@D)
	$$(CXX) $$(common) $$(LDFLAGS) -o $$@ $$(filter %.o,$$^) $(needs.$(call unit_lib,$(1))) -lcmocka \
	    $(if $(filter base,$(call unit_lib,$(1))),,$$(LIBS.formats) $$(LIBS.bake) $$(LIBS.tests)) \
	    $$(LIBS.base)
endef
$(foreach s,$(unit_sources),$(eval $(call unit_rule,$(s))))
# Libraries that some tests compare results with, or make files with.
LIBS.tests = $(LIBS.openvdb) -lembree3 $(shell pkg-config --libs libjpeg)
# Tests look for modules in ../lib/bisque, as programs do.
$(BUILD)/tests/lib:
	@mkdir -p $(@D)
	ln -sfn ../lib $@

# The scan generator and the programs that check maps.
scan_objs = $(patsubst %,$(BUILD)/obj/tests/scan/%.c.o,$(1))
generator := $(BUILD)/tests/generate-scan
checkers  := $(addprefix $(BUILD)/tests/check-,vase mesh tangent)
$(generator): $(call scan_objs,$(basename $(notdir $(wildcard tests/scan/generate*.c))) \
    mesh_writer text_writer vase)
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^ -lm
$(checkers): $(BUILD)/tests/check-%: $(call scan_objs,check_% verdict vase) $(archive.libbake) \
    $(archive.formats) $(archive.base) | $(module_files)
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $^ $(LIBS.all)

# Drivers for tests: a CUDA driver without a GPU, an OpenCL driver that crashes, an OpenCL library
# that starts CUDA, and one whose devices are GPUs that fail.
fake_cuda := $(BUILD)/tests/fake/libcuda.so.1
$(fake_cuda): $(patsubst %.c,$(BUILD)/obj/%.c.o,$(wildcard tests/fake/fake_*.c tests/fake/ptx_*.c))
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

# A folder with the installed headers and no others, for examples/ and `make doc`.
public_headers := base/version.h base/context.h base/loss.h base/options.h libvoxel/voxel.h libbake/bake.h libbake/compare.h
public_copies  := $(public_headers:%=$(BUILD)/include/%)
$(public_copies): $(BUILD)/include/%: %
	@install -D -m 644 $< $@
examples := $(patsubst %.c,$(BUILD)/%,$(wildcard examples/*.c))
$(examples): $(BUILD)/%: %.c $(public_copies) $(archives)
	@mkdir -p $(@D)
	$(CC) -std=c99 -Wall -Wextra -Werror $(opt.$(config)) -I$(BUILD)/include $(LDFLAGS) -o $@ $< \
	    $(archive.libvoxel) $(archive.libbake) $(archive.formats) $(archive.base) \
	    $(LIBS.all) -pthread

# Naive readers, written from formats/FORMATS.md. Without -I they cannot include Bisque's headers.
naive := $(BUILD)/tests/naive-read-tris $(BUILD)/tests/naive-read-nvdb
$(naive): $(BUILD)/tests/naive-read-%: tests/naive/read_%.c tests/naive/bytes.h
	@mkdir -p $(@D)
	$(CC) -std=c11 $(WARN) $(opt.$(config)) -o $@ $< -lxxhash -lm
xxh3 := $(BUILD)/tests/xxh3
$(xxh3): tests/naive/xxh3.c
	@mkdir -p $(@D)
	$(CC) -std=c11 $(WARN) $(opt.$(config)) -o $@ $< -lxxhash

# Says how Bisque's readers judge files, for the readers of tests/oracle.
read_files := $(BUILD)/tests/read-files
$(read_files): $(BUILD)/obj/tests/oracle/read_files.c.o $(archive.formats) $(archive.base)
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $^ $(LIBS.all)

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
fuzz.assimp := $(BUILD)/obj/tests/fuzz/scene_check.cc.o
fuzz_libs.assimp := $(LIBS.scene)
fuzz_link.assimp := $(CXX)
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
$(BUILD)/tests/faults.so: tests/faults/faults.c
	@mkdir -p $(@D)
	$(CC) -std=c11 -D_GNU_SOURCE $(WARN) -O1 -g -fPIC -shared -o $@ $< -ldl
$(BUILD)/tests/torture $(BUILD)/tests/no-sockets: $(BUILD)/tests/%: tests/faults/%.c
	@mkdir -p $(@D)
	$(CC) -std=c11 -D_GNU_SOURCE $(WARN) -O1 -g -o $@ $<

fuzz_seconds ?= 60
.PHONY: $(fuzz_names:%=fuzz-%) fuzz-all fuzz-all-build fuzz-merge
## fuzz-NAME: fuzz a target of tests/fuzz for fuzz_seconds=60: obj, ply, stl, mtl, tris, nvdb, …
$(fuzz_names:%=fuzz-%): fuzz-%:
	@$(MAKE) --no-print-directory config=fuzz build/fuzz/tests/fuzz-$*
	tests/fuzz/run_all.sh $(fuzz_seconds) 1 $*

## fuzz-all: all targets for fuzz_seconds=60 each; inputs that fail are in build/fuzz/failures
fuzz-all:
	@$(MAKE) --no-print-directory -j$(jobs) config=fuzz fuzz-all-build
	tests/fuzz/run_all.sh $(fuzz_seconds) $(jobs) $(fuzz_names)
fuzz-all-build: $(fuzz_names:%=$(BUILD)/tests/fuzz-%)

## fuzz-merge: add what fuzzing found and reaches new code to tests/fuzz/corpus
fuzz-merge:
	@$(MAKE) --no-print-directory -j$(jobs) config=fuzz fuzz-all-build
	for name in $(fuzz_names); do mkdir -p build/fuzz/corpus/$$name; \
	    build/fuzz/tests/fuzz-$$name -merge=1 tests/fuzz/corpus/$$name build/fuzz/corpus/$$name \
	    2>&1 | tail -n 1; done

.PHONY: unit tests-build test check
## unit: build and run the unit tests only
unit: $(unit_bins) $(module_files) $(fakes)
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh $(unit_bins)

tests-build: all $(examples) $(unit_bins) $(generator) $(checkers) $(naive) $(xxh3) \
    $(read_files) $(replays) $(fakes) $(faults)

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
	else echo "check-ptx: skipped, NVIDIA's assemblers cannot be installed"; fi

# openjd-cli in a virtual environment of the tests.
farm_venv := build/farm-venv
.PHONY: check-farm deps-farm
deps-farm:
	@tests/install-packages.sh slurm-wlm python3-venv
	@[ -x $(farm_venv)/bin/openjd ] || { python3 -m venv $(farm_venv) && \
	    $(farm_venv)/bin/pip install -q openjd-cli==0.8.0; }
## check-farm: bake in tasks on a Slurm cluster on this machine, and with openjd (installs both)
check-farm: tests-build deps-farm
	@OPENJD=$(farm_venv)/bin/openjd BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh \
	    tests/farm/check_openjd.sh tests/farm/check_slurm.sh

.PHONY: bench-farm
## bench-farm: processor time of bakes and grids in 1 to 64 tasks beside that of a single run
bench-farm: all $(generator)
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/farm.sh
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/farm_grid.sh

## check-long: check, and many more rounds of the randomized tests
.PHONY: check-long
check-long: check
	@LONG=1 BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh \
	    $(patsubst %,tests/cli/test_%.sh,faults overwritten oracle reproducible) \
	    $(BUILD)/tests/exhaustion/test_exhaustion

# ---- packages ----
packages_build := gcc g++ pkg-config libopenvdb-dev libboost-dev libopenexr-dev libopenimageio-dev \
    libpng-dev libjpeg62-turbo-dev libjansson-dev libdraco-dev libmeshoptimizer-dev libassimp-dev \
    libxxhash-dev zlib1g-dev libdeflate-dev libisal-dev libzstd-dev opencl-c-headers
packages_test  := libcmocka-dev libembree-dev libnanovdb-dev libnanovdb-tools pocl-opencl-icd \
    ocl-icd-libopencl1 jq mandoc python3 python3-numpy python3-xxhash
# Compiles the kernel for NVIDIA GPUs. Without it the build has no CUDA.
packages_cuda  := $(if $(ptx_clang)$(ptx_nvcc),,clang)
packages := $(packages_build) $(packages_test)
packages_fuzz := clang libclang-rt-14-dev
packages_lint := cppcheck clang-tidy clang-format
packages_doc  := doxygen
packages_deb  := build-essential debhelper dpkg-dev clang
jobs ?= $(shell nproc)

.PHONY: deps deps-lint deps-doc deps-fuzz deps-deb
## deps: install missing Debian packages (with sudo if needed)
deps:
	@tests/install-packages.sh $(packages)
	@tests/install-packages.sh $(packages_cuda) || echo \
	    "deps: continues without clang; the programs will have no CUDA"

deps-lint:
	@tests/install-packages.sh $(packages_lint)
deps-doc:
	@tests/install-packages.sh $(packages_doc)
deps-deb:
	@tests/install-packages.sh $(packages_build) $(packages_deb)
# For the control file of Debian packages, whose builds always have the compilers.
.PHONY: print-packages
print-packages:
	@echo $(filter-out gcc g++,$(packages_build))
# Any clang that has its fuzzer will do.
deps-fuzz:
	@echo 'int LLVMFuzzerTestOneInput(void) { return 0; }' | \
	    clang -fsanitize=fuzzer,address -x c -o /dev/null - 2>/dev/null || \
	    tests/install-packages.sh $(packages_fuzz)

# ---- demo ----
demo_dir ?= demo
.PHONY: demo demo-maps
## demo: install, build, generate a scan of 2 million triangles and bake its maps
demo: deps
	@$(MAKE) --no-print-directory -j$(jobs) all $(generator)
	@$(MAKE) --no-print-directory demo-maps

demo-maps: all $(generator)
	@mkdir -p $(demo_dir)
	$(generator) --triangles 2000000 --colors vase -o $(demo_dir)/vase.obj
	$(generator) vase-low -o $(demo_dir)/vase_low.obj
	$(BUILD)/bin/bisque-voxelize $(demo_dir)/vase.obj -o $(demo_dir)/vase.nvdb
	$(BUILD)/bin/bisque-bake $(demo_dir)/vase.nvdb $(demo_dir)/vase_low.obj \
	    --maps normal,color,mask --preview $(demo_dir)/preview.png -o '$(demo_dir)/vase_<MAP>.exr'
	$(BUILD)/bin/bisque-bake $(demo_dir)/vase.nvdb $(demo_dir)/vase_low.obj --size 1024 \
	    --samples 1 --maps height,ao,curvature --ao-rays 16 -o '$(demo_dir)/vase_<MAP>.png'
	$(generator) --tiles 2 vase-low -o $(demo_dir)/vase_tiles.obj
	$(BUILD)/bin/bisque-bake $(demo_dir)/vase.nvdb $(demo_dir)/vase_tiles.obj --size 1024 \
	    --maps normal,height -o '$(demo_dir)/tile_<MAP>.<UDIM>.png'
	@echo
	@echo "Maps:    $(demo_dir)/vase_*.exr and .png; in two UDIM tiles: $(demo_dir)/tile_*.png"
	@echo "Preview: $(demo_dir)/preview.png (low-poly mesh without and with its maps, scan)"

# ---- benchmark ----
BENCH ?= medium
packages_bench := libtinyobjloader-dev
bench_bins := $(addprefix $(BUILD)/tests/,measure baseline-embree baseline-assimp \
    $(if $(wildcard /usr/include/tiny_obj_loader.h),baseline-tinyobj))
$(BUILD)/tests/measure: $(BUILD)/obj/tests/bench/measure.c.o
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^
$(BUILD)/tests/baseline-embree: $(BUILD)/obj/tests/bench/baseline_embree.c.o
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^ -lembree3
$(BUILD)/tests/baseline-assimp: $(BUILD)/obj/tests/bench/baseline_assimp.cc.o
	@mkdir -p $(@D)
	$(CXX) $(common) -o $@ $^ -lassimp
$(BUILD)/tests/baseline-tinyobj: $(BUILD)/obj/tests/bench/baseline_tinyobj.cc.o
	@mkdir -p $(@D)
	$(CXX) $(common) -o $@ $^ -ltinyobjloader

rays_archives := $(archive.libbake) $(archive.formats) $(archive.base)
rays_objs = $(patsubst %,$(BUILD)/obj/tests/bench/%.c.o,rays_scene $(1))
$(BUILD)/tests/bench-rays: $(call rays_objs,rays rays_embree) $(rays_archives) \
    | $(module_files) $(helper) $(BUILD)/tests/lib
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $(filter %.o,$^) $(rays_archives) $(LIBS.all) -lembree3
$(BUILD)/tests/bench-maps: $(call rays_objs,maps rays_embree) $(rays_archives) \
    | $(module_files) $(helper) $(BUILD)/tests/lib
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $(filter %.o,$^) $(rays_archives) $(LIBS.all) -lembree3
# The native device with counters. Its objects come before the library's when linking.
counted := native_lanes.c $(simd:%=native_lanes.c.%)
$(BUILD)/counted/%.c.o: %.c
	@mkdir -p $(@D)
	$(CC) $(CPPFLAGS) $(CFLAGS) -c $< -o $@
$(BUILD)/counted/tests/bench/rays_counters.c.o: tests/bench/rays_counters.c
$(BUILD)/tests/bench-gpu-trace: $(call rays_objs,gpu_trace gpu_limits) $(rays_archives) \
    | $(module_files) $(helper) $(BUILD)/tests/lib
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $(filter %.o,$^) $(rays_archives) $(LIBS.all)
$(BUILD)/tests/bench-rays-counters: $(call rays_objs) \
    $(BUILD)/counted/tests/bench/rays_counters.c.o \
    $(counted:%=$(BUILD)/counted/libbake/device/native/%.o) $(rays_archives) | $(module_files) \
    $(BUILD)/tests/lib
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $(filter %.o,$^) $(rays_archives) $(LIBS.all)

.PHONY: bench bench-build
bench-build: all $(generator) $(bench_bins)

## bench: compare stage 1 with other programs, BENCH=small, medium (default) or large
bench: deps
	@tests/install-packages.sh $(packages_bench) || echo "bench: continues without tinyobjloader"
	@$(MAKE) --no-print-directory -j$(jobs) bench-build >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/run.sh $(BENCH)

.PHONY: bench-bake
## bench-bake: compare rays a second with Embree on each device, BENCH=small or medium (default)
bench-bake: deps
	@$(MAKE) --no-print-directory -j$(jobs) all $(generator) $(BUILD)/tests/bench-rays \
	    $(BUILD)/tests/bench-rays-counters >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/bake.sh $(BENCH)

.PHONY: bench-maps
## bench-maps: compare the cost of maps, and secondary rays with Embree, BENCH=small or medium (default)
bench-maps: deps
	@$(MAKE) --no-print-directory -j$(jobs) all $(generator) $(BUILD)/tests/bench-maps >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/maps.sh $(BENCH)

.PHONY: bench-accuracy
## bench-accuracy: compare maps from voxels with exact maps, BENCH=small or medium (default)
bench-accuracy: deps
	@$(MAKE) --no-print-directory -j$(jobs) all $(generator) $(checkers) >&2
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/accuracy.sh $(BENCH)

.PHONY: bench-normals
## bench-normals: compare the weights of vertex normals on analytic surfaces
$(BUILD)/tests/bench-normals: $(BUILD)/obj/tests/bench/normals.c.o
	@mkdir -p $(@D)
	$(CC) $(common) -o $@ $^ -lm
bench-normals: $(BUILD)/tests/bench-normals
	@$< $(BENCH_CELLS)

.PHONY: bench-blender
## bench-blender: compare maps, and the cost of whole jobs, with Blender's, BENCH=small or medium (default)
bench-blender: all $(generator) $(BUILD)/tests/measure
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/blender.sh
	@BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/bench/blender_job.sh $(BENCH)

# The programs with their shared libraries, except those of C and C++, for machines that cannot
# build.
gpu_bundle := build/gpu
.PHONY: bench-gpu gpu-bundle
## bench-gpu: measure bisque-bake on this machine's GPUs, BENCH=small or full (default)
bench-gpu: gpu-bundle
	@tests/bench/gpu.sh $(if $(filter small,$(BENCH)),small,full)

## gpu-bundle: collect what bench-gpu needs on a machine that cannot build, in build/gpu
gpu-bundle: $(bins) $(generator) $(BUILD)/tests/bench-gpu-trace $(helper)
	rm -rf $(gpu_bundle)
	@mkdir -p $(gpu_bundle)/bin $(gpu_bundle)/lib/bisque
	cp $(filter-out $(helper),$^) $(gpu_bundle)/bin
	cp $(helper) $(gpu_bundle)/lib/bisque
	strip $(gpu_bundle)/bin/* $(gpu_bundle)/lib/bisque/*
	ldd $(gpu_bundle)/bin/* | awk '$$2 == "=>" && $$3 ~ /^\// { print $$3 }' | sort -u | \
	    grep -Ev '/(libc|libm|libdl|libpthread|librt|libgcc_s|libstdc[+][+])[.]so' | \
	    xargs -I LIB cp LIB $(gpu_bundle)/lib

# ---- quality ----
sources_c := $(foreach l,$(libs),$(src.$(l))) $(src.helper) $(wildcard tools/*.c)
# The sources that .clang-format applies to.
formatted = $(sort $(shell find $(libs) tools tests $(wildcard examples) \
    -name '*.c' -o -name '*.h' -o -name '*.cc' -o -name '*.cl'))
# States that Clang's static analyzer visits in each function at most.
lint_nodes ?= 225000
.PHONY: lint format
## lint: check rooms, documents, formatting, cppcheck, clang-tidy (installs missing tools)
lint: deps-lint $(addprefix $(BUILD)/gen/,kernel_source.inc kernel_ptx.inc chunk_sources.inc \
    bake_sources.inc)
	tests/lint/rooms.sh
	tests/lint/documents.sh
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

# ---- installation ----
bindir = $(DESTDIR)$(prefix)/bin
arcdir = $(DESTDIR)$(libdir)
moddir = $(DESTDIR)$(prefix)/lib/bisque
incdir = $(DESTDIR)$(prefix)/include/bisque
mandir = $(DESTDIR)$(prefix)/share/man/man1
farmdir = $(DESTDIR)$(prefix)/share/bisque/farm
farm_programs := tools/farm/bisque-slurm tools/farm/bisque-openjd

.PHONY: install uninstall
## install: install programs, man pages, libraries and headers under prefix=/usr/local
install: all
	install -d $(bindir) $(arcdir)/pkgconfig $(moddir) $(mandir) $(farmdir) \
	    $(addprefix $(incdir)/,$(sort $(dir $(public_headers))))
	install -m 755 $(bins) $(bindir)
	install -m 644 $(wildcard man/*.1) $(mandir)
	install -m 755 $(farm_programs) $(farmdir)
	install -m 644 $(filter-out $(farm_programs),$(wildcard tools/farm/*)) $(farmdir)
	install -m 644 $(module_files) $(moddir)
	install -m 755 $(helper) $(moddir)
	install -m 644 $(archives) $(arcdir)
	$(here) $(CC) $(CPPFLAGS) $(directory_cppflags) $(CFLAGS) -c formats/module/module_directory.c \
	    -o $(moddir)/module_directory.c.o
	$(AR) rD $(arcdir)/$(notdir $(archive.formats)) $(moddir)/module_directory.c.o
	rm $(moddir)/module_directory.c.*
	$(foreach h,$(public_headers),install -m 644 $(h) $(incdir)/$(h) &&) true
	for lib in voxel bake; do \
	    sed -e 's|@prefix@|$(prefix)|; s|@libdir@|$(libdir)|; s|@version@|$(VERSION)|' \
	    tools/bisque-$$lib.pc.in > $(arcdir)/pkgconfig/bisque-$$lib.pc; done

## uninstall: remove the files of install
uninstall:
	rm -f $(addprefix $(bindir)/,$(programs)) $(addprefix $(mandir)/,$(notdir $(wildcard man/*.1)))
	rm -f $(addprefix $(arcdir)/,$(notdir $(archives))) $(arcdir)/pkgconfig/bisque-*.pc
	rm -rf $(incdir) $(moddir) $(farmdir)
	-rmdir $(dir $(farmdir)) 2>/dev/null

# ---- packages of Bisque ----
dist := build/dist/bisque-$(VERSION).tar.gz
.PHONY: dist deb
## dist: build/dist/bisque-VERSION.tar.gz with the sources of the last commit, and its date
dist:
	@mkdir -p $(dir $(dist))
	git archive --format=tar --prefix=bisque-$(VERSION)/ HEAD | gzip -9n > $(dist)

## deb: build/deb with Debian packages of the last commit (installs missing packages)
deb: deps-deb dist
	tools/packaging/make-deb.sh $(dist) build/deb

.PHONY: clean
## clean: remove the build folder
clean:
	rm -rf build

.PHONY: help
## help: list the targets
help:
	@sed -n 's/^## //p' $(MAKEFILE_LIST)

-include $(shell find $(BUILD)/obj $(BUILD)/counted -name '*.d' 2>/dev/null)

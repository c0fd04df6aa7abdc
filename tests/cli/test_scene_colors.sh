#!/bin/sh
# test_scene_colors.sh - colours and textures of scans that Assimp reads.
. "$(dirname "$0")/lib.sh"

printf 'P3\n2 2\n255\n255 0 0  0 255 0\n0 0 255  9 90 200\n' >image.ppm
printf 'newmtl paint\nKd 0.2 0.4 0.6\nnewmtl image\nmap_Kd image.ppm\n' >square.mtl
points='v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0'
printf 'mtllib square.mtl\n%s\nusemtl paint\nf 1 2 3 4\n' "$points" >paint.obj
printf 'mtllib square.mtl\n%s\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl image\nf 1/1 2/2 3/3 4/4\n' \
    "$points" >image.obj
printf 'v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 0.2 0.4 0.6\nf 1 2 3 4\n' >colors.obj

# source_of NAME LETTERS VALUE...: an array of four values.
source_of()
{
    name=$1 letters=$2
    shift 2
    echo "<source id=\"$name\"><float_array id=\"$name-a\" count=\"$#\">$*</float_array>
        <technique_common><accessor count=\"4\" source=\"#$name-a\" stride=\"$(($# / 4))\">"
    for letter in $letters; do
        echo "<param name=\"$letter\" type=\"float\"/>"
    done
    echo "</accessor></technique_common></source>"
}

# write_dae INPUTS DIFFUSE: a square; its inputs besides the positions, and its diffuse element.
write_dae()
{
    echo "<?xml version=\"1.0\"?>
<COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" version=\"1.4.1\">
<asset><up_axis>Y_UP</up_axis></asset>
<library_images><image id=\"i\"><init_from>./image.ppm</init_from></image></library_images>
<library_effects><effect id=\"e\"><profile_COMMON>
<newparam sid=\"f\"><surface type=\"2D\"><init_from>i</init_from></surface></newparam>
<newparam sid=\"s\"><sampler2D><source>f</source></sampler2D></newparam>
<technique sid=\"t\"><lambert><diffuse>$2</diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id=\"m\" name=\"m\"><instance_effect url=\"#e\"/></material>
</library_materials>
<library_geometries><geometry id=\"g\"><mesh>"
    source_of positions "X Y Z" 0 0 0 1 0 0 1 1 0 0 1 0
    source_of texcoords "S T" 0 0 1 0 1 1 0 1
    source_of colors "R G B" 1 0 0 0 1 0 0 0 1 0.2 0.4 0.6
    echo "<vertices id=\"v\"><input semantic=\"POSITION\" source=\"#positions\"/></vertices>
<polylist count=\"1\" material=\"s\"><input offset=\"0\" semantic=\"VERTEX\" source=\"#v\"/>"
    for semantic in $1; do
        case $semantic in
        TEXCOORD) echo '<input offset="0" semantic="TEXCOORD" source="#texcoords" set="0"/>' ;;
        COLOR) echo '<input offset="0" semantic="COLOR" source="#colors"/>' ;;
        esac
    done
    echo "<vcount>4</vcount><p>0 1 2 3</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id=\"w\"><node id=\"n\"><instance_geometry url=\"#g\">
<bind_material><technique_common><instance_material symbol=\"s\" target=\"#m\"/>
</technique_common></bind_material></instance_geometry></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url=\"#w\"/></scene></COLLADA>"
}

color='<color>0.2 0.4 0.6 1</color>' texture='<texture texture="s" texcoord="UVSET0"/>'
write_dae TEXCOORD "$color" >paint.dae
write_dae TEXCOORD "$texture" >image.dae
write_dae COLOR "$color" >colors.dae
gzip -c image.dae >image.packed.dae.gz
for name in paint image colors; do
    ok run bisque-voxelize $name.obj -o $name.nvdb --resolution 32
    for file in "$name".*dae*; do
        ok run bisque-voxelize "$file" -o other.nvdb --tris other.tris --resolution 32 --strict
        out_like 'with colour'
        same $name.nvdb other.nvdb
    done
done
run bisque-voxelize image.dae -o a.nvdb --tris image.ppm
refused 64 'bisque-voxelize: image.ppm: this output would overwrite ./image.ppm, the texture that image.dae names'

# What is not used is told, for scans only.
write_dae 'TEXCOORD COLOR' "$texture" >both.dae
ok run bisque-voxelize both.dae -o both.nvdb --resolution 32
grep -qxF 'bisque-voxelize: warning: both.dae: 1 meshes have a texture, so their vertex colours are not used' "$err"
check 'a warning of vertex colours beside a texture' $?
run bisque-voxelize both.dae -o other.nvdb --resolution 32 --strict
code 65
same image.nvdb both.nvdb
ok run bisque-bake image.nvdb both.dae -o low.exr --maps color --size 16 --strict
write_dae TEXCOORD '<color>0.2 1.5 0.6 1</color>' >bright.dae
ok run bisque-voxelize bright.dae -o bright.nvdb --resolution 32
grep -qxF 'bisque-voxelize: warning: bright.dae: 1 meshes have a diffuse colour out of range, which was clamped' "$err"
check 'a warning of a diffuse colour out of range' $?
write_dae COLOR '<color>0.2 1.5 0.6 1</color>' >bright.dae
ok run bisque-voxelize bright.dae -o bright.nvdb --resolution 32 --strict
same colors.nvdb bright.nvdb
mkdir without
cp image.dae without
ok run bisque-voxelize without/image.dae -o other.nvdb --resolution 32
holds 'a warning of a missing texture' grep -q 'warning: without/image.dae: without/./image.ppm: no such texture: ' "$err"

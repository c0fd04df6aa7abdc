/* mesh_writer.c - see mesh_writer.h. */
#include "tests/scan/mesh_writer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static int has_suffix(const char *path, const char *suffix)
{
    size_t length = strlen(path), size = strlen(suffix);
    return length >= size && strcmp(path + length - size, suffix) == 0;
}

enum mesh_output mesh_output_of(const char *path)
{
    if (has_suffix(path, ".text.ply"))
        return MESH_PLY_TEXT;
    if (has_suffix(path, ".big.ply"))
        return MESH_PLY_BIG;
    if (has_suffix(path, ".ply"))
        return MESH_PLY_LITTLE;
    return has_suffix(path, ".stl") ? MESH_STL : MESH_OBJ;
}

/* Returns the value of the text that text_real() writes. */
static double rounded(double value)
{
    return (double)llround(value * 1e6) / 1e6;
}

static unsigned char color_byte(double value)
{
    return (unsigned char)((float)rounded(value) * 255.0f + 0.5f);
}

/* ---- PLY and STL: numbers ---- */

static int is_ply_text(const struct mesh_writer *w)
{
    return w->output == MESH_PLY_TEXT;
}

static void put_bits(struct mesh_writer *w, uint64_t bits, unsigned bytes)
{
    char out[8];
    for (unsigned i = 0; i < bytes; i++)
        out[w->output == MESH_PLY_BIG ? bytes - 1 - i : i] = (char)(bits >> 8 * i);
    text_bytes(&w->text, out, bytes);
}

static void put_integer(struct mesh_writer *w, uint64_t value, unsigned bytes)
{
    if (!is_ply_text(w)) {
        put_bits(w, value, bytes);
        return;
    }
    text_string(&w->text, " ");
    text_integer(&w->text, value);
}

static void put_float(struct mesh_writer *w, double value)
{
    float single = (float)rounded(value);
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    if (is_ply_text(w))
        text_real(&w->text, value);
    else
        put_bits(w, bits, 4);
}

static void put_double(struct mesh_writer *w, double value)
{
    double number = rounded(value);
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    if (is_ply_text(w))
        text_real(&w->text, value);
    else
        put_bits(w, bits, 8);
}

static void end_line(struct mesh_writer *w)
{
    if (is_ply_text(w))
        text_string(&w->text, "\n");
}

/* ---- headers ---- */

/* Declares properties, whose names are separated by blanks. */
static void put_properties(struct mesh_writer *w, const char *type, const char *names)
{
    while (*names) {
        char name[16] = "";
        size_t length = strcspn(names, " ");
        memcpy(name, names, length);
        names += length + (names[length] == ' ');
        text_string(&w->text, "property ");
        text_string(&w->text, type);
        text_string(&w->text, " ");
        text_string(&w->text, name);
        text_string(&w->text, "\n");
    }
}

static void put_ply_header(struct mesh_writer *w)
{
    static const char *const names[] = {[MESH_PLY_TEXT] = "ascii",
                                        [MESH_PLY_LITTLE] = "binary_little_endian",
                                        [MESH_PLY_BIG] = "binary_big_endian"};
    text_string(&w->text, "ply\nformat ");
    text_string(&w->text, names[w->output]);
    text_string(&w->text, " 1.0\nelement vertex ");
    text_integer(&w->text, w->facts.vertices);
    text_string(&w->text, "\n");
    put_properties(w, w->facts.far ? "double" : "float", "x y z");
    if (w->facts.normals)
        put_properties(w, "float", "nx ny nz");
    if (w->facts.colors)
        put_properties(w, "uchar", "red green blue");
    text_string(&w->text, "element face ");
    text_integer(&w->text, w->facts.faces);
    text_string(&w->text, "\nproperty list uchar int vertex_indices\n");
    if (w->facts.texcoords)
        text_string(&w->text, "property list uchar double texcoord\n");
    text_string(&w->text, "end_header\n");
}

static void put_stl_header(struct mesh_writer *w)
{
    char header[80] = "a generated scan";
    text_bytes(&w->text, header, sizeof header);
    put_bits(w, w->facts.faces, 4);
    w->positions = malloc((w->facts.vertices + 1) * sizeof *w->positions);
    if (!w->positions)
        abort();
}

void mesh_open(struct mesh_writer *w, const char *path, const struct mesh_facts *facts)
{
    memset(w, 0, sizeof *w);
    w->output = mesh_output_of(path);
    w->facts = *facts;
    text_open(&w->text, path);
    if (w->output == MESH_STL)
        put_stl_header(w);
    else if (w->output != MESH_OBJ)
        put_ply_header(w);
}

/* ---- elements ---- */

static void put_obj_vector(struct mesh_writer *w, const char *keyword, const double v[3],
                           const double *color)
{
    text_string(&w->text, keyword);
    for (int k = 0; k < 3; k++)
        text_real(&w->text, v[k]);
    for (int k = 0; color && k < 3; k++)
        text_real(&w->text, color[k]);
    text_string(&w->text, "\n");
}

static void keep_vertex(struct mesh_writer *w, const double position[3])
{
    for (int k = 0; k < 3; k++)
        w->positions[w->vertices][k] = (float)rounded(position[k]);
    w->vertices++;
}

void mesh_vertex(struct mesh_writer *w, const double position[3], const double *color,
                 const double *normal)
{
    if (w->output == MESH_OBJ) {
        put_obj_vector(w, "v", position, color);
        return;
    }
    if (w->output == MESH_STL) {
        keep_vertex(w, position);
        return;
    }
    for (int k = 0; k < 3; k++)
        (w->facts.far ? put_double : put_float)(w, position[k]);
    for (int k = 0; normal && k < 3; k++)
        put_float(w, normal[k]);
    for (int k = 0; color && k < 3; k++)
        put_integer(w, color_byte(color[k]), 1);
    end_line(w);
}

void mesh_texcoord(struct mesh_writer *w, double u, double v)
{
    if (w->output != MESH_OBJ)
        return;
    text_string(&w->text, "vt");
    text_real(&w->text, u);
    text_real(&w->text, v);
    text_string(&w->text, "\n");
}

int mesh_normals_apart(const struct mesh_writer *w)
{
    return w->output == MESH_OBJ;
}

void mesh_normal(struct mesh_writer *w, const double normal[3])
{
    if (w->output == MESH_OBJ)
        put_obj_vector(w, "vn", normal, NULL);
}

/* ---- faces ---- */

static void put_obj_corner(struct mesh_writer *w, const struct mesh_corner *corner)
{
    text_string(&w->text, " ");
    text_integer(&w->text, corner->vertex + 1);
    if (w->facts.texcoords) {
        text_string(&w->text, "/");
        text_integer(&w->text, corner->texcoord + 1);
    }
    if (w->facts.normals) {
        text_string(&w->text, w->facts.texcoords ? "/" : "//");
        text_integer(&w->text, corner->vertex + 1);
    }
}

static void put_ply_face(struct mesh_writer *w, const struct mesh_corner *corners, unsigned count)
{
    put_integer(w, count, 1);
    for (unsigned i = 0; i < count; i++)
        put_integer(w, corners[i].vertex, 4);
    if (w->facts.texcoords)
        put_integer(w, 2 * count, 1);
    for (unsigned i = 0; w->facts.texcoords && i < count; i++)
        for (int k = 0; k < 2; k++)
            put_double(w, corners[i].uv[k]);
    end_line(w);
}

static void put_stl_triangle(struct mesh_writer *w, const struct mesh_corner *corners)
{
    const char nothing[12] = {0};
    text_bytes(&w->text, nothing, 12);
    for (int i = 0; i < 3; i++)
        text_bytes(&w->text, (const char *)w->positions[corners[i].vertex], 12);
    text_bytes(&w->text, nothing, 2);
}

void mesh_face(struct mesh_writer *w, const struct mesh_corner *corners, unsigned count)
{
    if (w->output == MESH_STL) {
        put_stl_triangle(w, corners);
        return;
    }
    if (w->output != MESH_OBJ) {
        put_ply_face(w, corners, count);
        return;
    }
    text_string(&w->text, "f");
    for (unsigned i = 0; i < count; i++)
        put_obj_corner(w, &corners[i]);
    text_string(&w->text, "\n");
}

void mesh_close(struct mesh_writer *w)
{
    text_close(&w->text);
    free(w->positions);
}

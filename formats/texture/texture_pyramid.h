// texture_pyramid.h - averages of an image over squares of 2^n texels, in linear light.
#ifndef FMT_TEXTURE_TEXTURE_PYRAMID_H
#define FMT_TEXTURE_TEXTURE_PYRAMID_H

#include <algorithm>
#include <cstdint>
#include <vector>

namespace fmt
{

// A rectangle in texels; the origin is the image's upper left corner.
struct Rectangle {
    double x0, x1, y0, y1;
};

// Returns the length that [first, first + extent) and [a, b) share. They must not be disjoint.
inline double overlap(double first, double extent, double a, double b)
{
    return std::min(first + extent, b) - std::max(first, a);
}

// Levels first_level, first_level + 1, ... up to a level of one cell. Cell (i, j) of level n is the
// average over texels [i, i + 1) x [j, j + 1) * 2^n, cut off at the image's right and lower edges.
class Pyramid
{
  public:
    Pyramid() = default;
    Pyramid(uint32_t width, uint32_t height, int first_level);

    // Returns the memory that a pyramid takes.
    static uint64_t size_bytes(uint32_t width, uint32_t height, int first_level);

    // Adds the next row of the image, top row first: `width` RGB triples.
    void add_row(const float *rgb);
    // Builds the levels above the first; to be called after the last row.
    void finish();

    int first_level() const
    {
        return first;
    }
    int last_level() const
    {
        return first + int(levels.size()) - 1;
    }

    // Adds to `sum` the integral of a level over a rectangle inside the image.
    void integrate(int level, const Rectangle &rectangle, double sum[3]) const;

  private:
    struct Rgb {
        float c[3];
    };
    struct Level {
        uint32_t width, height;
        std::vector<Rgb> cells;
    };

    static Level make_level(uint32_t width, uint32_t height, int number);
    Level make_next(const Level &below, int number) const;
    void close_cells(uint32_t rows);

    uint32_t width = 0, height = 0;
    int first = 0;
    uint32_t next_row = 0;
    std::vector<double> sums; // of the first level's current row of cells
    std::vector<Level> levels;
};

} // namespace fmt

#endif

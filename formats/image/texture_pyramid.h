// texture_pyramid.h - averages of an image over squares of 2^n texels, in linear light; private to
// the texture reader, C++.
#ifndef FMT_IMAGE_TEXTURE_PYRAMID_H
#define FMT_IMAGE_TEXTURE_PYRAMID_H

#include <algorithm>
#include <cstdint>
#include <vector>

namespace fmt
{

// A rectangle in texels, from the image's upper left corner.
struct Rectangle {
    double x0, x1, y0, y1;
};

// Length of what [first, first + extent) and [a, b), which touch, share.
inline double overlap(double first, double extent, double a, double b)
{
    return std::min(first + extent, b) - std::max(first, a);
}

// Levels first_level, first_level + 1, ... up to one that has a single cell. Cell (i, j) of level n
// is the average over texels [i, i + 1) x [j, j + 1) * 2^n, fewer at the right and lower edges.
class Pyramid
{
  public:
    Pyramid() = default;
    Pyramid(uint32_t width, uint32_t height, int first_level);

    // Bytes that a pyramid takes.
    static uint64_t size_bytes(uint32_t width, uint32_t height, int first_level);

    // Adds the image's next row, from the top: width RGB triples.
    void add_row(const float *rgb);
    // Makes the upper levels; after the last row.
    void finish();

    int first_level() const
    {
        return first;
    }
    int last_level() const
    {
        return first + int(levels.size()) - 1;
    }

    // Adds the integral of level `level` over a rectangle inside the image to sum.
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
    std::vector<double> sums; // of the first level's row of cells that is not complete
    std::vector<Level> levels;
};

} // namespace fmt

#endif

// texture_pyramid.cc - averages of an image over squares of 2^n texels.
//
// The first level is built from the image's rows as they come, with the sums of one row of cells in
// memory. Cells at the right and lower edges cover fewer texels and weigh less. So the integral
// over the whole image is the same on every level, for any image size.
#include "formats/texture/texture_pyramid.h"

#include <cmath>
#include <cstddef>

namespace fmt
{

static uint32_t cell_count(uint32_t texels, int level)
{
    return uint32_t((uint64_t(texels) + (uint64_t(1) << level) - 1) >> level);
}

// Returns the width in texels of cell i of a level.
static uint32_t cell_extent(uint32_t i, int level, uint32_t texels)
{
    uint64_t start = uint64_t(i) << level;
    return uint32_t(std::min(uint64_t(texels) - start, uint64_t(1) << level));
}

uint64_t Pyramid::size_bytes(uint32_t width, uint32_t height, int first_level)
{
    uint64_t cells = 0;
    for (int level = first_level;; level++) {
        uint32_t columns = cell_count(width, level), rows = cell_count(height, level);
        cells += uint64_t(columns) * rows;
        if (columns == 1 && rows == 1)
            return cells * sizeof(Rgb);
    }
}

Pyramid::Level Pyramid::make_level(uint32_t width, uint32_t height, int number)
{
    Level level;
    level.width = cell_count(width, number);
    level.height = cell_count(height, number);
    level.cells.resize(size_t(level.width) * level.height);
    return level;
}

Pyramid::Pyramid(uint32_t width, uint32_t height, int first_level)
    : width(width), height(height), first(first_level)
{
    levels.push_back(make_level(width, height, first));
    sums.assign(3 * size_t(levels[0].width), 0.0);
}

// Completes the current row of cells, which holds the sums of `rows` rows of texels.
void Pyramid::close_cells(uint32_t rows)
{
    Level &base = levels[0];
    Rgb *cells = &base.cells[size_t((next_row - 1) >> first) * base.width];
    for (uint32_t i = 0; i < base.width; i++)
        for (size_t c = 0; c < 3; c++)
            cells[i].c[c] = float(sums[3 * size_t(i) + c] /
                                  (double(cell_extent(i, first, width)) * double(rows)));
    std::fill(sums.begin(), sums.end(), 0.0);
}

void Pyramid::add_row(const float *rgb)
{
    for (uint32_t x = 0; x < width; x++)
        for (size_t c = 0; c < 3; c++)
            sums[3 * size_t(x >> first) + c] += double(rgb[3 * size_t(x) + c]);
    uint32_t row = next_row++ >> first;
    if (next_row == height || next_row >> first != row)
        close_cells(next_row - (row << first));
}

// Returns the next level: averages of up to 2 x 2 cells, weighted by the texels that each covers.
Pyramid::Level Pyramid::make_next(const Level &below, int number) const
{
    Level above = make_level(width, height, number + 1);
    for (uint32_t y = 0; y < above.height; y++)
        for (uint32_t x = 0; x < above.width; x++) {
            double sum[3] = {0, 0, 0}, weights = 0;
            for (uint32_t j = 2 * y; j < std::min(2 * y + 2, below.height); j++)
                for (uint32_t i = 2 * x; i < std::min(2 * x + 2, below.width); i++) {
                    double weight = double(cell_extent(i, number, width)) *
                                    double(cell_extent(j, number, height));
                    for (int c = 0; c < 3; c++)
                        sum[c] += weight * double(below.cells[size_t(j) * below.width + i].c[c]);
                    weights += weight;
                }
            for (int c = 0; c < 3; c++)
                above.cells[size_t(y) * above.width + x].c[c] = float(sum[c] / weights);
        }
    return above;
}

void Pyramid::finish()
{
    for (int level = first; levels.back().width > 1 || levels.back().height > 1; level++)
        levels.push_back(make_next(levels.back(), level));
    sums = {};
}

void Pyramid::integrate(int level, const Rectangle &r, double sum[3]) const
{
    const Level &cells = levels[size_t(level - first)];
    double size = std::ldexp(1.0, level);
    auto x_end = std::min(cells.width, uint32_t(std::ceil(r.x1 / size)));
    auto y_end = std::min(cells.height, uint32_t(std::ceil(r.y1 / size)));
    for (auto y = uint32_t(r.y0 / size); y < y_end; y++) {
        double high = overlap(y * size, cell_extent(y, level, height), r.y0, r.y1);
        for (auto x = uint32_t(r.x0 / size); x < x_end; x++) {
            double weight = high * overlap(x * size, cell_extent(x, level, width), r.x0, r.x1);
            for (int c = 0; c < 3; c++)
                sum[c] += weight * double(cells.cells[size_t(y) * cells.width + x].c[c]);
        }
    }
}

} // namespace fmt

/* simplify_cgal.cpp - Lindstrom and Turk's edge collapse as CGAL has it, for simplify.py.
 *
 *     simplify_cgal IN OUT TRIANGLES
 *
 * Both files: numbers of vertices and triangles, positions as floats, corners; 32 bits each. Prints
 * the processor time of the collapse in seconds. Build it with the headers of libcgal-dev:
 *
 *     g++ -O2 -std=c++17 -DNDEBUG tests/bench/simplify_cgal.cpp -lgmp -lmpfr -o simplify_cgal */
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/Surface_mesh_simplification/Edge_collapse_visitor_base.h>
#include <CGAL/Surface_mesh_simplification/edge_collapse.h>

#include <ctime>
#include <fstream>
#include <iostream>

using Mesh = CGAL::Surface_mesh<CGAL::Simple_cartesian<double>::Point_3>;
namespace simplification = CGAL::Surface_mesh_simplification;

static std::size_t faces;

struct Stop {
    std::size_t target;
    template <class Cost, class Profile>
    bool operator()(const Cost &, const Profile &, std::size_t, std::size_t) const
    {
        return faces <= target;
    }
};

/* Counts the triangles that are left: CGAL counts edges. */
struct Counter : simplification::Edge_collapse_visitor_base<Mesh> {
    void OnCollapsed(const Profile &profile, vertex_descriptor)
    {
        faces -= profile.left_face_exists() + profile.right_face_exists();
    }
};

int main(int argc, char **argv)
{
    if (argc != 4)
        return 64;
    std::ifstream in(argv[1], std::ios::binary);
    std::uint32_t counts[2];
    in.read(reinterpret_cast<char *>(counts), sizeof counts);
    std::vector<Mesh::Point> points(counts[0]);
    std::vector<std::array<std::uint32_t, 3>> triangles(counts[1]);
    for (auto &point : points) {
        float p[3];
        in.read(reinterpret_cast<char *>(p), sizeof p);
        point = Mesh::Point(p[0], p[1], p[2]);
    }
    in.read(reinterpret_cast<char *>(triangles.data()), 12 * triangles.size());
    Mesh mesh;
    CGAL::Polygon_mesh_processing::orient_polygon_soup(points, triangles);
    CGAL::Polygon_mesh_processing::polygon_soup_to_polygon_mesh(points, triangles, mesh);
    faces = mesh.number_of_faces();
    const std::clock_t start = std::clock();
    const Stop stop{std::stoul(argv[3])};
    simplification::edge_collapse(mesh, stop, CGAL::parameters::visitor(Counter()));
    std::cout << double(std::clock() - start) / CLOCKS_PER_SEC << '\n';
    mesh.collect_garbage();
    std::ofstream out(argv[2], std::ios::binary);
    counts[0] = mesh.number_of_vertices();
    counts[1] = mesh.number_of_faces();
    out.write(reinterpret_cast<char *>(counts), sizeof counts);
    for (auto v : mesh.vertices()) {
        const auto &at = mesh.point(v);
        const float p[3] = {float(at.x()), float(at.y()), float(at.z())};
        out.write(reinterpret_cast<const char *>(p), sizeof p);
    }
    for (auto f : mesh.faces())
        for (auto v : CGAL::vertices_around_face(mesh.halfedge(f), mesh)) {
            const std::uint32_t number = v;
            out.write(reinterpret_cast<const char *>(&number), sizeof number);
        }
}

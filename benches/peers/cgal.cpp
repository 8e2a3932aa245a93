// C interface to CGAL's two edge-collapse simplifiers, for benches/simplify.py.
// They are called as in the manual's examples, except that they stop at a number of faces: a stop at a
// number of edges misses the target on meshes with borders.
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/Bounded_normal_change_placement.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/GarlandHeckbert_plane_policies.h>
#include <CGAL/Surface_mesh_simplification/edge_collapse.h>
#include <CGAL/version.h>

#include <cstddef>
#include <cstdint>

namespace {

namespace simplification = CGAL::Surface_mesh_simplification;
using Kernel = CGAL::Simple_cartesian<double>;
using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;

struct FaceCount {
    std::size_t wanted;

    template <typename Cost, typename Profile>
    bool operator()(const Cost&, const Profile& profile, std::size_t, std::size_t) const {
        return profile.surface_mesh().number_of_faces() <= wanted;
    }
};

}  // namespace

extern "C" {

const char* version() { return CGAL_VERSION_STR; }

// Returns null if CGAL rejects a face as non-manifold.
void* load(const double* vertices, std::size_t vertex_count, const std::int32_t* triangles, std::size_t count) {
    auto mesh = new Mesh;
    for (std::size_t i = 0; i < vertex_count; ++i)
        mesh->add_vertex({vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2]});
    for (std::size_t i = 0; i < count; ++i) {
        const auto corner = [&](int k) { return Mesh::Vertex_index(triangles[3 * i + k]); };
        if (mesh->add_face(corner(0), corner(1), corner(2)) == Mesh::null_face()) {
            delete mesh;
            return nullptr;
        }
    }
    return mesh;
}

void lindstrom_turk(void* handle, std::size_t wanted) {
    simplification::edge_collapse(*static_cast<Mesh*>(handle), FaceCount{wanted});
}

void garland_heckbert(void* handle, std::size_t wanted) {
    auto& mesh = *static_cast<Mesh*>(handle);
    using Policies = simplification::GarlandHeckbert_plane_policies<Mesh, Kernel>;
    Policies policies(mesh);
    const simplification::Bounded_normal_change_placement<Policies::Get_placement> placement(
        policies.get_placement());
    simplification::edge_collapse(mesh, FaceCount{wanted},
                                  CGAL::parameters::get_cost(policies.get_cost()).get_placement(placement));
}

std::size_t vertex_count(void* handle) { return static_cast<Mesh*>(handle)->number_of_vertices(); }

std::size_t triangle_count(void* handle) { return static_cast<Mesh*>(handle)->number_of_faces(); }

// Writes the simplified mesh into arrays with the counts above, and frees it.
void unload(void* handle, double* vertices, std::int32_t* triangles) {
    auto mesh = static_cast<Mesh*>(handle);
    mesh->collect_garbage();
    for (const auto vertex : mesh->vertices())
        for (int k = 0; k < 3; ++k) *vertices++ = mesh->point(vertex)[k];
    for (const auto face : mesh->faces())
        for (const auto vertex : mesh->vertices_around_face(mesh->halfedge(face))) *triangles++ = vertex;
    delete mesh;
}

}  // extern "C"

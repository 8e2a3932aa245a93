// C interface to meshoptimizer's clusterlod. Stores all clusters of its hierarchy with their errors, so that
// the hierarchy can be cut at any error.
#include <cstddef>
#include <cstdint>
#include <vector>

#include "meshoptimizer.h"
#define CLUSTERLOD_IMPLEMENTATION
#include "clusterlod.h"

namespace {

struct Built {
    std::vector<float> group_error;
    // Of each cluster: its group, and the group that it simplifies, or -1.
    std::vector<int32_t> group, refined;
    // Corners of cluster i: indices[first[i]] to indices[first[i + 1]].
    std::vector<uint64_t> first{0};
    std::vector<uint32_t> indices;
};

int add_group(void* context, clodGroup group, const clodCluster* clusters, size_t count) {
    Built& built = *static_cast<Built*>(context);
    const int number = static_cast<int>(built.group_error.size());
    built.group_error.push_back(group.simplified.error);
    for (size_t i = 0; i < count; ++i) {
        const clodCluster& cluster = clusters[i];
        built.group.push_back(number);
        built.refined.push_back(cluster.refined);
        built.indices.insert(built.indices.end(), cluster.indices, cluster.indices + cluster.index_count);
        built.first.push_back(built.indices.size());
    }
    return number;
}

}  // namespace

extern "C" {

// Builds clusters of at most `triangles` triangles with the default configuration. Arrays stay with the caller.
void* build(const float* points, size_t point_count, const uint32_t* indices, size_t index_count, size_t triangles) {
    clodMesh mesh = {};
    mesh.indices = indices;
    mesh.index_count = index_count;
    mesh.vertex_count = point_count;
    mesh.vertex_positions = points;
    mesh.vertex_positions_stride = 3 * sizeof(float);
    Built* built = new Built;
    clodBuild(clodDefaultConfig(triangles), mesh, built, add_group);
    return built;
}

// Writes the corners of the cut at `error` into `target`, which may be null. Returns their count.
size_t cut(const void* handle, float error, uint32_t* target) {
    const Built& built = *static_cast<const Built*>(handle);
    size_t count = 0;
    for (size_t i = 0; i < built.group.size(); ++i) {
        const bool is_enough = built.refined[i] < 0 || built.group_error[built.refined[i]] <= error;
        if (!is_enough || built.group_error[built.group[i]] <= error) continue;
        for (uint64_t k = built.first[i]; k < built.first[i + 1]; ++k, ++count) {
            if (target) target[count] = built.indices[k];
        }
    }
    return count;
}

void release(void* handle) { delete static_cast<Built*>(handle); }

}

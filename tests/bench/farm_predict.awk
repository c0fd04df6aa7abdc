# farm_predict.awk - predicts bakes of large scans on a farm from the figures of farm.sh: lines with
# a name and a value, in seconds of one core and bytes, for 16 tasks.
#
# Model: a step that is divided takes its core seconds / (nodes * CORES). Serial steps take theirs on
# one core. Work grows with texels, triangles and voxels as it was measured:
#   sorting       triangles, divided by parts of the scan
#   voxelizing    triangles and bytes of the grid; all cores of one node
#   tasks         texels; from triangles also each triangle that a task loads
#   merge         texels; one core
# The load of the file system is what the tasks of a step read and write, by the time of the step.
# The measured scan has fewer chunks than a large one has for each task, so how many tasks read a chunk
# is assumed: CHUNK_READERS. Tasks on one node share its page cache, so a node reads less than its tasks do.
# TEXELS: of all UDIM tiles. The grid has RESOLUTION voxels along the longest side for 10^9 triangles,
# and as many for each triangle of others.
BEGIN {
    CORES = 16
    TEXELS = 20 * 16384 * 16384
    RESOLUTION = 8192
    CHUNK_READERS = 3
    GB = 1e9
}
{ f[$1] = $2 }

function most(a, b) { return a > b ? a : b }

# Solves seconds = texels * each_texel + triangles * each_triangle for a map of `side` and one of a
# quarter of it.
function fit(kind,    texels) {
    texels = f["side"] ^ 2
    each_texel[kind] = (f[kind "_single"] - f[kind "_small"]) / (texels * 15 / 16)
    each_triangle[kind] = most(0, f[kind "_small"] - each_texel[kind] * texels / 16) / f["triangles"]
    merge_texel[kind] = f[kind "_merge"] / texels
    each_texel[kind] = most(1e-9, each_texel[kind] - merge_texel[kind])
    overhead[kind] = f[kind "_tasks"] / (f[kind "_single"] - f[kind "_merge"])
    part_texel[kind] = f[kind "_parts"] / texels
    # How often the bytes of the scan are read by all tasks together.
    again[kind] = kind == "tris" ? CHUNK_READERS : most(1, f[kind "_read"] / f[kind "_bytes"])
}

function row(kind, triangles, nodes,    cores, grid, sort, voxels, tasks, merge, scan, parts, total) {
    cores = nodes * CORES
    grid = f["nvdb_bytes"] * (RESOLUTION / 1024) ^ 2 * triangles / 1e9
    sort = f["sort_seconds"] / f["triangles"] * triangles / cores
    voxels = kind == "nvdb" ? (grid * grid_byte + triangles * grid_triangle) / CORES : 0
    scan = kind == "nvdb" ? grid : f["tris_bytes"] / f["triangles"] * triangles
    tasks = TEXELS * each_texel[kind] * most(1, overhead[kind])
    if (kind == "tris")
        tasks += triangles * again[kind] * each_triangle[kind]
    tasks /= cores
    merge = TEXELS * merge_texel[kind]
    parts = TEXELS * part_texel[kind]
    total = sort + voxels + tasks + merge
    printf "| %s | 10^%d | %d | %s | %s | %s | %s | %s | %.0f %% | %.1f | %.1f | %.1f |\n",
        kind == "nvdb" ? "grid" : "triangles", log(triangles) / log(10) + 0.5, nodes, time(sort),
        kind == "nvdb" ? time(voxels) : "-", time(tasks), time(merge), time(total),
        100 * merge / total,
        triangles * (f["obj_bytes"] + f["tris_bytes"]) / f["triangles"] / sort / GB,
        (scan * again[kind] + parts) / tasks / GB, 2 * parts / merge / GB
}

function time(s) { return s < 90 ? sprintf("%.0f s", s) : s < 5400 ? sprintf("%.0f min", s / 60) : sprintf("%.1f h", s / 3600) }

END {
    grid_byte = (f["grid_seconds"] - f["small_grid_seconds"]) / (f["nvdb_bytes"] - f["small_grid_bytes"])
    grid_triangle = most(0, f["small_grid_seconds"] - grid_byte * f["small_grid_bytes"]) / f["triangles"]
    fit("nvdb")
    fit("tris")
    printf "predicted for %.1f billion texels (20 maps of 16384 x 16384), nodes of %d cores like this one:\n", TEXELS / 1e9, CORES
    print "| bake | triangles | nodes | sorting | voxelizing | tasks | merge (serial) | in all | serial | sorting GB/s | tasks GB/s | merge GB/s |"
    print "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
    for (kind = 0; kind < 2; kind++)
        for (power = 9; power <= 10; power++)
            for (nodes = 16; nodes <= 64; nodes *= 4)
                row(kind ? "tris" : "nvdb", 10 ^ power, nodes)
    printf "\nmeasured for each texel: %.2f us in tasks from a grid, %.2f us from triangles, %.2f us in the merge, %.1f bytes of parts\n",
        each_texel["nvdb"] * 1e6, each_texel["tris"] * 1e6, merge_texel["nvdb"] * 1e6, part_texel["nvdb"]
    printf "for each triangle: %.2f us sorting, %.2f us voxelizing, %.2f us when an exact bake loads it; %.1f bytes sorted\n",
        f["sort_seconds"] / f["triangles"] * 1e6, grid_triangle * 1e6, each_triangle["tris"] * 1e6,
        f["tris_bytes"] / f["triangles"]
    printf "for each MB of the grid: %.1f ms voxelizing\n", grid_byte * 1e9
    printf "16 tasks read the grid %.1f times; assumed: %d tasks read each chunk\n", again["nvdb"], CHUNK_READERS
}

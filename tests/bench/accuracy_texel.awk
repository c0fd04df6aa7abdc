# accuracy_texel.awk - prints how many world units a unit of texture space is on a low-poly mesh (OBJ): the square root of
# the surface's area divided by the charts' area. Divided by the size of the map, this is the side of a mean texel.
$1 == "v" { vertices++; for (k = 1; k <= 3; k++) position[vertices, k] = $(k + 1) }
$1 == "vt" { texcoords++; for (k = 1; k <= 2; k++) texcoord[texcoords, k] = $(k + 1) }
$1 == "f" {
    for (corner = 2; corner <= NF; corner++) {
        split($corner, index_of, "/")
        v[corner] = index_of[1] < 0 ? vertices + 1 + index_of[1] : index_of[1]
        t[corner] = index_of[2] < 0 ? texcoords + 1 + index_of[2] : index_of[2]
    }
    for (corner = 3; corner < NF; corner++)
        add_triangle(2, corner, corner + 1)
}
function add_triangle(a, b, c,    k, p, q, n, square) {
    for (k = 1; k <= 3; k++) {
        p[k] = position[v[b], k] - position[v[a], k]
        q[k] = position[v[c], k] - position[v[a], k]
    }
    for (k = 1; k <= 3; k++) {
        n = p[k % 3 + 1] * q[(k + 1) % 3 + 1] - p[(k + 1) % 3 + 1] * q[k % 3 + 1]
        square += n * n
    }
    surface += sqrt(square)
    for (k = 1; k <= 2; k++) {
        p[k] = texcoord[t[b], k] - texcoord[t[a], k]
        q[k] = texcoord[t[c], k] - texcoord[t[a], k]
    }
    n = p[1] * q[2] - p[2] * q[1]
    charts += n < 0 ? -n : n
}
END { printf "%.9g\n", sqrt(surface / charts) }

# accuracy_diagonal.awk - prints the diagonal of a scan's bounds (OBJ).
$1 == "v" {
    for (k = 1; k <= 3; k++) {
        if (!(k in low) || $(k + 1) < low[k])
            low[k] = $(k + 1)
        if (!(k in high) || $(k + 1) > high[k])
            high[k] = $(k + 1)
    }
}
END {
    for (k = 1; k <= 3; k++)
        square += (high[k] - low[k]) ^ 2
    printf "%.9g\n", sqrt(square)
}

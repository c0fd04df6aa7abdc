# Checks that PTX rounds as IEEE 754 asks, so that a GPU gives the processor's bits: no approximation, no flushed
# denormals, nothing contracted, no add or mul without a rounding mode, which ptxas may contract, and no double but in
# bake_meet and bake_first. Checks that it divides no integers, for which assemblers approximate reciprocals, and that
# there are five kernels that call nothing. Prints each offence.
# See docs/decisions/0012-one-kernel-for-all-devices.md.
/^[ \t]*\/\// { next }
/^}/ { meets = 0 }
/\.(approx|ftz|full)[. ]/ || /[ \t](fma|mad[a-z.]*|rsqrt|ex2|lg2|sin|cos|tanh)\.[a-z.]*f(32|64)/ || /\.f16/ ||
/[ \t](add|sub|mul)\.f(32|64)/ || /[ \t](div|rcp|sqrt)\.f(32|64)/ || /[ \t](div|rem)\.[su][0-9]/ || /[ \t]call/ ||
(!meets && /\.f64/) {
    print FILENAME ":" FNR ": " $0 > "/dev/stderr"
    bad = 1
}
/\.entry bake_(patch|look|rays|meet|first)\(/ { kernels++ }
/\.entry bake_(meet|first)\(/ { meets = 1 }
/[ \t]sqrt\.rn\.f32/ { roots++ }
/[ \t](div|rcp)\.rn\.f32/ { divisions++ }
END {
    if (kernels != 5 || !roots || !divisions) {
        print FILENAME ": " kernels + 0 " kernels, " roots + 0 " square roots, " divisions + 0 " divisions" > "/dev/stderr"
        bad = 1
    }
    exit bad
}

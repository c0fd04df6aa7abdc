# accuracy_table.awk - turns the records of accuracy.sh into tables and a list of goals.
#
# Input, separated by tabs:
#   voxel SCAN RATIO DETAIL SAMPLING MEAN P95 P99 MAX SHARE_ABOVE_1 SHARE_ABOVE_5 AGREEMENT
#   truth SCAN MAP MEAN P95 P99 MAX
# RATIO is the voxel's size in texels, or 0 for exact maps of the triangles' facets; DETAIL the wavelength in
# voxels, or "-".
$1 == "voxel" {
    key = $2 SUBSEP $3 SUBSEP $4
    if (!(key in seen)) {
        seen[key] = 1
        rows[++row_count] = key
    }
    if (!($2 in listed)) {
        listed[$2] = 1
        scans[++scan_count] = $2
    }
    by_detail[$2] = $4 != "-"
    for (i = 6; i <= NF; i++)
        figure[key, $5, i - 5] = $i
}
$1 == "truth" {
    truths[$2] = truths[$2] sprintf("| %s | %.3f | %.2f | %.2f | %.1f |\n", $3, $4, $5, $6, $7)
}

function fraction(ratio) {
    return ratio == 0 ? "exact" : ratio == 0.5 ? "1/2" : ratio == 0.25 ? "1/4" : ratio
}

function print_row(key, sampling,    part, nearest, trilinear) {
    split(key, part, SUBSEP)
    printf "| %s |", fraction(part[2])
    if (by_detail[part[1]])
        printf " %s | %g |", part[3], part[3] * part[2]
    printf " %s | %.3f | %.2f | %.2f | %.1f | %.2f %% | %.3f %% | %.4f %% |", sampling,
        figure[key, sampling, 1], figure[key, sampling, 2], figure[key, sampling, 3],
        figure[key, sampling, 4], 100 * figure[key, sampling, 5], 100 * figure[key, sampling, 6],
        100 * figure[key, sampling, 7]
    nearest = figure[key, "nearest", 1]
    trilinear = figure[key, "trilinear", 1]
    printf " %s |\n", sampling == "nearest" ? sprintf("%.2f", nearest / trilinear) : ""
}

function print_table(scan,    i, part) {
    printf "\n### %s\n\n| voxel / texel |", scan
    if (by_detail[scan])
        printf " wave, voxels | wave, texels |"
    print " sampling | mean ° | p95 ° | p99 ° | max ° | above 1° | above 5° | hit agreement | times worse |"
    printf "|---:|"
    if (by_detail[scan])
        printf "---:|---:|"
    print ":---|---:|---:|---:|---:|---:|---:|---:|---:|"
    for (i = 1; i <= row_count; i++) {
        split(rows[i], part, SUBSEP)
        if (part[1] != scan)
            continue
        if (part[2] == 0) {
            if ((rows[i], "smooth", 1) in figure)
                print_row(rows[i], "smooth")
            print_row(rows[i], "flat")
            continue
        }
        print_row(rows[i], "trilinear")
        print_row(rows[i], "nearest")
    }
    if (scan in truths) {
        printf "\nThe same maps against the formula:\n\n| map | mean ° | p95 ° | p99 ° | max ° |\n"
        printf "|:---|---:|---:|---:|---:|\n%s", truths[scan]
    }
}

function goal(text, value, limit, at_most, format,    holds) {
    holds = at_most ? value <= limit : value >= limit
    printf "- %s: %s: " format ", goal %s " format "\n", holds ? "holds" : "**missed**", text,
        value, at_most ? "at most" : "at least", limit
}

function print_goals(key,    part, where) {
    split(key, part, SUBSEP)
    where = part[1] (part[3] == "-" ? "" : ", wave of " part[3] " voxels") ", voxel / texel " fraction(part[2])
    if (part[3] == "-" && part[2] == 1) {
        goal(where ", mean °", figure[key, "trilinear", 1], 1, 1, "%.3f")
        goal(where ", p95 °", figure[key, "trilinear", 2], 3, 1, "%.2f")
        goal(where ", hit agreement %", 100 * figure[key, "trilinear", 7], 99.9, 0, "%.3f")
    }
    if (part[3] == "-" && part[2] == 0.5)
        goal(where ", mean °", figure[key, "trilinear", 1], 0.4, 1, "%.3f")
    if (part[3] != "-" && part[3] >= 8)
        goal(where ", nearest over trilinear", figure[key, "nearest", 1] / figure[key, "trilinear", 1],
            3, 0, "%.2f")
}

# Sorts the rows of a scan by falling ratio, then by rising detail.
function comes_before(a, b,    p, q) {
    split(a, p, SUBSEP)
    split(b, q, SUBSEP)
    if (p[1] != q[1] || p[2] == 0 || q[2] == 0)
        return 0
    return p[2] != q[2] ? p[2] + 0 > q[2] + 0 : p[3] + 0 < q[3] + 0
}

function sort_rows(    i, j, row) {
    for (i = 2; i <= row_count; i++) {
        row = rows[i]
        for (j = i - 1; j > 0 && comes_before(row, rows[j]); j--)
            rows[j + 1] = rows[j]
        rows[j + 1] = row
    }
}

END {
    sort_rows()
    for (i = 1; i <= scan_count; i++)
        print_table(scans[i])
    print "\n### Goals\n"
    for (i = 1; i <= row_count; i++)
        print_goals(rows[i])
}

# accuracy_table.awk - turns the records of accuracy.sh into tables and a list of goals.
#
# Input, separated by tabs:
#   SCAN RATIO DETAIL SAMPLING MEAN P95 P99 MAX SHARE_ABOVE_1 SHARE_ABOVE_5 AGREEMENT
# RATIO is the voxel's size in texels, DETAIL the wavelength in voxels or "-".
{
    key = $1 SUBSEP $2 SUBSEP $3
    if (!(key in seen)) {
        seen[key] = 1
        rows[++row_count] = key
    }
    if (!($1 in listed)) {
        listed[$1] = 1
        scans[++scan_count] = $1
    }
    by_detail[$1] = $3 != "-"
    for (i = 5; i <= NF; i++)
        figure[key, $4, i - 4] = $i
}

function fraction(ratio) {
    return ratio == 0.5 ? "1/2" : ratio == 0.25 ? "1/4" : ratio
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
    printf " %s |\n", sampling == "nearest" ? sprintf("%.1f", nearest / trilinear) : ""
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
        print_row(rows[i], "trilinear")
        print_row(rows[i], "nearest")
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

END {
    for (i = 1; i <= scan_count; i++)
        print_table(scans[i])
    print "\n### Goals\n"
    for (i = 1; i <= row_count; i++)
        print_goals(rows[i])
}

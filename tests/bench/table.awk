# table.awk - turns the records of run.sh into tables and a list of goals.
#
# Input, separated by tabs:
#   run   SCAN ROUND KEY TITLE AGAINST TRIANGLES BYTES WALL USER SYSTEM RSS_KIB WRITTEN
#   fact  SCAN KEY NAME VALUE
#   skip  SCAN TITLE REASON
# AGAINST is the key of the job that KEY is compared with, or "-". All figures are medians over the
# rounds. A ratio is taken within a round, so that a machine that slows down for a while affects both
# jobs. Resident memory is the highest of all rounds.
# Variables: threads (processors), resolution.

function median(values, count,    i, j, t) {
    for (i = 2; i <= count; i++) {
        t = values[i]
        for (j = i - 1; j > 0 && values[j] > t; j--)
            values[j + 1] = values[j]
        values[j + 1] = t
    }
    if (count % 2)
        return values[(count + 1) / 2]
    return (values[count / 2] + values[count / 2 + 1]) / 2
}

function column(table, scan, key,    i, n, values) {
    for (i = 1; i <= rounds[scan]; i++)
        if ((scan, key, i) in table)
            values[++n] = table[scan, key, i]
    return n ? median(values, n) : -1
}

function ratio(scan, key, other,    i, n, values) {
    for (i = 1; i <= rounds[scan]; i++)
        if (((scan, key, i) in wall) && ((scan, other, i) in wall) && wall[scan, other, i] > 0)
            values[++n] = wall[scan, key, i] / wall[scan, other, i]
    return n ? median(values, n) : -1
}

function thousands(n,    s, out) {
    s = sprintf("%.0f", n)
    for (out = ""; length(s) > 3; s = substr(s, 1, length(s) - 3))
        out = "," substr(s, length(s) - 2) out
    return s out
}

function or_dash(format, value) {
    return value < 0 ? "-" : sprintf(format, value)
}

function print_heading(scan) {
    printf "\n### %s: %s triangles, %.2f GB of OBJ, %s\n\n", scan,
        thousands(triangles[scan, first[scan]]), bytes[scan, first[scan]] / 1e9,
        (rounds[scan] == 1) ? "one run" : "medians of " rounds[scan] " runs"
    printf row_format, "job", "ratio", "to", "triangles", "wall s", "user s", "system s", "GB/s",
        "Mtri/s", "RSS MiB", "written B/tri"
    print "|:-----------------------------|-------:|:-----------------------------" \
        "|------------:|-------:|-------:|---------:|------:|-------:|--------:|--------------:|"
}

function print_row(scan, key,    seconds, other, n) {
    seconds = column(wall, scan, key)
    other = against[scan, key]
    n = triangles[scan, key]
    printf(row_format, title[scan, key], or_dash("%.2f", ratio(scan, key, other)),
        ((scan, other) in title) ? title[scan, other] : "-", thousands(n), sprintf("%.2f", seconds),
        sprintf("%.2f", column(user, scan, key)), sprintf("%.2f", column(sys, scan, key)),
        (seconds > 0) ? sprintf("%.2f", bytes[scan, key] / seconds / 1e9) : "-",
        (seconds > 0) ? sprintf("%.1f", n / seconds / 1e6) : "-",
        sprintf("%.0f", rss[scan, key] / 1024), sprintf("%.1f", column(written, scan, key) / n))
}

function print_files(scan,    i, key, n) {
    print ""
    for (i = 1; i <= jobs[scan]; i++) {
        key = order[scan, i]
        if (!((scan, key, "voxels") in fact))
            continue
        n = triangles[scan, key]
        printf "- %s: %s voxels, .nvdb %.1f MiB (%.1f bytes a voxel)", title[scan, key],
            thousands(fact[scan, key, "voxels"]), fact[scan, key, "grid_bytes"] / 1048576,
            fact[scan, key, "grid_bytes"] / fact[scan, key, "voxels"]
        if ((scan, key, "tris_bytes") in fact)
            printf ", .tris %.2f and temporary files of sorting %.2f bytes a triangle",
                fact[scan, key, "tris_bytes"] / n, fact[scan, key, "temp_bytes"] / n
        print ""
    }
}

# Prints a line of the list of goals. The limit is "at most" if sense is -1, "at least" if it is 1.
function goal(scan, text, value, limit, sense, format) {
    if (value < 0)
        return
    printf("- %s %s: %s: " format " (%s " format ")\n",
        (sense * (value - limit) >= 0) ? "met   " : "missed", scan, text, value,
        (sense > 0) ? "at least" : "at most", limit)
}

function ratio_goal(scan, key, limit) {
    if ((scan, key) in title)
        goal(scan, title[scan, key] " / " title[scan, against[scan, key]],
            ratio(scan, key, against[scan, key]), limit, -1, "%.2f")
}

function rate_goal(scan, key, limit,    seconds) {
    seconds = column(wall, scan, key)
    if (seconds > 0)
        goal(scan, title[scan, key] ", GB/s", bytes[scan, key] / seconds / 1e9, limit, 1, "%.2f")
}

function memory_goal(scan, key, limit) {
    if ((scan, key) in title)
        goal(scan, title[scan, key] ", resident MiB", rss[scan, key] / 1024, limit, -1, "%.0f")
}

function scan_goals(scan) {
    ratio_goal(scan, "whole", 0.25)
    if (scan == "10M")
        goal(scan, title[scan, "whole"] ", seconds", column(wall, scan, "whole"), 2, -1, "%.2f")
    rate_goal(scan, "parse-1", 1)
    rate_goal(scan, "parse", threads)
    ratio_goal(scan, "parse-ply", 2)
    ratio_goal(scan, "whole-ply", 0.6)
    ratio_goal(scan, "parse-gz", 1)
    ratio_goal(scan, "whole-zst", 1)
    ratio_goal(scan, "revoxelize", 1 / 3)
    ratio_goal(scan, "shuffled", 2)
    ratio_goal(scan, "whole-256M", 2.5)
    ratio_goal(scan, "shuffled-256M", 2.5)
    memory_goal(scan, "parse-1", 64)
    memory_goal(scan, "parse", 64)
    memory_goal(scan, "whole", 1024)
    if ((scan, "whole", "tris_bytes") in fact)
        goal(scan, ".tris, bytes a triangle",
            fact[scan, "whole", "tris_bytes"] / triangles[scan, "whole"], 14, -1, "%.2f")
}

# 11.5 times as long for 109 million triangles as for 10 million, at the sizes that were measured.
function scaling_goal(    times, seconds) {
    seconds = column(wall, "10M", "whole")
    if (!(("109M", "whole") in title) || seconds <= 0)
        return
    times = triangles["109M", "whole"] / triangles["10M", "whole"]
    goal("109M", sprintf("time for %.2f times the triangles of 10M, as a multiple", times),
        column(wall, "109M", "whole") / seconds, 11.5 * times / 10.9, -1, "%.2f")
}

function see_scan(scan) {
    if (!(scan in jobs)) {
        scans[++scan_count] = scan
        jobs[scan] = 0
    }
}

BEGIN {
    FS = "\t"
    row_format = "| %-28s | %6s | %-28s | %11s | %6s | %6s | %8s | %5s | %6s | %7s | %13s |\n"
}

$1 == "run" {
    see_scan($2)
    if (!(($2, $4) in title)) {
        order[$2, ++jobs[$2]] = $4
        title[$2, $4] = $5
        against[$2, $4] = $6
        triangles[$2, $4] = $7
        bytes[$2, $4] = $8
    }
    if (!($2 in first))
        first[$2] = $4
    if ($3 > rounds[$2])
        rounds[$2] = $3
    wall[$2, $4, $3] = $9
    user[$2, $4, $3] = $10
    sys[$2, $4, $3] = $11
    if ($12 > rss[$2, $4])
        rss[$2, $4] = $12
    written[$2, $4, $3] = $13
}

$1 == "fact" { fact[$2, $3, $4] = $5 }

$1 == "skip" {
    see_scan($2)
    if (!(($2, $3) in skipped)) {
        skipped[$2, $3] = 1
        left_out[$2] = left_out[$2] "- left out: " $3 ": " $4 "\n"
    }
}

END {
    for (s = 1; s <= scan_count; s++) {
        print_heading(scans[s])
        for (i = 1; i <= jobs[scans[s]]; i++)
            print_row(scans[s], order[scans[s], i])
        print_files(scans[s])
        printf "%s", left_out[scans[s]]
    }
    printf "\n### Goals\n\n"
    for (s = 1; s <= scan_count; s++)
        scan_goals(scans[s])
    scaling_goal()
}

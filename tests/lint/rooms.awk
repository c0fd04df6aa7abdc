# Holds the includes of the product's sources against the table of rooms, rooms.txt. Reads the
# table first, then lines "FILE:#include "HEADER"" as grep prints them. Prints each include that
# is not allowed, each room that is missing and each "but" row that nothing needs; exits with 1
# if there is one.

function complain(text)
{
    print text
    bad = 1
}

# Returns the room of a file: its own row if it has one, else the row of its folder.
function room_of(file)
{
    if (file in row)
        return file
    sub(/\/[^\/]*$/, "", file)
    return file
}

# Returns whether a header's base name matches one of the door's patterns.
function is_door(room, header,    names, n, i, pattern)
{
    sub(/.*\//, "", header)
    n = split(door[room], names, " ")
    for (i = 1; i <= n; i++) {
        pattern = names[i]
        gsub(/\./, "[.]", pattern)
        gsub(/\*/, ".*", pattern)
        if (header ~ "^" pattern "$" && (room != "base" || header !~ /_internal[.]h$/))
            return 1
    }
    return 0
}

FILENAME == ARGV[1] && /^but / { except[$2 " " $3] = 1; next }
FILENAME == ARGV[1] && /^[^#]/ {
    split($0, field, "|")
    room = field[1]
    gsub(/ /, "", room)
    row[room] = ++rows
    door[room] = field[2]
    n = split(field[3], allowed, " ")
    for (i = 1; i <= n; i++) {
        may[room, allowed[i]] = 1
        if (!(allowed[i] in row))
            complain("rooms.txt: " room " may include " allowed[i] ", which is not in a row above it")
    }
    next
}
FILENAME == ARGV[1] { next }
{
    file = $0
    sub(/:.*/, "", file)
    header = $0
    sub(/^[^"]*"/, "", header)
    sub(/".*/, "", header)
    from = room_of(file)
    to = room_of(header)
    if (!(from in row))
        complain(file ": its room " from " has no row in rooms.txt")
    # A public header is a room below the folder it lies in; its own sources may include it.
    if (from == to || !(to in row) || header == from)
        next
    used[from, to] = 1
    if ((file " " header) in except) {
        delete except[file " " header]
        next
    }
    if (!((from, to) in may))
        complain(file ": includes " header ", but " from " may not include " to)
    else if (!is_door(to, header))
        complain(file ": includes " header ", which is private to " to)
}
END {
    for (pair in except)
        complain("rooms.txt: nothing needs the row: but " pair)
    for (pair in may)
        if (!(pair in used)) {
            split(pair, ends, SUBSEP)
            complain("rooms.txt: " ends[1] " does not include " ends[2])
        }
    exit bad
}

# Prints each static function that several files define, with these files. Names between files of
# rooms that match `later` do not count.

# Returns the name of the function that begins with `text`, "" if it is a variable.
function name_of(text) {
    gsub(/__attribute__\(\([a-z_]*\)\)/, "", text)
    if (text !~ /\(/ || text ~ /^[^(]*=/)
        return ""
    sub(/\(.*/, "", text)
    sub(/.*[^A-Za-z_0-9]/, "", text)
    return text
}
function add(name) {
    if (name == "" || (name, FILENAME) in seen)
        return
    seen[name, FILENAME] = 1
    files[name] = files[name] " " FILENAME
    count[name]++
    strict[name] += FILENAME !~ later
}
FNR == 1 { start = "" }
# The type of a function may have a line of its own.
start != "" && /^[A-Za-z_]/ && !/^static/ {
    add(name_of(start " " $0))
    start = ""
}
/^static / {
    start = /\(/ && name_of($0) != "" || /[;={]/ ? "" : $0
    if (start == "")
        add(name_of($0))
    functions++
}
END {
    for (name in count)
        if (count[name] > 1 && strict[name]) {
            print "static " name "() is in" files[name] ": name one of them by its file's subject"
            bad = 1
        }
    if (!functions) {
        print "statics: no files"
        bad = 1
    }
    exit bad
}

# Flattens the local #includes of an OpenCL source, each file once, into C string literals.
# System headers and those of base/ are only for the C build of the kernel and are left to it.
function emit(path, directory,    line, name) {
    if (path in seen)
        return
    seen[path] = 1
    while ((status = (getline line < path)) > 0) {
        if (line ~ /^#include "base\//)
            continue
        if (line ~ /^#include "/) {
            name = line
            sub(/^#include "/, "", name)
            sub(/".*/, "", name)
            emit(directory name, directory)
            continue
        }
        gsub(/\\/, "&&", line)
        gsub(/"/, "\\\"", line)
        printf "\"%s\\n\"\n", line
    }
    if (status < 0) {
        print "cannot read " path > "/dev/stderr"
        exit 1
    }
    close(path)
}

BEGIN {
    directory = ARGV[1]
    sub(/[^\/]*$/, "", directory)
    emit(ARGV[1], directory)
    exit 0
}

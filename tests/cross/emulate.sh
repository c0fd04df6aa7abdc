#!/bin/sh
# Copies a cross build so that its programs run under qemu-user: each becomes a script that starts
# qemu with the program itself, which lies beside the script's folder. Programs that these start,
# such as bisque-gltf, are scripts too.
#
#   tests/cross/emulate.sh BUILD SYSROOT TO
set -eu
build=$1 sysroot=$(cd "$2" && pwd) processor=$(basename "$2")
qemu=qemu-${processor%%-*}-static
rm -rf "$3"
mkdir -p "$3"
to=$(cd "$3" && pwd)
cp -rl "$build/bin" "$build/lib" "$build/share" "$build/tests" "$to"
find "$to" -type f -perm -u+x ! -name '*.so*' | while read -r program; do
    folder=$(dirname "$program").program
    mkdir -p "$folder"
    mv "$program" "$folder"
    printf '#!/bin/sh\nexec %s -L %s %s/%s "$@"\n' "$qemu" "$sysroot" "$folder" "${program##*/}" >"$program"
    chmod +x "$program"
done

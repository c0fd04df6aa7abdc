#!/bin/sh
# Unpacks Debian packages of another architecture, and all that they depend on, into a folder. This
# machine's own packages and lists stay as they are.
#
#   tests/cross/sysroot.sh DIRECTORY ARCHITECTURE PACKAGE...
set -eu
sysroot=$1 architecture=$2
shift 2
rm -rf "$sysroot"
mkdir -p "$sysroot/usr/lib" "$sysroot/apt/state/lists/partial" "$sysroot/apt/cache/archives/partial"
ln -s usr/lib "$sysroot/lib"
cd "$sysroot"
: >apt/status
cat >apt/conf <<CONF
APT::Architecture "$architecture";
APT::Architectures { "$architecture"; };
APT::Install-Recommends "false";
Dir::State "$PWD/apt/state";
Dir::State::status "$PWD/apt/status";
Dir::Cache "$PWD/apt/cache";
CONF
export APT_CONFIG="$PWD/apt/conf"
apt-get update -qq
apt-get install -qq --download-only "$@" >/dev/null
for package in apt/cache/archives/*.deb; do
    dpkg-deb --fsys-tarfile "$package" | tar -x --keep-directory-symlink \
        --wildcards --exclude='./usr/share/doc*' --exclude='./usr/share/locale*'
done
# Absolute links would leave the folder.
find . -type l -lname '/*' | while read -r link; do
    ln -sfn "$PWD$(readlink "$link")" "$link"
done
# Debian's alternatives, which no package here sets up.
for library in blas lapack; do
    for file in usr/lib/*/$library/lib$library.so.3; do
        [ ! -e "$file" ] || ln -sfn "$library/${file##*/}" "${file%/*/*}/${file##*/}"
    done
done
rm -rf apt

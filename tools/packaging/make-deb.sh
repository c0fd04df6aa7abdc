#!/bin/sh
# make-deb.sh TAR FOLDER - builds the Debian packages of a tar of `make dist` and puts them into a
# folder. Their date is the date of the files in the tar, so equal tars give equal packages.
set -eu
[ $# -eq 2 ] || { echo "usage: make-deb.sh TAR FOLDER" >&2; exit 64; }
name=$(basename "$1" .tar.gz)
unset MAKEFLAGS MAKEOVERRIDES # of a make that called this script
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
tar -xzf "$1" -C "$work"
top=$work/$name
mv "$top/tools/packaging/debian" "$top/debian"
SOURCE_DATE_EPOCH=$(stat -c %Y "$top/Makefile")
export SOURCE_DATE_EPOCH
sed -e "s/@version@/${name#bisque-}/; s/@date@/$(LC_ALL=C date -uR -d "@$SOURCE_DATE_EPOCH")/" \
    "$top/debian/changelog.in" >"$top/debian/changelog"
packages=$(make -s --no-print-directory -C "$top" print-packages | sed 's/ /, /g')
sed "s/@packages@/$packages/" "$top/debian/control.in" >"$top/debian/control"
rm "$top"/debian/*.in
(cd "$top" && dpkg-buildpackage --build=binary --no-sign)
mkdir -p "$2"
mv "$work"/*.deb "$work"/*.changes "$work"/*.buildinfo "$2"

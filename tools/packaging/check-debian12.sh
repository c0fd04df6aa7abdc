#!/bin/bash
# check-debian12.sh [--no-tests] [FOLDER] - proves that a fresh Debian 12 is enough. As root:
#
# 1. makes a minimal Debian 12 with debootstrap, from the mirror that this machine's apt uses, or
#    from the mirror in $MIRROR;
# 2. with only git and make added, unpacks a tar of `make dist`, runs `make check` in it, and builds
#    the packages with `make deb`;
# 3. installs the packages into another fresh Debian 12, and runs the commands of README.md there on
#    a generated scan.
#
# Works in FOLDER (default: a new folder in /var/tmp) and removes it if all went well.
set -eu
top=$(cd "$(dirname "$0")/../.." && pwd)
tests=1
[ "${1-}" != --no-tests ] || { tests=; shift; }
folder=${1:-$(mktemp -d /var/tmp/bisque-debian12.XXXXXX)}
mirror=${MIRROR:-$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' \
    2>/dev/null | head -n 1)}
mkdir -p "$folder"
step() { echo "== $*"; }

# inside NAME COMMAND: runs a shell command in a system.
inside()
{
    chroot "$folder/$1" /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C \
        DEBIAN_FRONTEND=noninteractive sh -euc "$2"
}
unmount()
{
    for system in build clean; do
        for mount in proc dev/pts dev; do
            ! mountpoint -q "$folder/$system/$mount" || umount "$folder/$system/$mount"
        done
    done
}
trap unmount EXIT

# start NAME: a copy of the minimal system, with its file systems and the machine's name servers.
start()
{
    cp -a "$folder/base" "$folder/$1"
    cp -L /etc/resolv.conf "$folder/$1/etc/resolv.conf"
    mount -t proc proc "$folder/$1/proc"
    mount --bind /dev "$folder/$1/dev"
    mount -t devpts devpts "$folder/$1/dev/pts"
    inside "$1" 'apt-get update -qq'
}

step "a minimal Debian 12"
[ -e "$folder/base/etc/debian_version" ] ||
    debootstrap --variant=minbase bookworm "$folder/base" ${mirror:+"$mirror"} >"$folder/log"
rm -rf "$folder/build" "$folder/clean"

step "make dist"
make -C "$top" --no-print-directory dist
tar=$(ls -t "$top"/build/dist/bisque-*.tar.gz | head -n 1)
name=$(basename "$tar" .tar.gz)

start build
inside build 'apt-get install -y -qq --no-install-recommends git make >/dev/null'
tar -xzf "$tar" -C "$folder/build/root"
cp "$tar" "$folder/build/root"
if [ -n "$tests" ]; then
    step "make check, with git and make alone to begin with"
    inside build "cd /root/$name && make check"
else
    step "make, with git and make alone to begin with"
    inside build "cd /root/$name && make deps && make -j$(nproc) all build/release/tests/generate-scan"
fi
step "make deb"
inside build "cd /root/$name && make deps-deb && tools/packaging/make-deb.sh /root/$name.tar.gz /root/deb"

step "the packages in a clean Debian 12, and the commands of README.md"
start clean
cp "$folder"/build/root/deb/*.deb "$folder/clean/root"
cp "$folder/build/root/$name/build/release/tests/generate-scan" "$folder/clean/root"
inside clean 'apt-get install -y -qq --no-install-recommends /root/*.deb >/dev/null'
# Indented lines that start a program, with the lines that continue them; at a smaller size.
awk '/^    bisque-/ || more { print; more = /\\$/ }' "$top/README.md" | sed 's/4096/512/g' \
    >"$folder/clean/root/commands"
inside clean 'cd /root && ./generate-scan --triangles 200000 --colors vase -o statue.obj &&
    ./generate-scan vase-low -o statue_low.obj && cat commands && . ./commands && ls -l *.exr'
echo "check-debian12: ok"
unmount
rm -rf "$folder"

#!/bin/bash
# check-debian12.sh [--no-tests] [FOLDER] - shows that a fresh Debian 12 is enough:
#
# 1. makes a minimal Debian 12 with debootstrap and adds git and make;
# 2. clones the last commit there, runs `make deps` as root, and `make check` and `make deb` as an
#    ordinary user; builds the packages twice, compares them, and runs lintian on them;
# 3. installs the packages in a second fresh Debian 12; an ordinary user voxelizes and bakes a small
#    scan there, and compiles the examples; removing the packages must leave no file.
#
# Needs root, debootstrap, about 4 GB in FOLDER (default: a new folder in /var/tmp) and a Debian
# mirror, $MIRROR (default: deb.debian.org). A minimal system in FOLDER/base is used again. FOLDER is
# removed if all went well and the script made it.
set -eu
# Mounts are private, and they and all processes end with this script.
[ -n "${BISQUE_PRIVATE_MOUNTS-}" ] ||
    BISQUE_PRIVATE_MOUNTS=1 exec unshare --mount --pid --fork --kill-child "$0" "$@"
trap 'exit 130' INT TERM # the first process of a namespace ignores them otherwise
top=$(cd "$(dirname "$0")/../.." && pwd)
tests=yes
[ "${1-}" != --no-tests ] || { tests='' && shift; }
made=
[ $# -gt 0 ] || made=yes
folder=${1:-$(mktemp -d /var/tmp/bisque-debian12.XXXXXX)}
mkdir -p "$folder/archives/partial"
step() { echo "== $*"; }
fail() { echo "check-debian12: $*" >&2; exit 1; }

# inside NAME USER COMMAND: runs a shell command in a system.
inside()
{
    local home=/home/$2
    [ "$2" != root ] || home=/root
    chroot --userspec="$2:$2" "$folder/$1" /usr/bin/env -i HOME="$home" LC_ALL=C USER="$2" \
        PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive \
        bash -euc "cd $home; $3"
}

# start NAME USER: a fresh copy of the minimal system, with an ordinary user.
start()
{
    rm -rf --one-file-system "${folder:?}/$1"
    cp -a "$folder/base" "$folder/$1"
    cp -L /etc/resolv.conf "$folder/$1/etc/resolv.conf"
    mount -t proc proc "$folder/$1/proc"
    mount --bind -o ro /sys "$folder/$1/sys"
    mount -t devpts -o newinstance,ptmxmode=0666 devpts "$folder/$1/dev/pts"
    mount -t tmpfs tmpfs "$folder/$1/dev/shm"
    # Both systems need the same packages.
    mount --bind "$folder/archives" "$folder/$1/var/cache/apt/archives"
    echo force-unsafe-io >"$folder/$1/etc/dpkg/dpkg.cfg.d/unsafe-io" # several times as fast
    inside "$1" root "apt-get update -qq && useradd --create-home $2"
}

step "a minimal Debian 12"
if [ ! -e "$folder/base/complete" ]; then
    rm -rf --one-file-system "$folder/base"
    debootstrap --variant=minbase bookworm "$folder/base" \
        "${MIRROR:-http://deb.debian.org/debian}" >"$folder/debootstrap.log" ||
        fail "debootstrap failed, see $folder/debootstrap.log"
    touch "$folder/base/complete"
fi

step "a clone of $(git -C "$top" log -1 --format='%h, %s'), with git and make alone"
start build builder
inside build root 'apt-get install -y -qq --no-install-recommends git make >/dev/null'
git clone --quiet --depth 1 "file://$top" "$folder/build/home/builder/bisque"
inside build root 'chown -R builder:builder /home/builder'
inside build root 'make -s -C /home/builder/bisque deps'
if [ -n "$tests" ]; then
    step "make check"
    inside build builder 'make -C bisque check'
fi
step "make deb"
inside build root 'make -s -C /home/builder/bisque deps-deb &&
    apt-get install -y -qq --no-install-recommends lintian >/dev/null'
inside build builder 'make -C bisque deb >deb.log 2>&1 || { tail -n 50 deb.log; exit 1; }
    make -s -C bisque build/release/tests/generate-scan
    ls -l bisque/build/deb/*.deb'
step "the same packages from another build"
inside build builder 'bisque/tools/packaging/make-deb.sh bisque/build/dist/bisque-*.tar.gz again >deb.log 2>&1
    for package in again/*.deb; do cmp "$package" "bisque/build/deb/$(basename "$package")"; done'
step "lintian"
inside build builder 'lintian --display-info --pedantic --fail-on error,warning,info,pedantic \
    bisque/build/deb/*.changes'

step "the packages in a second Debian 12"
start clean artist
built=$folder/build/home/builder/bisque
cp "$built"/build/deb/*bisque*_*.deb "$folder/clean/root"
cp "$built"/build/release/tests/generate-scan "$folder/clean/home/artist"
inside clean root 'rm *-dbgsym_*; apt-get install -y -qq --no-install-recommends ./*.deb >/dev/null'
inside clean root 'dpkg -L bisque libbisque0 libbisque-dev >installed; dpkg -V bisque libbisque0 libbisque-dev'
for page in "$top"/man/*.1; do
    gzip -dc "$folder/clean/usr/share/man/man1/$(basename "$page").gz" | cmp - "$page"
done
[ "$(stat -c %a "$folder/clean/usr/lib/bisque/bisque-devices")" = 755 ] ||
    fail "bisque-devices has not the mode 755"
inside clean artist '
    ./generate-scan --triangles 200000 --colors vase -o statue.obj
    ./generate-scan vase-low -o statue_low.obj
    printf "P3\n1 1\n255\n255 0 0\n" >red.ppm
    bisque-voxelize statue.obj -o statue.nvdb --resolution 256 --vdb statue.vdb
    bisque-voxelize statue_low.obj -o red.nvdb --resolution 32 --texture red.ppm
    bisque-bake --list devices
    bisque-bake statue.nvdb statue_low.obj --maps normal,color --size 512 -o "grid_<MAP>.exr"
    bisque-bake statue.tris statue_low.obj --maps normal,color --size 512 -o "exact_<MAP>.exr"
    bisque-compare grid_normal.exr exact_normal.exr
    ls -l grid_normal.exr grid_color.exr exact_normal.exr exact_color.exr statue.vdb red.nvdb'
step "the examples, compiled with libbisque-dev"
inside clean root 'apt-get install -y -qq --no-install-recommends gcc libc6-dev pkg-config >/dev/null'
inside clean artist '
    for source in /usr/share/doc/libbisque-dev/examples/*.c; do
        gcc -o $(basename $source .c) $source $(pkg-config --cflags --libs bisque)
    done
    ./voxelize_scan statue.obj own.tris own.nvdb 64
    ./bake_maps own.nvdb statue_low.obj "own_<MAP>.png" 64'
step "removing the packages"
inside clean root 'apt-get purge -y -qq bisque libbisque0 libbisque-dev >/dev/null
    grep -vFx /. installed | while read -r name; do
        [ ! -e "$name" ] || { [ -d "$name" ] && dpkg -S "$name" >/dev/null 2>&1; } || echo "$name"
    done >left
    find / -xdev -name "*bisque*" ! -path "/root/*" ! -path "/home/*" ! -path "/var/cache/apt/*" >>left
    [ ! -s left ] || { echo "left behind:"; cat left; exit 1; }'
for system in build clean; do
    umount "$folder/$system"/{proc,sys,dev/pts,dev/shm,var/cache/apt/archives}
done
[ -z "$made" ] || rm -rf --one-file-system "$folder"
echo "check-debian12: ok"

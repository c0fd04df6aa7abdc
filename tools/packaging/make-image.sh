#!/bin/bash
# make-image.sh DEB FILE - makes an OCI image of Bisque's Debian package, as an archive with zstd layers that podman, docker
# and skopeo read. Needs root, debootstrap, buildah and a Debian mirror, $MIRROR, but no registry.
#
# The package and what it depends on are installed in a minimal Debian 12. Documents, and libraries that
# no program in it links, are removed: OpenImageIO alone brings 500 MB, such as video codecs and drivers for
# displays. An ordinary user, 1000, runs the programs; /work is where a farm mounts its folder.
set -eu
[ $# -eq 2 ] || { echo "usage: make-image.sh DEB FILE" >&2; exit 64; }
version=$(dpkg-deb -f "$1" Version)
folder=${IMAGE_FOLDER:-$(mktemp -d /var/tmp/bisque-image.XXXXXX)} # a system in it is used again
root=$folder/root
export STORAGE_DRIVER=vfs BUILDAH_ISOLATION=chroot
buildah() { command buildah --root "$folder/storage" --runroot "$folder/run" "$@"; }
inside() { chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive bash -euc "$1"; }
[ -n "${IMAGE_FOLDER-}" ] || trap 'rm -rf --one-file-system "$folder"' EXIT

[ -e "$folder/base/etc/debian_version" ] ||
    debootstrap --variant=minbase bookworm "$folder/base" "${MIRROR:-http://deb.debian.org/debian}" >/dev/null
rm -rf --one-file-system "$root"
cp -a "$folder/base" "$root"
cp "$1" "$root/tmp/bisque.deb"
cp -L /etc/resolv.conf "$root/etc/resolv.conf"
echo force-unsafe-io >"$root/etc/dpkg/dpkg.cfg.d/image"
inside 'apt-get update -qq
    apt-get install -y -qq --no-install-recommends /tmp/bisque.deb >/dev/null
    useradd --uid 1000 --create-home bisque && install -d -o bisque /work'
# Licences stay. Then the libraries that no program links go; those of NSS are opened by name.
inside 'find /usr/share/doc -type f ! -name copyright -delete
    find /usr/share -mindepth 1 -maxdepth 1 ! -name doc ! -name bisque ! -name common-licenses -exec rm -rf {} +
    rm -rf /tmp/* /var/lib/{apt,dpkg} /var/cache/* /var/log/* /usr/lib/{apt,dpkg,x86_64-linux-gnu/{gconv,perl*,dri}}
    rm -f /usr/bin/{perl*,apt*,dpkg*,gpg*} /usr/sbin/* /usr/lib/x86_64-linux-gnu/*.a
    find /usr/bin /usr/lib/bisque -type f | while read -r file; do ldd "$file" 2>/dev/null || true; done |
    sed -n "s/.*=> \(\/[^ ]*\) .*/\1/p" | sort -u | while read -r file; do readlink -f "$file"; done | sort -u >/tmp/linked
    find /usr/lib/x86_64-linux-gnu -type f -name "*.so*" ! -name "libnss_*" ! -name "ld-linux*" |
        sort | comm -23 - /tmp/linked | xargs -r rm
    find /usr/lib/x86_64-linux-gnu -xtype l -delete
    rm /tmp/linked'
rm "$root/etc/resolv.conf"

container=$(buildah from scratch)
buildah copy -q "$container" "$root" / >/dev/null
buildah config --user 1000:1000 --workingdir /work --env PATH=/usr/bin:/bin --cmd '["bisque-bake", "--help"]' \
    --label org.opencontainers.image.title=bisque --label org.opencontainers.image.version="$version" \
    --label org.opencontainers.image.licenses=Apache-2.0 "$container"
buildah run "$container" -- bisque-voxelize --version
buildah commit -q --timestamp "${SOURCE_DATE_EPOCH:-0}" "$container" "bisque:$version" >/dev/null
# With gzip, the image has 154 MB.
buildah push -q --compression-format zstd --compression-level 9 "bisque:$version" "oci-archive:$2:bisque:$version"
buildah rm "$container" >/dev/null
bytes=$(stat -c %s "$2")
echo "$2: $((bytes / 1000000)) MB, $(du -sm "$root" | cut -f1) MiB unpacked"
[ "$bytes" -lt 150000000 ] || { echo "make-image.sh: larger than 150 MB" >&2; exit 1; }

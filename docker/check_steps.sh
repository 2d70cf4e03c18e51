#!/bin/sh
# Run the RUN steps of a Dockerfile in a clean Debian root, without Docker: shows that the README's steps work.
#
#   sudo docker/check_steps.sh [Dockerfile] [folder for the root]
#
# Needs root, debootstrap and a network. The root is made once and kept; everything else happens in a copy of it.
# Settings of pip and apt that this machine has in the environment (proxies, certificates, mirrors) are handed on.
set -eu

# in a mount namespace of its own, so that nothing of this machine can stay bound into a root that is removed later
if [ -z "${CAPTURE_EVAL_OWN_MOUNTS:-}" ]; then
    CAPTURE_EVAL_OWN_MOUNTS=1 exec unshare --mount --propagation private "$0" "$@"
fi

dockerfile=${1:-docker/Dockerfile}
folder=${2:-build/clean-root}
suite=bookworm
source=$(cd "$(dirname "$0")/.." && pwd)

mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
if [ ! -d "$folder/base/usr" ]; then
    debootstrap --variant=minbase "$suite" "$folder/base"
fi
rm -rf "$folder/root"
cp -a "$folder/base" "$folder/root"
root=$folder/root

mount -t proc proc "$root/proc"
cp /etc/resolv.conf "$root/etc/resolv.conf"
[ ! -f /etc/hosts ] || cp /etc/hosts "$root/etc/hosts"
for settings in /etc/apt/apt.conf.d/*proxy* /etc/pip.conf; do
    [ ! -f "$settings" ] || cp "$settings" "$root$settings"
done

if [ -f /etc/ssl/certs/ca-certificates.crt ]; then
    mkdir -p "$root/etc/ssl/certs"
    cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/host.crt"
fi
clean_environment="PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8"
clean_environment="$clean_environment PIP_CERT=/etc/ssl/certs/host.crt SSL_CERT_FILE=/etc/ssl/certs/host.crt"
for name in http_proxy https_proxy no_proxy HTTP_PROXY HTTPS_PROXY NO_PROXY PIP_INDEX_URL; do
    value=$(printenv "$name" || true)
    [ -z "$value" ] || clean_environment="$clean_environment $name=$value"
done

# COPY . . : what git has, as a fresh clone would have it
target=$(sed -n 's/^WORKDIR \(\/opt\/.*\)/\1/p' "$dockerfile" | head -n 1)
mkdir -p "$root$target"
git -C "$source" archive HEAD | tar -x -C "$root$target"

# join continued lines, then run every RUN step in order
sed -e ':a' -e '/\\$/N; s/\\\n//; ta' "$dockerfile" | while IFS= read -r line; do
    case $line in
        "# step:"*) echo "== ${line#\# step: }" ;;
        "RUN "*)
            echo "+ ${line#RUN }"
            started=$(date +%s)
            # shellcheck disable=SC2086 # one word for each setting
            env -i $clean_environment chroot "$root" /bin/sh -ec "cd $target 2>/dev/null || cd /; ${line#RUN }" < /dev/null
            echo "  ($(($(date +%s) - started)) s)"
            ;;
    esac
done
echo "all steps of $dockerfile work in a clean $suite root"

#!/usr/bin/env bash
# PATH on a 64-bit ARM computer, tried without one: an aarch64 Debian under qemu's user-mode emulation.
#
#   sudo install/arm/try.sh FOLDER [STEP ...]
#
# FOLDER is where the root is made and kept (4 GB); a second run goes on in it. Steps, all of them unless named:
#   root     a minimal Debian of this computer's own release, from the mirror that its apt uses
#   setup    this tree's files into it, then the README's own set-up, and what the tests need
#   doctor   `path-handoff doctor`, for this computer and for the rig `sim`
#   prepare  the kernels of a drone's own program, compiled
#   sim      one whole handoff at level `sim`
#   tests    the method's tests
# Each step's output goes to FOLDER/results/STEP.txt, and a line of how it ended and how long it took to results/steps.txt.
#
# Needs: Debian's debootstrap and qemu-user-static, root (for chroot and binfmt_misc).
# QEMU_CPU names the processor (default: the Jetson Nano's cortex-a57), SUITE another release, MIRROR another mirror.
# Nothing is left mounted but the kernel's own binfmt_misc; the emulator's registration goes again when this script made it.
set -euo pipefail

tree=$(cd "$(dirname "$0")/../.." && pwd)
[ $# -ge 1 ] || { sed -n '2,17s/^# \{0,1\}//p' "$0"; exit 3; }
mkdir -p "$1"
folder=$(cd "$1" && pwd)
shift
root=$folder/root results=$folder/results
mkdir -p "$results"
export QEMU_CPU=${QEMU_CPU:-cortex-a57}

refuse() { echo "$1" >&2; exit 3; }
[ "$(id -u)" = 0 ] || refuse "root is needed, for chroot: sudo $0 $folder"
for tool in debootstrap qemu-aarch64-static unshare; do
    command -v "$tool" > /dev/null || refuse "$tool is missing: apt install debootstrap qemu-user-static util-linux"
done

# The kernel is told how aarch64 programs are run, for as long as this script runs, unless it knows already.
misc=/proc/sys/fs/binfmt_misc
[ -e $misc/register ] || mount -t binfmt_misc binfmt_misc $misc || refuse "binfmt_misc cannot be mounted"
if [ "$(uname -m)" != aarch64 ] && [ ! -e $misc/qemu-aarch64 ]; then
    cat /usr/lib/binfmt.d/qemu-aarch64.conf > $misc/register || refuse "the kernel does not take qemu's registration"
    trap 'echo -1 > $misc/qemu-aarch64' EXIT
fi

# In the root, with its own /proc and /dev that are gone afterwards, and nothing of this shell's environment.
inside() {
    env -i PATH=/tree/.venv/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 QEMU_CPU="$QEMU_CPU" \
        SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt UV_LINK_MODE=copy ROOT="$root" \
        unshare --mount --propagation private sh -euc '
            mount -t proc proc "$ROOT/proc"; mount --rbind /dev "$ROOT/dev"; mount -t tmpfs tmpfs "$ROOT/dev/shm"
            exec chroot "$ROOT" /bin/bash -euc "cd /tree && $1"' sh "$1"
}

step_root() {
    if [ ! -e "$root/etc/debian_version" ]; then
        mirror=${MIRROR:-$(apt-get indextargets --format '$(REPO_URI) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' |
            awk '$3 == "main" && $2 !~ /-/ { print $1; exit }')}
        debootstrap --arch=arm64 --variant=minbase --include=python3-venv,ca-certificates \
            "${SUITE:-$(. /etc/os-release && echo "$VERSION_CODENAME")}" "$root" "$mirror"
    fi
    cp /etc/resolv.conf "$root/etc/resolv.conf"
    cp --dereference /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/ca-certificates.crt"
    # pip's index, where this computer names one; folders of this computer's own are not there
    index=$(python3 -m pip config get global.index-url 2> /dev/null || true)
    printf '[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n%s\n' "${index:+index-url = $index}" > "$root/etc/pip.conf"
    printf '%s' "${index:+index-url = \"$index\"}" > "$root/etc/uv-index.toml"
    mkdir -p "$root/etc/uv" "$root/tree" && mv "$root/etc/uv-index.toml" "$root/etc/uv/uv.toml"
    inside 'uname -m; python3 --version; ldd --version | head -1; nproc'
}

step_setup() {
    (cd "$tree" && git ls-files -z --cached --others --exclude-standard | tar --null -c -T - ) | tar -x -C "$root/tree"
    # The first of the README's two set-ups, without the flight behind it.
    line=$(grep -m1 '^python3 -m venv .* && \.venv/bin/path-handoff handoff$' "$tree/README.md")
    inside "${line% && *}"
    inside '.venv/bin/uv pip install -q --python .venv/bin/python -c constraints.txt pytest pytest-xdist hypothesis && .venv/bin/uv pip list --python .venv/bin/python'
}

# Of the rig `sitl`, which flies on pyrealsense2, it may find a fault: that is what it is for.
step_doctor() { inside 'path-handoff doctor || echo "exit code $?"; path-handoff doctor --rig sim'; }

step_prepare() { inside 'path-handoff prepare --rig sim && time path-handoff --help | tail -1'; }

step_sim() { inside 'path-handoff handoff --rig sim --seed 7 --out /tree/runs/arm'; }

step_tests() { inside 'pytest tests/path --durations=15'; }

TIMEFORMAT='%R s, %U s of processor time'
run() {
    local took code
    code=0
    took=$( { time ("step_$1" > "$results/$1.txt" 2>&1) || exit $?; } 2>&1 ) || code=$?
    echo "$1: exit code $code, $took" | tee -a "$results/steps.txt"
    return $code
}

steps=("$@")
[ ${#steps[@]} -gt 0 ] || steps=(root setup doctor prepare sim tests)
worst=0
for step in "${steps[@]}"; do
    declare -F "step_$step" > /dev/null || refuse "there is no step '$step'"
    set +e
    run "$step"
    code=$?
    set -e
    [ $code = 0 ] || worst=$code
    # without a root or a set-up nothing that follows means anything
    case $code,$step in 0,*) ;; *,root | *,setup) tail -5 "$results/$step.txt" >&2; exit "$code" ;; esac
done
exit "$worst"

#!/usr/bin/env bash
# Which of PATH's dependencies, at the pinned versions, have a wheel for aarch64: a table by Python and by glibc.
#
#   install/arm/wheels.sh [PYTHON ...]        needs uv (as after the README's set-up); asks the package index, installs nothing
#
# A cell is "all" when everything that PATH needs there comes as a wheel, else what does not. pyrealsense2 is asked for
# by itself: where it has none PATH is installed without it.
set -uo pipefail
cd "$(dirname "$0")/../.."
[ -x .venv/bin/uv ] && PATH=$PWD/.venv/bin:$PATH
pythons=("$@")
[ ${#pythons[@]} -gt 0 ] || pythons=(3.11 3.12 3.13 3.14)
glibcs=(2_17 2_28 2_39)
realsense=$(grep -o '^pyrealsense2==[0-9.]*' constraints.txt)

resolve() { # what to resolve, and for which Python and glibc
    uv pip compile -q --no-header --no-annotate --only-binary :all: "$1" -c constraints.txt \
        --python-version "$2" --python-platform "aarch64-manylinux_$3" 2>&1
}

printf '| Python |'; printf ' glibc %s |' "${glibcs[@]/_/.}"; printf ' pyrealsense2 |\n|---|'
printf -- '---|%.0s' "${glibcs[@]}"; printf -- '---|\n'
for python in "${pythons[@]}"; do
    printf '| %s |' "$python"
    for glibc in "${glibcs[@]}"; do
        if said=$(resolve pyproject.toml "$python" "$glibc"); then
            printf ' all |'
        else
            printf ' not %s |' "$(tr '\n' ' ' <<< "$said" | grep -oE '[a-z0-9_-]+(==[0-9.a-z]+)? has no (usable )?wheels' | head -1 | cut -d' ' -f1)"
        fi
    done
    only=$(mktemp --suffix=.in)
    printf '%s\n' "$realsense" > "$only"
    resolve "$only" "$python" 2_39 > /dev/null && printf ' yes |\n' || printf ' no |\n'
    rm -f "$only"
done

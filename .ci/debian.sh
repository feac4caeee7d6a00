#!/usr/bin/env bash
# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
# A dry run of the release into a distribution: bloom's templates make debian/ from package.xml, dpkg-buildpackage builds the package, and dpkg
# installs it, with empty packages in the place of those it depends on, into a folder where its commands run. Needs debhelper, dh-python,
# python3-all and fakeroot; ROSDISTRO names a checkout of github.com/ros/rosdistro for a machine without network.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$PWD/.venv/bin/python ros=${ROS:-jazzy}
. /etc/os-release
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "check-deb: $1"; exit 1; }
for tool in dh dpkg-buildpackage fakeroot; do
    command -v $tool > /dev/null || fail "$tool is not installed: apt install debhelper dh-python python3-all fakeroot"
done
bloom=$PWD/build/bloom
[ -x "$bloom/bin/bloom-generate" ] || { "$python" -m venv "$bloom" && "$bloom/bin/pip" install --quiet bloom==0.14.4; }

mkdir "$work/home" "$work/sources" "$work/build"
export HOME=$work/home
if [ -n "${ROSDISTRO:-}" ]; then
    printf "yaml file://$ROSDISTRO/rosdep/%s.yaml\n" base python > "$work/sources/20-default.list"
    export ROSDEP_SOURCE_PATH=$work/sources ROSDISTRO_INDEX_URL=file://$ROSDISTRO/index-v4.yaml
fi
PYTHONPATH=.ci "$python" -c 'import sys, pathlib, sources; sources.copy_sources(pathlib.Path(sys.argv[1]))' "$work/build/package"
cd "$work/build/package"
PATH=$bloom/bin:$PATH
rosdep update --rosdistro "$ros" > ../rosdep.txt 2>&1 || { cat ../rosdep.txt; fail "rosdep has no rules"; }
bloom-generate rosdebian --os-name "$ID" --os-version "$VERSION_CODENAME" --ros-distro "$ros" < /dev/null > ../bloom.txt 2>&1 ||
    { cat ../bloom.txt; fail "bloom does not find a dependency, or a template does not fit"; }

# The system's Python builds, not an environment's; tests need ROS and are not part of it.
DEB_BUILD_PROFILES=nocheck DEB_BUILD_OPTIONS=nocheck PATH=/usr/sbin:/usr/bin:/sbin:/bin dpkg-buildpackage -b -us -uc > ../build.txt 2>&1 ||
    { tail -40 ../build.txt; fail "the package cannot be built"; }
deb=$(echo ../*.deb)

IFS=', ' read -r -a needed <<< "$(dpkg-deb -f "$deb" Depends)"
root=$work/root
mkdir -p "$root/var/lib/dpkg/info" "$root/var/lib/dpkg/updates" ../stubs
touch "$root/var/lib/dpkg/status"
for name in "${needed[@]}"; do
    [[ $name == ros-* ]] || apt-cache show "$name" > /dev/null 2>&1 || fail "$ID $VERSION_CODENAME has no package $name"
    mkdir -p "../stub/DEBIAN"
    printf 'Package: %s\nVersion: 1\nArchitecture: all\nMaintainer: nobody\nDescription: stub\n' "$name" > ../stub/DEBIAN/control
    dpkg-deb --build ../stub "../stubs/$name.deb" > /dev/null
done
fakeroot dpkg --force-script-chrootless --root="$root" --install ../stubs/*.deb "$deb" > ../install.txt 2>&1 ||
    { tail -20 ../install.txt; fail "the package cannot be installed"; }

prefix=$root/opt/ros/$ros
export AMENT_PREFIX_PATH=$prefix PYTHONPATH=$(echo "$prefix"/lib/python3*/site-packages)
cd "$work"
[[ $("$python" -c 'import hyst_control; print(hyst_control.__file__)') == "$prefix"/* ]] || fail "another hyst_control is imported"
model=$("$python" -c 'from hyst_control.base.config_files import config_path; print(config_path("models/pea_hampi.yaml"))')
[[ $model == "$prefix"/* ]] || fail "the model files of the package are not found, but $model"
"$python" "$prefix/lib/hyst_control/hyst" simulate "$model" --excitation sine frequency=10 amplitude=2 duration=0.2 --output simulated --quiet > /dev/null
echo "check-deb: ${deb##*/} builds from bloom's templates, installs beside ${#needed[@]} dependencies, and simulates"

#!/usr/bin/env bash
# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
# Compilers and checkers that the tests of the exported C use: installed where this is Debian and we may, named where not. The tests of what
# is missing are skipped.
set -uo pipefail
packages=()
for pair in gcc:gcc clang:clang cppcheck:cppcheck qemu-arm:qemu-user arm-linux-gnueabihf-gcc:gcc-arm-linux-gnueabihf; do
    command -v "${pair%%:*}" > /dev/null || packages+=("${pair#*:}")
done
# Debian's clang comes without the libraries of its sanitizers.
if ! command -v clang > /dev/null; then
    packages+=(libclang-rt-dev)
elif ! echo 'int main(void) { return 0; }' | clang -fsanitize=address -o /dev/null -x c - 2> /dev/null; then
    packages+=("libclang-rt-$(clang -dumpversion | cut -d. -f1)-dev")
fi
((${#packages[@]})) || { echo "compilers: all there"; exit 0; }
[[ " ${packages[*]} " == *gcc-arm* ]] && packages+=(libc6-dev-armhf-cross)
install=(apt-get install --yes --no-install-recommends "${packages[@]}")
if command -v apt-get > /dev/null && [ "$(id -u)" = 0 ]; then
    apt-get update > /dev/null 2>&1
    "${install[@]}" > /dev/null 2>&1 && { echo "compilers: installed ${packages[*]}"; exit 0; }
fi
echo "compilers: not here: ${packages[*]} (${install[*]}): their tests are skipped"

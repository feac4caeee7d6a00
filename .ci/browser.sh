#!/usr/bin/env bash
# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
# The browser that the tests of pages use: installed where this is Debian and we may, named where not. Those tests are then skipped.
set -uo pipefail
command -v chromium > /dev/null && { echo "browser: there"; exit 0; }
install=(apt-get install --yes --no-install-recommends chromium fonts-dejavu-core)
if command -v apt-get > /dev/null && [ "$(id -u)" = 0 ]; then
    apt-get update > /dev/null 2>&1
    "${install[@]}" > /dev/null 2>&1 && { echo "browser: installed chromium"; exit 0; }
fi
echo "browser: not here (${install[*]}): the tests of pages are skipped"

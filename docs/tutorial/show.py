# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Print a picture as HTML, for the tutorial's pages: `python show.py PICTURE.png "what it shows"`."""

from __future__ import annotations

import base64
import html
import sys
from pathlib import Path

if __name__ == "__main__":
    picture, text = sys.argv[1:]
    data = base64.b64encode(Path(picture).read_bytes()).decode()
    print(f'<img src="data:image/png;base64,{data}" alt="{html.escape(text)}" style="max-width:100%">')

# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Pages and drawings from templates, so that Python code has no markup.

A template lies in the folder `templates` of its room: `reporting/templates/page.html`; those of `evaluation` are found likewise. In
`.html`, `.svg` and `.xml` every value is escaped, unless it is `markupsafe.Markup`; in `.md` none is.
"""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from importlib.util import find_spec

from jinja2 import ChoiceLoader, Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined, select_autoescape
from jinja2.bccache import Bucket
from markupsafe import Markup
from platformdirs import user_cache_path


class _Compiled(FileSystemBytecodeCache):
    """Templates as they were compiled before, in the user's cache; where that cannot be written, they are compiled each time."""

    def __init__(self) -> None:
        super().__init__(str(user_cache_path("hyst_control") / "templates"))

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a template."""
        with suppress(OSError):
            os.makedirs(self.directory, exist_ok=True)
            super().dump_bytecode(bucket)


def render(template: str, **values: object) -> str:
    """Fill in a template."""
    return _environment().get_template(template).render(values)


def render_markup(template: str, **values: object) -> Markup:
    """Fill in a template whose result is inserted unchanged into another one; see `render`."""
    return Markup(render(template, **values))


@cache
def _environment() -> Environment:
    return Environment(
        bytecode_cache=_Compiled(),
        loader=ChoiceLoader([PackageLoader(name, "") for name in ("hyst_control", "evaluation") if find_spec(name)]),
        autoescape=select_autoescape(("html", "svg", "xml"), default=False),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )

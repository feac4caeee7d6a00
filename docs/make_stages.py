"""Write the page of all stages from their declarations: `python docs/make_stages.py`, from the repository's root."""

from __future__ import annotations

from pathlib import Path

import hyst_control.effects  # noqa: F401  (makes the effects' stages known)
from hyst_control.chain.reference import stages_reference

if __name__ == "__main__":
    (Path(__file__).parent / "stages.md").write_text(stages_reference(), encoding="utf-8")

"""Ten million samples of both papers' plants and feedforwards in C and in Python: no bit may differ."""

from __future__ import annotations

import sys

from evaluation.benchmarks.exported import COMPARED, compared, differences
from hyst_control.errors import InputError


def main() -> None:
    try:
        found = {case: differences(exported) for case, exported in compared()}
    except InputError as error:
        sys.exit(str(error))
    if any(found.values()):
        sys.exit("\n".join(f"{case}: C and Python differ in {count} of {COMPARED} samples" for case, count in found.items()))
    print(f"exported C: {', '.join(found)}: {COMPARED} samples each, the same bits as in Python")


if __name__ == "__main__":
    main()

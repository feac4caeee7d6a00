"""Exported C: ten million samples of both papers' plants and feedforwards have Python's bits, a million odd ones do no harm.

The odd steps, with NaN, infinities and numbers of any size, are `make fuzz` of the exported folders, of a controller too.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile

from evaluation.benchmarks.exported import COMPARED, compared, differences
from hyst_control.config_files import config_path
from hyst_control.errors import InputError
from hyst_control.export.folder import write_folder
from hyst_control.export.programs import controller


def main() -> None:
    try:
        found = {case: differences(exported) for case, exported in compared()}
    except InputError as error:
        sys.exit(str(error))
    if any(found.values()):
        sys.exit("\n".join(f"{case}: C and Python differ in {count} of {COMPARED} samples" for case, count in found.items()))
    print(f"exported C: {', '.join(found)}: {COMPARED} samples each, the same bits as in Python")
    tracking = controller(config_path("nodes/tracking.yaml"), reference_ahead=True)
    for case, exported in (*compared(), ("controller", tracking)):
        with tempfile.TemporaryDirectory() as folder:
            write_folder(exported, folder)
            if subprocess.run(["make", "-s", "-C", folder, "fuzz"], check=False).returncode:
                sys.exit(f"{case}: make fuzz failed")


if __name__ == "__main__":
    main()

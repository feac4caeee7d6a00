"""Exported C: ten million samples of both papers' plants and feedforwards have Python's bits, a million odd ones do no harm.

The odd steps, with NaN, infinities and numbers of any size, are `make fuzz` of the exported folders, of a controller too.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from evaluation.benchmarks.exported import COMPARED, compared, differences
from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.export.folder import write_folder
from hyst_control.export.programs import controller

NODES = """
hampi_feedforward:
  ros__parameters: {{kind: hampi, model: '{model}', limits: [0.0, 50.0]}}
pi_feedback:
  ros__parameters: {{rate_hz: 20000.0, axes: [x], unit: um, kp: 0.34, ki: 13600.0, upper: 50.0, slew_limit: 2.0e+6}}
"""


def main() -> None:
    try:
        found = {case: differences(exported) for case, exported in compared()}
    except InputError as error:
        sys.exit(str(error))
    if any(found.values()):
        sys.exit("\n".join(f"{case}: C and Python differ in {count} of {COMPARED} samples" for case, count in found.items()))
    print(f"exported C: {', '.join(found)}: {COMPARED} samples each, the same bits as in Python")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "loop.yaml"
        path.write_text(NODES.format(model=config_path("models/pea_hampi.yaml")))
        loop = controller(path, reference_ahead=True)
    for case, exported in (*compared(), ("controller", loop)):
        with tempfile.TemporaryDirectory() as folder:
            write_folder(exported, folder)
            if subprocess.run(["make", "-s", "-C", folder, "fuzz"], check=False).returncode:
                sys.exit(f"{case}: make fuzz failed")


if __name__ == "__main__":
    main()

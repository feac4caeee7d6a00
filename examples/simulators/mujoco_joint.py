# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator that is a MuJoCo joint with armature, damping and dry friction, beside a record of one whose gear has backlash.

The torque is the command, the joint's angle the measurement. `pip install mujoco` is all that it needs besides.
"""

from __future__ import annotations

import numpy as np

import hyst_control as hc
from hyst_control.base.arrays import Array

try:
    import mujoco
    from mujoco import rollout
except ImportError:
    raise SystemExit("mujoco_joint: needs MuJoCo: pip install mujoco") from None

PARAMETERS = {
    "armature": (0.01, 0.0005, "kg m²"),
    "damping": (0.15, 0.01, "N m s/rad"),
    "friction": (0.05, 0.005, "N m"),
    "motor": (0.1, 0.001, "N m/V"),
}
RATE = 200.0
XML = """<mujoco><option gravity="0 0 0" integrator="implicitfast" timestep="0.005"/>
<worldbody><body><joint name="joint" axis="0 0 1" stiffness="3"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.3"/>
</body></worldbody><actuator><motor joint="joint"/></actuator></mujoco>"""
MODEL = mujoco.MjModel.from_xml_string(XML)
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def simulate(command: Array, sample_time: float, armature: float, damping: float, friction: float, motor: float) -> Array:
    """Angle of the joint, in mrad, from rest at 0."""
    MODEL.dof_armature[:], MODEL.dof_damping[:], MODEL.dof_frictionloss[:] = armature, damping, friction
    MODEL.actuator_gainprm[0, 0], MODEL.opt.timestep = motor, sample_time
    data = mujoco.MjData(MODEL)
    begin = np.zeros(mujoco.mj_stateSize(MODEL, STATE))
    mujoco.mj_getState(MODEL, data, begin, STATE)
    states, _ = rollout.rollout(MODEL, data, begin, command[None, :-1, None])
    return 1e3 * np.concatenate([[0.0], states[0, :, 1]])


def measured(seed: int = 0, backlash: float = 40.0) -> hc.Record:
    """Record the machine: between the joint and the load whose angle is measured is a gear with backlash."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-10.0, 10.0, 30), 25)
    command[:25] = 0.0
    load, rows = 0.0, []
    for joint in simulate(command, 1.0 / RATE, 0.0102, 0.147, 0.051, 0.1004):
        load = min(max(load, joint - 0.5 * backlash), joint + 0.5 * backlash)
        rows.append(load)
    return hc.from_arrays(command, rows + random.standard_normal(len(rows)), RATE, unit="mrad")


if __name__ == "__main__":
    print(hc.diagnose(measured(), simulate, parameters=PARAMETERS, verbose=False))

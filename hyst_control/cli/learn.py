# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learn the feedforward of a reference that repeats, from trial to trial, on a simulated plant or from bags of trials.

With --feedback-error, gain and lag are learned from the feedback instead, as for any reference.

Without bags the trials are run here: compensator, PI feedback and learning on a reference simulation (--plant) or on the model itself. With
bags, one a trial in order, the feedforward of the next trial is computed, which the feedforward nodes play (parameter learned_file).

examples:
  hyst learn config/models/fsm_mhl.yaml --plant fsm --rate 5000 --reference sine frequency=100 amplitude=0.9 offset=1 duration=0.01
  hyst learn pea.yaml --plant pea --gain-error 0.1 --reference raster.yaml --trials 6 --json learned.json
  hyst learn pea.yaml --plant pea --gain-error 0.1 --reference sine frequency=50 amplitude=2 offset=4 duration=0.02 --feedback-error 2
  hyst learn mirror.yaml trial_0 trial_1 --period 0.02 --output learned.npy
  hyst learn mirror.yaml trial_0 --period 0.02 --response excitation --output learned.npy
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from hyst_control.reporting.result import CommandResult

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hyst_control.base.arrays import Array
    from hyst_control.control.feedback.loop import Plant
    from hyst_control.control.learning.iterative_learning import RunningIterativeLearning
    from hyst_control.control.learning.learning_filter import LearningFilter
    from hyst_control.model_file import Model
    from hyst_control.reporting.tables import Table

AT_LIMITS = 0.01  # Share of a trial with the command at its limits from which a note reports it
NAME = "learn"
HELP = "learn the feedforward of a repeated reference from trial to trial"
READS = ("model", "bags", "response", "reference", "plant")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("model", metavar="MODEL.yaml", help="model file of the plant")
    add("bags", nargs="*", metavar="BAG", help="bags of trials with reference, feedback and measurement")
    add("--period", type=float, metavar="S", help="period of the reference in the bags")
    add("--reference", nargs="+", metavar="WORD", help="one period: kind or .yaml file, and parameter=value")
    add("--plant", help="reference simulation that the trials run on: a name or a file (default: the model itself)")
    add("--gain-error", type=float, default=0.0, help="relative change of the reference simulation's gain (default 0)")
    add("--rate", type=float, help="sample rate in Hz of trials that are run (default: the model's)")
    add("--kp", type=float, help="gain of the feedback, V per measurement unit (default: tuned, see hyst tune)")
    add("--ki", type=float, help="integral gain of the feedback, V per measurement unit and s")
    add("--roll-off", type=float, default=0.0, metavar="HZ", help="of the feedback, with --kp and --ki")
    add("--trials", type=int, default=6, help="trials to run at most (default 6)")
    add("--settling", type=int, default=1, help="periods of a trial that are not measured (default 1)")
    add("--averaged", type=int, default=2, help="periods of a trial that are (default 2)")
    add("--gain", type=float, default=1.0, help="share of a correction that is applied at first (default 1)")
    add("--mode-spread", type=float, default=0.0, help="of the first resonance with which no trial may lose (default 0)")
    add("--response", metavar="BAG", help="record of an excitation: its measured response takes the place of the model's")
    add("--feedback-error", type=float, metavar="S", help="learn gain and lag from the feedback for so long, in place of trials")
    add("--seed", type=int, default=0, help="of the reference simulation's noise (default 0)")
    add("--output", metavar="FILE.npy", help="file to write one period of what was learned to, in V")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from pathlib import Path

    import numpy as np

    from hyst_control.base.errors import InputError
    from hyst_control.base.files import check_writable, replacing
    from hyst_control.control.learning.iterative_learning import IterativeLearning
    from hyst_control.control.learning.learning_trials import learn_from_records, trial_table
    from hyst_control.model_file import load_model
    from hyst_control.records.bags.bag_files import bags_in
    from hyst_control.records.bags.bag_reader import read_bag

    model = load_model(arguments.model)
    if arguments.output is not None:
        if Path(arguments.output).suffix != ".npy":
            raise InputError(f"--output: {arguments.output}: must end in .npy")
        check_writable(arguments.output)
    options = {name: getattr(arguments, name) for name in ("settling", "averaged", "gain", "trials")}
    learner: RunningIterativeLearning | None
    if arguments.bags:
        if arguments.reference or arguments.plant or not arguments.period:
            raise InputError("give --period with bags, and neither --reference nor --plant")
        records = [read_bag(bag) for bag in bags_in(arguments.bags)]
        sample_time = records[0].common_step(("measurement",))
        longest = max(len(record.signal("measurement").time) for record in records) * sample_time
        if not 0.5 * sample_time < arguments.period <= longest:
            raise InputError(f"--period: must be within a sample and the longest bag, {longest:g} s, got {arguments.period:g} s")
        period = round(arguments.period / sample_time)
        if abs(period * sample_time - arguments.period) > 1e-3 * sample_time:
            raise InputError(f"--period: {arguments.period:g} s: must be a multiple of the sample time, {sample_time:g} s")
        options["trials"] = max(len(records) + 1, 1)
        learner, span = learn_from_records(records, IterativeLearning(_filter(arguments, model, period, sample_time), **options))
        table = trial_table(learner, span, "recorded trials")
    else:
        if not arguments.reference or arguments.period:
            raise InputError("give bags with --period, or one period of a --reference")
        table, learner = _simulated(arguments, model, options)
    if arguments.output is not None and learner is not None:
        with replacing(arguments.output) as file:
            np.save(file, learner.feedforward)
    return table


def _filter(arguments: argparse.Namespace, model: Model, period: int, sample_time: float) -> LearningFilter:
    from hyst_control.base.errors import InputError
    from hyst_control.control.learning.learning_filter import measured_filter, model_filter
    from hyst_control.records.bags.bag_files import one_bag
    from hyst_control.records.bags.bag_reader import read_bag

    if not arguments.response:
        return model_filter(model, period, sample_time=sample_time, mode_spread=arguments.mode_spread)
    [data] = read_bag(one_bag(arguments.response)).aligned()
    if abs(data.sample_time - sample_time) > 1e-3 * sample_time:
        raise InputError(f"--response: {arguments.response}: sample time {data.sample_time:g} s, {sample_time:g} s is needed")
    return measured_filter(data.command, data.measurement, period, sample_time)


def _simulated(
    arguments: argparse.Namespace, model: Model, options: Mapping[str, Any]
) -> tuple[Table, RunningIterativeLearning | None]:
    """Trials, or feedback-error learning, on a plant that is simulated here."""
    import numpy as np

    from hyst_control.base.errors import InputError
    from hyst_control.control.feedback.pi import PI
    from hyst_control.control.learning.feedback_error_learning import FeedbackErrorLearning
    from hyst_control.control.learning.iterative_learning import IterativeLearning
    from hyst_control.control.learning.learning_trials import best_compensator, feedback_error_table, run_trials, trial_table
    from hyst_control.control.tuning import AUTOMATIC, tune
    from hyst_control.model_file import Simulator
    from hyst_control.records.excitation.excitation import build
    from hyst_control.records.excitation.excitation_files import read_description
    from hyst_plant_sim.physics import PlantError, load_plant

    if arguments.rate is not None and not 0 < arguments.rate < 1e12:
        raise InputError(f"--rate: must be positive, got {arguments.rate!r} Hz")
    sample_time = 1.0 / arguments.rate if arguments.rate else model.sample_time
    axes = len(model.axes)
    reference = np.asarray(build(read_description(arguments.reference), sample_time, axes))
    lower, upper = np.array(model.valid.get("command", [0.0, 100.0]), dtype=float).reshape(-1, 2)[0]
    limits = float(lower), float(upper)
    plant: Plant
    if arguments.plant:
        effects = [{"name": "gain", "gain": arguments.gain_error}] if arguments.gain_error else None
        try:
            truth = load_plant(arguments.plant, seed=arguments.seed, sample_time=sample_time, effects=effects)
        except PlantError as error:
            raise InputError(f"--plant: {error}") from None
        if len(truth.axes) != axes:
            raise InputError(f"--plant: {arguments.plant}: has {len(truth.axes)} axes, the model {axes}")
        plant, limits = truth, truth.rating
    elif arguments.gain_error:
        raise InputError("--gain-error: belongs to a reference simulation: give --plant")
    else:
        plant = Simulator(model, sample_time)
    if arguments.kp is None and arguments.ki is None:
        controller = tune(model, sample_time=sample_time, roll_off=AUTOMATIC).controller(*limits)
    else:
        controller = PI(arguments.kp or 0.0, arguments.ki or 0.0, sample_time, *limits, roll_off=arguments.roll_off)
    kind, compensator = best_compensator(model, sample_time, limits)
    if arguments.feedback_error is not None:
        if not 0 < arguments.feedback_error <= 3600:
            raise InputError(f"--feedback-error: must be above 0 and at most 3600 s, got {arguments.feedback_error!r}")
        if arguments.output:
            raise InputError("--output: holds what trials learned: leave it out, or --feedback-error")
        loop = (reference, compensator, controller.start(axes), plant)
        return feedback_error_table(*loop, FeedbackErrorLearning(sample_time), arguments.feedback_error, kind, model.axes), None
    description = IterativeLearning(_filter(arguments, model, len(reference), sample_time), **options)
    learner, signals = run_trials(reference, compensator, controller.start(axes), plant, description)
    table = trial_table(learner, float(np.ptp(reference, axis=0).max()), kind)
    table.notes += _at_limits(model, signals["command"][-description.trial_rows :], reference, limits)
    return table, learner


def _at_limits(model: Model, command: Array, reference: Array, limits: tuple[float, float]) -> list[str]:
    """A note where the commands (N, A) of a trial stood at their limits: the reference is out of reach, or the loop oscillates."""
    import numpy as np

    from hyst_control.control.feedforward.compensator import quasi_static

    shares = np.mean((command <= limits[0]) | (command >= limits[1]), axis=0)
    axis = int(np.argmax(shares))
    if shares[axis] < AT_LIMITS:
        return []
    low, high = quasi_static(model, np.repeat(np.array(limits)[:, None], len(model.axes), axis=1))[:, axis]
    reached = np.all((reference[:, axis] >= low) & (reference[:, axis] <= high))
    told = (
        "they would do for the whole reference, so the loop oscillates, or the reference is too fast: lower the gains (--kp, --ki)."
        if reached
        else f"the model moves between {low:.4g} and {high:.4g} {model.units['measurement']}; change offset or amplitude."
    )
    return [
        f"The command of axis {model.axes[axis]} stood at its limits, {limits[0]:g} to {limits[1]:g} V, for {100 * shares[axis]:.0f} % of "
        f"the last trial: {told}"
    ]

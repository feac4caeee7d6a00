"""Where the gap lies: its energy by kind, frequency band, amplitude, axis and time span, each share with a 90 % interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from hyst_control.chain.stage import Array
from hyst_control.diagnose.attribution import Explanation
from hyst_control.diagnose.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.problem import Problem
from hyst_control.effects import EFFECTS

BLOCKS = 24
RESAMPLES = 300
BANDS = (0.0, 1.0, 10.0, 100.0, 1000.0, np.inf)
THIRDS = ("lower third", "middle third", "upper third")

Rows = list[dict[str, Any]]


def budget(diagnosis: Diagnosis) -> dict[str, Rows]:
    """kind, band, amplitude, axis and time of the residual of the nominal model; each list's shares add up to 1."""
    residuals = [part.gap() for part in diagnosis.parts]
    return {
        "kind": _added([_kinds(part, residual) for part, residual in zip(diagnosis.parts, residuals, strict=True)], diagnosis.seed),
        "band": _added([_bands(part, residual) for part, residual in zip(diagnosis.parts, residuals, strict=True)], diagnosis.seed),
        "amplitude": _added(
            [_amplitudes(part, residual) for part, residual in zip(diagnosis.parts, residuals, strict=True)], diagnosis.seed
        ),
        "axis": _added(
            [
                {
                    diagnosis.model.axes[axis]: _blocks(residual[:, i] ** 2)
                    for part, residual in zip(diagnosis.parts, residuals, strict=True)
                    for i, axis in enumerate(part.axes)
                }
            ],
            diagnosis.seed,
        ),
        "time": _added([_spans(part, residual) for part, residual in zip(diagnosis.parts, residuals, strict=True)], diagnosis.seed),
    }


def stages(diagnosis: Diagnosis, explanation: Explanation, unfaithful: Sequence[str] = ()) -> Rows:
    """Shares by place in the signal chain: the plant's places, the model's own coefficients, noise, what is unexplained.

    unfaithful: software blocks that did not do what they should; named with no share of the plant's residual.
    """
    energies: dict[str, Array] = dict.fromkeys(unfaithful, np.zeros(BLOCKS))
    effects = coefficients = noise = unexplained = np.zeros(BLOCKS)
    for part in diagnosis.parts:
        problem, linearised, solution = part.problem, part.linearised, part.decision.chosen.solution
        unknowns = part.decision.chosen.candidate.unknowns() if part.decision.chosen.candidate else None
        given = _energy(problem, linearised.measured - linearised.simulate(np.zeros(linearised.count)))
        left = np.minimum(_energy(problem, solution.residual), given)
        # What the effects leave with the coefficients as given is the coefficients' part.
        with_effects = _energy(problem, linearised.measured - linearised.simulate(np.zeros(linearised.count), unknowns, solution.x))
        fitted = np.clip(with_effects - left, 0.0, given - left)
        floor = np.minimum(float(np.sum(problem.sigma**2)) * len(linearised.measured) / len(problem.sigma) / BLOCKS, left)
        effects, coefficients = effects + given - left - fitted, coefficients + fitted
        noise, unexplained = noise + floor, unexplained + left - floor
    named = [effect for effect in explanation.effects if effect.shrink is not None]
    for effect in named:
        place = EFFECTS[effect.name].place
        energies[place] = energies.get(place, 0.0) + effects * effect.share
    energies |= {"coefficients": coefficients if named else coefficients + effects, "noise": noise, "unexplained": unexplained}
    return shares_with_intervals(energies, diagnosis.seed)


def _energy(problem: Problem, error: Array) -> Array:
    """Squared error of all axes in the measurement's unit, summed over each of BLOCKS stretches."""
    return _blocks((problem.rows(error) ** 2).sum(axis=1))


def shares_with_intervals(energies: Mapping[str, Array], seed: int) -> Rows:
    """Rows of shares from energies (BLOCKS,) by name: resampled over blocks."""
    names = list(energies)
    table = np.stack([np.maximum(energies[name], 0.0) for name in names])
    if table.sum() <= 0:
        return [{"name": name, "share": 1.0 / len(names), "ci90": [0.0, 1.0]} for name in names]
    shares = table.sum(axis=1) / table.sum()
    random = np.random.default_rng(seed)
    drawn = table[:, random.integers(0, table.shape[1], (RESAMPLES, table.shape[1]))].sum(axis=2)
    drawn = drawn / np.maximum(drawn.sum(axis=0), 1e-300)
    low, high = np.quantile(drawn, [0.05, 0.95], axis=1)
    return [
        {"name": name, "share": float(share), "ci90": [float(min(a, share)), float(max(b, share))]}
        for name, share, a, b in zip(names, shares, low, high, strict=True)
    ]


def _added(parts: Sequence[Mapping[str, Array]], seed: int) -> Rows:
    total: dict[str, Array] = {}
    for part in parts:
        for name, energy in part.items():
            total[name] = total.get(name, np.zeros(BLOCKS)) + energy
    return shares_with_intervals(total, seed)


def _blocks(energy: Array) -> Array:
    """Sums (BLOCKS,) of an energy (M,) over equal stretches."""
    edges = np.linspace(0, len(energy), BLOCKS + 1).astype(int)
    sums = np.concatenate([[0.0], np.cumsum(energy)])
    return sums[edges[1:]] - sums[edges[:-1]]


def _bands(part: AxisDiagnosis, residual: Array) -> dict[str, Array]:
    nyquist = 0.5 / part.problem.sample_time
    found, low = {}, residual * 0.0
    for lower, upper in zip(BANDS[:-1], BANDS[1:], strict=True):
        if lower >= nyquist:
            break
        up_to = residual if upper >= 0.95 * nyquist else sosfiltfilt(butter(2, upper / nyquist, output="sos"), residual, axis=0)
        name = f"{lower:g}-{upper:g} Hz" if upper < 0.95 * nyquist else f"above {lower:g} Hz"
        found[name] = _blocks(((up_to - low) ** 2).sum(axis=1))
        low = up_to
        if upper >= 0.95 * nyquist:
            break
    return found


def _amplitudes(part: AxisDiagnosis, residual: Array) -> dict[str, Array]:
    measured = part.problem.rows(part.linearised.measured)
    level = (measured - measured.min(axis=0)) / np.maximum(np.ptp(measured, axis=0), 1e-300)
    which = np.minimum((3 * level).astype(int), 2)
    return {name: _blocks((residual**2 * (which == i)).sum(axis=1)) for i, name in enumerate(THIRDS)}


def _spans(part: AxisDiagnosis, residual: Array) -> dict[str, Array]:
    """Five spans; their interval is that of the energy's own scatter within the span."""
    energy = (residual**2).sum(axis=1)
    edges = np.linspace(0, len(energy), 6).astype(int)
    period = part.problem.sample_time
    return {
        f"{a * period:.3g}-{b * period:.3g} s": np.resize(_blocks(energy[a:b]), BLOCKS)
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    }


def _kinds(part: AxisDiagnosis, residual: Array) -> dict[str, Array]:
    """What linear regressions take off one after the other, fitted on every other block and counted on the rest."""
    found: dict[str, Array] = {}
    for axis in range(residual.shape[1]):
        left = residual[:, axis]
        whole, taken = left, part.linearised.columns @ part.decision.chosen.solution.z
        if not part.decision.chosen.inflated and part.linearised.count:
            left = left - part.problem.rows(taken)[:, axis]
            energy = _blocks(whole**2)
            found["coefficients"] = found.get("coefficients", 0.0) + energy - np.minimum(_blocks(left**2), energy)
        target = left
        fold = (np.arange(len(left)) * BLOCKS // len(left)) % 2
        known = np.zeros((len(left), 0))
        before = np.minimum(_blocks(left**2), _blocks(whole**2))
        for name, features in _features(part, axis):
            known = np.concatenate([known, features], axis=1)
            scale = np.sqrt(np.mean(known**2, axis=0)) + 1e-300
            left = np.empty(len(residual))
            for held in (0, 1):
                rows = fold == held
                design = known[~rows] / scale
                ridge = 1e-6 * len(design) * np.eye(design.shape[1])
                weights = np.linalg.solve(design.T @ design + ridge, design.T @ target[~rows])
                left[rows] = target[rows] - known[rows] / scale @ weights
            after = np.minimum(_blocks(left**2), before)
            found[name] = found.get(name, 0.0) + before - after
            before = after
        noise = np.minimum(np.full(BLOCKS, part.problem.sigma[axis] ** 2 * len(left) / BLOCKS), before)
        found["noise"] = found.get("noise", 0.0) + noise
        found["unexplained"] = found.get("unexplained", 0.0) + before - noise
    return found


def _features(part: AxisDiagnosis, axis: int) -> list[tuple[str, Array]]:
    """Groups of regressors (M, n), what is simplest first."""
    problem, linearised = part.problem, part.linearised
    axes = len(problem.model.axes)
    command = np.concatenate([piece.counted(piece.command) for piece in problem.pieces])[:, axis]
    simulated = problem.rows(linearised.nominal)[:, axis]
    count = len(simulated)
    time = np.linspace(-1.0, 1.0, count)
    u, y = _normalised(command), _normalised(simulated)
    rate = np.gradient(y)
    rate /= np.sqrt(np.mean(rate**2)) + 1e-300
    delayed = [np.concatenate([np.full(n, y[0]), y[:-n]]) for n in (1, 2, 4, 8)]
    slow = [lfilter([1 - a], [1, -a], y, zi=[a * y[0]])[0] for a in (np.exp(-1.0 / n) for n in (20, 100, 500, 2500))]
    turned = np.sign(np.gradient(command))
    for k in range(1, count):
        if turned[k] == 0:
            turned[k] = turned[k - 1]
    groups = [
        ("offset and drift", np.stack([np.ones(count), time, time**2, time**3], axis=1)),
        ("linear dynamics", np.stack([y, rate, np.gradient(rate), *delayed, *slow], axis=1)),
        ("static, even", np.stack([y**2, y**4], axis=1)),
        ("static, odd", np.stack([y**3, y**5], axis=1)),
        ("velocity sign", np.stack([turned, turned * u, turned * u**2, np.abs(u) * turned], axis=1)),
        ("rate and amplitude", np.stack([np.abs(rate), rate * y, rate * np.abs(rate), rate * y**2], axis=1)),
    ]
    others = [piece.others for piece in problem.pieces]
    if axes > 1:
        groups.append(("cross-axis", np.delete(problem.rows(linearised.nominal), axis, axis=1)))
    elif others[0] is not None and others[0].shape[1]:
        groups.append(("cross-axis", np.concatenate([piece.counted(piece.others) for piece in problem.pieces])))
    return groups


def _normalised(values: Array) -> Array:
    return 2.0 * (values - values.min()) / max(np.ptp(values), 1e-300) - 1.0

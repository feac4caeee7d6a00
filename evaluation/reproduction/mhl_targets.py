# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The targets of the MHL experiments, by claim of the paper."""

from __future__ import annotations

from evaluation.reproduction import mhl_learning
from evaluation.reproduction.mhl_tables import (
    AHEAD,
    COMPOSITES,
    MOVED,
    OWN_LOOP,
    PUBLISHED,
    SLOWER,
    TRADITIONAL,
    WITHOUT,
    against_traditional,
)
from evaluation.reproduction.papers import MHL
from evaluation.reproduction.targets import OURS, Rows, Target, TargetList, margin_targets

GIVEN, WHY = MHL.published, MHL.causes
STATED = (PUBLISHED, MOVED, WITHOUT, AHEAD)
"""The composites with N(s) as published, at 1 kHz, without, and without phase."""
SCORED = (OWN_LOOP, MOVED, WITHOUT, AHEAD)
"""Of these N(s) as published is scored in the paper's own loop, whose PI has no roll-off."""
ABSOLUTE = {"single": 0.35, "decreasing": 0.35, "multi": 0.30}
"""% NRMSE, of the best composite."""
WHOLE = 0.15
"""% NRMSE, of the whole inverse."""
LEARNED, FEEDBACK_LEARNED = 0.03, 0.12
"""% NRMSE, of what is learned from trial to trial, and from the feedback."""


def mhl_targets(rows: Rows) -> list[Target]:
    """List the targets of the MHL experiments."""
    targets = TargetList()
    add = targets.add

    for axis in ("x", "y"):
        case = f"axis {axis}"
        areas = [rows.value("MHL Fig. 1", each, f"mirror, {case}", "loop area over its box") for each in ("1 Hz", "100 Hz")]
        add("MHL Fig. 1", f"{case}: loops widen, area over box at 100 Hz over 1 Hz", areas[1] / areas[0], 1.0, "", True)
        off = abs(rows.value("MHL Fig. 5", case, "model", "delay") - 68.0)
        add("MHL Fig. 5", f"{case}: delay away from 68 us", off, 15.0, "us", origin=OURS)
        add("MHL Table 2", f"{case}: -k1 (the loop lags)", -rows.value("MHL Table 2", case, "model", "k1"), 0.0, "s", True)
        add("MHL Table 2", f"{case}: k1' (the inverse leads)", rows.value("MHL Table 2", case, "inverse", "k1'"), 0.0, "s", True)
        for title, (nme, nrmse) in (("MHL Fig. 9", (0.96, 0.25)), ("MHL Fig. 11", (2.66, 0.85))):
            add(title, f"{case}: NME", rows.value(title, case, "MHL, paper", "nme"), nme, "%")
            add(title, f"{case}: NRMSE", rows.value(title, case, "MHL, paper", "nrmse"), nrmse, "%")
        own = f"60 to 3500 Hz, {case}"
        value = rows.value("MHL Fig. 10", own, "MHL, paper", "relative error of the response, rms")
        published = next(row.published for row in rows.rows if row.table == "MHL Fig. 10" and row.case == own and row.published)
        add("MHL Fig. 10", f"{case}: relative error of the response, rms", value, published, "%", origin=OURS)
        for frequency, (nme, nrmse) in GIVEN["table_3"].items():
            place = f"{frequency:g} Hz, {case}"
            add("MHL Table 3", f"{place}: NME", rows.value("MHL Table 3", place, "MHL, paper", "nme"), nme, "%", cause=WHY["fast"])
            add(
                "MHL Table 3",
                f"{place}: NRMSE",
                rows.value("MHL Table 3", place, "MHL, paper", "nrmse"),
                nrmse,
                "%",
                cause=WHY["fast"],
            )
        for quantity, subject in (("open loop", "mirror"), ("lead of Ψ'", "inverse")):
            off = abs(rows.value("MHL lags", f"100 Hz, {case}", subject, quantity) - GIVEN["lags"][quantity])
            add(
                "MHL §4.4, lags",
                f"{case}: {quantity} away from {GIVEN['lags'][quantity]:g} deg",
                off,
                15.0,
                "deg",
                False,
                WHY["own_lags"],
                OURS,
            )
    off = abs(rows.value("MHL lags", "100 Hz", "N(s) as published", "lag of N(s)") - GIVEN["lags"]["lag of N(s)"])
    add("MHL §4.4, lags", "lag of N(s) away from 39 deg", off, 1.0, "deg", False, WHY["printed_filter"], OURS)

    for case in GIVEN["lower"]:
        against = {
            quantity: {
                name: rows.value("MHL Table 4", case, against_traditional(name), f"{quantity} lower by")
                for name in (*STATED, OWN_LOOP)
            }
            for quantity in ("nrmse", "nme")
        }
        of_each = {name: rows.value("MHL Table 4", case, name, "nrmse") for name in (*STATED, OWN_LOOP, "whole inverse")}
        for claim, quantity, bound in (
            ("MHL §4.4, NRMSE lower", "nrmse", GIVEN["lower"][case]),
            ("MHL §4.4, NME lower", "nme", GIVEN["nme_lower"][case]),
        ):
            best = max(STATED, key=lambda name: against[quantity][name])
            add(claim, f"{case}: by at least, {best}", against[quantity][best], bound, "%", True, WHY["ratio"])
            add(claim, f"{case}: by at least, {OWN_LOOP}", against[quantity][OWN_LOOP], bound, "%", True, WHY["published_filter"])
        best = min(STATED, key=lambda name: of_each[name])
        add("MHL Table 4", f"{case}: NRMSE, {best}", of_each[best], ABSOLUTE[case], "%", False, WHY["ratio"], OURS)
        theirs = GIVEN["table_4"][case]["proposed composite"][1]
        add("MHL Table 4", f"{case}: NRMSE, {OWN_LOOP}", of_each[OWN_LOOP], theirs, "%", cause=WHY["published_filter"])
        add("MHL Table 4", f"{case}: NRMSE, whole inverse", of_each["whole inverse"], WHOLE, "%", origin=OURS)
        lower = {
            name: rows.value("MHL feedback", case, against_traditional(name), "output of the PI feedback lower by")
            for name in (*STATED, OWN_LOOP)
        }
        best = max(STATED, key=lambda name: lower[name])
        claim = "MHL §3, output of the feedback"
        add(claim, f"{case}: lower by at least, {best}", lower[best], GIVEN["pi_lower"], "%", True)
        add(claim, f"{case}: lower by at least, {OWN_LOOP}", lower[OWN_LOOP], GIVEN["pi_lower"], "%", True, WHY["published_filter"])
        add("MHL §4.5, errors", f"{case}: NRMSE below 0.6 %, {best}", of_each[best], 0.6, "%")
        add("MHL §4.5, errors", f"{case}: NME below 1 %, {best}", rows.value("MHL Table 4", case, best, "nme"), 1.0, "%")
        if case == "single":
            best = max(STATED, key=lambda name: against["nrmse"][name])
            add("MHL §3, error at equal output", f"NRMSE lower by up to 80 %, {best}", against["nrmse"][best], 80.0, "%", True)

    for axis in ("x", "y"):
        for quantity, bound in (("nme", 1.0), ("nrmse", 0.6)):
            for name in (OWN_LOOP, AHEAD):
                value = rows.value("MHL Fig. 17", f"spiral, axis {axis}", name, quantity)
                add("MHL Fig. 17", f"spiral, axis {axis}: {quantity.upper()}, {name}", value, bound, "%")
    peak = {name: rows.value("MHL Fig. 18", "closed loop", name, "peak") for name in (TRADITIONAL, *COMPOSITES)}
    for name in ("whole inverse", *SCORED):
        add("MHL §4.4, peak", f"{name}: peak", peak[name], 2.94, "dB", cause=WHY["peak"])
    add("MHL §4.4, peak", f"{SLOWER}: peak away from 5.22 dB", abs(peak[SLOWER] - 5.22), 1.0, "dB", False, WHY["peak"], OURS)
    add("MHL §4.4, peak", "by as much N(s) as published takes it down", peak[WITHOUT] - peak[PUBLISHED], 5.22 - 2.94, "dB", True)
    for name in ("whole inverse", *SCORED):
        value = rows.value("MHL Fig. 18", "closed loop", name, "bandwidth")
        add("MHL §4.5, closed loop", f"bandwidth, {name}", value, 1500.0, "Hz", True)
        value = rows.value("MHL Fig. 18", "step", name, "settling_time")
        add("MHL §4.5, closed loop", f"settling time, {name}", value, 2.0, "ms", cause=WHY["settling"])
    for name in ("whole inverse", *SCORED):
        cause = WHY["published_filter"] if name == OWN_LOOP else WHY["amplitude"]
        value = abs(rows.value("MHL Fig. 18", "100 Hz", name, "gain"))
        add("MHL Fig. 18", f"100 Hz: gain away from 0 dB, {name}", value, 0.2, "dB", cause=cause)
        value = abs(rows.value("MHL Fig. 18", "100 Hz", name, "lag"))
        add("MHL Fig. 18", f"100 Hz: phase away from 0, {name}", value, 0.69, "deg", cause=cause)
    return targets.found + _learning_targets(rows) + margin_targets(rows, "MHL robustness", "")


def _learning_targets(rows: Rows) -> list[Target]:
    """Targets of what is learned; the papers have nothing of the kind."""
    found = []
    for case in mhl_learning.CHANGES:
        value = rows.value(mhl_learning.TRIALS, f"{case}, trial 4", TRADITIONAL, "nrmse")
        found.append(Target(f"learning from trial to trial, {case}: NRMSE after four trials", value, LEARNED, "%", origin=OURS))
    changed = list(mhl_learning.CHANGES)[1]
    value = rows.value(mhl_learning.FEEDBACK_ERROR, f"{changed}, last tenth", "whole inverse, learning", "nrmse")
    name = f"learning of gain and lag from the feedback, {changed}: NRMSE in the last tenth"
    return [*found, Target(name, value, FEEDBACK_LEARNED, "%", origin=OURS)]

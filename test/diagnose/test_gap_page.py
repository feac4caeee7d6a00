# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The page for people: what is on it, that it needs no network, and that a browser draws it as a reader wants it."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.metadata import version
from types import SimpleNamespace

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.diagnose.report.coefficient_changes import coefficient_changes
from hyst_control.diagnose.report.document import in_words, named, off_by, reduction, sentence
from hyst_control.diagnose.report.page import actions, taken_off, write_page
from hyst_control.diagnose.report.rejected_hypotheses import rejected
from hyst_control.diagnose.report.slow_loops import slow_loops
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects import EFFECTS
from hyst_control.reporting.provenance import provenance
from hyst_control.reporting.signal_figures import thinned

DELAY = (("name", "delay"), ("tau", 2e-4))
CATALOGUE = {"delay", "gain", "offset", "backlash", "saturation", "slew_limit", "dac_hold", "quantization", "sensor_lowpass"}
"""Effects that are looked for: a page shows few as it shows many."""


@pytest.fixture(scope="module")
def few(answer):
    """Answers of the published stage with some effects, from that catalogue."""
    return lambda *effects: answer("pea_published", *effects, without=tuple(name for name in EFFECTS if name not in CATALOGUE))


@pytest.fixture(scope="module")
def page(few, tmp_path_factory):
    document, diagnosis, better = few(DELAY)
    path = tmp_path_factory.mktemp("page") / "gap.html"
    write_page(path, document, diagnosis, better, provenance([("model", [config_path("models/pea_hampi.yaml")])]))
    return path, document


def test_the_page_says_the_verdict_and_stands_alone(page):
    path, document = page
    text = path.read_text(encoding="utf-8")
    assert sentence(document) in text
    assert len(text) < 3e6
    assert (
        "caused by a delay of " in text and "models/pea_hampi.yaml'>" in text and f"hyst_control {version('hyst_control')}" in text
    )
    assert [path] == list(path.parent.iterdir())
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=['\"]?https?:", text)
    marked = re.findall(r"stroke='#c2542d'", text)
    assert len(marked) == 1  # the delay's one place


@pytest.mark.parametrize("verdict, shrink, told", [("unknown", -0.5, True), ("unknown", 0.2, False), ("effect", -0.5, False)])
def test_an_effect_that_widens_the_gap_does_not_stand_as_sure(page, verdict, shrink, told):
    """Its probability is that among the catalogue's effects; of an unknown gap the report says so."""
    document = page[1]
    effect = {**document["effects"][0], "probability": 1.0, "shrink": shrink, "shrink_reidentified": shrink}
    said = in_words({**document, "verdict": verdict, "unexplained_share": 1.0, "effects": [effect]})
    assert "probability 1.00" in said and ("it widens the gap" in said) == told


def test_a_reduction_below_zero_is_told_in_words(page):
    _, document = page
    effect = {**document["effects"][0], "shrink": -7.87, "shrink_ci90": (-10.0, 0.2), "shrink_reidentified": 0.03}
    told = in_words({**document, "effects": [effect]})
    assert "reduction none (worse on held-out rows), 3.0 % after re-fitting the model" in told
    assert reduction(0.2, (-8.0, 0.3)) == "20.0 % [below 0 … 30.0]"


def test_the_terminal_has_the_words_of_the_page(page):
    html, where = (
        page[0].read_text(encoding="utf-8"),
        {name: [{"name": "none of these", "share": 1.0}] for name in ("kind", "band")},
    )
    told = in_words({**page[1], "where": {"stage": [{"name": "drive", "share": 1.0}], **where}})
    for line in ("place in the chain: amplifier 100 %", "kind of curve: none of these 100 %", "frequency: "):
        assert f"  {line}" in told and f"by {line.partition(':')[0]}" in html
    moved = off_by({"name": "tau", "z": 37.5, "value": 2.0, "ci90": [1.9, 2.1], "nominal": 1.0, "unit": "s"})
    assert moved == "tau is 2 ± 0.1 s, the model has 1 (+37.5 σ of its tolerance)"


def test_only_coefficients_that_moved_for_certain_are_listed(few, tmp_path, monkeypatch):
    _, diagnosis, _ = given = few(DELAY)
    row = coefficient_changes(diagnosis)[0]
    rows = [replace(row, name=name, before=1.0, after=2.0, spread=spread) for name, spread in (("moved", 0.5), ("unsure", 1.5))]
    monkeypatch.setattr("hyst_control.diagnose.report.page.coefficient_changes", lambda *_: rows)
    write_page(tmp_path / "gap.html", given[0], given[1], given[2])
    told = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert ">moved<" in told and ">unsure<" not in told


def test_the_page_of_no_gap_is_written_too(few, tmp_path):
    write_page(tmp_path / "none.html", *few())
    assert "No gap beyond" in (tmp_path / "none.html").read_text(encoding="utf-8")


def test_a_folder_that_is_none_is_refused(few, tmp_path):
    with pytest.raises(InputError, match="choose a folder"):
        write_page(tmp_path / "missing" / "gap.html", *few())


def test_an_envelope_keeps_every_extreme():
    values = np.random.default_rng(0).standard_normal(50_000)
    time, kept = thinned(np.arange(50_000) * 1e-4, values, 1000)
    assert len(kept) == 1000 and np.all(np.diff(time) >= 0)
    edges = np.linspace(0, 50_000, 501).astype(int)
    for i, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        np.testing.assert_allclose(sorted(kept[2 * i : 2 * i + 2]), [values[a:b].min(), values[a:b].max()], rtol=1e-6)


def test_shares_of_the_waterfall_are_those_of_the_chain(page):
    _, document = page
    rows = taken_off(document)
    stage = {row["name"]: row["share"] for row in document["where"]["stage"]}
    assert sum(share for _, share in rows) == pytest.approx(1.0 - stage["noise"] - stage["unexplained"])
    assert dict(rows)["delay"] == pytest.approx(stage["drive"])


def test_what_kinds_do_not_describe_is_not_called_unexplained(page):
    _, document = page
    assert "unexplained" not in {row["name"] for row in document["where"]["kind"]}


def test_rejected_rivals_are_behind_and_have_a_reason(few):
    document, diagnosis, _ = few(DELAY)
    rows = rejected(diagnosis, 100)
    assert len(rows) > 5 and all(row.why for row in rows)
    named_effects = {effect["name"].replace("_", " ") for effect in document["effects"]}
    assert not named_effects & {row.name for row in rows}
    assert [row.behind for row in rows] == sorted(row.behind for row in rows)
    # What the rival leaves is what its own fit left, against the gap without any effect.
    part = diagnosis.parts[0]
    gain = next(one for one in part.found.singles if one.names == ("gain",))
    left = np.sum(gain.solution.residual**2) / np.sum(part.found.none.solution.residual**2)
    assert min(abs(row.left - left) for row in rows if row.name == "gain") < 1e-9


def test_what_a_rival_leaves_is_in_units_of_the_measurement_however_fits_weigh_it(few):
    _, diagnosis, _ = few(DELAY)
    part = diagnosis.parts[0]
    none, gain = part.found.none.solution.residual, next(one for one in part.found.singles if one.names == ("gain",))
    gains = np.linspace(1.0, 9.0, len(none))
    weighed = replace(part, problem=SimpleNamespace(in_noise=lambda flat: gains * flat))
    rows = rejected(replace(diagnosis, parts=(weighed,)), 100)
    left = np.sum((gains * gain.solution.residual) ** 2) / np.sum((gains * none) ** 2)
    assert min(abs(row.left - left) for row in rows if row.name == "gain") < 1e-9


def test_coefficients_have_the_values_that_their_deviation_says(few):
    _, diagnosis, _ = few(DELAY)
    tolerance = diagnosis.model.tolerance
    rows = coefficient_changes(diagnosis)
    assert len(rows) == len([one for one in diagnosis.parts[0].linearized.scatter.coefficients if not one.companion])
    for row in rows:
        share = tolerance.get(row.name.partition("[")[0])
        if share is not None:
            assert row.after == pytest.approx(row.before + abs(row.before) * share * row.deviations, rel=1e-9)


def test_slow_loops_are_the_slow_ones():
    time = np.arange(20_000) * 1e-4
    fast = 20.0 - 20.0 * np.cos(2 * np.pi * 50.0 * time[:2000])
    slow = 25.0 - 25.0 * np.cos(2 * np.pi * 2.0 * time[:10_000])
    steps = np.repeat([0.0, 50.0, 0.0, 50.0, 0.0], 1000)
    command = np.concatenate([np.zeros(500), fast, steps, slow])
    (loop,) = slow_loops(command, 1)
    begin = 500 + len(fast) + len(steps)
    assert loop.start >= begin - 1000 and np.ptp(command[loop]) == pytest.approx(50.0, rel=1e-3)
    assert slow_loops(np.linspace(0.0, 1.0, 100)) == [slice(0, 100)]


@pytest.mark.parametrize("name", list(EFFECTS))
def test_every_effect_has_a_phrase_of_told_parameters(name):
    """With each told value 0.02 the phrase is a text without braces; with a value missing it is the name."""
    effect = EFFECTS[name]
    assert effect.phrase
    fields = re.findall(r"{(\w+)}", effect.phrase)
    row = {"value": 0.02, "unit": "s"}
    text = named({"name": name, "parameters": dict.fromkeys(fields, row)})
    assert "{" not in text and ("20 ms" in text or not fields)
    assert named({"name": name}) == name.replace("_", " ")


@pytest.mark.parametrize("width", [420, 1400])
def test_a_folded_page_is_short_and_says_what_to_do(page, width, browser):
    path, document = page
    seen = browser(path, width)
    assert seen.figures == 1 and seen.height <= 2500
    assert sentence(document) in seen.text and all(action in seen.text for action in actions(document))
    assert not seen.complaints and not seen.overlaps and not seen.empty_axes and not seen.too_wide


@pytest.mark.parametrize("verdict", [verdict.value for verdict in Verdict])
def test_every_verdict_has_its_advice(page, verdict):
    told = actions({**page[1], "verdict": verdict})
    assert told[0].endswith(".") and "{" not in told[0]


@pytest.mark.parametrize("width", [420, 1400])
def test_a_browser_shows_the_page_without_overlap(page, width, browser):
    path, _ = page
    seen = browser(path, width, unfolded=True)
    assert seen.figures >= 6 and not seen.empty_tables
    assert not seen.complaints and not seen.overlaps and not seen.empty_axes and not seen.too_wide

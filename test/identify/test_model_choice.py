"""Choice between families: slow ones are tried only where the usual ones do badly, and win only by their held-out error."""

from __future__ import annotations

import pytest

from hyst_control.base.errors import InputError
from hyst_control.identify import Fit
from hyst_control.identify.assess.model_choice import POOR, USELESS, best_family


class Stand:
    """Fits by name of given held-out errors (%) and numbers of parameters; notes which were asked for."""

    def __init__(self, **known: tuple[float, int]) -> None:
        self.known, self.asked = known, []

    def __call__(self, name: str) -> Fit:
        self.asked.append(name)
        if name not in self.known:
            raise InputError(f"{name}: does not suit")
        error, count = self.known[name]
        return Fit(None, {"family": name, "held_out_nrmse": [error], "parameters": [{}] * count, "records": [], "notes": []})


@pytest.mark.parametrize(
    "first, slow, asked, chosen",
    [
        (0.9 * POOR, 0.1, ["a", "b"], "a"),
        (1.5 * POOR, 0.1, ["a", "b", "slow"], "slow"),
        (0.91, 0.2, ["a", "b", "slow"], "slow"),  # what hampi leaves of the plant `third`: too much
        (1.5 * POOR, 1.6 * POOR, ["a", "b", "slow"], "a"),
    ],
)
def test_the_second_choice_is_tried_where_the_first_is_poor_and_wins_by_its_error(first, slow, asked, chosen):
    stand = Stand(a=(first, 5), b=(2.0 * first, 3), slow=(slow, 20))
    fit = best_family(["a", "b"], stand, ["slow"])
    assert stand.asked == asked and fit.report["family"] == chosen
    assert [row["family"] for row in fit.report["tried"] if row["chosen"]] == [chosen]


def test_a_second_choice_that_does_not_suit_leaves_the_first():
    fit = best_family(["a"], Stand(a=(2.0 * POOR, 5)), ["slow"])
    assert fit.report["family"] == "a" and fit.report["tried"][1]["refused"] == "slow: does not suit"


def test_a_family_whose_simulation_explains_nothing_is_passed_over():
    """Rows that were not fitted are predicted with a zero of their own, and do not show that a simulation runs away."""
    stand = Stand(a=(0.2, 5), b=(0.4, 3), slow=(0.3, 20))
    fit = best_family(["a", "b"], stand, ["slow"], lambda fit: fit.report["family"] != "a")
    assert stand.asked == ["a", "b"] and fit.report["family"] == "b"
    assert fit.report["tried"][0]["refused"] == USELESS


def test_the_second_choice_is_tried_where_no_other_simulation_is_of_use():
    stand = Stand(a=(0.2, 5), slow=(0.4, 20))
    assert best_family(["a"], stand, ["slow"], lambda fit: fit.report["family"] == "slow").report["family"] == "slow"
    assert best_family(["a"], stand, ["slow"], lambda fit: False).report["family"] == "a"

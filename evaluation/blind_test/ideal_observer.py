# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ideal observer: how often the best possible diagnosis would name the true effect of a case.

It knows the noise, the model's discrepancy and every effect's best fit, and names the effect that comes closest to the record. Let d_j be
what the fit of effect j differs by from that of the true one, in units of noise and discrepancy. With noise n ~ N(0, I) effect j comes
closer where dⱼᵀn > ½ dⱼᵀdⱼ, so that only the products of the differences are needed. "Nothing", the coefficients alone, is as probable
beforehand as all effects together.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Annotated, Any

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis

DRAWS = 1000
"""Records that are drawn for a case."""


def separation(part: AxisDiagnosis) -> dict[str, Any]:
    """Names of the effects that were fitted alone or together, none for "nothing", and the products (E, E) of what their fits leave."""
    best: dict[tuple[str, ...], Array] = {}
    for one in sorted(part.hypotheses, key=lambda one: one.solution.misfit):
        if not one.inflated:
            best.setdefault(tuple(sorted(one.names)), one.solution.residual)
    left = np.array(list(best.values())).reshape(len(best), -1)
    return {"names": [list(names) for names in best], "products": (part.problem.weight * (left @ left.T)).tolist()}


def ceiling(names: Sequence[Sequence[str]], products: Annotated[Array, "E E"], accepted: Sequence[Collection[str]]) -> float | None:
    """Probability that an ideal observer names the true effects, each by an accepted name; None where they were not fitted."""
    products = np.asarray(products, dtype=float)
    right = [i for i, one in enumerate(names) if len(one) == len(accepted) and all({*one} & {*each} for each in accepted)]
    if not right:
        return None
    index = min(right, key=lambda i: products[i, i])
    rivals = [i for i, one in enumerate(names) if i not in right and len(one) <= len(accepted)]
    if not rivals:
        return 1.0
    # Products of the differences d_j = r_true - r_j.
    gram = products[np.ix_(rivals, rivals)] - products[rivals, index][:, None] - products[index, rivals] + products[index, index]
    values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = np.random.default_rng(0).standard_normal((DRAWS, len(rivals))) @ root.T
    alone = {names[i][0] for i in range(len(names)) if len(names[i]) == 1}
    odds = np.array([0.0 if names[i] else np.log(max(len(alone), 1)) for i in rivals])
    return float(np.mean(np.all(drawn < 0.5 * np.diag(gram) - odds, axis=1)))

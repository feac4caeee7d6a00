"""Options that several families have."""

from __future__ import annotations

from hyst_control.identify.families.options import TEXT, Kind, option
from hyst_control.identify.solve.gram_sums import NUISANCES
from hyst_control.identify.solve.stable_dynamics import Structure


def nuisance_option(default: str, methods: tuple[str, ...] = ()) -> str:
    """Declare the option `nuisance`: the offset or drift that each record may add to the model."""
    return option(
        default,
        TEXT,
        "what each record may add to the model: an offset, or an offset and a slow drift, so that creep does not bend the loop",
        choices=tuple(NUISANCES),
        methods=methods,
    )


def structure_option() -> Structure | None:
    """Declare the structure of G(s)."""
    return option(
        None,
        Kind("factors of G(s) such as modes=1,lags=1,zeros=2,slow_pair,delay", Structure.parse),
        "factors of G(s), where they are not to be chosen on held-out data",
    )

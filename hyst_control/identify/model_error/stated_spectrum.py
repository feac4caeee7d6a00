# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Spectrum of the model discrepancy as its file states it: in bands, beside the spectrum of the output that it belongs to.

The error and the output of the model on the baseline records are each reduced to the largest power in bands of a sixth of an octave. A
reader makes from them what the baseline records themselves would have told: how large the error is at each frequency, and how far a new
command drives the model where the clean ones did not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.identify.data.excited_band import lowest_frequency
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.records.session_zero import without_zero
from hyst_control.records.stream.row_store import spread_parts

BANDS = 6  # Bands an octave
MAX_ROWS, MAX_PARTS = 2**18, 4  # Rows of a part, and parts, that are read of a longer record
DIGITS = 3  # That are stated: a spectrum is hardly ever known to a percent


@dataclass(frozen=True, eq=False)
class StatedSpectrum:
    """Spectrum of the model discrepancy of one axis."""

    frequencies: Annotated[Array, "F"]  # Lower edges of the bands, ascending from 0, Hz
    # Largest power of the error in each band, beyond the white noise: square of an orthonormal cosine coefficient of a record of
    # `rows` rows, measurement unit squared
    error: Annotated[Array, "F"]
    rest: Annotated[Array, "F"]  # The same of what the learned part of the error leaves
    output: Annotated[Array, "F"]  # The same of the model's output
    output_rms: float  # Rms of that output, without zero and drift, measurement unit
    noise: float  # White noise of the records, rms, measurement unit
    rows: int  # Rows of the record that the power is of: that of lines grows with them

    @classmethod
    def of(
        cls,
        commands: Sequence[Array],
        errors: Sequence[Array],
        rests: Sequence[Array],
        measurements: Sequence[Array],
        sample_time: float,
    ) -> StatedSpectrum:
        """Estimate the spectrum from baseline records."""
        kept = [_parts(len(error)) for error in errors]
        counted = [command[len(command) - len(error) :] for command, error in zip(commands, errors, strict=True)]
        slowest = lowest_frequency(_cut(counted, kept), sample_time)
        rows = min(max(map(len, errors)), MAX_ROWS)
        edges = band_edges(rows)

        def spectrum(series: Sequence[Array]) -> tuple[Array, float]:
            found = ErrorSpectrum.of([without_zero(one[:, None])[0] for one in series], sample_time, rows, slowest)
            return np.maximum.reduceat(found.power[:, 0], edges), float(found.noise[0])

        error, noise = spectrum(_cut(errors, kept))
        rest = error if rests is errors else spectrum(_cut(rests, kept))[0]
        pairs = zip(_cut(measurements, kept), _cut(errors, kept), strict=True)
        outputs = [without_zero((measured - error)[:, None])[0][:, 0] for measured, error in pairs]
        size = float(np.sqrt(np.mean(np.concatenate(outputs) ** 2)))
        return cls(0.5 / sample_time * edges / rows, error, rest, spectrum(outputs)[0], size, noise, rows)

    def document(self) -> dict[str, Any]:
        """Convert to the form in a model file; `rest` only where it differs."""
        found = {
            "rows": self.rows,
            "noise": rounded(self.noise),
            "output_rms": rounded(self.output_rms),
            "frequencies": rounded(self.frequencies, 7),
            "error": rounded(self.error),
            "output": rounded(self.output),
        }
        return found if self.rest is self.error else found | {"rest": rounded(self.rest)}

    @classmethod
    def from_document(cls, document: Any) -> StatedSpectrum:
        """Read the form in a model file."""
        try:
            rows, noise, size = int(document["rows"]), float(document["noise"]), float(document["output_rms"])
            frequencies, error, output = (np.asarray(document[name], dtype=float) for name in ("frequencies", "error", "output"))
            rest = np.asarray(document["rest"], dtype=float) if "rest" in document else error
        except (KeyError, TypeError, ValueError) as problem:
            raise InputError(
                f"discrepancy.spectrum: is not what hyst identify writes ({problem!r}): identify the model again"
            ) from None
        powers = np.stack([error, rest, output]) if error.shape == rest.shape == output.shape else np.full((1, 1), np.nan)
        if (
            frequencies.shape != error.shape
            or frequencies.ndim != 1
            or not len(frequencies)
            or frequencies[0] != 0.0
            or not np.all(np.diff(frequencies) > 0)
            or not (np.isfinite(powers).all() and np.all(powers >= 0))
            or not (rows > 0 and np.isfinite([noise, size]).all() and noise >= 0 and size >= 0)
        ):
            raise InputError(
                "discrepancy.spectrum: must have ascending frequencies from 0, as many powers >= 0 of error and output, a noise and an "
                "output_rms >= 0, and rows > 0: identify the model again"
            )
        return cls(frequencies, error, rest, output, size, noise, rows)


def band_edges(rows: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """First cosine coefficient of each band."""
    edges = np.rint(2.0 ** (np.arange(int(BANDS * np.log2(rows)) + 1) / BANDS)).astype(np.int64)
    return np.unique(np.concatenate([[0], edges[edges < rows]]))


def spectrum_on_new_records(
    stated: Sequence[StatedSpectrum],
    outputs: Sequence[Array],
    sample_time: float,
    slowest: float,
    relative: Annotated[Array, "A"],
    with_learned: bool,
) -> ErrorSpectrum:
    """Predict the spectrum of the model discrepancy on new records."""
    rows = max(map(len, outputs))
    frequencies = 0.5 / sample_time * np.arange(rows) / rows
    bands = [np.searchsorted(one.frequencies, frequencies, side="right") - 1 for one in stated]
    new = ErrorSpectrum.of(outputs, sample_time, rows, slowest)
    # The largest power in each band, of the new output as of the known one.
    pooled = np.stack([_largest(column, band) for column, band in zip(new.power.T, bands, strict=True)], axis=1)

    def at_rows(powers: Sequence[Array]) -> Array:
        longer = [max(rows / one.rows, 1.0) for one in stated]
        return np.stack([much * power[band] for much, power, band in zip(longer, powers, bands, strict=True)], axis=1)

    noise = np.array([one.noise for one in stated])
    error = ErrorSpectrum(frequencies, at_rows([one.rest if with_learned else one.error for one in stated]), noise)
    known = ErrorSpectrum(frequencies, at_rows([one.output for one in stated]), noise)
    return error.for_output(known, ErrorSpectrum(frequencies, pooled, noise), relative)


def _parts(rows: int) -> list[slice]:
    """The record, or parts of it where it is long."""
    if rows <= MAX_ROWS:
        return [slice(0, rows)]
    count = min(MAX_PARTS, rows // MAX_ROWS)
    return spread_parts(rows, count * MAX_ROWS, count)


def _cut(series: Sequence[Array], parts: Sequence[Sequence[slice]]) -> list[Array]:
    return [np.asarray(rows[part]) for rows, kept in zip(series, parts, strict=True) for part in kept]


def _largest(power: Array, band: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> Array:
    """Power (N,) replaced by the largest in its band (N,), ascending."""
    begins = np.flatnonzero(np.diff(band, prepend=-1))
    return np.repeat(np.maximum.reduceat(power, begins), np.diff(begins, append=len(power)))


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Numbers to so many digits, in lists where there are several."""
    if np.ndim(value):
        return [rounded(item, digits) for item in value]
    return float(f"{float(value):.{digits}g}")

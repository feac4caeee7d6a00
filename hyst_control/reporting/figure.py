# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A figure as plain data, as a page's plotting library takes it: curves and bars in one pair of axes or a grid of them."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np


class Figure:
    """Traces and layout of a figure; rows and columns of its grid are counted from 1, from the top left."""

    def __init__(
        self,
        rows: int = 1,
        cols: int = 1,
        *,
        titles: Sequence[str] = (),
        spacing: tuple[float | None, float | None] = (None, None),
        heights: Sequence[float] = (),
        shared_x: bool = False,
    ) -> None:
        """Lay out the axes; spacing: between columns and between rows, as a share of the figure."""
        self.data: list[dict[str, Any]] = []
        self.layout: dict[str, Any] = {"xaxis": {}, "yaxis": {}}
        self._rows, self._cols = rows, cols
        if rows * cols == 1:
            return
        beside = 0.2 / cols if spacing[0] is None else spacing[0]
        below = 0.3 / rows if spacing[1] is None else spacing[1]
        width, parts = (1.0 - beside * (cols - 1)) / cols, np.array(heights or [1.0] * rows)
        tall = (1.0 - below * (rows - 1)) * parts / parts.sum()
        top, middles = 1.0, list[tuple[float, float]]()
        for row, height in enumerate(tall.tolist(), start=1):
            for col in range(1, cols + 1):
                left, number = (col - 1) * (width + beside), self._number(row, col)
                x: dict[str, Any] = {"anchor": f"y{number}", "domain": [left, left + width]}
                if shared_x and row < rows:
                    x |= {"matches": f"x{self._number(rows, col)}", "showticklabels": False}
                self.layout[f"xaxis{number}"] = x
                self.layout[f"yaxis{number}"] = {"anchor": f"x{number}", "domain": [max(top - height, 0.0), top]}
                middles.append((left + width / 2.0, top))
            top -= height + below
        place = {"xanchor": "center", "xref": "paper", "yanchor": "bottom", "yref": "paper"}
        look = {**place, "showarrow": False, "font": {"size": 13}}
        self.layout["annotations"] = [{"text": text, "x": x, "y": y, **look} for (x, y), text in zip(middles, titles, strict=False)]

    def _number(self, row: int, col: int) -> str:
        number = (row - 1) * self._cols + col
        return "" if number == 1 else str(number)

    def add(self, kind: str, row: int = 1, col: int = 1, **trace: Any) -> None:
        """Add a trace, as the plotting library describes it."""
        number = self._number(row, col)
        self.data.append({"type": kind, "xaxis": f"x{number}", "yaxis": f"y{number}", **trace})

    def axes(self, letter: str, row: int | None = None, col: int | None = None, title: str | None = None, **values: Any) -> None:
        """Set values of horizontal ("x") or vertical ("y") axes, of a row, of a column or of all."""
        if title is not None:
            values["title"] = {"text": title}
        for r in range(1, self._rows + 1) if row is None else [row]:
            for c in range(1, self._cols + 1) if col is None else [col]:
                self.layout[f"{letter}axis{self._number(r, c)}"].update(values)

    def to_plotly_json(self) -> dict[str, Any]:
        """The figure in values that JSON has."""
        return {"data": [dict(_plain(trace)) for trace in self.data], "layout": self.layout}


def _plain(values: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Entries with arrays as the plotting library reads them, bytes in base 64; it knows no integers of 64 bit."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield name, dict(_plain(value))
        elif isinstance(value, np.ndarray):
            numbers = value.astype(np.float64) if value.dtype.kind in "iu" else value
            yield name, {"dtype": numbers.dtype.str[1:], "bdata": base64.b64encode(numbers.tobytes()).decode()}
        else:
            yield name, value

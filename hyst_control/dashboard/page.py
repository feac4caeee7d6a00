# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a running loop: curves, the loop as it turns, the gap and its alarm, diagnostics, and the buttons."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady, Event
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, CustomJS, CustomJSTickFormatter, DataRange1d, LinearAxis
from bokeh.models.widgets import Button, Div
from bokeh.plotting import figure

from hyst_control.dashboard.live_state import LiveState, LoopEvent, NodeState, Trace
from hyst_control.reporting.html_page import COLORS
from hyst_control.reporting.templates import render

INTERVAL = 150  # ms, between two looks at the state
REST = 3.0
"""Pause after an update, in the time that the browser took to draw it: drawing keeps a quarter of a core busy at most."""
SILENT_AFTER = 1.0  # s without a row after which the page says so
MAX_ROWS = 20_000  # Rows of a curve that a browser keeps
NEUTRAL = "#7f8896"
"""Color of the reference and of axes, legible on a light and on a dark ground."""
SUBJECTS = {"reference": NEUTRAL, "measurement": COLORS[1], "error": COLORS[2], "command": COLORS[3], "gap": COLORS[4]}
"""Color of every subject, one on the whole page."""
ALARM = "#d62728"
NO_GAP = "No gap is shown: run the node diagnosis with a model of the stage."
CONFIRM = "requestAnimationFrame(() => setTimeout(() => { drawn.tags = [...cb_obj.tags] }, 0))"
"""Script of the page that says which update was drawn."""
DASHES = ("solid", "dashed", "dotdash", "dotted")  # Lines of the axes, in order
PANELS = (("reference", "measurement"), ("error",), ("command",))  # Subjects that share a figure over time
WRAP = {"flex-wrap": "wrap"}
WIDE = "1 1 20rem"  # Width of a figure in a row: as wide as there is room, below the others where that is too little
TEMPLATE = Path(__file__).parent / "templates" / "dashboard.html"


class Actions(Protocol):
    """Requests of a page to the nodes; none of them waits for the answer, which comes to `LiveState.answers`."""

    def ask(self, what: str) -> None:
        """Ask the nodes that drive the actuator for `what`: `enable`, `stop` or `reset`."""

    def record(self) -> None:
        """Begin a recording, or end the one that runs."""

    @property
    def recording(self) -> str:
        """Sentence about the recording that runs, "" when there is none."""


class LivePage:
    """Documents of the page, one for every browser window that opens it."""

    def __init__(self, state: LiveState, actions: Actions, title: str) -> None:
        self._state, self._actions, self._title = state, actions, title

    def __call__(self, document: Document) -> None:
        """Fill a document that was just opened, and keep it up to date until it is closed."""
        document.title = self._title
        cast(Any, document).template = TEMPLATE.read_text(encoding="utf-8")
        _Window(document, self._state, self._actions)


class _Curve:
    """Source of a figure that is fed with the new rows of a trace."""

    def __init__(self, trace: Trace) -> None:
        self.source = ColumnDataSource({"t": np.zeros(0)})
        self.columns: tuple[str, ...] = ()
        self._trace, self._epoch, self._index = trace, 0, 0

    def update(self, columns_changed: Callable[[], None]) -> bool:
        """Take over new rows; True when there were some."""
        before = self._epoch
        self._epoch, self._index, rows = self._trace.since(self._epoch, self._index)
        if not len(rows):
            return False
        columns = self._trace.columns
        data: dict[str, Any] = {"t" if index == 0 else name: rows[:, index] for index, name in enumerate(columns)}
        if self._epoch != before:
            changed, self.columns = columns != self.columns, columns
            self.source.data = data
            if changed:
                columns_changed()
        else:
            self.source.stream(data, rollover=MAX_ROWS)
        return True


class _Window:
    """One open window: its figures, texts and buttons."""

    def __init__(self, document: Document, state: LiveState, actions: Actions) -> None:
        self._state, self._actions = state, actions
        self._signals, self._gap = _Curve(state.signals), _Curve(state.gap)
        self._turn = ColumnDataSource({})
        self._alarm = ColumnDataSource({"t": np.zeros(0), "nrmse[%]": np.zeros(0)})
        self._turn_columns: tuple[str, ...] = ()
        self._status = Div(name="status", text="", sizing_mode="stretch_width")
        self._answers = Div(name="answers", text="", sizing_mode="stretch_width")
        self._nodes = Div(name="nodes", text="", sizing_mode="stretch_width")
        self._numbers = Div(name="numbers", text="", styles={"flex": "1 1 11rem"})
        self._events = Div(name="events", text="", sizing_mode="stretch_width")
        self._over_time = column(name="over_time", sizing_mode="stretch_width", styles={"flex": "20 1 20rem"})
        self._beside = row(Div(text=""), Div(text=NO_GAP), name="beside", sizing_mode="stretch_width", styles=WRAP)
        self._record = Button(label="record", name="record", width=110)
        self._record.on_click(actions.record)
        kinds = {"enable": "success", "stop": "danger", "reset": "default"}
        buttons = [*(self._button(what, kind) for what, kind in kinds.items()), self._record]
        top = row(*buttons, name="buttons", styles=WRAP), self._status, self._answers
        curves = row(self._over_time, self._numbers, name="curves", sizing_mode="stretch_width", styles=WRAP)
        below = self._beside, self._events, self._nodes
        document.add_root(column(*top, curves, *below, sizing_mode="stretch_width", name="dashboard"))
        self._sent, self._drawn = 0, -1  # number of the newest update, and of the newest one that the browser has drawn
        self._sent_at = self._rested_at = 0.0  # s, of the monotonic clock
        document.on_event(DocumentReady, self._ready)
        self._status.js_on_change("tags", CustomJS(args={"drawn": self._answers}, code=CONFIRM))
        self._answers.on_change("tags", self._confirmed)
        self._show()
        document.add_periodic_callback(self.update, INTERVAL)

    def update(self) -> None:
        """Show what is new, once the browser has drawn what it got before: a slow one, or one in the background, gets less."""
        if self._drawn != self._sent or time.monotonic() < self._rested_at:
            return
        self._show()
        self._sent += 1
        self._sent_at = time.monotonic()
        self._status.tags = [self._sent]

    def _show(self) -> None:
        self._signals.update(self._draw_signals)
        if self._gap.update(self._draw_gap):
            self._mark_alarms()
        self._turn_on()
        _set(self._status, render("dashboard/templates/status.html", **self._status_values()))
        _set(self._answers, render("dashboard/templates/answers.html", answers=list(self._state.answers)))
        nodes = self._state.nodes
        _set(self._nodes, render("dashboard/templates/nodes.html", nodes=nodes))
        _set(self._numbers, render("dashboard/templates/numbers.html", numbers=_numbers(nodes)))
        _set(self._events, render("dashboard/templates/events.html", events=_told(self._state.events)))
        label = "end recording" if self._actions.recording else "record"
        if self._record.label != label:
            self._record.label = label

    def _ready(self, _event: Event) -> None:
        self._drawn = self._sent

    def _confirmed(self, _attribute: str, _before: Any, now: list[int]) -> None:
        self._drawn = int(now[0]) if now else self._drawn
        now_at = time.monotonic()
        self._rested_at = now_at + REST * (now_at - self._sent_at)

    def _status_values(self) -> dict[str, Any]:
        age = self._state.signals.age
        values = self._gap.source.data.get("alarm[]", ())
        return {
            "silent": age > SILENT_AFTER,
            "ever": bool(np.isfinite(age)),
            "age": age,
            "nodes": self._state.nodes,
            "alarm": bool(len(values)) and bool(values[-1]) and self._state.gap.age < 10.0,
            "recording": self._actions.recording,
        }

    def _button(self, what: str, kind: Any) -> Button:
        button = Button(label=what, button_type=kind, name=what, width=110)
        button.on_click(lambda: self._actions.ask(what))
        return button

    def _draw_signals(self) -> None:
        figures: list[Any] = []
        for subjects in PANELS:
            names = [name for name in self._signals.columns[1:] if name.partition("_")[0] in subjects]
            if not names:
                continue
            label = "" if len(subjects) > 1 else f"{subjects[0]} "
            drawn = _figure("time [s]", f"{label}[{_unit(names[0])}]", 240 if len(subjects) > 1 else 170)
            drawn.name = subjects[-1]
            for name in names:
                subject, axis = name.partition("[")[0].split("_", 1)
                dash = DASHES[[each for each in names if each.startswith(subject)].index(name) % 4]
                look = {"color": SUBJECTS[subject], "line_dash": dash, "legend_label": f"{subject} {axis}"}
                drawn.line("t", name, source=self._signals.source, **look)
            newest = DataRange1d(follow="end", follow_interval=self._state.signals.window, range_padding=0.0)
            drawn.x_range = figures[0].x_range if figures else newest
            _quiet_legend(drawn)
            figures.append(drawn)
        self._over_time.children = figures

    def _turn_on(self) -> None:
        columns, rows = self._state.turn
        if not len(rows):
            return
        data = {name: rows[:, index] for index, name in enumerate(columns)}
        self._turn.data = data
        if columns != self._turn_columns:
            self._turn_columns = columns
            axes = (len(columns) - 1) // 2
            x, y = f"command ({_unit(columns[1])})", f"measurement ({_unit(columns[-1])})"
            drawn = _figure(x, y, 380)
            drawn.name = "loop"
            for index in range(axes):
                command, measurement = columns[1 + index], columns[1 + axes + index]
                drawn.line(command, measurement, source=self._turn, color=SUBJECTS["measurement"], line_dash=DASHES[index % 4])
            drawn.styles = {"flex": WIDE}
            self._beside.children = [drawn, *self._beside.children[1:]]

    def _draw_gap(self) -> None:
        drawn = _figure("time [s]", "gap [% of the range]", 380)
        drawn.name = "gap"
        drawn.y_range = DataRange1d(start=0.0)
        drawn.line("t", "nrmse[%]", source=self._gap.source, color=SUBJECTS["gap"], line_width=1.5)
        drawn.scatter("t", "nrmse[%]", source=self._alarm, color=ALARM, size=7)
        drawn.styles = {"flex": WIDE}
        self._beside.children = [*self._beside.children[:1], drawn]

    def _mark_alarms(self) -> None:
        data = {name: np.asarray(values) for name, values in self._gap.source.data.items()}
        alarms = data["alarm[]"] > 0
        if np.count_nonzero(alarms) or len(self._alarm.data["t"]):
            self._alarm.data = {name: data[name][alarms] for name in ("t", "nrmse[%]")}


def _numbers(nodes: Sequence[NodeState]) -> list[tuple[str, str]]:
    """Numbers of the last second, with what they are of: the errors, then the rate of the node that keeps its own least."""
    errors = [
        (key.replace("[", "(").replace("]", ")"), value)
        for node in nodes
        if not node.lost
        for key, value in node.values.items()
        if key.startswith(("rms error ", "peak error "))
    ]
    ticking = [(*node.rate, node.name) for node in nodes if node.rate is not None]
    timed = [(made / wanted, made, wanted, name) for made, wanted, name in ticking if wanted > 0.0]
    if timed:
        _, made, wanted, name = min(timed)
        return [*errors, (f"rate (Hz) of {wanted:g}, {name}", f"{made:.0f}")]
    return [*errors, *[(f"rate (Hz), {name}", f"{made:.0f}") for made, _, name in ticking[:1]]]


def _told(events: Iterable[LoopEvent]) -> list[tuple[str, LoopEvent]]:
    """Events with their times of day, the newest first."""
    return [(time.strftime("%H:%M:%S", time.localtime(event.when)), event) for event in reversed(list(events))]


def _set(div: Div, text: str) -> None:
    if div.text != text:
        div.text = text


def _unit(column: str) -> str:
    return column.partition("[")[2].rstrip("]")


def _figure(x: str, y: str, height: int) -> Any:
    """An empty figure that is legible on a light and on a dark ground."""
    drawn: Any = figure(height=height, sizing_mode="stretch_width", toolbar_location=None, x_axis_label=x, y_axis_label=y, tools="")
    drawn.background_fill_alpha = drawn.border_fill_alpha = 0.0
    drawn.outline_line_color = None
    drawn.grid.grid_line_color, drawn.grid.grid_line_alpha = NEUTRAL, 0.3
    for axis in drawn.select(LinearAxis):
        axis.axis_label_text_color = axis.major_label_text_color = axis.axis_line_color = NEUTRAL
        axis.major_tick_line_color, axis.minor_tick_line_color = NEUTRAL, None
        axis.axis_label_text_font_style = "normal"
        axis.formatter = CustomJSTickFormatter(code="return String(Number(tick.toPrecision(7)))")
    return drawn


def _quiet_legend(drawn: Any) -> None:
    drawn.add_layout(drawn.legend[0], "above")
    drawn.legend.orientation = "horizontal"
    if len(drawn.legend[0].items) > 2:
        drawn.legend.ncols = 2  # on a telephone there is room for no more
    drawn.legend.background_fill_alpha = 0.0
    drawn.legend.border_line_color = None
    drawn.legend.label_text_color = NEUTRAL
    drawn.legend.label_text_font_size = "11px"
    drawn.legend.padding = drawn.legend.margin = 2

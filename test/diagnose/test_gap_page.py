"""The page for people: what is on it, that it needs no network, and that a browser draws it without complaint."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
import pytest

from hyst_control.diagnose.gap_page import envelope, write_page
from hyst_control.diagnose.gap_report import sentence
from hyst_control.errors import InputError

DELAY = (("name", "delay"), ("tau", 2e-4))
BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)


@pytest.fixture(scope="module")
def page(answer, tmp_path_factory):
    document, diagnosis, better = answer("pea_published", DELAY)
    path = tmp_path_factory.mktemp("page") / "gap.html"
    write_page(path, document, diagnosis, better)
    return path, document


def test_the_page_says_the_verdict_and_stands_alone(page):
    path, document = page
    text = path.read_text(encoding="utf-8")
    assert sentence(document) in text
    assert len(text) < 8e6
    assert [path] == list(path.parent.iterdir())
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=['\"]?https?:", text)
    marked = re.findall(r"stroke='#c2542d'", text)
    assert len(marked) == 1  # the delay's one place


def test_the_page_of_no_gap_is_written_too(answer, tmp_path):
    write_page(tmp_path / "none.html", *answer("pea_published"))
    assert "No gap beyond" in (tmp_path / "none.html").read_text(encoding="utf-8")


def test_a_folder_that_is_none_is_refused(answer, tmp_path):
    with pytest.raises(InputError, match="choose a folder"):
        write_page(tmp_path / "missing" / "gap.html", *answer("pea_published"))


def test_an_envelope_keeps_every_extreme():
    values = np.random.default_rng(0).standard_normal(50_000)
    time, kept = envelope(np.arange(50_000) * 1e-4, values, bins=500)
    assert len(kept) == 1000 and np.all(np.diff(time) >= 0)
    edges = np.linspace(0, 50_000, 501).astype(int)
    for i, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        np.testing.assert_allclose(sorted(kept[2 * i : 2 * i + 2]), [values[a:b].min(), values[a:b].max()], rtol=1e-6)


@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_a_browser_draws_every_figure_without_complaint(page, tmp_path):
    path, _ = page
    done = subprocess.run(
        [
            BROWSER,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={tmp_path}",
            "--enable-logging=stderr",
            "--virtual-time-budget=10000",
            "--dump-dom",
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0
    complaints = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "rror" in line]
    assert not complaints
    figures = path.read_text(encoding="utf-8").count('class="plotly-graph-div"')
    assert figures >= 5 and done.stdout.count('class="main-svg"') >= figures

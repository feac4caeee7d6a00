"""The page of the papers' targets: what it says is met or missed follows the rows."""

import pytest

from hyst_control.cli import main
from hyst_control.errors import InputError
from hyst_control.reporting.tables import Table
from hyst_control.reproduction.hampi_published import FREQUENCIES, TABLE_5
from hyst_control.reproduction.page import write_page


def result(path, tracked: float = 1.0, gain_margin: float = 8.0):
    """A HAMPI result whose every figure is known."""
    table = Table("reproduce hampi", notes=["A note."])
    for frequency in TABLE_5["HAMPI"]:
        table.add("HAMPI Table 5", f"{frequency:g} Hz", "HAMPI, joint", "nrmse", "%", tracked)
        table.add("HAMPI Table 5", f"{frequency:g} Hz", "HAPI, joint", "nrmse", "%", 1.5)
    for frequency in FREQUENCIES:
        case = f"140 V, {frequency:g} Hz"
        for name, value in (("HAPI", 5.0), ("RDPI", 6.0), ("HAMPI", 2.0)):
            table.add("HAMPI Table 4", case, name, "nrmse", "%", value)
        for name in ("HAPI", "HAMPI"):
            for method, value in (("joint", 2.0), ("paper's sequence", 4.0)):
                for quantity in ("nrmse", "nrmse, rms over frequencies"):
                    table.add(
                        "HAMPI models: identified jointly and in the paper's sequence",
                        case,
                        f"{name}, {method}",
                        quantity,
                        "%",
                        value,
                    )
    for quantity, value in (("gain_margin", gain_margin), ("phase_margin", 60.0)):
        table.add("HAMPI model: feedback tuned on it", "truth, gain +0%, first mode +0%", "tuned PI", quantity, "", value)
    table.write(path)


@pytest.mark.parametrize(
    ("given", "missed"), [({}, 0), ({"tracked": 1.6}, 6), ({"gain_margin": 5.0}, 1), ({"gain_margin": float("nan")}, 1)]
)
def test_targets_are_met_or_missed_as_the_rows_say(tmp_path, given, missed):
    """1.6 % misses two of the published 1.50, 1.28, 1.61 and 2.25 %; HAPI's 1.5 % is below it four times."""
    result(tmp_path / "hampi.json", **given)
    assert main(["reproduce", "page", "--results", str(tmp_path / "hampi.json"), "--page", str(tmp_path / "page.md")]) == 0
    text = (tmp_path / "page.md").read_text()
    assert text.count("**missed**") == missed
    assert "- A note." in text and "### HAMPI Table 4" in text


def test_a_file_that_is_no_result_is_refused(tmp_path):
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="no result"):
        write_page([tmp_path / "other.json"], tmp_path / "page.md")
    assert main(["reproduce", "hampi", "--page", "page.md"]) == 2

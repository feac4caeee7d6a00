# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""YAML from outside: what stands for gigabytes, nests without an end or wears a wrong tag is refused at once, in one line."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from yaml import safe_dump, safe_load

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import MAX_BYTES, MAX_DEPTH, parse_yaml, read_yaml
from hyst_control.cli import main
from hyst_control.model_file import load_model
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.excitation.excitation_files import read_description
from hyst_plant_sim.physics import PlantError, load_plant

BOMB = "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefghij", "bcdefghijk", strict=True)
)
MERGES = "a: &a {k0: 1}\n" + "".join(
    f"m{i}: &m{i} {{<<: [{', '.join([f'*{before}'] * 9)}], k{i}: 1}}\n"
    for i, before in zip(range(9), ["a", *(f"m{k}" for k in range(8))], strict=True)
)
HEAD = "format: hyst_control/model\nversion: 1\naxes: [x]\nsample_time: 1.0e-4\nunits: {command: V, measurement: um}\n"
PARALLEL = "[{stage: parallel, branches: [" * 300 + "[{stage: gain, gain: 1.0}]" + "]}]" * 300
HOSTILE = {
    "aliases of aliases": BOMB,
    "merged aliases": MERGES,
    "an alias within itself": "a: &a [*a]",
    "brackets": "[" * 100_000,
    "braces": "{a: " * 50_000,
    "dashes": "- " * 50_000,
    "many keys": "\n".join(f"k{i}: {i}" for i in range(100_000)),
    "a wrong date": "signal: !!timestamp never",
    "a date that is none": "signal: 2001-99-99",
    "a wrong number": "signal: !!int ''",
    "a wrong truth value": "signal: !!bool perhaps",
    "a number of sixties": "signal: 1" + ":59" * 40_000,
    "nested parallel": HEAD + f"chain: {PARALLEL}\n",
    "a long text": "x: " + "a" * MAX_BYTES,
    "no text": b"\xff\xfe\x00",
    "control characters": "a: \x07",
}


def excitation(path):
    spec = read_description([str(path)])
    main(["excite", str(path), "--output", str(path.parent / "out.csv")])
    return spec


def metadata(path):
    """A bag whose metadata.yaml is that text; intact storage is read in spite of it, so there is none here."""
    folder = path.parent / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_bytes(path.read_bytes())
    return read_bag(folder)


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("reader", [load_model, load_plant, excitation, metadata, read_yaml], ids=lambda reader: reader.__name__)
def test_hostile_texts_end_in_one_line_at_once(reader, text, tmp_path, capsys):
    path = tmp_path / "hostile.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    begin = time.process_time()
    with pytest.raises((InputError, PlantError)) as refused:
        reader(path)
    assert time.process_time() - begin < 5.0
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 4000


@pytest.mark.parametrize("text", ["[1, 2]", "{signal: [sine]}", "{signal: {a: 1}}", "{signal: null}", "{1: 2, signal: sine}"])
def test_a_signal_that_is_no_name_is_refused(text, tmp_path, capsys):
    path = tmp_path / "odd.yaml"
    path.write_text(text)
    assert main(["excite", str(path), "--output", str(tmp_path / "out.csv")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text("abc: #é\n-1", max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abcdef", min_size=1, max_size=4), inner, max_size=4),
    max_leaves=20,
)


@given(VALUES)
def test_what_is_honest_reads_as_it_does_elsewhere(value):
    text = safe_dump(value)
    assert parse_yaml(text, "here") == safe_load(text) == value


def test_aliases_and_merges_of_honest_size_are_read():
    text = "a: &a {k: 1}\nb: *a\nc: {<<: *a, l: 2}\n"
    assert parse_yaml(text, "here") == {"a": {"k": 1}, "b": {"k": 1}, "c": {"k": 1, "l": 2}}
    assert parse_yaml("[" * MAX_DEPTH + "]" * MAX_DEPTH, "here") is not None
    with pytest.raises(InputError, match="here: line 3 .*the key 'k' stands twice"):
        parse_yaml("k: 1\nl: 2\nk: 2\n", "here")


@pytest.mark.parametrize(
    "text, words",
    [
        (BOMB, "its aliases counted"),
        ("[" * 100, "nested more than 64 deep"),
        (HOSTILE["many keys"], "a mapping of more than 10000 keys"),
        (HOSTILE["a long text"], "longer than 4 MiB"),
        ("x: " + "1" * 70_000, "a value of 70000 characters"),
        (HOSTILE["an alias within itself"], "stands within itself"),
        (HOSTILE["control characters"], "is not valid YAML: unreadable"),
        (HOSTILE["a wrong date"], "does not fit its tag"),
        ("{[1]: 2}", "a list or mapping cannot be a key"),
        ("a: 1\nb: [\n", "line 3 is not valid YAML"),
    ],
)
def test_a_refusal_says_what_the_matter_is(text, words):
    with pytest.raises(InputError, match=f"^here:.*{words}") as refused:
        parse_yaml(text, "here")
    assert ("its tag" in str(refused.value)) == ("its tag" in words)


def test_a_file_that_is_none_is_named(tmp_path):
    for path in (tmp_path / "none.yaml", tmp_path, f"{tmp_path}/a\0b"):
        with pytest.raises(InputError, match="give the path of a YAML file"):
            read_yaml(path)
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="is not a text file"):
        read_yaml(tmp_path / "bytes")


@pytest.mark.parametrize("path", sorted(config_path("models/pea_hampi.yaml").parent.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_models_are_far_from_the_limits(path):
    assert path.stat().st_size < MAX_BYTES / 100 and load_model(path)

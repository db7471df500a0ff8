"""Ids of parts."""

import json

import numpy as np

from msbdb.identity import part_ids, to_json


def ids(survey="survey", cell_m=0.5, **changes):
    """Return one id of a key with some changes."""
    key = {"threshold_px": 80, "row": -11_642_000, "col": 778_000, "piece": 0, **changes}
    return int(part_ids(survey, cell_m, **key)[0])


def test_an_id_depends_on_every_part_of_its_key():
    """Any change gives another id; no change gives the same."""
    changed = [
        ids(survey="other"),
        ids(cell_m=0.25),
        *(ids(**{name: 5}) for name in ("threshold_px", "row", "col", "piece")),
    ]
    assert ids() == ids()
    assert len({ids(), *changed}) == 7


def test_ids_are_positive_and_fit_59_bits():
    """They are safe in any signed 64-bit column."""
    found = part_ids("survey", 0.5, threshold_px=80, row=np.arange(5000), col=0, piece=0)
    assert found.dtype == np.int64
    assert found.min() > 0
    assert 2**57 < found.max() < 2**59
    assert np.unique(found).size == 5000


def test_an_id_is_pinned():
    """Databases of older versions hold such ids, so the recipe must not change unnoticed."""
    assert ids() == 415937913775108376


def test_colliding_keys_get_different_ids_in_any_order(monkeypatch):
    """With ids of 6 bits 40 keys meet, and each still gets its own, the same in any order."""
    monkeypatch.setattr("msbdb.identity.ID_BITS", 6)
    rows = np.arange(40)
    forward = part_ids("survey", 0.5, threshold_px=80, row=rows, col=0, piece=0)
    backward = part_ids("survey", 0.5, threshold_px=80, row=rows[::-1], col=0, piece=0)
    plain = [int(part_ids("survey", 0.5, threshold_px=80, row=row, col=0, piece=0)[0]) for row in rows]
    assert np.unique(forward).size == 40
    assert (forward == backward[::-1]).all()
    assert len(set(plain)) < 40


def test_one_key_twice_is_one_id():
    """Equal keys are no collision."""
    assert len(set(part_ids("survey", 0.5, threshold_px=80, row=[3, 3], col=[4, 4], piece=0).tolist())) == 1


def test_no_keys_give_no_ids():
    """An empty build is fine."""
    assert part_ids("survey", 0.5, threshold_px=[], row=[], col=[], piece=[]).size == 0


def test_numbers_keep_all_digits_where_another_library_makes_python_round_them(monkeypatch):
    """Digests of content depend on it: a database must not look damaged because cjio, say, was loaded."""
    value = {"b": [1 / 3, 2, None, True, 'ä"', 1e-300, float("nan")], "a": {"x": -0.5, "c": (), "e": {}}}
    expected = to_json(value)

    rounded = type("Rounded", (float,), {"__repr__": staticmethod(lambda number: format(number, ".6f"))})
    monkeypatch.setattr(json.encoder, "c_make_encoder", None)
    monkeypatch.setattr(json.encoder, "float", rounded, raising=False)
    assert json.dumps(1 / 3) == "0.333333"
    assert to_json(value) == expected
    assert "0.3333333333333333" in expected

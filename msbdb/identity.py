"""Stable ids, from absolute places or from words, never from a running counter; and values as canonical JSON."""

import hashlib
import json
import logging
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

logger = logging.getLogger(__name__)

ID_BITS = 59
"""Ids are below 2**59: they fit a signed 64-bit column with room to spare."""


def part_ids(
    survey: str,
    cell_m: float,
    *,
    threshold_px: ArrayLike,
    row: ArrayLike,
    col: ArrayLike,
    piece: ArrayLike,
) -> NDArray[np.int64]:
    """Return the ids of parts, from the survey and the parts' absolute places.

    Parameters
    ----------
    survey : str
        Name of the survey.
    cell_m : float
        Side of a cell, metres; taken in whole millimetres.
    threshold_px : (N,) array_like of int
        Area threshold s of the part's scale, cells; 0 for a region that belongs to no scale.
    row, col : (N,) array_like of int
        Absolute lattice place of the part's first cell, when the part was made: ``GridSpec.origin`` plus the place in
        the array. Hence the ids do not depend on the tile.
    piece : (N,) array_like of int
        0 for a cluster as found, n + 1 for a piece split off a region of number n.

    Returns
    -------
    (N,) ndarray of int64
        From 1 to 2**59 - 1.

    Notes
    -----
    An id is a BLAKE2b digest of its key. Two keys may get one id, in about one of a million builds of a million parts.
    Then the larger key, in the order of (threshold, row, col, piece), is digested again with a count. One key given
    twice gets one id.
    """
    keys = np.stack(
        np.broadcast_arrays(*(np.asarray(x, dtype=np.int64) for x in (threshold_px, row, col, piece))), axis=-1
    ).reshape(-1, 4)
    start = hashlib.blake2b(f"{round(cell_m * 1000)}\0{survey}".encode(), digest_size=8)
    ids = _digests(start, keys, 0)
    salt = 0
    while (late := _colliding(keys, ids)).size:
        salt += 1
        logger.info("%d part ids met another one; digested again", late.size)
        ids[late] = _digests(start, keys[late], salt)
    return ids


def _digests(start: "hashlib.blake2b", keys: NDArray[np.int64], salt: int) -> NDArray[np.int64]:
    """Digest each key after the common start; 0 is no id and becomes 1."""
    salted = np.column_stack([keys, np.full(len(keys), salt)]).astype("<i8")
    width = salted.shape[1] * 8
    packed = salted.tobytes()
    digests = bytearray()
    for at in range(0, len(packed), width):
        digest = start.copy()
        digest.update(packed[at : at + width])
        digests += digest.digest()
    found = np.frombuffer(bytes(digests), dtype="<u8") >> np.uint64(64 - ID_BITS)
    return np.maximum(found.astype(np.int64), 1)


def _colliding(keys: NDArray[np.int64], ids: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the places of the keys whose id belongs to a smaller key."""
    order = np.lexsort((*keys.T[::-1], ids))
    same_id = ids[order][1:] == ids[order][:-1]
    other_key = (keys[order][1:] != keys[order][:-1]).any(axis=1)
    late: NDArray[np.intp] = order[1:][same_id & other_key]
    return late


def plain(value: Any) -> Any:  # noqa: ANN401  (parameters and counts are nested plain values)
    """Return nested mappings, dataclasses, lists and scalars in the types of JSON.

    NaN and infinities become null, and -0.0 becomes 0.0, as databases keep it.
    """
    # The most frequent ones first, as asking for a mapping takes longer than all the others.
    if value is None or type(value) in (str, int, bool):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    return {str(key): plain(item) for key, item in value.items()} if isinstance(value, Mapping) else value


def to_json(value: Any) -> str:  # noqa: ANN401  (any value of JSON)
    """Return a value as JSON with sorted keys."""
    return exact_json(plain(value))


def exact_json(value: Any) -> str:  # noqa: ANN401  (any value of JSON)
    """Return plain values as JSON with sorted keys and all digits of numbers.

    Some libraries, cjio among them, change Python's own writer for the whole process, so that it rounds numbers. Then
    the values are written here: digests and ids must not depend on what else is loaded.
    """
    if getattr(json.encoder, "float", float) is float:
        return json.dumps(value, sort_keys=True, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{exact_json(str(key))}: {exact_json(value[key])}" for key in sorted(value)) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(exact_json, value)) + "]"
    if isinstance(value, float) and math.isfinite(value):
        return float.__repr__(value)
    return json.dumps(value, ensure_ascii=False)


def text_id(*words: object) -> int:
    """Return a key above 0 from the words that identify a row; so keys do not depend on the order of loading."""
    digest = hashlib.blake2b("\0".join(str(word) for word in words).encode(), digest_size=8).digest()
    return max(int.from_bytes(digest, "little") >> (64 - ID_BITS), 1)

"""Values in one canonical form, for JSON columns, digests and the dump."""

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

ID_BITS = 59
"""Width of the keys, the same as of the parts' ids."""


def plain(value: Any) -> Any:  # noqa: ANN401  (parameters and counts are nested plain values)
    """Return nested dictionaries, lists and scalars in the types of JSON; NaN and infinities become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(value: Any) -> str:  # noqa: ANN401
    """Return a value as JSON with sorted keys."""
    return json.dumps(plain(value), sort_keys=True, ensure_ascii=False, allow_nan=False)


def text_id(*words: object) -> int:
    """Return a key above 0 from the words that identify a row; so keys do not depend on the order of loading."""
    digest = hashlib.blake2b("\0".join(str(word) for word in words).encode(), digest_size=8).digest()
    return max(int.from_bytes(digest, "little") >> (64 - ID_BITS), 1)

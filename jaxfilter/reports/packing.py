"""Arrays and values as text in a page; ``data.js`` takes them apart again."""

from __future__ import annotations

import base64
import json
import math
import zlib
from typing import Any

import numpy as np

_LEVEL = 4


def pack(values: np.ndarray) -> str:
    """An array of u8 or u16 as base64: differences from one element to the next, byte by byte, deflated.

    Neighbours are mostly alike, so most differences are small and their upper bytes zero. Raises: TypeError.
    """
    if values.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"pack takes uint8 and uint16, not {values.dtype}")
    flat = values.ravel()
    difference = np.diff(flat, prepend=flat.dtype.type(0)).astype(flat.dtype.newbyteorder("<"), copy=False)
    planes = difference.view(np.uint8).reshape(-1, flat.dtype.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), _LEVEL)).decode("ascii")


def script_json(value: Any) -> str:
    """A value as JSON for the inside of a ``<script>``; NaN and infinities become null."""
    return json.dumps(_finite(value), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, np.ndarray | np.generic):
        return _finite(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value

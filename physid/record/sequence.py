"""Maximal-length binary sequences from linear feedback shift registers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

TAPS: Mapping[int, tuple[int, ...]] = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
    17: (17, 14),
    18: (18, 11),
    19: (19, 6, 2, 1),
    20: (20, 17),
    21: (21, 19),
    22: (22, 21),
    23: (23, 18),
    24: (24, 23, 22, 17),
}
"""Taps of a register of maximal length by its number of stages (P. Alfke, Xilinx XAPP 052)."""


def maximal_sequence(stages: int, length: int, state: int = 1) -> npt.NDArray[np.uint8]:
    r"""Bits of a maximal-length sequence.

    .. math:: a_k = \bigoplus_{t \in T} a_{k - t}

    Squaring a polynomial over GF(2) squares each of its terms, so the recurrence holds as well with
    every lag doubled, and the sequence is computed in blocks that double with it.

    Parameters
    ----------
    stages : int
        Stages of the register, one of `TAPS`; the period is 2**stages - 1.
    length : int
        Number of bits wanted.
    state : int
        First bits, lowest first: 1 to 2**stages - 1. Each gives another phase of the same sequence.

    Returns
    -------
    ndarray of uint8, shape (length,)
        Zeros and ones.
    """
    taps = TAPS[stages]
    bits = np.empty(max(length, stages), dtype=np.uint8)
    bits[:stages] = (state >> np.arange(stages)) & 1
    known, scale = stages, 1
    while known < length:
        while known >= 2 * scale * stages:
            scale *= 2
        block = min(min(taps) * scale, length - known)
        starts = [known - tap * scale for tap in taps]
        parts = [bits[start : start + block] for start in starts]
        bits[known : known + block] = np.bitwise_xor.reduce(parts)
        known += block
    return bits[:length]

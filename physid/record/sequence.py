"""Maximal-length binary sequences from linear feedback shift registers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

TAPS: Mapping[int, tuple[tuple[int, ...], ...]] = {
    2: ((2, 1),),
    3: ((3, 2), (3, 1)),
    4: ((4, 3), (4, 1)),
    5: ((5, 3), (5, 2), (5, 4, 3, 2), (5, 4, 3, 1)),
    6: ((6, 5), (6, 1), (6, 5, 4, 1), (6, 5, 3, 2)),
    7: ((7, 6), (7, 4), (7, 3), (7, 1)),
    8: ((8, 6, 5, 4), (8, 7, 6, 1), (8, 7, 5, 3), (8, 7, 3, 2)),
    9: ((9, 5), (9, 4), (9, 8, 7, 2), (9, 8, 6, 5)),
    10: ((10, 7), (10, 3), (10, 9, 8, 5), (10, 9, 7, 6)),
    11: ((11, 9), (11, 2), (11, 10, 9, 7), (11, 10, 9, 5)),
    12: ((12, 6, 4, 1), (12, 11, 10, 4), (12, 11, 10, 2), (12, 11, 8, 6)),
    13: ((13, 4, 3, 1), (13, 12, 11, 8), (13, 12, 11, 2), (13, 12, 11, 1)),
    14: ((14, 5, 3, 1), (14, 13, 12, 2), (14, 13, 11, 9), (14, 13, 11, 4)),
    15: ((15, 14), (15, 11), (15, 8), (15, 7)),
    16: ((16, 15, 13, 4), (16, 15, 12, 10), (16, 15, 12, 1), (16, 15, 10, 4)),
    17: ((17, 14), (17, 12), (17, 11), (17, 6)),
    18: ((18, 11), (18, 7), (18, 17, 16, 13), (18, 17, 16, 10)),
    19: ((19, 6, 2, 1), (19, 18, 17, 14), (19, 18, 17, 13), (19, 18, 17, 5)),
    20: ((20, 17), (20, 3), (20, 19, 16, 14), (20, 19, 16, 2)),
    21: ((21, 19), (21, 2), (21, 20, 19, 16), (21, 20, 19, 13)),
    22: ((22, 21), (22, 1), (22, 21, 20, 11), (22, 21, 20, 7)),
    23: ((23, 18), (23, 14), (23, 9), (23, 5)),
    24: ((24, 23, 22, 17), (24, 23, 22, 7), (24, 23, 21, 20), (24, 23, 21, 11)),
}
"""Taps of registers of maximal length by their number of stages.

The first of each order is of P. Alfke, Xilinx XAPP 052; the others were searched, fewest taps first.
Orders 2 to 4 have no more. All are tested to be primitive over GF(2).
"""


def maximal_sequence(
    stages: int, length: int, state: int = 1, choice: int = 0
) -> npt.NDArray[np.uint8]:
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
    choice : int
        Which of the registers in `TAPS`. Each gives another sequence.

    Returns
    -------
    ndarray of uint8, shape (length,)
        Zeros and ones.
    """
    taps = TAPS[stages][choice]
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

"""What the checksum leaves undetected, and under which assumption; ``INTEGRITY.md`` says it in words.

The generator is the primitive polynomial 0x104C11DB7 of IEEE 802.3 (0x82608EDB in Koopman's notation). Its
Hamming distances by length are those of Koopman's tables (P. Koopman, "32-bit cyclic redundancy codes for
Internet applications", DSN 2002, and his list of polynomials); the tests compute the last three anew.
"""

from __future__ import annotations

import math

CHECK_BITS = 32

# Greatest number of protected bits, checksum not counted, for each Hamming distance.
_DISTANCES = ((6, 268), (5, 2_974), (4, 91_607), (3, 2**32 - 1 - CHECK_BITS))

SHARE = 2.0**-31
"""Undetected share of the error patterns of one weight: twice that of a random code of 32 bits.

The share is 2⁻³² where patterns are many, and differs from it where they are few. Counted for the least
weight that goes undetected, it is 1.9 times that for 800 bits, 1.3 times for 1,200, 1.06 times for 12,112,
and less than 1 just above the lengths in the table; for less than 800 bits it is more than twice.
"""

SHORTEST_BITS = 800
"""What ``SHARE`` is claimed for; with key, producer and ``seq`` every message of ours is longer."""


def hamming_distance(data_bits: int) -> int:
    """Return the least number of inverted bits that can go undetected (6 stands for 6 and more).

    Args:
        data_bits: Length of what is protected, without the checksum.

    Raises:
        ValueError: It is not between 1 and 2³² − 33, beyond which two inverted bits may go undetected.
    """
    if not 1 <= data_bits <= _DISTANCES[-1][1]:
        raise ValueError(f"data_bits must be 1 to {_DISTANCES[-1][1]}, not {data_bits}")
    return next(distance for distance, longest in _DISTANCES if data_bits <= longest)


def residual_error(data_bits: int, bit_error_probability: float = 1e-2) -> float:
    """Return the probability that a message arrives changed and its checksum does not show it.

    The channel is taken to be binary and symmetric: each bit is inverted with the same probability,
    independently of the others. It is the sum over all weights from the Hamming distance on of the binomial
    probability times ``SHARE``.

    Args:
        data_bits: Length of what is protected, without the checksum.
        bit_error_probability: p, from 0 to 0.5.

    Raises:
        ValueError: An argument is out of range; ``data_bits`` is below ``SHORTEST_BITS``.
    """
    if data_bits < SHORTEST_BITS:
        raise ValueError(f"data_bits must be at least {SHORTEST_BITS}, not {data_bits}")
    if not 0.0 <= bit_error_probability <= 0.5:
        raise ValueError(f"bit_error_probability must be 0 to 0.5, not {bit_error_probability}")
    distance, n, p = hamming_distance(data_bits), data_bits + CHECK_BITS, bit_error_probability
    if p == 0.0:
        return 0.0
    mean = n * p
    if mean > 1.0:
        # Nearly every message is changed in many bits: the terms left out are small beside the rest.
        return SHARE
    first = math.exp(
        math.lgamma(n + 1)
        - math.lgamma(distance + 1)
        - math.lgamma(n - distance + 1)
        + distance * math.log(p)
        + (n - distance) * math.log1p(-p)
    )
    # Each term is less than `mean` / (distance + 1) times the one before.
    return SHARE * first / (1.0 - mean / (distance + 1))


def undetected_per_hour(latch_interval_s: float) -> float:
    """Return the greatest rate [1/h] of messages that are changed unnoticed, where errors latch a stop.

    Until the stop is latched, there is at most one error that is noticed in each interval; each error,
    however it came about, is taken to go unnoticed with the probability ``SHARE``. One more is
    added for the error that begins the first interval.

    Args:
        latch_interval_s: ``latch.interval_s`` of the profile [s].
    """
    return SHARE * (3600.0 / latch_interval_s + 1.0)

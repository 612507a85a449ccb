"""What the checksum leaves undetected: Hamming distances worked out from the polynomial itself."""

from __future__ import annotations

import math
import zlib

import numpy as np
import pytest

from ssm_service.wire.residual import SHARE, hamming_distance, residual_error, undetected_per_hour

POLYNOMIAL = 0x104C11DB7


def times(a: int, b: int) -> int:
    """Multiply two remainders modulo the polynomial."""
    product = 0
    for place in reversed(range(32)):
        product <<= 1
        if product >> 32:
            product ^= POLYNOMIAL
        if b >> place & 1:
            product ^= a
    return product


def power(exponent: int) -> int:
    result, factor = 1, 2
    while exponent:
        if exponent & 1:
            result = times(result, factor)
        factor, exponent = times(factor, factor), exponent >> 1
    return result


def remainders(count: int) -> np.ndarray:
    """Return x⁰, x¹, … modulo the polynomial, (count,)."""
    values, value = np.empty(count, dtype=np.int64), 1
    for index in range(count):
        values[index] = value
        value <<= 1
        if value >> 32:
            value ^= POLYNOMIAL
    return values


def test_the_polynomial_is_that_of_zlib():
    # One inverted bit, k places before the end, changes the checksum by x^(32 + k), bits reflected.
    for k in (0, 5, 100):
        data = bytearray(40)
        clean = zlib.crc32(data)
        data[-1 - k // 8] ^= 0x80 >> k % 8
        assert zlib.crc32(data) ^ clean == int(f"{power(32 + k):032b}"[::-1], 2)


def test_two_inverted_bits_are_always_noticed_up_to_the_length_stated():
    # The polynomial is primitive: the order of x is 2^32 - 1, so x^a = x^b only for a = b below that.
    order = 2**32 - 1
    assert power(order) == 1
    assert all(power(order // factor) != 1 for factor in (3, 5, 17, 257, 65537))
    assert hamming_distance(order - 32) == 3
    with pytest.raises(ValueError, match="data_bits"):
        hamming_distance(order - 31)


def test_three_inverted_bits_are_noticed_up_to_91607_bits():
    # An undetected pattern may be moved to the end: 1 + x^a + x^b = 0.
    x = remainders(91_607 + 32 + 1)
    for data_bits, distance in ((91_607, 4), (91_608, 3)):
        within = x[1 : data_bits + 32]
        assert bool(np.isin(within ^ 1, within).any()) == (distance == 3)
        assert hamming_distance(data_bits) == distance


def test_four_inverted_bits_are_noticed_up_to_2974_bits():
    # 1 + x^a + x^b + x^c = 0: some x^a + x^b is 1 + x^c.
    for data_bits, distance in ((2_974, 5), (2_975, 4)):
        x = remainders(data_bits + 32)[1:]
        thirds = np.sort(x ^ 1)
        found = False
        for index in range(1, len(x)):
            sums = x[:index] ^ x[index]
            places = np.minimum(np.searchsorted(thirds, sums), len(thirds) - 1)
            found = found or bool((thirds[places] == sums).any())
        assert found == (distance == 4)
        assert hamming_distance(data_bits) == distance


def test_shorter_messages_have_more():
    distances = [hamming_distance(bits) for bits in (1, 268, 269, 2_974)]
    assert distances == [6, 6, 5, 5]
    with pytest.raises(ValueError, match="data_bits"):
        hamming_distance(0)


@pytest.mark.parametrize("data_bits", [800, 1_000, 3_500, 20_000, 91_608, 8 * 65_536])
def test_the_residual_error_is_bounded_and_rises_with_the_channels(data_bits):
    errors = [residual_error(data_bits, p) for p in (0.0, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.5)]
    assert errors[0] == 0.0
    assert errors == sorted(errors)
    assert errors[-1] == SHARE
    assert all(error <= SHARE for error in errors)
    assert residual_error(data_bits) == errors[-2]


def test_the_residual_error_bounds_the_sum_over_all_weights():
    for data_bits, p in ((3_500, 1e-5), (3_500, 2e-4), (900, 1e-3), (800, 1.2e-3)):
        n, first = data_bits + 32, hamming_distance(data_bits)
        exact = SHARE * sum(math.comb(n, w) * p**w * (1.0 - p) ** (n - w) for w in range(first, first + 40))
        assert exact <= residual_error(data_bits, p) * (1 + 1e-9)
        assert residual_error(data_bits, p) < 1.3 * exact


def patterns_of_four(n: int) -> int:
    """Count the undetected patterns of 4 inverted bits in n: those with the last bit, times their places."""
    x = remainders(n)[1:]
    order = np.argsort(x ^ 1)
    thirds, count = (x ^ 1)[order], 0
    for index in range(1, len(x)):
        sums = x[:index] ^ x[index]
        places = np.minimum(np.searchsorted(thirds, sums), len(thirds) - 1)
        highest = order[places[thirds[places] == sums]] + 1
        count += int((n - highest[highest > index + 1]).sum())
    return count


def patterns_of_five(n: int) -> int:
    """Likewise of 5: 1 + x^a + x^b = x^c + x^d, each found for its 6 choices of a and b."""
    x = remainders(n)[1:]
    a, b = np.triu_indices(len(x), 1)
    sums = x[a] ^ x[b]
    order = np.argsort(sums)
    begin, end = (np.searchsorted(sums[order], sums ^ 1, side) for side in ("left", "right"))
    count = 0
    for index in np.nonzero(end > begin)[0]:
        for other in order[begin[index] : end[index]]:
            places = {a[index], b[index], a[other], b[other]}
            count += int(n - 1 - max(places)) if len(places) == 4 else 0
    return count // 6


@pytest.mark.parametrize(
    ("data_bits", "weight", "count"),
    [(800, 5, patterns_of_five), (1_200, 5, patterns_of_five), (3_200, 4, patterns_of_four)],
)
def test_the_share_bounds_what_is_counted(data_bits, weight, count):
    n = data_bits + 32
    undetected = count(n)
    assert 0 < undetected <= SHARE * math.comb(n, weight)


def test_it_is_claimed_for_no_shorter_message_than_ours():
    with pytest.raises(ValueError, match="at least 800"):
        residual_error(799)


@pytest.mark.parametrize("p", [-1e-9, 0.51, math.nan])
def test_a_probability_out_of_range_is_refused(p):
    with pytest.raises(ValueError, match="bit_error_probability"):
        residual_error(1000, p)


def test_the_latch_bounds_the_rate_whatever_the_network_does():
    assert undetected_per_hour(3600.0) == 2 * SHARE < 1e-9
    assert undetected_per_hour(60.0) == 61 * SHARE


@pytest.mark.parametrize("data_bits", [2_016, 4_064, 20_000, 131_040])
@pytest.mark.parametrize("mean", [1e-6, 0.5, 1.0])
def test_the_residual_error_is_the_first_term_and_a_geometric_series(data_bits, mean):
    n, weight = data_bits + 32, hamming_distance(data_bits)
    p = mean / n
    first = math.comb(n, weight) * p**weight * (1.0 - p) ** (n - weight)
    series = 1.0 / (1.0 - mean / (weight + 1))
    assert residual_error(data_bits, p) == pytest.approx(SHARE * first * series, rel=1e-8, abs=0.0)
    assert residual_error(data_bits, p) < SHARE


@pytest.mark.parametrize("data_bits", [2_016, 131_040])
def test_where_more_than_one_bit_is_inverted_on_average_every_change_counts(data_bits):
    for mean in (math.nextafter(1.0, 2.0), 1.5, 2.0, 100.0):
        assert residual_error(data_bits, mean / (data_bits + 32)) == SHARE


@pytest.mark.parametrize(
    ("data_bits", "p", "message"),
    [
        (2**32 - 32, 0.0, "data_bits must be 1 to 4294967263, not 4294967264"),
        (799, 0.0, "data_bits must be at least 800, not 799"),
        (800, 0.75, "bit_error_probability must be 0 to 0.5, not 0.75"),
    ],
)
def test_a_refusal_names_the_range(data_bits, p, message):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        residual_error(data_bits, p)
    assert str(caught.value) == message

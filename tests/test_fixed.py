"""Fixed-point formats and the one rounding rule: the same on Python integers, NumPy arrays and torch tensors."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cmfpga.fixed import Q, bits_for, floor_shift, round_half_up, saturate, signed_bits_for

# Every kind of number that the project calls these functions with.
KINDS = {
    "int": (lambda values: values, lambda f, values, *rest: [f(value, *rest) for value in values]),
    "numpy": (lambda values: np.array(values, np.int64), lambda f, values, *rest: f(values, *rest).tolist()),
    "numpy scalar": (
        lambda values: [np.int64(value) for value in values],
        lambda f, values, *rest: [int(f(value, *rest)) for value in values],
    ),
    "torch": (
        lambda values: torch.tensor(values, dtype=torch.int64),
        lambda f, values, *rest: f(values, *rest).tolist(),
    ),
}
VALUES = [*range(-40, 41), (1 << 40) + 7, -(1 << 40) - 7, (1 << 61) - 1, -(1 << 61)]


@pytest.fixture(params=KINDS)
def apply(request):
    """``apply(function, values, …)``: the results as a list of Python integers, by way of one kind of number."""
    make, call = KINDS[request.param]
    return lambda function, values, *rest: call(function, make(values), *rest)


@pytest.mark.parametrize("shift", [1, 2, 3, 8, 20])
def test_round_half_up(apply, shift):
    half = 1 << (shift - 1)
    values = [*VALUES, *(k * half + d for k in (-3, -1, 1, 3) for d in (-1, 0, 1))]
    expected = [math.floor(Fraction(value, 1 << shift) + Fraction(1, 2)) for value in values]
    assert apply(round_half_up, values, shift) == expected


@pytest.mark.parametrize("shift", [0, 1, 5, 62])
def test_floor_shift(apply, shift):
    assert apply(floor_shift, VALUES, shift) == [math.floor(Fraction(value, 1 << shift)) for value in VALUES]


@pytest.mark.parametrize("function", [round_half_up, floor_shift])
@pytest.mark.parametrize("shift", [0, -1, -20])
def test_shifts_of_zero_or_less_are_exact(apply, function, shift):
    values = VALUES[:81]
    assert apply(function, values, shift) == [value << -shift for value in values]


@pytest.mark.parametrize("low, high", [(-8, 7), (0, 15), (-(1 << 40), 1 << 40), (3, 3)])
def test_saturate(apply, low, high):
    assert apply(saturate, VALUES, low, high) == [low if v < low else high if v > high else v for v in VALUES]


def test_saturate_floats():
    assert saturate(-0.25, 0.0, 7.0) == 0.0 and saturate(7.5, 0.0, 7.0) == 7.0 and saturate(3.25, 0.0, 7.0) == 3.25


def test_inputs_are_left_as_they_were():
    for values in (np.array(VALUES), torch.tensor(VALUES)):
        for function, rest in ((round_half_up, (3,)), (floor_shift, (3,)), (saturate, (-5, 5))):
            function(values, *rest)
        assert values.tolist() == VALUES


@pytest.mark.parametrize("fmt, width, low, high, step, text", [
    (Q(5, 12), 18, -(1 << 17), (1 << 17) - 1, 2**-12, "Q5.12"),
    (Q(5, 12, signed=False), 17, 0, (1 << 17) - 1, 2**-12, "UQ5.12"), (Q(0, 4), 5, -16, 15, 1 / 16, "Q0.4"),
    (Q(-2, 6), 5, -16, 15, 1 / 64, "Q-2.6"), (Q(8, 0, signed=False), 8, 0, 255, 1, "UQ8.0"),
])  # fmt: skip
def test_a_format(fmt, width, low, high, step, text):
    assert (fmt.width, fmt.min, fmt.max, fmt.step, str(fmt)) == (width, low, high, step, text)
    # The raw range fills the width exactly.
    assert fmt.max - fmt.min + 1 == 1 << width
    assert fmt.real(fmt.max) == high * step
    np.testing.assert_array_equal(fmt.real(np.array([low, 1, high])), [low * step, step, high * step])


def test_raw_rounds_to_the_nearest_half_up():
    fmt = Q(2, 2)
    assert [fmt.raw(k / 16) for k in range(-9, 10)] == [
        -2, -2, -2, -1, -1, -1, -1, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2,
    ]  # fmt: skip
    assert fmt.raw(1) == 4 and fmt.raw(-4) == -16 and fmt.raw(Fraction(1, 3)) == 1


@pytest.mark.parametrize("fmt", [Q(2, 2), Q(2, 2, signed=False), Q(0, 8)], ids=str)
def test_raw_does_not_saturate(fmt):
    low, high = fmt.real(fmt.min), fmt.real(fmt.max)
    # The first value that rounds out of the range, and the last that does not.
    assert fmt.raw(high + 0.49 * fmt.step) == fmt.max and fmt.raw(low - 0.5 * fmt.step) == fmt.min
    for value in (high + 0.5 * fmt.step, low - 0.51 * fmt.step, 1e300):
        with pytest.raises(OverflowError, match=rf"does not fit {fmt} \({low} to {high}\)"):
            fmt.raw(value)


@given(i=st.integers(-2, 12), f=st.integers(2, 30), signed=st.booleans(), share=st.floats(0, 1))
@settings(derandomize=True, deadline=None, max_examples=100)
def test_raw_and_real_are_inverse(i, f, signed, share):
    fmt = Q(i, f, signed=signed)
    raw = fmt.min + math.floor(share * (fmt.max - fmt.min))
    assert fmt.raw(fmt.real(raw)) == raw


def test_bits_hold_exactly_their_range():
    assert [bits_for(value) for value in (0, 1, 2, 3, 4, 255, 256)] == [1, 1, 2, 2, 3, 8, 9]
    assert [signed_bits_for(value) for value in (0, 1, 2, 3, 4, 127, 128)] == [1, 2, 3, 3, 4, 8, 9]
    assert bits_for(np.int64(255)) == 8 and signed_bits_for(np.int64(127)) == 8

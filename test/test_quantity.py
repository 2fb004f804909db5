"""Values and standard errors as people read them."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_id.common.quantity import Tabled, measured

SCALES = {"": 1, "m": Decimal("1e-3"), "µ": Decimal("1e-6"), "n": Decimal("1e-9"), "k": 1000, "M": 10**6, "G": 10**9}


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "text"),
    [
        (0.0099971, 1.1e-5, "Ω", "9.997 ± 0.011 mΩ"),
        (0.0099971, 1.1e-5, "ohm", "9.997 ± 0.011 mΩ"),
        (0.35, 0.00996, "Ω", "350 ± 10 mΩ"),
        (0.99996, math.nan, "V", "1 V"),
        (999.96e-3, 1e-4, "Ω", "999.96 ± 0.10 mΩ"),
        (0.62, math.nan, "V", "0.62 V"),
        (312.5, 1.0, "V", "312.5 ± 1.0 V"),
        (2.5e-4, 1e-5, "A", "250 ± 10 µA"),
        (-3.2e-5, 1.5e-6, "H", "−32.0 ± 1.5 µH"),
        (1e-6, 2.5e-3, "Wb", "0.0 ± 2.5 mWb"),
        (12345.0, 1234.0, "Nm", "12.3 ± 1.2 kNm"),
        (12345.0, 1234.0, "samples", "12300 ± 1200 samples"),
        (0.98051, 0.0031, "1", "0.9805 ± 0.0031"),
        (0.0, math.inf, "A", "0 A"),
        (math.nan, 1.0, "A", "unknown"),
        (1 / 3, 1e-13, "V", "0.3333 V"),
        (-3.7e-5, 8.3e-6, "rad", "−0.00212 ± 0.00048 °"),
    ],
)
def test_examples(value, sigma, unit, text):
    assert measured(value, sigma, unit) == text


@pytest.mark.parametrize(
    ("value", "sigma", "size", "text"),
    [
        (0.35e-3, 1e-6, 1.2e-3, "0.3500 ± 0.0010 mH"),
        (1.2e-3, 1e-6, 0.35e-3, "1200.0 ± 1.0 µH"),
        (4e-6, math.nan, 1.2e-3, "0.004 mH"),
        (0.0, 2e-3, 5e-6, "0 ± 2000 µH"),
    ],
)
def test_what_is_shown_together_has_one_unit(value, sigma, size, text):
    assert measured(value, sigma, "H", size) == text


def test_a_table_is_aligned_in_text_and_safe_in_a_notebook():
    class Shown(Tabled):
        summary = "A < B"

        def rows(self):
            return [("R", "9.99 mΩ", "1"), ("L_d <b>", "1 H", "")]

    assert repr(Shown()).splitlines() == ["A < B", "R        9.99 mΩ  1", "L_d <b>      1 H"]
    assert Shown()._repr_html_() == (
        "<table><caption>A &lt; B</caption><tr><th>R</th><td>9.99 mΩ</td><td>1</td></tr>"
        "<tr><th>L_d &lt;b&gt;</th><td>1 H</td><td></td></tr></table>"
    )


@given(st.floats(1e-6, 1e6), st.floats(1e-4, 10.0), st.sampled_from([-1.0, 1.0]))
def test_both_numbers_are_rounded_to_two_digits_of_the_error(size, share, sign):
    """Against decimal arithmetic: the last digits of both stand for one tenth of the error's leading digit."""
    value, sigma = sign * size, share * size
    text = measured(value, sigma, "Ω").replace("\N{MINUS SIGN}", "-")
    numbers, _, unit = text.rpartition(" ")
    scale = SCALES[unit.removesuffix("Ω")]
    shown_value, shown_sigma = (Decimal(part) * scale for part in numbers.split(" ± "))
    exact = Decimal(sigma)
    step = Decimal(1).scaleb(exact.adjusted() - 1)
    assert shown_sigma in {exact.quantize(step, ROUND_HALF_EVEN), exact.quantize(step * 10, ROUND_HALF_EVEN)}
    coarse = shown_sigma.adjusted() > exact.adjusted()  # 0.0996 is 0.10
    assert abs(shown_value - Decimal(value)) <= step * (10 if coarse else 1) * Decimal("0.5001")
    assert 1 <= max(abs(shown_value), shown_sigma) / scale < 1001


def test_what_rounds_to_zero_has_no_sign():
    assert measured(-1e-5, 1e-3, "A", 100.0) == "0.0000 ± 0.0010 A"

"""Numbers and times as text."""

import math

from experiments.scoring.published import as_printed

NOTHING = "–"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plus_minus(mean: float, std: float = math.nan, unit: float = 1.0) -> str:
    """`mean ± std` in a unit, to the first digit of the s.d., or the second if that is 1 or 2."""
    mean, std = mean / unit, std / unit
    if math.isnan(mean) or not std > 0:
        return rounded(mean)
    exponent = math.floor(math.log10(std))
    decimals = max(0, int(float(f"{std / 10.0**exponent:.1f}") < 3) - exponent)
    return minus(f"{mean:,.{decimals}f} ± {std:,.{decimals}f}")


def between(median: float, lowest: float, highest: float, unit: float = 1.0) -> str:
    """`median [lowest, highest]` in a unit, to the second digit of the range."""
    width = (highest - lowest) / unit
    decimals = max(0, 1 - math.floor(math.log10(width))) if width > 0 else None
    numbers = [rounded(value / unit, decimals) for value in (median, lowest, highest)]
    return NOTHING if math.isnan(median) else f"{numbers[0]} [{numbers[1]}, {numbers[2]}]"


def rounded(value: float, decimals: int | None = None) -> str:
    """Number with that many decimals, or to three significant digits, but at least to the units."""
    if math.isnan(value):
        return NOTHING
    if decimals is None and abs(value) < 999.5:
        return minus(f"{value:.3g}")
    return minus(f"{value:,.{decimals or 0}f}")


def scientific(value: float, digits: int = 4) -> str:
    """Number with that many digits, and a power of ten if it is very small or large."""
    if math.isnan(value):
        return NOTHING
    number, _, exponent = f"{value:.{digits}g}".partition("e")
    return minus(number) + (f" × {power(10.0 ** int(exponent))}" if exponent else "")


def as_quoted(mean: float, std: float = math.nan, unit: float = 1.0) -> str:
    """A number of the paper in a unit that is a power of ten, with its printed digits."""
    exponent = round(math.log10(unit))
    digits = [f"{value.scaleb(-exponent):f}" for value in as_printed(mean, std)]
    return minus(" ± ".join(digits)) or NOTHING


def power(unit: float) -> str:
    """10⁻⁴ for 1e-4."""
    return "10" + str(round(math.log10(unit))).translate(_SUPERSCRIPTS)


def turned(angle: float) -> str:
    """Whole degrees with their sign, except for 0: +45°."""
    degrees = round(angle)
    return minus(f"{degrees:+d}°" if degrees else "0°")


def minus(text: str) -> str:
    """Text with typographic minus signs."""
    return text.replace("-", "−")

"""Attenuation of radar by rain: the recommendation's numbers, and another program's."""

import numpy as np
import pytest

from rainsim.errors import ParameterError
from rainsim.sensors.radar import rain_attenuation, rain_coefficients


def test_at_77_ghz_as_the_recommendation_has_it():
    """k and alpha of ITU-R P.838-3, table 5, at 80 GHz; attenuations at 77 GHz to 0.1 dB/km."""
    assert rain_coefficients(80, "horizontal") == pytest.approx((1.1704, 0.7115), rel=2e-4)
    assert rain_coefficients(80, "vertical") == pytest.approx((1.1668, 0.7021), rel=2e-4)
    assert rain_coefficients(10, "horizontal") == pytest.approx((0.01217, 1.2571), rel=2e-3)
    found = rain_attenuation(np.array([10, 25, 50, 100]), 77.0)
    np.testing.assert_allclose(found, [5.8, 11.0, 17.9, 29.3], atol=0.06)


@pytest.mark.parametrize("polarization", ["horizontal", "vertical", "circular"])
@pytest.mark.parametrize("elevation", [0.0, 0.4])
def test_as_itur_computes_it(polarization, elevation):
    pytest.importorskip("itur")
    from itur.models.itu838 import rain_specific_attenuation

    tilt = {"horizontal": 0, "vertical": 90, "circular": 45}[polarization]
    for frequency in (5.0, 24.0, 77.0, 122.0, 300.0):
        for rate in (1.0, 10.0, 25.0, 50.0, 100.0):
            expected = rain_specific_attenuation(rate, frequency, np.degrees(elevation), tilt)
            found = rain_attenuation(rate, frequency, polarization, elevation)
            assert found == pytest.approx(expected.value, rel=0.01)


@pytest.mark.parametrize(
    "wrong, message",
    [
        ((10, 0.5, "vertical"), r"frequency is 0.5 GHz; it must lie from 1 to 1000"),
        ((10, 77, "slanted"), r"'slanted'; it must be horizontal, vertical or circular"),
        ((-1, 77, "vertical"), r"rain rate is -1"),
    ],
)
def test_wrong_values_are_named(wrong, message):
    with pytest.raises(ParameterError, match=message):
        rain_attenuation(*wrong)

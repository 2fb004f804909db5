"""The parameters by which a drive takes the result of a first start."""

from __future__ import annotations

import math

import pytest

from drive_id.core.experiment.encoder import Encoder
from drive_id.core.experiment.first_start import FirstStart
from drive_id.errors import ConfigurationError


def found(encoder, offset, direction, pole_pairs):
    """What a first start finds with this encoder; the true angle is direction * pole_pairs * raw - offset."""
    raw = (0.0, 0.1)
    seen = [encoder.factor * x - encoder.encoder_offset for x in raw]
    true = [direction * pole_pairs * x - offset for x in raw]
    ratio = (true[1] - true[0]) / (seen[1] - seen[0])
    return FirstStart((0.0,) * 3, int(math.copysign(1, ratio)), round(abs(ratio)), ratio * seen[0] - true[0], 0.0, 0.0)


@pytest.mark.parametrize("before", [Encoder(), Encoder(0.4, -1, 1), Encoder(-3.0, 1, 2)])
@pytest.mark.parametrize(("offset", "direction", "pole_pairs"), [(0.7, 1, 4), (-2.0, -1, 2), (3.1, 1, 2)])
def test_a_correction_starts_from_what_the_drive_holds(before, offset, direction, pole_pairs):
    after = before.corrected_by(found(before, offset, direction, pole_pairs))
    assert (after.encoder_direction, after.encoder_pole_pairs) == (direction, pole_pairs)
    assert math.remainder(after.encoder_offset - offset, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_a_drive_that_is_right_stays_as_it_is():
    own = Encoder(0.3, -1, 3)
    assert own.corrected_by(FirstStart((0.0,) * 3, 1, 1, 0.0, 0.0, 0.0)) == own


def test_no_direction_is_refused():
    with pytest.raises(ConfigurationError, match="must be 1 or -1"):
        Encoder(encoder_direction=0)

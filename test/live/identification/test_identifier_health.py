"""What the identification node says of its live samples."""

from __future__ import annotations

import numpy as np
import pytest
from recorder_blocks import PERIOD, START, TOPICS, block

from drive_id.common.health import Level
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError
from drive_id.files.messages.block_codec import decode_block, encode_block
from drive_id.files.messages.messages import BLOCK_FIELDS
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.publishers import Publisher

NAMES = tuple(topic.name for topic in TOPICS[:3])
SOURCES = [[Publisher("/bench", topic.type_name)] for topic in TOPICS[:3]]


@pytest.fixture
def identifier():
    return Identifier(IdentificationSettings(refit_share=0.0), FitSettings("joint", i_max=40.0), NAMES)


def play(identifier, blocks, change=lambda _, number, values: (number * 100, values)):
    for number in range(blocks):
        for section, topic in enumerate(TOPICS[:3]):
            values = decode_block(block(topic.type_name, number * 100), len(BLOCK_FIELDS[topic.type_name])).values
            first, changed = change(section, number, [np.array(value) for value in values])
            stamp = START + round(number * 100 * PERIOD * 1e9)
            identifier.receive(section, encode_block(stamp, first, PERIOD, changed, "drive"))


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("temperatures", [20.0], "temperatures has 1 entry for 2 recordings"),
        ("u_dc", [540.0, -1.0], "u_dc is -1.0 V"),
        ("signals", "/no/such.yaml", "Signals file /no/such.yaml cannot be read"),
        ("method", "FULL", "method is 'FULL'"),
    ],
)
def test_a_request_is_judged_before_its_recordings_exist(identifier, field, value, said):
    bags = ["not_there_1", "not_there_2"]
    identifier.check(bags, method="full", temperatures=[20.0, 60.0])
    with pytest.raises(ConfigurationError, match=said):
        identifier.check(bags, **{"method": "joint", field: value})


def told(identifier):
    health = identifier.health("Waiting.", SOURCES)
    assert health.message.startswith("Waiting. ")
    assert health.message.count(". ") == 1, "two sentences"
    return health, [health.message, *(said for key, said in health.values.items() if key.startswith("also"))]


def test_nothing_is_wrong(identifier):
    play(identifier, 30)
    health, said = told(identifier)
    assert (health.level, health.message) == (Level.OK, "Waiting. 3000 live samples.")
    assert len(said) == 1


def test_nan_samples_are_named_and_not_said_to_have_no_partners(identifier):
    def spoiled(section, number, values):
        if section == 0:
            values[1][:20] = np.nan
        if section == 2 and number == 3:
            values[0][4] = np.inf
        return number * 100, values

    play(identifier, 30, spoiled)
    health, said = told(identifier)
    assert health.level == Level.WARN
    assert health.values["/phase_currents: samples NaN or infinite"] == "600"
    assert health.values["/resolver: samples NaN or infinite"] == "1"
    assert any("600 samples of /phase_currents are NaN or infinite" in sentence for sentence in said)
    assert not any("simultaneous" in sentence for sentence in said)
    reply = identifier.job((), "")(lambda *_: None)
    assert reply.code == "non_finite"  # as the sentence says


def test_samples_without_partners_are_still_told(identifier):
    play(
        identifier,
        30,
        lambda section, number, values: (number * 100, [v[: 100 if section == 0 else 50] for v in values]),
    )
    _, said = told(identifier)
    assert any("for lack of simultaneous voltages" in sentence for sentence in said)


def test_a_publisher_that_does_not_count_is_told(identifier):
    play(identifier, 30, lambda section, number, values: (0 if section == 1 else number * 100, values))
    health, said = told(identifier)
    assert health.level == Level.WARN
    told_of = [sentence for sentence in said if "is always 0" in sentence]
    assert len(told_of) == 1
    assert "first_sample of /phase_voltages is always 0, so that losses do not show" in told_of[0]

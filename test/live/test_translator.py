"""Messages of a stranger, translated as they arrive: the samples are those that were sent."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from drive_id.errors import ConfigurationError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.storage.container import TopicInfo
from drive_id.live.translator import Translator

STORE = get_typestore(Stores.ROS2_JAZZY)
PERIOD = 2e-4
JOINT, FLOATS = "sensor_msgs/msg/JointState", "std_msgs/msg/Float32MultiArray"


def signals(**changes):
    shared = {"sample_period": PERIOD}
    tree = {
        "currents": {"topic": "joint", "fields": ["effort[0]", "effort[1]", "effort[2]"], **shared},
        "resolver": {
            "topic": "joint", "angle": "position[0]", "speed": "velocity[0]", "mechanical": True,
            "pole_pairs": 4, **shared,
        },
        "voltages": {
            "topic": "duty", "fields": ["data[0]", "data[1]", "data[2]"], "scale": 400.0, "stamp": "index",
            "first_sample": "data[3]", **shared,
        },
    }  # fmt: skip
    for section, change in changes.items():
        tree[section] |= change
    return parse_signals(yaml.safe_dump(tree), "test")


class Stranger:
    """A drive with an encoder that counts mechanical turns, and duty cycles."""

    def __init__(self, count, seed=0, period=PERIOD):
        self.period = period
        random = np.random.default_rng(seed)
        self.i_abc = random.normal(size=(count, 3)).astype(np.float64)
        self.duty = random.uniform(-1, 1, (count, 3)).astype(np.float32)
        self.angle = np.cumsum(random.uniform(0.0, 0.01, count))  # mechanical
        self.speed = random.uniform(10, 20, count)

    def joint(self, k):
        types = STORE.types
        nanoseconds = round(k * self.period * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
        message = types[JOINT](
            types["std_msgs/msg/Header"](stamp, "drive"), ["rotor"], np.array([self.angle[k]]),
            np.array([self.speed[k]]), self.i_abc[k],
        )  # fmt: skip
        return bytes(STORE.serialize_cdr(message, JOINT))

    def floats(self, k):
        types = STORE.types
        layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
        return bytes(STORE.serialize_cdr(types[FLOATS](layout, np.append(self.duty[k], np.float32(k))), FLOATS))


def translator(**changes):
    made = Translator(signals(**changes))
    made.found("joint", TopicInfo("/joint", JOINT, None, "cdr"))
    made.found("duty", TopicInfo("/duty", FLOATS, None, "cdr"))
    return made


def translated(made, stranger, sent, every=37):
    blocks = []
    for number, k in enumerate(sent):
        made.receive("joint", stranger.joint(k), 0)
        made.receive("duty", stranger.floats(k), 0)
        if number % every == every - 1:
            blocks += made.advance()
    return [*blocks, *made.advance()]


def test_the_topics_are_named_once():
    assert Translator(signals()).topics == ("joint", "duty")


def test_all_samples_arrive_in_si_units_and_order():
    stranger, made = Stranger(2500), translator()
    blocks = translated(made, stranger, range(2500))
    together = {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in ("currents", "voltages", "resolver")
    }
    count = len(together["currents"])
    assert count >= 2495  # the last ones may wait for their partners
    np.testing.assert_allclose(together["currents"], stranger.i_abc[:count], rtol=1e-6)
    np.testing.assert_allclose(together["voltages"], 400.0 * stranger.duty[:count], rtol=1e-6)
    wrapped = np.angle(np.exp(4j * stranger.angle[:count]))
    np.testing.assert_allclose(np.exp(1j * together["resolver"][:, 0]), np.exp(1j * wrapped), atol=1e-5)
    np.testing.assert_allclose(together["resolver"][:, 1], 4 * stranger.speed[:count], rtol=1e-6)
    firsts = [block.first_sample for block in blocks]
    lengths = [len(block.currents) for block in blocks]
    assert firsts == list(np.cumsum([0, *lengths[:-1]]))
    assert {block.sample_period for block in blocks} == {PERIOD}
    assert (made.unreadable, made.dropped) == (0, 0)


def test_lost_messages_show_in_the_count():
    stranger, made = Stranger(2600), translator()
    blocks = translated(made, stranger, [*range(200), *range(250, 2600)])
    firsts = {block.first_sample for block in blocks}
    assert 250 in firsts
    assert made.report().gaps == 1
    after = next(block for block in blocks if block.first_sample == 250)
    np.testing.assert_allclose(after.currents[0], stranger.i_abc[250], rtol=1e-6)


def test_clocks_that_differ_are_told():
    """The drive's clock began 100 s before its count: no voltage belongs to any current."""
    made, stranger = translator(), Stranger(40)
    assert made.clock_finding() == ""
    blocks = []
    for k in range(40):
        made.receive("duty", stranger.floats(k), 0)
    blocks += made.advance()
    assert made.clock_finding() == ""  # the others may not have begun
    stranger.period = 100.0 / 20
    for k in range(20, 30):
        made.receive("joint", stranger.joint(k), 0)
    blocks += made.advance()
    assert blocks == []
    assert made.clock_finding() == (
        "The latest stamps are too far apart for one clock (currents (joint) 145.000 s, voltages (duty) 0.008 s, "
        "resolver (joint) 145.000 s): stamp all signals by the same clock."
    )
    made, stranger = translator(), Stranger(2500)
    assert translated(made, stranger, range(2500))
    assert made.clock_finding() == ""


@pytest.mark.parametrize("error", [-2e-3, 2e-3])
def test_a_period_that_is_not_quite_the_declared_one_is_no_loss_and_hides_none(error):
    stranger, made = Stranger(4000, period=PERIOD * (1 + error)), translator(voltages={"stamp": "log_time"})
    blocks = []
    for number, k in enumerate([*range(3000), *range(3004, 4000)]):
        received = round(k * stranger.period * 1e9)
        made.receive("joint", stranger.joint(k), received)
        made.receive("duty", stranger.floats(k), received)
        if number % 37 == 36:
            blocks += made.advance()
    firsts = np.array([block.first_sample for block in blocks])
    ends = firsts + [len(block.currents) for block in blocks]
    lost = firsts[1:] - ends[:-1]
    assert lost[lost != 0].tolist() == [4]
    assert firsts[1:][lost != 0].tolist() == [3004]


def test_damaged_messages_are_counted_and_the_rest_goes_on():
    stranger, made = Stranger(2300), translator()
    made.receive("joint", b"\0\1\0\0short", 0)
    blocks = translated(made, stranger, range(2300))
    assert made.unreadable == 2  # currents and resolver
    assert "joint cannot be read as" in made.last_error
    assert sum(len(block.currents) for block in blocks) >= 2295


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"currents": {"sample_period": None}}, "declares no sample_period for currents, which live signals need"),
        ({"resolver": {"speed": ""}}, r"needs a whole recording \(no speed beside the angle"),
        ({"voltages": {"equally_spaced": True, "stamp": "log_time"}}, "needs a whole recording"),
    ],
)
def test_what_needs_a_whole_recording_is_refused(changes, sentence):
    with pytest.raises(ConfigurationError, match=sentence):
        Translator(signals(**changes))

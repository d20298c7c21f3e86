"""The DBC against hand-packed bytes, and what the decoder refuses."""

import struct

import pytest

from protocol import can_database as can
from protocol.errors import LinkError


def test_status_is_decoded_as_packed_by_hand():
    data = struct.pack("<BBBBHh", can.UnitState.SELF_TEST, 7, 0b1000_0101, 0, 4987, -1234)
    message = can.decode_can(0x100, data)
    assert message.name == can.GNC_STATUS
    raised = {name for name, value in message.signals.items() if name.endswith("_error") and value}
    assert raised == {"imu_error", "memory_error", "link_error"}
    assert message.signals["state"] == can.UnitState.SELF_TEST
    assert message.signals["heartbeat_counter"] == 7
    assert message.signals["supply_voltage"] == pytest.approx(4.987)
    assert message.signals["temperature"] == pytest.approx(-12.34)
    assert can.message_period_s(can.GNC_STATUS) == 0.1


def test_test_request_and_echo_layout():
    request = can.encode_can(can.GNC_TEST_REQUEST, {"pattern": 0xA55A00FF, "counter": 200})
    assert request == (0x120, struct.pack("<IB", 0xA55A00FF, 200))
    inverted = 0xA55A00FF ^ can.PATTERN_MASK
    echo = can.encode_can(can.GNC_TEST_ECHO, {"inverted_pattern": inverted, "counter": 200, "status": 0})
    assert echo == (0x121, struct.pack("<IBB", inverted, 200, 0))


@pytest.mark.parametrize(
    ("name", "identifier", "stem", "scale", "full_range"),
    [
        (can.GNC_RATE, 0x110, "rate", 2**-12, 6.9814),  # 400 deg/s
        (can.GNC_SPECIFIC_FORCE, 0x111, "specific_force", 2**-6, 490.33),  # 50 g
    ],
)
def test_telemetry_covers_the_sensor_range(name, identifier, stem, scale, full_range):
    values = {f"{stem}_x": -full_range, f"{stem}_y": 0.0, f"{stem}_z": full_range, f"{stem}_counter": 65535}
    frame = can.encode_can(name, values)
    assert frame.identifier == identifier
    raw = struct.unpack("<hhhH", frame.data)
    assert raw == (round(-full_range / scale), 0, round(full_range / scale), 65535)
    decoded = can.decode_can(*frame).signals
    assert decoded[f"{stem}_x"] == pytest.approx(-full_range, abs=scale / 2)


def test_enumerations_are_those_of_the_dbc():
    for name, signal, enumeration in (
        (can.GNC_STATUS, "state", can.UnitState),
        (can.GNC_TEST_ECHO, "status", can.EchoStatus),
    ):
        choices = can.can_database().get_message_by_name(name).get_signal_by_name(signal).choices
        assert choices is not None
        assert {int(value): str(text) for value, text in choices.items()} == {
            int(member): member.name.lower() for member in enumeration
        }


@pytest.mark.parametrize(
    ("identifier", "data", "says"),
    [
        (0x321, b"", "no message of this identifier"),
        (0x121, b"\0" * 5, "6 bytes, not 5"),
        (0x121, b"\0" * 7, "6 bytes, not 7"),
        (0x100, b"\x63" + b"\0" * 7, "state has no value 99"),
    ],
)
def test_undecodable_frames_are_refused(identifier, data, says):
    with pytest.raises(LinkError, match=says) as caught:
        can.decode_can(identifier, data)
    assert f"0x{identifier:X}" in caught.value.where


@pytest.mark.parametrize(
    "signals",
    [{"counter": 1}, {"pattern": 2**32, "counter": 1}, {"pattern": 1, "counter": 1, "extra": 1}],
)
def test_unencodable_signals_are_refused(signals):
    with pytest.raises(LinkError, match="cannot be encoded"):
        can.encode_can(can.GNC_TEST_REQUEST, signals)


def test_unknown_message_names_the_known_ones():
    with pytest.raises(LinkError, match="NO_SUCH") as caught:
        can.encode_can("NO_SUCH", {})
    assert can.GNC_TEST_ECHO in caught.value.remedy

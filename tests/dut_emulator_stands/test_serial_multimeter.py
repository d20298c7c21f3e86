"""The voltmeter on RS-232: what it reads, how long it takes, what it refuses."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.instruments.scanning_voltmeter import BOUNDS
from dut_emulator.instruments.serial_multimeter import SerialMultimeter
from dut_emulator.products.rate_gyro_triad import make_unit
from dut_emulator.stands.rate_table import live_stand
from dut_emulator.twin import Twin
from protocol.bench_description import Site


class Inputs:
    """Three voltages; OUT_Z rises by 1 V/s from 0 s."""

    def __init__(self, x: float = 5.0693, y: float = -0.05) -> None:
        self.levels = {"OUT_X": x, "OUT_Y": y}
        self.asked: list[tuple[str, float, float]] = []

    def mean_voltage_v(self, point: str, begin_s: float, end_s: float) -> float:
        self.asked.append((point, begin_s, end_s))
        return self.levels.get(point, (begin_s + end_s) / 2)


class Terminal:
    """Who sits at the other end of the line. Time passes until the answer is there."""

    def __init__(self, inputs=None, seed: int = 1, *, remote: bool = True) -> None:
        self.meter = SerialMultimeter(inputs or Inputs(), seed, "M1")
        self.now_s = 0.0
        if remote:
            self.write("SYST:REM")

    def write(self, line: str) -> None:
        self.meter.receive(line.encode() + b"\n", self.now_s)

    def ask(self, line: str) -> str:
        self.write(line)
        while (next_s := self.meter.next_event_s()) is not None:
            self.now_s = next_s
            for answer in self.meter.advance(next_s):
                assert answer.time_s == self.now_s
                return answer.data.decode().removesuffix("\r\n")
        return ""

    def error(self) -> str:
        return self.ask("SYST:ERR?")


def test_a_reading_lies_inside_the_accuracy_that_paper_4_gives() -> None:
    """±(0.0035 % of reading + 0.0005 % of range) at 10 V, for many meters; not all of them the same."""
    bound_v = 3.5e-5 * 5.0693 + 5e-6 * 10
    readings = np.array([float(Terminal(seed=seed).ask("MEAS:VOLT:DC? 10")) for seed in range(80)])
    errors = readings - 5.0693
    assert (np.abs(errors) < bound_v).all()
    assert errors.std() == pytest.approx(math.hypot(3.5e-5 * 5.0693, 5e-5) / 3, rel=0.25)
    assert np.abs(readings / 1e-5 - np.rint(readings / 1e-5)).max() < 1e-3  # 6½ digits: 10 µV at 10 PLC


@pytest.mark.parametrize("range_v", sorted(BOUNDS))
def test_overload_is_above_1_2_of_the_range_either_way(range_v: float) -> None:
    inputs = Inputs(x=1.199 * range_v, y=-1.201 * range_v)
    terminal = Terminal(inputs)
    terminal.write(f"CONF:VOLT:DC {range_v};ROUT:SCAN (@1, 2)")
    inside, beyond = (float(value) for value in terminal.ask("READ?").split(","))
    assert inside == pytest.approx(1.199 * range_v, rel=2e-4)
    assert beyond == -9.9e37


def test_the_automatic_range_follows_the_signal() -> None:
    terminal = Terminal()
    terminal.write("ROUT:CHAN 2")
    assert float(terminal.ask("MEAS:VOLT:DC?")) == pytest.approx(-0.05, abs=6e-6)
    assert float(terminal.ask("VOLT:RANG?")) == 0.1
    assert terminal.ask("CONF?") == '"VOLT +1.00000000E-01,+1.00000000E-07"'
    terminal.write("ROUT:CHAN 1")
    terminal.ask("READ?")
    assert float(terminal.ask("VOLT:RANG?")) == 10.0
    terminal.write("VOLT:RANG:AUTO OFF")
    assert terminal.ask("VOLT:RANG:AUTO?") == "0"


def test_apertures_follow_one_another_through_the_inputs_and_the_answer_comes_over_the_wire() -> None:
    """5 ms for relays, n cycles of 20 ms; characters of 10 bits at 9600 baud, 15 for each reading."""
    inputs = Inputs()
    terminal = Terminal(inputs)
    terminal.write("VOLT:NPLC 0.7;ROUT:SCAN (@3,1);SAMP:COUN 2")
    assert terminal.ask("VOLT:NPLC?") == "+1.00000000E+00"
    start_s = terminal.now_s
    answer = terminal.ask("READ?")
    expected = [("OUT_Z", 0.005), ("OUT_X", 0.030), ("OUT_Z", 0.055), ("OUT_X", 0.080)]
    for (point, begin_s, end_s), (wanted, after_s) in zip(inputs.asked, expected, strict=True):
        assert point == wanted
        assert (begin_s, end_s) == pytest.approx((start_s + after_s, start_s + after_s + 0.02))
    assert terminal.now_s == pytest.approx(start_s + 0.1 + (4 * 15 + 3 + 2) * 10 / 9600)
    values = [float(value) for value in answer.split(",")]
    assert values[2] - values[0] == pytest.approx(0.05, abs=2e-4)


def test_init_lets_the_line_free_and_fetch_waits() -> None:
    terminal = Terminal()
    terminal.write("VOLT:NPLC 100;INIT")
    assert terminal.ask("ROUT:CHAN?") == "1"
    assert terminal.now_s < 0.1
    terminal.write("INIT")
    assert terminal.error().startswith('-221,"Settings conflict;acquisition is running')
    assert float(terminal.ask("FETC?")) == pytest.approx(5.0693, abs=3e-4)
    assert terminal.now_s > 2.0
    assert float(terminal.ask("FETC?")) == pytest.approx(5.0693, abs=3e-4)
    terminal.write("ABOR;FETC?")
    assert terminal.error().startswith("-230,")


def test_commands_behind_a_reading_wait_for_it() -> None:
    terminal = Terminal()
    terminal.write("*IDN?;READ?;ROUT:CHAN?")
    terminal.write("ROUT:CHAN 3")
    name, reading, channel = terminal.ask("ROUT:CHAN?").split(";")
    assert name.split(",")[:3] == ["Testloom", "DMM6S", "M1"]
    assert float(reading) == pytest.approx(5.0693, abs=3e-4)
    assert channel == "1"
    assert terminal.ask("ROUT:CHAN?") == "3"


def test_each_mistake_has_its_number_and_ends_its_line() -> None:
    terminal = Terminal(remote=False)
    terminal.write("READ?")
    assert terminal.error() == '-200,"Command not allowed in local: send SYST:REM"'
    terminal.write("SYST:REM")
    for line, code in (
        ("VOLT:NPLC 101", -222),
        ("VOLT:NPLC x", -104),
        ("ROUT:CHAN 4", -222),
        ("ROUT:CHAN 1.5", -224),
        ("ROUT:SCAN 1,2", -108),
        ("ROUT:SCAN (@)", -171),
        ("SAMP:COUN 0", -222),
        ("SAMP:COUN 512;ROUT:SCAN (@1,2);INIT", -221),
        ("CONF:VOLT:DC 1001", -222),
        ("FROB", -113),
        ("FETC?", -230),
        ("ROUT:CHAN", -109),
        ("\x07", -101),
    ):
        terminal.write(f"{line};*IDN?")
        assert terminal.error().startswith(f"{code},"), line
    assert terminal.error() == '0,"No error"'
    for end in (b"\n", b""):
        terminal.meter.receive(b"X" * 5000 + end, terminal.now_s)
        assert terminal.error().startswith("-363,")
        assert terminal.error() == '0,"No error"'
    terminal.write("*RST")
    for _ in range(70):
        terminal.write("READ?")  # more than can wait
    assert terminal.meter.advance(terminal.now_s + 60.0)[-1].data.startswith(b"+5.069")
    terminal.now_s += 60.0
    assert terminal.error().startswith("-363,")


def test_a_line_may_come_in_pieces_and_device_clear_drops_what_is_under_way() -> None:
    terminal = Terminal()
    for piece in (b"ROUT:CH", b"AN 2\r", b"\nREAD?\nROUT:CHAN 3\n"):
        terminal.meter.receive(piece, 0.0)
    assert terminal.meter.next_event_s() == pytest.approx(0.205)
    terminal.meter.receive(b"*ID\x03ROUT:CHAN?\n", 0.1)
    (answer,) = terminal.meter.advance(5.0)
    assert answer.data == b"2\r\n"
    assert terminal.meter.next_event_s() is None


def test_an_error_ends_its_line_also_when_the_queue_is_full() -> None:
    terminal = Terminal()
    terminal.write("ROUT:CHAN 1")
    for _ in range(20):
        terminal.write("FROB;ROUT:CHAN 2")
    assert terminal.ask("ROUT:CHAN?") == "1"
    assert [terminal.error().split(",")[0] for _ in range(17)] == ["-113"] * 15 + ["-350", "0"]


COMMANDS = st.sampled_from(
    [
        "READ?\n",
        "*IDN?",
        ";",
        "\n",
        "ROUT:SCAN (@1,2)",
        "VOLT:NPLC 0.02",
        "INIT;",
        "FETC?\n",
        "\x03",
        "SYST:ERR?\n",
    ]
)


@settings(max_examples=80)
@given(st.lists(COMMANDS | st.binary(max_size=6), max_size=25), st.lists(st.integers(0, 200), max_size=6))
def test_whatever_comes_over_the_line_it_answers_alike_in_whatever_pieces(parts, cuts: list[int]) -> None:
    data = b"".join(part.encode() if isinstance(part, str) else part for part in parts) + b"\n"
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    answers = []
    for pieces in ([data], [data[start:end] for start, end in itertools.pairwise(places)]):
        meter = SerialMultimeter(Inputs(), 1, "M1")
        meter.receive(b"SYST:REM\n", 0.0)
        for piece in pieces:
            meter.receive(piece, 0.0)
        answers.append(meter.advance(100.0))
        assert meter.next_event_s() is None
    assert answers[0] == answers[1]


def test_the_meter_reads_the_unit_s_true_mean_while_the_table_turns() -> None:
    """An ideal unit on a table at 100 °/s: K (R (1 + s) + Ω sin φ), s the table's own error."""
    site = Site(latitude_deg=34.2, gravity_m_s2=9.797)
    stand = live_stand(5, site, "RT")
    (share,) = (effect.share for effect in stand.surroundings.effects if effect.word == "rate_scale_factor")
    unit = make_unit(1, "U-1", None, Twin("", (effect_named("stand.rate_ripple"),)))
    unit.insert(stand.surroundings, 0.0)
    unit.set_supply(15.0, 0.0)
    stand.port.command("HOME", 0.0)
    terminal = Terminal(unit, seed=2)
    terminal.now_s = 20.0
    readings = {}
    for rate in (0.0, 100.0, -100.0):
        stand.port.command(f"RATE {rate}", terminal.now_s)
        terminal.now_s += 8.0
        unit.advance(terminal.now_s)
        terminal.write("ROUT:CHAN 3;VOLT:RANG 10")
        readings[rate] = float(terminal.ask("READ?"))
    earth = math.degrees(7.292115e-5) * math.sin(math.radians(34.2))
    for rate, reading in readings.items():
        truth = 0.050698 * (rate * (1 + share) + earth)
        assert reading == pytest.approx(truth, abs=3.5e-5 * abs(truth) + 5e-5 + 2e-5), rate
    half_span = (readings[100.0] - readings[-100.0]) / 2
    assert half_span / 5.0698 - 1 == pytest.approx(share, abs=3.5e-5)

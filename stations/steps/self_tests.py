"""Single-function tests of the processor, the sensors and the receiver (paper 1, Table 1)."""

import struct
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np

from protocol.errors import Fault, LinkError
from protocol.gnc_module import (
    AD_CHANNEL_OF_SOURCE,
    AD_OPEN_INPUT_V,
    AD_SWITCH_SOURCES,
    AD_VALUES,
    CPU_VALUES,
    GNSS_ANTENNA_HEIGHT_M,
    GNSS_ANTENNA_LATITUDE_DEG,
    GNSS_ANTENNA_LONGITUDE_DEG,
    GNSS_VALUES,
    GROUND_TEST_POINT,
    IMU_VALUES,
    MAG_SENSITIVITY_V_PER_GAUSS,
    MEMORY_VALUES,
    OPEN_CIRCUIT_OHM,
    RAIL_NOMINAL_V,
    TEST_DURATION_S,
    TIMER_PERIODS_US,
    TIMER_TEST_POINT,
    TIMER_VALUES,
    SelfTest,
)
from protocol.units_of_measure import factor_to_si
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step

AXES = ("x", "y", "z")
MEMORIES = {
    "internal_ram": SelfTest.INTERNAL_RAM,
    "sdram": SelfTest.SDRAM,
    "spi_flash": SelfTest.SPI_FLASH,
    "internal_flash": SelfTest.INTERNAL_FLASH,
}

# WGS 84 (NIMA TR8350.2, table 3.1)
_SEMI_MAJOR_AXIS_M = 6_378_137.0
_ECCENTRICITY_SQUARED = 6.694379990141e-3


def unpacked(layout: struct.Struct, values: bytes, what: str) -> tuple[float, ...]:
    """The numbers of a self-test's values.

    Raises:
        LinkError: there are more or fewer bytes than the product says.
    """
    if len(values) != layout.size:
        raise LinkError(
            f"The values of {what} have {len(values)} bytes, not {layout.size}.",
            where=what,
            fault=Fault.UNIT,
            remedy="check the unit's firmware version.",
        )
    return layout.unpack(values)


@step("test_cpu", ["cpu_operations_done", "cpu_operations_wrong"])
def test_cpu(context: StepContext) -> None:
    """Read-back and + − × ÷."""
    done, wrong = unpacked(CPU_VALUES, context.unit.self_test(SelfTest.CPU), "self-test CPU")
    context.measure("cpu_operations_done", done)
    context.measure("cpu_operations_wrong", wrong)


@step(
    "test_timers",
    [
        f"timer_{figure}_{period}us"
        for period in TIMER_PERIODS_US
        for figure in ("period_error", "interrupts")
    ],
)
def test_timers(context: StepContext) -> None:
    """Each timer's square wave against the oscilloscope: the unit cannot see its own crystal's error.

    No signal reads 9.9E+37 and stays so.
    """
    for period_us in TIMER_PERIODS_US:
        _test_timer(context, period_us)


def _test_timer(context: StepContext, period_us: int) -> None:
    """Holds the oscilloscope from before the test until the period is read, not until the test ends."""
    periods_s: list[float] = []
    with ExitStack() as held:
        oscilloscope = held.enter_context(context.oscilloscope())
        context.needed_board().route(TIMER_TEST_POINT, GROUND_TEST_POINT)

        def read_period() -> None:
            periods_s.append(oscilloscope.measure_period_s())
            held.close()

        values = self_test_watched(context, SelfTest.TIMER, period_us, read_period)
    (interrupts,) = unpacked(TIMER_VALUES, values, "self-test TIMER")
    nominal_s = period_us * 1e-6
    silent = periods_s[-1] >= OPEN_CIRCUIT_OHM
    error = OPEN_CIRCUIT_OHM if silent else periods_s[-1] / nominal_s - 1.0
    context.measure(f"timer_period_error_{period_us}us", error)
    if context.declares(f"timer_interrupts_{period_us}us"):
        context.measure(f"timer_interrupts_{period_us}us", interrupts)


def self_test_watched(context: StepContext, test: SelfTest, argument: int, look: Callable[[], None]) -> bytes:
    """A self-test with a look from outside that only counts while the test runs.

    Raises:
        LinkError: the station was too slow to look in time; no reason to blame the unit.
    """
    begun_s = context.clock.now_s()
    looked_s = begun_s

    def look_and_note() -> None:
        nonlocal looked_s
        look()
        looked_s = context.clock.now_s()

    values = context.unit.self_test(test, argument, while_running=look_and_note)
    if looked_s > begun_s + TEST_DURATION_S[test]:
        raise LinkError(
            f"The station looked at the self-test {test.name} {looked_s - begun_s:.3f} s after its "
            f"beginning; it runs for {TEST_DURATION_S[test]:g} s.",
            where=f"socket {context.lease.socket}",
            fault=Fault.STATION,
            remedy="relieve the station's computer, then run the operation again.",
        )
    return values


@step("test_memory", [f"{name}_words_{figure}" for name in MEMORIES for figure in ("tested", "wrong")])
def test_memory(context: StepContext) -> None:
    """One memory, written and read. Parameter memory: one of MEMORIES. A bad address is in the message."""
    name = context.word("memory", MEMORIES)
    test = MEMORIES[name]
    values = context.unit.self_test(test)
    tested, wrong, first = unpacked(MEMORY_VALUES, values, f"self-test {test.name}")
    context.measure(f"{name}_words_tested", tested)
    context.measure(f"{name}_words_wrong", wrong)
    if wrong:
        context.message = f"The first wrong word is at 0x{int(first):08X}."


@step(
    "test_imu",
    [
        *(f"gyro_{figure}_{axis}" for figure in ("bias", "noise") for axis in AXES),
        *(f"acc_{figure}_{axis}" for figure in ("mean", "noise") for axis in AXES),
        "acc_norm_error",
        "imu_temperature",
    ],
)
def test_imu(context: StepContext) -> None:
    """Means and standard deviations at rest.

    The mean rate is taken for the bias: the Earth's rate is at most 0.0042 °/s of it. The norm of the
    specific force does not depend on how level the board is.
    """
    numbers = unpacked(IMU_VALUES, context.unit.self_test(SelfTest.IMU), "self-test IMU")
    gyro, acc, temperature_c = numbers[0:3], numbers[3:6], numbers[6]
    gyro_noise, acc_noise = numbers[7:10], numbers[10:13]
    taken = {
        **{f"gyro_bias_{axis}": value for axis, value in zip(AXES, gyro, strict=True)},
        **{f"gyro_noise_{axis}": value for axis, value in zip(AXES, gyro_noise, strict=True)},
        **{f"acc_mean_{axis}": value for axis, value in zip(AXES, acc, strict=True)},
        **{f"acc_noise_{axis}": value for axis, value in zip(AXES, acc_noise, strict=True)},
        "acc_norm_error": float(np.linalg.norm(acc)) - context.site.gravity_m_s2,
        "imu_temperature": temperature_c,
    }
    for name, value in taken.items():
        if context.declares(name):
            context.measure(name, value)


@step(
    "test_gnss",
    ["gnss_fix", "gnss_satellites", "gnss_position_error", "gnss_speed", "gnss_pulse_error"],
)
def test_gnss(context: StepContext) -> None:
    """Fix against the surveyed antenna that is repeated to the sockets."""
    values = context.unit.self_test(SelfTest.GNSS)
    fix, satellites, _, *position, speed, pulse = unpacked(GNSS_VALUES, values, "self-test GNSS")
    context.measure("gnss_fix", fix)
    context.measure("gnss_satellites", satellites)
    context.measure("gnss_position_error", position_error_m(*position))
    context.measure("gnss_speed", speed)
    context.measure("gnss_pulse_error", pulse)


def position_error_m(latitude_rad: float, longitude_rad: float, height_m: float) -> float:
    """Distance from the surveyed antenna, in m, by Cartesian coordinates on WGS 84."""
    surveyed = _cartesian_m(
        np.radians(GNSS_ANTENNA_LATITUDE_DEG), np.radians(GNSS_ANTENNA_LONGITUDE_DEG), GNSS_ANTENNA_HEIGHT_M
    )
    return float(np.linalg.norm(_cartesian_m(latitude_rad, longitude_rad, height_m) - surveyed))


def _cartesian_m(latitude_rad: float, longitude_rad: float, height_m: float) -> np.ndarray:
    sine = np.sin(latitude_rad)
    normal_m = _SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * sine**2)
    horizontal_m = (normal_m + height_m) * np.cos(latitude_rad)
    return np.array(
        [
            horizontal_m * np.cos(longitude_rad),
            horizontal_m * np.sin(longitude_rad),
            (normal_m * (1.0 - _ECCENTRICITY_SQUARED) + height_m) * sine,
        ]
    )


@step(
    "test_ad",
    [*(f"ad_error_{channel}" for channel in AD_CHANNEL_OF_SOURCE.values()), "magnetometer_field"],
)
def test_ad(context: StepContext) -> None:
    """Each position of the AD switch, read by the unit, against the board's reference voltages.

    The magnetometer's three channels are read along: the norm of the field does not depend on how
    the board is turned.
    """
    board = context.needed_board()
    readings = ()
    for source in AD_SWITCH_SOURCES:
        board.set_ad_switch(source)
        readings = unpacked(AD_VALUES, context.unit.self_test(SelfTest.AD), "self-test AD")
        channel = AD_CHANNEL_OF_SOURCE[source]
        nominal_v = RAIL_NOMINAL_V.get(source, AD_OPEN_INPUT_V)
        context.measure(f"ad_error_{channel}", readings[channel - 1] - nominal_v)
    field_gauss = float(np.linalg.norm(readings[:3])) / MAG_SENSITIVITY_V_PER_GAUSS
    context.measure("magnetometer_field", field_gauss * factor_to_si("gauss"))

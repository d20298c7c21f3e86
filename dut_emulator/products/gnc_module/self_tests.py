# pyright: strict
"""What each self-test finds: the values of its DONE reply, from the unit as it truly is.

Firmware measures; it does not judge. Nothing here says what is wrong, only what was read.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.products.gnc_module.defects import MEMORY_WORDS
from dut_emulator.products.gnc_module.gnss_messages import geodetic_of
from dut_emulator.products.gnc_module.inertial_sensors import SensorSamples
from dut_emulator.products.gnc_module.unit_truth import UnitTruth
from dut_emulator.products.gnc_module.unit_twin import ACC_LSB_M_S2, GYRO_LSB_RAD_S
from protocol.gnc_module import (
    AD_OPEN_INPUT_V,
    AD_VALUES,
    CPU_VALUES,
    GNSS_ANTENNA_HEIGHT_M,
    GNSS_ANTENNA_LATITUDE_DEG,
    GNSS_ANTENNA_LONGITUDE_DEG,
    GNSS_VALUES,
    IMU_VALUES,
    IO_VALUES,
    MAG_SENSITIVITY_V_PER_GAUSS,
    MEMORY_VALUES,
    TEMPERATURE_LSB_C,
    TIMER_PERIODS_US,
    TIMER_VALUES,
    SelfTest,
)
from protocol.gnss.ubx import NavPvt
from protocol.units_of_measure import factor_to_si

CPU_OPERATIONS = 1_000_000
IO_PATTERNS = 256
SPI_BYTES = 256
NO_ADDRESS = 0xFFFF_FFFF
IO_LINES = 4
IMU_TEST_RATE_HZ = 200.0
AD_NOISE_V = 0.3e-3
GNSS_POSITION_NOISE_M = 0.3
GNSS_SPEED_NOISE_M_S = 0.005
GNSS_PULSE_NOISE_S = 2e-9


def cpu_values() -> bytes:
    """Operations done and wrong."""
    return CPU_VALUES.pack(CPU_OPERATIONS, 0)


def timer_values(duration_s: float, period_us: int) -> bytes:
    """Interrupts counted: test time and timer run on one crystal, so it cancels."""
    return TIMER_VALUES.pack(round(duration_s * 1e6) // period_us)


def memory_values(truth: UnitTruth, memory: SelfTest) -> bytes:
    """Words tested, wrong, first wrong address (all ones: none)."""
    wrong = truth.digital.wrong_addresses.get(memory, ())
    return MEMORY_VALUES.pack(MEMORY_WORDS[memory], len(wrong), wrong[0] if wrong else NO_ADDRESS)


def imu_values(samples: SensorSamples) -> bytes:
    """Means and standard deviations over the test's samples."""
    gyro, acc = samples.gyro * GYRO_LSB_RAD_S, samples.acc * ACC_LSB_M_S2
    temperature = float(samples.temperature.mean()) * TEMPERATURE_LSB_C
    means = (*gyro.mean(axis=0), *acc.mean(axis=0), temperature)
    return IMU_VALUES.pack(*means, *gyro.std(axis=0, ddof=1), *acc.std(axis=0, ddof=1))


def gnss_values(truth: UnitTruth, rng: np.random.Generator) -> bytes:
    """Fix, satellites, position of the repeated antenna with the receiver's error, speed, pulse."""
    receiver = truth.gnss
    if not receiver.acquires:
        return GNSS_VALUES.pack(0, receiver.satellites_used, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
    position_m = np.asarray(receiver.position_error_m) + GNSS_POSITION_NOISE_M * rng.standard_normal(3)
    antenna = math.radians(GNSS_ANTENNA_LATITUDE_DEG), math.radians(GNSS_ANTENNA_LONGITUDE_DEG)
    place = geodetic_of(position_m[np.newaxis, :], *antenna, GNSS_ANTENNA_HEIGHT_M)
    return GNSS_VALUES.pack(
        3,
        receiver.satellites_used,
        0,
        *(float(part[0]) for part in place),
        abs(receiver.speed_error_m_s + GNSS_SPEED_NOISE_M_S * float(rng.standard_normal())),
        receiver.pulse_error_s + GNSS_PULSE_NOISE_S * float(rng.standard_normal()),
    )


def gnss_values_of(fix: NavPvt) -> bytes:
    """The same from what the receiver itself says; how wrong its pulse is it does not know."""
    if not fix.fix_type:
        return GNSS_VALUES.pack(0, fix.satellites_used, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return GNSS_VALUES.pack(
        fix.fix_type,
        fix.satellites_used,
        0,
        fix.latitude_rad,
        fix.longitude_rad,
        fix.height_m,
        fix.ground_speed_m_s,
        0.0,
    )


def ad_values(
    truth: UnitTruth,
    field_t: NDArray[np.float64],
    routed_v: dict[int, float],
    rng: np.random.Generator,
) -> bytes:
    """Eight channels. `field_t`: the magnetometer's reading (3,); `routed_v`: channel → input voltage."""
    gauss = field_t / factor_to_si("gauss")
    inputs = [float(value) * MAG_SENSITIVITY_V_PER_GAUSS for value in gauss]
    inputs += [routed_v.get(channel, AD_OPEN_INPUT_V) for channel in range(4, 9)]
    noise = AD_NOISE_V * rng.standard_normal(8)
    readings = [
        0.0 if truth.ad_off == channel else value + truth.ad_error_v[channel - 1] + float(noise[channel - 1])
        for channel, value in enumerate(inputs, start=1)
    ]
    return AD_VALUES.pack(*readings)


def io_values(truth: UnitTruth, output_line: int, input_line: int) -> bytes:
    """Patterns driven on one line and read on another; a stuck line reads its level every time."""
    stuck = truth.digital.stuck_line
    wrong = IO_PATTERNS // 2 if stuck is not None and stuck[0] in (output_line, input_line) else 0
    return IO_VALUES.pack(IO_PATTERNS, wrong)


def spi_values(truth: UnitTruth) -> bytes:
    """Bytes of the SPI port as the four IO lines see them (CS, CLK, SDIN, SDOUT)."""
    if truth.digital.spi_broken or truth.digital.stuck_line is not None:
        return IO_VALUES.pack(SPI_BYTES, SPI_BYTES)
    return IO_VALUES.pack(SPI_BYTES, 0)


def error_flags(test: SelfTest, values: bytes) -> set[str]:
    """Flags of the heartbeat that a finished test raises: what it could not do, not what is out of limits."""
    match test:
        case SelfTest.INTERNAL_RAM | SelfTest.SDRAM:
            return {"memory"} if MEMORY_VALUES.unpack(values)[1] else set()
        case SelfTest.SPI_FLASH | SelfTest.INTERNAL_FLASH:
            return {"flash"} if MEMORY_VALUES.unpack(values)[1] else set()
        case SelfTest.GNSS:
            return {"gnss"} if values[0] == 0 else set()
        case SelfTest.IO | SelfTest.SPI:
            return {"io"} if IO_VALUES.unpack(values)[1] else set()
        case _:
            return set()


def is_valid_argument(test: SelfTest, argument: int) -> bool:
    """TIMER and IO take an argument; of the others it is ignored."""
    if test is SelfTest.TIMER:
        return argument in TIMER_PERIODS_US
    if test is SelfTest.IO:
        output_line, input_line = argument & 0xFF, argument >> 8
        return output_line < IO_LINES > input_line and output_line != input_line
    return True

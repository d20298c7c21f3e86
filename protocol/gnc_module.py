"""What a `gnc_module` says on its RS-422 link: commands, replies, raw samples, product constants.

A frame's layout is in `protocol/frames.py`, what commands have in common in `protocol/unit_commands.py`. A
self-test is answered twice: at once with ACCEPTED (or BUSY, UNKNOWN), and with DONE and its values when it
has run its fixed time. All numbers are little endian. The product follows paper 1, Tables 1 and 3.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from protocol.unit_commands import (  # noqa: F401 - part of what this product says
    COEFFICIENTS_LAYOUT,
    IDENTITY_LAYOUT,
    REPLY_BIT,
    START_STREAM_LAYOUT,
    ReplyStatus,
)

BAUD_RATE = 921_600


class FrameType(IntEnum):
    """Frame types from the host; replies have bit 7 set."""

    IDENTIFY = 0x01
    SELF_TEST = 0x02
    START_STREAM = 0x03
    STOP_STREAM = 0x04
    WRITE_COEFFICIENTS = 0x05
    READ_COEFFICIENTS = 0x06
    RESET = 0x07
    ECHO = 0x08
    FORWARD_GNSS = 0x09
    STREAM_SAMPLE = 0x20
    GNSS_DATA = 0x21


class SelfTest(IntEnum):
    """The unit's self-tests. Payload of SELF_TEST: test u8, argument u32.

    Payload of the DONE reply: status u8, test u8, argument u32, then the values named here.
    """

    CPU = 1  # u32 operations done, u32 operations wrong (read-back and + − × ÷)
    TIMER = 2  # argument: period in µs (500, 1000, 2000, 5000); u32 interrupts counted.
    # While it runs, TIMER_OUT carries a square wave of that period by the unit's own crystal.
    INTERNAL_RAM = 3  # memories: u32 words tested, u32 words wrong, u32 first wrong address
    SDRAM = 4
    SPI_FLASH = 5
    INTERNAL_FLASH = 6
    IMU = 7  # f32 means: gyro x y z rad/s, acc x y z m/s², temp °C; f32 standard deviations of the six
    GNSS = 8  # u8 fix (0 none, 3 three-dimensional), u8 satellites used, u16 reserved,
    # f64 latitude rad, f64 longitude rad, f32 height m, f32 speed m/s, f32 pulse-per-second error s
    AD = 9  # 8 × f32 V: channels 1–3 are the magnetometer's outputs, 4–8 the routed inputs
    IO = 10  # argument: output line | input line << 8 (0–3); u32 patterns sent, u32 patterns wrong
    SPI = 11  # looked at through the four IO lines; u32 bytes sent, u32 bytes wrong
    CAN = 12  # arms the CAN echo for the time of the test; u32 frames echoed


RESOURCE_OF_TEST = {
    SelfTest.CPU: "processor",
    SelfTest.TIMER: "processor",
    SelfTest.INTERNAL_RAM: "processor",
    SelfTest.SDRAM: "processor",
    SelfTest.SPI_FLASH: "processor",
    SelfTest.INTERNAL_FLASH: "processor",
    SelfTest.IMU: "imu",
    SelfTest.GNSS: "gnss",
    SelfTest.AD: "ad",
    SelfTest.IO: "io",
    SelfTest.SPI: "io",
    SelfTest.CAN: "can",
}
"""Tests of different resources run side by side; a second test on one resource is answered BUSY."""

TEST_DURATION_S = {
    SelfTest.CPU: 0.3,
    SelfTest.TIMER: 0.1,
    SelfTest.INTERNAL_RAM: 0.3,
    SelfTest.SDRAM: 0.7,
    SelfTest.SPI_FLASH: 0.6,
    SelfTest.INTERNAL_FLASH: 0.4,
    SelfTest.IMU: 1.0,
    SelfTest.GNSS: 3.0,
    SelfTest.AD: 0.1,
    SelfTest.IO: 0.1,
    SelfTest.SPI: 0.3,
    SelfTest.CAN: 0.3,
}
"""Fixed times of the product. One after the other (4 timers, 5 AD positions, 2 IO pairs) with boot and
static tests they make the 8–10 s of paper 1, section 5.2."""

BOOT_DURATION_S = 0.8
TIMER_PERIODS_US = (500, 1000, 2000, 5000)

RAIL_NOMINAL_V = {"5V": 5.0, "3V3": 3.3, "1V2": 1.2}
SUPPLY_CURRENT_NOMINAL_A = 0.49

# AD switch positions of the socket board: which source is routed to the channels 4–8, one at a time.
AD_SWITCH_SOURCES = ("5V", "3V3", "1V2", "GND", "OPEN")
AD_CHANNEL_OF_SOURCE = {"5V": 4, "3V3": 5, "1V2": 6, "GND": 7, "OPEN": 8}
AD_OPEN_INPUT_V = 0.0

GYRO_LSB_DEG_S = 0.0025
GYRO_RANGE_DEG_S = 400.0
ACC_LSB_G = 0.0005
ACC_RANGE_G = 50.0
MAG_LSB_GAUSS = 120e-6
MAG_RANGE_GAUSS = 6.0
MAG_SENSITIVITY_V_PER_GAUSS = 0.25
"""Of the magnetometer's outputs at AD channels 1–3, about 0 V: ±6 gauss are ±1.5 V."""
GNSS_ANTENNA_LATITUDE_DEG, GNSS_ANTENNA_LONGITUDE_DEG, GNSS_ANTENNA_HEIGHT_M = 34.2, 108.9, 430.0
"""The surveyed roof antenna whose signal is repeated to the sockets of a functional bench: units in
all sockets fix its position, not their own."""
TEMPERATURE_LSB_C = 0.01
GYRO_BIAS_INSTABILITY_DEG_H = 6.5
GYRO_TURN_ON_REPEATABILITY_DEG_H = 2.9
ACC_BIAS_INSTABILITY_MG = 0.126
ACC_TURN_ON_REPEATABILITY_MG = 0.039
# Means of the five units of paper 1, Table 2 (bias stability over 1 h, repeatability of six runs).
BIAS_INSTABILITY_UNIT_SPREAD = 0.4
"""Standard deviation of the logarithm over the same five units."""
BIAS_CORRELATION_TIME_S = 300.0
STREAM_RATES_HZ = (50, 100, 200, 400)
GNSS_RATES_HZ = (1, 5, 10)

SAMPLE_DTYPE = np.dtype(
    [
        ("counter", "<u4"),
        ("time_us", "<u8"),
        ("gyro", "<i4", (3,)),
        ("acc", "<i4", (3,)),
        ("mag", "<i4", (3,)),
        ("temp", "<i2"),
        ("status", "<u2"),
    ]
)
"""Payload of STREAM_SAMPLE. `time_us`: the unit's clock since power-on, at the sampling instant."""


class SampleStatus(IntEnum):
    """Bits of a sample's status."""

    COMPENSATED = 1
    GYRO_SATURATED = 2
    ACC_SATURATED = 4


class GnssProtocol(IntEnum):
    """Bits of what is forwarded of the receiver: NAV-PVT, or GGA and RMC."""

    UBX = 1
    NMEA = 2


class Sensor(IntEnum):
    """Which triad a set of coefficients is for."""

    GYRO = 0
    ACC = 1


SELF_TEST_LAYOUT = struct.Struct("<BI")
SELF_TEST_REPLY_HEAD = struct.Struct("<BBI")
FORWARD_GNSS_LAYOUT = struct.Struct("<BB")
"""Rate in Hz (0 ends it), protocols (`GnssProtocol`). From then on each epoch's bytes, as the receiver sends
them (`protocol.gnss`), are the payload of one GNSS_DATA, whose sequence counts the epochs."""

CPU_VALUES = struct.Struct("<II")
TIMER_VALUES = struct.Struct("<I")
MEMORY_VALUES = struct.Struct("<III")
IMU_VALUES = struct.Struct("<13f")
GNSS_VALUES = struct.Struct("<BBHddfff")
AD_VALUES = struct.Struct("<8f")
IO_VALUES = struct.Struct("<II")
CAN_VALUES = struct.Struct("<I")


@dataclass(frozen=True)
class PinPair:
    """Two test points of the socket board and what lies between them in a healthy unit.

    `nominal_ohm` with the relative spread of healthy units about it. Limits belong to the plan.
    """

    name: str
    high: str
    low: str
    nominal_ohm: float


CONTINUITY_PAIRS = (
    PinPair("ground_1", "GND_1", "GND_2", 0.25),
    PinPair("ground_2", "GND_3", "GND_4", 0.25),
    PinPair("supply_5v", "5V_1", "5V_2", 0.20),
    PinPair("rail_3v3", "3V3_1", "3V3_2", 0.30),
    PinPair("rail_1v2", "1V2_1", "1V2_2", 0.30),
    PinPair("layer_link_spi", "SPI_CLK_TOP", "SPI_CLK_BOTTOM", 0.40),
    PinPair("layer_link_imu", "IMU_CS_TOP", "IMU_CS_BOTTOM", 0.40),
    PinPair("layer_link_gnss", "GNSS_TX_TOP", "GNSS_TX_BOTTOM", 0.40),
)
INSULATION_PAIRS = (
    PinPair("can_to_5v", "CAN_H", "5V_1", 200e6),
    PinPair("can_to_ground", "CAN_H", "GND_1", 200e6),
    PinPair("rs422_to_5v", "RS422_TXP", "5V_1", 200e6),
    PinPair("rs422_to_ground", "RS422_TXP", "GND_1", 200e6),
    PinPair("io_to_io", "IO_1", "IO_2", 200e6),
    PinPair("case_to_ground", "CASE", "GND_1", 200e6),
)
IMPEDANCE_PAIRS = (
    PinPair("supply_5v", "5V_1", "GND_1", 1200.0),
    PinPair("rail_3v3", "3V3_1", "GND_1", 600.0),
    PinPair("rail_1v2", "1V2_1", "GND_1", 150.0),
)
OPEN_CIRCUIT_OHM = 9.9e37
"""What a multimeter answers for an overload (SCPI-99, 'positive infinity')."""

GROUND_TEST_POINT = "GND_1"
TIMER_TEST_POINT = "TIMER_OUT"
RIPPLE_TEST_POINT = "5V_1"

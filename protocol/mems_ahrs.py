"""What a `mems_ahrs` says on its RS-422 link: commands, replies, samples, product constants.

A frame's layout is in `protocol/frames.py`, what commands have in common in `protocol/unit_commands.py`;
types are as a `gnc_module`'s, so that a driver of one can talk to the other. All numbers are little endian.
The product follows paper 2.

The unit corrects a triad's output N by u = K (N − σ(N, T) − b): K and b of room temperature (coefficients),
σ_i = a_i N_i² + b_i N_i + c_i with a, b, c in nodes over temperature, straight between them, held beyond the
ends (paper 2, Eqs. 2 and 3). A new unit has neither.
"""

import struct
from enum import IntEnum, IntFlag

import numpy as np

from protocol.unit_commands import (  # noqa: F401 - part of what this product says
    COEFFICIENTS_LAYOUT,
    IDENTITY_LAYOUT,
    REPLY_BIT,
    START_STREAM_LAYOUT,
    ReplyStatus,
)

BAUD_RATE = 460_800
STREAM_RATES_HZ = (50, 100, 200)
BOOT_DURATION_S = 0.5
SUPPLY_NOMINAL_V = 5.0

GYRO_LSB_DEG_S, GYRO_RANGE_DEG_S = 0.0125, 400.0
ACC_LSB_G, ACC_RANGE_G = 0.0003125, 10.0
TEMPERATURE_LSB_C = 0.01
ATTITUDE_LSB_DEG = 0.01
CALIBRATED_RANGE_C = (-40.0, 70.0)
"""Sensors work to 80 °C; beyond 70 °C no calibration holds, and the unit says so."""


class FrameType(IntEnum):
    """Frame types from the host; replies have bit 7 set. Numbers that a GNC module has too mean the same."""

    IDENTIFY = 0x01
    START_STREAM = 0x03
    STOP_STREAM = 0x04
    WRITE_COEFFICIENTS = 0x05
    READ_COEFFICIENTS = 0x06
    RESET = 0x07
    ECHO = 0x08
    WRITE_NODE = 0x09
    READ_NODE = 0x0A
    ERASE_NODES = 0x0B
    STATUS = 0x0C
    STREAM_SAMPLE = 0x20


class Sensor(IntEnum):
    """Which triad coefficients or nodes are for."""

    GYRO = 0
    ACC = 1


class SampleFlag(IntFlag):
    """Bits of a sample's flags. The first three are a GNC module's."""

    COMPENSATED = 1
    GYRO_SATURATED = 2
    ACC_SATURATED = 4
    STEADY = 8  # the gates are open: the accelerometers may correct the attitude
    ALIGNED = 16  # the first levelling is done
    BEYOND_CALIBRATED = 32
    OVER_TEMPERATURE = 64  # a component is above its rated maximum


class Component(IntFlag):
    """Bits of STATUS: which components are above their rated maximum."""

    PROCESSOR = 1
    POWER_CHIPS = 2
    GYROS = 4
    ACCELEROMETERS = 8


SAMPLE_DTYPE = np.dtype(
    [
        ("counter", "<u4"),
        ("time_us", "<u8"),
        ("gyro", "<i2", (3,)),
        ("acc", "<i2", (3,)),
        ("temp", "<i2"),
        ("temp_gyro", "<i2"),
        ("temp_acc", "<i2"),
        ("attitude", "<i2", (3,)),
        ("flags", "<u2"),
    ]
)
"""Payload of STREAM_SAMPLE. `time_us`: the unit's clock since power-on, at the sampling instant; `temp`: the
mean of the two triads'; `attitude`: roll, pitch, yaw."""

NODE_LAYOUT = struct.Struct("<BBd9d")
"""WRITE_NODE: sensor, index, temperature °C, then a (1/SI), b, c (SI) of x, of y, of z. The index is that of
a node to be replaced or the next free one; temperatures must ascend. READ_NODE asks with sensor and index;
the reply is the status byte followed by the same, INVALID beyond the last node."""
NODE_ADDRESS_LAYOUT = struct.Struct("<BB")
MAX_NODES = 32
STATUS_LAYOUT = struct.Struct("<BHHQ4f3f")
"""Reply to STATUS: status, sample flags, components above their maximum, unit's clock µs; temperatures °C of
the test points 1 (heat sources), 2 (gyros), 3 (ADC and accelerometers) and of the case; roll, pitch, yaw in
degrees (NaN while there is no stream)."""

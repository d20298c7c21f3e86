# pyright: strict
"""The GNC module as whoever records it sees it. `dut`: the raw samples; `gnss`: the receiver's epochs.

Column `t` is the unit's clock, which runs by its crystal from the run's start; epochs lie on whole periods of
the satellites' time. What a twin cannot say (warmth, errors of the receiver's own) is drawn by serial number.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.lot import LotDraw, Spread
from dut_emulator.products.gnc_module.belief import believed_of
from dut_emulator.products.gnc_module.gnss_receiver import INNER_RATE_HZ, Fixes, GnssReceiver
from dut_emulator.products.gnc_module.inertial_sensors import InertialSensors
from dut_emulator.products.gnc_module.population import ACC_TURN_ON_SI, GYRO_TURN_ON_SI, draw_unit
from dut_emulator.products.gnc_module.unit_truth import GnssTruth
from dut_emulator.products.gnc_module.unit_twin import (
    PRODUCT_NAME,
    check_product,
    crystal_error,
    sensor_unit_of_serial,
    twin_of,
)
from dut_emulator.products.product import (
    Mounting,
    Product,
    StreamShape,
    UnitOnStand,
    UnitStreams,
    sample_times_s,
)
from dut_emulator.seeds import child_seed
from dut_emulator.twin import Twin
from protocol.gnc_module import ACC_LSB_G, GYRO_LSB_DEG_S, MAG_LSB_GAUSS, TEMPERATURE_LSB_C

RATE_HZ = 200.0
GNSS_RATE_HZ = 10
_TURNTABLE = ("static", "multi_position", "rotation", "rate_staircase", "tumble", "swing", "sweep")
_STANDS = {
    **dict.fromkeys(_TURNTABLE, "three_axis_turntable"),
    "spin": "non_magnetic_turntable",
    **dict.fromkeys(("satellite_static", "satellite_trajectory"), "satellite_simulator"),
    "vehicle_run": "vehicle_run_stand",
}
_TRIADS = (("gyro", "deg/s", GYRO_LSB_DEG_S), ("acc", "g", ACC_LSB_G), ("mag", "gauss", MAG_LSB_GAUSS))
_LOCAL = ("east", "north", "up")
_NOISE, _RECEIVER = range(2)

DUT = StreamShape(
    "dut",
    {
        "t": "s",
        **{f"{sensor}_{axis}": unit for sensor, unit, _ in _TRIADS for axis in "xyz"},
        **{"temp": "degC", "counter": "1", "status": "1"},
    },
    {
        "t": "float64",
        **{f"{sensor}_{axis}": "float64" for sensor, _, _ in _TRIADS for axis in "xyz"},
        **{"temp": "float64", "counter": "uint32", "status": "uint16"},
    },
)
_FIX_UNITS = {
    "t": "s",
    **{"fix_type": "1", "satellites_used": "1"},
    **{f"position_{axis}": "m" for axis in _LOCAL},
    **{f"velocity_{axis}": "m/s" for axis in _LOCAL},
    **{f"position_deviation_{axis}": "m" for axis in _LOCAL},
    **{"position_dop": "1", "pulse_error": "us"},
}
GNSS = StreamShape(
    "gnss",
    _FIX_UNITS,
    {**dict.fromkeys(_FIX_UNITS, "float64"), "fix_type": "uint8", "satellites_used": "uint8"},
)


class GncModuleProduct:
    """See `Product`."""

    name = PRODUCT_NAME
    profiles: Mapping[str, Mounting] = {
        profile: Mounting(stand, RATE_HZ) for profile, stand in _STANDS.items()
    }

    def twin(self, seed: int, serial: str) -> Twin:
        """The unit of this serial number in the lot of this seed: its true effects."""
        return twin_of(draw_unit(seed, serial))

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        """See `Product`: one at most."""
        defect = draw_unit(seed, serial).defect
        return (defect,) if defect is not None else ()

    def believed(self, twin: Twin) -> dict[str, Any]:
        """What the simulator knows of a unit with this twin."""
        return believed_of(twin)

    def begin(self, unit: UnitOnStand) -> UnitStreams:
        """Power the unit on this stand.

        Raises:
            TestloomError: the twin is another product's.
        """
        check_product(unit.twin)
        return _Streams(unit)


class _Streams:
    """See `UnitStreams`."""

    def __init__(self, unit: UnitOnStand) -> None:
        self._run, self._rate_hz = unit.run, unit.rate_hz
        self._clock = 1.0 + crystal_error(unit.twin)
        made_of = sensor_unit_of_serial(unit.twin, unit.serial, GYRO_TURN_ON_SI, ACC_TURN_ON_SI)
        self._sensors = InertialSensors(
            made_of, child_seed(unit.seed, _NOISE), unit.power_on_s, unit.stand_effects
        )
        self._receiver: GnssReceiver | None = None
        if unit.run.stimulus(np.zeros(1)).position_m is not None:
            self._receiver = GnssReceiver(
                receiver_of_serial(unit.serial),
                unit.twin,
                child_seed(unit.seed, _RECEIVER),
                unit.power_on_s,
                unit.run,
                unit.stand_effects,
            )
        self._taken = self._epochs = 0

    @property
    def shapes(self) -> tuple[StreamShape, ...]:
        """Without a receiver that hears anything, the samples alone."""
        return (DUT,) if self._receiver is None else (DUT, GNSS)

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, NDArray[Any]]]:
        """Samples of (last advance, to_s]."""
        streams = {"dut": self._samples(to_s)}
        if self._receiver is not None:
            streams["gnss"] = self._fixes(self._receiver, to_s)
        return streams

    def _samples(self, to_s: float) -> dict[str, NDArray[Any]]:
        stamps_s = sample_times_s(self._taken, to_s * self._clock, self._rate_hz)
        times_s = stamps_s / self._clock
        samples = self._sensors.sample(times_s, 1 / self._rate_hz / self._clock, self._run.stimulus(times_s))
        counters = np.arange(self._taken, self._taken + len(times_s), dtype=np.uint32)
        self._taken += len(times_s)
        here = ~samples.lost
        columns: dict[str, NDArray[Any]] = {"t": stamps_s[here]}
        for (sensor, _, quantum), counts in zip(
            _TRIADS, (samples.gyro, samples.acc, samples.mag), strict=True
        ):
            for axis, values in zip("xyz", (counts[here] * quantum).T, strict=True):
                columns[f"{sensor}_{axis}"] = values
        columns["temp"] = samples.temperature[here] * TEMPERATURE_LSB_C
        columns["counter"], columns["status"] = counters[here], samples.status[here]
        return columns

    def _fixes(self, receiver: GnssReceiver, to_s: float) -> dict[str, NDArray[Any]]:
        every = INNER_RATE_HZ // GNSS_RATE_HZ
        times_s = sample_times_s(self._epochs, to_s, float(GNSS_RATE_HZ))
        fixes = receiver.fixes(np.arange(self._epochs, self._epochs + len(times_s)) * every)
        self._epochs += len(times_s)
        return _fix_columns(fixes, self._clock)


def receiver_of_serial(serial: str) -> GnssTruth:
    """A healthy receiver's own errors: of position 3 m, of the pulse 15 ns (as in a lot's healthy units)."""
    draw = LotDraw(0, serial)
    return GnssTruth(
        acquires=True,
        satellites_used=12,
        position_error_m=draw.triple("gnss_position", 0.0, Spread(unit=1.5)),
        speed_error_m_s=0.0,
        pulse_error_s=draw.normal("gnss_pulse", 0.0, Spread(unit=15e-9)),
    )


def _fix_columns(fixes: Fixes, clock: float) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {
        "t": fixes.time_s * clock,
        "fix_type": fixes.fix_type,
        "satellites_used": fixes.satellites_used,
    }
    for name, values in (
        ("position", fixes.position_m),
        ("velocity", fixes.velocity_m_s),
        ("position_deviation", fixes.deviation_m),
    ):
        columns |= {f"{name}_{axis}": values[:, number] for number, axis in enumerate(_LOCAL)}
    return columns | {"position_dop": fixes.position_dop, "pulse_error": fixes.pulse_error_s * 1e6}


PRODUCT: Product = GncModuleProduct()

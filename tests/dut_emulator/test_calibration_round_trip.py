"""Emulated unit and table → evaluation → the truth, within the evaluation's own uncertainties.

The two packages share names and shapes but no code, so a sign or a transposition in either shows here.
"""

import dataclasses
import math

import numpy as np
import pytest

from calibration.imu_session import Rotation, SlowNoise, StaticPose, calibrate_imu
from dut_emulator.gimbal_geometry import body_rate_rad_s
from dut_emulator.products.gnc_module import GncModule
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_truth import Category, TriadTruth, UnitTruth
from dut_emulator.stands.three_axis_turntable import ThreeAxisTurntableModel
from protocol import gnc_module as product
from protocol.bench_description import Site
from protocol.frames import FrameBlock, FrameParser, encode_frame
from protocol.gnc_module import SAMPLE_DTYPE, FrameType

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=12.0)
GYRO_LSB = math.radians(product.GYRO_LSB_DEG_S)
ACC_LSB = product.ACC_LSB_G * 9.80665
WARM_S = 300.0
POSE_S, TURN_S = 20.0, 7.0
POSES = {
    "z_up": (0.0, 0.0, 0.0),
    "z_down": (0.0, 180.0, 0.0),
    "x_up": (0.0, -90.0, 0.0),
    "x_down": (0.0, 90.0, 0.0),
    "y_up": (0.0, 0.0, 90.0),
    "y_down": (0.0, 0.0, -90.0),
}
UNITS = 6


def healthy_units() -> list[UnitTruth]:
    """Without the part of the bias that a power-on draws anew: it is in no truth."""
    lot = (draw_unit(3, f"RT-{number}") for number in range(1, 100))
    healthy = [unit for unit in lot if unit.category is Category.HEALTHY][:UNITS]
    return [
        dataclasses.replace(
            unit,
            gyro=dataclasses.replace(unit.gyro, turn_on_deviation_si=0.0),
            acc=dataclasses.replace(unit.acc, turn_on_deviation_si=0.0),
            self_heating_c=2.0,  # to the reference temperature of the biases
        )
        for unit in healthy
    ]


class Session:
    """A unit on a table, and a host that records."""

    def __init__(self, truth: UnitTruth) -> None:
        self.table = ThreeAxisTurntableModel(SITE)
        self.table.home(0.0)
        self.unit = GncModule(truth)
        self.unit.insert(self.table, 0.0)
        self.unit.set_supply(5.0, 0.0)
        self.now_s = WARM_S

    def record(self, duration_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time by the unit's clock, gyro, acc in nominal SI."""
        self.unit.advance(self.now_s)
        start = product.START_STREAM_LAYOUT.pack(200, 0)
        self.unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, start), self.now_s)
        self.now_s += duration_s
        self.unit.receive("rs422", encode_frame(FrameType.STOP_STREAM, 2, b""), self.now_s)
        self.now_s += 0.01
        data = b"".join(o.data for o in self.unit.advance(self.now_s) if o.link == "rs422")
        blocks = [item for item in FrameParser().feed(data) if isinstance(item, FrameBlock)]
        rows = np.concatenate([block.payloads for block in blocks]).view(SAMPLE_DTYPE).ravel()
        return rows["time_us"] * 1e-6, rows["gyro"] * GYRO_LSB, rows["acc"] * ACC_LSB

    def pose(self, name: str) -> StaticPose:
        moved = self.table.move(POSES[name], self.now_s)
        assert isinstance(moved, float)
        self.now_s += moved
        acting = self.table.stimulus(np.array([self.now_s]))
        time_s, gyro, acc = self.record(POSE_S)
        return StaticPose(name, gyro, acc, acting.specific_force_m_s2[0], acting.rate_rad_s[0], time_s)

    def turn(self, axis: str, angle_deg: float) -> Rotation:
        begun_s = self.now_s
        assert self.table.rotate(axis, angle_deg, 5.0, 2.2, begun_s + 1.0) == 5.0
        time_s, gyro, _ = self.record(TURN_S)
        instants = np.linspace(begun_s, begun_s + TURN_S, 7001)
        turned = np.trapezoid(self.table.encoder_samples(instants)[:, 1:4], instants, axis=0)
        inertial = self.table.stimulus(instants).rate_rad_s
        relative = body_rate_rad_s(*self.table.pose(instants)[:2])
        earth = np.trapezoid(inertial - relative, instants, axis=0)
        return Rotation(f"{axis}{angle_deg:+g}", time_s, gyro, turned, earth)


def matrix_of(triad: TriadTruth) -> np.ndarray:
    """M of y = M u + b."""
    return np.diag(1 + np.array(triad.scale_factor_error)) @ (np.eye(3) + np.array(triad.misalignment_rad))


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    """(units, 24) estimate less truth, in the evaluation's own standard uncertainties."""
    found = []
    for truth in healthy_units():
        session = Session(truth)
        poses = [session.pose(name) for name in POSES]
        session.now_s += float(session.table.move((0.0, 0.0, 0.0), session.now_s))  # type: ignore[arg-type]
        turns = [
            session.turn(axis, sign * 1080.0) for axis in ("inner", "middle", "outer") for sign in (1, -1)
        ]
        result = calibrate_imu(
            poses,
            turns,
            gyro_range_rad_s=math.radians(product.GYRO_RANGE_DEG_S),
            acc_range_m_s2=product.ACC_RANGE_G * 9.80665,
            gyro_slow_noise=SlowNoise(math.radians(5 / 3600), 300.0),
            acc_slow_noise=SlowNoise(0.1e-3 * 9.80665, 300.0),
        )
        # rates are integrated over the unit's own seconds: its scale factor is by its own clock
        clock = 1 + truth.crystal_error
        row = []
        for estimate, triad, factor in ((result.gyro, truth.gyro, clock), (result.acc, truth.acc, 1.0)):
            true = np.concatenate([factor * matrix_of(triad).ravel(), triad.bias_si])
            got = np.concatenate([np.ravel(estimate.matrix), estimate.bias])
            row.append((got - true) / np.sqrt(np.diag(estimate.covariance)))
        found.append(np.concatenate(row))
    return np.array(found)


def test_each_coefficient_comes_back_within_its_uncertainty(errors: np.ndarray) -> None:
    assert np.abs(errors).max() < 4.0
    assert np.mean(np.abs(errors) > 3.0) < 0.02


def test_the_uncertainties_are_neither_too_small_nor_too_large(errors: np.ndarray) -> None:
    gyro, acc = errors[:, :12], errors[:, 12:]
    for triad in (gyro, acc):
        assert 0.7 < math.sqrt(float(np.mean(triad**2))) < 1.4

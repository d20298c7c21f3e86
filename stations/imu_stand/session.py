"""A session on the stand, put together: clocks aligned, truth attached, one recording of it all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from protocol.attempts import UnitIdentity
from protocol.bench_description import Site
from protocol.errors import Fault, LinkError
from protocol.gnc_module import (
    ACC_BIAS_INSTABILITY_MG,
    ACC_LSB_G,
    ACC_RANGE_G,
    ACC_TURN_ON_REPEATABILITY_MG,
    BIAS_CORRELATION_TIME_S,
    BIAS_INSTABILITY_UNIT_SPREAD,
    GYRO_BIAS_INSTABILITY_DEG_H,
    GYRO_LSB_DEG_S,
    GYRO_RANGE_DEG_S,
    GYRO_TURN_ON_REPEATABILITY_DEG_H,
    TEMPERATURE_LSB_C,
)
from protocol.instruments import StandFacts
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2
from stations.imu_stand.alignment import ClockAlignment, align, turn_centroid_s
from stations.imu_stand.capture import Capture
from stations.imu_stand.truth import FloatArray, static_truth, turn_truth

if TYPE_CHECKING:  # a station without a stand is up sooner without the evaluation's libraries
    from calibration.imu_session import Rotation, StaticPose

ALIGNMENT_WORDS = "centroids of the turns' rates on both streams, a line through them"
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Segment:
    """One capture with its truth, on the bench's time. Vectors in body axes, shape (3,).

    `force_or_turn`: specific force (m/s²) of a pose, turn relative to the laboratory (rad) of a rotation;
    `earth`: Earth rate (rad/s) or its integral (rad).
    """

    capture: Capture
    time_s: FloatArray
    force_or_turn: FloatArray
    earth: FloatArray

    @property
    def gyro_rad_s(self) -> FloatArray:
        return self.capture.gyro_rad_s()

    @property
    def acc_m_s2(self) -> FloatArray:
        return self.capture.dut["acc"] * (ACC_LSB_G * STANDARD_GRAVITY_M_S2)

    def described(self) -> dict[str, Any]:
        """The segment as `test.segments` of recording.json has it; half a period wider than its samples."""
        half_period_s = 0.5 / self.capture.rate_hz
        words = (
            ("specific_force_body_m_s2", "earth_rate_body_rad_s")
            if self.capture.kind == "static"
            else ("rotation_body_rad", "earth_rotation_body_rad")
        )
        return {
            "name": self.capture.name,
            "kind": self.capture.kind,
            "start_s": float(self.time_s[0] - half_period_s),
            "end_s": float(self.time_s[-1] + half_period_s),
            words[0]: self.force_or_turn.tolist(),
            words[1]: self.earth.tolist(),
        }


@dataclass(frozen=True)
class StandSession:
    """All captures of one look at a unit."""

    segments: tuple[Segment, ...]
    alignment: ClockAlignment
    response: Mapping[str, float]
    """Turn name → angle that the turned gyro saw, over the stand's."""

    def poses(self) -> "list[StaticPose]":
        """As `calibrate_imu` takes them."""
        from calibration.imu_session import StaticPose

        return [
            StaticPose(s.capture.name, s.gyro_rad_s, s.acc_m_s2, s.force_or_turn, s.earth, s.time_s)
            for s in self.segments
            if s.capture.kind == "static"
        ]

    def rotations(self) -> "list[Rotation]":
        """As `calibrate_imu` takes them."""
        from calibration.imu_session import Rotation

        return [
            Rotation(s.capture.name, s.time_s, s.gyro_rad_s, s.force_or_turn, s.earth)
            for s in self.segments
            if s.capture.kind == "rotation"
        ]


def build_session(captures: Sequence[Capture], site: Site) -> StandSession:
    """Align the unit's clock to the bench's, and give each capture its truth.

    Raises:
        LinkError: the unit's clock does not run like a clock.
    """
    alignment, response = _alignment(captures)
    if not alignment.is_plausible:
        raise LinkError(
            f"The unit's clock cannot be laid over the bench's: skew {alignment.skew:.2e}, turns up to "
            f"{alignment.residual_max_s:.2e} s off a line.",
            where="time stamps of the unit's samples",
            fault=Fault.UNIT,
            remedy="look at the unit's timer tests; a retest on another stand tells whose clock it is.",
        )
    segments: list[Segment] = []
    for capture in captures:
        angles = capture.stand["angles_rad"]
        if capture.kind == "static":
            truth = static_truth(angles, site)
        else:
            truth = turn_truth(capture.stand["time_s"], angles, site)
        segments.append(Segment(capture, alignment.bench_time_s(capture.unit_time_s()), *truth))
    return StandSession(tuple(segments), alignment, response)


def session_recording(
    session: StandSession,
    recording_id: str,
    unit: UnitIdentity,
    stand: StandFacts,
    site: Site,
    test: Mapping[str, Any],
) -> Recording:
    """The session as a recording. The unit's own time stamps are kept beside the aligned time.

    Args:
        session: with at least one capture.
        recording_id: names it.
        unit: whose.
        stand: that it was on; a certificate names it, its date, and that it was emulated.
        site: where.
        test: profile, run, mount, started_at …; segments and alignment are added.
    """
    alignment = session.alignment
    return Recording(
        recording_id=recording_id,
        unit={"serial": unit.serial, "product": unit.product, "lot": unit.lot},
        test={
            **test,
            "segments": [segment.described() for segment in session.segments],
            "time_alignment": {
                "method": ALIGNMENT_WORDS,
                "unit_reference_s": alignment.unit_reference_s,
                "bench_reference_s": alignment.bench_reference_s,
                "skew": alignment.skew,
                "turns": alignment.turns,
            },
        },
        streams={"dut": _dut_stream(session), "stand": _stand_stream(session)},
        stand=_stand_mapping(stand),
        site=site.model_dump(),
        believed={
            "gyro": {
                **{"unit": "deg/s", "range": GYRO_RANGE_DEG_S, "quantum": GYRO_LSB_DEG_S},
                **_slow_noise(GYRO_BIAS_INSTABILITY_DEG_H, GYRO_TURN_ON_REPEATABILITY_DEG_H, "deg/h"),
            },
            "acc": {
                **{"unit": "g", "range": ACC_RANGE_G, "quantum": ACC_LSB_G},
                **_slow_noise(ACC_BIAS_INSTABILITY_MG, ACC_TURN_ON_REPEATABILITY_MG, "mg"),
            },
        },
    )


def _stand_mapping(stand: StandFacts) -> dict[str, Any]:
    return {
        "id": stand.stand_id,
        "kind": stand.kind,
        "identification": stand.identification,
        "calibration_due": stand.calibration_due,
        **({"emulated": True} if stand.emulated else {}),
    }


def _slow_noise(instability: float, turn_on: float, unit: str) -> dict[str, Any]:
    """What the product is known to do more slowly than a session of minutes can show."""
    return {
        "bias_instability": {
            "value": instability,
            "unit": unit,
            "unit_spread": BIAS_INSTABILITY_UNIT_SPREAD,
            "correlation_time_s": BIAS_CORRELATION_TIME_S,
        },
        "turn_on_repeatability": {"value": turn_on, "unit": unit},
    }


def _alignment(captures: Sequence[Capture]) -> tuple[ClockAlignment, dict[str, float]]:
    turns = [capture for capture in captures if capture.kind == "rotation" and capture.axis is not None]
    unit_s: list[float] = []
    bench_s: list[float] = []
    response: dict[str, float] = {}
    for capture in turns:
        axis = capture.axis or 0
        bench, true_angle = turn_centroid_s(capture.stand["time_s"], capture.stand["rate_rad_s"][:, axis])
        unit, seen_angle = turn_centroid_s(capture.unit_time_s(), capture.gyro_rad_s()[:, axis])
        unit_s.append(unit)
        bench_s.append(bench)
        response[capture.name] = seen_angle / true_angle
    first = captures[0]
    fallback = (float(first.unit_time_s()[0]), first.started_bench_s + 1.0 / first.rate_hz)
    seen = np.array(list(response.values()))
    return align(np.array(unit_s), np.array(bench_s), seen, fallback=fallback), response


def _dut_stream(session: StandSession) -> Stream:
    dut = np.concatenate([segment.capture.dut for segment in session.segments])
    columns: dict[str, Any] = {
        "t": np.concatenate([segment.time_s for segment in session.segments]),
        "counter": dut["counter"].astype(np.uint32),
        "time_unit": dut["time_us"].astype(np.uint64),
        "status": dut["status"].astype(np.uint16),
        "temp": dut["temp"] * TEMPERATURE_LSB_C,
    }
    units = {"t": "s", "counter": "count", "time_unit": "us", "status": "1", "temp": "degC"}
    for kind, quantum, unit in (("gyro", GYRO_LSB_DEG_S, "deg/s"), ("acc", ACC_LSB_G, "g")):
        for index, axis in enumerate(_AXES):
            columns[f"{kind}_{axis}"] = dut[kind][:, index] * quantum
            units[f"{kind}_{axis}"] = unit
    return Stream("dut", "bench", "t", units, columns)


def _stand_stream(session: StandSession) -> Stream:
    stand = np.concatenate([segment.capture.stand for segment in session.segments])
    columns: dict[str, Any] = {"t": np.ascontiguousarray(stand["time_s"])}
    units = {"t": "s"}
    for field, names, unit in (
        ("rate_rad_s", ("rate_x", "rate_y", "rate_z"), "rad/s"),
        ("specific_force_m_s2", ("acc_x", "acc_y", "acc_z"), "m/s^2"),
        ("angles_rad", ("angle_outer", "angle_middle", "angle_inner"), "rad"),
    ):
        for index, name in enumerate(names):
            columns[name] = np.ascontiguousarray(stand[field][:, index])
            units[name] = unit
    columns["temp"] = np.ascontiguousarray(stand["temperature_c"])
    units["temp"] = "degC"
    return Stream("stand", "bench", "t", units, columns)

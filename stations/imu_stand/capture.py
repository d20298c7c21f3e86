"""Captures on the turntable: the unit's raw stream and the stand's encoders over a pose or a turn.

Each capture starts and stops both streams, so that a lost sample costs one capture, not the session.
A capture in which samples were lost on the link is taken once more; what is lost again is the link's
fault. A stand that did not do what it was told is the stand's.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, LinkError
from protocol.gnc_module import GYRO_LSB_DEG_S, SampleStatus
from protocol.instruments import ThreeAxisTurntable
from stations.imu_stand.truth import POSES_DEG, FloatArray
from stations.interruptions import StepError
from stations.sequencing.context import StepContext

CAPTURE_TRIES = 2
SETTLE_S = 0.5
REST_BEFORE_TURN_S = 0.5
TAIL_SAMPLES = 3
"""The unit's crystal and the moments of start and stop leave this many samples open."""
COUNT_TOLERANCE = 1e-3
MAX_ANGLE_ERROR_RAD = np.deg2rad(0.05)
MAX_REST_MOVEMENT_RAD = np.deg2rad(0.02)
MIN_RATE_SHARE = 0.98
"""The largest rate of a turn, of what the trapezoid asks for."""


@dataclass(frozen=True)
class Capture:
    """One pose or turn as recorded.

    Attributes:
        name: e.g. 'x_up', 'x_plus'.
        dut: SAMPLE_DTYPE (n,), as the unit sent it.
        stand: the stand's samples (m,), with fields time_s, rate_rad_s, angles_rad …
        started_bench_s: bench time when the unit had acknowledged the start of its stream.
        axis: body axis of a turn (0, 1, 2); None for a pose.
    """

    name: str
    kind: Literal["static", "rotation"]
    dut: NDArray[np.void]
    stand: NDArray[np.void]
    started_bench_s: float
    rate_hz: int
    axis: int | None = None

    def unit_time_s(self) -> FloatArray:
        """Sampling instants on the unit's clock, (n,)."""
        return self.dut["time_us"].astype(np.float64) * 1e-6

    def gyro_rad_s(self) -> FloatArray:
        """Outputs in nominal scaling, (n, 3)."""
        return self.dut["gyro"] * np.deg2rad(GYRO_LSB_DEG_S)

    def flagged(self, bit: SampleStatus) -> int:
        """Samples with this bit of the status set."""
        return int(np.count_nonzero(self.dut["status"] & np.uint16(bit)))


@dataclass(frozen=True)
class TurnProfile:
    """A turn about the vertical: trapezoid of rate with equal ramps, then a rest that is recorded."""

    angle_deg: float
    duration_s: float
    ramp_s: float
    rest_s: float

    @property
    def peak_rate_rad_s(self) -> float:
        """Of the trapezoid."""
        return float(np.deg2rad(self.angle_deg) / (self.duration_s - self.ramp_s))


def stand_of(ctx: StepContext) -> ThreeAxisTurntable:
    """The bench's turntable. Raises StepError: it has none."""
    stand = ctx.stand
    if stand is None:
        raise StepError(
            "This bench has no turntable.",
            fault=Fault.PLAN,
            remedy="run this plan on a bench with a three-axis turntable.",
        )
    return stand


def capture_poses(ctx: StepContext, *, duration_s: float, rate_hz: int, compensated: bool) -> list[Capture]:
    """The six positions, each axis up and down.

    Raises:
        LinkError: samples were lost twice (link), or the stand moved (stand).
    """
    captures: list[Capture] = []
    for name, angles_deg in POSES_DEG.items():
        _go_to(ctx, angles_deg)
        captures.append(_complete(ctx, name, "static", None, duration_s, rate_hz, compensated, None))
    return captures


def capture_turns(
    ctx: StepContext, profile: TurnProfile, *, rate_hz: int, compensated: bool
) -> list[Capture]:
    """Each body axis upright in turn, and the outer axis turned forth and back under it.

    Raises:
        LinkError: samples were lost twice (link), or the stand did not do its turn (stand).
    """
    captures: list[Capture] = []
    for axis, letter in enumerate("xyz"):
        _go_to(ctx, POSES_DEG[f"{letter}_up"])
        for sign, word in ((1, "plus"), (-1, "minus")):
            name = f"{letter}_{word}"
            turn = (profile, sign)
            captures.append(_complete(ctx, name, "rotation", axis, 0.0, rate_hz, compensated, turn))
    return captures


def _go_to(ctx: StepContext, angles_deg: tuple[float, float, float]) -> None:
    stand_of(ctx).move_to(angles_deg)
    ctx.clock.sleep_until(ctx.clock.now_s() + SETTLE_S)


def _complete(
    ctx: StepContext,
    name: str,
    kind: Literal["static", "rotation"],
    axis: int | None,
    duration_s: float,
    rate_hz: int,
    compensated: bool,
    turn: tuple[TurnProfile, int] | None,
) -> Capture:
    """A capture without lost samples, within `CAPTURE_TRIES`."""
    lost = 0
    for _ in range(CAPTURE_TRIES):
        stand = stand_of(ctx)
        stand.start_stream(float(rate_hz))
        ctx.unit.start_stream(rate_hz, compensated)
        started_s = ctx.clock.now_s()
        with _collecting(ctx, stand):
            if turn is None:
                ctx.clock.sleep_until(started_s + duration_s)
            else:
                _turn(ctx, stand, *turn)
        elapsed_s = ctx.clock.now_s() - started_s
        dut = ctx.unit.stop_stream()
        capture = Capture(name, kind, dut, stand.stop_stream(), started_s, rate_hz, axis)
        _check_stand(capture, turn, elapsed_s)
        _check_mode(capture, compensated)
        lost = lost_samples(dut, elapsed_s, rate_hz)
        if lost == 0:
            return capture
    raise LinkError(
        f"{lost} of the unit's samples were lost during '{name}', {CAPTURE_TRIES} times running.",
        where=f"RS-422 link, capture {name} at {rate_hz} Hz",
        fault=Fault.FIXTURE,
        remedy="check the socket's contacts and cable; a retest on another stand tells.",
    )


@contextmanager
def _collecting(ctx: StepContext, stand: ThreeAxisTurntable) -> Iterator[None]:
    """Both streams are taken in as they come, whatever the step waits for."""
    unit = ctx.unit

    def collect() -> None:
        unit.collect()
        stand.collect()

    ctx.clock.while_sleeping = collect
    try:
        yield
    finally:
        ctx.clock.while_sleeping = lambda: None


def _turn(ctx: StepContext, stand: ThreeAxisTurntable, profile: TurnProfile, sign: int) -> None:
    ctx.clock.sleep_until(ctx.clock.now_s() + REST_BEFORE_TURN_S)
    stand.rotate("outer", sign * profile.angle_deg, profile.duration_s, profile.ramp_s)
    ctx.clock.sleep_until(ctx.clock.now_s() + profile.rest_s)


def lost_samples(dut: NDArray[np.void], elapsed_s: float, rate_hz: int) -> int:
    """Samples that are not there, of a stream that ran for `elapsed_s`: gaps of the counter, and its end.

    A counter that stands still or jumps back counts as one lost sample each.
    """
    if len(dut) < 2:
        return max(1, round(elapsed_s * rate_hz) - len(dut))
    steps = np.diff(dut["counter"].astype(np.int64))
    gaps = int((steps[steps > 1] - 1).sum() + np.count_nonzero(steps < 1)) + int(dut["counter"][0])
    expected = int(elapsed_s * rate_hz * (1 - COUNT_TOLERANCE)) - TAIL_SAMPLES
    return gaps + max(0, expected - len(dut) - gaps)


def _check_mode(capture: Capture, compensated: bool) -> None:
    flagged = capture.flagged(SampleStatus.COMPENSATED)
    if flagged != (len(capture.dut) if compensated else 0):
        raise LinkError(
            f"{flagged} of {len(capture.dut)} samples of '{capture.name}' are marked as compensated, where "
            f"{'all' if compensated else 'none'} should be.",
            where=f"RS-422 stream, capture {capture.name}",
            fault=Fault.UNIT,
            remedy="check the unit's firmware version.",
        )


def _check_stand(capture: Capture, turn: tuple[TurnProfile, int] | None, elapsed_s: float) -> None:
    stand = capture.stand
    expected = int(elapsed_s * capture.rate_hz * (1 - COUNT_TOLERANCE)) - TAIL_SAMPLES
    if len(stand) < max(expected, 2) or (np.diff(stand["time_s"]) <= 0).any():
        raise _stand_fault(capture, f"only {len(stand)} of {expected} encoder samples came, or out of order")
    angles = np.unwrap(stand["angles_rad"], axis=0)
    if turn is None:
        moved = float(np.ptp(angles, axis=0).max())
        if moved > MAX_REST_MOVEMENT_RAD:
            raise _stand_fault(capture, f"it moved by {np.rad2deg(moved):.3f}° while it should rest")
        return
    profile, sign = turn
    turned = angles[-1] - angles[0] - np.array([sign * np.deg2rad(profile.angle_deg), 0.0, 0.0])
    if np.abs(turned).max() > MAX_ANGLE_ERROR_RAD:
        raise _stand_fault(
            capture, f"it ended {np.rad2deg(np.abs(turned).max()):.3f}° from where it should be"
        )
    reached = float(np.abs(stand["rate_rad_s"]).max())
    if reached < MIN_RATE_SHARE * profile.peak_rate_rad_s:
        raise _stand_fault(
            capture,
            f"it reached {np.rad2deg(reached):.1f} of {np.rad2deg(profile.peak_rate_rad_s):.1f} °/s",
        )


def _stand_fault(capture: Capture, how: str) -> LinkError:
    return LinkError(
        f"The stand did not do '{capture.name}' as it was told: {how}.",
        where=f"turntable, capture {capture.name}",
        fault=Fault.STAND,
        remedy="home the stand; look at its drives, its limits and its encoder stream.",
    )

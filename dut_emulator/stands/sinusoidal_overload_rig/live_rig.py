# pyright: strict
"""The overload rig as a state machine over bench time: what a unit on its slide feels at every moment.

    READY ── run ──> STARTING ── at speed ──> RUNNING ── stop ──> STOPPING ── at rest ──> READY
    FAULT while the door is open, NOREF while the grating's zero mark is lost.

The even phase of the crank has pieces of constant acceleration; crank and slide follow from it in closed form
(`CrankTurn.at`). A door that opens, or a mark that is lost, brakes; a drive that misses its speed
stays STARTING at 97 % of it. Runs are refused as `SinusoidalOverloadRig` refuses them.
"""

import math
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.interfaces import StandRefusal
from dut_emulator.motion.crank import Crank, CrankTurn, FloatArray, SlideState
from dut_emulator.stands.sinusoidal_overload_rig.carriage import Carriage
from dut_emulator.stands.sinusoidal_overload_rig.crank_drive import FULL_TURN, SAME_PHASE_RAD, CrankDrive
from dut_emulator.stands.sinusoidal_overload_rig.rig import SinusoidalOverloadRig
from protocol.errors import TestloomError
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

ERR_BUSY, ERR_NO_REFERENCE, ERR_LIMIT, ERR_DOOR_OPEN, ERR_NOT_RUNNING = 10, 11, 12, 13, 14
FAULTS = ("none", "door_open", "lost_reference", "speed_not_reached")
RADIUS_M, PAYLOAD_KG = 0.15, 45.0
BRAKE_RAD_S2 = 6.0
MISSED_SPEED_SHARE = 0.97
_SAME_MOMENT_S = 1e-9
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)


@dataclass(frozen=True)
class HalfCycle:
    """What the grating measured between its last two passes over the zero mark; `force`: +1 or −1."""

    force: int
    duration_s: float
    speed_change_m_s: float
    squared_m2_s3: float


@dataclass(frozen=True)
class RigStatus:
    """What `STAT?` says."""

    state: str  # READY STARTING RUNNING STOPPING FAULT NOREF
    overload_g: float
    speed_rad_s: float
    angle_rad: float
    position_m: float
    temperature_c: float


class LiveOverloadRig:
    """See the module. Calls never go back in time. Also the unit's `Surroundings`."""

    def __init__(self, rig: SinusoidalOverloadRig) -> None:
        self.rig = rig
        errors = rig.errors
        self._crank = Crank(RADIUS_M)
        true = Crank(RADIUS_M * (1.0 + errors.radius))
        turn = CrankTurn(rig.drive.flywheel(true, PAYLOAD_KG, 1.0 + errors.balance))
        self._carriage = Carriage(turn, rig.site, 1, errors.grating)
        mark = true.force_free_angle_rad()
        self._marks = turn.phase(np.array([mark, FULL_TURN - mark]))
        self._drive = CrankDrive()
        self._fault = "none"
        self._at_speed_s = self._at_rest_s = -math.inf

    # --- commands

    def start(self, overload_g: float, now_s: float) -> float | StandRefusal:
        """To speed; how long that takes."""
        refusal = self._refusal(now_s, "READY")
        if refusal is not None:
            return refusal
        try:
            speed = self.rig.checked_speed_rad_s(self._crank, overload_g, PAYLOAD_KG, 1.0)
        except TestloomError as error:
            return StandRefusal(ERR_LIMIT, error.what)
        start_up_s = self.rig.figures(self._crank, speed, PAYLOAD_KG, 1.0).start_up_s
        speed *= 1.0 + self.rig.errors.speed
        missed = self._fault == "speed_not_reached"
        share = MISSED_SPEED_SHARE if missed else 1.0
        self._drive.accelerate(share * speed, speed / start_up_s, now_s)
        self._at_rest_s, self._at_speed_s = math.inf, math.inf if missed else now_s + start_up_s
        return start_up_s

    def stop(self, now_s: float) -> float:
        """To rest; how long that takes."""
        if self._at_rest_s < math.inf:
            return max(self._at_rest_s - now_s, 0.0)
        duration_s = self._drive.brake(BRAKE_RAD_S2, now_s)
        self._at_rest_s, self._at_speed_s = now_s + duration_s, math.inf
        return duration_s

    def mount(self, axis: int, now_s: float) -> StandRefusal | None:
        """Put the unit with this body axis along the stroke."""
        refusal = self._refusal(now_s, "READY")
        if refusal is None:
            carriage = self._carriage
            self._carriage = Carriage(carriage.turn, carriage.site, axis, carriage.grating)
        return refusal

    def inject(self, fault: str, now_s: float) -> None:
        """One of `FAULTS`."""
        if fault in ("door_open", "lost_reference"):
            self.stop(now_s)
        self._fault = fault

    # --- what is seen

    def status(self, now_s: float) -> RigStatus:
        """The state now."""
        slide = self.slide(np.array([now_s]))
        return RigStatus(
            state=self.state(now_s),
            overload_g=float(slide.speed_rad_s[0]) ** 2 * RADIUS_M / STANDARD_GRAVITY_M_S2,
            speed_rad_s=float(slide.speed_rad_s[0]),
            angle_rad=math.fmod(float(slide.angle_rad[0]), FULL_TURN),
            position_m=float(self._carriage.grating.read_m(slide.position_m)[0]),
            temperature_c=self._carriage.temperature_c,
        )

    def state(self, now_s: float) -> str:
        """See the module."""
        if self._fault == "door_open":
            return "FAULT"
        if self._fault == "lost_reference":
            return "NOREF"
        if now_s >= self._at_rest_s - _SAME_MOMENT_S:
            return "READY"
        if self._at_rest_s < math.inf:
            return "STOPPING"
        return "RUNNING" if now_s >= self._at_speed_s - _SAME_MOMENT_S else "STARTING"

    def next_mark_s(self, after_s: float) -> float | None:
        """The next pass over the grating's zero mark: an edge of the trigger line. None: none to come."""
        if self._fault in ("door_open", "lost_reference"):
            return None
        return self._drive.next_pass_s(self._marks, after_s)

    def half_cycle(self, now_s: float) -> HalfCycle | StandRefusal:
        """The last half-cycle that was measured at speed."""
        refusal = self._refusal(now_s, "RUNNING")
        if refusal is not None:
            return refusal
        first_s = self.next_mark_s(self._at_speed_s)
        phase, rate, _ = (float(values[0]) for values in self._drive.at(np.array([now_s])))
        behind = np.sort(np.mod(phase + SAME_PHASE_RAD - self._marks, FULL_TURN))
        begin_s, end_s = now_s - float(behind[1]) / rate, now_s - float(behind[0]) / rate
        if first_s is None or begin_s < first_s - _SAME_MOMENT_S:
            return StandRefusal(ERR_NOT_RUNNING, "no half-cycle measured yet")
        middle_s, half_s = 0.5 * (begin_s + end_s), 0.5 * (end_s - begin_s)
        slide = self.slide(np.concatenate([[begin_s], middle_s + half_s * _NODES, [end_s]]))
        longer = 1.0 + self._carriage.grating.length_error
        change = longer * float(slide.velocity_m_s[-1] - slide.velocity_m_s[0])
        squared = longer**2 * half_s * float(_WEIGHTS @ slide.acceleration_m_s2[1:-1] ** 2)
        clock_s = self._carriage.grating.clock_s
        duration_s = (round(end_s / clock_s) - round(begin_s / clock_s)) * clock_s
        return HalfCycle(1 if change > 0 else -1, duration_s, abs(change), squared)

    def slide(self, times_s: FloatArray) -> SlideState:
        """Crank and slide, (n,)."""
        return self._carriage.turn.at(*self._drive.at(times_s))

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """Of the guide and the mounting."""
        return self.rig.effects

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit."""
        return self._carriage.stimulus(times_s, self.slide(times_s))

    def stream_rows(self, times_s: FloatArray) -> FloatArray:
        """(n, 15): columns of `protocol.stand_stream`, the grating's position in the last one."""
        slide = self.slide(times_s)
        read = self._carriage.reading(slide)
        rows = np.zeros((len(times_s), 15))
        rows[:, 0], rows[:, 9] = times_s, read["angle_crank"]
        for column, axis in enumerate("xyz"):
            rows[:, 4 + column] = read[f"acc_{axis}"]
        rows[:, 12], rows[:, 13], rows[:, 14] = slide.speed_rad_s, read["temp"], read["position"]
        return rows

    def _refusal(self, now_s: float, needed: str) -> StandRefusal | None:
        state = self.state(now_s)
        if state == "FAULT":
            return StandRefusal(ERR_DOOR_OPEN, "door open")
        if state == "NOREF":
            return StandRefusal(ERR_NO_REFERENCE, "zero mark of the grating not found")
        if state == needed:
            return None
        if needed == "READY":
            return StandRefusal(ERR_BUSY, state.lower())
        return StandRefusal(ERR_NOT_RUNNING, f"not at speed: {state.lower()}")

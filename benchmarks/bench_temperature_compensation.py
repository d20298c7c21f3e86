"""Paper 2, section 2.2: six positions re-mounted in the chamber against the frozen matrix with sigma(N, T).

The paper measured a largest residual of 30 mg with the one and of 5 mg with the other, and does not say how
well its unit sat. Emulated units are mounted anew for every pair of axes, once as well as the emulated stand
does it (1 mrad) and once as badly as explains the paper's figure (20 mrad in each axis). Both methods get
the same recordings; their errors are those of the specific force at attitudes and temperatures that neither
was fitted at, against the unit's own effects.
"""

import dataclasses
from typing import Any

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.temperature_compensation import hat_weights
from calibration.algorithms.thermal_soaks import fit_soaks, soak_temperatures
from calibration.evaluations.room_matrix import room_matrix
from calibration.evaluations.thermal_positions import soak_readings
from dut_emulator.effects.effect import EffectChain, Stage, Stimulus
from dut_emulator.effects.stand import RemountMisalignment
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import Twin
from protocol.recordings import Recording

G = 9.80665
SEEDS = (1, 3)
"""Of units without a lot defect."""
PAPER_MG = {"re-mounted six positions": 30.0, "frozen matrix and sigma(N, T)": 5.0}
VALUES = {"soak_s": 600.0, "ramp_c_per_min": 5.0, "levels": 12.0}
NOT_OF_TEMPERATURE = {"white_noise", "bias_instability", "quantization", "warm_up", "thermal_hysteresis"}
TEMPERATURES_C = np.array([-28.0, -12.0, 3.0, 37.0, 52.0, 67.0])


def run(seeds: tuple[int, ...] = SEEDS) -> list[dict[str, Any]]:
    """Rows for the table; the paper's figures stand beside the simulated ones."""
    rows: list[dict[str, Any]] = []
    for words, deviation_rad in (("1 mrad, the stand's", 1e-3), ("20 mrad, as in the paper", 20e-3)):
        worst = np.max([errors_mg(seed, deviation_rad) for seed in seeds], axis=0)
        for (method, paper), value in zip(PAPER_MG.items(), worst.tolist(), strict=True):
            better = method != "re-mounted six positions"
            rows.append(
                {
                    "figure": f"{method}, largest error, re-mounted to {words}",
                    "value": value,
                    "unit": "mg",
                    "goal": "at most 5 mg" if better else "-",
                    "met": value <= PAPER_MG[method] if better else None,
                    "compared_with": f"simulated, {len(seeds)} units; paper 2: {paper:g} mg, measured",
                }
            )
    return rows


def errors_mg(seed: int, remounted_rad: float) -> tuple[float, float]:
    """Largest error of a unit compensated by either method: per-temperature six positions, sigma(N, T)."""
    twin = product_named("mems_ahrs").twin(seed, "U-0001")
    rng = np.random.default_rng(seed)
    mounted = [
        dataclasses.replace(twin, effects=(*_mounting(rng, remounted_rad), *twin.effects)) for _ in range(3)
    ]
    chamber = [
        recorded(
            "mems_ahrs",
            "thermal_positions",
            values=VALUES | {"mount": float(mount)},
            mount=f"m{mount}",
            twin=mounted[mount - 1],
            seed=seed,
            rate_hz=4.0,
        )
        for mount in (1, 2, 3)
    ]
    turntable = [
        recorded("mems_ahrs", profile, twin=twin, seed=seed, powered_before_s=1800.0)
        for profile in ("multi_position", "rotation")
    ]
    room = room_matrix(turntable)
    readings = soak_readings(chamber, "acc", [])
    model = fit_soaks(readings, room.acc, room.temperature_c["acc"]).model
    soaks, matrices = six_positions(chamber)
    inputs = _attitudes()
    errors = np.zeros((2, len(TEMPERATURES_C)))
    for column, degrees in enumerate(TEMPERATURES_C):
        output = _true_output(twin, inputs, degrees)
        at = np.full(len(inputs), degrees)
        weights = hat_weights(soaks, np.array([degrees]))[0]
        fitted = np.tensordot(weights, matrices, axes=1)
        conventional = (output - fitted[3]) @ np.linalg.inv(fitted[:3].T).T
        # What each power-on shifts is no matter of temperature: both are taken at their mean.
        frozen = model.compensate(output, at).input_si
        for row, found in enumerate((conventional, frozen)):
            errors[row, column] = np.abs(found - inputs).max()
    return tuple(float(one) * 1e3 / G for one in errors.max(axis=1))  # type: ignore[return-value]


def six_positions(chamber: list[Recording]) -> tuple[FloatArray, FloatArray]:
    """Soak temperatures (k,), and [M^T; D] (k, 4, 3) of each by least squares over all mounts (eq (1))."""
    outputs, temperatures, inputs = [], [], []
    for recording in chamber:
        readings = soak_readings([recording], "acc", [])
        stand = recording.streams["stand"]
        force, time_s = stand.si("acc_x", "acc_y", "acc_z"), stand.time_s()
        at = np.stack([np.interp(readings.middle_s, time_s, one) for one in force.T], axis=1)
        outputs.append(readings.output)
        temperatures.append(readings.temperature_c)
        inputs.append(at)
    output, temperature, force = np.concatenate(outputs), np.concatenate(temperatures), np.concatenate(inputs)
    soaks = soak_temperatures(temperature)
    nearest = np.abs(temperature[:, None] - soaks).argmin(axis=1)
    matrices = []
    for soak in range(len(soaks)):
        rows = nearest == soak
        design = np.column_stack([force[rows], np.ones(int(rows.sum()))])
        matrices.append(np.linalg.lstsq(design, output[rows], rcond=None)[0])
    return soaks, np.array(matrices)


def _mounting(rng: np.random.Generator, deviation_rad: float) -> tuple[RemountMisalignment, ...]:
    x, y, z = rng.normal(0.0, deviation_rad, 3).tolist()
    return tuple(RemountMisalignment(sensor, (x, y, z)) for sensor in ("gyro", "acc"))


def _attitudes() -> FloatArray:
    """Specific forces of 1 g in 26 directions, m/s^2."""
    grid = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=float)
    grid = grid[np.abs(grid).sum(axis=1) > 0]
    return G * grid / np.linalg.norm(grid, axis=1, keepdims=True)


def _true_output(twin: Twin, inputs: FloatArray, temperature_c: float) -> FloatArray:
    """What the unit's own effects make of steady inputs, settled and without noise."""
    left_out = NOT_OF_TEMPERATURE | {"bandwidth", "saturation"}
    effects = [
        one
        for one in twin.effects
        if one.sensor == "acc" and one.word not in left_out and one.stage < Stage.TRANSPORT
    ]
    chain = EffectChain(effects)
    stimulus = Stimulus(np.arange(len(inputs), dtype=np.float64), np.full(len(inputs), temperature_c), 1.0)
    return chain.apply(inputs, stimulus, chain.begin(np.random.SeedSequence(0)))

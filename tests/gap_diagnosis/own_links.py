"""Recordings of a unit on a swinging table, made without the emulator: each fault of a link or a converter.

Gyro and accelerometer at `RATE_HZ`; the table's report four times as often. Random tones make the motion, so
that no two stretches are alike; noise is white, with a random walk beside it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from protocol.recordings import Recording, Stream

RATE_HZ, STAND_TIMES = 100.0, 4
DEG, G = math.pi / 180.0, 9.80665
NAMES = {"gyro": ("gyro_x", "gyro_y", "gyro_z"), "acc": ("acc_x", "acc_y", "acc_z")}
NOISE_SI = {"gyro": 0.05 * DEG, "acc": 0.02}


@dataclass
class Motion:
    """Rates and specific forces at any time: (n,) s → (n, 3) SI."""

    tones: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    at_rest: float = 0.0

    def at(self, sensor: str, time_s: np.ndarray) -> np.ndarray:
        f, phase, size = self.tones[sensor]
        moving = np.clip((time_s - self.at_rest) / 2.0, 0.0, 1.0)[:, None]
        wave = np.stack(
            [np.sin(2 * math.pi * np.outer(time_s, f[k]) + phase[k]) @ size[k] for k in range(3)], axis=1
        )
        constant = np.array([0.0, 0.0, G if sensor == "acc" else 0.0])
        return constant + moving * wave


def motion(seed: int, rate_rad_s: float = 40 * DEG, force_m_s2: float = 2.0, at_rest: float = 0.0) -> Motion:
    rng = np.random.default_rng([seed, 1])

    def of(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return rng.uniform(0.1, 2.5, (3, 8)), rng.uniform(0, 6.28, (3, 8)), np.full((3, 8), size / 2.0)

    return Motion({"gyro": of(rate_rad_s), "acc": of(force_m_s2)}, at_rest)


@dataclass
class Samples:
    """What a unit would send, before its link: times, and triads in SI."""

    time_s: np.ndarray
    values: dict[str, np.ndarray]
    rng: np.random.Generator


def samples(moved: Motion, seconds: float, seed: int, jitter_s: float = 0.0) -> Samples:
    rng = np.random.default_rng([seed, 2])
    time_s = np.arange(0.5, seconds, 1.0 / RATE_HZ)
    taken = time_s + jitter_s * rng.standard_normal(len(time_s))
    values: dict[str, np.ndarray] = {}
    for sensor, noise in NOISE_SI.items():
        walk = np.cumsum(rng.normal(0, 0.002 * noise, (len(time_s), 3)), axis=0)
        turned = np.eye(3) + rng.normal(0, 1e-3, (3, 3))
        bias = rng.normal(0, 3 * noise, 3)
        white = rng.normal(0, noise, (len(time_s), 3))
        values[sensor] = moved.at(sensor, taken) @ turned.T + bias + white + walk
    return Samples(time_s, values, rng)


def rounded(values: np.ndarray, quantum: float) -> np.ndarray:
    return np.rint(values / quantum) * quantum if quantum > 0 else values


def wrapped(values: np.ndarray, half_span: float) -> np.ndarray:
    return (values + half_span) % (2 * half_span) - half_span


def recording(
    moved: Motion,
    made: Samples,
    believed: Mapping[str, Mapping[str, Any]] | None = None,
    keep: np.ndarray | None = None,
    counter: np.ndarray | None = None,
    number: int = 1,
) -> Recording:
    rows = np.ones(len(made.time_s), dtype=bool) if keep is None else keep
    stand_s = np.arange(0.0, made.time_s[-1] + 0.5, 1.0 / (STAND_TIMES * RATE_HZ))
    dut = {"t": made.time_s[rows]}
    for sensor, values in made.values.items():
        scale = DEG if sensor == "gyro" else 1.0
        dut |= {name: values[rows, k] / scale for k, name in enumerate(NAMES[sensor])}
    units = dict.fromkeys(NAMES["gyro"], "deg/s") | dict.fromkeys(NAMES["acc"], "m/s^2")
    if counter is not None:
        dut["counter"], units["counter"] = counter[rows], "1"
    rates, forces = moved.at("gyro", stand_s) / DEG, moved.at("acc", stand_s)
    stand = {"t": stand_s, **{f"rate_{a}": rates[:, k] for k, a in enumerate("xyz")}}
    stand |= {f"acc_{a}": forces[:, k] for k, a in enumerate("xyz")}
    stand_units = {f"rate_{a}": "deg/s" for a in "xyz"} | {f"acc_{a}": "m/s^2" for a in "xyz"}
    density = {
        "gyro": (0.05 * 60 / math.sqrt(RATE_HZ), "deg/sqrt(h)"),
        "acc": (0.02 * 60 / math.sqrt(RATE_HZ), "m/s/sqrt(h)"),
    }
    word = {"gyro": "angle_random_walk", "acc": "velocity_random_walk"}
    known: dict[str, Any] = {
        sensor: {
            "unit": "deg/s" if sensor == "gyro" else "m/s^2",
            word[sensor]: {"value": density[sensor][0], "unit": density[sensor][1], "unit_spread": 0.3},
            **(believed or {}).get(sensor, {}),
        }
        for sensor in made.values
    }
    return Recording(
        f"own-{number}",
        {"serial": "U-1", "product": "own"},
        {"profile": "swing", "run": number, "mount": f"m{number}"},
        {
            "dut": Stream("dut", "dut", "t", {"t": "s", **units}, dut),
            "stand": Stream("stand", "stand", "t", {"t": "s", **stand_units}, stand),
        },
        believed=known,
    )

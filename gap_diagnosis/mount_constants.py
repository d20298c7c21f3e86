# pyright: strict
"""Constants of mount and stand, from the matrices that every mount is recalibrated for.

    D = M − M_believed ≈ K_unit − [φ×] + s I (gyro)

One mount cannot tell the unit's own matrix K from the rotation φ of the mount and the rate error s of the
stand. Two mounts can: K is common to them, φ is another one, the same for gyro and accelerometer; s goes with
the stand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc  # pyright: ignore[reportMissingTypeStubs]

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.mount_estimates import MatrixEstimate, MountEstimate, ParameterEstimate

REMOUNT, RATE_SCALE = "stand.remount_misalignment", "stand.rate_scale_factor"
OF_ROTATION = (((1, 2), (2, 1)), ((2, 0), (0, 2)), ((0, 1), (1, 0)))
"""φ_i is half of the first entry less the second one (`RemountMisalignment`: y = u − φ × u)."""


@dataclass(frozen=True)
class MountPair:
    """Two mounts of one unit: the rotation between them that gyro and accelerometer have in common.

    Attributes:
        rotation_rad, standard_uncertainty_rad: (3,) second mount less first.
        rate_share, rate_share_uncertainty: the second stand's rate error less the first's; None on one stand.
        p: that what is left of the matrices' difference is noise.
    """

    serial: str
    first: tuple[str, str]
    second: tuple[str, str]
    rotation_rad: tuple[float, float, float]
    standard_uncertainty_rad: tuple[float, float, float]
    rate_share: float | None
    rate_share_uncertainty: float | None
    p: float

    def entry(self) -> dict[str, object]:
        """As cohort.json lists it."""
        return {
            "serial": self.serial,
            "first": {"stand": self.first[0], "mount": self.first[1]},
            "second": {"stand": self.second[0], "mount": self.second[1]},
            "rotation": {"value": list(self.rotation_rad), "unit": "rad"},
            "standard_uncertainty": {"value": list(self.standard_uncertainty_rad), "unit": "rad"},
            "rate_scale_factor": self.rate_share,
            "rate_scale_factor_standard_uncertainty": self.rate_share_uncertainty,
            "p_of_the_rest": self.p,
        }


def constants_of(mount: MountEstimate) -> tuple[ParameterEstimate, ...]:
    """Rotation of each triad and mean scale of the gyro at one mount, as parameters.

    Each triad has a rotation of its own: the unit's part of it differs.
    """
    found: list[ParameterEstimate] = []
    for matrix in mount.matrices:
        if matrix.sensor not in ("gyro", "acc"):
            continue
        for axis, (plus, minus) in enumerate(OF_ROTATION):
            if matrix.told[plus] and matrix.told[minus]:
                row = np.zeros((3, 3))
                row[plus], row[minus] = 0.5, -0.5
                name = f"rotation_{'xyz'[axis]}"
                found.append(_linear(matrix, row, REMOUNT, name, "rad"))
        if matrix.sensor == "gyro" and np.diag(matrix.told).all():
            found.append(_linear(matrix, np.eye(3) / 3.0, RATE_SCALE, "share", "1"))
    return tuple(found)


def _linear(matrix: MatrixEstimate, row: FloatArray, effect: str, name: str, unit: str) -> ParameterEstimate:
    flat = row.ravel()
    value = float(flat @ matrix.change.ravel())
    return ParameterEstimate(
        effect, matrix.sensor, name, value, float(np.sqrt(flat @ matrix.covariance @ flat)), unit
    )


def mount_pairs(mounts: Sequence[MountEstimate]) -> tuple[MountPair, ...]:
    """Each unit's mounts against its first one."""
    by_unit: dict[str, list[MountEstimate]] = {}
    for one in mounts:
        by_unit.setdefault(one.serial, []).append(one)
    pairs = (_pair(own[0], other) for own in by_unit.values() for other in own[1:])
    return tuple(pair for pair in pairs if pair is not None)


def _pair(first: MountEstimate, second: MountEstimate) -> MountPair | None:
    """Generalised least squares of all entries that both mounts tell: φ, and s between two stands."""
    on_two_stands = first.stand_id != second.stand_id
    gram, cross, square, entries = np.zeros((4, 4)), np.zeros(4), 0.0, 0
    earlier = {one.sensor: one for one in first.matrices}
    for later in second.matrices:
        before = earlier.get(later.sensor)
        if before is None or later.sensor not in ("gyro", "acc"):
            continue
        told = (before.told & later.told).ravel()
        if not told.any():
            continue
        weight = np.linalg.inv((before.covariance + later.covariance)[np.ix_(told, told)])
        columns = np.zeros((3, 3, 4))
        for axis, (plus, minus) in enumerate(OF_ROTATION):
            columns[plus][axis], columns[minus][axis] = 1.0, -1.0
        if later.sensor == "gyro" and on_two_stands:
            columns[..., 3] = np.eye(3)
        rows = columns.reshape(9, 4)[told]
        change = (later.change - before.change).ravel()[told]
        gram += rows.T @ weight @ rows
        cross += rows.T @ weight @ change
        square += float(change @ weight @ change)
        entries += len(change)
    size = 4 if on_two_stands and gram[3, 3] > 0.0 else 3
    gram, cross = gram[:size, :size], cross[:size]
    if entries <= size or np.linalg.matrix_rank(gram) < size:
        return None
    covariance = np.linalg.inv(gram)
    found, u = covariance @ cross, np.sqrt(np.diag(covariance))
    left = max(square - float(cross @ found), 0.0)
    x, y, z = (float(value) for value in found[:3])
    ux, uy, uz = (float(value) for value in u[:3])
    share = (float(found[3]), float(u[3])) if size == len(gram) > 3 else (None, None)
    return MountPair(
        first.serial,
        (first.stand_id, first.mount),
        (second.stand_id, second.mount),
        (x, y, z),
        (ux, uy, uz),
        *share,
        p=float(gammaincc(0.5 * (entries - size), 0.5 * left)),
    )
